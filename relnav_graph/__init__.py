"""Factor-graph smoothing for spacecraft relative navigation, compared with Kalman filters.

Conventions
-----------
- SI units and radians inside. Degrees, arc-seconds, deg/h exist only in scenario files
  (as strings with their unit) and in tables for people.
- The *target* (chief) is the tumbling body; the *chaser* (deputy) carries the sensors.
- Frames: ``i`` inertial, ``o`` orbital frame of the target = RTN (x radial outward,
  y transverse, z along the orbit normal), ``t`` target body, ``c`` chaser body, ``s``
  sensor. A scenario without an orbit takes a frame that does not rotate as ``o``.
- ``R_ab`` takes b-components to a-components. ``r_tc_o`` is the position of c relative to
  t in o-components. ``w_ti_t`` is the rate of t relative to i in t-components.
- Perturbations act on the right: ``R = R_hat Exp(d)``, d in the right-hand frame of R.
  Filter, smoother, covariances and NEES all use it.
- Quaternions appear in files only: Hamilton, scalar first, ``q_wxyz``, w >= 0.
- Residuals are prediction minus measured.
- ``*_density`` is a continuous noise (unit/sqrt(Hz)), ``*_sigma`` one per sample.
- ``P_*`` is a covariance, ``sigma_*`` a standard deviation.
- Time is float seconds since the scenario's epoch; the time of a measurement is when it
  was valid. An input sample (gyro, velocity) is the mean over the interval it states.
- Random numbers come from ``SeedSequence(root, spawn_key=(run, stream))`` only, one
  stream per sensor.
- Of an inertia only the ratios are observable: l_x = (J_y - J_z) / J_x and cyclic.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from relnav_graph.constants import VERSION as __version__
from relnav_graph.core.lent import lend

if TYPE_CHECKING:
    from relnav_graph.core.epochs import make_epochs
    from relnav_graph.core.measurement import InputSeries, Measurement
    from relnav_graph.core.numerical import NumericalSensor
    from relnav_graph.core.problem import Prior, Problem
    from relnav_graph.core.timed import TimedSensor
    from relnav_graph.core.track import Recording, Track, Truth
    from relnav_graph.errors import InputError
    from relnav_graph.estimators.online.driver import online
    from relnav_graph.io.exports import to_dataframe, to_xarray
    from relnav_graph.io.readers import read_raw
    from relnav_graph.io.writers import write_track
    from relnav_graph.runs.arrays import problem_from_arrays
    from relnav_graph.runs.comparison import Comparison, compare
    from relnav_graph.runs.estimates import run_estimator
    from relnav_graph.runs.frames import problem_from_frames
    from relnav_graph.runs.graph import to_gtsam, to_track
    from relnav_graph.runs.plotting import plot_track
    from relnav_graph.scenario.build import load_scenario
    from relnav_graph.scenario.scenario import Scenario
    from relnav_graph.streaming.online import Online

__all__ = [
    "Comparison",
    "InputError",
    "InputSeries",
    "Measurement",
    "NumericalSensor",
    "Online",
    "Prior",
    "Problem",
    "Recording",
    "Scenario",
    "TimedSensor",
    "Track",
    "Truth",
    "__version__",
    "compare",
    "load_scenario",
    "make_epochs",
    "online",
    "plot_track",
    "problem_from_arrays",
    "problem_from_frames",
    "read_raw",
    "run_estimator",
    "to_dataframe",
    "to_gtsam",
    "to_track",
    "to_xarray",
    "write_track",
]

#: Where each of them lives: loaded when first asked for, so that the import itself costs nothing.
_HOMES = {
    "Comparison": "runs.comparison",
    "InputError": "errors",
    "InputSeries": "core.measurement",
    "Measurement": "core.measurement",
    "NumericalSensor": "core.numerical",
    "Online": "streaming.online",
    "Prior": "core.problem",
    "Problem": "core.problem",
    "Recording": "core.track",
    "Scenario": "scenario.scenario",
    "TimedSensor": "core.timed",
    "Track": "core.track",
    "Truth": "core.track",
    "compare": "runs.comparison",
    "load_scenario": "scenario.build",
    "make_epochs": "core.epochs",
    "online": "estimators.online.driver",
    "plot_track": "runs.plotting",
    "problem_from_arrays": "runs.arrays",
    "problem_from_frames": "runs.frames",
    "read_raw": "io.readers",
    "run_estimator": "runs.estimates",
    "to_dataframe": "io.exports",
    "to_gtsam": "runs.graph",
    "to_track": "runs.graph",
    "to_xarray": "io.exports",
    "write_track": "io.writers",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


lend(__getattr__)


def __dir__() -> list[str]:
    return [*__all__]
