"""Scenarios whose points nobody knows: the true map, its prior, and what is simulated of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from passes import EXPERIMENTS, changed_tables

from relnav_graph.arrays import Array
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.problem import Prior
from relnav_graph.core.track import Recording, Truth
from relnav_graph.errors import InputError
from relnav_graph.io.dataset import write_dataset
from relnav_graph.runs.passes import open_dataset, open_pass
from relnav_graph.scenario.build import load_scenario, make_scenario
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.scenario.schema import ScenarioError
from relnav_graph.sim.sensors import Timing, measure

INSPECTION = EXPERIMENTS / "inspection.toml"
SHORT = ["time.epochs=40"]
POINTS = [[0.5, 0.5, 0.0], [-0.5, 0.5, 0.1], [0.0, -0.5, 0.2]]


def raw(*path: str, value: Any = None) -> dict[str, Any]:
    """The tables of inspection.toml with one of them changed; None: taken out."""
    return changed_tables(load_scenario(INSPECTION, SHORT).raw, *path, value=value)


def problems(*path: str, value: Any = None) -> dict[str, str]:
    with pytest.raises(ScenarioError) as raised:
        make_scenario(raw(*path, value=value), "wrong")
    return dict(raised.value.problems)


def of_camera(recording: Recording) -> list[Measurement]:
    return [m for m in recording.measurements if m.sensor == "camera"]


# The true map.


def test_a_generated_map_lies_on_a_cuboid_with_normals_outward() -> None:
    made = load_scenario(INSPECTION, ["truth.map.count=2000"]).map
    assert made is not None
    assert made.normals is not None
    half = np.array([0.5, 0.5, 0.3])
    on_face = np.abs(np.abs(made.points) - half) < 1e-12
    assert (np.abs(made.points) <= half + 1e-12).all()
    np.testing.assert_array_equal(on_face.sum(axis=1), 1)
    np.testing.assert_array_equal(made.normals, np.where(on_face, np.sign(made.points), 0.0))
    # Uniform: each face has its share of the surface, within four sigmas.
    share = on_face.mean(axis=0)
    expected = np.array([0.6, 0.6, 1.0]) / 2.2
    assert (np.abs(share - expected) < 4 * np.sqrt(expected * (1 - expected) / 2000)).all()
    again = load_scenario(INSPECTION, ["truth.map.count=2000"]).map
    other = load_scenario(INSPECTION, ["truth.map.count=2000", "truth.map.seed=2"]).map
    assert again is not None
    assert other is not None
    np.testing.assert_array_equal(again.points, made.points)
    assert np.abs(other.points - made.points).max() > 0.1


def test_the_truth_tells_where_all_points_are_seen_or_not() -> None:
    scenario = load_scenario(INSPECTION, SHORT)
    truth = scenario.simulate(0).truth
    assert truth is not None
    assert scenario.map is not None
    for i in range(50):
        expected = np.tile(scenario.map.points[i], (40, 1))
        np.testing.assert_array_equal(truth.values[f"point[{i}]"], expected)
    assert "point[50]" not in truth.values


def test_a_listed_map_has_units_and_is_seen_from_all_sides() -> None:
    listed = [["50 cm", "0.5 m", 0], [-0.5, 0.5, 0.1]]
    scenario = make_scenario(raw("truth", "map", value={"points": listed}), "listed")
    assert scenario.map is not None
    np.testing.assert_allclose(scenario.map.points, POINTS[0:1] + POINTS[1:2])
    assert {tuple(m.ids) for m in of_camera(scenario.simulate(0))} == {(0, 1)}


def test_the_simulated_camera_knows_the_map_and_that_of_the_estimators_does_not() -> None:
    scenario = load_scenario(INSPECTION, SHORT)
    assert scenario.sensors["camera"].numbered is not None  # type: ignore[attr-defined]
    twin: Any = scenario.true_sensors["camera"]
    assert twin.numbered is None
    assert scenario.map is not None
    np.testing.assert_array_equal(twin.points, scenario.map.points)
    np.testing.assert_array_equal(twin.normals, scenario.map.normals)


@pytest.mark.parametrize(
    ("value", "path", "message"),
    [
        (None, "truth.map", "missing: a simulated pass needs the points that camera would see"),
        ({"points": [[1, 2]]}, "truth.map.points", "found shape (1, 2), expected ('n', 3)"),
        ({"points": [[1, 2, "3 deg"]]}, "truth.map.points", "expected one like 'm'"),
        ({"points": POINTS, "normals": [[0, 0, 1]]}, "truth.map", "found 1 normals for 3 points"),
        ({"points": POINTS, "count": 3}, "truth.map", "found points and count, expected"),
        ({"count": 0, "box": [1, 1, 1]}, "truth.map.count", "greater than or equal to 1"),
        ({"count": 5}, "truth.map.box", "missing, and required"),
        ({"count": 5, "box": ["1 m", 0, 1]}, "truth.map.box", "expected a positive value"),
        (7, "truth.map", "found 7"),
    ],
)
def test_a_map_that_is_none_is_named_with_its_path(value: Any, path: str, message: str) -> None:
    assert message in problems("truth", "map", value=value)[path]


def test_a_map_that_no_sensor_needs_is_named() -> None:
    found = problems("sensors", "camera", "points", value=POINTS)
    assert "no sensor sees points of an unknown map" in found["truth.map"]
    assert "unknown block" in found["prior.point"]


# Its prior.


def test_one_prior_stands_for_all_points() -> None:
    scenario = make_scenario(raw("prior", "point", value={"sigma": "5 m"}), "prior")
    (name, prior), *others = scenario.numbered_priors.items()
    assert (name, others) == ("point", [])
    np.testing.assert_array_equal(prior.x, np.zeros(3))
    np.testing.assert_array_equal(prior.P, 25 * np.eye(3))
    moved = {"sigma": [1, 2, 3], "mean": ["1 m", 0, "5 cm"]}
    own = make_scenario(raw("prior", "point", value=moved), "prior").numbered_priors["point"]
    np.testing.assert_allclose(own.x, [1, 0, 0.05])
    np.testing.assert_allclose(own.P, np.diag([1.0, 4.0, 9.0]))
    measured = {"sigma": "5 m", "mean": "measured"}
    same = make_scenario(raw("prior", "point", value=measured), "prior").numbered_priors["point"]
    np.testing.assert_array_equal(same.x, prior.x)


def points_of(prior: Prior, count: int) -> Array:
    return prior.x[-3 * count :].reshape(count, 3)


def test_points_of_a_pass_have_that_prior_or_one_about_the_truth_each() -> None:
    for options, spread in (
        ({"sigma": "1 cm"}, None),
        ({"sigma": "1 cm", "mean": "truth"}, 0.0),
        ({"sigma": "1 cm", "mean": "drawn"}, 0.01),
    ):
        scenario = make_scenario(raw("prior", "point", value=options), "prior")
        recording = scenario.simulate(0)
        problem = scenario.problem(recording, 0)
        numbered = [b for b in problem.layout if b.number is not None]
        assert {b.number for b in numbered} == {int(i) for m in of_camera(recording) for i in m.ids}
        assert recording.truth is not None
        true = np.array([recording.truth.values[b.name][0] for b in numbered])
        found = points_of(problem.prior, len(numbered))
        if spread is None:
            np.testing.assert_array_equal(found, 0.0)
            continue
        off = found - true
        assert np.sqrt((off**2).mean()) == pytest.approx(spread, rel=0.3, abs=1e-15)
        P = problem.prior.P[-3 * len(numbered) :, -3 * len(numbered) :]
        np.testing.assert_allclose(P, 1e-4 * np.eye(len(P)))


def test_a_prior_of_points_changes_no_other_draw() -> None:
    one = load_scenario(INSPECTION, SHORT)
    other = make_scenario(raw("prior", "point", value={"sigma": 1, "mean": "drawn"}), "drawn")
    x, y = (s.problem(s.simulate(0), 0).prior.x[:41] for s in (one, other))
    np.testing.assert_array_equal(x, y)


@pytest.mark.parametrize(
    ("value", "path", "message"),
    [
        (None, "prior.point", "missing: every block needs a prior (here one for each, where no"),
        ({"sigma": "1 deg"}, "prior.point.sigma", "expected one like 'm'"),
        ({"sigma": 0}, "prior.point.sigma", "expected a positive value"),
        ({"sigma": 1, "mean": [1, 2]}, "prior.point.mean", "found shape (2,), expected (3,)"),
    ],
)
def test_a_wrong_prior_of_points_is_named(value: Any, path: str, message: str) -> None:
    assert message in problems("prior", "point", value=value)[path]


def test_points_drawn_about_a_truth_that_is_not_known_are_named() -> None:
    scenario = make_scenario(raw("prior", "point", value={"sigma": 1, "mean": "truth"}), "truth")
    found = scenario.simulate(0)
    assert found.truth is not None
    known = {n: v for n, v in found.truth.values.items() if not n.startswith("point")}
    less = Recording(found.times, found.measurements, found.inputs, Truth(found.truth.t, known))
    with pytest.raises(InputError, match=r"prior\.point: mean = 'truth' .* not known of point\[\d"):
        scenario.problem(less, 0)


# What is seen of it.


def test_points_go_and_come_with_the_same_ids_and_only_some_are_seen_at_once() -> None:
    scenario = load_scenario(INSPECTION)
    recording = scenario.simulate(0)
    frames = of_camera(recording)
    assert max(len(m.ids) for m in frames) == 10
    seen = np.zeros((len(frames), 50), dtype=bool)
    for k, m in enumerate(frames):
        assert (np.diff(m.ids) > 0).all()
        seen[k, m.ids] = True
    assert seen.any(axis=0).sum() >= 48
    # Point by point: none for at least half a minute, and seen again after it.
    longest = [np.diff(np.flatnonzero(column)).max() for column in seen.T if column.sum() > 1]
    assert np.median(longest) > 30
    camera: Any = scenario.true_sensors["camera"]
    assert recording.truth is not None
    for k in (0, 200, 400):
        x = [recording.truth.values[b.name][k] for b in camera.reads]
        assert set(frames[k].ids) <= set(camera.in_view(np.arange(50), *x))
        assert len(camera.in_view(np.arange(50), *x)) < 35


def test_at_most_so_many_are_drawn_evenly_by_the_sensors_own_stream() -> None:
    scenario = load_scenario(INSPECTION, ["time.epochs=400", "sensors.camera.most=3"])
    camera: Any = scenario.true_sensors["camera"]
    truth = load_scenario(INSPECTION, ["time.epochs=400"]).simulate(0).truth
    assert truth is not None
    still = Truth(
        truth.t, {n: np.tile(v[:1], (400, *[1] * (v.ndim - 1))) for n, v in truth.values.items()}
    )
    every = measure("camera", camera, Timing(), still, np.random.default_rng(1))[0].ids
    frames = measure("camera", camera, Timing(most=3), still, np.random.default_rng(1))
    assert {len(m.ids) for m in frames} == {3}
    counts = np.bincount(np.concatenate([m.ids for m in frames]), minlength=50)
    assert set(np.flatnonzero(counts)) == set(every)
    expected = 3 * 400 / len(every)
    assert (np.abs(counts[every] - expected) < 5 * np.sqrt(expected)).all()


def test_wrong_associations_carry_the_pixels_of_another_point_of_the_frame() -> None:
    clean = load_scenario(INSPECTION).simulate(0)
    scenario = load_scenario(INSPECTION, ["sensors.camera.association_errors=0.1"])
    recording = scenario.simulate(0)
    total = struck = 0
    for m, good in zip(of_camera(recording), of_camera(clean), strict=True):
        np.testing.assert_array_equal(m.ids, good.ids)
        total += len(m.ids)
        struck += len(m.wrong)
        assert good.wrong == ()
        for k, i in enumerate(m.ids):
            same = (good.z == m.z[k]).all(axis=1)
            assert same.sum() == 1  # some point's, and with that point's noise
            assert (good.ids[same][0] != i) == (i in m.wrong)
    assert total > 5000
    assert abs(struck - 0.1 * total) < 4 * np.sqrt(0.09 * total)
    assert len(recording.misassociated) == struck
    assert clean.misassociated == frozenset()
    first = next(m for m in of_camera(recording) if m.wrong)
    assert ("camera", first.t, first.wrong[0]) in recording.misassociated


def test_a_point_alone_in_its_frame_is_never_taken_for_another() -> None:
    scenario = load_scenario(
        INSPECTION, [*SHORT, "sensors.camera.association_errors=0.9", "sensors.camera.most=1"]
    )
    assert scenario.simulate(0).misassociated == frozenset()


@pytest.mark.parametrize(("key", "value"), [("most", 0), ("association_errors", 1.0)])
def test_options_of_what_is_seen_are_checked(key: str, value: Any) -> None:
    assert f"sensors.camera.{key}" in problems("sensors", "camera", key, value=value)


# Recorded data.


def test_the_map_of_a_data_set_is_known_for_its_scores(tmp_path: Path) -> None:
    scenario = load_scenario(INSPECTION, SHORT)
    recording = scenario.simulate(0)
    write_dataset(tmp_path / "set", scenario.raw, recording, *described(scenario))
    found = open_dataset(tmp_path / "set").recording
    assert found.truth is not None
    assert scenario.map is not None
    for name, point in scenario.map.values.items():
        np.testing.assert_array_equal(found.truth.values[name], np.tile(point, (40, 1)))


def described(scenario: Scenario) -> tuple[Any, ...]:
    return scenario.sensors, scenario.input_columns, {b.name: b for b in scenario.layout}


def recorded(settings: dict[str, Any]) -> Any:
    tables = raw("truth")
    del tables["time"], tables["inputs"]
    tables |= {"data": {"reader": "starry_night"}}
    full = load_scenario(INSPECTION, SHORT).simulate(0)
    assert full.truth is not None
    known = {n: v for n, v in full.truth.values.items() if not n.startswith("point")}
    truth = Truth(full.truth.t, known)
    data = Recording(full.times, full.measurements, full.inputs, truth, settings)
    return open_pass(make_scenario(tables, "recorded"), data=data)


def test_points_that_data_bring_become_the_truth_where_the_scenario_says_unknown() -> None:
    made = load_scenario(INSPECTION, SHORT).map
    assert made is not None
    brought = {"sensors": {"camera": {"points": made.points.tolist(), "fu": 1.0}}}
    found = recorded(brought)
    assert found.scenario.sensors["camera"].numbered is not None
    assert found.scenario.sensors["camera"].fu == 2000  # the scenario wins
    np.testing.assert_array_equal(found.recording.truth.values["point[7]"][3], made.points[7])
    assert "point" in found.problem.numbered
    nothing = recorded({})
    assert "point[7]" not in nothing.recording.truth.values
    assert nothing.problem.layout == found.problem.layout


@pytest.mark.parametrize("name", ["inspection", "inspection_mono", "principal_spin"])
def test_scenarios_of_unknown_maps_see_enough_of_them(name: str) -> None:
    scenario = load_scenario(EXPERIMENTS / f"{name}.toml")
    assert scenario.map is not None
    count = len(scenario.map.points)
    assert count == (20 if name == "principal_spin" else 50)
    frames = of_camera(scenario.simulate(0))
    assert len(frames) == len(scenario.times)  # the target stays in view
    assert len({int(i) for m in frames for i in m.ids}) >= 0.8 * count
    assert np.mean([len(m.ids) for m in frames]) > 7


def test_a_recorded_pass_without_its_map_can_be_checked_without_its_data() -> None:
    scenario = load_scenario(EXPERIMENTS / "starry_night_map.toml")
    assert "prior" in scenario.raw
