"""Data sets: a folder with a scenario, one table per sensor and input, and maybe truth.

::

    scenario.toml         the scenario
    epochs.csv            t_s; optional, else the times of the measurements
    <sensor>.csv          t_s, id (not needed where there is but one thing to see), the columns of
                          the sensor; maybe t_arrival_s, and noise row by row (`noise_columns`); of
                          one that closes loops, t_from_s, the time of the earlier epoch
    <input>.csv           t_start_s, t_end_s, the columns that its process declares
    truth_<block>.csv     t_s, the columns of `component_columns`; optional; maybe `sigma_columns`
    truth_<family>.csv    id, the same columns: of numbered blocks, such as points
    dataset.toml          format, settings that the data bring, digests; optional

Units are SI and stand in the names of the columns, which come in any order; further ones are said
once and not read. One row is one observation, in order of time, or sorted on request ([data] sort).
An input may have one column ``t_s`` in place of two: a row is then the mean since the row before,
and the first row only says when the first interval starts; where rows are missing, the scenario's
[gaps] says what is done. The input ``thrust`` may be a table of manoeuvres, see
`relnav_graph.io.manoeuvres`. Times are those of any clock: its [time]
origin is taken off them. A table may be Parquet instead. A folder made by hand needs no
``dataset.toml``; where there is one, every table that it lists must still be as it was written.
Truth is interpolated at the epochs between its rows, see `relnav_graph.io.truth`; that of a static
block, which has one value for the pass, may be one row without ``t_s``. The scenario of
a data set may name no module ("module:Class"), which is code, unless it is trusted.
"""

from __future__ import annotations

import os
from collections.abc import Container, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import CopiesBlocks, Sensor
from relnav_graph.core.epochs import epoch_times
from relnav_graph.core.manoeuvres import THRUST_COLUMNS
from relnav_graph.core.measurement import SAME_TIME, InputSeries, Measurement
from relnav_graph.core.numbered import families, number_in
from relnav_graph.core.state import Block
from relnav_graph.core.track import Recording, Truth
from relnav_graph.errors import InputError
from relnav_graph.files import check_name
from relnav_graph.io.atomic import atomic
from relnav_graph.io.closures import (
    by_keyframe,
    grouped,
    keyframes_in,
    of_closures,
)
from relnav_graph.io.dataset_file import is_ours, read_manifest, write_manifest
from relnav_graph.io.manoeuvres import read_manoeuvres
from relnav_graph.io.maps import family_table
from relnav_graph.io.sensor_tables import measurements_in, sensor_columns
from relnav_graph.io.tabular import (
    Format,
    Table,
    component_columns,
    read_table,
    sigma_columns,
    to_components,
    write_table,
)
from relnav_graph.io.truth import read_truth
from relnav_graph.registry import look_beside
from relnav_graph.scenario.toml import merge as joined
from relnav_graph.scenario.toml import modules_of, read_toml, refuse_modules

__all__ = [
    "Format",
    "read_dataset",
    "read_scenario_of",
    "read_settings_of",
    "write_dataset",
]

Columns = Mapping[str, NDArray[Any]]

#: Characters of a table's name: that of a block or sensor, and what it is of.
_LONGEST = 200


def _need_table(folder: Path, stem: str, origin: float) -> Table:
    table = read_table(folder, stem, origin)
    if table is None:
        here = ", ".join(sorted(p.name for p in folder.iterdir())) or "nothing"
        raise InputError(f"{folder}: no table {stem}.csv or {stem}.parquet; found {here}")
    return table


def _input(
    folder: Path, name: str, channels: tuple[str, ...], sort: bool, origin: float
) -> InputSeries:
    table = _need_table(folder, name, origin)
    if sort:
        table = table.sorted_by("t_s" if "t_s" in table.columns else "t_start_s")
    if channels == THRUST_COLUMNS and "dvx_m_s" in table.columns:
        return read_manoeuvres(table, name)
    if "t_s" in table.columns:
        table.require(("t_s", *channels))
        table.increasing("t_s")
        t, values = table["t_s"], table.stack(channels)
        where = str(table.path), table.lines[1:]
        return InputSeries(name, t[:-1], t[1:], values[1:], None, *where)
    table.require(("t_start_s", "t_end_s", *channels))
    t_start, t_end = table["t_start_s"], table["t_end_s"]
    table.increasing("t_start_s")
    table.refuse(t_end <= t_start, "t_end_s", "a time after t_start_s")
    overlap = np.concatenate(([False], t_start[1:] < t_end[:-1] - 1e-9))
    table.refuse(overlap, "t_start_s", "a time not before t_end_s of the row above")
    where = str(table.path), table.lines
    return InputSeries(name, t_start, t_end, table.stack(channels), None, *where)


def read_scenario_of(folder: str | os.PathLike[str], trust: bool = False) -> dict[str, Any]:
    """The scenario of a data set, as tables. trust: it may name modules, which are code.

    Raises InputError without a valid one.
    """
    path = Path(folder) / "scenario.toml"
    raw = read_toml(path, of_data=True)
    if not trust:
        refuse_modules(str(path), raw)
    look_beside(Path(folder), modules_of(raw))
    return raw


def read_settings_of(
    folder: str | os.PathLike[str], scenario: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Settings that a data set brings, {} when none: those of its manifest and, for the tables of a
    scenario, the keyframes of its loop closures. Raises InputError on a damaged one."""
    folder = Path(folder)
    settings: dict[str, Any] = read_manifest(folder).get("settings", {})
    keyframes = keyframes_in(folder, scenario or {})
    return joined(settings, {"sensors": keyframes}) if keyframes else settings


def _epochs(
    folder: Path,
    epochs: Table | None,
    tables: Iterable[Table],
    measurements: Iterable[Measurement],
    merge: float,
) -> Array:
    """Times of the epochs (N,), s: those of a table, or of the measurements. Raises InputError on
    an observation that is on none of them, within `merge`, s."""
    if epochs is None:
        times = epoch_times(np.array([m.t for m in measurements]), merge)
    else:
        epochs.require(("t_s",))
        epochs.increasing("t_s")
        times = epochs["t_s"]
    if not len(times):
        raise InputError(f"{folder}: no epochs: neither epochs.csv nor an observation has any row")
    for table in tables:
        t = table["t_s"]
        right = np.searchsorted(times, t)
        left, right = np.maximum(right - 1, 0), np.minimum(right, len(times) - 1)
        apart = np.minimum(np.abs(times[left] - t), np.abs(times[right] - t))
        table.refuse(apart > merge, "t_s", "the time of an epoch")
    return times


def read_dataset(
    folder: str | os.PathLike[str],
    sensors: Mapping[str, Sensor],
    inputs: Mapping[str, tuple[str, ...]],
    blocks: Mapping[str, Block],
    merge: float = SAME_TIME,
    statics: Container[str] = (),
    origin: float = 0.0,
    late: Container[str] = (),
    sort: bool = False,
    gap: float | None = None,
    partial: bool = False,
) -> Recording:
    """The recording in a folder: tables of the sensors and inputs, truth of `blocks`.

    inputs: columns of each input, by name; merge: s, how close to an epoch is of it; statics:
    which of the blocks are static, see `relnav_graph.io.truth.read_truth`; origin: what stamps say
    at t = 0, s, which is taken off all of them; late: sensors whose stamps are not those of
    epochs, since they lag; sort: put rows that are out of order of time in order; gap: s,
    see `relnav_graph.io.truth.read_truth`; partial: what has no table is elsewhere, and so are the
    epochs.

    Other tables are left alone. Observations of one sensor at one time make one
    measurement. Raises InputError, naming file, line, column, what was found and what was
    expected, on a table that is missing, damaged or has other columns, on text, NaN, times
    that run backwards or fall between epochs, and observations that occur twice.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    for name in (*sensors, *inputs):
        check_name("a table", name, _LONGEST)
    manifest = read_manifest(folder)
    if partial:
        here = {p.stem for p in folder.iterdir() if p.suffix in (".csv", ".parquet")}
        sensors = {
            n: s for own in grouped(sensors).items() if own[0] in here for n, s in own[1].items()
        }
        inputs = {n: columns for n, columns in inputs.items() if n in here}
    tables = {name: _need_table(folder, name, origin) for name in grouped(sensors)}
    measurements = list[Measurement]()
    for name, own in grouped(sensors).items():
        closures = of_closures(own)
        parts = by_keyframe(tables[name], own) if closures else {name: tables[name]}
        measurements += [
            m for n, part in parts.items() for m in measurements_in(part, n, own[n], sort)
        ]
    measurements.sort(key=lambda m: m.t)
    on_time = [table for name, table in tables.items() if name not in late]
    epochs = read_table(folder, "epochs", origin)
    alone = partial and not measurements and epochs is None
    times = np.zeros(0) if alone else _epochs(folder, epochs, on_time, measurements, merge)
    series = {name: _input(folder, name, columns, sort, origin) for name, columns in inputs.items()}
    source = manifest.get("truth_source", "")
    numbered = families(sensors)
    truth = read_truth(folder, blocks, times, source, statics, numbered, gap, sort, origin)
    return Recording(times, tuple(measurements), series, truth, manifest.get("settings", {}))


def _truth_columns(block: Block, truth: Truth) -> Columns:
    """The table of a true block: the rows where it is known."""
    values = truth.values[block.name]
    known = np.isfinite(values.reshape(len(values), -1)).all(axis=1)
    components = to_components(block, values[known])
    names = component_columns(block)
    columns = {"t_s": truth.t[known], **dict(zip(names, components.T, strict=True))}
    if block.name in truth.sigmas:
        own = truth.sigmas[block.name][known].T
        columns |= dict(zip(sigma_columns(block), own, strict=True))
    return columns


def _tables(
    recording: Recording,
    sensors: Mapping[str, Sensor],
    inputs: Mapping[str, tuple[str, ...]],
    blocks: Mapping[str, Block],
) -> dict[str, Columns]:
    """All tables of a data set, by name."""
    for m in recording.measurements:
        if m.sensor not in sensors:
            raise InputError(f"t = {m.t} s: unknown sensor {m.sensor!r}; known: {list(sensors)}")
    tables: list[tuple[str, Columns]] = [("epochs", {"t_s": recording.times})]
    for name in (*sensors, *recording.inputs):
        check_name("a table", name, _LONGEST)
    measured = recording.measurements
    tables += [(n, sensor_columns(n, s, measured)) for n, s in grouped(sensors).items()]
    for name, series in recording.inputs.items():
        if name not in inputs:
            raise InputError(f"unknown input {name!r}; known are {', '.join(inputs)}")
        channels = dict(zip(inputs[name], series.values.T, strict=True))
        tables.append((name, {"t_start_s": series.t_start, "t_end_s": series.t_end, **channels}))
    truth = recording.truth or Truth(np.zeros(0), {})
    copies = {n for s in sensors.values() if isinstance(s, CopiesBlocks) for n in s.copies}
    for name in truth.values:
        if name in blocks and name not in copies:
            tables.append((f"truth_{name}", _truth_columns(blocks[name], truth)))
    for family, block in families(sensors).items():
        parts = [(n, i) for n in truth.values for f, i in (number_in(n),) if f == family]
        known = {
            n: block.numbered(i)
            for n, i in parts
            if i is not None and np.isfinite(truth.values[n][:1]).all()
        }
        if known:
            values = np.stack([truth.values[n][:1] for n in known], axis=1)  # at all times the same
            P = None
            if any(n in truth.sigmas for n in known):
                none = np.zeros((len(truth.t), block.dim))
                sigma = np.stack([truth.sigmas.get(n, none)[:1] for n in known], axis=1)
                P = sigma[..., None] ** 2 * np.eye(block.dim)
            rows = family_table(truth.t[:1], tuple(known.values()), values, P)
            tables.append((f"truth_{family}", rows))
    names = [name for name, _ in tables]
    for name in (n for n in names if names.count(n) > 1):
        raise InputError(f"{name!r} cannot name a table: taken twice")
    return dict(tables)


def write_dataset(
    folder: str | os.PathLike[str],
    scenario: Mapping[str, Any] | None,
    recording: Recording,
    sensors: Mapping[str, Sensor],
    inputs: Mapping[str, tuple[str, ...]],
    blocks: Mapping[str, Block],
    tables: Format = "csv",
    origin: float = 0.0,
) -> None:
    """Write a recording and its scenario as a data set; reading gives the same numbers. Without a
    scenario it is a folder for the reader "tables".

    blocks: definitions of the blocks of the truth; a true quantity without one is left out,
    since its units are not known. tables: format of the tables; origin: s, put on all times. A data
    set that stands in `folder` is replaced. Raises InputError when other files stand there, when
    nothing can be written, or when the recording has a sensor or an input that is not known.
    """
    folder = Path(folder)
    if folder.is_dir() and any(folder.iterdir()) and not is_ours(folder):
        raise InputError(f"{folder}: holds files that are not of a data set; name another folder")
    contents = _tables(recording, sensors, inputs, blocks)
    source = recording.truth.source if recording.truth else ""
    with atomic(folder) as staged:
        staged.mkdir()
        for name, columns in contents.items():
            write_table(staged / f"{name}.{tables}", columns, origin)
        write_manifest(staged, dict(recording.settings), source)
        if scenario is not None:
            (staged / "scenario.toml").write_text(tomli_w.dumps(scenario), "utf-8")
