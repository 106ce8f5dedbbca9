"""Noise parameters from the residuals of one pass."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from passes import ZHANG, relnav

from relnav_graph.errors import InputError
from relnav_graph.runs.passes import Pass, open_pass
from relnav_graph.scenario.build import load_scenario
from relnav_graph.study.tune import TELLING, _noises, _Trial, fragment, tune

Capture = pytest.CaptureFixture[str]
CLOSE = ZHANG.with_name("zhang2015_close.toml")
GYRO, BEACONS = "processes.chaser.angle_random_walk_density", "sensors.beacons.sigma"


@pytest.fixture(scope="module")
def opened() -> Pass:
    return open_pass(CLOSE, 3, assignments=["time.epochs=150"])


@pytest.mark.parametrize("at", [0.0, math.log(4.0)])
def test_squares_less_redundancy_are_the_slope_of_the_likelihood(opened: Pass, at: float) -> None:
    """So residuals, redundancies and likelihood, each computed in its own way, are of one model."""
    noises, of_rows = _noises(opened.scenario, opened.problem)
    names, h = [BEACONS, GYRO], 0.01
    assert of_rows["beacons"] == [BEACONS] * opened.scenario.sensors["beacons"].rows
    trial = _Trial(opened, noises, of_rows)
    here = trial.fit(dict.fromkeys(names, at), names)
    slope = 0.5 * (here.squares - here.redundancy)
    for k, name in enumerate(names):
        logs = dict.fromkeys(names, at)
        high, low = (trial.fit({**logs, name: at + d}, names).log_likelihood for d in (h, -h))
        within = 0.02 * math.sqrt(here.T[k, k])
        assert (high - low) / (2 * h) == pytest.approx(slope[k], abs=within)


def test_what_is_told_is_near_and_the_rest_stays(opened: Pass) -> None:
    found = tune(opened)
    told = {name: row for name, row in found["noises"].items() if row["told"]}
    assert set(told) == {BEACONS, GYRO}
    for row in told.values():
        low, high = row["factor_ci"]
        assert low < row["factor"] < high < TELLING**2 * low
        assert row["factor"] == pytest.approx(1, abs=0.25)
        np.testing.assert_allclose(row["value"], np.multiply(row["declared"], row["factor"]))
    for name, row in found["noises"].items():
        if name not in told:
            assert row["why"]
            assert row["value"] == row["declared"]
    likelihood = found["log_likelihood"]
    assert likelihood["tuned"] >= likelihood["declared"] - 0.05
    json.dumps(found, allow_nan=False)


def test_the_file_is_a_base_of_a_scenario(tmp_path: Path, capsys: Capture) -> None:
    """Units are those of the scenario, and nothing but what was told is in it."""
    out = tmp_path / "tuned.toml"
    wrong = ("--set", f'{GYRO}="0.33 deg/sqrt(h)"', "--set", "time.epochs=150")
    code, text, err = relnav(capsys, "tune", CLOSE, "--seed", 3, *wrong, "-o", out, "--json")
    assert code == 0, err
    row = json.loads(text)["noises"][GYRO]
    assert row["unit"] == "deg/sqrt(h)"
    assert row["value"] == pytest.approx(0.1087, rel=0.15)
    assert row["declared"] == pytest.approx(0.33)
    assert "torque_density" not in out.read_text("utf-8")
    raw = CLOSE.read_text("utf-8").replace("zhang2015.toml", str(ZHANG))
    whole = tmp_path / "whole.toml"  # the scenario, with the file as the last of its bases
    whole.write_text(raw)
    from relnav_graph.scenario.toml import merge, read_toml

    both = tmp_path / "both.toml"
    both.write_text(f'base = "{out}"\n')
    merged = merge(read_toml(whole), read_toml(both))
    gyro = merged["processes"]["chaser"]
    assert gyro["angle_random_walk_density"] == f"{row['value']:.6g} deg/sqrt(h)"
    assert gyro["kind"] == "gyro_bias"
    # Again: it writes over what it wrote, and over nothing else.
    code, text, err = relnav(capsys, "tune", CLOSE, "--seed", 3, *wrong, "-o", out)
    assert code == 0, err
    assert "95 % interval" in text
    assert "cannot be told: residuals of this pass hardly show it" in text
    code, _, err = relnav(capsys, "tune", CLOSE, "-o", whole)
    assert code == 2
    assert "it stays as it is" in err
    assert whole.read_text() == raw


def test_parameters_of_one_sensor_are_told_apart() -> None:
    """A pose has two, each with its own rows. What drives none, or has a robust loss, is held."""
    path = ZHANG.with_name("astrobee_tumble.toml")
    scenario = load_scenario(path)
    from relnav_graph.core.measurement import Measurement
    from relnav_graph.study.tune import _sensor_noises

    z = np.array([[0.0, 0, 0, 1, 0, 0, 0]])
    sensor = scenario.sensors["odometry"]
    m = Measurement("odometry", 1.0, z[:, : len(sensor.columns)], np.zeros(1, dtype=np.int64))
    found, of_rows = _sensor_noises(scenario, {"odometry": m})
    assert sorted(of_rows["odometry"]) == sorted([n.name for n in found for _ in range(3)])
    assert {n.field for n in found if not n.held} == {"position_sigma", "attitude_sigma"}
    lossy = load_scenario(path, ['sensors.odometry.loss="huber"'])
    found, _ = _sensor_noises(lossy, {"odometry": m})
    assert all("robust loss" in n.held for n in found)
    found, _ = _sensor_noises(scenario, {})
    assert all(n.held == "nothing was measured" for n in found)


def test_a_fragment_quotes_names_that_toml_would_split() -> None:
    import tomllib

    row = {"told": True, "unit": "deg", "value": [1.0, 2.0], "factor": 1.0, "factor_ci": [0.9, 1.1]}
    text = fragment({"noises": {"sensors.cam.left+1.sigma": row}}, "a command")
    assert tomllib.loads(text) == {"sensors": {"cam.left+1": {"sigma": ["1 deg", "2 deg"]}}}


def test_a_pass_that_is_flown_is_refused() -> None:
    path = ZHANG.with_name("thienel2006.toml")
    flown = open_pass(path, assignments=["time.epochs=20"], loops=True)
    with pytest.raises(InputError, match="flown in closed loops"):
        tune(flown)
