"""Rows 36 and 55: kinds that are strangers' code, of the wrong section, or no model at all."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from passes import ZHANG, relnav

Capture = pytest.CaptureFixture[str]

STRANGE = """
from dataclasses import dataclass

class NoDataclass:
    kind = "no_dataclass"

@dataclass
class NoModel:
    kind = "no_model"

@dataclass
class Fails:
    kind = "fails"
    def __post_init__(self):
        1 / 0

class NoName:
    kind = 3
"""


@pytest.fixture
def importable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("1 / 0", "ZeroDivisionError: division by zero"),
        ("raise SystemExit(0)", "SystemExit: 0"),
        ("import sys; sys.exit()", "SystemExit"),
        ("def broken(:", "SyntaxError: invalid syntax"),
        ("import no_such_package", "ModuleNotFoundError: No module named 'no_such_package'"),
    ],
)
def test_row_55_a_module_that_cannot_be_imported_is_an_error_of_its_path(
    importable: Path, capsys: Capture, content: str, says: str
) -> None:
    """Also one that would leave with exit code 0: that of a valid scenario."""
    name = f"stranger_{abs(hash(content))}"
    (importable / f"{name}.py").write_text(content + "\n")
    for path in ("sensors.beacons", "processes.target", "truth", "inputs.gyro"):
        given = ("validate", ZHANG, "--set", f"{path}.kind={name}:Model")
        code, out, err = relnav(capsys, *given)
        assert (code, out) == (2, ""), err
        assert any(f"  {path}.kind: " in line and says in line for line in err.splitlines()), err
    code, out, err = relnav(capsys, "validate", ZHANG, "--set", f"estimators=['{name}:Model']")
    assert (code, out) == (2, "")
    assert "estimators[0]: " in err
    assert says in err
    assert relnav(capsys, "compare", ZHANG, "-e", f"{name}:Model")[0] == 2
    assert name not in sys.modules


@pytest.mark.parametrize("path", ["sensors.beacons", "processes.target", "truth", "inputs.gyro"])
@pytest.mark.parametrize(
    ("cls", "says"),
    [
        ("NoDataclass", "is not a dataclass"),
        ("NoModel", ""),
        ("Fails", "Fails cannot be made: ZeroDivisionError: division by zero"),
        ("NoName", "expected a class with a kind"),
        ("Missing", "AttributeError"),
        ("", "AttributeError"),
    ],
)
def test_row_36_a_class_that_is_no_model(
    importable: Path, capsys: Capture, path: str, cls: str, says: str
) -> None:
    (importable / "strange_models.py").write_text(STRANGE)
    table = f"{path}={{kind='strange_models:{cls}'}}"
    code, out, err = relnav(capsys, "validate", ZHANG, "--set", table)
    assert (code, out) == (2, "")
    # What the table held before stands beside its new kind; it is reported, too.
    where = path if cls == "Fails" else f"{path}.kind"
    assert any(line.startswith(f"  {where}: ") and says in line for line in err.splitlines()), err


@pytest.mark.parametrize(
    ("table", "says"),
    [
        (
            "processes.more={kind='laser_range_angles',range_sigma=1,angle_sigma=1}",
            "'laser_range_angles' is not one of processes",
        ),
        (
            "sensors.more={kind='white_noise_acceleration',acceleration_density=1}",
            "'white_noise_acceleration' is not one of sensors",
        ),
        ("inputs.more={kind='attitude_tracking'}", ""),
        ("truth={kind='rate_integrating_gyro'}", ""),
    ],
)
def test_row_36_kinds_of_other_sections(capsys: Capture, table: str, says: str) -> None:
    code, out, err = relnav(capsys, "validate", ZHANG, "--set", table)
    assert (code, out) == (2, ""), err
    where = table.partition("=")[0]
    assert any(line.startswith(f"  {where}") and says in line for line in err.splitlines()), err


@pytest.mark.parametrize("value", ["[1, 2]", "3", "'leo'", "[{a=1}]"])
def test_row_36_an_orbit_that_is_no_table(capsys: Capture, value: str) -> None:
    code, out, err = relnav(capsys, "validate", ZHANG, "--set", f"orbit={value}")
    assert (code, out) == (2, "")
    assert any(line.startswith("  orbit: ") for line in err.splitlines()), err


def test_row_36_an_estimator_that_is_none(importable: Path, capsys: Capture) -> None:
    (importable / "strange_models.py").write_text(STRANGE)
    for given in (
        ("-e", "strange_models:NoModel"),
        ("--set", "estimators=['strange_models:NoModel']"),
    ):
        code, out, err = relnav(capsys, "compare", ZHANG, *given)
        assert (code, out) == (2, "")
        assert "expected an estimator, with run(problem)" in err
