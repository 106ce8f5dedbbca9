"""What sensors and inputs give: measurements, and known inputs over intervals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.errors import InputError

__all__ = [
    "InputSeries",
    "Measurement",
    "edge_tolerance",
]


@dataclass(frozen=True, eq=False)
class Measurement:
    """What one sensor saw at one time: k observations of the same kind.

    sensor: name in the problem; t: time of validity, s; z: (k, nz) measured values, in the
    units that the sensor's `columns` name and the frame that the sensor says; ids: (k,) which
    beacon or point each row belongs to; t_arrival: when it became known, s.
    Raises InputError on a value that is not finite or on sizes that do not match.
    """

    sensor: str
    t: float
    z: Array
    ids: Indices
    t_arrival: float | None = None

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
        object.__setattr__(self, "z", np.ascontiguousarray(z, dtype=np.float64))
        object.__setattr__(self, "ids", ids)


#: Times closer than this are the same, s: above the rounding of stamps of 1e9 s.
SAME_TIME = 1e-6


def edge_tolerance(t0: float, t1: float) -> float:
    """How far the edge of a sample may be from t0 or t1, s, and still be taken for it: less than
    the interval [t0, t1], however short."""
    return min(SAME_TIME, 0.25 * (t1 - t0))


@dataclass(frozen=True, eq=False)
class InputSeries:
    """A known input (gyro, accelerometer): its means over n intervals.

    t_start, t_end (n,): where each interval begins and ends, s; values (n, channels): the mean
    over it, SI, in the frame that the process says (for a gyro, the axes c of the chaser).

    Raises InputError on values that are not finite and on intervals that overlap or run
    backwards.
    """

    name: str
    t_start: Array
    t_end: Array
    values: Array

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

        Raises InputError where there is no sample.
        """
        tolerance = edge_tolerance(t0, t1)
        i = int(np.searchsorted(self.t_end, t0 + tolerance, side="right"))
        j = int(np.searchsorted(self.t_start, t1 - tolerance, side="left"))
        starts, ends = self.t_start[i:j], self.t_end[i:j]
        if j <= i or starts[0] > t0 + tolerance or ends[-1] < t1 - tolerance:
            raise InputError(f"input {self.name!r} does not cover {t0} s to {t1} s")
        gaps = starts[1:] - ends[:-1] > tolerance
        if gaps.any():
            t = ends[:-1][gaps][0]
            raise InputError(f"input {self.name!r} has a gap after {t} s")
        return np.concatenate(([t0], ends[:-1], [t1])), self.values[i:j]
