"""Models that break their contract, run by themselves, by an estimator and by iSAM2.

A program of `test_broken_models.py`: what it provokes may crash. For each argument it says
what became of each model, one line each, and "alive" in the end.
"""

from __future__ import annotations

import sys
from typing import Any

import gtsam
import numpy as np
from relnav_factors.dynamics.white_noise_acceleration import WhiteNoiseAcceleration
from toy_model import PositionFix, ThermalDrift

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.epochs import Epoch, make_epochs
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.errors import ModelError, RelnavError
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.online.driver import online
from relnav_graph.linear import gtsam_factors


@jit
def unfilled(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    for i in range(3):
        r[i] = x[i] - z[i]
        H[i, i] = 1.0
    return 0


@jit
def outside(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    H[:, :] = 0.0
    for i in range(7):
        r[i] = 0.0
    return 0


@jit
def outside_jacobian(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    r[:] = 0.0
    H[:, :] = 0.0
    H[3, 0] = 1.0
    return 0


@jit
def before(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    r[:] = 0.0
    H[:, :] = 0.0
    r[-4] = 1.0
    return 0


@jit
def fewer(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    for i in range(2):
        r[i] = 0.0
        for j in range(3):
            H[i, j] = 0.0
    return 0


@jit
def not_finite(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    r[:] = 0.0
    H[:, :] = 0.0
    H[1, 1] = np.inf
    return 0


def nothing(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> None:
    r[:] = 0.0
    H[:, :] = 0.0


def arguments(p: Array, q: Array, z: Array, x: Array, r: Array) -> int:
    return 0


@jit
def process_unfilled(
    p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array
) -> int:
    x_next[0] = x[0]
    F[0, 0] = 1.0
    return 0


@jit
def process_outside(
    p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array
) -> int:
    x_next[0] = x[0]
    F[0, 0] = 1.0
    Q[0, 0] = 1.0
    x_next[5] = 1.0
    return 0


def sensor_with(kernel: Any, **members: Any) -> Any:
    cls = type("Broken", (PositionFix,), {"kernel": staticmethod(kernel), **members})
    return cls(covariance=np.eye(3))


SENSORS: dict[str, Any] = {
    "unfilled": lambda: sensor_with(unfilled),
    "outside": lambda: sensor_with(outside),
    "outside_jacobian": lambda: sensor_with(outside_jacobian),
    "before": lambda: sensor_with(before),
    "fewer": lambda: sensor_with(fewer),
    "not_finite": lambda: sensor_with(not_finite),
    "nothing": lambda: sensor_with(jit(nothing)),
    "arguments": lambda: sensor_with(jit(arguments)),
    "not_compiled": lambda: sensor_with(nothing),
    "more_rows": lambda: sensor_with(PositionFix.kernel, rows=4),
    "fewer_rows": lambda: sensor_with(PositionFix.kernel, rows=2),
    "fewer_rows_noise": lambda: sensor_with(
        PositionFix.kernel, rows=2, noise=lambda self, m: np.tile(np.eye(2), (len(m.z), 1, 1))
    ),
}
PROCESSES: dict[str, Any] = {
    "process_unfilled": process_unfilled,
    "process_outside": process_outside,
}

MEASUREMENT = Measurement("fix", 0.0, np.zeros((1, 3)), np.zeros(1, dtype=np.int64))


def estimate(sensors: dict[str, Any], electronics: Any) -> None:
    processes: dict[str, Any] = {
        "motion": WhiteNoiseAcceleration(acceleration_density=1.0),
        "drift": electronics,
    }
    measurements = [
        MEASUREMENT,
        Measurement("fix", 1.0, np.zeros((1, 3)), np.zeros(1, dtype=np.int64)),
    ]
    epochs = make_epochs(processes, measurements, {})
    run_estimator("ekf", Problem(processes, sensors, Prior(np.zeros(7), np.eye(7)), epochs))


def incremental(factor: gtsam.CustomFactor, keys: list[tuple[int, int]]) -> None:
    params = gtsam.ISAM2Params()
    params.setFactorization("QR")
    isam = gtsam.ISAM2(params)
    new, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for key, n in keys:
        values.insert(key, np.zeros(n))
        new.add(gtsam.PriorFactorVector(key, np.zeros(n), gtsam.noiseModel.Unit.Create(n)))
    new.add(factor)
    isam.update(new, values)


def assembly_sensor(name: str) -> None:
    estimate({"fix": SENSORS[name]()}, ThermalDrift(time_constant=1.0, density=1.0))


def assembly_process(name: str) -> None:
    cls = type("Broken", (ThermalDrift,), {"kernel": staticmethod(PROCESSES[name])})
    estimate({"fix": PositionFix(covariance=np.eye(3))}, cls(time_constant=1.0, density=1.0))


def model_sensor(name: str) -> None:
    SENSORS[name]().residual(MEASUREMENT, np.zeros(3))


def model_process(name: str) -> None:
    cls = type("Broken", (ThermalDrift,), {"kernel": staticmethod(PROCESSES[name])})
    cls(time_constant=1.0, density=1.0).transition(0.0, np.ones((1, 1)), np.zeros(1))


def isam2_sensor(name: str) -> None:
    incremental(gtsam_factors.measurement_factor(SENSORS[name](), MEASUREMENT, [7]), [(7, 3)])


def isam2_process(name: str) -> None:
    cls = type("Broken", (ThermalDrift,), {"kernel": staticmethod(PROCESSES[name])})
    process = cls(time_constant=1.0, density=1.0)
    factor = gtsam_factors.process_factor(process, 0.0, np.ones((1, 1)), [7], [8], [np.zeros(1)])
    incremental(factor, [(7, 1), (8, 1)])


def online_sensor(name: str) -> None:
    drive({"fix": SENSORS[name]()}, ThermalDrift(time_constant=1.0, density=1.0))


def online_process(name: str) -> None:
    cls = type("Broken", (ThermalDrift,), {"kernel": staticmethod(PROCESSES[name])})
    drive({"fix": PositionFix(covariance=np.eye(3))}, cls(time_constant=1.0, density=1.0))


def drive(sensors: dict[str, Any], electronics: Any) -> None:
    """Take two epochs in with every estimator that runs online; it is as before after each
    error, the last of which is raised."""
    processes: dict[str, Any] = {
        "motion": WhiteNoiseAcceleration(acceleration_density=1.0),
        "drift": electronics,
    }
    problem, raised = Problem(processes, sensors, Prior(np.zeros(7), np.eye(7)), ()), []
    inputs = {name: np.ones((1, 1)) for name in processes}
    for kind in ("ekf", "incremental", "fixed_lag"):
        estimator = online(kind, problem)
        for epoch in (Epoch(0.0, (MEASUREMENT,)), Epoch(1.0, (), inputs)):
            before = estimator.state()
            try:
                estimator.step(epoch)
            except ModelError as error:
                after = estimator.state()
                if any(not np.array_equal(before[k], after[k], True) for k in before | after):
                    raise SystemExit(f"{kind}: changed by a step that failed") from error
                raised.append(error)
                break
    if len(raised) < 3:
        raise SystemExit(f"accepted by {3 - len(raised)} estimators")
    raise raised[-1]


WAYS = {
    "assembly_sensor": assembly_sensor,
    "assembly_process": assembly_process,
    "model_sensor": model_sensor,
    "model_process": model_process,
    "isam2_sensor": isam2_sensor,
    "isam2_process": isam2_process,
    "online_sensor": online_sensor,
    "online_process": online_process,
}


def verdict(way: str, name: str) -> str:
    try:
        WAYS[way](name)
    except RelnavError as error:
        return f"{type(error).__name__}: {str(error).splitlines()[0]}"
    except Exception as error:
        return f"other {type(error).__name__}"
    return "accepted"


if __name__ == "__main__":
    for way in sys.argv[1:]:
        for name in PROCESSES if way.endswith("process") else SENSORS:
            print(way, name, verdict(way, name), flush=True)
    print("alive", flush=True)
