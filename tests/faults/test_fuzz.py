"""Rows 36 and 50 with mutated inputs of fixed seeds; `fuzz.py` makes as many as one likes."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from fuzzing import fuzz_lines, fuzz_scenarios, fuzz_tables

from relnav_graph.streaming.clock import Clock
from relnav_graph.streaming.session import Parsed, Session

Fuzz = Callable[[int, int], Iterator[str]]


@pytest.mark.parametrize("seed", [11, 12])
def test_row_50_mutated_lines(seed: int) -> None:
    """No exception; a refused line leaves all as it was; a journal gives it back."""
    assert list(fuzz_lines(8000, seed)) == []


@pytest.mark.parametrize(("fuzz", "count"), [(fuzz_scenarios, 300), (fuzz_tables, 500)])
def test_row_36_mutated_files(fuzz: Fuzz, count: int) -> None:
    """Refused by a named error, or valid, and within seconds."""
    assert list(fuzz(count, 13)) == []


def test_the_fuzzer_finds_what_is_planted(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that a refused line moves, a number that it leaves, an exception."""
    refuse, take = Clock.refuse, Session.take

    def moves(self: Clock, name: str, arrival: float, error: Any) -> str:
        self.heard += 1e-3
        return refuse(self, name, arrival, error)

    def leaves(self: Session, line: Parsed) -> list[dict[str, Any]]:
        out = take(self, line)
        self._last = self._last if line.n is None else line.n
        return out

    def raises(self: Session, line: Parsed) -> list[dict[str, Any]]:
        if self.lines > 50:
            raise OverflowError
        return take(self, line)

    with monkeypatch.context() as planted:
        planted.setattr(Clock, "refuse", moves)
        assert any("has changed something" in found for found in fuzz_lines(800, 0))
    with monkeypatch.context() as planted:
        planted.setattr(Session, "take", leaves)
        assert any("has changed something" in found for found in fuzz_lines(800, 0))
    with monkeypatch.context() as planted:
        planted.setattr(Session, "take", raises)
        assert all("OverflowError" in found for found in fuzz_lines(800, 0))
    assert list(fuzz_lines(800, 0)) == []


def test_the_script_runs() -> None:
    script = Path(__file__).with_name("fuzz.py")
    command = [sys.executable, str(script), "--lines", "400", "--seed", "3"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "400 lines" in done.stdout
    assert done.stdout.endswith("0 broken\n")
