"""`relnav check`: what is wrong with a third party's model is found, and named."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import pytest
from passes import relnav

Capture = pytest.CaptureFixture[str]


@pytest.mark.parametrize(
    ("cls", "says"),
    [
        ("WrongSign", "H[1, 5]: row 1 (y_m), relative_position z: found {} say {} (wrong sign?)"),
        ("OneMissing", "H[2, 0]: row 2 (z_m), chaser_attitude x: unfilled, or not finite"),
        ("OneAdded", "H[0, 4]: row 0 (x_m), relative_position y: another value when the outputs"),
        ("PastTheEnd", "H: the kernel wrote past it"),
        ("NoNoise", "covariance of noise: found variance 0.0, expected > 0"),
        ("LittleNoise", "perturb: residuals of noise put on a prediction have 0.2"),
        ("Forgetful", "F[0, 0]: offset, offset: found "),
        ("LongSteps", "H[0, "),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(capsys: Capture, cls: str, says: str) -> None:
    """Row, block and component; and nothing else is found."""
    code, out, _ = relnav(capsys, "check", f"third_party:{cls}", "--states", 8)
    assert code == 3
    assert "FAIL" in out
    for part in says.split("{}"):
        assert part in out
    faults = [line for line in out.splitlines() if line.startswith("      ")]
    assert all(says.split(":")[0] in fault for fault in faults), faults


def test_a_right_model_passes(capsys: Capture) -> None:
    """By its own example, or with parameters; a kind of a package, too."""
    for arguments in (
        ("third_party:Bearing",),
        ("third_party:Bearing", "--set", "sigma=5 cm"),
        ("third_party:Distance",),
        ("range", "--set", "sigma=1 m"),
        ("gyro_bias", "--set", "angle_random_walk_density=1e-4", "--set",
         "bias_random_walk_density=1e-6"),
        ("position_in_target",),
    ):  # fmt: skip
        code, out, err = relnav(capsys, "check", *arguments, "--states", 5)
        assert code == 0, out + err
        assert "FAIL" not in out
        assert "ok    jacobian" in out


def test_parameters_come_from_a_file_too(capsys: Capture, tmp_path: Path) -> None:
    (tmp_path / "p.toml").write_text('sigma = "3 mm"\n')
    code, out, _ = relnav(
        capsys, "check", "third_party:WrongSign", "--file", tmp_path / "p.toml", "--json"
    )
    found = json.loads(out)
    assert code == 3
    assert [c["name"] for c in found["checks"] if c["faults"]] == ["jacobian"]
    assert found["checks"][2]["faults"][0]["where"].startswith("H[1, 5]")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("nowhere:Class",), "cannot be imported: ModuleNotFoundError"),
        (
            ("third_party:Bearing", "--set", "sigma=-1 m"),
            "sigma: found -1.0 m, expected",
        ),
        (("range",), "(example()|sigma)"),
        (("third_party:ReadsNothing",), "ReadsNothing: .* expected .*core.contracts"),
        (("third_party:Raises",), "Raises: raised ZeroDivisionError: no such thing"),
    ],
)
def test_what_cannot_be_made_is_wrong_input(
    capsys: Capture, arguments: tuple[str, ...], says: str
) -> None:
    code, _, err = relnav(capsys, "check", *arguments)
    assert code == 2
    assert re.search(says, err), err


def test_a_model_in_the_working_folder_is_found(
    capsys: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = Path(__file__).parents[1] / "support" / "third_party.py"
    (tmp_path / "my_own_bearing.py").write_text(source.read_text())
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    code, out, err = relnav(capsys, "check", "my_own_bearing:OneMissing", "--states", 2)
    assert code == 3, out + err
