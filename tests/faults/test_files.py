"""Rows 36 and 37: wrong scenario files; disks that are full, folders that take nothing."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from passes import ZHANG, relnav
from streams import lines_of, write_scenario

from relnav_graph.scenario.build import load_scenario

TESTS = Path(__file__).parents[1] / "support"
Capture = pytest.CaptureFixture[str]
SHORT = ("--set", "time.epochs=40")


def test_row_36_three_errors_at_once_with_their_paths(tmp_path: Path, capsys: Capture) -> None:
    """An unknown key, a wrong type and a missing one; every command that reads the file."""
    text = ZHANG.read_text("utf-8")
    text = text.replace('sigma = "0.0005 deg"', 'sigmma = "0.0005 deg"', 1)
    text = text.replace('step = "10 s"', "step = true", 1)
    text = text.replace("target_rate = { sigma", "target_rates = { sigma", 1)
    path = tmp_path / "wrong.toml"
    path.write_text(text, "utf-8")
    for arguments in (
        ("validate", path),
        ("compare", path),
        ("simulate", path, "-o", tmp_path / "out"),
        ("stream", path),
    ):
        code, out, err = relnav(capsys, *arguments)
        assert (code, out) == (2, "")
        for where, says in (
            ("sensors.beacons.sigmma", "did you mean 'sigma'"),
            ("time.step", "found True"),
            ("prior.target_rate", "missing"),
        ):
            assert any(where in line and says in line for line in err.splitlines()), err
    assert [p.name for p in tmp_path.iterdir()] == ["wrong.toml"]


@pytest.mark.parametrize("command", ["validate", "compare", "stream"])
def test_row_36_a_missing_file_is_named(tmp_path: Path, capsys: Capture, command: str) -> None:
    path = tmp_path / "nowhere.toml"
    code, out, err = relnav(capsys, command, path)
    assert (code, out) == (2, "")
    assert f"{path}: cannot be read: No such file or directory" in err


LIMITED = """
import resource, signal, sys
from relnav_graph.cli.main import main
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), int(sys.argv[1])))
main(sys.argv[2:])
"""


def _with_room(
    room: int, *arguments: object, env: dict[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """A command whose files may not grow above `room` bytes: writing fails as on a full disk."""
    return subprocess.run(
        [sys.executable, "-c", LIMITED, str(room), *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        env=env,
    )


def test_row_37_nothing_half_written_when_the_disk_is_full(tmp_path: Path, capsys: Capture) -> None:
    """And what stood under the final name stays as it was."""
    data = tmp_path / "pass"
    done = _with_room(2000, "simulate", ZHANG, *SHORT, "-o", data)
    assert done.returncode == 2, done.stderr
    assert f"{data}: cannot be written: File too large; nothing was changed" in done.stderr
    assert list(tmp_path.iterdir()) == []
    assert relnav(capsys, "simulate", ZHANG, *SHORT, "-o", data)[0] == 0
    before = {p.name: p.read_bytes() for p in data.iterdir()}
    assert _with_room(2000, "simulate", ZHANG, *SHORT, "--seed", 9, "-o", data).returncode == 2
    assert {p.name: p.read_bytes() for p in data.iterdir()} == before
    assert [p.name for p in tmp_path.iterdir()] == ["pass"]


@pytest.mark.parametrize("command", ["simulate", "compare"])
def test_row_37_a_folder_that_cannot_be_written(command: str, capsys: Capture) -> None:
    """Nobody may write below /proc, whoever it is."""
    extra = ("-e", "ekf") if command == "compare" else ()
    code, _, err = relnav(capsys, command, ZHANG, *SHORT, *extra, "-o", "/proc/relnav/out")
    assert code == 2
    assert "/proc/relnav/out" in err
    assert "Traceback" not in err


def test_row_37_a_journal_on_a_full_disk(tmp_path: Path) -> None:
    """The stream ends and says where; with room again it goes on, and loses nothing."""
    path = write_scenario(tmp_path)
    lines = lines_of(load_scenario(path))
    (tmp_path / "lines").write_text("\n".join(lines) + "\n", "utf-8")
    options = ("stream", path, "--from", tmp_path / "lines", "--journal", tmp_path / "journal")
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(TESTS), *filter(None, sys.path)])}
    done = _with_room(6000, *options, env=env)
    assert done.returncode == 2, done.stderr
    assert "00000000.journal: offset " in done.stderr
    assert "cannot be written: File too large" in done.stderr
    again = _with_room(1 << 30, *options, env=env)
    assert again.returncode == 0, again.stderr
    first, then = done.stdout.splitlines(), again.stdout.splitlines()
    # The line whose record found no room may come again, under its number; no other does.
    told = [json.loads(line)["seq"] for line in first + then]
    assert 0 < len(first) < 40
    assert sorted(set(told)) == list(range(40))
    assert len(told) <= 41


def test_row_37_output_on_a_full_disk(tmp_path: Path, capsys: Capture) -> None:
    path = write_scenario(tmp_path)
    (tmp_path / "lines").write_text("\n".join(lines_of(load_scenario(path))) + "\n", "utf-8")
    code, _, err = relnav(capsys, "stream", path, "--from", tmp_path / "lines", "-o", "/dev/full")
    assert code == 2
    assert "-o /dev/full: cannot be written: No space left on device" in err
