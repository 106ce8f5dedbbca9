"""Which observations a track was made without: as variables of its group, and as a table."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Mapping

import numpy as np

from relnav_graph.core.track import LeftOut, Track
from relnav_graph.errors import InputError
from relnav_graph.files import file_in
from relnav_graph.io.atomic import atomic
from relnav_graph.io.netcdf import Group, Variable
from relnav_graph.io.stored import check_json

__all__ = ["left_out_variables", "stored_left_out", "write_left_out"]

_SENSOR, _TIME, _ID = _NAMES = ("left_out_sensor", "left_out_time", "left_out_id")


def left_out_variables(found: Mapping[str, LeftOut]) -> dict[str, Variable]:
    """Sensor, time and id of each observation; {} where there is none."""
    if not found:
        return {}
    over, each = ("left_out",), list(found.values())
    sensor = np.repeat(np.arange(len(each), dtype=np.float64), [len(one.t) for one in each])
    what = "observation not used: number of its sensor, in the order of `sensors`"
    return {
        _SENSOR: Variable(over, sensor, {"long_name": what, "sensors": json.dumps(list(found))}),
        _TIME: Variable(over, np.concatenate([one.t for one in each]), {"units": "s"}),
        _ID: Variable(over, np.concatenate([one.ids for one in each]), {}),
    }


def stored_left_out(where: str, group: Group) -> dict[str, LeftOut]:
    """What `left_out_variables` made of it. Raises InputError on a damaged group."""
    if not any(name in group.variables for name in _NAMES):
        return {}
    for name in _NAMES:
        if name not in group.variables:
            raise InputError(f"{where}: damaged: no variable {name!r}")
    sensor, t, ids = (np.asarray(group.variables[name].values) for name in _NAMES)
    text = str(group.variables[_SENSOR].attributes.get("sensors", ""))
    names = check_json(f"{where}/{_SENSOR}: sensors", text.encode(), list[str])
    if not (sensor.ndim == t.ndim == ids.ndim == 1 and len(sensor) == len(t) == len(ids)):
        found = f"{sensor.shape}, {t.shape} and {ids.shape}"
        raise InputError(f"{where}/{_SENSOR}: damaged: found {found}, expected one length")
    if not (np.isfinite(t).all() and np.isin(sensor, np.arange(len(names))).all()):
        raise InputError(
            f"{where}/{_SENSOR}: damaged: expected finite times and sensors 0 to {len(names) - 1}"
        )
    own = {name: sensor == i for i, name in enumerate(names)}
    return {n: LeftOut(t[rows], ids[rows].astype(np.int64)) for n, rows in own.items()}


def write_left_out(folder: str | os.PathLike[str], tracks: Mapping[str, Track]) -> None:
    """Write ``left_out.csv``: estimator, sensor, time, s, and id of each observation that a track
    was made without; no file where there is none. Raises InputError when it cannot be written."""
    if not any(track.left_out for track in tracks.values()):
        return
    with (
        atomic(file_in(folder, "left_out.csv")) as staged,
        staged.open("w", encoding="utf-8", newline="") as stream,
    ):
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["estimator", "sensor", "t_s", "id"])
        for name, track in tracks.items():
            for sensor, one in track.left_out.items():
                rows = zip(one.t.tolist(), one.ids.tolist(), strict=True)
                writer.writerows([name, sensor, repr(t), i] for t, i in rows)
