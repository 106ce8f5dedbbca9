"""Between formats: tracks of a file of results to other files, orbits to data."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from relnav_graph.core.catalogue import (
    CHASER_ATTITUDE,
    CHASER_POSITION,
    CHASER_VELOCITY,
    RELATIVE_ATTITUDE,
    RELATIVE_POSITION,
    RELATIVE_VELOCITY,
    TARGET_ATTITUDE,
)
from relnav_graph.core.track import Track
from relnav_graph.errors import InputError
from relnav_graph.io.dataset import Format, write_dataset
from relnav_graph.io.known import Known
from relnav_graph.io.parts import read_data
from relnav_graph.io.readers import by_suffix as reader_of
from relnav_graph.io.readers import options_wrong, read_raw
from relnav_graph.io.results import read_results
from relnav_graph.io.writers import by_suffix as writer_of
from relnav_graph.io.writers import fills_folder, options_of, write_track, writers
from relnav_graph.maths.instants import Instant
from relnav_graph.registry import suffixes
from relnav_graph.runs.passes import open_pass
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scoring.metrics import with_smoothed

__all__ = ["convert_orbits", "convert_results", "write_pass"]

_BLOCKS = (
    *(RELATIVE_POSITION, RELATIVE_VELOCITY, CHASER_POSITION, CHASER_VELOCITY),
    *(RELATIVE_ATTITUDE, CHASER_ATTITUDE, TARGET_ATTITUDE),
)


def write_pass(opened: Any, target: Path, tables: Format) -> int:
    """Write a pass as a data set; how many epochs it has. Raises InputError."""
    s = opened.scenario
    origin = s.file.time.origin
    recording, blocks = opened.recording, {b.name: b for b in s.layout}
    write_dataset(target, s.raw, recording, s.sensors, s.input_columns, blocks, tables, origin)
    return len(opened.recording.times)


def _chosen(source: Path, tracks: list[Track], name: str, many: bool) -> list[Track]:
    """Tracks to write: all, where many may go to one place and none is named."""
    if many and not name:
        return tracks
    every = with_smoothed(tracks)
    if name not in every and (name or len(tracks) > 1):
        found = f"track {name!r}" if name else "several tracks"
        names = ", ".join(every)
        raise InputError(f"{source}: found {found}, expected one by --track: {names}")
    return [every[name] if name else tracks[0]]


def convert_results(
    source: Path, out: Path, to: str = "", name: str = "", options: Mapping[str, Any] | None = None
) -> str:
    """Write tracks of a file of results in another format; what was written, in words.

    to: the writer, by default the one that the suffix of `out` says, else CSV tables; name: of the
    track, where there are several, also NAME_smoothed; options: of the writer. When t = 0 is, and
    whether o turns, is taken from the results, where they say it. Raises InputError, also on a
    suffix that no writer has.
    """
    tracks, _, attributes = read_results(source)
    writer = to or writer_of(out)
    if not writer and out.suffix and not out.is_dir():
        known = ", ".join(sorted(end for ends in suffixes(writers()).values() for end in ends))
        raise InputError(
            f"{out}: no writer makes files {out.suffix}; expected one of {known}, a name without a"
            " suffix for a folder of CSV tables, or the name of a writer (--to)"
        )
    writer = writer or "csv"
    own: dict[str, Any] = {}
    if "time_epoch" in attributes:
        turns = {"i": False, "RTN": True}.get(attributes.get("o", ""))
        own = {"epoch": attributes["time_epoch"], "orbital": turns}
    own = {k: v for k, v in own.items() if k in options_of(writer)} | dict(options or {})
    folder = fills_folder(writer, out)
    chosen = _chosen(source, tracks, name, folder)
    for track in chosen:
        write_track(writer, track, out, **own)
    return f"{out}: {len(chosen)} tracks" if folder else f"{out}: {name or chosen[0].name}"


def convert_orbits(
    source: Path,
    out: Path,
    target: Path | None = None,
    scenario: Path | None = None,
    tables: Format = "csv",
) -> str:
    """Make data of a file of true states: the chaser's orbit and, of another file, the target's;
    what was written, in words.

    Without a scenario it is a folder of truth, for ``[data] reader = "tables"`` with sensors to
    simulate (o is i); with one a whole data set, o as it says, and its data.simulate drawn. Raises
    InputError.
    """
    reader = reader_of(source)
    if reader is None:
        raise InputError(f"{source}: no reader knows files of that name")
    options: dict[str, Any] = {} if options_wrong(reader, {"role": ""}) else {"role": "truth"}
    if target is not None:
        options["target"] = str(target.resolve())
    if scenario is None:
        found = read_raw(reader, source, options)
        write_dataset(out, None, found, {}, {}, {b.name: b for b in _BLOCKS}, tables)
        return f"{out}: {len(found.times)} epochs of truth"
    made = load_scenario(scenario)
    time = made.file.time
    known = Known(orbital=made.file.orbit is not None, origin=time.origin)
    epoch = None if time.epoch is None else Instant.parse(time.epoch)
    found = read_data({"reader": reader, "options": options}, source, known, epoch)
    return f"{out}: {write_pass(open_pass(scenario, None, found), out, tables)} epochs"
