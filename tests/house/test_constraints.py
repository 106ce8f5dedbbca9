"""The versions that CI takes are versions that the package allows, one for each thing it needs."""

from __future__ import annotations

import re
import tomllib
from itertools import chain
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
PYTHONS = ("3.11.9", "3.12.9", "3.13.9", "3.14.1")


def _pinned(python: str) -> dict[str, str]:
    """Versions by name, of one version of Python on Linux."""
    lines = (ROOT / ".ci" / "constraints.txt").read_text("utf-8").splitlines()
    environment = {
        "python_version": python.rpartition(".")[0],
        "python_full_version": python,
        "sys_platform": "linux",
    }
    found: dict[str, str] = {}
    for line in lines:
        one = Requirement(line)
        if one.marker is not None and not one.marker.evaluate(environment):
            continue
        (pin,) = one.specifier
        assert pin.operator == "==", line
        assert canonicalize_name(one.name) not in found, line
        found[canonicalize_name(one.name)] = pin.version
    return found


def test_each_requirement_has_one_version_that_it_allows() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = project["optional-dependencies"].values()
    wanted = [Requirement(one) for one in chain(project["dependencies"], *extras)]
    for python in PYTHONS:
        pinned = _pinned(python)
        for one in wanted:
            if one.name != project["name"]:
                assert one.specifier.contains(pinned[canonicalize_name(one.name)]), (one, python)


def test_the_list_names_no_place() -> None:
    text = (ROOT / ".ci" / "constraints.txt").read_text("utf-8")
    assert not re.search(r"https?:|@|--", text)
