"""Every experiment runs; the published ones reach the accuracy that they are there for."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from passes import EXPERIMENTS, ZHANG, recorded

from relnav_graph.cli.main import main
from relnav_graph.io.readers import read_raw
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.toml import read_toml
from relnav_graph.units import parse_quantity

SCENARIOS = sorted(EXPERIMENTS.glob("*.toml"))
SIMULATED = [path for path in SCENARIOS if "truth" in read_toml(path)]
#: Of targets without a model, which a filter of a few epochs cannot know.
UNMAPPED = [path for path in SIMULATED if "map" in read_toml(path)["truth"]]
MAPPED = [path for path in SIMULATED if path not in UNMAPPED]


def _compare(capsys: pytest.CaptureFixture[str], *arguments: object) -> Any:
    """The estimators of a comparison that ends well."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as stopped:
        main(["compare", *map(str, arguments), "--json"])
    out, err = capsys.readouterr()
    assert stopped.value.code == 0, err
    return json.loads(out)["estimators"]


def test_there_are_simulated_and_recorded_ones() -> None:
    assert ZHANG in SIMULATED
    assert len(SCENARIOS) > len(SIMULATED)


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda p: p.stem)
def test_every_experiment_is_valid(path: Path) -> None:
    scenario = load_scenario(path)
    assert scenario.file.title
    assert scenario.file.description.strip()
    assert scenario.sensors or scenario.file.data is not None
    assert scenario.cautions == ()


@pytest.mark.parametrize("path", MAPPED, ids=lambda p: p.stem)
def test_every_simulated_experiment_runs(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keyframes = ("--set", 'sensors.closures.keyframes=["0 s", "5 s"]')  # those of a pass so short
    more = keyframes if path.stem == "closures" else ()
    rows = _compare(capsys, path, "--set", "time.epochs=12", *more)
    assert {"ekf", "iekf", "rts", "batch", "incremental", "incremental_smoothed"} <= set(rows)
    assert all(row["status"] == "ok" for row in rows.values())


def test_a_target_without_a_model_is_mapped_within_a_turn(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Nothing was known of the points, the inertia, or the rate; the truth is 2.5 deg/s."""
    path = EXPERIMENTS / "inspection.toml"
    assert path in UNMAPPED
    arguments = ("--set", "time.epochs=151", "-e", "batch", "-e", "incremental")
    rows = _compare(capsys, path, *arguments)
    assert all(row["status"] == "ok" for row in rows.values())
    for name in ("batch", "incremental"):
        row = rows[name]
        assert row["states"]["target_rate"]["rmse_last"] < 0.05
        assert 0.5 < row["statics_anees"] < 1.6
        assert row["states"]["inertia_matrix_parameters"]["rmse_last"] < 0.5
    assert rows["batch"]["states"]["relative_position"]["rmse"] < 0.1


def test_a_mounting_is_told_with_the_map(capsys: pytest.CaptureFixture[str]) -> None:
    """Half a degree and 5 cm off. Taken for known, it spoils the rest, and residuals are silent."""
    arguments = (EXPERIMENTS / "mounting_map.toml", "--set", "time.epochs=301", "-e", "batch")
    batch = _compare(capsys, *arguments)["batch"]
    assert batch["status"] == "ok"
    assert batch["anees"] < 2
    assert 0.5 < batch["statics_anees"] < 1.6
    assert batch["aligned"]["map_rmse_m"] < 0.004
    assert batch["statics"]["camera_misalignment"]["rmse"] < 0.5
    ignored = _compare(capsys, *arguments, "--set", "sensors.camera.mounting=known")["batch"]
    assert ignored["status"] == "ok"
    assert ignored["anees"] > 1000


def test_zhang2015_at_full_size(capsys: pytest.CaptureFixture[str]) -> None:
    """A tumbling target of unknown rate and inertia: smoothing halves the position error
    of the best filter, and rate and inertia are found."""
    rows = _compare(capsys, ZHANG)
    states = {name: row["states"] for name, row in rows.items()}
    batch, iekf = states["batch"], states["iekf"]
    assert {
        "relative_position",
        "relative_velocity",
        "relative_attitude",
        "target_attitude",
        "chaser_attitude",
        "target_rate",
        "inertia_ratios",
        "gyro_bias",
    } <= set(batch)
    assert batch["relative_position"]["rmse"] <= 0.5 * iekf["relative_position"]["rmse"]
    assert batch["relative_attitude"]["rmse"] <= 0.65 * iekf["relative_attitude"]["rmse"]
    assert 0.5 <= rows["batch"]["anees"] <= 2
    for name in ("iekf", "batch", "incremental", "incremental_smoothed"):
        # The truth is 2.5 deg/s and ratios of -0.5 to 0.5; nothing was known of either.
        assert states[name]["target_rate"]["rmse_last"] < 0.002
        assert states[name]["inertia_ratios"]["rmse_last"] < 0.002
    for name in batch:
        assert states["incremental_smoothed"][name]["rmse"] == pytest.approx(
            batch[name]["rmse"], rel=0.02
        )


def test_starry_night_from_frame_131_on(capsys: pytest.CaptureFixture[str]) -> None:
    """Real data. The scenario's `evaluate` leaves out the first frames, in which no frame
    shows three points."""
    path = EXPERIMENTS / "starry_night.toml"
    folder = recorded("starry_night")
    times = read_raw("starry_night", folder).times
    evaluate = load_scenario(path).file.evaluate
    assert evaluate is not None
    start, end = (parse_quantity(b, "s") if isinstance(b, str) else b * times[-1] for b in evaluate)
    assert times[128] < start <= times[130]
    assert end >= times[-1]
    rows = _compare(capsys, path, "--data", folder, "-e", "ekf", "-e", "batch")
    batch, ekf = rows["batch"]["states"], rows["ekf"]["states"]
    assert batch["relative_position"]["rmse"] <= 0.009
    assert batch["relative_attitude"]["rmse"] <= 1.65
    assert ekf["relative_position"]["rmse"] <= 0.015
    # The truth has errors of its own, which the scenario says: without them nothing would fit.
    assert 0.8 <= rows["batch"]["anees"] <= 1.3
    assert rows["batch"]["anees_without_truth_noise"] > 10
    for name in ("relative_position", "relative_attitude"):
        assert batch[name]["rmse"] < ekf[name]["rmse"]


def test_starry_night_with_its_points_withheld(capsys: pytest.CaptureFixture[str]) -> None:
    """The same pass, which makes its own map: after one rigid alignment nearly as good as with the
    known one."""
    path, folder = EXPERIMENTS / "starry_night_map.toml", recorded("starry_night")
    rows = _compare(capsys, path, "--data", folder, "-e", "batch")
    aligned = rows["batch"]["aligned"]
    assert rows["batch"]["statics"]["point"]["count"] == 20
    assert aligned["map_rmse_m"] <= 0.003
    known = _compare(capsys, EXPERIMENTS / "starry_night.toml", "--data", folder, "-e", "batch")
    for name, row in aligned["states"].items():
        assert row["rmse"] <= 1.1 * known["batch"]["states"][name]["rmse"]
