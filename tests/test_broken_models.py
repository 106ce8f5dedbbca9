"""Models that break their contract: a named error, in a process of its own, no crash."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

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


@pytest.fixture(scope="module")
def verdicts() -> dict[tuple[str, str], str]:
    return run_broken("assembly_sensor", "assembly_process", "isam2_sensor", "isam2_process")


def test_models_called_from_python_are_guarded_too() -> None:
    """`residual` and `transition` hand the kernel arrays that it may write past as well."""
    found = run_broken("model_sensor", "model_process")
    for name in ("outside", "outside_jacobian", "before", "process_outside"):
        way = "model_process" if name.startswith("process") else "model_sensor"
        assert found[way, name].startswith("ModelError: "), f"{name}: {found[way, name]}"
        assert "wrote past its arrays" in found[way, name]


@pytest.mark.parametrize("how", ["assembly", "isam2"])
@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("unfilled", "unfilled or not finite"),
        ("outside", "wrote past its arrays"),
        ("outside_jacobian", "wrote past its arrays"),
        ("before", "wrote past its arrays"),
        ("fewer", "unfilled or not finite"),
        ("not_finite", "unfilled or not finite"),
        ("more_rows", "noise gives (1, 3, 3), expected (1, 4, 4)"),
        ("fewer_rows", "noise gives (1, 3, 3), expected (1, 2, 2)"),
        ("fewer_rows_noise", "wrote past its arrays"),
    ],
)
def test_broken_sensor_is_a_named_error_and_no_crash(
    verdicts: dict[tuple[str, str], str], how: str, name: str, says: str
) -> None:
    verdict = verdicts[f"{how}_sensor", name]
    assert verdict.startswith("ModelError: "), verdict
    assert says in verdict
    assert "fix" in verdict


@pytest.mark.parametrize("how", ["assembly", "isam2"])
@pytest.mark.parametrize(
    ("name", "kernel"),
    [("nothing", "nothing"), ("arguments", "arguments"), ("not_compiled", "nothing")],
)
def test_kernel_of_another_form_is_a_named_error(
    verdicts: dict[tuple[str, str], str], how: str, name: str, kernel: str
) -> None:
    """It returns nothing, takes other arguments, or was never compiled."""
    verdict = verdicts[f"{how}_sensor", name]
    assert verdict.startswith("ModelError: "), verdict
    assert kernel in verdict


@pytest.mark.parametrize("how", ["assembly", "isam2"])
@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("process_unfilled", "unfilled or not finite"),
        ("process_outside", "wrote past its arrays"),
    ],
)
def test_broken_process_is_a_named_error_and_no_crash(
    verdicts: dict[tuple[str, str], str], how: str, name: str, says: str
) -> None:
    verdict = verdicts[f"{how}_process", name]
    assert verdict.startswith("ModelError: "), verdict
    assert says in verdict
    assert "toy_thermal_drift" in verdict
