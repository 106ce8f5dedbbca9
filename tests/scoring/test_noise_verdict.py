"""The verdict on declared noises: what a variance of nothing says, and what innovations add."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from static_tracks import drifting_pass

from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track
from relnav_graph.estimators import run_estimator
from relnav_graph.scoring.noise_verdict import cause_text, noise_factors, noise_verdict
from relnav_graph.scoring.variance_components import NoiseResiduals

NAMES = ("sensors.camera", "processes.gyro.density")


def factors(camera: float, gyro: float) -> list[dict[str, Any]]:
    """Of two noises, 1000 rows each, whose variances are estimated to be so many times those that
    are declared."""
    coupling = np.array([[1000.0, 200.0], [200.0, 1000.0]])
    return noise_factors(NAMES, coupling @ np.array([camera, gyro]), coupling)


@pytest.mark.parametrize("gyro", [-3.0, -0.01, 0.0])
def test_no_variance_beside_a_cause_is_no_cause(gyro: float) -> None:
    camera, other = factors(100.0, gyro)
    assert camera["named"]
    assert cause_text(camera, {}).startswith("sensors.camera is declared 10.00 times too small (")
    assert (other["tested"], other["named"]) == (False, False)
    assert other["factor"] is other["factor_ci"] is None


def test_a_negative_variance_says_nothing_of_its_noise() -> None:
    assert [(n["tested"], n["named"]) for n in factors(1.0, -0.5)] == [
        (True, False),
        (False, False),
    ]


def test_no_variance_alone_says_how_much_too_large_a_noise_is_at_least() -> None:
    """0 +- 0.0456: at most a sigma of 0.3, in 95 % of passes."""
    _, gyro = factors(1.0, 0.0)
    assert gyro["named"]
    least = 1 / gyro["factor_ci"][1]
    assert f"density is declared at least {least:.2f} times too large: " in cause_text(gyro, {})
    assert gyro["factor_ci"][1] == pytest.approx(0.3, abs=0.01)
    _, gyro = factors(1.0, 0.25)
    low, high = gyro["factor_ci"]
    assert f"2.00 times too large ({1 / high:.2f} to {1 / low:.2f})" in cause_text(gyro, {})


def test_innovations_say_what_residuals_do_not_test() -> None:
    """Only where those of every filter are off: else it is the others' linearisation."""
    problem, _ = drifting_pass(epochs=60)
    ekf, iekf = (run_estimator(kind, problem) for kind in ("ekf", "iekf"))
    names = ("sensors.ranger", "processes.motion.acceleration_density")
    found = NoiseResiduals(dict(zip(names, (500.0, 3.0), strict=True)), 0.0, np.diag([500.0, 3.0]))

    def swollen(track: Track, times: float) -> Track:
        own = {n: replace(i, v=times * i.v) for n, i in track.innovations.items()}
        return replace(track, innovations=own)

    def text(problem: Problem, *tracks: Track) -> list[str]:
        said: list[str] = noise_verdict(problem, "batch", found, tracks)["text"]
        return said

    plain = [
        "The residuals of batch are as the declared noises say.",
        "Not testable by this pass: processes.motion.acceleration_density.",
    ]
    assert text(problem, ekf, iekf) == plain
    assert text(problem, swollen(ekf, 3.0), iekf) == plain
    said = text(problem, swollen(ekf, 3.0), swollen(iekf, 3.0))
    assert said[0] == "The residuals of batch are as the declared noises that they test say."
    assert said[1] == plain[1]
    assert said[2].startswith("The innovations of ekf are not as declared: ")
    nis = 9 * float(ekf.innovations["ranger"].nis.sum()) / int(ekf.innovations["ranger"].rows.sum())
    assert f"ranger, mean square {nis:.3f} (" in said[2]
    assert said[3].startswith("`relnav tune SCENARIO --data DIR`")
    # What a cause explains needs no other.
    one = replace(found, squares={**found.squares, names[0]: 5000.0})
    causes = noise_verdict(problem, "batch", one, [swollen(ekf, 3.0)])
    assert causes["causes"] == ["sensors.ranger"]
    assert not any("innovations" in line for line in causes["text"])
