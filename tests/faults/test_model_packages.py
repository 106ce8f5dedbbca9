"""Packages of models, as they are found: whole, hidden, broken."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from passes import EXPERIMENTS

ZHANG = str(EXPERIMENTS / "zhang2015.toml")


def relnav(path: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """The command line with a folder in front of all others that Python imports from."""
    return subprocess.run(
        [sys.executable, "-m", "relnav_graph", *arguments],
        env={**os.environ, "PYTHONPATH": str(path)},
        capture_output=True,
        text=True,
        check=False,
    )


def register(path: Path, package: str) -> None:
    """Install a third party's distribution that registers a package of models."""
    info = path / "third_party-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: third-party\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[relnav_graph.models]\nmine = {package}\n")


def test_row_55_a_stray_file_that_hides_the_models_is_named(tmp_path: Path) -> None:
    stray = tmp_path / "relnav_factors.py"
    stray.write_text("x = 1\n")
    for arguments in (("validate", ZHANG), ("list",)):
        done = relnav(tmp_path, *arguments)
        assert done.returncode == 2
        assert str(stray) in done.stderr
        assert "Traceback" not in done.stderr


def test_row_55_another_package_called_factors_changes_nothing(tmp_path: Path) -> None:
    (tmp_path / "factors.py").write_text("raise RuntimeError\n")
    done = relnav(tmp_path, "validate", ZHANG)
    assert (done.returncode, done.stderr) == (0, "")


def test_row_55_a_broken_package_of_a_third_party_is_named_and_left_out(tmp_path: Path) -> None:
    for package, content in (("gone", None), ("raises", "1 / 0"), ("leaves", "raise SystemExit")):
        path = tmp_path / package
        path.mkdir()
        register(path, package)
        if content is not None:
            (path / f"{package}.py").write_text(content + "\n")
        for arguments in (("validate", ZHANG), ("list",)):
            done = relnav(path, *arguments)
            assert done.returncode == 0, done.stderr
            assert f"mine = {package!r} of third-party cannot be imported" in done.stderr


def test_row_55_a_registered_package_without_a_model_is_refused(tmp_path: Path) -> None:
    register(tmp_path, "hollow")
    (tmp_path / "hollow.py").write_text("x = 1\n")
    done = relnav(tmp_path, "validate", ZHANG)
    assert done.returncode == 2
    assert str(tmp_path / "hollow.py") in done.stderr
