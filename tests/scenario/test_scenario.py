"""Scenario files: what is read, what is refused and how, and what is simulated from them."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from passes import EXPERIMENTS, ZHANG
from scipy.special import chdtri

from relnav_graph.cli.main import main
from relnav_graph.errors import InputError
from relnav_graph.maths import so3
from relnav_graph.scenario.build import load_scenario, make_scenario
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.scenario.schema import ScenarioError
from relnav_graph.scenario.toml import override

DEGREE = math.pi / 180

# --- files that are wrong ----------------------------------------------------------------------

WRONG = """
title = "wrong in many places"
colour = "red"

[time]
step = "10 m"
epochs = 0

[processes.motion]
kind = "white_noise_acceleration"
acceleration_densty = 1

[processes.other]
kind = "nonsense"

[sensors.camera]
kind = "stereo_point_cartesian"
points = [[1, 2]]
sigma = [1, 1, -1]
gate = 2

[sensors.nameless]
points = 1

[sensors.motion_again]
kind = "white_noise_acceleration"
acceleration_density = 1

[prior]
relative_position = { sigma = "1 m", men = 3 }

[truth]
kind = "own_models"
initial = 3
"""


def _run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of a command."""
    with pytest.raises(SystemExit) as stopped:
        main([str(a) for a in arguments])
    assert isinstance(stopped.value.code, int)
    out, err = capsys.readouterr()
    return stopped.value.code, out, err


@pytest.mark.parametrize("command", ["validate", "compare"])
def test_all_errors_at_once_with_their_paths(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(WRONG, "utf-8")
    code, out, err = _run(capsys, command, path)
    assert code == 2
    assert out == ""
    for where, what in {
        "colour": "red",
        "time.step": "found unit 'm', expected one like 's'",
        "time.epochs": "found 0",
        "processes.motion.acceleration_densty": "did you mean 'acceleration_density'?",
        "processes.motion.acceleration_density": "missing, and required",
        "processes.other.kind": "found kind 'nonsense', expected one of: ",
        "sensors.camera.points": "found shape (1, 2), expected ('n', 3)",
        "sensors.camera.sigma": "found -1.0 m, expected a positive value",
        "sensors.camera.gate": "found 2",
        "sensors.nameless.kind": "found None",
        "sensors.motion_again.kind": "'white_noise_acceleration' is not one of sensors",
        "prior.relative_position.men": "found 3",
        "truth.initial": "found 3",
    }.items():
        lines = [line for line in err.splitlines() if line.startswith(f"  {where}: ")]
        assert len(lines) == 1, f"{where} in\n{err}"
        assert what in lines[0]
    assert err.startswith("error: wrong: 13 errors\n")


def test_errors_are_also_values(tmp_path: Path) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(WRONG, "utf-8")
    with pytest.raises(ScenarioError) as raised:
        load_scenario(path)
    assert "sensors.camera.sigma" in dict(raised.value.problems)


def test_missing_file_and_what_is_no_toml(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "none.toml"
    code, _, err = _run(capsys, "validate", path)
    assert code == 2
    assert str(path) in err
    assert "No such file" in err
    path.write_text("title = \nx", "utf-8")
    code, _, err = _run(capsys, "validate", path)
    assert code == 2
    assert "not valid TOML" in err
    assert "line 1" in err
    path.write_bytes(b"title = '\xff'")
    code, _, err = _run(capsys, "validate", path)
    assert code == 2
    assert "not valid TOML" in err


def test_prior_must_cover_the_state_and_only_that() -> None:
    settings = (
        "prior.foo.sigma=1",
        'prior.target_rate.sigma="1 m"',
        "prior.gyro_bias.mean=[1, 2]",
        "prior.chaser_attitude.sigma=[1, -1, 1]",
    )
    with pytest.raises(ScenarioError) as raised:
        load_scenario(ZHANG, settings)
    found = dict(raised.value.problems)
    assert "unknown block; the state has relative_position" in found["prior.foo"]
    assert found["prior.target_rate.sigma"] == "found unit 'm', expected one like 'rad/s'"
    assert found["prior.gyro_bias.mean"] == "found shape (2,), expected (3,)"
    assert found["prior.chaser_attitude.sigma"] == "found -1.0 rad, expected a positive value"
    raw = dict(load_scenario(ZHANG).raw)
    raw["prior"] = {k: v for k, v in raw["prior"].items() if k != "target_rate"}
    with pytest.raises(ScenarioError, match=r"prior\.target_rate: missing: every block needs"):
        make_scenario(raw, "zhang")


# --- settings from the command line ------------------------------------------------------------


def test_assignments_win_and_keep_the_rest() -> None:
    raw = {"a": {"b": 1, "c": 2}, "d": 3}
    found = override(raw, ["a.b=[1.5, 2]", 'a.e.f="x y"', "d=true", "g=5 deg", "a.c=a=b"])
    assert found == {
        "a": {"b": [1.5, 2], "c": "a=b", "e": {"f": "x y"}},
        "d": True,
        "g": "5 deg",
    }
    assert raw == {"a": {"b": 1, "c": 2}, "d": 3}
    for wrong in ("time", "=3", "a..b=1"):
        with pytest.raises(InputError, match=r"--set: found '.*', expected key\.path=value"):
            override(raw, [wrong])


def test_false_takes_a_table_away_and_nothing_else() -> None:
    """What a variant of a scenario does not have: the prior of a block that is not in its state."""
    scenario = load_scenario(EXPERIMENTS / "zhang2015_known_inertia.toml")
    assert "inertia_parameters" not in scenario.layout
    raw = {"prior": {"a": {"sigma": 1.0}, "b": {"sigma": 2.0}}, "on": True}
    assert override(raw, ["prior.a=false", "on=false"]) == {
        "prior": {"b": {"sigma": 2.0}},
        "on": False,
    }
    with pytest.raises(ScenarioError, match=r"prior\.target_rate"):
        load_scenario(ZHANG, ["prior.target_rate=false"])
    with pytest.raises(ScenarioError, match=r"prior\.nothing"):
        load_scenario(ZHANG, ["prior.nothing=false"])


def test_an_assignment_reaches_the_model_in_its_unit() -> None:
    scenario = load_scenario(ZHANG, ["sensors.beacons.sigma=1 arcmin", "time.epochs=7"])
    sensor: Any = scenario.sensors["beacons"]
    assert sensor.sigma == pytest.approx(DEGREE / 60)
    assert len(scenario.simulate(0).times) == 7
    with pytest.raises(ScenarioError, match=r"sensors\.beacons\.sigma: found unit 'm', expected"):
        load_scenario(ZHANG, ["sensors.beacons.sigma=1 m"])


# --- JSON schema -------------------------------------------------------------------------------


def _walk(node: Any) -> Iterator[dict[str, Any]]:
    if isinstance(node, dict):
        yield node
        for value in node.values():
            yield from _walk(value)
    elif isinstance(node, list):
        for value in node:
            yield from _walk(value)


def test_json_schema_is_whole(capsys: pytest.CaptureFixture[str]) -> None:
    """Strict JSON; every reference leads somewhere, every type is one, every kind is there."""
    code, out, _ = _run(capsys, "validate", "--schema")
    assert code == 0
    schema = json.loads(out, parse_constant=lambda name: pytest.fail(name))
    types = {"object", "array", "string", "number", "integer", "boolean", "null"}
    for node in _walk(schema):
        if isinstance(node.get("$ref"), str):
            target: Any = schema
            for part in node["$ref"].removeprefix("#/").split("/"):
                assert part in target, f"{node['$ref']} leads nowhere"
                target = target[part]
        if isinstance(node.get("type"), str) and "properties" not in node.get("type", ""):
            assert node["type"] in types
    assert {"title", "processes", "sensors", "prior"} <= set(schema["else"]["required"])
    assert schema["additionalProperties"] is False
    kinds = {
        section: {
            choice["properties"]["kind"].get("const")
            for choice in schema["else"]["properties"][section]["additionalProperties"]["anyOf"]
        }
        for section in ("processes", "sensors", "inputs")
    }
    assert {"euler_rotation", "gyro_bias"} <= kinds["processes"]
    assert {"beacon_los", "stereo_point"} <= kinds["sensors"]
    assert {"rate_integrating_gyro"} <= kinds["inputs"]
    assert kinds["processes"] & kinds["sensors"] == {None}  # of somebody's module


# --- simulation: prior, truth, streams ---------------------------------------------------------

TOY: dict[str, Any] = {
    "title": "toy",
    "time": {"step": 2.0, "epochs": 5},
    "processes": {
        "motion": {"kind": "white_noise_acceleration", "acceleration_density": 0.01},
        "electronics": {
            "kind": "toy_model:ThermalDrift",
            "time_constant": "30 s",
            "density": "1 cm/sqrt(s)",
        },
    },
    "sensors": {
        "ranger": {"kind": "toy_model:DriftingRange", "points": [[1, 0, 0]], "sigma": "1 cm"}
    },
    "prior": {
        "relative_position": {"sigma": [1, 2, 3], "mean": "truth"},
        "relative_velocity": {"sigma": "1 cm/s", "mean": ["1 cm/s", 0, "-0.5 m/s"]},
        "range_drift": {"sigma": "10 cm"},
    },
    "truth": {"kind": "own_models", "initial": {"relative_position": [9, 8, 7]}},
}


def _toy(*settings: str) -> Scenario:
    return make_scenario(override(TOY, settings), "toy")


def test_prior_mean_is_the_truth_or_drawn_or_given() -> None:
    scenario = _toy()
    draws = []
    for run in range(200):
        recording = scenario.simulate(3, run)
        prior = scenario.problem(recording, 3, run).prior
        np.testing.assert_array_equal(np.diag(prior.P), [1, 4, 9, 1e-4, 1e-4, 1e-4, 0.1**2])
        np.testing.assert_array_equal(prior.x[:6], [9, 8, 7, 0.01, 0, -0.5])
        assert recording.truth is not None
        draws.append((prior.x[6] - recording.truth.values["range_drift"][0, 0]) / 0.1)
    total = float(np.sum(np.square(draws)))
    assert chdtri(200, 0.99) < total < chdtri(200, 0.01)
    assert abs(np.mean(draws)) < 3 / np.sqrt(200)


def test_prior_attitude_is_a_rotation_vector_with_units() -> None:
    scenario = load_scenario(
        ZHANG, ["time.epochs=2", 'prior.target_attitude.mean=["90 deg", 0, 0]']
    )
    problem = scenario.problem(scenario.simulate(0), 0)
    R_ot = problem.layout.value(problem.prior.x, "target_attitude")
    np.testing.assert_allclose(R_ot, [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-15)


def test_prior_that_needs_an_unknown_truth_says_so() -> None:
    scenario = _toy()
    recording = scenario.simulate(0)
    object.__setattr__(recording, "truth", None)
    with pytest.raises(InputError, match=r"prior\.relative_position: mean = 'truth' needs the tr"):
        scenario.problem(recording, 0)


def test_own_models_draw_the_noise_that_they_state() -> None:
    """Steps of a long pass, less what the model predicts, over the model's own sigma."""
    scenario = _toy("time.epochs=400")
    truth = scenario.simulate(1).truth
    assert truth is not None
    assert "inverse crime" in truth.source
    np.testing.assert_array_equal(truth.values["relative_position"][0], [9, 8, 7])
    decay = np.exp(-2 / 30)
    d = truth.values["range_drift"][:, 0]
    steps = (d[1:] - decay * d[:-1]) / np.sqrt(0.01**2 * 15 * (1 - decay**2))
    v = truth.values["relative_velocity"]
    kicks = np.diff(v, axis=0) / (0.01 * np.sqrt(2))
    for total, n in ((np.sum(steps**2), 399), (np.sum(kicks**2), 3 * 399)):
        assert chdtri(n, 0.995) < total < chdtri(n, 0.005)


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("truth.initial.target_rate=[1,2,3]", r"truth\.initial: no block \['target_rate'\]"),
        ("truth.initial.range_drift=[1,2]", r"truth\.initial\.range_drift: found \[1, 2\], expec"),
        (
            'inputs.gyro={kind="rate_integrating_gyro", period=1, angle_random_walk_density=0,'
            " bias_random_walk_density=0}",
            r"inputs\.gyro: a truth of kind own_models wants constant_input",
        ),
    ],
)
def test_own_models_refuse_what_they_cannot_do(setting: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        _toy(setting).simulate(0)


def test_scenario_for_recorded_data_cannot_be_simulated() -> None:
    raw = {k: v for k, v in TOY.items() if k != "truth"}
    with pytest.raises(InputError, match=r"toy: no \[truth\] and \[time\] to simulate from; give"):
        make_scenario(raw, "toy").simulate(0)


def test_a_sensor_more_leaves_the_others_as_they_were() -> None:
    alone = _toy().simulate(7, 2)
    fix = 'sensors.first={kind="toy_model:PositionFix", covariance=[[1,0,0],[0,1,0],[0,0,1]]}'
    together = _toy(fix).simulate(7, 2)
    before = [m for m in alone.measurements if m.sensor == "ranger"]
    after = [m for m in together.measurements if m.sensor == "ranger"]
    assert len(before) == len(after) == 5
    assert len(together.measurements) == 10
    for a, b in zip(before, after, strict=True):
        assert a.z.tobytes() == b.z.tobytes()
    assert alone.truth is not None
    assert together.truth is not None
    for name, values in alone.truth.values.items():
        assert values.tobytes() == together.truth.values[name].tobytes()
    # Seeds and runs do change them.
    for other in (_toy().simulate(8, 2), _toy().simulate(7, 3)):
        assert other.measurements[0].z.tobytes() != before[0].z.tobytes()


def test_sensors_of_one_kind_have_noise_of_their_own() -> None:
    ranger = TOY["sensors"]["ranger"]
    raw = {**TOY, "sensors": {"ranger": ranger, "other": ranger}}
    recording = make_scenario(raw, "toy").simulate(7)
    assert recording.truth is not None
    noise = {
        name: [
            float(m.z[0, 0] - np.linalg.norm(r - [1, 0, 0]) - d[0])
            for r, d, m in zip(
                recording.truth.values["relative_position"],
                recording.truth.values["range_drift"],
                [m for m in recording.measurements if m.sensor == name],
                strict=True,
            )
        ]
        for name in ("ranger", "other")
    }
    assert np.abs(np.subtract(noise["ranger"], noise["other"])).min() > 1e-6
    for values in noise.values():
        assert 0 < np.std(values) < 0.03


def test_period_of_a_sensor() -> None:
    recording = _toy('sensors.ranger.period="4 s"').simulate(0)
    assert [m.t for m in recording.measurements] == [0.0, 4.0, 8.0]


def test_a_period_between_the_epochs_brings_epochs_of_its_own() -> None:
    """Every 1.5 steps: one epoch more in three, at which nobody else measures."""
    fix = 'sensors.first={kind="toy_model:PositionFix", covariance=[[1,0,0],[0,1,0],[0,0,1]]}'
    recording = _toy('sensors.ranger.period="3 s"', fix).simulate(0)
    grid, own = {0.0, 2.0, 4.0, 6.0, 8.0}, {0.0, 3.0, 6.0}
    assert recording.times.tolist() == sorted(grid | own)
    for sensor, times in (("ranger", own), ("first", grid)):
        assert {m.t for m in recording.measurements if m.sensor == sensor} == times


def test_orbit_of_the_scenario_reaches_every_model_that_asks() -> None:
    scenario = load_scenario(ZHANG)
    orbits = [getattr(p, "orbit", None) for p in scenario.processes.values()]
    assert len([o for o in orbits if o is not None and o.semi_major_axis == 7.2e6]) == 3
    assert scenario.truth.semi_major_axis == 7.2e6
    own, given = scenario.truth.target_attitude, np.array([10.0, -20.0, 30.0]) * DEGREE
    np.testing.assert_allclose(so3.exp(own).T @ so3.exp(given), np.eye(3), atol=1e-15)


def test_every_experiment_is_found() -> None:
    assert {"zhang2015.toml", "starry_night.toml"} <= {p.name for p in EXPERIMENTS.glob("*.toml")}
