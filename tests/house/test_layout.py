"""The house: its rooms, its floors, and that imports only go downstairs."""

from __future__ import annotations

import ast
import re
import statistics
import tomllib
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import relnav_graph
from relnav_graph.compiled.cache import _LOWER_FLOORS

ROOT = Path(__file__).parents[2]
PACKAGES = {"relnav_graph": ROOT, "relnav_factors": ROOT / "factors"}
#: Not rooms, but what Python and the tools want in a package.
FURNITURE = {"__init__.py", "__main__.py", "__pycache__", "py.typed"}
GROUPS = {
    f"relnav_graph.{name}" for name in ("models", "estimators", "truths", "readers", "writers")
}


def floors() -> list[set[str]]:
    """The rooms of relnav_graph floor by floor, the highest first, as import-linter has them."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = next(c["layers"] for c in settings["contracts"] if c["type"] == "layers")
    return [{room.strip() for room in layer.split("|")} - {"__main__"} for layer in layers]


def rooms() -> set[str]:
    """Files and folders on the top level of relnav_graph."""
    found = {p.name for p in (ROOT / "relnav_graph").iterdir()} - FURNITURE
    return {name.removesuffix(".py") for name in found}


def modules() -> dict[str, Path]:
    """All modules of both packages, by name."""
    out = {}
    for package, folder in PACKAGES.items():
        for path in (folder / package).rglob("*.py"):
            parts = path.relative_to(folder).with_suffix("").parts
            out[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return out


MODULES = modules()


def reached(path: Path) -> Iterator[str]:
    """Modules of both packages that a file imports, at any place in it, or names in a string
    as something to import."""
    for node in ast.walk(ast.parse(path.read_text())):
        names: list[str] = []
        if isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, f"{path}: a relative import"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found = re.fullmatch(r"(relnav_\w+(\.\w+)+)(:\w+)?", node.value)
            names = [found[1]] if found and found[1] not in GROUPS else []
        for name in names:
            if name.split(".")[0] in PACKAGES:
                yield name if name in MODULES else name.rpartition(".")[0]


def test_every_room_is_in_the_picture() -> None:
    assert set.union(*floors()) == rooms()
    for name in MODULES:  # no module beside the rooms
        assert (
            name.count(".") == 0
            or name.split(".")[1] in rooms() | {"__main__"}
            or (name.startswith("relnav_factors."))
        )


def test_there_are_few_rooms_on_few_floors() -> None:
    assert len(rooms() | {"relnav_factors", "experiments"}) <= 24
    # Experiments stand beside the report, the models beside linear and sim.
    assert len([floor for floor in floors() if floor]) <= 13


def test_imports_go_downstairs() -> None:
    level = {room: -i for i, floor in enumerate(floors()) for room in floor}
    for name, path in MODULES.items():
        if not name.startswith("relnav_graph.") or name == "relnav_graph.__main__":
            continue
        own = name.split(".")[1]
        for other in reached(path):
            assert other.startswith("relnav_graph."), f"{name} imports {other}"
            room = other.split(".")[1]
            assert room == own or level[room] < level[own], f"{name} reaches up to {other}"


def test_nothing_goes_in_a_circle() -> None:
    """Not even among the files of a room, nor by a string; relnav_graph itself, whose names
    load lazily and from which nothing imports, excepted."""
    graph = {n: {*reached(p)} - {n} for n, p in MODULES.items() if n != "relnav_graph"}
    assert not any("relnav_graph" in others for others in graph.values())
    list(TopologicalSorter(graph).static_order())  # raises CycleError


def test_compiled_code_calls_only_what_its_cache_watches() -> None:
    """Machine code whose callee has changed unseen calls into nowhere, and crashes."""
    compiles = {n for n, p in MODULES.items() if "@jit" in p.read_text()}
    for name in compiles:
        package, room = name.split(".")[:2]
        for other in compiles.intersection(reached(MODULES[name])):
            near = other.split(".")[0] == package and (
                package == "relnav_factors" or other.split(".")[1] in {room, *_LOWER_FLOORS}
            )
            assert near or other.split(".")[1] in _LOWER_FLOORS, f"{name} calls {other}"


@pytest.mark.parametrize(
    "house", ["relnav_graph", "factors/relnav_factors", "experiments", "tests"]
)
def test_files_are_short(house: str) -> None:
    lines = {p: len(p.read_text().splitlines()) for p in (ROOT / house).rglob("*.py")}
    limit = 200 if house.startswith("factors") else 400
    assert not {p.name: n for p, n in lines.items() if n > limit}
    if house != "tests":
        assert statistics.median(lines.values()) <= 150


def test_names_load_when_asked_for() -> None:
    for name in relnav_graph.__all__:
        assert getattr(relnav_graph, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'smooth'"):
        relnav_graph.smooth  # noqa: B018


def test_the_version_stands_once() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["version"] == relnav_graph.__version__
