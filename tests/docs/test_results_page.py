"""The reference of results names every variable of results.nc with its dimensions, no other."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import h5netcdf
import numpy as np
import pytest

from relnav_graph.core.numbered import members
from relnav_graph.core.track import Track
from relnav_graph.io.results import write_results
from relnav_graph.runs.comparison import compare_pass
from relnav_graph.runs.passes import open_pass
from relnav_graph.scoring.deviations import derived_estimates
from relnav_graph.scoring.metrics import with_smoothed

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "results.md"
#: Which group, name and dimensions.
Row = tuple[str, str, tuple[str, ...]]
#: Estimators and settings: a map and a mounting in the state; a filter whose gate leaves some out.
PASSES = {
    "mounting_map": (["incremental"], ["time.epochs=8"]),
    "zhang2015": (
        ["iekf", "incremental"],
        [
            "time.epochs=30",
            "sensors.beacons.gate=0.99",
            "sensors.beacons.outliers.fraction=0.2",
            "sensors.beacons.outliers.size=50",
        ],
    ),
}


def _rows() -> list[Row]:
    found = []
    for line in PAGE.read_text("utf-8").splitlines():
        cells = line.strip("|").split(" | ")
        if line.startswith("|") and "`" in line:
            found.append((cells[0].strip(), cells[1].strip("`"), _names(cells[2])))
    return found


def _names(cell: str) -> tuple[str, ...]:
    return tuple(re.findall("`([^`]*)`", cell))


def _named(track: Track) -> dict[str, list[str]]:
    """What the words in capitals stand for."""
    return {
        "BLOCK": [b.name for b in track.blocks if b.number is None],
        "FAMILY": list(members(track.blocks)),
        "DERIVED": list(derived_estimates(track)),
        "SENSOR": list(track.rejected),
    }


def _written(row: Row, named: Mapping[str, Sequence[str]]) -> dict[str, tuple[str, ...]]:
    """The variables that a row of the table stands for."""
    _, variable, dimensions = row
    word = next((w for w in named if w in variable), "")
    return {
        variable.replace(word, name): tuple(d.replace(word, name) for d in dimensions)
        for name in (named[word] if word else [""])
    }


@pytest.fixture(scope="module")
def used(tmp_path_factory: pytest.TempPathFactory) -> set[Row]:
    """The rows of the table of which files have a variable; each variable is in one of them."""
    found = set[Row]()
    for scenario, (kinds, settings) in PASSES.items():
        path = tmp_path_factory.mktemp(scenario) / "results.nc"
        opened = open_pass(scenario, assignments=settings)
        tracks = compare_pass(opened, kinds).tracks
        truth = opened.recording.truth
        assert truth is not None
        sigmas = {"relative_position": np.ones((len(truth.t), 3))}
        write_results(path, tracks, replace(truth, sigmas=sigmas), {})
        rows = with_smoothed(tracks)
        with h5netcdf.File(path, "r") as file:
            assert set(file.groups) == {*rows, "truth"}
            assert not file.variables
            for name, group in file.groups.items():
                of = "track" if name in rows else "truth"
                here = [row for row in _rows() if row[0] in ("both", of)]
                named = _named(rows.get(name, tracks[0]))
                for key, variable in group.variables.items():
                    own = tuple("time" if d == "pass" else d for d in variable.dimensions)
                    told = [row for row in here if _written(row, named).get(key) == own]
                    assert len(told) == 1, f"{name}/{key} {own} is {len(told)} times on the page"
                    found.update(told)
    return found


@pytest.mark.parametrize("row", _rows(), ids=lambda row: f"{row[0]}-{row[1]}")
def test_every_name_of_the_page_is_in_a_file(row: Row, used: set[Row]) -> None:
    assert row in used


def test_the_page_has_a_table() -> None:
    assert len(_rows()) > 10
    assert len(set(_rows())) == len(_rows())
