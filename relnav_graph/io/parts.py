"""One recording of several parts: an orbit, an attitude, and a table of a gyro beside them."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import epoch_times
from relnav_graph.core.measurement import InputSeries, Measurement
from relnav_graph.core.track import Recording, Truth, at_all_times
from relnav_graph.errors import InputError
from relnav_graph.io.known import Known
from relnav_graph.io.readers import asks, options_wrong, read_raw, roles_wrong
from relnav_graph.io.truth import at_epochs, block_like
from relnav_graph.maths.instants import Instant, moved

__all__ = ["data_problems", "need_known", "read_data", "target_of"]

_LOG = logging.getLogger(__name__)
_TARGET = ("target_position", "target_velocity")


def _parts(data: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Tables with a reader, by their path in the scenario."""
    found = data.get("parts")
    if not isinstance(found, Mapping):
        return {"data": data}
    return {f"data.parts.{n}": part for n, part in found.items() if isinstance(part, Mapping)}


def _options(part: Mapping[str, Any]) -> Any:
    return part.get("options", {})


def data_problems(data: Any, known: Known | None = None) -> list[tuple[str, str]]:
    """What is wrong with readers that a table [data] names, and with their options, by what the
    scenario knows where that is given: paths and messages. What is no such table is reported
    elsewhere."""
    found = []
    for path, part in _parts(data).items() if isinstance(data, Mapping) else ():
        if isinstance(part.get("reader"), str):
            reader, options = part["reader"], _options(part)
            wrong = options_wrong(reader, options)
            wrong = wrong or ("" if known is None else roles_wrong(reader, options, known))
            found += [(path, wrong)] if wrong else []
    return found


def need_known(data: Mapping[str, Any]) -> bool:
    """Whether one of the readers asks for what the scenario knows."""
    return any(asks(str(part.get("reader"))) for part in _parts(data).values())


def target_of(path: str, recording: Recording) -> Recording:
    """The recording, which is to tell the target's orbit. Raises InputError where it does not."""
    values = recording.truth.values if recording.truth else {}
    lacks = [name for name in _TARGET if name not in values]
    if lacks:
        raise InputError(f"{path}: found no {lacks[0]}, expected the orbit of the target")
    return recording


def _read(path: str, part: Mapping[str, Any], folder: Path, known: Known) -> Recording:
    """One part. Raises InputError, with its path in the scenario."""
    where = folder / str(part.get("file", ""))
    try:
        return read_raw(str(part["reader"]), where, _options(part), known)
    except InputError as error:
        raise InputError(f"{path}: {error}" if path != "data" else str(error)) from error


def read_data(
    data: Mapping[str, Any], folder: Path, known: Known, epoch: Instant | None = None
) -> Recording:
    """What [data] of a scenario says, of a folder (or a file, where one reader takes one), in the
    clock of the pass.

    epoch: when t = 0 is; None: what the first part says that knows. A part that knows its absolute
    time is put where its own epoch says, to the nanosecond; of another one `known.origin` is taken
    off. A part with the option ``role = "target"`` tells the target's orbit to the others, and is
    none itself.

    Measurements, inputs, settings and truth are those of all parts; epochs are the times of parts
    with measurements, or of all where none has any, or sensors are to be simulated; truth is
    interpolated to them (`relnav_graph.io.truth`). A recording of one reader keeps the times
    that it has. Raises InputError on what two parts say both, naming both, and on what a reader
    refuses.
    """
    parts = _parts(data)
    targets = [
        p
        for p, part in parts.items()
        if p != "data" and isinstance(o := _options(part), Mapping) and o.get("role") == "target"
    ]
    if len(targets) > 1:
        raise InputError(f"{' and '.join(targets)}: found two targets, expected one")
    for path in targets:
        orbit = target_of(path, _read(path, parts.pop(path), folder, known))
        known = replace(known, target=orbit)
    if not parts:
        raise InputError(f"{targets[0]}: found the target alone, expected other parts beside it")
    found = {path: _read(path, part, folder, known) for path, part in parts.items()}
    told = epoch is not None
    if not told:
        epoch = next((e for r in found.values() if (e := r.epoch) is not None), None)
    placed = {path: _placed(r, epoch, known.origin) for path, r in found.items()}
    if len(placed) == 1:
        (whole,) = placed.values()
    else:
        whole = _union(placed, known, bool(data.get("simulate")))
    settings = {k: v for k, v in whole.settings.items() if k != "time"}
    if epoch is not None and not told:  # as data say it: of a stamp of 0
        settings["time"] = {"epoch": str(epoch.after(-known.origin))}
    return replace(whole, settings=settings)


def _placed(recording: Recording, epoch: Instant | None, origin: float) -> Recording:
    """A part in the clock of the pass."""
    own = recording.epoch
    if own is None or epoch is None:
        counted = recording.settings.get("time", {}).get("origin", origin)
        own, epoch = Instant(0), Instant(0).after(counted)
    by = own.ns_since(epoch)
    if not by:
        return recording

    def later(m: Measurement) -> Measurement:
        arrival = None if m.t_arrival is None else float(moved(m.t_arrival, by))
        return replace(m, t=float(moved(m.t, by)), t_arrival=arrival)

    def shifted(s: InputSeries) -> InputSeries:
        return replace(s, t_start=moved(s.t_start, by), t_end=moved(s.t_end, by))

    truth = recording.truth
    return replace(
        recording,
        times=moved(recording.times, by),
        measurements=tuple(later(m) for m in recording.measurements),
        inputs={n: shifted(s) for n, s in recording.inputs.items()},
        truth=truth and replace(truth, t=moved(truth.t, by)),
    )


def _union(parts: Mapping[str, Recording], known: Known, simulate: bool) -> Recording:
    """One recording of parts in one clock, by their paths."""
    inputs = _once("input", {p: r.inputs for p, r in parts.items()})
    times = _epochs(parts, known.merge, simulate)
    measured = sorted((m for r in parts.values() for m in r.measurements), key=lambda m: m.t)
    _check_measured(parts)
    truths = {p: r.truth for p, r in parts.items() if r.truth is not None}
    _once("truth", {p: t.values for p, t in truths.items()})
    truth = _truth(truths, known, times) if truths else None
    settings: dict[str, Any] = {}
    said: dict[str, str] = {}
    for path, part in parts.items():
        own = {k: v for k, v in part.settings.items() if k != "time"}
        _merge(settings, own, path, said, "")
    return Recording(times, tuple(measured), inputs, truth, settings)


def _once(what: str, named: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """All that parts have, by name. Raises InputError on a name that two have."""
    found: dict[str, Any] = {}
    owner: dict[str, str] = {}
    for path, things in named.items():
        for name, thing in things.items():
            if owner.setdefault(name, path) != path:
                raise InputError(f"{what} {name!r}: found in {owner[name]} and in {path}")
            found[name] = thing
    return found


def _check_measured(parts: Mapping[str, Recording]) -> None:
    """Raise InputError where two parts have a measurement of one sensor at one time."""
    owner: dict[tuple[str, float], str] = {}
    for path, part in parts.items():
        for m in part.measurements:
            if (other := owner.setdefault((m.sensor, m.t), path)) != path:
                raise InputError(f"sensor {m.sensor!r} at t = {m.t} s: found in {other} and {path}")


def _epochs(parts: Mapping[str, Recording], merge: float, simulate: bool) -> Array:
    """Times of the epochs (N,), s. Raises InputError without any."""
    own = [r.times for r in parts.values() if r.measurements or r.truth is None]
    if simulate or not any(len(t) for t in own):
        own = [r.times for r in parts.values()]
    times = epoch_times(np.sort(np.concatenate(own)), merge)
    if not len(times):
        raise InputError(f"{', '.join(parts)}: found no epochs: neither measurements nor truth")
    return times


def _truth(truths: Mapping[str, Truth], known: Known, times: Array) -> Truth:
    """What all parts say is true, at the epochs `times` (N,), s."""
    values: dict[str, Array] = {}
    sigmas: dict[str, Array] = {}
    for path, truth in truths.items():
        for name, value in truth.values.items():
            if name in known.statics and len(value) and (value == value[0]).all():
                values[name] = at_all_times(value[0], len(times))
            else:
                there = np.isfinite(value.reshape(len(value), -1)).all(axis=1)
                block = known.blocks.get(name) or block_like(name, value)
                where = f"{path}: truth of {name}"
                values[name] = at_epochs(where, block, truth.t[there], value[there], times)
        for name, sigma in truth.sigmas.items():
            columns = [np.interp(times, truth.t, one) for one in np.atleast_2d(sigma).T]
            sigmas[name] = np.column_stack(columns)
    sources = [t.source for t in truths.values() if t.source]
    return Truth(times, values, "; ".join(dict.fromkeys(sources)), sigmas)


def _merge(
    into: dict[str, Any], own: Mapping[str, Any], path: str, said: dict[str, str], at: str
) -> None:
    """Add settings of a part to those of others. Raises InputError where they contradict."""
    for key, value in own.items():
        where = f"{at}.{key}" if at else key
        if isinstance(value, Mapping) and isinstance(into.setdefault(key, {}), dict):
            _merge(into[key], value, path, said, where)
            continue
        if key in into and not _same(into[key], value):
            other = said.get(where, "another part")
            raise InputError(f"{where}: {other} says {into[key]!r}, and {path} {value!r}")
        into[key] = value
        said[where] = path


def _same(a: Any, b: Any) -> bool:
    sequences = isinstance(a, Sequence) and isinstance(b, Sequence)
    return list(a) == list(b) if sequences and not isinstance(a, str) else bool(a == b)
