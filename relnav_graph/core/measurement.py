"""What sensors and inputs give: measurements, and known inputs over intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relnav_graph.arrays import Array, Indices
from relnav_graph.errors import InputError

__all__ = [
    "LATEST",
    "QUATERNION",
    "SAME_TIME",
    "Bridge",
    "InputSeries",
    "Measurement",
    "Stamps",
    "edge_tolerance",
]

#: Columns of a quaternion, of sensors and of tables: Hamilton, scalar first.
QUATERNION = ("q_w", "q_x", "q_y", "q_z")


@dataclass(frozen=True, eq=False)
class Measurement:
    """What one sensor saw at one time: k observations of the same kind.

    sensor: name in the problem; t: time of validity, s; z: (k, nz) measured values, in the
    units that the sensor's `columns` name and the frame that the sensor says; ids: (k,) which
    beacon or point each row belongs to; t_arrival: when it became known, s. wrong: of a simulated
    one, those ids whose row is another point's; for scores alone, estimators do not look at it.
    covariance: (k, rows, rows) of the residuals, that came with the data, in place of those that
    the sensor says; None: none did.
    Raises InputError on a value that is not finite or on sizes that do not match.
    """

    sensor: str
    t: float
    z: Array
    ids: Indices
    t_arrival: float | None = None
    wrong: tuple[int, ...] = ()
    covariance: Array | None = None

    def __post_init__(self) -> None:
        where = f"sensor {self.sensor!r} at t = {self.t} s"
        z = np.array(self.z)
        if z.dtype.kind not in "fiu" or z.ndim != 2 or np.ma.isMaskedArray(self.z):
            raise InputError(f"{where}: z is {z.dtype} {z.shape}, expected real numbers (k, nz)")
        ids = np.array(self.ids)
        if ids.dtype.kind not in "iu":
            raise InputError(f"{where}: found ids {ids}, expected whole numbers")
        ids = ids.astype(np.int64)
        if ids.shape != (len(z),):
            raise InputError(f"{where}: {len(z)} rows of z, but ids of shape {ids.shape}")
        if not np.isfinite([self.t, self.t if self.t_arrival is None else self.t_arrival]).all():
            raise InputError(f"{where}: the time is not finite (arrival: {self.t_arrival})")
        if not np.isfinite(z).all():
            bad = int(ids[np.nonzero(~np.isfinite(z).all(axis=1))[0][0]])
            raise InputError(f"{where}: z of id {bad} is not finite: {z[ids == bad][0]}")
        if self.covariance is not None:
            R = np.ascontiguousarray(self.covariance, dtype=np.float64)
            if R.ndim != 3 or len(R) != len(z) or not np.isfinite(R).all():
                raise InputError(f"{where}: R is {R.shape}, expected finite ({len(z)}, rows, rows)")
            object.__setattr__(self, "covariance", R)
        object.__setattr__(self, "z", np.ascontiguousarray(z, dtype=np.float64))
        object.__setattr__(self, "ids", ids)

    def only(self, kept: NDArray[Any] | Sequence[int]) -> Measurement:
        """Some of the observations: by a mask (k,) or by their places."""
        R = None if self.covariance is None else self.covariance[kept]
        return replace(self, z=self.z[kept], ids=self.ids[kept], covariance=R)

    def later(self, by: float, arrives: float = 0.0) -> Measurement:
        """The same with `by`, s, added to its time, and `arrives` to when it became known."""
        arrival = None if self.t_arrival is None else self.t_arrival + arrives
        return replace(self, t=self.t + by, t_arrival=arrival)


#: Times closer than this are the same, s: above the rounding of stamps of 1e9 s.
SAME_TIME = 1e-6
#: Later times than that, s, lose nanoseconds as float64.
LATEST = 2.0**53 / 1e9


def edge_tolerance(t0: float, t1: float) -> float:
    """How far the edge of a sample may be from t0 or t1, s, and still be taken for it: less than
    the interval [t0, t1], however short."""
    return min(SAME_TIME, 0.25 * (t1 - t0))


@dataclass(frozen=True, eq=False)
class Bridge:
    """How gaps in an input are bridged: the last mean goes on, and is less and less known.

    longest: s, up to which length; spread: SI, one sigma, for each channel or one for all: of the
    mean over a gap of length L the integral has the variance (spread L)^2 then. Of a part of a
    gap, from a to b seconds from where the held mean was known, it has spread^2 (b^2 - a^2), so
    that the parts of a gap add up to that of the whole.
    """

    longest: float
    spread: Array


@dataclass(frozen=True)
class Stamps:
    """How late the stamps of an input or a sensor are, lag, s; and, of an input, one sigma of how
    long an interval between epochs is, jitter, s: see `InputSeries.spreads`."""

    lag: float = 0.0
    jitter: float = 0.0


@dataclass(frozen=True, eq=False)
class InputSeries:
    """A known input (gyro, accelerometer): its means over n intervals.

    t_start, t_end (n,): where each interval begins and ends, s; values (n, channels): the mean
    over it, SI, in the frame that the process says (for a gyro, the axes c of the chaser).
    bridge: how gaps between the intervals, before and after them are bridged, None for not at
    all; source, lines (n,): the file, and the line of each interval, for messages; jitter: see
    `Stamps`, s.

    Raises InputError on values that are not finite and on intervals that overlap or run
    backwards.
    """

    name: str
    t_start: Array
    t_end: Array
    values: Array
    bridge: Bridge | None = None
    source: str = ""
    lines: Indices | None = None
    jitter: float = 0.0

    def __post_init__(self) -> None:
        for key in ("t_start", "t_end", "values"):
            array = np.array(getattr(self, key), dtype=np.float64, order="C")
            if not np.isfinite(array).all():
                raise InputError(f"input {self.name!r}: {key} holds a value that is not finite")
            object.__setattr__(self, key, array)
        n = len(self.t_start)
        if self.t_end.shape != (n,) or self.values.ndim != 2 or len(self.values) != n:
            raise InputError(f"input {self.name!r}: t_start, t_end and values differ in length")
        backwards = self.t_end <= self.t_start
        backwards[1:] |= self.t_start[1:] < self.t_end[:-1] - SAME_TIME
        if backwards.any():
            t = self.t_start[np.nonzero(backwards)[0][0]]
            raise InputError(f"input {self.name!r}: intervals overlap or run backwards at {t} s")

    def over(self, t0: float, t1: float) -> tuple[Array, Array]:
        """Edges (k + 1,), s, and values (k, channels) of the samples that cover [t0, t1].

        In a gap, the value that is held there. Raises InputError on a gap that is not bridged.
        """
        gaps = self.gaps(t0, t1)
        first, last = self._touching(t0, t1)
        if not gaps:
            ends = self.t_end[first : last - 1]
            return np.concatenate(([t0], ends, [t1])), self.values[first:last]
        edges, values = [t0], list[Array]()
        rest = [
            (a, b, max(int(np.searchsorted(self.t_start, b - SAME_TIME)) - 1, 0)) for a, b in gaps
        ]
        own = [(self.t_start[i], min(self.t_end[i], t1), i) for i in range(first, last)]
        for _, end, i in sorted(rest + own):
            edges.append(end)
            values.append(self.values[i])
        edges[-1] = t1
        return np.array(edges), np.array(values)

    def _touching(self, t0: float, t1: float) -> tuple[int, int]:
        """Which samples, first to last - 1, tell of [t0, t1], s."""
        tolerance = edge_tolerance(t0, t1)
        first = int(np.searchsorted(self.t_end, t0 + tolerance, side="right"))
        last = int(np.searchsorted(self.t_start, t1 - tolerance, side="left"))
        if last <= first and len(self.t_end) and self._gap(first, t0, t1)[1] <= SAME_TIME:
            first = min(first, len(self.t_end) - 1)
            last = first + 1
        return first, max(first, last)

    def _gap(self, i: int, t0: float, t1: float) -> tuple[float, float]:
        """Start, s, and length, s, of the gap before sample i, as far as [t0, t1] tells."""
        start = float(self.t_end[i - 1]) if i else t0
        return start, (float(self.t_start[i]) if i < len(self.t_start) else t1) - start

    def gaps(self, t0: float, t1: float) -> list[tuple[float, float]]:
        """Where no sample tells of [t0, t1], s: start and end of each part, s.

        Raises InputError on one that is not bridged, longer than it may be, or without any
        sample beside it.
        """
        first, last = self._touching(t0, t1)
        ends = np.concatenate(([t0], np.minimum(self.t_end[first:last], t1)))
        starts = np.concatenate((np.maximum(self.t_start[first:last], t0), [t1]))
        found = []
        for k in np.nonzero(starts - ends > (SAME_TIME if last > first else 0.0))[0].tolist():
            self._check_gap(first + k, t0, t1)
            found.append((float(ends[k]), float(starts[k])))
        return found

    def _check_gap(self, i: int, t0: float, t1: float) -> None:
        """Raise InputError unless the gap before sample i is bridged."""
        start, length = self._gap(i, t0, t1)
        n = len(self.t_start)
        if n and self.bridge is not None and length <= self.bridge.longest + SAME_TIME:
            return
        where = f"input {self.name!r}"
        if self.lines is not None and n:
            where = f"{self.source}, line {self.lines[min(max(i - 1, 0), n - 1)]}: {where}"
        if not n or self.bridge is None:
            inner = 0 < i < n
            what = f"has a gap after {start} s" if inner else f"does not cover {t0} s to {t1} s"
            raise InputError(f"{where} {what}")
        raise InputError(
            f"{where} has a gap of {length:.6g} s, from {start} s to {start + length} s; expected"
            f" at most {self.bridge.longest:g} s ([gaps] {self.name}.bridge)"
        )

    def later(self, by: float) -> InputSeries:
        """The same with `by`, s, added to every time."""
        return replace(self, t_start=self.t_start + by, t_end=self.t_end + by) if by else self

    def spreads(self, edges: Array) -> Array:
        """One sigma, SI, (k, channels), of the means over k parts that adjoin at edges (k + 1,), s.

        Zero where samples tell and stamps do not jitter; see `Bridge`, `Stamps`.
        """
        out = self._held(edges)
        if not self.jitter or not len(self.t_end):
            return out
        length, parts = edges[-1] - edges[0], np.diff(edges)[:, None]
        middle = 0.5 * (self.t_start + self.t_end)
        ends = [np.interp(edges[[0, -1]], middle, v) for v in self.values.T]
        last = len(middle) - 1
        own = self.values[np.minimum(np.searchsorted(self.t_end, edges[:-1], "right"), last)]
        mean, change = (parts * own).sum(axis=0) / length, np.diff(ends).T
        # So that what the parts add up to has the variance jitter^2 (mean^2 + change^2).
        variance = self.jitter**2 * (mean**2 + change**2) / (length * parts)
        spread: Array = np.sqrt(out**2 + variance)
        return spread

    def _held(self, edges: Array) -> Array:
        """What bridges add to `spreads`."""
        channels = self.values.shape[1]
        out = np.zeros((len(edges) - 1, channels))
        if self.bridge is None or not len(self.t_end):
            return out
        middle, last = 0.5 * (edges[1:] + edges[:-1]), len(self.t_end) - 1
        after = np.searchsorted(self.t_end, middle, side="right")
        known = np.where(after > 0, self.t_end[np.maximum(after - 1, 0)], self.t_start[0])
        until = np.where(after <= last, self.t_start[np.minimum(after, last)], np.inf)
        held = (middle < until) & (np.where(after > 0, until - known, np.inf) > SAME_TIME)
        far = np.abs(edges[:-1] - known) + np.abs(edges[1:] - known)
        out[held] = np.sqrt(far / np.diff(edges))[held, None] * self.bridge.spread
        return out
