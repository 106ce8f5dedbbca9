"""A small recording and its tables, with toy sensors."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np

from relnav_graph.core.catalogue import INERTIA, RELATIVE_ATTITUDE, RELATIVE_VELOCITY_T
from relnav_graph.core.measurement import InputSeries, Measurement
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Recording, Truth
from relnav_graph.io.dataset import read_dataset, write_dataset

GYRO = "t_start_s,t_end_s,wx_rad_s,wy_rad_s,wz_rad_s\n"
# All that a table needs of a sensor.
SENSORS: dict[str, Any] = {
    "beacons": SimpleNamespace(
        columns=("los_x", "los_y", "los_z"),
        rows=2,
        residual_columns=("first_rad", "second_rad"),
        observables=lambda: np.arange(4),
    ),
    "range": SimpleNamespace(columns=("range_m",), rows=1, observables=lambda: np.array([7])),
}
BLOCKS = {b.name: b for b in (RELATIVE_ATTITUDE, RELATIVE_VELOCITY_T, INERTIA)}
SCENARIO = {"title": "a pass", "seed": 3, "sensors": {"range": {"sigma": "0.1 mm"}}}


def make_recording(epochs: int = 30) -> Recording:
    rng = np.random.default_rng(5)
    t = np.cumsum(rng.uniform(0.1, 0.2, epochs))
    measurements = []
    for k in range(epochs):
        ids = rng.permutation(6)[: k % 4]
        if len(ids):
            measurements.append(Measurement("beacons", t[k], rng.normal(size=(len(ids), 3)), ids))
        if k % 3 == 0:
            z = 1e-7 * rng.normal(size=(1, 1))
            measurements.append(Measurement("range", t[k], z, np.array([7]), t[k] + 0.01))
    gyro = InputSeries("gyro", t[:-1], t[1:], rng.normal(size=(epochs - 1, 3)))
    layout = Layout(BLOCKS.values())
    x = np.array(
        [layout.retract(layout.identity, d) for d in rng.normal(size=(epochs, layout.dim))]
    )
    values = {name: layout.value(x, name).copy() for name in BLOCKS}
    values["relative_velocity"][4:9] = np.nan
    settings = {"sensors": {"range": {"points": [[0.1, 1 / 3], [2.0, 3.0]]}}}
    return Recording(t, tuple(measurements), {"gyro": gyro}, Truth(t, values, "made up"), settings)


INPUTS = {"gyro": ("wx_rad_s", "wy_rad_s", "wz_rad_s")}


def read(folder: Path) -> Recording:
    return read_dataset(folder, SENSORS, INPUTS, BLOCKS)


def write(folder: Path, tables: Literal["csv", "parquet"] = "csv") -> Path:
    write_dataset(folder, SCENARIO, make_recording(), SENSORS, INPUTS, BLOCKS, tables)
    return folder


def by_hand(folder: Path, **tables: str) -> Path:
    """A data set without a manifest, as one makes it from one's own data."""
    folder.mkdir(exist_ok=True)
    defaults = {
        "beacons": "t_s,id,los_x,los_y,los_z\n0,1,0,0,1\n0,2,0,1,0\n1,1,0,0,1\n",
        "range": "t_s,id,range_m\n0,0,5\n1.0,0,6.5\n",
        "gyro": "t_start_s,t_end_s,wx_rad_s,wy_rad_s,wz_rad_s\n0,0.5,0,0,1\n0.5,1,0,0,2\n",
    }
    for name, text in (defaults | tables).items():
        (folder / f"{name}.csv").write_text(text, "utf-8")
    return folder
