"""Row 54: what a machine lacks for drawing costs no estimate."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from passes import ZHANG, relnav

SHORT = (str(ZHANG), "--set", "time.epochs=5", "-e", "ekf")


@pytest.mark.parametrize(
    ("backend", "commands"), [("module://no_such_package.backend", 1), ("inline", 2)]
)
def test_row_54_a_backend_that_is_not_here(tmp_path: Path, backend: str, commands: int) -> None:
    """What a notebook sets for the processes that it starts; nothing here opens a window."""
    env = {
        **os.environ,
        "MPLBACKEND": backend,
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
    }
    env.pop("DISPLAY", None)
    command = [sys.executable, "-m", "relnav_graph"]
    for arguments in (("compare", *SHORT, "-o", "out"), ("report", "out"))[:commands]:
        done = subprocess.run(
            [*command, *arguments],
            cwd=tmp_path,
            env=env,
            capture_output=True,
            text=True,
            check=False,
            timeout=120,
        )
        assert done.returncode == 0, done.stderr
    written = {p.relative_to(tmp_path / "out").as_posix() for p in tmp_path.rglob("*.*")}
    expected = {"results.nc", "summary.json", "figures/trajectory.png"}
    assert expected | ({"report.html"} if commands == 2 else set()) <= written


def test_row_54_results_and_table_survive_a_drawing_that_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import relnav_graph.figures

    def fails(*_: object) -> None:
        raise RuntimeError("no fonts")

    monkeypatch.setattr(relnav_graph.figures, "save_pass", fails)
    with pytest.raises(RuntimeError, match="no fonts"):
        relnav(capsys, "compare", *SHORT, "-o", tmp_path / "out")
    assert "relative_attitude [deg]" in capsys.readouterr().out
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "results.nc",
        "summary.json",
        "pass.json",
    }
