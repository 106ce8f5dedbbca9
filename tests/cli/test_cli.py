"""The command line, end to end on short passes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from passes import EXPERIMENTS, ZHANG
from streams import RELNAV

from relnav_graph.cli.main import COMMANDS, main

SHORT = ("--set", "time.epochs=20")
ROWS = [
    "ekf",
    "iekf",
    "rts",
    "batch",
    "incremental",
    "incremental_smoothed",
    "isam2",
    "isam2_smoothed",
]
UNITS = {
    "relative_position": "m",
    "relative_velocity": "m/s",
    "relative_attitude": "deg",
    "target_attitude": "deg",
    "chaser_attitude": "deg",
    "target_rate": "deg/s",
    "inertia_ratios": "1",
    "gyro_bias": "deg/h",
}
Capture = pytest.CaptureFixture[str]


def _run(capsys: Capture, *arguments: object) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of a command."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as stopped:
        main([str(a) for a in arguments])
    assert isinstance(stopped.value.code, int)
    out, err = capsys.readouterr()
    return stopped.value.code, out, err


def _json(text: str) -> Any:
    """One strict JSON object, and nothing else."""
    return json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))


def _states(capsys: Capture, *arguments: object) -> Any:
    """The states of the only estimator of a command that ends well."""
    code, out, _ = _run(capsys, *arguments, "--json")
    assert code == 0
    (row,) = _json(out)["estimators"].values()
    return row["states"]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("cli") / "data"
    with pytest.raises(SystemExit, match="0"):
        main(["simulate", str(ZHANG), *SHORT, "--seed", "3", "-o", str(out)])
    return out


def test_help_is_quick_and_names_every_command() -> None:
    """What makes start-up slow is not imported for it."""
    script = (
        "import sys; from relnav_graph.cli.main import main\n"
        "try: main(['--help'])\n"
        "except SystemExit as stopped: code = stopped.code\n"
        "slow = {'numpy', 'numba', 'gtsam', 'scipy', 'matplotlib', 'pydantic'} & set(sys.modules)\n"
        "print('loaded', sorted(slow)); sys.exit(code)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "loaded []" in done.stdout
    for name, text in COMMANDS.items():
        assert any(line.split() == [name, *text.split()] for line in done.stdout.splitlines()), (
            done.stdout
        )


@pytest.mark.parametrize("command", list(COMMANDS))
def test_every_command_explains_itself(capsys: Capture, command: str) -> None:
    code, out, _ = _run(capsys, command, "--help")
    assert code == 0
    assert out.startswith(f"Usage: relnav {command} ")


def test_compare_prints_one_object(capsys: Capture) -> None:
    code, out, _ = _run(capsys, "compare", ZHANG, *SHORT, "--seed", 5, "--json")
    assert code == 0
    found = _json(out)
    assert found["schema"] == 1
    assert found["scenario"] == "zhang2015"
    assert found["seed"] == 5
    assert found["epochs"] == 20
    assert {"relnav-graph", "gtsam", "numpy", "numba", "python"} <= set(found["versions"])
    assert list(found["estimators"]) == ROWS
    for name, row in found["estimators"].items():
        online = name in ("ekf", "iekf", "incremental", "isam2")
        assert row["kind"] == ("filtered" if online else "smoothed")
        assert row["status"] == "ok"
        assert row["runtime_s"] >= 0
        assert ("step_ms" in row) == online
        if online:
            names = {"median", "p99", "first_tenth_median", "last_tenth_median"}
            assert set(row["step_ms"]) == names
        assert row["rejected"] == {"beacons": 0}
        assert row["anees"] > 0
        low, high = row["anees_band"]
        assert 0 < low < 1 < high
        for state, unit in UNITS.items():
            scores = row["states"][state]
            assert scores["unit"] == unit
            for key in ("rmse", "rmse_last", "sigma", "anees"):
                assert scores[key] > 0
            assert 0 <= scores["inside_3sigma"] <= 1


def test_compare_as_a_table_with_chosen_estimators(capsys: Capture) -> None:
    code, out, _ = _run(capsys, "compare", ZHANG, *SHORT, "-e", "iekf", "-e", "rts")
    assert code == 0
    assert "relative_position [m]" in out
    assert "iekf" in out
    assert "rts" in out
    assert "batch" not in out


def test_seed_of_the_command_line_wins(capsys: Capture) -> None:
    first = _states(capsys, "compare", ZHANG, *SHORT, "-e", "iekf", "--seed", 1)
    again = _states(capsys, "compare", ZHANG, *SHORT, "-e", "iekf", "--seed", 1)
    other = _states(capsys, "compare", ZHANG, *SHORT, "-e", "iekf", "--set", "seed=2")
    same = _states(capsys, "compare", ZHANG, *SHORT, "-e", "iekf", "--seed", 2)
    assert first == again
    assert other == same
    assert other != first


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """They take seconds; one test looks at them."""
    monkeypatch.setattr("relnav_graph.figures.save_pass", lambda *_: [])


def _assert_same(found: Any, expected: Any) -> None:
    """The same states with the same scores, up to the rounding of quaternions in tables."""
    assert list(found) == list(expected)
    for state, scores in expected.items():
        for key in ("rmse", "rmse_last", "sigma", "anees"):
            assert found[state][key] == pytest.approx(scores[key], rel=1e-8), f"{state} {key}"


@pytest.mark.usefixtures("no_figures")
def test_smoothing_a_data_set_is_smoothing_the_simulation(
    capsys: Capture, dataset: Path, tmp_path: Path
) -> None:
    """Every digit goes through the tables, as CSV and as Parquet; so does --data."""
    direct = _states(capsys, "compare", ZHANG, *SHORT, "-e", "batch", "--seed", 3)
    _assert_same(_states(capsys, "smooth", dataset, "-o", tmp_path / "out"), direct)
    given = _states(capsys, "compare", ZHANG, "--data", dataset, "-e", "batch", "--seed", 3)
    _assert_same(given, direct)
    code, _, _ = _run(capsys, "convert", dataset, tmp_path / "parquet", "--parquet")
    assert code == 0
    assert (tmp_path / "parquet" / "beacons.parquet").is_file()
    stored = _states(capsys, "smooth", tmp_path / "parquet", "-o", tmp_path / "out2")
    _assert_same(stored, direct)
    # Another seed is another pass.
    other = _states(capsys, "compare", ZHANG, *SHORT, "-e", "batch", "--seed", 4)
    rmse = direct["relative_position"]["rmse"]
    assert other["relative_position"]["rmse"] != pytest.approx(rmse, rel=1e-3)


def test_smooth_writes_results_that_convert_to_tables(
    capsys: Capture, dataset: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    code, printed, _ = _run(
        capsys, "smooth", dataset, "-e", "iekf", "-e", "incremental", "-o", out, "--json"
    )
    assert code == 0
    assert json.loads((out / "summary.json").read_text()) == _json(printed)
    assert (out / "results.nc").stat().st_size > 0
    figures = {p.name for p in (out / "figures").iterdir()}
    assert {"relative_position.png", "relative_position.svg", "trajectory.png"} <= figures
    code, _, _ = _run(capsys, "convert", out / "results.nc", tmp_path / "tables")
    assert code == 0
    tables = {p.name for p in (tmp_path / "tables").iterdir()}
    assert tables == {"iekf.csv", "incremental.csv", "incremental_smoothed.csv"}
    header, *lines = (tmp_path / "tables" / "iekf.csv").read_text().splitlines()
    assert header.startswith("t_s,")
    assert len(lines) == 20


def test_validate_says_what_is_in_it(capsys: Capture, dataset: Path) -> None:
    code, out, _ = _run(capsys, "validate", ZHANG)
    assert code == 0
    assert "relative_position [r_tc_o]" in out
    assert "20 error states" in out
    code, out, _ = _run(capsys, "validate", dataset)
    assert code == 0
    assert "beacons: 120 observations" in out
    assert "epochs: 20" in out


def test_validate_finds_a_damaged_data_set(capsys: Capture, dataset: Path, tmp_path: Path) -> None:
    code, _, _ = _run(capsys, "convert", dataset, tmp_path / "copy")
    assert code == 0
    table = tmp_path / "copy" / "beacons.csv"
    table.write_bytes(table.read_bytes()[:-40])
    code, _, err = _run(capsys, "validate", tmp_path / "copy")
    assert code == 2
    assert "beacons.csv: truncated or changed" in err


def test_list_refuses_what_is_no_folder(capsys: Capture) -> None:
    code, _, err = _run(capsys, "list", "euler_rotatoin")
    says = "no such folder, kind, state or format; is it euler_rotation?"
    assert (code, err) == (2, f"error: euler_rotatoin: {says}\n")


def test_list_tells_of_a_kind_what_it_takes(capsys: Capture) -> None:
    code, out, _ = _run(capsys, "list", "gyro_bias")
    assert code == 0
    assert out.startswith("gyro_bias\n\nChaser attitude and gyro bias")
    said = {
        line.split()[0]: line.split(maxsplit=1)[1] for line in out.splitlines() if line[:2] == "  "
    }
    assert said["angle_random_walk_density"] == (
        "3 numbers, or one for all, in rad/sqrt(s) above zero"
    )
    assert said["bias_random_walk_density"].endswith("of zero or more; default [0.0, 0.0, 0.0]")
    assert said["attitude"].endswith("'relative_attitude'; default 'chaser_attitude'")
    assert said["orbit"] == "KeplerOrbit; may be left out"


def test_list_names_everything(capsys: Capture) -> None:
    code, out, _ = _run(capsys, "list", EXPERIMENTS)
    assert code == 0
    for name in (
        "beacon_los",
        "euler_rotation",
        "relative_attitude",
        "incremental",
        "rigid_body_pair",
    ):
        assert f"\n  {name} " in out
    assert "starry_night" in out
    assert "zhang2015: tumbling target" in out


@pytest.mark.usefixtures("no_figures")
def test_degraded_estimates_end_with_3_and_are_written(capsys: Capture, tmp_path: Path) -> None:
    """A gate that lets next to nothing through: the sensor is lost, and says so."""
    code, out, err = _run(
        capsys,
        *("compare", ZHANG, *SHORT, "-e", "iekf", "-o", tmp_path / "out", "--json"),
        *("--set", "sensors.beacons.gate=0.05"),
    )
    assert code == 3
    row = _json(out)["estimators"]["iekf"]
    assert row["status"] == "degraded"
    assert row["rejected"]["beacons"] > 60
    assert f"{row['rejected']['beacons']} of 120 observations of beacons rejected" in row["message"]
    assert "iekf: degraded: " in err
    assert (tmp_path / "out" / "results.nc").is_file()
    stored = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert stored["estimators"]["iekf"]["status"] == "degraded"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["frobnicate"], "No such command 'frobnicate'"),
        (["compare"], "Missing argument 'SCENARIO'"),
        (["compare", ZHANG, "--seed", "-1"], "-1 is not in the range"),
        (["compare", ZHANG, *SHORT, "-e", "kalman"], "found kind 'kalman', expected one of: batch"),
        (["compare", ZHANG, "--data", "nowhere"], "nowhere: no such folder"),
        (["compare", ZHANG, "--set", "time"], "--set: found 'time', expected key.path=value"),
        (["compare", EXPERIMENTS / "starry_night.toml"], "give recorded data"),
        (["smooth", "nowhere", "-o", "out"], "nowhere: no such folder"),
        (["convert", "nowhere", "out"], "nowhere: found nothing"),
        (["convert", EXPERIMENTS, "out"], "a raw folder needs --scenario"),
        (
            ["compare", ZHANG, *SHORT, "-e", "ekf", "--set", "evaluate=[0.9, 0.1]"],
            "evaluate: found (0.9, 0.1), expected the earlier end first",
        ),
    ],
)
def test_wrong_input_ends_with_2(
    capsys: Capture,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[object],
    says: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = _run(capsys, *arguments)
    assert code == 2
    assert out == ""
    assert says in err
    assert "Traceback" not in err
    assert not list(tmp_path.iterdir())


def test_output_folder_that_cannot_be(capsys: Capture, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", "utf-8")
    for command in (
        ["compare", ZHANG, *SHORT, "-e", "ekf", "-o", tmp_path / "file"],
        ["simulate", ZHANG, *SHORT, "-o", tmp_path / "file" / "below"],
    ):
        code, _, err = _run(capsys, *command)
        assert code == 2
        assert str(tmp_path / "file") in err
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_a_reader_who_leaves_ends_it_quietly() -> None:
    """As SIGPIPE ends a filter: 141 to the shell, and not a word."""
    command = [*RELNAV, "simulate", str(EXPERIMENTS / "zhang2015.toml"), "-o", "-"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline().startswith('{"format"')
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == 141
