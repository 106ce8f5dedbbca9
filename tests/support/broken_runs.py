"""Runs `broken_models.py` in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parent


def run_broken(*ways: str) -> dict[tuple[str, str], str]:
    """What became of each broken model, by way of reaching it and name."""
    path = os.pathsep.join([str(TESTS), *filter(None, sys.path)])
    done = subprocess.run(
        [sys.executable, str(TESTS / "broken_models.py"), *ways],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, f"{done.returncode}\n{done.stdout}\n{done.stderr}"
    lines = done.stdout.splitlines()
    assert lines[-1] == "alive"
    found = {}
    for line in lines[:-1]:
        way, name, verdict = line.split(" ", 2)
        found[way, name] = verdict
    return found
