"""JSON lines: what `relnav simulate -o -` writes and `relnav stream` reads and writes.

One object a line, in UTF-8. SI and radians; attitudes are Hamilton quaternions, scalar
first, w >= 0. In come, in any order,

::

    {"format": "relnav-lines", "version": 1, "scenario": "zhang2015", "seed": 0, "t": 0.0,
     "prior": {"relative_position": [x, y, z], "target_attitude": [w, x, y, z], ...}}
    {"sensor": "beacons", "t": 10.0, "id": [0, 1], "z": [[...], [...]], "t_arrival": 10.4}
    {"input": "gyro", "t_start": 0.0, "t_end": 10.0, "values": [...], "t_arrival": 10.1}
    {"epoch": 20.0}

- The first is the *header*, at most once and before all others; it may be missing. `prior` gives
  means at time `t` for blocks that the scenario has drawn about the truth, `settings` what a
  recording brings for the scenario (camera constants, points): data, which never name a module.
- A *measurement*: what a sensor saw at its time of validity t, a row of `z` for each id. A loop
  closure has the time of the earlier epoch, one of the sensor's keyframes, as `t_from`.
  `covariance`: for each id that of its residual, a list of rows, in place of what the sensor says.
- An *input*: the mean of a known input over [t_start, t_end].
- An *epoch*: an estimate is wanted at a time at which nothing was measured.
- `t_arrival`: when it became known, on the same clock; without it, at its own time.
- `n`: number of the line, increasing, where the writer counts. A line whose number is not
  above that of the last one taken in is a repeat and skipped, unless its time is new: so a
  sender may begin again from the start, or count anew.

A stream has one *clock*: that of the header's `t`, or else of the first line taken in.

- Times may come in any order within the window (`online.window`, or 30 epochs); what comes
  later than that is refused ("late").
- A time further than --max-gap from the newest one heard of, or beyond 1e10 s (milliseconds?),
  is of another clock and refused ("clock"). What is refused moves no clock.
- Where the times of arrival of a sensor or an input go back by more than the window, and run
  on from there, they are refused until they jump forward again, also when they have come to
  the newest time once more; a clock that was set for good begins a new stream. Within the
  window a jump back cannot be told from lateness, unless a sensor gives another value for a
  time and id that it has measured ("second value"), or an input one that overlaps ("overlap").
- A jump forward by more than the window, and five times the steps before, is taken for a
  silence: the state is propagated, with growing covariance.
- Each of these jumps is said at once, by a line out that is DEGRADED (LOST before the first
  estimate): once for each sensor or input, until a line of it is taken in again.

Epochs that the inputs do not reach wait for them, and where they have not come for as long as the
window (or 30 s), the gap is bridged as the scenario's [gaps] say; an epoch in a longer one is
refused, and its line LOST. What the inputs reach again after it is estimated from the last estimate
before, their last means held and spread over all that is missing: DEGRADED as long as the window,
and with the caution "begun again" in all lines from there on.

Out goes a line for each epoch, and for each one that a late measurement improves:

::

    {"seq": 7, "t": 70.0, "status": "OK", "message": "",
     "estimate": {"relative_position": {"value": [x, y, z], "sigma": [sx, sy, sz]}, ...},
     "rejected": [{"sensor": "beacons", "t": 70.0, "id": 3, "reason": "..."}],
     "latency_ms": 0.8}

- `seq` counts the lines out, from 0. `t` is the newest epoch: it comes again when a late
  measurement has improved its estimate.
- `status`: OK, INITIALISING (with unknown points, until the target has turned by a quarter: what
  is told of it depends on the prior), DEGRADED (the estimate is fed by less than it should be, or
  its residuals do not fit), LOST (not to be used). `message` says why. `estimate` is null where
  there is none.
- `sigma` of an attitude are angles about the axes of its right-hand frame; null where there is
  none, as of the principal axes of two equal moments.
- `rejected`: what was not used since the line before, and why; `id` null for all of a line.
- `cautions`: what leaves the status as it is, and must be known all the same, as
  {"name": ..., "text": ...}; the key is there only where there is any. At the end, an estimator
  that holds the whole pass (incremental, isam2) and is OK takes a second look at it
  (`relnav_graph.estimators.second_look`), about as long as two or three batch estimates of all
  epochs; what it finds is in a last line, "the end of the stream".
- All times out are of the pass's clock: a [time] origin is taken off all times in, that of the
  header too, a lag of [stamps] off those of its input, whose later samples are waited for.
- `latency_ms`: computing time, from the last line in that it needed to this line.
- `now`: with --predict-to-now, {"t": ..., "estimate": ...} at the newest time heard of; the
  newest inputs go on to it. Where there are none, `estimate` is null and `message` says so.

What waits to become an epoch is bounded: 100,000 samples of each input, epochs, and observations
of one time; more is refused ("full").
"""

from __future__ import annotations

import codecs
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, FailFast, Field, ValidationError
from pydantic_core import from_json

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import CopiesBlocks, Sensor
from relnav_graph.core.copies import closure_name
from relnav_graph.core.measurement import SAME_TIME, Measurement
from relnav_graph.errors import InputError, RelnavError
from relnav_graph.linear.whitening import inverse_cholesky, measurement_noise
from relnav_graph.scenario.schema import from_pydantic
from relnav_graph.streaming.clock import LATEST, check_reasonable

__all__ = [
    "Header",
    "InputSample",
    "LineError",
    "Tick",
    "header_of",
    "parse_line",
]

FORMAT, VERSION = "relnav-lines", 1
#: A longer line is refused unread: nothing that a sensor sees at one time fills it.
LONGEST = 1 << 20
#: No kind of line has as many keys.
MOST_KEYS = 20
NO_LAGS: Mapping[str, float] = MappingProxyType({})
#: Larger values, SI, are of no instrument, and their powers overflow.
LARGEST = 1e30


@dataclass(frozen=True, eq=False)
class Header:
    """What a stream says of itself; prior: means by block, as components, at time t, s."""

    scenario: str = ""
    seed: int | None = None
    t: float | None = None
    prior: Mapping[str, list[float]] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class InputSample:
    """Mean of a known input over [t_start, t_end], s: values (channels,)."""

    name: str
    t_start: float
    t_end: float
    values: Array
    t_arrival: float | None = None


@dataclass(frozen=True)
class Tick:
    """An epoch at t, s, without a measurement."""

    t: float
    t_arrival: float | None = None


class LineError(InputError):
    """A line that cannot be used: which sensor or input, what time, as far as it says so."""

    def __init__(self, reason: str, sensor: str | None = None, t: float | None = None) -> None:
        super().__init__(reason)
        self.reason, self.sensor, self.t = reason, sensor, t


#: One thing that is wrong is enough to say: a line may have a hundred thousand.
_Entry = TypeVar("_Entry")
_List = Annotated[list[_Entry], FailFast()]


class _Line(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    n: int | None = Field(default=None, ge=0, lt=2**63)
    t_arrival: float | None = None


class _HeaderLine(_Line):
    format: str
    version: int
    scenario: str = ""
    seed: int | None = None
    t: float | None = None
    prior: dict[str, _List[float]] = {}
    settings: dict[str, Any] = {}


class _MeasurementLine(_Line):
    sensor: str
    t: float
    t_from: float | None = None
    id: _List[Annotated[int, Field(ge=-(2**63), lt=2**63)]]
    z: _List[_List[float]]
    covariance: _List[_List[_List[float]]] = []


class _InputLine(_Line):
    input: str
    t_start: float
    t_end: float
    values: _List[float]


class _EpochLine(_Line):
    epoch: float


_KINDS: dict[str, type[_Line]] = {
    "format": _HeaderLine,
    "sensor": _MeasurementLine,
    "input": _InputLine,
    "epoch": _EpochLine,
}


def _check_time(what: str, t: float) -> None:
    if not np.isfinite(t):
        raise InputError(f"found {what} {t}, expected a finite time")


def _check_values(what: str, values: Array) -> None:
    if not (np.abs(values) <= LARGEST).all():
        raise InputError(f"found {what} {np.abs(values).max():.6g}, expected {LARGEST:g} at most")


def _header(line: _HeaderLine) -> Header:
    if (line.format, line.version) != (FORMAT, VERSION):
        raise LineError(
            f"header: found format {line.format!r}, version {line.version}, expected"
            f" {FORMAT!r}, version {VERSION}"
        )
    if line.t is not None:
        _check_time("header.t", line.t)
        check_reasonable(line.t)
    return Header(line.scenario, line.seed, line.t, line.prior, line.settings)


def _measurement(line: _MeasurementLine, sensors: Mapping[str, Sensor]) -> Measurement:
    name = line.sensor if line.t_from is None else closure_name(line.sensor, line.t_from)
    if name not in sensors or isinstance(sensors[name], CopiesBlocks):
        known = [n for n, s in sensors.items() if not isinstance(s, CopiesBlocks)]
        raise InputError(f"unknown sensor {name!r}; the scenario has {known}")
    widths = {len(row) for row in line.z}
    columns = sensors[name].columns
    if widths != {len(columns)}:
        raise InputError(f"found rows of z with {sorted(widths)} numbers, expected {columns}")
    ids = np.array(line.id, dtype=np.int64)
    if len(set(line.id)) < len(ids):
        raise InputError(f"found ids {line.id}, expected each one once")
    R = np.array(line.covariance) if line.covariance else None
    m = Measurement(name, line.t, np.array(line.z), ids, line.t_arrival, covariance=R)
    _check_values("z", m.z)
    try:
        sensors[name].accept(m.z)
        if m.covariance is not None:
            inverse_cholesky(f"sensor {name!r}", measurement_noise(name, sensors[name], m))
        sensors[name].observation_data(m.ids)
    except RelnavError:
        raise
    except Exception as error:  # a model's, which must not end the stream
        raise InputError(f"the model raised {type(error).__name__}: {error}") from error
    return m


def _input(line: _InputLine, inputs: Mapping[str, tuple[str, ...]]) -> InputSample:
    if line.input not in inputs:
        raise InputError(f"unknown input {line.input!r}; the processes have {list(inputs)}")
    values, columns = np.array(line.values), inputs[line.input]
    if len(values) != len(columns) or not np.isfinite(values).all():
        raise InputError(f"found values {line.values}, expected finite numbers {columns}")
    _check_values("values", values)
    _check_time("t_start", line.t_start)
    _check_time("t_end", line.t_end)
    if line.t_end - line.t_start <= SAME_TIME:
        raise InputError(f"found {line.t_start} s to {line.t_end} s, expected times that run on")
    return InputSample(line.input, line.t_start, line.t_end, values, line.t_arrival)


def _checked(
    line: _Line, sensors: Mapping[str, Sensor], inputs: Mapping[str, tuple[str, ...]]
) -> Header | Measurement | InputSample | Tick:
    if isinstance(line, _HeaderLine):
        return _header(line)
    if line.t_arrival is not None:
        _check_time("t_arrival", line.t_arrival)
    if isinstance(line, _MeasurementLine):
        return _measurement(line, sensors)
    if isinstance(line, _InputLine):
        return _input(line, inputs)
    assert isinstance(line, _EpochLine)
    _check_time("epoch", line.epoch)
    return Tick(line.epoch, line.t_arrival)


def _named(raw: Mapping[str, Any], origin: float) -> tuple[str | None, float | None]:
    """Sensor or input, and time since `origin`, s, that a line which cannot be used names."""
    name = raw.get("sensor", raw.get("input"))
    t = raw.get("t", raw.get("t_end", raw.get("epoch")))
    name = name if isinstance(name, str) else None
    is_time = isinstance(t, int | float) and not isinstance(t, bool)
    if not is_time or not abs(t) <= LATEST + abs(origin):
        return name, None
    return name, float(t) - origin


def _since(origin: float, lags: Mapping[str, float], line: _Line) -> _Line:
    """The line with its times counted from `origin`, s, and its stamps without lag."""
    late = origin + lags.get(getattr(line, "sensor", getattr(line, "input", "")), 0.0)
    off = dict.fromkeys(("t", "t_from", "t_start", "t_end"), late)
    off |= {"epoch": origin, "t_arrival": origin}
    found = {name: getattr(line, name, None) for name, by in off.items() if by}
    return line.model_copy(update={n: t - off[n] for n, t in found.items() if t is not None})


def _other_form(text: bytes) -> str:
    """What a line belongs to that people take for lines of JSON, or ""."""
    if text.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "UTF-16, expected UTF-8"
    if text.strip() == b"{":
        return "an object over many lines, expected an object on each line"
    if text.lstrip().startswith(b"["):
        return "an array, expected an object on each line"
    return ""


def _object(text: bytes) -> dict[str, Any]:
    """The object that a line is, after the mark that some editors put before a first line. Raises
    LineError, which says what is there instead."""
    text = text.removeprefix(codecs.BOM_UTF8)
    try:
        if len(text) > LONGEST:
            raise ValueError(f"{len(text)} bytes, expected {LONGEST} at most")
        if other := _other_form(text):
            raise ValueError(other)
        raw = from_json(text)
        if not isinstance(raw, dict):
            raise ValueError("expected an object")
        if len(raw) > MOST_KEYS:
            raise ValueError(f"{len(raw)} keys, expected {MOST_KEYS} at most")
    except ValueError as error:
        start = text[:60].decode("utf-8", "replace")
        raise LineError(f"not a line of JSON: {error}; found {start!r}") from error
    return raw


def parse_line(
    text: bytes,
    sensors: Mapping[str, Sensor],
    inputs: Mapping[str, tuple[str, ...]],
    origin: float = 0.0,
    lags: Mapping[str, float] = NO_LAGS,
) -> tuple[int | None, Header | Measurement | InputSample | Tick]:
    """The number of a line, where it has one, and what it says.

    inputs: columns of each input, by name; origin: s, taken off all its times; lags: of sensors and
    inputs, s, taken off their stamps. Raises LineError on whatever is wrong with it.
    """
    raw = _object(text)
    kinds = [kind for key, kind in _KINDS.items() if key in raw]
    try:
        if len(kinds) != 1:
            raise InputError(f"found keys {list(raw)}, expected one of {', '.join(_KINDS)}")
        line = _since(origin, lags, kinds[0].model_validate(raw))
        return line.n, _checked(line, sensors, inputs)
    except ValidationError as error:
        problems = "; ".join(f"{path}: {text[:200]}" for path, text in from_pydantic("line", error))
        raise LineError(problems, *_named(raw, origin)) from error
    except (RelnavError, OverflowError) as error:
        raise LineError(str(error), *_named(raw, origin)) from error


def header_of(first: bytes, origin: float = 0.0) -> Header:
    """The header that a first line is, or an empty one when it is something else.

    origin: s, taken off its time. Raises LineError when it is a header that cannot be used.
    """
    try:
        raw = _object(first)
    except LineError:
        if _other_form(first.removeprefix(codecs.BOM_UTF8)):
            raise  # nor will the lines that follow be of use
        return Header()
    if "format" not in raw:
        return Header()
    header = parse_line(first, {}, {}, origin)[1]
    assert isinstance(header, Header)
    return header
