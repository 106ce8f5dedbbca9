"""Models that break their contract: a named error, in a process of its own, no crash."""

from __future__ import annotations

import pytest
from broken_runs import run_broken


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
