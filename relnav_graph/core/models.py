"""Mixins that turn a model's kernel into the methods of its contract, and how models are found.

The contracts themselves (`relnav_graph.core.contracts`) are structural: a model need not
inherit from these.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from relnav_graph.arrays import Array, Indices, finite
from relnav_graph.compiled.contracts import GUARD, MARK
from relnav_graph.core.contracts import Derived, Kernel, Sensor
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.numbered import numbered_of
from relnav_graph.core.state import Block, Layout
from relnav_graph.core.steps import check_steps
from relnav_graph.errors import GeometryError, InputError, ModelError
from relnav_graph.registry import classes, provides
from relnav_graph.units import check_fields

__all__ = [
    "DerivedQuantity",
    "DynamicsModel",
    "Outputs",
    "SensorModel",
    "derived_quantities",
    "evaluate",
]
ENTRY_POINTS = "relnav_graph.models"


class DerivedQuantity:
    """Mixin: `Derived.value` made of `values`, which treats a whole pass at once."""

    def values(self, *x: Array) -> tuple[Array, Array]:
        """Values and Jacobians at N epochs.

        x: (N, 3, 3) or (N, dim) per block read, SI, in the block's frame. Value: (N, 3, 3) or
        (N, dim); Jacobian: (N, dim, sum of dims read). See `Derived.value`.
        """
        raise NotImplementedError

    def value(self, *x: Array) -> tuple[Array, Array]:
        """The value and its Jacobian at one epoch."""
        value, jacobian = self.values(*(np.asarray(a)[None] for a in x))
        return value[0], jacobian[0]


def _pack(blocks: Sequence[Block], values: Sequence[Any], kind: str) -> Array:
    if len(values) != len(blocks):
        names = [b.name for b in blocks]
        raise InputError(f"{kind}: found {len(values)} values, expected one for each of {names}")
    return np.concatenate([b.pack(v) for b, v in zip(blocks, values, strict=True)])


def check_inputs(where: str, process: Any, u: Any, spreads: bool = False) -> Array:
    """The inputs u (rows, 1 + channels) of a process over an interval, as C-contiguous float64.

    Each row: length of the sub-interval, s, then all inputs in their order, SI; with `spreads`,
    they may have as many columns more, see `relnav_graph.core.epochs.Epoch`.

    Raises InputError on another shape, values that are not finite, lengths that are not
    positive, spreads below zero, or that would take the process more steps than it can make.
    """
    array = np.ascontiguousarray(u, dtype=np.float64)
    channels = sum(len(columns) for columns in process.inputs.values())
    widths = (1 + channels, 1 + 2 * channels) if spreads else (1 + channels,)
    if array.ndim != 2 or not len(array) or array.shape[1] not in widths:
        raise InputError(f"{where}: found u of {array.shape}, expected (rows, {widths[0]})")
    if not np.isfinite(array).all() or (array[:, 0] <= 0).any():
        raise InputError(f"{where}: found u = {array}, expected finite values and lengths > 0")
    if (array[:, 1 + channels :] < 0).any():
        raise InputError(f"{where}: found u = {array}, expected spreads of zero or more")
    # Of each interval of each pass: to ask whether it is an IntegratesBySteps takes 20 us.
    if max_step := getattr(process, "max_step", None):
        check_steps(where, float(array[:, 0].sum()), max_step)
    return array


class Outputs:
    """Arrays for a kernel to fill, with guard numbers around them that show an overrun.

    fill: what they hold before: NaN, so that what was forgotten is seen.
    """

    def __init__(self, kind: str, fill: float = np.nan, **shapes: tuple[int, ...]) -> None:
        self.kind, self.shapes = kind, shapes
        sizes = {name: int(np.prod(shape)) for name, shape in shapes.items()}
        self._buffers = {name: np.full(n + 2 * GUARD, MARK) for name, n in sizes.items()}
        self.arrays = [
            self._buffers[name][GUARD:-GUARD].reshape(shape) for name, shape in shapes.items()
        ]
        for array in self.arrays:
            array[...] = fill

    @property
    def overrun(self) -> list[str]:
        """Names of the arrays that the kernel wrote past."""
        ends = {name: (b[:GUARD], b[-GUARD:]) for name, b in self._buffers.items()}
        return [name for name, both in ends.items() if any((end != MARK).any() for end in both)]

    @property
    def unfilled(self) -> list[tuple[str, tuple[int, ...]]]:
        """Entries that are not finite: array and place."""
        named = zip(self.shapes, self.arrays, strict=True)
        return [(n, tuple(at)) for n, a in named for at in np.argwhere(~np.isfinite(a)).tolist()]

    def check(self) -> None:
        """Raise ModelError when the kernel left an entry unfilled or wrote past an array."""
        for name in self.overrun:
            raise ModelError(f"{self.kind}: the kernel wrote past its arrays, at {name}")
        for name, at in self.unfilled:
            raise ModelError(f"{self.kind}: the kernel left {name}{list(at)} unfilled")


class SensorModel:
    """Mixin: the methods of `Sensor` that follow from the kernel. Checks the fields."""

    kind: ClassVar[str]
    rows: ClassVar[int]
    columns: ClassVar[tuple[str, ...]]
    kernel: ClassVar[Kernel]
    #: What each non-zero status of the kernel means.
    failures: ClassVar[Mapping[int, str]] = {}

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def reads(self) -> tuple[Block, ...]:
        raise NotImplementedError

    def constants(self) -> Array:
        return np.zeros(0)

    def observation_data(self, ids: Indices) -> Array:
        """None for the only thing that is seen. Raises InputError on the id of another, unless ids
        are numbers of blocks."""
        only = self.observables()
        other = ~np.isin(ids, only) & (numbered_of(self) is None)
        if other.any():
            found, expected = np.asarray(ids)[other][0], ", ".join(map(str, only))
            raise InputError(f"{self.kind}: found id {found}, expected {expected}")
        return np.zeros((len(ids), 0))

    def observables(self) -> Indices:
        return np.zeros(1, dtype=np.int64)

    def accept(self, z: Array) -> Array:
        """z (k, nz), checked. Raises InputError on rows of another width."""
        if z.ndim != 2 or z.shape[1] != len(self.columns):
            raise InputError(f"{self.kind}: found z of {z.shape}, expected columns {self.columns}")
        return z

    def at(self, t: float) -> Sensor:
        """The same at all times, unless a model says otherwise."""
        return self  # type: ignore[return-value]

    def in_view(self, ids: Indices, *x: Array) -> Indices:
        """All of them, unless a model says otherwise."""
        return ids

    def perturb(self, z: Array, e: Array) -> Array:
        return z + e

    def failure(self, status: int) -> str:
        """What a non-zero status of the kernel means."""
        return self.failures.get(status, f"status {status}")

    def residual(self, m: Measurement, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        """r (k * rows,) and its Jacobian to the tangent of each block, (k * rows, dim).

        x: one value per block read, (3, 3) or (dim,), SI, in the block's frame.

        Raises GeometryError when an observation is impossible at this state, InputError
        on values of the wrong shape, ModelError when the kernel leaves an entry unfilled.
        """
        now = self.at(m.t)
        assert isinstance(now, SensorModel)
        r, jacobian = now._call(f"at t = {m.t} s", m.ids, self.accept(m.z), x)
        stacked = jacobian.reshape(-1, sum(self._dims))
        return r.reshape(-1), tuple(np.split(stacked, np.cumsum(self._dims)[:-1], axis=1))

    @property
    def _dims(self) -> list[int]:
        """Tangent dimensions of the blocks that an observation reads."""
        own = numbered_of(self)
        return [b.dim for b in (*self.reads, *([] if own is None else [own]))]

    def predict(self, ids: Indices, *x: Array) -> Array:
        """z = h(x) (k, nz) of k observations, for a sensor whose residual is h(x) - z: the
        kernel's residual at z = 0.

        ids: (k,); x: one value per block read, (3, 3) or (dim,), SI, in the block's frame.
        Raises GeometryError when an observation is impossible at this state.
        """
        return self._call("", ids, np.zeros((len(ids), len(self.columns))), x)[0]

    def _call(self, where: str, ids: Indices, z: Array, x: Sequence[Array]) -> tuple[Array, Array]:
        """Residuals (k, rows) of observations z (k, nz), and Jacobians (k, rows, dims read)."""
        own, plain = numbered_of(self), x
        if own is not None and len(x) == len(self.reads) + 1:
            plain = x[:-1]
            if np.shape(x[-1]) != (len(ids), own.dim):
                found = f"found {own.name} of {np.shape(x[-1])}"
                raise InputError(f"{self.kind}: {found}, expected {(len(ids), own.dim)}")
        elif own is not None:
            raise InputError(
                f"{self.kind}: found no values of {own.name}, expected one for each id"
            )
        packed = _pack(self.reads, plain, self.kind)
        p, q = self.constants(), self.observation_data(ids)
        r = np.empty((len(z), self.rows))
        jacobian = np.empty((len(z), self.rows, sum(self._dims)))
        shared = len(packed)
        if own is not None:
            packed = np.concatenate([packed, np.zeros(own.dim)])
        for k in range(len(z)):
            if own is not None:
                packed[shared:] = x[-1][k]
            outputs = Outputs(self.kind, r=r[k].shape, H=jacobian[k].shape)
            status = self.kernel(p, q[k], z[k], packed, *outputs.arrays)
            if status:
                at = f"{self.kind}: id {ids[k]} {where}".rstrip()
                raise GeometryError(f"{at}: {self.failure(status)}")
            outputs.check()
            r[k], jacobian[k] = outputs.arrays
        return r, jacobian


class DynamicsModel:
    """Mixin: the methods of `Dynamics` that follow from the kernel. Checks the fields."""

    kind: ClassVar[str]
    inputs: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    noises: ClassVar[tuple[str, ...]] = ()
    kernel: ClassVar[Kernel]
    failures: ClassVar[Mapping[int, str]] = {}

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def advances(self) -> tuple[Block, ...]:
        raise NotImplementedError

    @property
    def reads(self) -> tuple[Block, ...]:
        return ()

    def constants(self) -> Array:
        return np.zeros(0)

    def failure(self, status: int) -> str:
        """What a non-zero status of the kernel means."""
        return self.failures.get(status, f"status {status}")

    def condense(self, u: Array) -> Array:
        """u (rows, 1 + channels) as it is, unless a model says otherwise."""
        return u

    def caution(self, length: float, *x: Array) -> str:
        """No warning, unless a model gives one. x: (3, 3) or (dim,) per block, SI."""
        return ""

    def transition(self, t: float, u: Array, *x: Array) -> tuple[tuple[Array, ...], Array, Array]:
        """The advanced blocks at the end of the interval, F and Q.

        t: start, s; u: (rows, 1 + channels), one row per sub-interval: its length in s,
        then the inputs that hold in it, SI. x: one value per block, advanced ones first, (3, 3)
        or (dim,), SI, in the block's frame. F: (n, n + dims read), in tangent coordinates, the
        advanced blocks first; Q: (n, n) covariance of the advanced blocks' noise.
        Raises InputError on values of the wrong shape, ModelError when the kernel leaves
        an entry unfilled, GeometryError when the interval cannot be propagated.
        """
        packed = _pack(self.advances + self.reads, x, self.kind)
        n = sum(b.dim for b in self.advances)
        size, width = sum(b.size for b in self.advances), n + sum(b.dim for b in self.reads)
        outputs = Outputs(self.kind, x_next=(size,), F=(n, width), Q=(n, n))
        x_next, F, Q = outputs.arrays
        u = check_inputs(self.kind, self, u)
        status = self.kernel(self.constants(), float(t), u, packed, x_next, F, Q)
        if status:
            raise GeometryError(f"{self.kind}: from t = {t} s: {self.failure(status)}")
        outputs.check()
        parts = np.split(x_next, np.cumsum([b.size for b in self.advances])[:-1])
        values = tuple(b.unpack(v) for b, v in zip(self.advances, parts, strict=True))
        return values, F, Q

    def propagate(self, t: float, u: Array, *x: Array) -> tuple[Array, ...]:
        """The advanced blocks at the end of the interval; see :meth:`transition`."""
        return self.transition(t, u, *x)[0]


def derived_quantities(layout: Layout) -> list[Derived]:
    """All known derived quantities that `layout` has the blocks for, but not as a block."""
    return [
        cls()
        for cls in classes(ENTRY_POINTS).values()
        if provides(cls, Derived)
        and cls.block.name not in layout
        and all(block in layout.blocks for block in cls.reads)
    ]


def evaluate(quantity: Derived, x: Sequence[Array]) -> tuple[Array, Array]:
    """Value (N, 3, 3) or (N, dim), SI, and Jacobian (N, dim, sum of dims read) at N epochs, NaN
    where an argument is not finite. x: (N, 3, 3) or (N, dim) for each block that is read."""
    block, n = quantity.block, len(x[0])
    value = np.full((n, block.size), np.nan)
    jacobian = np.full((n, block.dim, sum(b.dim for b in quantity.reads)), np.nan)
    known = np.flatnonzero(finite(*x))
    if isinstance(quantity, DerivedQuantity):  # a whole pass at once
        found, jacobian[known] = quantity.values(*(a[known] for a in x))
        value[known] = found.reshape(len(known), block.size)
        return block.unpack(value), jacobian
    for k in known:
        one, jacobian[k] = quantity.value(*(a[k] for a in x))
        value[k] = one.reshape(-1)
    return block.unpack(value), jacobian
