"""Static blocks in damaged results files, tables and records of a study."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from static_tracks import OFFSET, filtered, smoothed, truth_of_statics

from relnav_graph.errors import InputError
from relnav_graph.io.netcdf import Group, Variable, read_groups, write_groups
from relnav_graph.io.results import read_results, write_results
from relnav_graph.io.track_tables import write_csv
from relnav_graph.scenario.build import load_scenario
from relnav_graph.study.record import RunRecord
from relnav_graph.study.runs import StudySpec, run_record

FORMAT = ("relnav-graph results", 1)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write_results(tmp_path / "r.nc", [filtered(), smoothed()], truth_of_statics(), {})
    return tmp_path / "r.nc"


def damaged(path: Path, change: dict[str, Variable | None]) -> Path:
    """The file with variables of the track ekf changed, or taken out, and its digest right."""
    groups = read_groups(path, *FORMAT)
    own = groups["ekf"]
    variables = {n: v for n, v in {**own.variables, **change}.items() if v is not None}
    groups["ekf"] = Group(own.attributes, variables)
    root = {k: v for k, v in groups[""].attributes.items() if not k.startswith("format")}
    write_groups(path, *FORMAT, {**groups, "": Group(root)})
    return path


@pytest.mark.parametrize(
    ("name", "shape", "words"),
    [
        ("static_covariance", (40, 5, 5), r"static_covariance: damaged: found \(40, 5, 5\)"),
        ("static_covariance", None, "no variable 'static_covariance'"),
        ("cross_covariance", (40, 3, 5), r"cross_covariance: damaged: found \(40, 3, 5\)"),
        ("cross_covariance", None, "no variable 'cross_covariance'"),
        ("lever_arm", (39, 3), r"lever_arm: damaged: found \(39, 3\), expected \(40, 3\)"),
        ("lever_arm", None, "no variable 'lever_arm'"),
    ],
)
def test_row_34_damaged_statics_are_named(
    path: Path, name: str, shape: tuple[int, ...] | None, words: str
) -> None:
    change: dict[str, Variable | None] = {name: None}
    if shape is not None:
        found = read_groups(path, *FORMAT)["ekf"].variables[name]
        own = tuple(f"own_{k}" for k in range(len(shape)))
        change[name] = Variable(own, np.zeros(shape), found.attributes)
    with pytest.raises(InputError, match=words) as caught:
        read_results(damaged(path, change))
    assert str(path) in str(caught.value)
    assert "ekf" in str(caught.value)


@pytest.mark.parametrize("order", ["", "relative_position lever_arm"])
def test_row_34_an_order_of_statics_that_cannot_be_is_named(path: Path, order: str) -> None:
    found = read_groups(path, *FORMAT)["ekf"].variables["static_covariance"]
    other = replace(found, attributes={**found.attributes, "block_order": order})
    with pytest.raises(InputError, match="static_covariance: damaged: block_order"):
        read_results(damaged(path, {"static_covariance": other}))


def test_row_34_two_tables_of_one_name_are_refused(tmp_path: Path) -> None:
    other = replace(filtered(name="ekf_statics"), statics=None)
    with pytest.raises(InputError, match="'ekf_statics' cannot name a table: taken twice"):
        write_csv(tmp_path / "out", [filtered(), other])
    assert not (tmp_path / "out").exists()


def test_row_34_a_record_with_damaged_statics_is_named(tmp_path: Path) -> None:
    path = tmp_path / "offset.toml"
    path.write_text(OFFSET, "utf-8")
    spec = StudySpec.of(load_scenario(path), None, ("iekf",))
    record = RunRecord.from_bytes(run_record(spec.to_json(), 0), "here")
    assert set(record.scalars["rows"]["iekf"]["statics"]) == {"range_drift"}
    for change, words in (
        (
            {"other": {**record.scalars["rows"]["iekf"]["statics"]["range_drift"], "unit": 3}},
            "rows.iekf.statics.other.unit",
        ),
        ({"range_drift": {"unit": "m"}}, "rows.iekf.statics.range_drift.sigma"),
        ({"range_drift": 3}, "rows.iekf.statics.range_drift"),
    ):
        row = {**record.scalars["rows"]["iekf"], "statics": change}
        bad = RunRecord({**record.scalars, "rows": {"iekf": row}}, record.series)
        with pytest.raises(InputError, match=words):
            RunRecord.from_bytes(bad.to_bytes(), "here")
