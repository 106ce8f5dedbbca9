"""What a scenario file may hold, and how its tables become models.

A file is checked as a whole: every error is reported at once, with its path in the file.
"""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from relnav_graph.core import models
from relnav_graph.errors import InputError, ModelError
from relnav_graph.registry import find_class
from relnav_graph.scenario.scores import ScoreSettings
from relnav_graph.scenario.settings import (
    BlockPrior,
    Bound,
    DataSettings,
    GapSettings,
    OnlineSettings,
    StampSettings,
)
from relnav_graph.scenario.time_settings import STRICT, TimeSettings

__all__ = ["ScenarioError", "ScenarioFile"]

Problems = list[tuple[str, str]]


#: Characters of a message.
_LONGEST = 1000
MISSING = "missing, and required"
#: What [truth] may tell of recorded data: true values that no model of a truth gives.
BESIDE_TRUTH = {"statics", "map"}


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

    truth_noise: of recorded data, whose truth was measured itself: 1-sigma of its blocks, of
    attitudes about the axes of the body, and of derived quantities that it gives, for all axes or
    one each. NEES and what follows from it counts it; columns of sigmas in the truth's tables say
    the same. The truth of a simulated pass is exact.

    truth.map: the true points, by id, of sensors with points = "unknown": `points` and maybe
    `normals` of each, or a generated one, { count = 50, box = ["1 m", "1 m", "0.6 m"], seed = 1 }:
    drawn uniformly on the surface of that cuboid about the centre of mass, with its normals. For
    recorded data it is for scores alone; by default, what the data bring.

    prior: of every block of the state: what the processes advance, and what is read by a model and
    advanced by no process, which is static: one value for the whole pass.

    Names of sensors, inputs and processes have letters, digits, `_` and, not first, `. + -`;
    48 at most: they are those of tables, too.
    """

    model_config = STRICT

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
    truth_noise: dict[str, Any] = {}
    score: ScoreSettings = ScoreSettings()
    control: dict[str, Any] | None = None
    inputs: dict[str, dict[str, Any]] = {}
    gaps: dict[str, GapSettings] = {}
    stamps: dict[str, StampSettings] = {}
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


def make_kind(
    group: str,
    path: str,
    table: Mapping[str, Any],
    problems: Problems,
    *contracts: type[Any],
) -> Any:
    """An instance of the class that a table names by `kind`, found in an entry-point group; None
    when there is none, or the table does not fit it: `problems` then says why. contracts: what it
    may provide; kinds that do are named where there is none of that name."""
    kind = table.get("kind")
    if not isinstance(kind, str):
        problems.append((f"{path}.kind", f"found {kind!r}, expected the name of a kind"))
        return None
    try:
        cls = find_class(group, kind, *contracts)
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
        left = {"estimated"} if placed else {"estimated", "epoch"}  # a truth knows its orbit
        out = {**{k: v for k, v in orbit.items() if k not in left}, **out}
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
