"""What sensors would have measured of a truth, and when."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.contracts import ScattersRaw, Sensor
from relnav_graph.core.measurement import SAME_TIME, Measurement
from relnav_graph.core.track import Truth
from relnav_graph.errors import GeometryError, InputError

__all__ = [
    "check_known",
    "stream",
]
Law = Literal["gaussian", "random_direction"]


def stream(seed: int, run: int, name: str) -> np.random.Generator:
    """The generator of one stream: its own for each name, so that adding a sensor leaves
    the others as they were; the same however many workers share the runs."""
    key = (run, zlib.crc32(name.encode()))
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


@dataclass(frozen=True)
class Timing:
    """How a simulated sensor measures: every `period` s (None: at each epoch) from `begin`
    until before `end`, s, with a fraction of outliers, off by `outlier_size` sigmas.

    law: of the noise, "gaussian", or "random_direction": of a normal length along a
    direction drawn at random, of the same covariance. most: observations of one time, drawn from
    all that there are; None: all. association_errors: fraction of the observations that get the
    values of another one of the same time.
    """

    period: float | None = None
    outlier_fraction: float = 0.0
    outlier_size: float = 0.0
    begin: float = -np.inf
    end: float = np.inf
    law: Law = "gaussian"
    most: int | None = None
    association_errors: float = 0.0

    def fires(self, t: float, t0: float) -> bool:
        if not self.begin - SAME_TIME < t < self.end - SAME_TIME:
            return False
        if self.period is None:
            return True
        cycles = (t - t0) / self.period
        return abs(cycles - round(cycles)) < 1e-6


def _seen(sensor: Sensor, ids: Indices, x: Sequence[Array]) -> tuple[Indices, Array]:
    """Those of the ids (k,) that can be seen, and their z (m, nz) without noise."""
    try:
        return ids, sensor.predict(ids, *x)
    except GeometryError:
        if len(ids) == 1:
            return ids[:0], np.zeros((0, len(sensor.columns)))
    found = [_seen(sensor, ids[i : i + 1], x) for i in range(len(ids))]
    return np.concatenate([i for i, _ in found]), np.concatenate([z for _, z in found])


def _unit_noise(law: Law, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """Noise of unit covariance; shape: (k, rows)."""
    noise = rng.standard_normal(shape)
    if law == "random_direction":
        noise /= np.linalg.norm(noise, axis=1, keepdims=True)
        noise *= np.sqrt(shape[1]) * rng.standard_normal((shape[0], 1))
    return noise


def _with_outliers(e: Array, timing: Timing, rng: np.random.Generator) -> Array:
    """Unit noise e (k, rows) with outliers added, each in a direction of its own."""
    direction = rng.standard_normal(e.shape)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    struck = rng.random(len(e)) < timing.outlier_fraction
    out: Array = e + timing.outlier_size * struck[:, None] * direction
    return out


def _confused(m: Measurement, fraction: float, rng: np.random.Generator) -> Measurement:
    """A measurement with a fraction of its rows replaced by those of others."""
    count = len(m.ids)
    struck = rng.random(count) < fraction
    other = (np.arange(count) + rng.integers(1, max(count, 2), count)) % count
    if count < 2 or not struck.any():
        return m
    z = np.where(struck[:, None], m.z[other], m.z)
    return replace(m, z=z, wrong=tuple(m.ids[struck].tolist()))


def check_known(name: str, sensor: Sensor, values: Mapping[str, Array]) -> None:
    """Raise InputError when a truth with these values lacks a block that a sensor reads.

    values: by block name, (N, 3, 3) or (N, dim), SI; only the names are looked at.
    """
    missing = [b.name for b in sensor.reads if b.name not in values]
    if missing:
        raise InputError(
            f"sensor {name!r} cannot be simulated: the truth has no {missing}; what is static is"
            f" given as truth.statics.{missing[0]}, else the sensor brings it (own_truth), or the"
            " process that advances it draws it (wandering)"
        )


def measure_once(
    name: str,
    sensor: Sensor,
    timing: Timing,
    t: float,
    x: Sequence[Array],
    rng: np.random.Generator,
    outliers: np.random.Generator | None = None,
) -> Measurement | None:
    """What a sensor measures at time t, s; None when it sees nothing. See `measure`.

    x: true value of each block that it reads, (3, 3) or (dim,), SI, in the block's frame.
    """
    now = sensor.at(t)
    seen, rows = _seen(now, now.in_view(now.observables(), *x), x)
    if not len(seen):
        return None
    if timing.most is not None and len(seen) > timing.most:
        kept = np.sort(rng.choice(len(seen), timing.most, replace=False))
        seen, rows = seen[kept], rows[kept]
    clean = Measurement(name, t, rows, seen)
    raw = isinstance(sensor, ScattersRaw)
    unit = _unit_noise(timing.law, rows.shape if raw else (len(rows), sensor.rows), rng)
    if outliers is not None and timing.outlier_fraction > 0:
        unit = _with_outliers(unit, timing, outliers)
    if isinstance(sensor, ScattersRaw):
        z = sensor.scattered(clean.z, unit)
    else:
        e = np.einsum("kij,kj->ki", np.linalg.cholesky(sensor.noise(clean)), unit)
        z = sensor.perturb(clean.z, e)
    found = Measurement(name, t, z, clean.ids)
    if outliers is not None and timing.association_errors > 0:
        found = _confused(found, timing.association_errors, outliers)
    return found


def measure(
    name: str,
    sensor: Sensor,
    timing: Timing,
    truth: Truth,
    rng: np.random.Generator,
    outliers: np.random.Generator | None = None,
) -> list[Measurement]:
    """What a sensor would have measured: the model at the truth, with its noise.

    outliers: the stream that these, and wrong associations, are drawn from: all other noise is as
    without them.

    An observation that is impossible at the truth, such as a point behind the camera, is
    one that is not seen. Raises InputError when the truth lacks a block.
    """
    check_known(name, sensor, truth.values)
    out = []
    for k, t in enumerate(truth.t):
        if not timing.fires(float(t), float(truth.t[0])):
            continue
        x = [np.ascontiguousarray(truth.values[b.name][k]) for b in sensor.reads]
        found = measure_once(name, sensor, timing, float(t), x, rng, outliers)
        out += [] if found is None else [found]
    return out


def measure_all(
    sensors: Mapping[str, Sensor],
    timings: Mapping[str, Timing],
    truth: Truth,
    seed: int,
    run: int = 0,
) -> tuple[Measurement, ...]:
    """What all sensors would have measured, each with a stream of its own; see `measure`."""
    out: list[Measurement] = []
    for name, sensor in sensors.items():
        rng = stream(seed, run, f"sensor {name}")
        outliers = stream(seed, run, f"outliers {name}")
        out += measure(name, sensor, timings.get(name, Timing()), truth, rng, outliers)
    return tuple(out)
