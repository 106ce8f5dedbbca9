"""Row 36, further: scenarios that ask for what no machine has, or hold what no model can mean."""

from __future__ import annotations

import time

import pytest
from passes import ZHANG, relnav

from relnav_graph.errors import InputError
from relnav_graph.memory import check_room

Capture = pytest.CaptureFixture[str]


def refused(capsys: Capture, *given: object) -> list[str]:
    """What is said of a command that must be refused at once, in lines."""
    begun = time.monotonic()
    code, out, err = relnav(capsys, *given)
    assert (code, out) == (2, ""), err
    assert "Traceback" not in err
    assert time.monotonic() - begun < 10
    assert len(err) < 3000
    return err.splitlines()


# --- memory ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("path", "value", "found"),
    [
        ("time.epochs", "1000000000000", "found 1000000000000 epochs"),
        ("time.epochs", "1" + 30 * "0", "epochs, which take at least"),
        ("inputs.gyro.period", '"1e-9 s"', "found a period of 1e-09 s, 6e+12 samples"),
        ("inputs.gyro.period", "1e-320", "GiB of memory"),
    ],
)
def test_row_36_more_memory_than_the_machine_has(
    capsys: Capture, path: str, value: str, found: str
) -> None:
    """Already `validate` says so; no memory is taken."""
    for command in ("validate", "compare"):
        said = refused(capsys, command, ZHANG, "--set", f"{path}={value}")
        assert any(line.startswith(f"  {path}: ") and found in line for line in said), said


@pytest.mark.parametrize("value", ["1e-9", "1e-300"])
def test_row_36_more_steps_than_the_machine_can_draw(capsys: Capture, value: str) -> None:
    said = refused(capsys, "compare", ZHANG, "--set", f"truth.max_step={value}")
    assert f"truth.max_step {value}" in said[-1].replace("1e-09", "1e-9")


def test_room_is_what_this_process_may_use() -> None:
    check_room("nothing much", 1000)
    with pytest.raises(InputError, match="found too many, which take at least 8e"):
        check_room("too many", 2.0**30 * 1e30)
    with pytest.raises(InputError):
        check_room("what is no number", float("nan"))
