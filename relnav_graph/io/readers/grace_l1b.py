"""Reader of Level-1B data of GRACE and GRACE-FO, as the ASCII files of JPL and GFZ.

A header that ends with the line ``# End of YAML header``, then rows separated by blanks, whose
widths the files do not keep; times are GPS seconds after 2000-01-01 12:00. By the product, with ID
the letter of a spacecraft (A and B, C and D) or Y for both:

- ``GNV1B_DATE_ID_*``, ``GNI1B_DATE_ID_*``: orbits, Earth-fixed (which are turned to GCRF) and
  inertial, m, m/s. They are the truth.
- ``KBR1B_DATE_Y_*``, ``LRI1B_DATE_Y_*``: range of microwaves or of the laser, with a constant that
  nobody knows and that changes at a phase break, and its rate. Corrections for the light time and
  for the antennas' place ahead of the centres of mass stand beside, and are added.
- ``SCA1B_DATE_ID_*``: attitude, scalar first. The matrix of the Hamilton quaternion takes the axes
  of the science reference frame (c: x to the other spacecraft but for the pitch, z down) to those
  of GCRF.

i is GCRF, and o is i. Source: Wen et al. 2019, GRACE-FO Level-1 Data Product User Handbook, JPL
D-56935.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from relnav_graph.arrays import Array
from relnav_graph.core.absolute_time import AbsoluteTime
from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError
from relnav_graph.io.declared import Collected
from relnav_graph.io.known import Known
from relnav_graph.io.lines import text_of
from relnav_graph.io.orbits import (
    SAME,
    Orbit,
    celestial,
    check_state,
    excess,
    in_common,
    in_order,
    relative_truth,
    roles,
    split,
)
from relnav_graph.io.poses import from_quaternions, quaternions
from relnav_graph.maths.instants import Instant

__all__ = ["read"]

_LOG = logging.getLogger(__name__)
_END, _EPOCH = "# End of YAML header", "2000-01-01T12:00:00"
#: Modified Julian day and second of it, GPS, of time zero.
_DAY, _NOON = 51544, 43200.0
_AXES = ("x", "y", "z")
_ORBIT = (
    "gps_time",
    "GRACEFO_id",
    "coord_ref",
    *(f"{a}pos" for a in _AXES),
    *(f"{a}pos_err" for a in _AXES),
    *(f"{a}vel" for a in _AXES),
    *(f"{a}vel_err" for a in _AXES),
    "qualflg",
)
_RANGE = (
    "gps_time",
    *("biased_range", "range_rate", "range_accl", "iono_corr"),
    *("lighttime_corr", "lighttime_rate", "lighttime_accl"),
    *("ant_centr_corr", "ant_centr_rate", "ant_centr_accl"),
    *("K_A_SNR", "Ka_A_SNR", "K_B_SNR", "Ka_B_SNR", "qualflg"),
)
_ATTITUDE = ("gps_time", "GRACEFO_id", "sca_id", "q_0", "q_1", "q_2", "q_3", "qual_rss", "qualflg")
_WORDS = {"GRACEFO_id", "coord_ref", "qualflg"}


@dataclass(frozen=True, eq=False)
class _Product:
    """Numbers by name of a file's columns, (N,) each; of those that are words, the words."""

    path: Path
    lines: list[int]
    numbers: dict[str, Array]
    words: dict[str, list[str]]

    def where(self, row: int) -> str:
        return f"{self.path}, line {self.lines[row]}"

    def stack(self, *names: str) -> Array:
        return np.column_stack([self.numbers[name] for name in names])

    def of(self, rows: NDArray[np.bool_]) -> _Product:
        """Some rows."""
        return _Product(
            self.path,
            [n for n, good in zip(self.lines, rows, strict=True) if good],
            {name: values[rows] for name, values in self.numbers.items()},
            {
                name: [w for w, good in zip(words, rows, strict=True) if good]
                for name, words in self.words.items()
            },
        )


def _product(path: Path, columns: Sequence[str], leave_flagged: bool) -> _Product:
    lines = text_of(path).splitlines()
    ends = [n for n, line in enumerate(lines) if line.strip() == _END]
    if not ends:
        raise InputError(f"{path}: found {len(lines)} lines and no line {_END!r}")
    for number, line in enumerate(lines[: ends[0]], 1):
        match = re.match(r"\s*epoch_time\s*:\s*(\S+)", line)
        if match and not match[1].strip("\"'").startswith(_EPOCH):
            raise InputError(
                f"{path}, line {number}: found epoch_time {match[1]}, expected {_EPOCH}"
            )
    at = [n for n in range(ends[0] + 1, len(lines)) if lines[n].strip()]
    rows = [lines[n].split() for n in at]
    for n, row in zip(at, rows, strict=True):
        if len(row) != len(columns):
            raise InputError(
                f"{path}, line {n + 1}: found {len(row)} columns, expected {len(columns)}:"
                f" {' '.join(columns)}"
            )
    if not rows:
        raise InputError(f"{path}: found no row below the header")
    told = re.search(r"^\s*num_records\s*:\s*(\d+)", "\n".join(lines[: ends[0]]), re.MULTILINE)
    if told and int(told[1]) != len(rows):
        _LOG.warning(f"{path}: found {len(rows)} rows, and num_records {told[1]}: is it a part?")
    words, numbers = dict[str, list[str]](), dict[str, Array]()
    for k, name in enumerate(columns):
        column = [row[k] for row in rows]
        if name in _WORDS:
            words[name] = column
        else:
            numbers[name] = _numbers(path, at, name, column)
    product = _Product(path, [n + 1 for n in at], numbers, words)
    in_order(path, product.lines, numbers["gps_time"])
    return _flagged(product, leave_flagged)


def _numbers(path: Path, at: list[int], name: str, column: list[str]) -> Array:
    try:
        found = np.array(column, dtype=np.float64)
    except ValueError:
        found = np.array([_number(word) for word in column])
    bad = np.nonzero(~np.isfinite(found))[0]
    if len(bad):
        k = int(bad[0])
        raise InputError(
            f"{path}, line {at[k] + 1}, column {name}: found {column[k]!r}, expected a number"
        )
    return found


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return np.nan


def _flagged(product: _Product, leave_out: bool) -> _Product:
    """The product, without rows whose quality flags say anything, if they are to be left out."""
    good = np.array([not flag.strip("0") for flag in product.words["qualflg"]])
    if good.all():
        return product
    what = "left out" if leave_out else "kept"
    _LOG.info(f"{product.path}: {int((~good).sum())} of {len(good)} rows are flagged, and {what}")
    return product.of(good) if leave_out else product


def _find(folder: Path, product: str, craft: str, run: str) -> list[Path]:
    found = sorted(folder.glob(f"{product}_*_{craft}_*"))
    return [p for p in found if run in p.name]


def _one(folder: Path, product: str, craft: str, run: str) -> Path:
    found = _find(folder, product, craft, run)
    if len(found) != 1:
        names = ", ".join(p.name for p in found) or "no file"
        raise InputError(
            f"{folder}: found {names}, expected one {product}_*_{craft}_*; data.options.run is a"
            " part of the name, such as the date"
        )
    return found[0]


def _orbit(path: Path, leave_flagged: bool) -> tuple[Orbit, bool]:
    """An orbit, named by the spacecraft's letter, and whether it is Earth-fixed."""
    product = _product(path, _ORBIT, leave_flagged)
    frames, names = set(product.words["coord_ref"]), set(product.words["GRACEFO_id"])
    if len(frames) != 1 or not frames <= {"E", "I"} or len(names) != 1:
        raise InputError(
            f"{path}: found coord_ref {', '.join(sorted(frames))} of {', '.join(sorted(names))},"
            " expected E or I of one spacecraft"
        )
    state = product.stack(*(f"{a}{q}" for q in ("pos", "vel") for a in _AXES))
    for k, row in enumerate(state):
        check_state(product.where(k), row.tolist())
    seconds = product.numbers["gps_time"] + _NOON
    day = np.full(len(state), float(_DAY))
    return Orbit(path, names.pop(), day, seconds, np.ascontiguousarray(state)), frames == {"E"}


def _pair(folder: Path, product: str, run: str, leave: bool) -> tuple[list[Orbit], bool]:
    """Both orbits, and whether they are Earth-fixed."""
    wanted = (product,) if product else ("GNI1B", "GNV1B")
    for name in wanted:
        paths = _find(folder, name, "[ABCD]", run)
        if len(paths) == 2:
            (one, fixed), (other, also) = (_orbit(p, leave) for p in paths)
            if fixed != also:
                raise InputError(f"{paths[0]} and {paths[1]}: found one Earth-fixed, one inertial")
            return [one, other], fixed
    found = [p.name for name in wanted for p in _find(folder, name, "[ABCD]", run)]
    raise InputError(
        f"{folder}: found {', '.join(found) or 'no file'}, expected two of"
        f" {' or '.join(wanted)}; data.options.run is a part of both names, such as the date"
    )


def read(
    folder: Path,
    known: Known,
    range: str = "",
    range_rate: str = "",
    attitude: str = "",
    instrument: str = "KBR1B",
    orbit: str = "",
    run: str = "",
    chaser: str = "",
    start: float = 0.0,
    duration: float | None = None,
    orientation: str = "",
    leave_flagged: bool = False,
) -> Recording:
    """Orbits of both spacecraft, and what is named of their link and of the chaser's attitude.

    range, range_rate, attitude: names of the sensors that get them, "": none; instrument: "KBR1B"
    or "LRI1B"; orbit: "GNI1B" or "GNV1B", by default the first of which there are two; run: a part
    of all names, such as the date; chaser: its letter, else the second of the two; start, duration:
    the part of the pass to take, s from its first epoch; orientation: a file finals2000A of the
    IERS, as of [time], with which Earth-fixed orbits are turned, too; leave_flagged: rows whose
    quality flags say anything are left out. Times start at zero with the first epoch taken.

    Measurements: range and rate, m and m/s, (1, 1), with both corrections; attitude, q_wxyz of
    R_ic. Truth: relative_position r_tc, relative_velocity v_tc, chaser_position r_c,
    chaser_velocity v_c, m, m/s, in i; chaser_attitude R_ic where there is an SCA1B that is not a
    sensor's; with the range range_bias, m, the mean over the pass of what it is more than the
    distance of the orbits, and range_drift, the rest; the same of the rate. Settings: the absolute
    time of t = 0.

    Raises InputError, with file and line, on files that are missing, damaged, of another time zero,
    and when they have no two epochs in common.
    """
    if instrument not in ("KBR1B", "LRI1B"):
        raise InputError(f"data.options.instrument: found {instrument!r}, expected KBR1B or LRI1B")
    pair, fixed = _pair(folder, orbit, run, leave_flagged)
    target, craft = roles(folder, pair, chaser)
    t, state_t, state_c = in_common(target, craft, float(_DAY), start, duration)
    first, end = float(t[0]), float(t[-1])
    times, begin = t - first, Instant.of(_DAY, first, "GPS")
    table = AbsoluteTime(str(begin), orientation).table if fixed else None

    def inertial(state: Array) -> tuple[Array, Array]:
        return celestial(begin, times, state, table) if fixed else split(state)

    truth = relative_truth(inertial(state_t), inertial(state_c))
    found = Collected(known, f"{craft.path.name} (chaser) and {target.path.name} (target)")
    for name, value in truth.items():
        found.add_truth(str(folder), name, times, value)

    def taken(product: _Product) -> tuple[_Product, Array]:
        """The rows of the part of the pass, and their times (N,), s."""
        at = product.numbers["gps_time"] + _NOON - first
        rows = (at >= -SAME) & (at <= end - first + SAME)
        return product.of(rows), at[rows]

    if range or range_rate:
        link = _product(_one(folder, instrument, "Y", run), _RANGE, leave_flagged)
        r_tc, v_tc = truth["relative_position"], truth["relative_velocity"]
        line = r_tc / np.linalg.norm(r_tc, axis=1, keepdims=True)
        orbits = {
            "range": np.linalg.norm(r_tc, axis=1),
            "range_rate": np.einsum("ni,ni->n", line, v_tc),
        }
        _add_link(found, *taken(link), times, orbits, {"range": range, "range_rate": range_rate})
    if attitude or _find(folder, "SCA1B", craft.name, run):
        path = _one(folder, "SCA1B", craft.name, run)
        product, at = taken(_product(path, _ATTITUDE, leave_flagged))
        q = product.stack("q_0", "q_1", "q_2", "q_3")
        R = from_quaternions(product.where, q, "wxyz")
        if attitude:
            found.add_rows(attitude, at, quaternions(R))
        else:
            found.add_truth(str(path), "chaser_attitude", at, R)
    return found.recording({"time": {"epoch": str(begin)}})


#: Columns of a range, or of its rate: as measured, and what is added.
_SUMS = {
    "range": ("biased_range", "lighttime_corr", "ant_centr_corr"),
    "range_rate": ("range_rate", "lighttime_rate", "ant_centr_rate"),
}


def _add_link(
    found: Collected,
    link: _Product,
    at: Array,
    times: Array,
    orbits: dict[str, Array],
    sensors: dict[str, str],
) -> None:
    """Ranges and rates at (N,), s, and what they are more than what the orbits (M,) at times (M,),
    s, say: a bias and a drift."""
    for quantity, sensor in sensors.items():
        if not sensor:
            continue
        z = link.stack(*_SUMS[quantity]).sum(axis=1)
        found.add_rows(sensor, at, z[:, None])
        bias, drift = excess(link.path, at, z, times, orbits[quantity], like=False)
        found.add_truth(str(link.path), f"{quantity}_bias", times, bias)
        found.add_truth(str(link.path), f"{quantity}_drift", times, drift)
