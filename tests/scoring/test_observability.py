"""`relnav explain`: what is weak is named, what is predicted comes true."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from passes import ZHANG

from relnav_graph.cli.main import main
from relnav_graph.core.models import derived_quantities
from relnav_graph.estimators import run_estimator
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scoring.bounds import true_trajectory
from relnav_graph.scoring.directions import named_directions
from relnav_graph.scoring.metrics import score

Capture = pytest.CaptureFixture[str]


def _explain(capsys: Capture, *settings: str) -> Any:
    capsys.readouterr()
    arguments = [part for s in settings for part in ("--set", s)]
    with pytest.raises(SystemExit, match="0"):
        main(["explain", str(ZHANG), "--set", "time.epochs=60", *arguments, "--json"])
    return json.loads(capsys.readouterr().out)


def _weak(found: Any) -> dict[str, float]:
    return {w["direction"]: w["kept"] for w in found["weak"]}


def test_the_heading_of_the_orbital_frame_is_named_as_what_beacons_cannot_see(
    capsys: Capture,
) -> None:
    """Tighter than what the orbit's dynamics tell, the prior is all there is."""
    found = _explain(capsys, 'prior.chaser_attitude.sigma="0.001 deg"')
    names = [n for n, kept in _weak(found).items() if n.startswith("joint rotation") and kept > 0.9]
    assert len(names) == 3
    assert all(w["verdict"] == "not observable" for w in found["weak"][:3])


def test_a_principal_spin_hides_the_inertia(capsys: Capture) -> None:
    """About a principal axis nothing couples: the ratio of the other two stays unknown."""
    spin = 'truth.target_rate=["0 deg/s", "0 deg/s", "3 deg/s"]'
    hidden = _weak(_explain(capsys, spin, "truth.torque_density=0.0"))
    inertia = [n for n in hidden if "inertia" in n]
    assert inertia
    tumbling = _weak(_explain(capsys))
    assert not [n for n in tumbling if "inertia" in n]


def test_a_target_at_rest_hides_its_inertia_wholly(capsys: Capture) -> None:
    rest = 'truth.target_rate=["0 deg/s", "0 deg/s", "0 deg/s"]'
    kept = _weak(_explain(capsys, rest, "truth.torque_density=0.0"))
    assert sorted(round(v, 2) for n, v in kept.items() if "inertia" in n) == [1.0, 1.0]


def test_noises_are_those_of_one_step(capsys: Capture) -> None:
    found = _explain(capsys)
    (sensor,) = found["sensors"]
    assert sensor["sigma"] == pytest.approx([np.deg2rad(0.0005)] * 2)
    noise = {n["block"]: n for p in found["processes"] for n in p["noise"]}
    # An angle random walk of 1e-4.5 rad/sqrt(s) over 10 s.
    walk = np.rad2deg(10**-4.5 * np.sqrt(10.0))
    assert noise["chaser_attitude"]["sigma"] == pytest.approx([walk] * 3, rel=1e-4)
    assert noise["chaser_attitude"]["unit"] == "deg"


def test_predicted_sigmas_are_those_of_the_estimators(capsys: Capture) -> None:
    found = _explain(capsys)["states"]
    scenario = load_scenario(ZHANG, ("time.epochs=60",))
    problem = scenario.problem(scenario.simulate(0), 0)
    derived = derived_quantities(scenario.layout)
    for kind, key in (("iekf", "filter"), ("batch", "smoother")):
        states = score(run_estimator(kind, problem), None, derived).states
        for name in ("relative_position", "relative_attitude", "gyro_bias"):
            assert found[name][key] == pytest.approx(states[name].sigma, rel=0.05)


def test_directions_are_tangents_of_the_state() -> None:
    """A joint rotation moves both bodies and the line between them, and no line of sight."""
    scenario = load_scenario(ZHANG, ("time.epochs=2",))
    recording = scenario.simulate(0)
    problem = scenario.problem(recording, 0)
    x = true_trajectory(problem, recording.truth)[0]
    named = {d.name: d for d in named_directions(problem, x)}
    sensor = scenario.sensors["beacons"]
    (m,) = problem.epochs[0].measurements
    blocks = [problem.layout.value(x, b.name) for b in sensor.reads]
    _, jacobians = sensor.residual(m, *blocks)
    _, places = problem.layout.gather(sensor.reads)
    H = np.hstack(jacobians)
    joint = named["joint rotation of both attitudes and the position, axis in o"].D[places]
    assert np.abs(H @ joint).max() < 1e-12
    spin = named["rotation of the target about its spin axis"].D[places]
    assert np.abs(H @ spin).max() > 1e-6


def test_the_text_has_a_line_for_each(capsys: Capture) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["explain", str(ZHANG), "--set", "time.epochs=20"])
    out = capsys.readouterr().out
    for words in (
        "beacons (beacon_los)",
        "chaser (gyro_bias, driven by gyro)",
        "relative_position [m]",
        "range, along the line of sight [m]",
        "Weak directions",
    ):
        assert words in out
