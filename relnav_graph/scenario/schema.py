"""What a scenario file may hold, and how its tables become models.

A file is checked as a whole: every error is reported at once, with its path in the file.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    model_validator,
)

from relnav_graph.core import models
from relnav_graph.core.contracts import Dynamics, Sensor
from relnav_graph.core.epochs import LONGEST, unit_hint
from relnav_graph.core.measurement import SAME_TIME
from relnav_graph.errors import InputError, ModelError
from relnav_graph.maths.losses import LossKind
from relnav_graph.registry import classes, find_class, provides
from relnav_graph.sim.contracts import GROUP as TRUTHS
from relnav_graph.sim.contracts import Instrument
from relnav_graph.sim.sensors import Law, Timing
from relnav_graph.units import Quantity, parse_quantity

__all__ = [
    "BlockPrior",
    "ScenarioError",
    "ScenarioFile",
    "SensorOptions",
    "json_schema",
]

Problems = list[tuple[str, str]]


def _checked_bound(value: float | str) -> float | str:
    if isinstance(value, str):
        parse_quantity(value, "s")
    elif not 0 <= value <= 1:
        raise InputError(f"found {value}, expected a fraction of the pass or a time like '60 s'")
    return value


#: Characters of a message.
_LONGEST = 1000
MISSING = "missing, and required"
#: What [truth] may tell of recorded data: true values that no model of a truth gives.
BESIDE_TRUTH = {"statics", "map"}
Seconds = Annotated[float, Quantity("s", positive=True)]
Bound = Annotated[float | str, AfterValidator(_checked_bound)]
_STRICT = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)


class ScenarioError(InputError):
    """Everything that is wrong in a scenario; `problems` holds (path, message) pairs."""

    def __init__(self, source: str, problems: Problems) -> None:
        # Some quote what was found: a value may be megabytes long.
        self.problems = problems = [(path, message[:_LONGEST]) for path, message in problems]
        if [path for path, _ in problems] == [""]:  # of the file as a whole: one line
            super().__init__(f"{source}: {problems[0][1]}")
            return
        lines = "\n".join(f"  {path or '(file)'}: {message}" for path, message in problems)
        count = "1 error" if len(problems) == 1 else f"{len(problems)} errors"
        super().__init__(f"{source}: {count}\n{lines}")


class TimeSettings(BaseModel):
    """The clock of a pass, and the epochs of a simulated one.

    step, epochs: of a simulated pass, which has so many epochs, so far apart, from t = 0, and
    between them those of sensors whose period is no multiple of the step; recorded data need
    neither. origin: what the stamps of files and streams say at t = 0, s: it
    is taken off when they are read, so that numbers stay small, and put back when data are
    written; all other times (`[orbit] epoch`, `evaluate`, results) are of the pass's own clock.
    merge: s, measurements that close to the first of an epoch are of it; 0: only equal stamps.
    """

    model_config = _STRICT

    step: Seconds | None = None
    epochs: int | None = Field(default=None, ge=1)
    origin: Annotated[float, Quantity("s")] = 0.0
    merge: Annotated[float, Quantity("s", nonnegative=True)] = SAME_TIME

    @property
    def tolerance(self) -> float:
        """`merge` with room for the rounding of stamps that are just so far apart, s."""
        return self.merge * (1 + 1e-6) if self.merge > SAME_TIME else self.merge

    @model_validator(mode="after")
    def _reasonable(self) -> TimeSettings:
        if (self.step is None) != (self.epochs is None):
            raise ValueError("found one of step and epochs, expected both or neither")
        if self.step is not None and self.step > LONGEST:
            hint = unit_hint(self.step).replace("stamps", "numbers")
            raise ValueError(f"found step {self.step:g} s, expected at most {LONGEST:g} s{hint}")
        return self


class DataSettings(BaseModel):
    """Where recorded data come from: a reader of `relnav_graph.io.readers`; `simulate`: the
    sensors that a raw folder lacks, simulated on its truth."""

    model_config = _STRICT

    reader: str
    options: dict[str, Any] = {}
    simulate: list[str] = []


class OutlierSettings(BaseModel):
    """Simulated outliers: `fraction` of the observations, with errors of `size` sigmas, each
    in a direction drawn at random."""

    model_config = _STRICT

    fraction: float = Field(gt=0, lt=1)
    size: float = Field(gt=0)


class SensorOptions(BaseModel):
    """Settings that every sensor has, whatever its model.

    gate: probability of the chi-square gate on each observation; of unknown points, smoothers
    decide it again at a robust estimate of the whole history, and retire points of which no more
    observations fit than do not. loss: a robust loss, tuning: its constant in sigmas, of student_t
    degrees of freedom. In simulation: period, between measurements, from begin until before end;
    law of the noise, "gaussian" or "random_direction" (of a normal length along a direction drawn at random, of the
    same covariance); outliers; most: observations of one time, drawn from all that are seen;
    association_errors: fraction of the observations that get the values of another one of the
    same time.
    """

    model_config = _STRICT

    gate: float | None = Field(default=None, gt=0, lt=1)
    loss: LossKind | None = None
    tuning: float | None = Field(default=None, gt=0)
    period: Seconds | None = None
    begin: Seconds | None = None
    end: Seconds | None = None
    law: Law = "gaussian"
    outliers: OutlierSettings | None = None
    most: int | None = Field(default=None, ge=1)
    association_errors: float = Field(default=0.0, ge=0, lt=1)

    @model_validator(mode="after")
    def _in_order(self) -> SensorOptions:
        if self.begin is not None and self.end is not None and not self.begin < self.end:
            raise ValueError(f"found begin at {self.begin} s and end at {self.end} s")
        return self

    def timing(self) -> Timing:
        """The settings as the simulator takes them."""
        begin = -math.inf if self.begin is None else self.begin
        end = math.inf if self.end is None else self.end
        o = self.outliers
        struck = (0.0, 0.0) if o is None else (o.fraction, o.size)
        few = self.most, self.association_errors
        return Timing(self.period, *struck, begin, end, self.law, *few)


def besides(step: float | None, options: Iterable[SensorOptions]) -> set[float]:
    """Periods of sensors, s, that are no multiples of the step of a simulated pass, s: they measure
    between its epochs, so that it has these besides."""
    if step is None:
        return set()
    periods = {o.period for o in options if o.period is not None}
    return {p for p in periods if p / step < 1 - 1e-6 or abs(p / step - round(p / step)) > 1e-6}


class OnlineSettings(BaseModel):
    """Settings of estimators that take one epoch at a time. window: length of the fixed-lag
    smoother's window, and how late a measurement may come; by default 30 epochs. Also of the batch
    that `ekf_batch_start` begins with; by default 100 s."""

    model_config = _STRICT

    window: Seconds | None = None


class GapSettings(BaseModel):
    """How gaps in an input are bridged, before, between and after its samples: for `bridge`
    seconds at most the last mean goes on, and the variance (spread x length)^2 is added to what
    is integrated of it. `spread`, in the unit of the input, is one number or one for each of its
    channels; by default 0.1 deg/s for rates, 0.01 m/s^2 for accelerations, 0.1 m/s for
    velocities; an input of another unit is bridged only where it is given. A longer gap is an
    error; a stream begins again after it."""

    model_config = _STRICT

    bridge: Annotated[float, Quantity("s", nonnegative=True)] = 30.0
    spread: Any = None


class BlockPrior(BaseModel):
    """Prior of one block. sigma: one for all axes or one each, SI or strings with units.

    mean: "drawn" about the truth with sigma (simulation only), "truth" itself, "measured"
    by the first frames, or values (an attitude as a rotation vector, or as q_wxyz: scalar first,
    normalised within 1e-3). Of a family of blocks (`point`, of an unknown map) one prior stands for
    each: values, by default zero, or "measured", which is the same: a point starts from where it is
    first seen, and is within sigma of the target's centre of mass; or "drawn" or "truth", written
    out, of each its own. considered: not estimated, but counted in the covariances of all others
    (Schmidt 1966), by `ekf`, and of static blocks by `batch` and `isam2`.
    """

    model_config = _STRICT

    sigma: Any
    mean: Literal["drawn", "truth", "measured"] | list[Any] = "drawn"
    considered: bool = False


class ScenarioFile(BaseModel):
    """The tables of a scenario file. Models are checked apart, by their `kind`.

    evaluate: the part of the pass that is scored, each end a fraction of it or a time
    with its unit.

    A sensor that compares two epochs (odometry) and has `keyframes`, a list of times or a period,
    s, closes loops: it compares an epoch with any of these earlier ones, which are copied as they
    come. In a data set, a table with a column t_from_s says them.

    truth.statics: true values of static blocks (a mounting, a constant), by name, as the means of
    a prior are given; what the truth itself gives needs none. For recorded data it may stand alone.
    With mounting = "known", the blocks that "estimated" would have: the sensor is simulated with
    them, and the estimators know nothing of it.

    truth.map: the true points, by id, of sensors with points = "unknown": `points` and maybe
    `normals` of each, or a generated one, { count = 50, box = ["1 m", "1 m", "0.6 m"], seed = 1 }:
    drawn uniformly on the surface of that cuboid about the centre of mass, with its normals. For
    recorded data it is for scores alone; by default, what the data bring.

    prior: of every block of the state: what the processes advance, and what is read by a model and
    advanced by no process, which is static: one value for the whole pass.

    Names of sensors, inputs and processes have letters, digits, `_` and, not first, `. + -`;
    48 at most: they are those of tables, too.
    """

    model_config = _STRICT

    title: str
    description: str = ""
    seed: int = Field(default=0, ge=0)
    estimators: list[str] = ["ekf", "iekf", "rts", "batch", "incremental"]
    evaluate: tuple[Bound, Bound] | None = None
    time: TimeSettings = TimeSettings()
    data: DataSettings | None = None
    online: OnlineSettings = OnlineSettings()
    orbit: dict[str, Any] | None = None
    truth: dict[str, Any] | None = None
    control: dict[str, Any] | None = None
    inputs: dict[str, dict[str, Any]] = {}
    gaps: dict[str, GapSettings] = {}
    processes: dict[str, dict[str, Any]] = Field(min_length=1)
    sensors: dict[str, dict[str, Any]] = Field(min_length=1)
    prior: dict[str, BlockPrior]

    @property
    def simulated(self) -> bool:
        """Whether there is a truth to simulate from, not only values for recorded data."""
        return self.truth is not None and not self.truth.keys() <= BESIDE_TRUTH


def _path(prefix: str, location: Sequence[int | str]) -> str:
    out = prefix
    for part in location:
        out += f"[{part}]" if isinstance(part, int) else f".{part}" if out else part
    return out


def from_pydantic(prefix: str, error: ValidationError) -> Problems:
    """The errors that pydantic found, in our words; prefix: path of what it validated."""
    found = []
    for e in error.errors():
        message = e["msg"].removeprefix("Value error, ")
        message = MISSING if e["type"] == "missing" else message
        if e["type"] == "extra_forbidden" and len(e["loc"]) == 1 and not prefix:
            message = unknown_key(str(e["loc"][0]), [*ScenarioFile.model_fields, "base"])
        if "found" not in message and e["type"] != "missing":
            message += f" (found {e['input']!r})"
        found.append((_path(prefix, e["loc"]), message))
    return found


def unknown_key(key: str, names: Sequence[str]) -> str:
    """What to say of a key that is none of `names`."""
    near = difflib.get_close_matches(key, names, 1)
    return "unknown key" + (
        f"; did you mean {near[0]!r}?" if near else f"; expected {', '.join(names)}"
    )


def _make(path: str, cls: type[Any], table: Mapping[str, Any], problems: Problems) -> Any:
    """An instance of a dataclass from a table, or None; problems collects what is wrong."""
    names = [f.name for f in dataclasses.fields(cls) if f.init]
    problems += [(f"{path}.{k}", unknown_key(k, names)) for k in table if k not in names]
    known = {key: value for key, value in table.items() if key in names}
    try:
        return TypeAdapter(cls).validate_python(known)
    except ValidationError as error:
        problems += from_pydantic(path, error)
    except (InputError, ModelError) as error:
        problems.append((path, str(error)))
    except Exception as error:  # of the class itself, which need not be one of ours
        problems.append((path, f"{cls.__name__} cannot be made: {type(error).__name__}: {error}"))
    return None


def make_kind(group: str, path: str, table: Mapping[str, Any], problems: Problems) -> Any:
    """An instance of the class that a table names by `kind`, found in an entry-point group; None
    when there is none, or the table does not fit it: `problems` then says why."""
    kind = table.get("kind")
    if not isinstance(kind, str):
        problems.append((f"{path}.kind", f"found {kind!r}, expected the name of a kind"))
        return None
    try:
        cls = find_class(group, kind)
    except ModelError as error:
        problems.append((f"{path}.kind", str(error)))
        return None
    if not dataclasses.is_dataclass(cls):
        problems.append((f"{path}.kind", f"{kind!r} is not a dataclass, expected one"))
        return None
    rest = {key: value for key, value in table.items() if key != "kind"}
    return _make(path, cls, rest, problems)


def shared_orbit(
    group: str, table: Mapping[str, Any], orbit: Mapping[str, Any] | None
) -> dict[str, Any]:
    """The table, with the scenario's [orbit] added where the model has a field `orbit`, or the
    orbit's elements as fields of its own."""
    out = dict(table)
    try:
        cls = find_class(group, str(table.get("kind")))
    except ModelError:
        return out
    if not dataclasses.is_dataclass(cls) or not isinstance(orbit, Mapping):
        return out  # reported elsewhere
    names = {f.name for f in dataclasses.fields(cls)}
    if "orbit" in names:
        out.setdefault("orbit", dict(orbit))
    elif "semi_major_axis" in names:
        placed = names & {"epoch", "true_anomaly", "argument_of_latitude"}
        out = {**{k: v for k, v in orbit.items() if placed or k != "epoch"}, **out}
    return out


def named_mount(table: Mapping[str, Any], name: str) -> dict[str, Any]:
    """The table of a sensor, with its own name as that of its mount, where its model has one."""
    try:
        cls = find_class(models.ENTRY_POINTS, str(table.get("kind")))
    except ModelError:
        return dict(table)  # reported elsewhere
    if not dataclasses.is_dataclass(cls) or "mount" not in {
        f.name for f in dataclasses.fields(cls)
    }:
        return dict(table)
    return {"mount": name, **table}


def json_schema() -> dict[str, Any]:
    """JSON Schema of scenario files, for editors."""
    schema = ScenarioFile.model_json_schema()
    own_options = SensorOptions.model_json_schema()
    schema["$defs"] |= own_options.pop("$defs", {})
    options = own_options["properties"]
    for section, group, contract, general in (
        ("processes", models.ENTRY_POINTS, Dynamics, {}),
        ("sensors", models.ENTRY_POINTS, Sensor, options),
        ("inputs", TRUTHS, Instrument, {}),
    ):
        choices = []
        for kind, cls in classes(group).items():
            if provides(cls, contract):
                choice = TypeAdapter(cls).json_schema()
                schema["$defs"] |= choice.pop("$defs", {})
                own = choice.get("properties", {})
                choice["properties"] = {"kind": {"const": kind}, **general, **own}
                # The scenario's [orbit] serves all models that ask for one.
                required = [n for n in choice.get("required", []) if n != "orbit"]
                choice["required"] = ["kind", *required]
                choices.append(choice)
        schema["properties"][section]["additionalProperties"] = {"anyOf": choices}
    return schema
