"""A stream that is killed again and again, each time in a process of its own.

A program of the tests, since it forks: ``killed_stream.py SIGNAL COUNT SEED SCENARIO LINES OUT
JOURNAL``. It kills COUNT runs with SIGNAL at random moments, lets the last one end, and
prints the exit code of each.
"""

from __future__ import annotations

import contextlib
import io
import os
import random
import sys
import tempfile
import time
from pathlib import Path

from relnav_graph.cli.main import main

OPTIONS = ("--snapshot-every", "40", "--fsync", "never", "--allow-rejects")


def _warm_up(scenario: str, lines: str, folder: str) -> None:
    """Load all code here once: the processes that are killed have it from the start."""
    few = Path(folder, "few")
    few.write_text("".join(Path(lines).read_text("utf-8").splitlines(True)[:40]), "utf-8")
    arguments = ["stream", scenario, "--from", str(few), "-o", f"{folder}/out"]
    with contextlib.suppress(SystemExit), contextlib.redirect_stderr(io.StringIO()):
        main([*arguments, "--journal", f"{folder}/journal"])


def _child(arguments: list[str]) -> int:
    """A run of the command; its process."""
    process = os.fork()
    if process:
        return process
    code = 70
    try:
        with contextlib.redirect_stderr(open(os.devnull, "w", encoding="utf-8")):
            main(arguments)
    except SystemExit as stopped:
        code = int(stopped.code or 0)
    finally:
        os._exit(code)


def _lines(out: Path) -> int:
    return out.read_bytes().count(b"\n") if out.exists() else 0


def _killed(arguments: list[str], out: Path, number: int, rng: random.Random) -> int:
    """Kill a run after some lines more, at whatever it is doing then; its exit status."""
    goal = _lines(out) + rng.randrange(0, 20)
    process = _child(arguments)
    while _lines(out) < goal:
        if os.waitpid(process, os.WNOHANG)[0]:
            raise SystemExit("it ended before it was killed")
        time.sleep(0.001)
    time.sleep(rng.random() * 0.02)
    os.kill(process, number)
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


def run(
    number: int, count: int, seed: int, scenario: str, lines: str, out: str, journal: str
) -> None:
    arguments = ["stream", scenario, "--from", lines, "-o", out, "--journal", journal, *OPTIONS]
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory() as folder:
        _warm_up(scenario, lines, folder)
    codes = [_killed(arguments, Path(out), number, rng) for _ in range(count)]
    codes.append(os.waitstatus_to_exitcode(os.waitpid(_child(arguments), 0)[1]))
    print(*codes)


if __name__ == "__main__":
    number, count, seed = map(int, sys.argv[1:4])
    run(number, count, seed, *sys.argv[4:8])
