"""Reader of any table: a text of columns, MATLAB's .mat, NumPy's .npz, by naming what is what.

For the recorders of Basilisk, files of 42, reports of GMAT, MATLAB's workspaces::

    [data]
    reader = "table"

    [data.options]
    time = { column = "t", unit = "ns", clock = "none" }

    [data.options.sensors.tracker]           # a sensor of the scenario, its columns in their order
    columns = ["r[0]", "r[1]", "r[2]"]       # or "r", of three columns
    unit = "km"                              # one, or one for each
    quaternion = ["q1", "q2", "q3", "q4"]    # after the columns; or mrp, or matrix, row by row
    order = "xyzw"

    [data.options.inputs.gyro]
    columns = "omega_BN_B"
    unit = "deg/s"
    samples = "instant"

    [data.options.truth.chaser_attitude]
    mrp = "sigma_BN"

An attitude is the R_ab of the block or sensor, the matrix of the Hamilton quaternion (v_a = q v_b
q*); `inverse = true` takes its transpose. Who writes "from ECI to body" of a quaternion or of MRPs
and means the change of coordinates v_b = [BN] v_n (Basilisk, 42's qn, GMAT, MATLAB's quatrotate,
the JPL convention) has numbers whose Hamilton rotation takes the body's axes to ECI: no inverse.
The *matrix* [BN] is the inverse. Axes are taken as they are: GMAT's EarthMJ2000Eq is 44 mas from
EME2000, EME2000 23 mas from GCRF, 0.8 m at 7000 km.

Each of sensors, inputs and truth may have a `file` and a `time` of its own, `transpose = true` for
arrays with a column for each time, `missing = "skip"` for rows with NaN, which are else refused;
`sigma`, columns of sigmas in `sigma_unit`; a sensor an `id`, a column or a number.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError
from relnav_graph.files import file_in
from relnav_graph.io.columns import Columns, read_columns
from relnav_graph.io.declared import Collected
from relnav_graph.io.known import Known
from relnav_graph.io.lines import file_of, rising
from relnav_graph.io.mapping import Target, targets_of

__all__ = ["FILES", "check", "read"]

FILES = True
_PATTERNS = ("*.npz", "*.mat", "*.csv", "*.tsv", "*.txt")


def _files(
    path: Path, targets: list[Target], file: str, form: tuple[str, bool, int]
) -> list[Columns]:
    """The file of each target; each is read once."""
    read: dict[Path, Columns] = {}
    found = []
    for target in targets:
        if target.file and path.is_file():
            raise InputError(f"{target.where}.file: found {path}, expected a folder")
        own = file_in(path, target.file) if target.file else file_of(path, _PATTERNS, file)
        if own not in read:
            read[own] = read_columns(own, *form)
        found.append(read[own])
    return found


def check(
    known: Known,
    time: Any = None,
    sensors: Any = None,
    inputs: Any = None,
    truth: Any = None,
    **_: Any,
) -> None:
    """Raise InputError on names that the scenario does not have, on units and on clocks."""
    given = {"sensors": sensors, "inputs": inputs, "truth": truth}
    named = {"sensors": known.check_sensor, "inputs": known.check_input, "truth": known.check_truth}
    for target in targets_of(given, time, known):
        named[target.role](target.where, target.name)


def read(
    path: Path,
    known: Known,
    time: Mapping[str, Any] | None = None,
    sensors: Mapping[str, Any] | None = None,
    inputs: Mapping[str, Any] | None = None,
    truth: Mapping[str, Any] | None = None,
    file: str = "",
    separator: str = "",
    header: bool = True,
    skip: int = 0,
) -> Recording:
    """What is named, of one or several files.

    time: the stamps, see `relnav_graph.io.stamp_columns.StampColumn`; sensors, inputs, truth: by
    the name of a sensor, an input or a block, see above; file: a part of the name, in a folder with
    several; separator, header, skip: of texts, see `relnav_graph.io.columns.read_columns`. All
    stamps are of one clock, whose earliest sets t = 0, see `relnav_graph.io.clocks.Clock`.

    Raises InputError when nothing is named or a unit or clock is not, on columns that are not
    there, with those that are, on arrays of other lengths, and, with the row, on NaN, times out of
    order, and attitudes that are none within 1e-3.
    """
    given = {"sensors": sensors, "inputs": inputs, "truth": truth}
    targets = targets_of(given, time, known)
    files = _files(path, targets, file, (separator, header, skip))
    clocks = {(t.time.clock.name, str(t.time.clock.origin)) for t in targets}
    if len(clocks) > 1:
        raise InputError(f"data.options: found stamps of the clocks {sorted(clocks)}, expected one")
    clock = targets[0].time.clock
    stamps = [t.time.read(columns) for t, columns in zip(targets, files, strict=True)]
    firsts = [
        clock.begin(str(c.path), min(s)) for s, c in zip(stamps, files, strict=True) if len(s)
    ]
    if not firsts:
        raise InputError(f"{path}: found no rows")
    begin = min(firsts)
    found = Collected(known, ", ".join(dict.fromkeys(c.path.name for c in files)))
    for target, columns, own in zip(targets, files, stamps, strict=True):
        t = clock.seconds(own, begin)
        rising(columns.where, t, target.role != "sensors")
        target.add(found, columns, t)
    return found.recording(clock.settings(begin))
