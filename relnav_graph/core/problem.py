"""The estimation problem: all that an estimator sees, immutable.

Filter and smoothers receive the same `Problem`: that is the fairness argument.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType

import numpy as np
from scipy.linalg import block_diag

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.catalogue import ORBIT
from relnav_graph.core.cautions import (
    Caution,
    angle_cautions,
    gap_cautions,
    interval_cautions,
    late_cautions,
    orbit_cautions,
    untold_cautions,
)
from relnav_graph.core.contracts import Dynamics, KnowsOrbit, Sensor
from relnav_graph.core.copies import copied
from relnav_graph.core.epochs import Epoch, check_epoch
from relnav_graph.core.lent import Lent
from relnav_graph.core.measurement import SAME_TIME, Bridge, Stamps
from relnav_graph.core.numbered import families, first_seen
from relnav_graph.core.scatter import scatter_cautions
from relnav_graph.core.shown import Shown, listed, span
from relnav_graph.core.state import Block, Layout
from relnav_graph.core.turning import turning_cautions
from relnav_graph.errors import InputError, ModelError
from relnav_graph.files import check_name
from relnav_graph.maths.losses import Loss
from relnav_graph.maths.orbit import KeplerOrbit

__all__ = [
    "Prior",
    "Problem",
    "lengthened",
    "padded",
]


@dataclass(frozen=True, eq=False)
class Prior:
    """Mean x (size,), a stored vector, and covariance P (n, n), in tangent coordinates, at the
    first epoch; SI, in the order of the layout.

    Raises InputError when x is not finite or P not symmetric positive definite.
    """

    x: Array
    P: Array

    def __post_init__(self) -> None:
        if not np.isfinite(self.x).all():
            raise InputError(f"the prior: found x = {self.x}, expected finite values")
        check_covariance("the prior", self.P)


def check_covariance(where: str, P: Array) -> None:
    """Raise InputError unless P (n, n) is finite, symmetric and positive definite."""
    P = np.asarray(P)
    if P.ndim != 2 or P.shape[0] != P.shape[1] or not np.isfinite(P).all():
        raise InputError(f"covariance of {where}: found {P.shape}, expected finite and square")
    scale = np.sqrt(np.abs(np.diag(P)))
    if (np.diag(P) <= 0).any():
        raise InputError(f"covariance of {where}: found variance {np.diag(P).min()}, expected > 0")
    if np.abs((P - P.T) / np.outer(scale, scale)).max() > 1e-9:
        raise InputError(f"covariance of {where} is not symmetric")
    smallest = np.linalg.eigvalsh(P / np.outer(scale, scale)).min()
    if smallest <= 0:
        raise InputError(
            f"covariance of {where} is not positive definite: smallest eigenvalue of the"
            f" correlation matrix {smallest:.3g}"
        )


@dataclass(frozen=True, eq=False, repr=False)
class Problem(Shown):
    """Models, prior and data of one pass. `Problem.from_arrays` and `Problem.from_frames` make one
    of arrays and of data frames.

    processes, sensors: models by name; gates: probability of the chi-square gate by
    sensor, where one is asked for; losses: robust ones, likewise; window: of a
    fixed-lag smoother, of the batch that a filter begins from, and for late data online, s, None
    for their defaults; bridges, stamps: how gaps in inputs are bridged, by input, and how late
    stamps are, by input or sensor, where they come online; merge: s, how close to an epoch is of
    it, online, 0 for equal times only; numbered: of each family of numbered blocks that the
    sensors read, the prior of one of them; known: those of them that are in the state whether they
    are measured or not; considered: names of blocks, or of families of numbered ones, that are
    counted and not estimated (Schmidt 1966): their uncertainty goes into the covariance of all
    others; measured: names of the blocks whose mean in the prior is from the first measurements
    (`relnav_graph.scenario.first_estimate`). Without epochs it is one to be driven online: they
    come later. Copies (`relnav_graph.core.copies`) are made at its epochs. The layout ends with the
    numbered blocks that are measured, in order of first sight; a prior that does not tell of just
    these is completed. Raises ModelError when no process advances any block, or two advance one,
    InputError when times do not increase, a sensor is unknown, two models have different orbits, a
    name is none (`relnav_graph.files.check_name`), `numbered` is not of just the families that the
    sensors read, with the sizes of their blocks, or `known` not of numbered ones of these, an id of
    one is below zero, a considered block is none of the state or leaves nothing to estimate, or
    there is no epoch to copy.
    """

    processes: Mapping[str, Dynamics]
    sensors: Mapping[str, Sensor]
    prior: Prior
    epochs: tuple[Epoch, ...]
    gates: Mapping[str, float] = field(default_factory=dict)
    window: float | None = None
    losses: Mapping[str, Loss] = field(default_factory=dict)
    bridges: Mapping[str, Bridge] = field(default_factory=dict)
    stamps: Mapping[str, Stamps] = field(default_factory=dict)
    merge: float = SAME_TIME
    numbered: Mapping[str, Prior] = field(default_factory=dict)
    known: tuple[Block, ...] = ()
    considered: tuple[str, ...] = ()
    measured: tuple[str, ...] = ()
    layout: Layout = field(init=False)

    from_arrays = Lent("problem_from_arrays", maker=True)
    from_frames = Lent("problem_from_frames", maker=True)

    def _shown(self) -> tuple[str, Mapping[str, str]]:
        seen = dict.fromkeys(self.sensors, 0)
        for m in (m for epoch in self.epochs for m in epoch.measurements):
            seen[m.sensor] += len(m.ids)
        rows = {
            "processes": listed(f"{n} ({p.kind})" for n, p in self.processes.items()),
            "sensors": listed(f"{n} ({s.kind}, {seen[n]})" for n, s in self.sensors.items()),
            "state": listed(f"{b.name} {b.symbol}" for b in self.layout),
        }
        return f"Problem: {span(self.times)}, {self.layout.dim} error states", rows

    def _doubts(self) -> tuple[Caution, ...]:
        return self.cautions

    def __post_init__(self) -> None:
        for name in ("processes", "sensors", "gates", "losses", "bridges", "stamps", "numbered"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
        for what, named in (("a process", self.processes), ("a sensor", self.sensors)):
            for name in named:
                check_name(what, name)
        for name in ("gates", "losses"):
            for sensor in getattr(self, name):
                if sensor not in self.sensors:
                    raise InputError(f"{name}: unknown sensor {sensor!r}")
        object.__setattr__(self, "epochs", copied(self.epochs, self.sensors, self.merge))
        measured = first_seen(self.sensors, (m for e in self.epochs for m in e.measurements))
        own = families(self.sensors)
        for block in self.known:
            if not isinstance(block, Block) or block.number is None or block.family not in own:
                found = block.name if isinstance(block, Block) else repr(block)
                raise InputError(f"known: found {found}, expected numbered blocks that are read")
        seen = tuple(dict.fromkeys((*self.known, *measured)))
        layout = layout_of(self.processes, self.sensors)
        object.__setattr__(self, "layout", Layout(layout.moving, (*layout.statics, *seen)))
        self._check_numbered()
        self._check_considered()
        if seen and self.prior.x.shape != (self.layout.size,):
            object.__setattr__(self, "prior", completed(self.prior, layout, seen, self.numbered))
        check_orbits(self.processes, self.sensors)
        n = self.layout.dim
        if self.prior.x.shape != (self.layout.size,) or self.prior.P.shape != (n, n):
            raise InputError(
                f"prior: found x {self.prior.x.shape} and P {self.prior.P.shape}, expected"
                f" ({self.layout.size},) and ({n}, {n}) for {self.layout} (a static block is read"
                " by a model and advanced by no process)"
            )
        try:
            self.layout.pack(self.layout.values(self.prior.x))
        except InputError as error:
            raise InputError(f"prior: {error}") from error
        times = np.array([e.t for e in self.epochs])
        bad = ~np.isfinite(times) | np.concatenate(([False], np.diff(times) <= 0))
        if bad.any():
            k = int(np.nonzero(bad)[0][0])
            raise InputError(f"epoch {k}: found t = {times[k]} s, expected increasing times")
        for before, epoch in zip((None, *self.epochs), self.epochs, strict=False):
            t_before = None if before is None else before.t
            check_epoch(self.processes, self.sensors, epoch, t_before)

    def _check_numbered(self) -> None:
        """Raise InputError unless each family of numbered blocks has a prior of its size."""
        own = families(self.sensors)
        for name in self.numbered:
            if name not in own:
                known = ", ".join(own) or "none"
                raise InputError(f"numbered: found {name!r}, expected families read: {known}")
        for name, block in own.items():
            prior, n = self.numbered.get(name), block.dim
            if not isinstance(prior, Prior):
                found = "none" if prior is None else repr(prior)
            elif prior.x.shape != (block.size,) or prior.P.shape != (n, n):
                found = f"x of {prior.x.shape} and P of {prior.P.shape}"
            else:
                continue
            raise InputError(
                f"prior of {name}: found {found}, expected x ({block.size},) and P ({n}, {n}) for"
                " each of these static blocks"
            )

    def _check_considered(self) -> None:
        """Raise InputError unless what is considered is some of the state, and not all of it."""
        names = dict.fromkeys((*(b.name for b in self.layout), *families(self.sensors)))
        for name in self.considered:
            if name not in names:
                raise InputError(
                    f"considered: found {name!r}, expected blocks of the state: {', '.join(names)}"
                )
        if not self.layout.dim > len(self.considered_columns):
            raise InputError(
                "considered: found every block of the state, expected some to estimate"
            )

    def expect_none_considered(self, who: str) -> None:
        """Raise InputError when there are considered blocks, for an estimator that has none."""
        if self.considered:
            raise InputError(
                f"considered: found {', '.join(self.considered)}, expected none for {who}; ekf"
                " considers any block, batch and isam2, after the pass, static ones"
            )

    @property
    def considered_columns(self) -> Indices:
        """Places (c,) in the tangent of the state of the blocks that are considered."""
        if not self.considered:  # asked for at every step
            return np.zeros(0, np.int64)
        own = [b for b in self.layout if {b.name, b.family} & set(self.considered)]
        columns = [np.arange(self.layout.dim)[self.layout.tangent(b.name)] for b in own]
        return np.concatenate([np.zeros(0, np.int64), *columns])

    @property
    def orbit(self) -> KeplerOrbit | None:
        """The target's orbit, with which frame o turns; None where o is at rest."""
        models = *self.processes.values(), *self.sensors.values()
        return next((m.orbit for m in models if isinstance(m, KnowsOrbit)), None)

    @property
    def times(self) -> Array:
        """Times of the epochs (N,), s."""
        return np.array([e.t for e in self.epochs])

    @property
    def cautions(self) -> tuple[Caution, ...]:
        """What is doubtful about the pass, whoever estimates it; nothing before its epochs."""
        if not self.epochs:
            return ()
        start = self.cautions_from(self.epochs[0].t)
        taken = [m for epoch in self.epochs for m in epoch.measurements if len(m.ids)]
        measured = [self.sensors[name] for name in dict.fromkeys(m.sensor for m in taken)]
        points = first_seen(self.sensors, taken)
        statics = [block.name for block in self.layout.statics if block not in points]
        untold = untold_cautions(statics, self.processes.values(), measured)
        gaps = gap_cautions(self.bridged)
        clock = late_cautions(self.epochs[0].t) + interval_cautions(self.times)
        return start + clock + gaps + untold + self._inputs

    @cached_property
    def _inputs(self) -> tuple[Caution, ...]:
        """What they say that others, or they themselves, contradict."""
        known = self.layout.values(self.prior.x)
        turning = turning_cautions(self.processes, self.sensors, self.epochs, known)
        return scatter_cautions(self.processes, self.epochs) + turning

    def cautions_from(self, t: float) -> tuple[Caution, ...]:
        """What is doubtful about a pass that begins at time t, s, whatever comes of it."""
        far = orbit_cautions([*self.processes.values(), *self.sensors.values()], t)
        sigma = np.sqrt(np.diag(self.prior.P))
        return far + angle_cautions(self.layout, sigma, self.sensors)

    @property
    def bridged(self) -> dict[str, list[tuple[float, float]]]:
        """Where gaps in inputs were bridged, by input: times of the epochs whose interval has one,
        s, and how much of it, s."""
        found: dict[str, dict[float, float]] = {}
        for epoch in self.epochs:
            for name, length in epoch.bridged.items():
                found.setdefault(name, {})[epoch.t] = length
        return {key: list(lengths.items()) for key, lengths in found.items()}


def completed(
    prior: Prior, layout: Layout, blocks: Sequence[Block], numbered: Mapping[str, Prior]
) -> Prior:
    """What a prior tells of the blocks of a layout, followed by that of further, numbered ones.

    numbered: of each family, the prior of one of its blocks.
    """
    own = [numbered[block.family] for block in blocks]
    known = prior.P[: layout.dim, : layout.dim]
    return Prior(
        np.concatenate([prior.x[: layout.size], *(one.x for one in own)]),
        block_diag(known, *(one.P for one in own)),
    )


def lengthened(prior: Prior, x: Array) -> Array:
    """A trajectory x (N, s) of the first blocks of a prior, with the prior's mean of the blocks
    after these in each row, (N, size)."""
    return np.hstack([x, np.tile(prior.x[x.shape[1] :], (len(x), 1))])


def padded(prior: Prior, x: Array, P: Array) -> tuple[Array, Array]:
    """A state x (s,) and covariance P (n, n) of the first blocks of a prior, with the prior's of
    the blocks after these, which it correlates with nothing: (size,), (dim, dim)."""
    n = len(P)
    return np.concatenate([x, prior.x[len(x) :]]), block_diag(P, prior.P[n:, n:])


def check_orbits(processes: Mapping[str, Dynamics], sensors: Mapping[str, Sensor]) -> None:
    """Raise InputError, naming two models, unless frame o turns alike for all.

    A model to which it matters has an `orbit`: the target's, or None for an o that is at rest. One
    that is estimated is read by all of them, and advanced by one.
    """
    found = [
        (f"{section} {name!r} ({model.kind})", model.orbit)
        for section, models in (("process", processes), ("sensor", sensors))
        for name, model in models.items()
        if isinstance(model, KnowsOrbit)
    ]
    for where, orbit in found[1:]:
        if orbit != found[0][1]:
            both = [f"{w} has {o or 'no orbit'}" for w, o in (found[0], (where, orbit))]
            raise InputError(
                f"{both[0]}, {both[1]}: expected one orbit for all, with which frame o turns"
            )
    if not found or found[0][1] is None or not found[0][1].estimated:
        return
    names = {block.name for block in ORBIT}
    if missing := names - {b.name for process in processes.values() for b in process.advances}:
        raise InputError(
            f"orbit.estimated: found no process that advances {', '.join(sorted(missing))},"
            " expected one"
        )
    for section, models in (("process", processes), ("sensor", sensors)):
        for name, model in models.items():
            blocks = (*model.reads, *getattr(model, "advances", ()))
            if isinstance(model, KnowsOrbit) and not names & {b.name for b in blocks}:
                raise InputError(
                    f"{section} {name!r} ({model.kind}): found an orbit that is estimated, expected"
                    " one that is known: it cannot take it from the state"
                )


def layout_of(processes: Mapping[str, Dynamics], sensors: Mapping[str, Sensor]) -> Layout:
    """The blocks that the processes advance, in order, then the static ones: those that a model
    reads and no process advances have one value for the whole pass.

    Raises ModelError when two processes advance one block, or none advances any.
    """
    advanced: dict[str, str] = {}
    for name, process in processes.items():
        for block in process.advances:
            if block.name in advanced:
                raise ModelError(
                    f"block {block.name!r} is advanced by both {advanced[block.name]!r}"
                    f" and {name!r}"
                )
            advanced[block.name] = name
    if not advanced:
        raise ModelError("no process advances any block, expected one or more")
    everything = [b for p in processes.values() for b in p.advances + p.reads]
    everything += [b for s in sensors.values() for b in s.reads]
    moving = [b for b in everything if b.name in advanced]
    return Layout(moving, [b for b in everything if b.name not in advanced])
