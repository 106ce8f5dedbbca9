"""The table of a sensor: a row per observation, read as measurements and written."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relnav_graph.arrays import Indices
from relnav_graph.core.contracts import Sensor
from relnav_graph.core.measurement import Measurement
from relnav_graph.errors import InputError
from relnav_graph.io.closures import earlier_times
from relnav_graph.io.covariances import of_measurements
from relnav_graph.io.noise_columns import noise_in, noise_names
from relnav_graph.io.tabular import Table

__all__ = ["measurements_in", "sensor_columns"]


def _ids(table: Table, sensor: Sensor) -> Indices:
    """Ids (rows,) of a table's observations; without a column, those of the only thing that a
    sensor sees."""
    if "id" in table.columns:
        raw = table["id"]
        whole = (raw == np.rint(raw)) & (np.abs(raw) < 2.0**53)
        table.refuse(~whole, "id", "a whole number below 2^53")
        return raw.astype(np.int64)
    only = sensor.observables()
    if len(only) != 1:
        table.require(("t_s", "id", *sensor.columns), tuple(table.columns))
    first = np.concatenate(([True], np.diff(table["t_s"]) > 0))[: len(table.lines)]
    table.refuse(~first, "t_s", "one row at each time, or a column id that tells them apart")
    return np.repeat(only, len(table.lines))


def measurements_in(
    table: Table, name: str, sensor: Sensor, sort: bool = False
) -> list[Measurement]:
    """One measurement per time of a sensor's table, with the noise that its rows state.

    sort: put rows in order of time first, and say so. Raises InputError, naming file, line and
    column, on what is missing, out of order, or there twice.
    """
    optional = ("id", "t_arrival_s", *noise_names(sensor))
    table.require(("t_s", *sensor.columns), optional)
    if sort:
        table = table.sorted_by("t_s")
    table.increasing("t_s", strictly=False)
    t, ids, z = table["t_s"], _ids(table, sensor), table.stack(sensor.columns)
    order = np.lexsort((ids, t))
    repeated = np.zeros(len(t), dtype=bool)
    repeated[order[1:]] = (np.diff(t[order]) == 0) & (np.diff(ids[order]) == 0)
    table.refuse(repeated, "id", "an id once at each time: a duplicate")
    first = np.diff(t, prepend=-np.inf) > 0
    arrival = table.columns.get("t_arrival_s")
    if arrival is not None:
        same = np.concatenate(([True], arrival[1:] == arrival[:-1]))
        table.refuse(~(first | same), "t_arrival_s", "the same for all rows of one time")
    R = noise_in(table, sensor)
    edges = np.append(np.nonzero(first)[0], len(t))
    return [
        Measurement(
            *(name, t[i], z[i:j], ids[i:j], None if arrival is None else arrival[i]),
            covariance=None if R is None else R[i:j],
        )
        for i, j in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
    ]


def sensor_columns(
    name: str, sensors: Mapping[str, Sensor], measurements: Iterable[Measurement]
) -> dict[str, NDArray[Any]]:
    """The table of a sensor, or of those that close loops to its keyframes: a row per observation,
    in order of time. Raises InputError on a measurement of another width."""
    sensor = next(iter(sensors.values()))
    own = sorted((m for m in measurements if m.sensor in sensors), key=lambda m: m.t)
    for m in own:
        if m.z.shape[1] != len(sensor.columns):
            raise InputError(
                f"sensor {name!r} at t = {m.t} s: z has {m.z.shape[1]} columns,"
                f" expected {', '.join(sensor.columns)}"
            )
    counts = [len(m.z) for m in own]
    z = np.concatenate([np.zeros((0, len(sensor.columns))), *(m.z for m in own)])
    columns: dict[str, NDArray[Any]] = {
        "t_s": np.repeat([m.t for m in own], counts),
        **earlier_times(own, sensors),
        "id": np.concatenate([np.zeros(0, dtype=np.int64), *(m.ids for m in own)]),
        **dict(zip(sensor.columns, z.T, strict=True)),
    }
    if any(m.t_arrival is not None for m in own):
        arrival = [m.t if m.t_arrival is None else m.t_arrival for m in own]
        columns["t_arrival_s"] = np.repeat(arrival, counts)
    return columns | of_measurements(name, own, sensor.rows)
