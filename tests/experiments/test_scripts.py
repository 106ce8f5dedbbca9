"""The scripts of experiments/ run, at reduced size, and find what they say."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import pytest
from passes import recorded
from scripts import loaded

from relnav_graph.scenario.build import load_scenario
from relnav_graph.study.conduct import do_runs
from relnav_graph.study.folder import StudyFolder
from relnav_graph.study.runs import StudySpec

EXPERIMENTS = Path(__file__).parents[2] / "experiments"


def _script(name: str) -> ModuleType:
    return loaded(EXPERIMENTS / f"{name}.py")


def test_native_gtsam_recovers_the_pose() -> None:
    """From priors of 0.01 rad, 0.05 rad and 0.2 m, by beacons known to 1e-4 rad."""
    errors = _script("native_gtsam").main()
    assert errors["chaser attitude [rad]"] < 0.02
    assert errors["target attitude [rad]"] < 0.02
    assert errors["relative position [m]"] < 0.1


def test_native_gtsam_shows_why_qr() -> None:
    found = _script("native_gtsam").why_qr(20)
    assert found["MULTIFRONTAL_CHOLESKY"][0] == 0  # and no error was raised
    assert found["MULTIFRONTAL_QR"][0] > 1
    assert found["MULTIFRONTAL_QR"][1] < 1e-2 * found["MULTIFRONTAL_CHOLESKY"][1]


def test_tumbling_rates_finds_the_graph_consistent() -> None:
    found = _script("tumbling_rates").main(passes=3, epochs=40)
    assert {"iekf", "iukf", "iekf_batch_start", "iekf_batch_start_smoothed", "isam2"} < set(found)
    for consistent in ("batch", "incremental", "isam2", "iekf_batch_start"):
        assert max(found[consistent]) < 2.5, consistent
    assert max(found["ukf"]) > max(found["iukf"])


def test_tune_check_finds_a_gyro_noise_declared_wrong() -> None:
    found = _script("tune_check").main(passes=2, epochs=200, jobs=1)
    for wrong, row in found.items():
        assert row["told"] == 2, wrong
        assert abs(row["median"] - 1) < 0.15, wrong
        assert row["inside"] >= 0.5, wrong


def test_a_real_range_tells_the_distance() -> None:
    found = _script("ranging_axes").main(recorded("grace_kbr"))
    ranged, fixes = (found[case]["scored part"] for case in ("with the range", "without"))
    assert ranged["distance_about_mean_mm"] <= 15
    assert fixes["distance_about_mean_mm"] > 100
    for axis in ("radial_m", "along_m", "across_m"):
        assert ranged[axis] <= 1.05 * fixes[axis]
    assert ranged["range_bias_inside_3_sigma"] == 1
    assert ranged["range_drift_inside_3_sigma"] > 0.99


def test_published_claims_rank_the_integrators(capsys: pytest.CaptureFixture[str]) -> None:
    found = _script("published_claims").main(runs=2, epochs=100)
    attitude = [
        found[name]["ekf"]["states"]["target_attitude"]["rmse_last"]
        for name in ("one Euler step", "five Euler steps", "Runge-Kutta")
    ]
    assert attitude[0] > 1.2 * attitude[1] > 1.2 * attitude[2]
    assert set(found) >= {"xiong2013", "xiong2013_0p1m"}
    assert "| relative attitude, deg | 0.866 |" in capsys.readouterr().out


def test_tracking_claims_tell_control_from_estimation(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    settings = ["time.epochs=201", "control.start=50.0", "evaluate=[0.9, 1.0]"]
    scenario = load_scenario(EXPERIMENTS / "thienel2006.toml", settings)
    folder = StudyFolder(tmp_path / "mc", StudySpec.of(scenario, 0, ("ekf", "rts")))
    assert not do_runs(folder, range(2))
    found = _script("tracking_claims").main(tmp_path / "mc")
    assert set(found) == {"published", "ekf", "rts"}
    assert found["ekf"]["control_attitude"][1] >= found["ekf"]["control_attitude"][0] > 0
    assert set(found["rts"]) == {"target_attitude", "target_rate"}
    assert "2 cases, 0 failed, 0 not ok" in capsys.readouterr().out
    alone = _script("tracking_claims").main(tmp_path / "mc", "10deg")["published"]
    assert alone == {"control_attitude": (0.75, 0.75), "control_rate": (0.00091, 0.00091)}


def test_astrobee_beats_its_authors() -> None:
    found = _script("astrobee_authors").main(recorded("astrobee_tumble"))
    assert found["batch"][0] < 0.3 < found["authors, length only"][0]


def test_soak_prints_its_marks(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["soak", "--steps", "40", "--window", "5 s"])
    _script("soak").main()
    out = capsys.readouterr().out.splitlines()
    assert out[1].split()[0] == "40"
    assert "OK" in out[1]


def test_window_accuracy_is_a_fraction_of_a_sigma(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = str(EXPERIMENTS / "zhang2015_close.toml")
    arguments = [scenario, "--epochs", "60", "--window", "15 s"]
    monkeypatch.setattr("sys.argv", ["window_accuracy", *arguments])
    _script("window_accuracy").main()
    first, *_, last = capsys.readouterr().out.splitlines()
    largest = float(first.rsplit(" ", 1)[1])
    assert 0 < largest < 0.1
    assert "ISAM2" in last


def test_benchmark_compares_everything(tmp_path: Path) -> None:
    """At a tiny size, where the figures mean nothing; that solvers agree does."""
    figure = tmp_path / "cost.png"
    script = _script("benchmark")
    sizes = (20, 30), 20, 40, 20, 20
    found = script.main(True, figure, *sizes, False, (12, 12, 20), (2, 3))
    assert set(script.measure_fixed_lag(script.problem_of(40))[0]) == set(found["fixed_lag"])
    assert set(found) == {"batch", "incremental", "fixed_lag", "online", "statics", "start"}
    assert found["online"]["isam2"]["sigma_from_batch"] < 0.3
    assert found["batch"]["gtsam_own_rows"] > 0
    assert found["batch"]["faster_than"]["gtsam_lm"] > 0  # None unless at the same optimum
    assert found["incremental"]["sigma_from_batch"] < 0.1
    assert "floor_ratio_6" in found["statics"]  # a difference of times, which may be below zero
    assert figure.stat().st_size > 1000
    json.dumps(found, allow_nan=False)


def test_random_problems_leave_nothing_wrong_without_a_word(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["random_problems", "5", "12", "-e", "iekf", "-e", "batch"])
    _script("random_problems").main()
    iekf, batch = (line.split() for line in capsys.readouterr().out.splitlines()[-3:-1])
    for name, problems, _, _, silent, right, cautioned in (iekf, batch):
        assert (problems, silent) == ("12", "0"), name
        assert int(right) > 6
        assert int(cautioned) <= 1


def test_random_tumbles_reach_the_optimum(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["random_tumbles", "2", "2", "--epochs", "201"])
    _script("random_tumbles").main()
    *lines, total = capsys.readouterr().out.splitlines()
    assert total == "2 of 2 reached the optimum"
    assert [line.split(": ")[:2] for line in lines] == [["0", "reached"], ["1", "reached"]]
    assert all(float(line.split(" sigma apart")[0].rsplit(" ", 1)[1]) < 1e-2 for line in lines)


def test_yang2016_claims_judge_a_bias_twice(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    scenario = load_scenario(EXPERIMENTS / "yang2016.toml", ["time.epochs=60"])
    kinds = ("ekf_without_drift", "ekf")
    folder = StudyFolder(tmp_path / "mc", StudySpec.of(scenario, 0, kinds))
    assert not do_runs(folder, range(2))
    picture = tmp_path / "visible.png"
    found = _script("yang2016_claims").main(tmp_path / "mc", picture)
    assert set(found) == set(kinds)
    assert all(number > 0 for row in found.values() for three in row.values() for number in three)
    assert "Accelerometer bias of 2 runs" in capsys.readouterr().out
    assert picture.stat().st_size > 1000


@pytest.mark.parametrize(("paper", "figures"), [("xiong2013", 5), ("hu2019", 4), ("yang2016", 7)])
def test_paper_figures_are_drawn(paper: str, figures: int, tmp_path: Path) -> None:
    script = _script("paper_figures")
    files = script.main(paper, tmp_path, "time.epochs=30")
    assert len(files) == 2 * figures
    assert all(file.stat().st_size > 1000 for file in files)
    assert [one.number for one in script.PAPERS["thienel2006"]] == [str(k) for k in range(1, 9)]


def test_validation_keeps_its_tolerances(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    pytest.importorskip("filterpy.kalman", reason="needs the extra dev")
    pytest.importorskip("ccsds_ndm", reason="needs the extra dev")
    pytest.importorskip("brahe", reason="needs the extra dev, where brahe has wheels")
    script, file = _script("validation"), tmp_path / "table.md"
    rows = script.main(epochs=20, file=file)
    assert len(rows) == 36
    assert [row.what for row in rows if not row.good] == []
    assert not script.Row("", "", float("nan"), 1.0, "").good
    printed = capsys.readouterr().out
    assert file.read_text("utf-8").startswith(printed)
    assert "| GTSAM 4." in printed


def test_every_script_is_run_here() -> None:
    here = Path(__file__).read_text("utf-8")
    for path in EXPERIMENTS.glob("*.py"):
        assert f'"{path.stem}"' in here, f"{path.name} has no test"
