"""JSON lines: what `relnav simulate -o -` writes and `relnav stream` reads and writes.

One object a line, in UTF-8. SI and radians; attitudes are Hamilton quaternions, scalar
first, w >= 0. In come, in any order,

::

    {"format": "relnav-lines", "version": 1, "scenario": "zhang2015", "seed": 0, "t": 0.0,
     "prior": {"relative_position": [x, y, z], "target_attitude": [w, x, y, z], ...}}
    {"sensor": "beacons", "t": 10.0, "id": [0, 1], "z": [[...], [...]], "t_arrival": 10.4}
    {"input": "gyro", "t_start": 0.0, "t_end": 10.0, "values": [...], "t_arrival": 10.1}
    {"epoch": 20.0}

- The first is the *header*, at most once and before all others; it may be missing. `prior`
  gives means at time `t` for blocks that the scenario has drawn about the truth, `settings`
  what a recording brings for the scenario (camera constants, points).
- A *measurement*: what a sensor saw at its time of validity t, a row of `z` for each id.
- An *input*: the mean of a known input over [t_start, t_end].
- An *epoch*: an estimate is wanted at a time at which nothing was measured.
- `t_arrival`: when it became known, on the same clock; without it, at its own time.
- `n`: number of the line, increasing, where the writer counts. A line whose number is not
  above the last one read is a repeat and skipped: so a sender may begin again from the start.

Out goes a line for each epoch, and for each one that a late measurement improves:

::

    {"seq": 7, "t": 70.0, "status": "OK", "message": "",
     "estimate": {"relative_position": {"value": [x, y, z], "sigma": [sx, sy, sz]}, ...},
     "rejected": [{"sensor": "beacons", "t": 70.0, "id": 3, "reason": "..."}],
     "latency_ms": 0.8}

- `seq` counts the lines out, from 0. `t` is the newest epoch: it comes again when a late
  measurement has improved its estimate.
- `status`: OK, DEGRADED (the estimate is fed by less than it should be, or its residuals do
  not fit), LOST (not to be used). `message` says why. `estimate` is null where there is none.
- `sigma` of an attitude are angles about the axes of its right-hand frame.
- `rejected`: what was not used since the line before, and why; `id` null for all of a line,
  `sensor` null for a line that names none.
- `cautions`: what leaves the status as it is, and must be known all the same, as
  {"name": ..., "text": ...}; the key is there only where there is any.
- All times out are of the pass's clock: where the scenario has a [time] origin, that is taken
  off all times in, `t` of the header too.
- `latency_ms`: computing time, from the last line in that it needed to this line.
- `now`: with --predict-to-now, {"t": ..., "estimate": ...} at the newest time heard of that
  the inputs reach.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import from_json

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import Derived, Sensor
from relnav_graph.core.measurement import SAME_TIME, Measurement
from relnav_graph.core.problem import Prior
from relnav_graph.core.state import Block, Layout
from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError, RelnavError
from relnav_graph.io.tabular import from_components, to_components
from relnav_graph.scenario.schema import from_pydantic

__all__ = [
    "Header",
    "InputSample",
    "LineError",
    "Tick",
    "dump",
    "estimate_object",
    "header_of",
    "input_object",
    "measurement_object",
    "parse_line",
    "prior_values",
    "recording_lines",
]

FORMAT, VERSION = "relnav-lines", 1
#: A longer line is refused unread: nothing that a sensor sees at one time fills it.
LONGEST = 1 << 20


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


class _Line(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    n: int | None = Field(default=None, ge=0)
    t_arrival: float | None = None


class _HeaderLine(_Line):
    format: str
    version: int
    scenario: str = ""
    seed: int | None = None
    t: float | None = None
    prior: dict[str, list[float]] = {}
    settings: dict[str, Any] = {}


class _MeasurementLine(_Line):
    sensor: str
    t: float
    id: list[Annotated[int, Field(ge=-(2**63), lt=2**63)]]
    z: list[list[float]]


class _InputLine(_Line):
    input: str
    t_start: float
    t_end: float
    values: list[float]


class _EpochLine(_Line):
    epoch: float


_KINDS: dict[str, type[_Line]] = {
    "format": _HeaderLine,
    "sensor": _MeasurementLine,
    "input": _InputLine,
    "epoch": _EpochLine,
}


def _header(line: _HeaderLine) -> Header:
    if (line.format, line.version) != (FORMAT, VERSION):
        raise LineError(
            f"header: found format {line.format!r}, version {line.version}, expected"
            f" {FORMAT!r}, version {VERSION}"
        )
    return Header(line.scenario, line.seed, line.t, line.prior, line.settings)


def _measurement(line: _MeasurementLine, sensors: Mapping[str, Sensor]) -> Measurement:
    if line.sensor not in sensors:
        raise InputError(f"unknown sensor {line.sensor!r}; the scenario has {list(sensors)}")
    widths = {len(row) for row in line.z}
    columns = sensors[line.sensor].columns
    if widths != {len(columns)}:
        raise InputError(f"found rows of z with {sorted(widths)} numbers, expected {columns}")
    ids = np.array(line.id, dtype=np.int64)
    if len(set(line.id)) < len(ids):
        raise InputError(f"found ids {line.id}, expected each one once")
    m = Measurement(line.sensor, line.t, np.array(line.z), ids, line.t_arrival)
    try:
        sensors[line.sensor].accept(m.z)
        sensors[line.sensor].observation_data(m.ids)
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
    if not np.isfinite([line.t_start, line.t_end]).all() or line.t_end <= line.t_start:
        raise InputError(f"found {line.t_start} s to {line.t_end} s, expected times that run on")
    return InputSample(line.input, line.t_start, line.t_end, values, line.t_arrival)


def _checked(
    line: _Line, sensors: Mapping[str, Sensor], inputs: Mapping[str, tuple[str, ...]]
) -> Header | Measurement | InputSample | Tick:
    if isinstance(line, _HeaderLine):
        return _header(line)
    if line.t_arrival is not None and not np.isfinite(line.t_arrival):
        raise InputError(f"found t_arrival {line.t_arrival}, expected a finite time")
    if isinstance(line, _MeasurementLine):
        return _measurement(line, sensors)
    if isinstance(line, _InputLine):
        return _input(line, inputs)
    assert isinstance(line, _EpochLine)
    if not np.isfinite(line.epoch):
        raise InputError(f"found epoch {line.epoch}, expected a finite time")
    return Tick(line.epoch, line.t_arrival)


def _named(raw: Mapping[str, Any]) -> tuple[str | None, float | None]:
    """Sensor or input, and time, that a line which cannot be used names."""
    name = raw.get("sensor", raw.get("input"))
    t = raw.get("t", raw.get("t_end", raw.get("epoch")))
    is_time = isinstance(t, int | float) and not isinstance(t, bool) and abs(t) < np.inf
    return name if isinstance(name, str) else None, float(t) if is_time and t is not None else None


def _since(origin: float, line: _Line) -> _Line:
    """The line with its times counted from `origin`, s."""
    times = ("t", "t_start", "t_end", "epoch", "t_arrival") if origin else ()
    found = {name: getattr(line, name, None) for name in times}
    return line.model_copy(update={n: t - origin for n, t in found.items() if t is not None})


def parse_line(
    text: bytes,
    sensors: Mapping[str, Sensor],
    inputs: Mapping[str, tuple[str, ...]],
    origin: float = 0.0,
) -> tuple[int | None, Header | Measurement | InputSample | Tick]:
    """The number of a line, where it has one, and what it says.

    inputs: columns of each input, by name; origin: s, taken off all its times. Raises LineError on
    whatever is wrong with it.
    """
    try:
        if len(text) > LONGEST:
            raise ValueError(f"{len(text)} bytes, expected {LONGEST} at most")
        raw = from_json(text)
        if not isinstance(raw, dict):
            raise ValueError("expected an object")
    except ValueError as error:
        start = text[:60].decode("utf-8", "replace")
        raise LineError(f"not a line of JSON: {error}; found {start!r}") from error
    kinds = [kind for key, kind in _KINDS.items() if key in raw]
    try:
        if len(kinds) != 1:
            raise InputError(f"found keys {list(raw)[:20]}, expected one of {', '.join(_KINDS)}")
        line = _since(origin, kinds[0].model_validate(raw))
        return line.n, _checked(line, sensors, inputs)
    except ValidationError as error:
        problems = "; ".join(f"{path}: {text[:200]}" for path, text in from_pydantic("line", error))
        raise LineError(problems, *_named(raw)) from error
    except (RelnavError, OverflowError) as error:
        raise LineError(str(error), *_named(raw)) from error


def header_of(first: bytes, origin: float = 0.0) -> Header:
    """The header that a first line is, or an empty one when it is something else.

    origin: s, taken off its time. Raises LineError when it is a header that cannot be used.
    """
    try:
        raw = from_json(first)
    except ValueError:
        return Header()
    if not isinstance(raw, dict) or "format" not in raw:
        return Header()
    header = parse_line(first, {}, {}, origin)[1]
    assert isinstance(header, Header)
    return header


def prior_values(header: Header, layout: Layout) -> dict[str, Array]:
    """Values of the blocks whose prior means a header gives, by name.

    (3, 3) for an attitude, else (dim,), SI, in the block's frame. Raises InputError.
    """
    out = {}
    for name, components in header.prior.items():
        if name not in layout:
            raise InputError(f"header: prior.{name}: the state has {[b.name for b in layout]}")
        block, found = layout.block(name), np.array(components)
        length = 4 if block.manifold == "SO3" else block.dim
        if found.shape != (length,) or not np.isfinite(found).all():
            raise InputError(f"header: prior.{name}: found {components}, expected {length} numbers")
        if block.manifold == "SO3" and abs(np.linalg.norm(found) - 1) > 1e-6:
            raise InputError(
                f"header: prior.{name}: found {components}, expected a unit quaternion"
            )
        out[name] = from_components(block, found[None])[0]
    return out


def dump(value: Mapping[str, Any]) -> str:
    """One line of strict JSON, without its end; the shortest digits that read back the same."""
    return json.dumps(value, allow_nan=False, separators=(", ", ": "))


def _components(block: Block, value: Array) -> list[float]:
    out: list[float] = to_components(block, value[None])[0].tolist()
    return out


def _sigmas(P: Array) -> list[float]:
    out: list[float] = np.sqrt(np.diag(P)).tolist()
    return out


def estimate_object(
    layout: Layout, derived: Iterable[Derived], x: Array, P: Array
) -> dict[str, dict[str, list[float]]]:
    """`estimate` of an output line: blocks, and quantities derived from them, with sigmas.

    x (size,): stored vector; P (n, n): its covariance; SI. Attitudes come as quaternions, w first.
    """
    found = {}
    values = layout.values(x)
    for block in layout:
        rows = layout.tangent(block.name)
        value = _components(block, values[block.name])
        found[block.name] = {"value": value, "sigma": _sigmas(P[rows, rows])}
    for quantity in derived:
        derived_value, J = quantity.value(*(values[b.name] for b in quantity.reads))
        _, tangent = layout.gather(quantity.reads)
        found[quantity.block.name] = {
            "value": _components(quantity.block, derived_value),
            "sigma": _sigmas(J @ P[np.ix_(tangent, tangent)] @ J.T),
        }
    return found


def measurement_object(m: Measurement) -> dict[str, Any]:
    """A measurement as a line in."""
    line = {"sensor": m.sensor, "t": float(m.t), "id": m.ids.tolist(), "z": m.z.tolist()}
    return line if m.t_arrival is None else {**line, "t_arrival": float(m.t_arrival)}


def input_object(sample: InputSample) -> dict[str, Any]:
    """A sample of an input as a line in."""
    line = {
        "input": sample.name,
        "t_start": sample.t_start,
        "t_end": sample.t_end,
        "values": sample.values.tolist(),
    }
    return line if sample.t_arrival is None else {**line, "t_arrival": sample.t_arrival}


def recording_lines(
    recording: Recording, name: str, seed: int, layout: Layout, prior: Prior
) -> Iterator[str]:
    """A recording as the lines of a stream, in order of arrival, numbered.

    prior: its mean goes into the header, as the estimators of a comparison get it.
    """
    mean = {b.name: _components(b, layout.value(prior.x, b.name)) for b in layout}
    lines: list[tuple[float, int, dict[str, Any]]] = []
    for key, series in recording.inputs.items():
        edges = zip(series.t_start.tolist(), series.t_end.tolist(), strict=True)
        for (t_start, t_end), values in zip(edges, series.values, strict=True):
            lines.append((t_end, 0, input_object(InputSample(key, t_start, t_end, values))))
    for m in recording.measurements:
        arrival = m.t if m.t_arrival is None else m.t_arrival
        lines.append((float(arrival), 1, measurement_object(m)))
    measured = np.array(sorted([*(m.t for m in recording.measurements), np.inf]))
    nearest = measured[np.searchsorted(measured, recording.times - SAME_TIME)]
    silent = recording.times[nearest > recording.times + SAME_TIME]
    lines += [(t, 1, {"epoch": t}) for t in silent.tolist()]
    header = {"format": FORMAT, "version": VERSION, "scenario": name, "seed": seed}
    settings = {"settings": dict(recording.settings)} if recording.settings else {}
    yield dump({**header, "t": float(recording.times[0]), "prior": mean, **settings, "n": 0})
    lines.sort(key=lambda entry: entry[:2])
    for n, (_, _, line) in enumerate(lines, 1):
        yield dump({**line, "n": n})
