"""Mountings and lags found from a pass, and held by another one."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from passes import EXPERIMENTS, recorded, relnav

from relnav_graph.errors import InputError
from relnav_graph.maths import so3
from relnav_graph.runs.calibration import calibrate
from relnav_graph.runs.passes import open_pass
from relnav_graph.scenario.build import load_scenario

Capture = pytest.CaptureFixture[str]
MOUNTING = EXPERIMENTS / "mounting.toml"
NOISE = (
    "truth_noise={"
    + ",".join(
        ['relative_position="1 mm"', 'chaser_attitude="2 arcsec"', 'target_attitude="2 arcsec"']
    )
    + "}"
)
FEW = ("--set", "time.epochs=121")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated pass as recorded data; its camera is mounted as no scenario says."""
    from relnav_graph.cli.main import main

    out = tmp_path_factory.mktemp("calibration") / "pass"
    with pytest.raises(SystemExit) as stopped:
        main(["simulate", str(MOUNTING), *FEW, "--seed", "3", "-o", str(out)])
    assert stopped.value.code == 0
    return out


def test_mountings_are_found_within_their_covariance_and_held(
    folder: Path, tmp_path: Path, capsys: Capture
) -> None:
    fragment = tmp_path / "found.toml"
    options = ("--data", folder, "--sensor", "camera", "--no-lags", "--set", NOISE)
    code, out, err = relnav(capsys, "calibrate", MOUNTING, *options, "-o", fragment, "--json")
    assert code == 0, err
    found = json.loads(out)
    recorded = open_pass(MOUNTING, data=folder).recording
    assert recorded.truth is not None
    for name, row in found["mountings"].items():
        true = recorded.truth.values[name][0]
        off = so3.log(true) if true.shape == (3, 3) else true
        e, P = np.array(row["value"]) - off, np.array(row["covariance"])
        assert e @ np.linalg.solve(P, e) < 21.1  # chi-square, three axes, 1e-4
        assert all(row["told"])
    held = tmp_path / "held.toml"
    held.write_text(f'base = ["{MOUNTING}", "found.toml"]')
    scenario = load_scenario(held)
    assert not [b.name for b in scenario.layout if b.name.startswith("camera_")]
    code, out, err = relnav(capsys, "compare", held, "--data", folder, "-e", "batch", "--json")
    assert code == 0, err
    assert json.loads(out)["estimators"]["batch"]["anees"] < 2.0
    considered = load_scenario(held, ["sensors.camera.mounting=estimated"])
    assert considered.problem_at(considered.prior(recorded.truth, 0.0, 0)).considered == (
        "camera_misalignment",
        "camera_displacement",
    )


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ((), "expected that of chaser_attitude and target_attitude and relative_position"),
        (("--sensor", "gyro"), "found sensor 'gyro', expected one of those that can be"),
        (("--lag", "camera"), "found input 'camera', expected one of those that can be"),
        (("--setting", "sensors.camera.points"), "expected a number of a sensor or a process"),
        (("--setting", "camera"), "expected a number of a sensor or a process"),
    ],
)
def test_what_cannot_be_calibrated(
    folder: Path, capsys: Capture, options: tuple[str, ...], says: str
) -> None:
    noise = ("--set", NOISE) if options else ()
    code, _, err = relnav(capsys, "calibrate", MOUNTING, "--data", folder, *noise, *options)
    assert code == 2
    assert says in err


def test_without_truth_a_lever_arm_is_held_unless_asked_for(folder: Path) -> None:
    opened = open_pass(MOUNTING, data=folder)
    found = calibrate(opened, ["camera"], (), truth=False)
    held = {m.block.name: m.held for m in found.mounts}
    assert held == {"camera_misalignment": False, "camera_displacement": True}
    assert list(found.sensors["camera"]) == ["sensor_attitude"]
    asked = calibrate(opened, ["camera"], (), truth=False, arms=True)
    assert not any(m.held for m in asked.mounts)


def test_lag_and_baseline_of_a_pass_that_has_neither_wrong(folder: Path) -> None:
    opened = open_pass(MOUNTING, data=folder)
    found = calibrate(opened, (), ["gyro"], ["sensors.camera.baseline"], truth=False)
    lag, baseline = found.parameters
    assert abs(lag.value) < 4 * lag.sigma
    assert abs(baseline.value - 1.0) < 4 * baseline.sigma
    assert lag.told
    assert baseline.told


def test_the_camera_and_the_gyro_of_starry_night(tmp_path: Path, capsys: Capture) -> None:
    """From 250 frames, what holds on the next ones."""
    data, nominal = recorded("starry_night"), EXPERIMENTS / "starry_night_nominal.toml"
    frames = "data.options.frames=[131,380]"
    options = ("--data", data, "--lag", "gyro", "--set", frames)
    fragment = tmp_path / "found.toml"
    assert relnav(capsys, "calibrate", nominal, *options, "-o", fragment)[0] == 0
    found = tomllib.loads(fragment.read_text())
    assert 0.08 < found["stamps"]["gyro"]["lag"] < 0.14
    held = tmp_path / "held.toml"
    held.write_text(f'base = ["{nominal}", "found.toml"]')
    rest = ("--set", "data.options.frames=[381,680]", "--set", "evaluate=[0,1]", "-e", "batch")

    def rmse(path: Path) -> dict[str, Any]:
        code, out, err = relnav(capsys, "compare", path, "--data", data, *rest, "--json")
        assert code == 0, err
        states = json.loads(out)["estimators"]["batch"]["states"]
        return {name: row["rmse"] for name, row in states.items() if "rmse" in row}

    before, after = rmse(nominal), rmse(held)
    assert after["relative_position"] < 0.7 * before["relative_position"]
    assert after["relative_attitude"] < before["relative_attitude"]


def test_nothing_to_calibrate() -> None:
    opened = open_pass(EXPERIMENTS / "xiong2013_0p1m.toml", assignments=["time.epochs=5"])
    with pytest.raises(InputError, match="neither a mounting nor an input"):
        calibrate(opened, (), ())
