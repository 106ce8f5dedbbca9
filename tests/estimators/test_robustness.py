"""Failures that must stay small: one row lost, one clear line, nothing silently wrong."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from relnav_graph.cli.main import main
from relnav_graph.core.measurement import InputSeries
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.schema import ScenarioError

ZHANG = Path(__file__).parents[2] / "experiments" / "zhang2015.toml"


def _relnav(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    return int(stop.value.code or 0), out, err


def test_a_diverging_filter_costs_its_own_row_only(capsys: pytest.CaptureFixture[str]) -> None:
    # Ten times less would be lost in the rounding of the lines of sight.
    settings = ["--set", "time.epochs=30", "--set", 'sensors.beacons.sigma="1e-11 deg"']
    code, out, _ = _relnav(
        capsys, "compare", str(ZHANG), "-e", "ekf", "-e", "batch", *settings, "--json"
    )
    rows = json.loads(out)["estimators"]
    assert code == 3
    assert rows["ekf"]["status"] == "diverged"
    assert rows["ekf"]["message"]
    assert rows["batch"]["status"] == "ok"


def test_a_track_far_from_its_covariance_is_degraded(capsys: pytest.CaptureFixture[str]) -> None:
    settings = ["--set", "time.epochs=20", "--set", "sensors.beacons.period=70.0"]
    code, out, err = _relnav(capsys, "compare", str(ZHANG), "-e", "ekf", *settings, "--json")
    assert (code, json.loads(out)["estimators"]["ekf"]["status"]) == (3, "degraded")
    assert "times what the covariance says" in err


def test_inputs_at_stamps_of_a_clock_keep_their_samples() -> None:
    """At 1.4e9 s a double is good to 2e-7 s: no sample of 0.1 s may get lost."""
    edges = 1.4e9 + 0.1 * np.arange(101, dtype=np.float64)
    series = InputSeries("gyro", edges[:-1], edges[1:], np.arange(300.0).reshape(100, 3))
    found, values = series.over(float(edges[20]), float(edges[70]))
    np.testing.assert_allclose(np.diff(found), 0.1, atol=1e-6)
    np.testing.assert_array_equal(values[:, 0], 3.0 * np.arange(20, 70))


def test_errors_of_all_tables_come_at_once() -> None:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(
            ZHANG,
            [
                'sensors.beacons.sigma="-1 deg"',
                'prior.target_rate.sigma="x"',
                "prior.foo.sigma=1",
                'estimators=["nope"]',
                "evaluate=[0.9,0.1]",
            ],
        )
    paths = {path for path, _ in caught.value.problems}
    assert paths == {
        "sensors.beacons.sigma",
        "prior.target_rate.sigma",
        "prior.foo",
        "estimators[0]",
        "evaluate",
    }


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        (['sensors.beacons.kind=":x"'], "sensors.beacons.kind: found kind ':x'"),
        (['sensors.beacons.period="-7 s"'], "sensors.beacons.period"),
        (['truth.kind="constant_input"'], "truth.relative_position: unknown key"),
    ],
)
def test_wrong_settings_end_with_2(
    settings: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    options = [text for setting in settings for text in ("--set", setting)]
    code, out, err = _relnav(capsys, "compare", str(ZHANG), "--set", "time.epochs=5", *options)
    assert (code, out) == (2, "")
    assert says in err


def test_files_that_name_each_other_as_base(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.toml").write_text('base = "b.toml"\n')
    (tmp_path / "b.toml").write_text('base = "a.toml"\n')
    code, _, err = _relnav(capsys, "validate", str(tmp_path / "a.toml"))
    assert code == 2
    assert "base: found 'a.toml', expected another file" in err


def test_truth_at_some_epochs_is_enough(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = tmp_path / "pass"
    assert (
        _relnav(capsys, "simulate", str(ZHANG), "--set", "time.epochs=6", "-o", str(data))[0] == 0
    )
    (data / "dataset.toml").unlink()  # as made by hand
    for table in data.glob("truth_*.csv"):
        table.write_text("\n".join(table.read_text().splitlines()[:3]) + "\n")
    code, out, _ = _relnav(capsys, "smooth", str(data), "-o", str(tmp_path / "out"), "--json")
    states = json.loads(out)["estimators"]["batch"]["states"]
    assert code == 0
    assert states["relative_position"]["rmse"] > 0


def test_nothing_is_computed_for_a_folder_that_cannot_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    code, out, err = _relnav(capsys, "compare", str(ZHANG), "-o", str(tmp_path / "file"))
    assert (code, out) == (2, "")
    assert "is a file, expected a folder" in err
    assert "epochs ..." not in err
