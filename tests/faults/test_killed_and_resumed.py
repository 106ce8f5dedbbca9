"""Rows 23 and 35: a stream that is killed, interrupted or played again gives what it gave."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from passes import relnav
from streams import RELNAV, SCENARIO, changed, feed, lines_of, session_of, write_scenario

from relnav_graph.scenario.build import load_scenario

TESTS = Path(__file__).parents[1] / "support"
Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scenario, and a long stream with all that can go wrong in one."""
    folder = tmp_path_factory.mktemp("killed")
    path = write_scenario(folder, SCENARIO.replace("epochs = 40", "epochs = 450"))
    lines = lines_of(load_scenario(path))
    header, rest = lines[0], [changed(line) for line in lines[1:]]
    for at in range(20, len(rest) - 40, 50):
        rest[at], rest[at + 5] = rest[at + 5], rest[at]  # late, inside the window
        rest[at + 11] = rest[at + 10]  # twice, and one never
        rest[at + 20] = "no line"
        rest.insert(at + 30, rest[at - 20])  # beyond the window
    (folder / "lines").write_text("\n".join([header, *rest]) + "\n", "utf-8")
    return folder


def _arguments(folder: Path, name: str) -> list[str]:
    paths = [folder / "toy.toml", folder / "lines", folder / f"{name}.out", folder / name]
    return [str(path) for path in paths]


def _process(*arguments: object, **options: Any) -> subprocess.Popen[str]:
    path = os.pathsep.join([str(TESTS), *filter(None, sys.path)])
    return subprocess.Popen(
        [str(a) for a in arguments],
        env={**os.environ, "PYTHONPATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def _run(number: int, count: int, arguments: list[str]) -> list[int]:
    """Exit codes of a stream that was killed so many times, and then not."""
    with _process(
        sys.executable, TESTS / "killed_stream.py", number, count, 5, *arguments
    ) as process:
        out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    return [int(code) for code in out.split()]


def _told(path: Path) -> list[dict[str, Any]]:
    """Lines out but for the time that they took."""
    lines = [json.loads(line) for line in path.read_text("utf-8").splitlines()]
    assert all(line.pop("latency_ms") >= 0 for line in lines)
    return lines


@pytest.fixture(scope="module")
def uninterrupted(folder: Path) -> list[dict[str, Any]]:
    arguments = _arguments(folder, "whole")
    assert _run(signal.SIGKILL, 0, arguments) == [0]
    told = _told(Path(arguments[2]))
    assert [line["seq"] for line in told] == list(range(len(told)))
    assert len(told) > 450
    return told


def test_row_23_killed_20_times_and_resumed(
    folder: Path, uninterrupted: list[dict[str, Any]]
) -> None:
    """kill -9 at random moments: no line lost, none twice, all as without it, bit for bit."""
    arguments = _arguments(folder, "killed")
    codes = _run(signal.SIGKILL, 20, arguments)
    assert codes == [-signal.SIGKILL] * 20 + [0]
    assert _told(Path(arguments[2])) == uninterrupted


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_row_23_ended_by_a_signal_and_resumed(
    folder: Path, uninterrupted: list[dict[str, Any]], number: signal.Signals
) -> None:
    """They end it between two lines, with the exit code of the signal."""
    arguments = _arguments(folder, number.name)
    codes = _run(number, 3, arguments)
    # One that came while the command was being started may have found nobody to mind it.
    assert set(codes[:-1]) <= {128 + number, -number}
    assert 128 + number in codes
    assert codes[-1] == 0
    assert _told(Path(arguments[2])) == uninterrupted


def _wait_for(condition: Callable[[], bool]) -> None:
    for _ in range(6000):
        if condition():
            return
        time.sleep(0.01)
    pytest.fail("waited for a minute")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_row_23_a_signal_ends_a_stream_that_waits(
    folder: Path, tmp_path: Path, number: signal.Signals
) -> None:
    """While there is nothing to read: at once, and it says so; the sender begins again from
    the start, and nothing is lost or repeated on standard output."""
    lines = lines_of(load_scenario(folder / "toy.toml"))[:200]
    command = [*RELNAV, "stream", folder / "toy.toml", "--journal", tmp_path / "journal"]
    first = tmp_path / "first"
    with first.open("w", encoding="utf-8") as out:
        process = _process(*command, stdin=subprocess.PIPE)
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write("\n".join(lines[:80]) + "\n")
        process.stdin.flush()
        count = 0
        while count < 50:  # what was complete has gone out, though the stream goes on
            out.write(process.stdout.readline())
            count += 1
        process.send_signal(number)
        # Not communicate(), which passes over what readline has read ahead.
        assert process.stderr is not None
        out.write(process.stdout.read())
        err = process.stderr.read()
        process.stdin.close()
        process.wait(timeout=60)
        process.stdout.close()
        process.stderr.close()
    assert process.returncode == 128 + number, err
    assert f"ended by {number.name}; the journal is whole" in err
    with _process(*command, stdin=subprocess.PIPE) as process:
        told, err = process.communicate("\n".join(lines) + "\n", timeout=120)
    assert process.returncode == 0, err
    assert "lines came again and were skipped" in err
    both = [json.loads(line) for line in (first.read_text() + told).splitlines()]
    assert [line["seq"] for line in both] == list(range(len(both)))
    whole = feed(session_of(load_scenario(folder / "toy.toml"), lines[0]), lines)
    assert [line["estimate"] for line in both] == [line["estimate"] for line in whole]


def test_row_35_a_journal_played_again_gives_the_same(
    folder: Path, uninterrupted: list[dict[str, Any]], tmp_path: Path, capsys: Capture
) -> None:
    """From the first segment, with the same stream: the same lines; from the last one, with
    nothing new: none, and the state at the end is that of the first run."""
    arguments = _arguments(folder, "whole")
    first = tmp_path / "first"
    first.mkdir()
    shutil.copy(Path(arguments[3]) / "00000000.journal", first)
    options = ("--from", arguments[1], "--snapshot-every", 40, "--allow-rejects")
    out = tmp_path / "out"
    code, _, err = relnav(capsys, "stream", arguments[0], *options, "--journal", first, "-o", out)
    assert code == 0, err
    assert _told(out) == uninterrupted
    again = tmp_path / "again"
    shutil.copytree(arguments[3], again)
    code, _, err = relnav(
        capsys, "stream", arguments[0], *options, "--journal", again, "-o", arguments[2]
    )
    assert code == 0, err
    assert _told(Path(arguments[2])) == uninterrupted
    assert f"{len(uninterrupted)} out; at last OK" in err


def test_row_35_a_replay_that_comes_out_otherwise_is_an_error(
    folder: Path, uninterrupted: list[dict[str, Any]], tmp_path: Path, capsys: Capture
) -> None:
    """As it would with a library that rounds otherwise: here, with another line in."""
    from relnav_graph.streaming.journal import Journal

    assert uninterrupted
    arguments = _arguments(folder, "whole")
    with Journal(Path(arguments[3]), "never") as source:
        identity, snapshot, records = source.identity, source.snapshot, source.records
    changed_line = False
    with Journal(tmp_path / "other", "never") as journal:
        journal.belongs_to(identity)
        journal.rotate(snapshot)
        for kind, content in records:
            if kind == b"L" and b'"ranger"' in content and not changed_line:
                at = content.rindex(b".") + 1
                content = (
                    content[:at]
                    + (b"1" if content[at : at + 1] != b"1" else b"2")
                    + content[at + 1 :]
                )
                changed_line = True
            journal.append(kind, content)
    assert changed_line
    code, _, err = relnav(
        capsys,
        *("stream", arguments[0], "--from", arguments[1], "--snapshot-every", 40),
        *("--allow-rejects", "--journal", tmp_path / "other", "-o", arguments[2]),
    )
    assert code == 2
    assert "comes out otherwise than it did" in err
