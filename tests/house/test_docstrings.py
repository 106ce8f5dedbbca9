"""How many public numeric functions say the shapes and units of what they take and give.

The rule. Counted are public functions, and public methods of public classes, of both packages
whose annotations name an array. What is said in the docstring of the class, or of the same
method in a base class or contract, counts for a method. A shape is a tuple in parentheses,
such as (3,), (N, 3) or (rows, 1 + channels). A unit is one of `UNITS` as a word of its own.
Rooms whose numbers have no fixed unit (linear algebra, whitened rows, states of mixed units)
are not asked for units.

`python tests/house/test_docstrings.py` lists those that say nothing.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
HOUSES = (ROOT / "relnav_graph", ROOT / "factors" / "relnav_factors")
_TERM = r"[\w.]+(?:\s*[-+*/]\s*\w+)*"
SHAPE = re.compile(rf"\(\s*(?:{_TERM}|\.\.\.)\s*,(?:\s*(?:{_TERM})\s*,?)*\s*\)")
UNITS = re.compile(
    r"(?<![\w`])(?:m|s|rad|deg|kg|N|SI|m/s|m/s\^2|rad/s|m\^3/s\^2|sigmas?|seconds|pixels)(?![\w`])"
)
WITHOUT_UNITS = (
    *("relnav_graph/compiled", "relnav_graph/linear", "relnav_graph/estimators"),
    *("relnav_graph/core", "relnav_graph/io", "relnav_graph/report", "relnav_graph/scoring"),
    *("relnav_graph/streaming", "relnav_graph/study", "relnav_graph/figures"),
    *("relnav_graph/scenario", "relnav_graph/maths/dense.py", "relnav_graph/maths/losses.py"),
    *("relnav_graph/maths/manifold.py", "relnav_graph/units.py", "relnav_graph/runs"),
)


@dataclass(frozen=True)
class Numeric:
    """A function that takes or gives arrays."""

    place: str
    text: str


def _annotations(function: ast.FunctionDef) -> str:
    arguments = [*function.args.args, *function.args.kwonlyargs, function.args.vararg]
    found = [a.annotation for a in arguments if a is not None and a.annotation is not None]
    found += [function.returns] if function.returns is not None else []
    return " ".join(ast.unparse(a) for a in found)


def _inherited() -> dict[str, str]:
    """What contracts and mixins say of a method, by its name."""
    said: dict[str, str] = {}
    files: tuple[str, ...] = ("relnav_graph/core/contracts.py", "relnav_graph/core/models.py")
    for file in (
        *files,
        "relnav_graph/sim/contracts.py",
        "relnav_graph/estimators/online/engine.py",
    ):
        for node in ast.walk(ast.parse((ROOT / file).read_text())):
            if isinstance(node, ast.FunctionDef):
                said[node.name] = said.get(node.name, "") + (ast.get_docstring(node) or "")
    return said


def numeric_functions() -> Iterator[Numeric]:
    """All that are counted."""
    inherited = _inherited()
    for house in HOUSES:
        for path in sorted(house.rglob("*.py")):
            tree = ast.parse(path.read_text())
            owners: list[tuple[ast.Module | ast.ClassDef, str]] = [(tree, "")]
            owners += [(n, f"{n.name}.") for n in tree.body if isinstance(n, ast.ClassDef)]
            for owner, prefix in owners:
                if prefix.startswith("_"):
                    continue
                about = (ast.get_docstring(owner) or "") if prefix else ""
                for node in owner.body:
                    if not isinstance(node, ast.FunctionDef) or node.name.startswith("_"):
                        continue
                    if not re.search(r"\b(Array|Indices|NDArray)\b", _annotations(node)):
                        continue
                    above = inherited.get(node.name, "") if prefix else ""
                    text = "\n".join((ast.get_docstring(node) or "", about, above))
                    where = path.relative_to(ROOT).as_posix().removeprefix("factors/")
                    yield Numeric(f"{where}:{node.lineno} {prefix}{node.name}", text)


def _silent(pattern: re.Pattern[str], functions: list[Numeric]) -> list[Numeric]:
    return [f for f in functions if not pattern.search(f.text)]


def with_units(functions: list[Numeric]) -> list[Numeric]:
    """Those whose numbers have a unit."""
    return [f for f in functions if not f.place.startswith(WITHOUT_UNITS)]


def test_shapes_are_said() -> None:
    functions = list(numeric_functions())
    silent = _silent(SHAPE, functions)
    assert len(silent) <= 0.10 * len(functions), "\n".join(f.place for f in silent)


def test_units_are_said() -> None:
    functions = with_units(list(numeric_functions()))
    silent = _silent(UNITS, functions)
    assert len(silent) <= 0.30 * len(functions), "\n".join(f.place for f in silent)


if __name__ == "__main__":
    everything = list(numeric_functions())
    for title, pattern, asked in (
        ("shapes", SHAPE, everything),
        ("units", UNITS, with_units(everything)),
    ):
        missing = _silent(pattern, asked)
        print(f"{title}: {len(asked) - len(missing)} of {len(asked)}")
        for one in missing:
            print("   ", one.place)
