"""Row 57 and others, of unknown points: their ids, their priors, their true map."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from passes import EXPERIMENTS

from relnav_graph.core.catalogue import BODY_RATE, POINT
from relnav_graph.core.problem import Prior
from relnav_graph.errors import InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.io.dataset import write_dataset
from relnav_graph.runs.comparison import compare
from relnav_graph.runs.passes import Pass, open_dataset, open_pass
from relnav_graph.scenario.build import load_scenario

INSPECTION = EXPERIMENTS / "inspection.toml"
SHORT = ["time.epochs=12", "truth.map.count=8", "sensors.camera.incidence='90 deg'"]


def recorded(folder: Path, table: str, edit: Callable[[str], str]) -> Pass:
    """A short pass as a data set with one of its tables edited, opened."""
    made = load_scenario(INSPECTION, SHORT)
    described = made.sensors, made.input_columns, {b.name: b for b in made.layout}
    write_dataset(folder, made.raw, made.simulate(0), *described)
    path, manifest = folder / table, folder / "dataset.toml"
    path.write_text(edit(path.read_text()))
    line = f'"{table}" = "{hashlib.sha256(path.read_bytes()).hexdigest()}"'
    manifest.write_text(re.sub(rf'"{table}" = ".*"', line, manifest.read_text()))
    return open_dataset(folder)


def test_row_56_points_that_were_seen_are_told_of() -> None:
    problem = open_pass(INSPECTION, assignments=SHORT).problem
    assert any(block.number is not None for block in problem.layout)
    assert [c.name for c in problem.cautions] == []


def test_row_56_where_no_point_was_ever_seen_the_inertia_is_never_seen() -> None:
    far = [*SHORT, 'sensors.camera.range=["100 m", "200 m"]']
    found = compare(load_scenario(INSPECTION, far), ["ekf", "batch"])
    (pass_,) = [c for c in found.summary["cautions"] if c["estimator"] is None]
    assert "tells of inertia_matrix_parameters: it ends" in pass_["text"]
    assert found.summary["estimators"]["batch"]["status"] == "ok"


@pytest.mark.parametrize(
    ("numbered", "says"),
    [
        ({}, r"prior of point: found none"),
        ({"point": Prior(np.zeros(2), np.eye(2))}, r"found x of \(2,\) and P of \(2, 2\)"),
        ({"point": Prior(np.zeros(3), np.eye(2))}, r"P of \(2, 2\), expected .* P \(3, 3\)"),
        ({"point": 3}, r"prior of point: found 3"),
        ({"point": Prior(np.zeros(3), np.eye(3)), "pint": 3}, r"numbered: found 'pint'"),
    ],
)
def test_row_56_priors_of_numbered_blocks_are_of_these(numbered: Any, says: str) -> None:
    """Also where the prior of the whole tells of all of them already."""
    problem = open_pass(INSPECTION, assignments=SHORT).problem
    with pytest.raises(InputError, match=says):
        replace(problem, numbered=numbered)


@pytest.mark.parametrize("known", [POINT, "point[3]", BODY_RATE, BODY_RATE.numbered(2)])
def test_row_25_blocks_known_beforehand_are_numbered_ones(known: Any) -> None:
    problem = open_pass(INSPECTION, assignments=SHORT).problem
    with pytest.raises(InputError, match=r"known: found .* expected numbered blocks that are read"):
        replace(problem, known=(known,))


def test_row_25_a_numbered_block_has_one_number_of_zero_or_more() -> None:
    for block, number in ((POINT, -1), (POINT.numbered(1), 2)):
        with pytest.raises(InputError, match="expected one number, zero or more"):
            block.numbered(number)


def test_row_57_an_id_below_zero_is_refused_by_sensor_and_time(tmp_path: Path) -> None:
    def negative(text: str) -> str:
        return re.sub(r"^5\.0,\d+,", "5.0,-3,", text, count=1, flags=re.M)

    says = r"sensor 'camera' at t = 5\.0 s: found id -3, expected zero or more"
    with pytest.raises(InputError, match=says):
        _ = recorded(tmp_path, "camera.csv", negative).problem


def test_row_25_an_id_without_a_known_point_is_refused_by_sensor_and_time(tmp_path: Path) -> None:
    def other(text: str) -> str:
        return re.sub(r"^5\.0,\d+,", "5.0,70,", text, count=1, flags=re.M)

    scenario, taken = load_scenario(INSPECTION, SHORT), recorded(tmp_path, "camera.csv", other)
    size, dim = scenario.layout.size, scenario.layout.dim
    prior = Prior(taken.problem.prior.x[:size], taken.problem.prior.P[:dim, :dim])
    problem = replace(taken.problem, sensors=scenario.true_sensors, prior=prior, numbered={})
    says = r"sensor 'camera' at t = 5\.0 s: stereo_point: found id 70, expected 0 to 7"
    with pytest.raises(InputError, match=says):
        run_estimator("ekf", problem)


@pytest.mark.parametrize("number", ["9007199254740993", "1e30"])
def test_row_57_ids_that_a_float_cannot_tell_apart_are_refused(tmp_path: Path, number: str) -> None:
    def huge(text: str) -> str:
        return re.sub(r"^5\.0,\d+,", f"5.0,{number},", text, count=1, flags=re.M)

    with pytest.raises(InputError, match=r"camera\.csv, line \d+, column id: .* below 2\^53"):
        _ = recorded(tmp_path, "camera.csv", huge).recording


@pytest.mark.parametrize("number", ["9007199254740993", "1e30", "-1", "0.5"])
def test_row_42_a_true_point_without_such_an_id_is_refused(tmp_path: Path, number: str) -> None:
    with pytest.raises(InputError, match=r"truth_point\.csv, line 10, column id: .* below 2\^53"):
        _ = recorded(tmp_path, "truth_point.csv", lambda text: f"{text}{number},0,0,1\n").recording


def test_row_42_a_map_of_recorded_data_is_not_mixed_with_that_of_the_scenario(
    tmp_path: Path,
) -> None:
    """It may be of another target: a point that only the scenario's map has is not its truth."""
    truth = recorded(tmp_path, "truth_point.csv", lambda text: text[: text.index("\n3,") + 1])
    assert truth.recording.truth is not None
    names = [n for n in truth.recording.truth.values if n.startswith("point[")]
    assert sorted(names) == ["point[0]", "point[1]", "point[2]"]


@pytest.mark.parametrize(("sigma", "found"), [("1e300 m", "1e+300 m"), ("1e-300 m", "1e-300 m")])
def test_row_36_a_sigma_whose_square_is_no_variance_is_refused(sigma: str, found: str) -> None:
    says = rf"prior\.point\.sigma: found {re.escape(found)}, expected one from 1e-154 to 1e\+154"
    with pytest.raises(InputError, match=says):
        load_scenario(INSPECTION, [*SHORT, f'prior.point.sigma="{sigma}"'])


def test_row_36_a_map_that_is_both_listed_and_generated_is_one_error() -> None:
    says = r"1 error\s+truth\.map: found points and box, count, seed, expected a map that is listed"
    with pytest.raises(InputError, match=says):
        load_scenario(INSPECTION, [*SHORT, "truth.map.points=[[0, 0, 1]]"])


@pytest.mark.parametrize("length", [0.0, 1e-200])
def test_row_36_a_true_normal_of_length_zero_is_refused_by_its_path(
    tmp_path: Path, length: float
) -> None:
    text = re.sub(
        r"\[truth\.map\].*?\n\n",
        "[truth.map]\npoints = [[1, 0, 0], [0, 1, 0]]\n"
        f"normals = [[0, 0, 1], [0, 0, {length}]]\n\n",
        INSPECTION.read_text(),
        flags=re.S,
    )
    (tmp_path / "listed.toml").write_text(text)
    with pytest.raises(InputError, match=r"truth\.map: found normals\[1\] of length zero"):
        load_scenario(tmp_path / "listed.toml")


def test_row_36_a_field_of_view_of_more_than_a_turn_is_refused_in_words() -> None:
    says = r"field_of_view: found \[400\.0\d*\] deg, expected .* of at most 360 deg"
    with pytest.raises(InputError, match=says):
        load_scenario(INSPECTION, [*SHORT, 'sensors.camera.field_of_view="400 deg"'])
