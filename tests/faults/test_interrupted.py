"""Row 46: Ctrl-C ends what takes for ever, within a second, wherever it strikes."""

from __future__ import annotations

import ast
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import relnav_factors
from passes import ZHANG, relnav

import relnav_graph
from relnav_graph.core import steps
from relnav_graph.sim.truths.integrate import STATE_SIZE, integrate

Capture = pytest.CaptureFixture[str]


@contextmanager
def struck(after: float) -> Iterator[Callable[[], float]]:
    """Ctrl-C after some seconds. Gives what tells how long ago that was, s."""
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    due = time.monotonic() + after
    signal.setitimer(signal.ITIMER_REAL, after)
    try:
        yield lambda: time.monotonic() - due
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("kind", ["ekf", "iekf", "rts", "batch", "incremental"])
def test_row_46_every_estimator_is_stopped_within_a_second(
    kind: str, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each interval takes a hundred million steps of integration: minutes."""
    monkeypatch.setattr(steps, "MOST_STEPS", 10**12)
    given = ("compare", ZHANG, "--set", "time.epochs=5", "-e", kind)
    assert relnav(capsys, *given)[0] in (0, 3)  # compiled
    with struck(after=3.0) as since:
        code, _, err = relnav(capsys, *given, "--set", 'processes.target.max_step="1e-7 s"')
        late = since()
    assert (code, err.splitlines()[-1]) == (130, "interrupted")
    assert 0 <= late < 1


def test_row_46_a_stream_is_stopped_within_a_second(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Within an update that takes minutes, too; the journal is whole."""
    monkeypatch.setattr(steps, "MOST_STEPS", 10**12)
    given = (ZHANG, "--set", "time.epochs=5")
    code, lines, _ = relnav(capsys, "simulate", *given, "-o", "-")
    assert code == 0
    (tmp_path / "lines").write_text(lines, "utf-8")
    stream = ("stream", *given, "-e", "ekf", "--from", tmp_path / "lines")
    assert relnav(capsys, *stream, "-o", tmp_path / "whole")[0] == 0  # compiled
    slow = ("--set", 'processes.target.max_step="1e-7 s"', "--journal", tmp_path / "journal")
    command = f"sleep 3; kill -INT {os.getpid()}; date +%s.%N"
    with subprocess.Popen(["sh", "-c", command], stdout=subprocess.PIPE, text=True) as killer:
        code, _, err = relnav(capsys, *stream, *slow, "-o", tmp_path / "out")
        now = time.time()
        struck_at = float(killer.communicate()[0])
    assert (code, err.splitlines()[-1]) == (130, "ended by SIGINT; the journal is whole"), err
    assert now - struck_at < 1.5
    whole, cut = ((tmp_path / name).read_text().splitlines() for name in ("whole", "out"))
    assert len(cut) < len(whole) == 5


def test_row_46_a_truth_is_stopped_within_a_second() -> None:
    """Twenty million steps."""
    counts, h, p = np.array([20_000_000]), np.array([1e-9]), np.array([4e14, 1.0, 2.0, 3.0])
    start, out = np.ones(STATE_SIZE), np.empty((1, STATE_SIZE))
    integrate(p, start, np.array([1]), h, np.zeros((1, 6)), out)
    with struck(after=0.5) as since, pytest.raises(KeyboardInterrupt):
        integrate(p, start, counts, h, np.zeros((counts[0], 6)), out)
    assert since() < 1


def _loops(tree: ast.Module) -> Iterator[ast.FunctionDef]:
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            decorators = [ast.unparse(d) for d in node.decorator_list]
            if any(d.startswith("jit_loop(") for d in decorators):
                yield node


def test_row_46_every_compiled_loop_gives_way() -> None:
    """Those that loop themselves, and the one that leaves it to a function."""
    found = 0
    for package in (relnav_graph, relnav_factors):
        for path in sorted(Path(str(package.__file__)).parent.rglob("*.py")):
            for loop in _loops(ast.parse(path.read_text("utf-8"))):
                turns = [n for n in ast.walk(loop) if isinstance(n, (ast.For, ast.While))]
                found += 1
                if loop.name != "measure":
                    assert turns, f"{path}: {loop.name} has no loop"
                    assert "give_way(" in ast.unparse(loop), f"{path}: {loop.name} is deaf"
    assert found > 10
