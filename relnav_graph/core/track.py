"""`Recording`, `Truth`, `Track`: the data of one pass, what really was, what an estimator gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.cautions import Caution
from relnav_graph.core.contracts import Derived
from relnav_graph.core.lent import Lent
from relnav_graph.core.measurement import SAME_TIME, InputSeries, Measurement, Stamps
from relnav_graph.core.models import derived_quantities, evaluate
from relnav_graph.core.shown import Shown, listed, span
from relnav_graph.core.state import Block, Layout
from relnav_graph.errors import ModelError
from relnav_graph.maths.instants import Instant

__all__ = [
    "Innovations",
    "Kind",
    "LeftOut",
    "Recording",
    "Statics",
    "Status",
    "Track",
    "Truth",
    "at_all_times",
    "estimates",
    "estimates_in_parts",
]

Kind = Literal["filtered", "fixed-lag", "smoothed"]
Status = Literal["ok", "degraded", "diverged"]


@dataclass(frozen=True, eq=False)
class Innovations:
    """What a filter did not foresee of one sensor, whitened: v = S^-1/2 (prediction minus
    measured) with S = H P H^T + R, so that a consistent filter has v ~ N(0, I), white in
    time.

    t (m,): epochs with observations that were used, s; v: their rows, one epoch after the
    other; offsets (m + 1,): where each epoch's begin in v.
    """

    t: Array
    v: Array
    offsets: Indices

    @property
    def rows(self) -> Indices:
        """Rows of each epoch (m,)."""
        return np.diff(self.offsets)

    @property
    def nis(self) -> Array:
        """Normalised innovation squared of each epoch (m,)."""
        total = np.concatenate(([0.0], np.cumsum(self.v**2)))
        return np.diff(total[self.offsets])


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Observations of one sensor that an estimate was made without, in order of time: t (m,), s,
    and ids (m,)."""

    t: Array
    ids: Indices


@dataclass(frozen=True, eq=False)
class Statics:
    """What each epoch of a track says of the blocks that have one value for the whole pass.

    x (N, size): stored vectors; P (N, dim, dim): their covariances; cross (N, n, dim): their
    covariances with the epoch's state, n of its tangent. Of a smoothed track all rows of x and P
    are the same.
    """

    layout: Layout
    x: Array
    P: Array
    cross: Array


@dataclass(frozen=True, eq=False, repr=False)
class Track(Shown):
    """Estimates over a pass. `to_xarray`, `to_dataframe` and `plot` give them with all that is
    derived of them (`relnav_graph.io.exports`).

    kind: what each epoch's estimate has seen: the past (filtered), a little of the future
    (fixed-lag), everything (smoothed). t (N,) s; x (N, size) stored vectors; P (N, dim,
    dim) covariances of the right perturbation, in the layout's order. status and message:
    whether to trust it; rejected: observations not used, by sensor, and left_out: which these are,
    of the sensors that have any; retired: names of the numbered blocks of which none is used;
    downweighted: those that
    a robust loss lets count for less; step_s: time of each
    online step, s; smoothed: for an online estimator, the track that it ends with;
    innovations: of a filter, by sensor, of a smoother its standardised residuals where they were
    asked for; truth: of the pass, where the estimator flew one of
    its own; controlled: the errors of control there, whose aim is zero; cautions: what leaves
    the status as it is, and must be known all the same; statics: of the blocks that do not move,
    where there are any; extra: value and covariance (d, d) of each variable that is of no block,
    by its GTSAM key, where a user has put some into the graph.
    """

    name: str
    kind: Kind
    layout: Layout
    t: Array
    x: Array
    P: Array
    status: Status = "ok"
    message: str = ""
    runtime_s: float = 0.0
    step_s: Array | None = None
    rejected: Mapping[str, int] = field(default_factory=dict)
    left_out: Mapping[str, LeftOut] = field(default_factory=dict)
    retired: tuple[str, ...] = ()
    downweighted: Mapping[str, int] = field(default_factory=dict)
    smoothed: Track | None = None
    innovations: Mapping[str, Innovations] = field(default_factory=dict)
    truth: Truth | None = None
    controlled: tuple[Block, ...] = ()
    cautions: tuple[Caution, ...] = ()
    statics: Statics | None = None
    extra: Mapping[int, tuple[Any, Array]] = field(default_factory=dict)

    to_xarray = Lent("to_xarray")
    to_dataframe = Lent("to_dataframe")
    plot = Lent("plot_track")

    def _shown(self) -> tuple[str, Mapping[str, str]]:
        rows = {"status": self.status + (f": {self.message}" if self.message else "")}
        for block in [b for b in self.blocks if b.number is None][:8] if len(self.t) else ():
            sigma = np.sqrt(np.trace(self.covariance(block.name)[-1])) * block.table_scale
            at_end = f"1-sigma {sigma:.3g} {block.table_unit} at the end"
            rows[block.name] = f"{block.symbol}, {at_end}"
        if len(self.blocks) > len(rows) - 1:
            rows["and"] = listed([b.name for b in self.blocks if b.name not in rows], 3)
        if self.rejected and any(self.rejected.values()):
            rows["not used"] = listed(f"{n}: {k}" for n, k in self.rejected.items())
        return f"Track {self.name!r} ({self.kind}): {span(self.t)}", rows

    def _doubts(self) -> tuple[Caution, ...]:
        return self.cautions

    @property
    def blocks(self) -> tuple[Block, ...]:
        """All blocks: those of the epochs, then the static ones."""
        return self.layout.blocks + (self.statics.layout.blocks if self.statics else ())

    @property
    def mapped(self) -> tuple[Block, ...]:
        """Numbered blocks of which observations were used, such as the points of a map."""
        statics = self.statics.layout if self.statics else ()
        return tuple(b for b in statics if b.number is not None and b.name not in self.retired)

    @property
    def states(self) -> Array:
        """Stored vectors (N, size) of all blocks, in the order of :attr:`blocks`."""
        return self.x if self.statics is None else np.hstack([self.x, self.statics.x])

    def at(self, epochs: slice | NDArray[np.bool_]) -> Track:
        """The same with the estimates of some epochs only."""
        s = self.statics
        if s is not None:
            s = replace(s, x=s.x[epochs], P=s.P[epochs], cross=s.cross[epochs])
        return replace(self, t=self.t[epochs], x=self.x[epochs], P=self.P[epochs], statics=s)

    def value(self, name: str) -> Array:
        """Values of one block, or of what derives from blocks (the relative attitude, say),
        (N, 3, 3) for an attitude, (N, dim) otherwise, SI. Raises ModelError on another name."""
        if self.statics is not None and name in self.statics.layout:
            return self.statics.layout.value(self.statics.x, name)
        if name in self.layout:
            return self.layout.value(self.x, name)
        return self._derived(name)[1]

    def covariance(self, *names: str) -> Array:
        """Joint covariance of blocks, and of what derives from them, in the order of their names,
        (N, dims, dims), SI. Raises ModelError on another name."""
        if len(names) == 1:
            return self._between(*names, *names)
        return np.block([[self._between(a, b) for b in names] for a in names])

    def _derived(self, name: str) -> tuple[Derived, Array, Array]:
        """A derived quantity, its values and its Jacobian (N, dim, dims read). Raises ModelError
        where the blocks give none of that name."""
        known = {q.block.name: q for q in derived_quantities(Layout(self.blocks))}
        if (quantity := known.get(name)) is None:
            there = [b.name for b in self.blocks]
            also = f", and what derives from them: {', '.join(known)}" if known else ""
            raise ModelError(f"no block {name!r}; {self.name!r} has {', '.join(there)}{also}")
        return quantity, *evaluate(quantity, [self.value(b.name) for b in quantity.reads])

    def _between(self, a: str, b: str) -> Array:
        """Covariance of two blocks or derived quantities, (N, dim of a, dim of b)."""
        s, moving = self.statics, self.layout
        own = [moving] if s is None else [moving, s.layout]
        if not any(a in layout for layout in own):
            quantity, _, J = self._derived(a)
            found: Array = J @ np.hstack([self._between(r.name, b) for r in quantity.reads])
            return found
        if not any(b in layout for layout in own):
            return self._between(b, a).transpose(0, 2, 1)
        if s is None or (a in moving and b in moving):
            return self.P[:, moving.tangent(a), moving.tangent(b)]
        if a in moving:
            return s.cross[:, moving.tangent(a), s.layout.tangent(b)]
        if b in moving:
            return self._between(b, a).transpose(0, 2, 1)
        return s.P[:, s.layout.tangent(a), s.layout.tangent(b)]


def estimates(layout: Layout, x: Array, P: Array) -> dict[str, Any]:
    """layout, x, P and statics of a track, from states x (N, size) and covariances P (N, n, n) of
    all blocks of a layout."""
    n = layout.moving.dim
    return estimates_in_parts(layout, x, P[:, :n, :n], P[:, n:, n:], P[:, :n, n:])


def estimates_in_parts(
    layout: Layout, x: Array, P: Array, P_s: Array, cross: Array
) -> dict[str, Any]:
    """`estimates` from covariances P (N, n, n) of the epochs, P_s (N, m, m) of the static blocks,
    and cross (N, n, m) of both."""
    size = layout.moving.size
    statics = Statics(layout.statics, x[:, size:], P_s, cross) if layout.statics else None
    return {"layout": layout.moving, "x": x[:, :size], "P": P, "statics": statics}


def at_all_times(value: Array, count: int) -> Array:
    """One value, (3, 3) or (dim,), at so many times: (count, 3, 3) or (count, dim)."""
    return np.tile(value, (count, *[1] * value.ndim))


@dataclass(frozen=True, eq=False, repr=False)
class Truth(Shown):
    """True values of blocks (and of derived quantities) at times t (N,).

    values: by name, (N, 3, 3) or (N, dim), SI, in the block's frame, NaN where not known;
    source: where it is from. A truth may know fewer blocks than an estimator has.

    sigmas: of a truth that was measured itself, by name, (N, dim), SI: 1-sigma about each axis of
    its tangent, of an attitude the right perturbation, in the body frame; independent from axis to
    axis. Of what is not in it the truth is exact.
    """

    t: Array
    values: Mapping[str, Array]
    source: str = ""
    sigmas: Mapping[str, Array] = field(default_factory=dict)

    def _shown(self) -> tuple[str, Mapping[str, str]]:
        known = {"values": listed(self.values), "source": self.source or "not said"}
        return f"Truth: {span(self.t)}", known

    def at(self, times: Array) -> tuple[Indices, NDArray[np.bool_]]:
        """Rows (M,) of the truth that are nearest to `times` (M,), s; and a mask (M,): which of
        them are of that time, within `SAME_TIME`."""
        if not len(self.t):
            return np.zeros(len(times), np.int64), np.zeros(len(times), np.bool_)
        rows = np.clip(np.searchsorted(self.t, times), 0, len(self.t) - 1)
        before = np.maximum(rows - 1, 0)
        closer = np.abs(self.t[before] - times) <= np.abs(self.t[rows] - times)
        rows = np.where(closer, before, rows)
        return rows, np.abs(self.t[rows] - times) <= SAME_TIME

    def at_least_at(self, times: Array) -> Truth:
        """The same with rows at all of the `times` (M,), s, that it lacks: not known, NaN."""
        if not len(times) or not len(self.t):
            return self
        lacking = np.unique(times[~self.at(times)[1]])
        if not len(lacking):
            return self
        t = np.concatenate([self.t, lacking])
        order = np.argsort(t, kind="stable")

        def filled(value: Array) -> Array:
            unknown = np.full((len(lacking), *value.shape[1:]), np.nan)
            return np.ascontiguousarray(np.concatenate([value, unknown])[order])

        values = {name: filled(value) for name, value in self.values.items()}
        sigmas = {n: filled(s) if len(s) == len(self.t) else s for n, s in self.sigmas.items()}
        return replace(self, t=t[order], values=values, sigmas=sigmas)


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Shown):
    """Measurements, inputs and, where known, truth.

    times: epochs to estimate at, s (N,); every measurement falls on one of them. Inertial axes are
    those of GCRF, see `epoch` for when t = 0 is.
    settings: values that the data bring for the scenario (camera constants, points), as
    nested tables; a value written in the scenario wins over them.
    """

    times: Array
    measurements: tuple[Measurement, ...]
    inputs: Mapping[str, InputSeries] = field(default_factory=dict)
    truth: Truth | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)

    def _shown(self) -> tuple[str, Mapping[str, str]]:
        seen: dict[str, int] = {}
        for m in self.measurements:
            seen[m.sensor] = seen.get(m.sensor, 0) + len(m.ids)
        inputs = (f"{name}: {len(s.t_start)} samples" for name, s in self.inputs.items())
        rows = {
            "measurements": listed(f"{name}: {count}" for name, count in seen.items()),
            "inputs": listed(inputs),
            "truth": "none" if self.truth is None else listed(self.truth.values),
        }
        return f"Recording: {span(self.times)}", rows

    @property
    def misassociated(self) -> frozenset[tuple[str, float, int]]:
        """Sensor, time (s) and id of the simulated observations that are another point's."""
        return frozenset((m.sensor, m.t, i) for m in self.measurements for i in m.wrong)

    @property
    def epoch(self) -> Instant | None:
        """The absolute time of a stamp of 0, where the data know it. Raises InputError on settings
        that say something else there."""
        time = self.settings.get("time")
        text = time.get("epoch") if isinstance(time, Mapping) else None
        return None if text is None else Instant.parse(str(text))

    def shifted(self, by: float) -> Recording:
        """The same with `by`, s, added to every time."""
        if not by:
            return self

        inputs = {name: s.later(by) for name, s in self.inputs.items()}
        truth = self.truth and replace(self.truth, t=self.truth.t + by)
        measurements = tuple(m.later(by, by) for m in self.measurements)
        return replace(
            self, times=self.times + by, measurements=measurements, inputs=inputs, truth=truth
        )

    def between(self, begin: float, end: float) -> Recording:
        """What is from `begin` until before `end`, s, at the times that it has. Inputs stay whole:
        what is beside the epochs is of no interval."""
        truth = self.truth
        if truth is not None:
            rows, n = (truth.t >= begin) & (truth.t < end), len(truth.t)
            values = {name: value[rows] for name, value in truth.values.items()}
            sigmas = {k: s[rows] if len(s) == n else s for k, s in truth.sigmas.items()}
            truth = replace(truth, t=truth.t[rows], values=values, sigmas=sigmas)
        seen = tuple(m for m in self.measurements if begin <= m.t < end)
        times = self.times[(self.times >= begin) & (self.times < end)]
        return replace(self, times=times, measurements=seen, truth=truth)

    def with_lags(self, stamps: Mapping[str, Stamps]) -> Recording:
        """The same with all stamps so late; its epochs are those without lags. stamps: of inputs
        and sensors, by name."""
        lags = {name: one.lag for name, one in stamps.items()}
        inputs = {name: s.later(lags.get(name, 0.0)) for name, s in self.inputs.items()}
        ms = tuple(m.later(lags[m.sensor]) if m.sensor in lags else m for m in self.measurements)
        return replace(self, measurements=ms, inputs=inputs)

    def without_lags(self, stamps: Mapping[str, Stamps]) -> Recording:
        """The same with the stamps of when it was so, for stamps that are so late; arrivals are as
        they were. stamps: of inputs and sensors, by name. Measurements that are moved may fall
        between the epochs, and then make epochs of their own, whose truth is not known."""
        lags = {name: Stamps(-one.lag) for name, one in stamps.items() if one.lag}
        if not lags:
            return self
        early = self.with_lags(lags)
        moved = np.array([m.t for m in early.measurements if m.sensor in lags])
        truth = self.truth and self.truth.at_least_at(moved)
        return replace(early, times=np.sort(np.concatenate([self.times, moved])), truth=truth)
