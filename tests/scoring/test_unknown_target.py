"""What `relnav explain` says of a target without a model: what can be told, and what not."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from relnav_graph.arrays import Array
from relnav_graph.cli.main import main
from relnav_graph.core.catalogue import INERTIA_MATRIX
from relnav_graph.core.numbered import members
from relnav_graph.core.problem import Problem
from relnav_graph.maths import so3
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scoring.bounds import true_trajectory
from relnav_graph.scoring.directions import ACROSS, ALONG, GAUGE, INERTIA, SCALE, named_directions
from relnav_graph.scoring.observability import explain
from relnav_graph.scoring.text import explain_table

SPIN = Path(__file__).parents[2] / "experiments" / "principal_spin.toml"
SHORT = ("time.epochs=161", "truth.map.count=12")


def opened() -> tuple[Problem, Array]:
    scenario = load_scenario(SPIN, ("time.epochs=3", "truth.map.count=60"))
    recording = scenario.simulate(0)
    problem = scenario.problem(recording, 0)
    return problem, true_trajectory(problem, recording.truth)


@pytest.fixture(scope="module")
def found() -> Any:
    """Of a spin about the middle principal axis."""
    with pytest.MonkeyPatch.context() as patch:
        lines: list[str] = []
        patch.setattr("click.echo", lambda text, **_: lines.append(text))
        with pytest.raises(SystemExit, match="0"):
            main(["explain", str(SPIN), *(p for s in SHORT for p in ("--set", s)), "--json"])
    return json.loads(lines[-1])


def test_a_principal_spin_hides_the_centre_of_mass_along_it(found: Any) -> None:
    rows = {r["direction"]: r for r in found["directions"]}
    along, across = rows[ALONG]["smoother_middle"], rows[f"{ACROSS} (x)"]["smoother_middle"]
    assert rows[ALONG]["unit"] == "mm"
    assert along > 50 * across
    assert found["statics"]["centre_of_mass"]["smoother"] == pytest.approx(along, rel=0.01)
    (said,) = (text for text in found["target"] if text.startswith(ALONG))
    assert "hardly observable" in said or "not observable" in said
    assert f"{along:.3g} mm" in said


def test_three_parameters_of_the_inertia_stay_at_the_prior_and_are_named(found: Any) -> None:
    (said,) = (text for text in found["target"] if text.startswith(INERTIA))
    assert said.startswith("inertia: 3 of 5 parameters stay at the prior")
    for part in ("moment about", "difference of the moments across", "product of the axes across"):
        assert part in said
    assert "products with the spin axis" not in said


@pytest.mark.parametrize(
    ("epochs", "along", "across", "hidden"), [(301, 137.0, 0.7, 3), (1501, 0.5, 0.3, 0)]
)
def test_sigmas_are_those_of_another_implementation(
    epochs: int, along: float, across: float, hidden: int
) -> None:
    """mm, of a prototype with the same noises and priors, whose points are not known: within 20 %.
    In 25 minutes the body has begun to swing: its product across the spin axis stays longest."""
    scenario = load_scenario(SPIN, (f"time.epochs={epochs}",))
    recording = scenario.simulate(0)
    problem = scenario.problem(recording, 0)
    told = explain("spin", problem, true_trajectory(problem, recording.truth), [], None)
    rows = {r["direction"]: r for r in told["directions"]}
    others = [rows[f"{ACROSS} ({k})"]["smoother_middle"] for k in "xy"]
    assert rows[ALONG]["smoother_middle"] == pytest.approx(along, rel=0.2)
    assert np.sqrt(np.mean(np.square(others))) == pytest.approx(across, rel=0.2)
    kept = {n: r["smoother_middle"] / r["prior"] for n, r in rows.items() if n.startswith(INERTIA)}
    assert sum(part > 0.9 for part in kept.values()) == hidden
    assert max(kept, key=lambda n: kept[n]) in (
        f"{INERTIA}difference of the moments across the spin axis",
        f"{INERTIA}product of the axes across the spin axis",
    )
    assert kept[f"{INERTIA}product of the axes across the spin axis"] > 0.75
    assert kept[f"{INERTIA}products with the spin axis (x)"] < 0.003


def test_scale_and_gauge_are_told(found: Any) -> None:
    rows = {r["direction"]: r for r in found["directions"]}
    assert rows[SCALE]["smoother_middle"] == pytest.approx(
        found["statics"]["map_scale"]["smoother"], rel=1e-6
    )
    (scale,) = (text for text in found["target"] if text.startswith(SCALE))
    assert ": observable" in scale  # of a stereo camera
    assert any(text.startswith(GAUGE) and "gauge" in text for text in found["target"])
    weak = [w for w in found["weak"] if w["direction"].startswith(GAUGE)]
    assert len(weak) == 3
    assert all(w["verdict"] == "not observable" for w in weak)


def test_a_map_is_one_line_of_the_predictions_and_the_words_are_in_the_text(found: Any) -> None:
    assert not [n for n in (*found["states"], *found["statics"]) if "[" in n]
    assert found["statics"]["point"]["smoother"] > 0
    text = explain_table(found)
    assert "What the data tell of the target" in text
    assert f"  {found['target'][0]}" in text


def test_directions_of_a_map_are_seen_by_no_camera() -> None:
    """Shifts of the body in its frame, and turns of the frame, change no sight of any point."""
    problem, x = opened()
    sensor, layout = problem.sensors["camera"], problem.layout
    named = {d.name: d for d in named_directions(problem, x[1])}
    (m,) = (m for m in problem.epochs[1].measurements if m.sensor == "camera")
    points = [layout.block(f"point[{i}]") for i in m.ids]
    values = [layout.value(x[1], b.name) for b in sensor.reads]
    own = np.array([layout.value(x[1], b.name) for b in points])
    _, jacobians = sensor.residual(m, *values, own)
    H = np.zeros((len(jacobians[0]), layout.dim))
    for block, J in zip(sensor.reads, jacobians, strict=False):
        H[:, layout.tangent(block.name)] = J
    rows = len(H) // len(points)
    for k, block in enumerate(points):
        part = slice(k * rows, (k + 1) * rows)
        H[part, layout.tangent(block.name)] = jacobians[-1][part]
    seen = np.abs(H).max()
    for name in (ALONG, ACROSS, GAUGE):
        D = named[name].D
        assert np.abs(H @ D).max() < 1e-10 * seen * np.abs(D).max(), name
    assert np.abs(H @ named[SCALE].D).max() > 1.0  # a base of two cameras tells the scale


def test_amplitudes_are_of_their_directions() -> None:
    problem, x = opened()
    for direction in named_directions(problem, x[1]):
        if direction.W is not None:
            np.testing.assert_allclose(
                direction.W.T @ direction.D, np.eye(direction.D.shape[1]), atol=1e-9
            )


def test_the_gauge_turns_the_inertia_with_the_frame() -> None:
    problem, x = opened()
    layout = problem.layout
    (gauge,) = (d for d in named_directions(problem, x[0]) if d.name == GAUGE)
    step = 1e-5
    for k, e in enumerate(np.eye(3)):
        moved = layout.retract(x[0], step * gauge.D[:, k])
        R = so3.exp(step * e)
        turned = R.T @ shape(layout.value(x[0], INERTIA_MATRIX.name)) @ R
        np.testing.assert_allclose(
            shape(layout.value(moved, INERTIA_MATRIX.name)), turned, atol=1e-8
        )
        for block in members(layout.statics)["point"]:
            before, after = layout.value(x[0], block.name), layout.value(moved, block.name)
            np.testing.assert_allclose(after, R.T @ before, atol=1e-8)


def shape(k: Array) -> Array:
    """S = sum k_a T_a, with the basis written out."""
    a, b, c, d, e = k
    b /= np.sqrt(3.0)
    return np.array([[a + b, c, d], [c, b - a, e], [d, e, -2 * b]])
