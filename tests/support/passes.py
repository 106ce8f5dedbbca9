"""Passes that several test files use."""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from relnav_factors.dynamics.white_noise_acceleration import WhiteNoiseAcceleration
from toy_model import DriftingRange, PositionFix, ThermalDrift

from relnav_graph.arrays import Array
from relnav_graph.cli.main import main
from relnav_graph.core.epochs import make_epochs
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Track, Truth
from relnav_graph.runs.closed_loop import Flown

ESTIMATORS = ("ekf", "iekf", "ukf", "iukf", "ekf_batch_start", "rts", "batch", "incremental")
EXPERIMENTS = Path(__file__).parents[2] / "experiments"
ZHANG = EXPERIMENTS / "zhang2015.toml"
ONE_ID = np.zeros(1, dtype=np.int64)

# --- position fixes and drifting ranges, 30 epochs one second apart ------------------------

PROCESSES: dict[str, Any] = {
    "motion": WhiteNoiseAcceleration(acceleration_density=0.002),
    "electronics": ThermalDrift(time_constant=60.0, density=0.002),
}
FIX = PositionFix(covariance=0.01 * np.eye(3))
RANGER = DriftingRange(points=2 * np.eye(3), sigma=0.005)
SENSORS: dict[str, Any] = {"fix": FIX, "ranger": RANGER}
PRIOR = Prior(
    np.array([9.0, -6.0, 4.0, 0.0, 0.0, 0.0, 0.0]), np.diag([1.0] * 3 + [0.01] * 3 + [0.04])
)


def toy_measurements(count: int = 30) -> list[Measurement]:
    """Of a steady motion and a constant drift."""
    rng = np.random.default_rng(0)
    out = []
    for k in range(count):
        r = np.array([9.3, -5.5, 4.1]) + 0.05 * k * np.array([1, -1, 0])
        z = r + 0.1 * rng.normal(size=3)
        out.append(Measurement("fix", float(k), z[None], ONE_ID))
        ids = RANGER.observables()
        ranges = RANGER.predict(ids, r, np.array([0.1])) + 0.005 * rng.normal(size=(3, 1))
        out.append(Measurement("ranger", float(k), ranges, ids))
    return out


def toy_problem(measurements: list[Measurement], **changes: Any) -> Problem:
    epochs = make_epochs(PROCESSES, measurements, {}, np.arange(30.0))
    return replace(Problem(PROCESSES, SENSORS, PRIOR, epochs), **changes)


def spoilt_toy() -> Problem:
    """The toy with fixes that are far out, one in six."""
    out = []
    for m in toy_measurements():
        wrong = m.sensor == "fix" and int(m.t) % 6 == 3
        out.append(replace(m, z=m.z + np.array([2.0, -3.0, 1.0])) if wrong else m)
    return toy_problem(out)


# --- fixes of a linear motion, at irregular times -------------------------------------------

#: Fixes are correlated between axes, so that whitening matters.
R_FIX = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, -0.02], [0.0, -0.02, 0.05]])
LINEAR_PRIOR = Prior(np.array([10.0, -5.0, 3.0, 0.0, 0.1, 0.0]), np.diag([4.0] * 3 + [0.01] * 3))


def linear_problem(density: float, seed: int = 0, count: int = 30) -> Problem:
    """Fixes at irregular times, with two at one epoch and some epochs with none."""
    rng = np.random.default_rng(seed)
    times = np.concatenate(([0.0], np.cumsum(rng.uniform(0.5, 3.0, count - 1))))
    processes: dict[str, Any] = {"motion": WhiteNoiseAcceleration(acceleration_density=density)}
    sensors: dict[str, Any] = {"fix": PositionFix(covariance=R_FIX)}
    r, v = np.array([11.0, -4.0, 2.0]), np.array([0.05, 0.0, -0.05])
    measurements = []
    for k, t in enumerate(times):
        fixes = 0 if k % 5 in (2, 3) else 2 if k % 7 == 4 else 1
        if fixes:
            z = r + t * v + rng.multivariate_normal(np.zeros(3), R_FIX, fixes)
            measurements.append(Measurement("fix", float(t), z, np.arange(fixes)))
    epochs = make_epochs(processes, measurements, {}, times)
    return Problem(processes, sensors, LINEAR_PRIOR, epochs)


# --- tracks against each other and against truth -------------------------------------------


def rows_of(track: Track) -> list[Track]:
    """A track, and the smoothed one that an online estimator ends with."""
    return [track] if track.smoothed is None else [track, track.smoothed]


def sigmas(P: Array) -> Array:
    """Standard deviations (N, dim) of covariances (N, dim, dim)."""
    return np.asarray(np.sqrt(np.einsum("kii->ki", P)))


def stored(layout: Layout, truth: Truth) -> Array:
    """Truth as stored vectors (N, size)."""
    count = len(truth.t)
    return np.array(
        [layout.pack({b.name: truth.values[b.name][k] for b in layout}) for k in range(count)]
    )


def differences(layout: Layout, a: Array, b: Array) -> Array:
    """Tangent vectors (N, dim) from the trajectory a to b (N, size)."""
    return np.array([layout.local(p, q) for p, q in zip(a, b, strict=True)])


# --- the command line ---------------------------------------------------------------------


def recorded(name: str) -> Path:
    """The folder of a recorded data set; skips where nobody says where the data are."""
    root = os.environ.get("RELNAV_DATA")
    if not root:
        pytest.skip("RELNAV_DATA does not name the folder with the recorded data")
    folder = Path(root) / name
    assert folder.is_dir(), f"{folder}: no such folder, but RELNAV_DATA is set"
    return folder


def relnav(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of a command."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as stopped:
        main([str(a) for a in arguments])
    assert isinstance(stopped.value.code, int)
    out, err = capsys.readouterr()
    return stopped.value.code, out, err


def truth_of(flown: Flown) -> Truth:
    """Of a pass that was flown."""
    assert flown.track.truth is not None
    return flown.track.truth


def changed_tables(tables: Mapping[str, Any], *path: str, value: Any = None) -> dict[str, Any]:
    """The tables of a scenario with one of them, or a value there, changed; None: taken out."""
    out: dict[str, Any] = copy.deepcopy(dict(tables))
    at = out
    for key in path[:-1]:
        at = at.setdefault(key, {})
    at.pop(path[-1], None)
    if value is not None:
        at[path[-1]] = value
    return out


def beyond_digits() -> Problem:
    """A prior of 10 km, fixes of 0.1 mm: no covariance has digits for both."""
    processes: dict[str, Any] = {"motion": WhiteNoiseAcceleration(acceleration_density=1e-6)}
    sensors: dict[str, Any] = {"fix": PositionFix(covariance=1e-8 * np.eye(3))}
    fixes = [Measurement("fix", float(t), np.zeros((1, 3)), ONE_ID) for t in range(6)]
    prior = Prior(np.zeros(6), 1e8 * np.eye(6))
    return Problem(processes, sensors, prior, make_epochs(processes, fixes, {}))
