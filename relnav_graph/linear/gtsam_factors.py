"""Any of our models as a `gtsam.CustomFactor` in anybody's own factor graph.

The only module that builds a `CustomFactor`; one of a user's goes through `guarded`. Keys map to
blocks in the order in which a model names them: an attitude block is a `gtsam.Rot3`, any other a
vector. The residual is whitened inside, so the factor's noise model is a unit one, or what the
caller gives for whitened residuals: a robust one, say. Every Jacobian comes out of a buffer of the
right size and is checked to be filled. A kernel that writes past its buffer is found out before
GTSAM sees the factor, since GTSAM answers a wrong shape with a segmentation fault.

Inside `ISAM2` keep a reference to ``isam.getLinearizationPoint()`` while updating: without
it, GTSAM copies all its values for each call of each factor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gtsam
import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import Dynamics, Sensor
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.numbered import numbered_of
from relnav_graph.core.problem import Prior
from relnav_graph.core.state import Block, Layout
from relnav_graph.errors import (
    EstimationError,
    GeometryError,
    InputError,
    ModelError,
    RelnavError,
)
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import anchor_of
from relnav_graph.linear.intervals import process_rows
from relnav_graph.maths.losses import Loss

__all__ = [
    "Look",
    "NoiseModel",
    "Way",
    "insert_block",
    "interval_factor",
    "measurement_factor",
    "observation_factor",
    "prior_factor",
    "process_factor",
    "read_block",
]

#: Of whitened residuals: GTSAM's own, or one of our losses.
NoiseModel = Loss | gtsam.noiseModel.Base


def insert_block(values: gtsam.Values, key: int, block: Block, value: Array) -> None:
    """Insert the value of a block under a key, as the factors expect it.

    value: (3, 3) for an attitude, (dim,) otherwise; SI. Raises InputError when the value has
    another shape, is not finite, or is no rotation.
    """
    stored = block.pack(value)
    values.insert(key, gtsam.Rot3(block.unpack(stored)) if block.manifold == "SO3" else stored)


def read_block(values: gtsam.Values, key: int, block: Block) -> Array:
    """The value of a block under a key: (3, 3) for an attitude, (dim,) otherwise; SI."""
    if block.manifold == "SO3":
        return values.atRot3(key).matrix()
    return values.atVector(key)


class _Reader:
    """Reads blocks from GTSAM's values into one stored vector x (1, size)."""

    def __init__(self, layout: Layout) -> None:
        self.x = layout.identity[None].copy()
        parts = [(b.manifold == "SO3", self.x[0, layout.stored(b.name)]) for b in layout]
        self._places = [(so3, part.reshape(3, 3) if so3 else part) for so3, part in parts]

    def read(self, values: gtsam.Values, keys: Sequence[int]) -> Array:
        for key, (so3, place) in zip(keys, self._places, strict=True):
            place[...] = values.atRot3(key).matrix() if so3 else values.atVector(key)
        return self.x


def _check_keys(kind: str, keys: Sequence[int], blocks: Sequence[Block]) -> None:
    whole = all(isinstance(k, (int, np.integer)) and k >= 0 for k in keys)
    if not whole or len(keys) != len(blocks) or len(set(keys)) != len(keys):
        names = [b.name for b in blocks]
        raise InputError(f"{kind}: found keys {list(keys)}, expected a different one for {names}")


#: GTSAM's estimators whose weights are those of our losses, by kind, and the power of their tuning
#: constant: ours times the root of the number of rows, since GTSAM weighs by the norm of the
#: residual and we by its root mean square. A student_t is its Cauchy, see `_noise_model`.
_ROBUST: Mapping[str, tuple[str, int]] = {
    "huber": ("Huber", 1),
    "cauchy": ("Cauchy", 1),
    "dcs": ("DCS", 2),
    "tukey": ("Tukey", 1),
}


def _noise_model(kind: str, rows: int, observations: int, model: NoiseModel | None) -> Any:
    """The noise model of so many whitened rows. Raises InputError on one that does not fit: GTSAM
    would read beyond it; and on a loss of several observations, which would weigh all as one."""
    unit = gtsam.noiseModel.Unit.Create(rows)
    if model is None:
        return unit
    if isinstance(model, Loss):
        if observations != 1:
            raise InputError(
                f"{kind}: found a loss for {observations} observations, which it would weigh as"
                " one; expected a factor of each observation by itself"
            )
        if model.kind == "student_t":  # (nu + m) / (nu + |r|^2) = s^-2 / (1 + |r / s|^2 / (nu + m))
            nu = model.numbers(1)[1]
            scaled = gtsam.noiseModel.Isotropic.Sigma(rows, float(np.sqrt(nu / (nu + rows))))
            cauchy = gtsam.noiseModel.mEstimator.Cauchy.Create(float(np.sqrt(nu + rows)))
            return gtsam.noiseModel.Robust.Create(cauchy, scaled)
        name, power = _ROBUST[model.kind]
        tuning = (model.numbers(rows)[1] * float(np.sqrt(rows))) ** power
        estimator = getattr(gtsam.noiseModel.mEstimator, name).Create(tuning)
        return gtsam.noiseModel.Robust.Create(estimator, unit)
    if not isinstance(model, gtsam.noiseModel.Base) or model.dim() != rows:
        raise InputError(
            f"{kind}: found noise model {model!r}, expected a loss, or one of GTSAM's of dimension"
            f" {rows} for its whitened residuals"
        )
    return model


class Look:
    """What the factors of one sensor have in common: the blocks that it reads, and buffers."""

    def __init__(self, sensor: Sensor, own: Block | None = None) -> None:
        """own: the numbered block that its observations read, where the sensor reads one."""
        self.sensor = sensor
        self.layout = Layout(sensor.reads, () if own is None else (own,))
        self.columns = [self.layout.tangent(b.name) for b in self.layout]
        self.reader = _Reader(self.layout)


class Way:
    """What the factors of one process have in common: the blocks at both ends, and buffers."""

    def __init__(self, process: Dynamics) -> None:
        self.process, self.layout = process, Layout(process.advances, process.reads)
        self.end = Layout(process.advances)
        self.columns = [self.layout.tangent(b.name) for b in self.layout]
        self.columns += [self.end.tangent(b.name) for b in self.end]
        self.reader, self.reader_next = _Reader(self.layout), _Reader(self.end)


def measurement_factor(
    sensor: Sensor, m: Measurement, keys: Sequence[int], model: NoiseModel | None = None
) -> gtsam.CustomFactor:
    """The factor of one measurement: whitened residuals (count * rows,) of its observations.

    keys: of the blocks that the sensor reads, in their order, and of the numbered block of the
    observations, where it reads one: they then have one id; model: a robust loss, of a
    measurement of one observation, or GTSAM's noise model of the whitened residuals; by default a
    unit one. Evaluating it raises GeometryError when an observation is impossible at the values,
    and ModelError when the model breaks its contract. Raises InputError on wrong keys or a model
    that does not fit.
    """
    block = numbered_of(sensor)
    if block is not None and len(set(m.ids.tolist())) != 1:
        raise InputError(f"{sensor.kind}: found ids {m.ids}, expected one: a factor for each")
    look = Look(sensor, None if block is None else block.numbered(int(m.ids[0])))
    _check_keys(sensor.kind, keys, look.layout.blocks)
    assembly = Assembly(look.layout, {}, {m.sensor: sensor}, [Epoch(m.t, (m,))])
    return observation_factor(look, assembly, keys, np.ones(assembly.observations), model)


def observation_factor(
    look: Look,
    assembly: Assembly,
    keys: Sequence[int],
    weight: Array,
    model: NoiseModel | None = None,
) -> gtsam.CustomFactor:
    """:func:`measurement_factor` of one measurement that is assembled already, alone.

    weight (observations,): square roots of their weights; 0 leaves one out.
    """
    sensor, columns, reader, weight = look.sensor, look.columns, look.reader, np.array(weight)

    def error(
        factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None
    ) -> Array:
        rows = assembly.measure(reader.read(values, factor.keys()), weight)
        if np.count_nonzero(rows.status):
            bad = np.nonzero(rows.status)[0][0]
            raise GeometryError(
                f"{sensor.kind}: id {assembly.ids[bad]} at t = {assembly.times[0]} s:"
                f" {sensor.failure(int(rows.status[bad]))}"
            )
        if jacobians is not None:
            for i, part in enumerate(columns):
                jacobians[i] = rows.H[:, part]
        return rows.r

    count = int(assembly.row_offsets[-1])
    noise = _noise_model(sensor.kind, count, assembly.observations, model)
    return gtsam.CustomFactor(noise, list(keys), error)


def guarded(where: str, inner: gtsam.CustomFactor, dims: Sequence[int]) -> gtsam.CustomFactor:
    """A factor of a user's, looked at each time that it is evaluated: GTSAM takes what is not
    filled, or of another size, for numbers.

    where: of the factor, for messages; dims: tangent dimension of each of its keys. Evaluating it
    raises ModelError when it raises anything but an error of this package, or gives residuals or
    Jacobians of another shape, EstimationError when they are not finite.
    """
    count = inner.noiseModel().dim()

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> Array:
        try:
            r = np.asarray(inner.unwhitenedError(values, jacobians))
        except RelnavError:
            raise
        except Exception as raised:
            raise ModelError(f"{where}: it raised {type(raised).__name__}: {raised}") from raised
        found = {"residuals": r} | {f"jacobians[{i}]": H for i, H in enumerate(jacobians or ())}
        shapes = [(count,), *((count, dim) for dim in dims if jacobians is not None)]
        if len(found) != len(shapes):
            raise ModelError(f"{where}: found {len(found) - 1} Jacobians, expected {len(dims)}")
        for (name, array), shape in zip(found.items(), shapes, strict=True):
            if array.shape != shape:
                raise ModelError(f"{where}: found {name} of {array.shape}, expected {shape}")
            if not np.isfinite(array).all():
                bad = array[~np.isfinite(array)][0]
                raise EstimationError(f"{where}: found {bad} in {name}, expected finite numbers")
        return r

    return gtsam.CustomFactor(inner.noiseModel(), list(inner.keys()), error)


def process_factor(
    process: Dynamics,
    t: float,
    u: Array,
    keys: Sequence[int],
    keys_next: Sequence[int],
    noise_at: Sequence[Array],
    model: NoiseModel | None = None,
) -> gtsam.CustomFactor:
    """The factor of one interval, ``local(propagate(x_k), x_k+1)``.

    t: start of the interval, s; u (rows, 1 + channels): its inputs, see
    `relnav_graph.core.models`; keys: of the blocks advanced and read, at the start; keys_next:
    of the advanced blocks, at the end; noise_at: values of the blocks of `keys`, (3, 3) or
    (dim,), at which the process noise is evaluated, once; model: as of :func:`measurement_factor`,
    the interval counting as one observation. Raises InputError on wrong keys, a noise covariance
    that is not positive definite or a model that does not fit.
    """
    blocks = process.advances + process.reads
    way = Way(process)
    _check_keys(process.kind, [*keys, *keys_next], [*blocks, *process.advances])
    t_end = float(t + np.sum(np.asarray(u)[:, 0]))
    epoch = Epoch(t_end, (), {"process": np.ascontiguousarray(u, dtype=np.float64)})
    assembly = Assembly(way.layout, {"process": process}, {}, [epoch], t_before=float(t))
    start = way.layout.pack(dict(zip([b.name for b in blocks], noise_at, strict=True)))
    whiten = assembly.whitening(start[None])[0]
    return interval_factor(way, assembly, [*keys, *keys_next], whiten, model)


def interval_factor(
    way: Way,
    assembly: Assembly,
    keys: Sequence[int],
    whiten: Array,
    model: NoiseModel | None = None,
) -> gtsam.CustomFactor:
    """:func:`process_factor` of one interval that is assembled already, alone.

    keys: at the start, then at the end; whiten (n, n): of the process noise of what is advanced.
    """
    begin, end, columns, whiten = len(way.layout), way.end, way.columns, np.array(whiten)[None]

    def error(
        factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None
    ) -> Array:
        at = factor.keys()
        x_next, F, _ = assembly.transition(way.reader.read(values, at[:begin]))
        x1 = way.reader_next.read(values, at[begin:])
        rows = process_rows(end, x_next[:, : end.size], x1, F, whiten)
        if jacobians is not None:
            for i, part in enumerate(columns):
                jacobians[i] = rows.A[0][:, part] if i < begin else rows.B[0][:, part]
        residual: Array = rows.e[0]
        return residual

    noise = _noise_model(way.process.kind, end.dim, 1, model)
    return gtsam.CustomFactor(noise, list(keys), error)


def prior_factor(
    layout: Layout, prior: Prior, keys: Sequence[int], model: NoiseModel | None = None
) -> gtsam.CustomFactor:
    """The factor of a prior on all blocks of a layout together, correlated or not.

    keys: of its blocks, in order; model: as of :func:`measurement_factor`, the prior counting as
    one observation. Raises InputError on wrong keys, a prior that is not one of the layout, or a
    model that does not fit.
    """
    _check_keys("prior", keys, layout.blocks)
    if prior.x.shape != (layout.size,) or len(prior.P) != layout.dim:
        raise InputError(f"prior: found x {prior.x.shape}, P {prior.P.shape}, expected of {layout}")
    columns = [layout.tangent(b.name) for b in layout]
    anchor, reader = anchor_of(prior), _Reader(layout)

    def error(
        factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None
    ) -> Array:
        e, A = anchor.rows(layout, reader.read(values, factor.keys())[0])
        if jacobians is not None:
            for i, part in enumerate(columns):
                jacobians[i] = A[:, part]
        return e

    return gtsam.CustomFactor(_noise_model("prior", layout.dim, 1, model), list(keys), error)
