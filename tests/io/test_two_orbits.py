"""Two orbits as a relative one: o, its turn, and what is between the states of a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from ccsds import RATE, circle, formation

from relnav_graph import read_raw
from relnav_graph.errors import InputError
from relnav_graph.io.ccsds.axes import state_turns
from relnav_graph.io.known import Known
from relnav_graph.maths.frames import from_rtn, rtn_axes, to_rtn
from relnav_graph.maths.hermite import between_states


def test_two_orbits_are_a_relative_one(tmp_path: Path) -> None:
    """A chaser at rest in RTN 100 m behind, between the states of the target: to 0.1 mm."""
    t, own = np.arange(0.0, 600.0, 7.0), np.array([10.0, -100.0, 5.0, 0.0, 0.0, 0.0])
    target, chaser = formation(tmp_path, t, own)
    options = {"role": "truth", "target": target.name}
    found = read_raw("oem", chaser, options, Known(orbital=True)).truth
    assert found is not None
    np.testing.assert_allclose(found.values["relative_position"] - own[:3], 0, atol=1e-4)
    np.testing.assert_allclose(found.values["relative_velocity"], 0, atol=1e-5)
    still = read_raw("oem", chaser, options).truth
    assert still is not None
    # In axes at rest it turns once per orbit; radial is the target's own direction.
    r = circle(t)[:, :3] / 7e6
    np.testing.assert_allclose((still.values["relative_position"] * r).sum(axis=1), 10, atol=1e-4)
    fine = np.arange(0.0, 8.0, 0.5)
    target, chaser = formation(tmp_path, fine, own)
    moving = read_raw("oem", chaser, options).truth
    assert moving is not None
    r, v = (moving.values[f"relative_{n}"] for n in ("position", "velocity"))
    np.testing.assert_allclose((r[2:] - r[:-2]) / 1.0, v[1:-1], atol=2e-4)
    speed = np.linalg.norm(still.values["relative_velocity"], axis=1)
    arm = np.hypot(10.0, 100.0)  # from the axis of the turn
    np.testing.assert_allclose(speed, arm * RATE, rtol=1e-3)
    with pytest.raises(InputError, match="the target's orbit is not known: it goes from"):
        read_raw("oem", target, {"role": "truth", "target": chaser.name})


def test_errors_turn_as_states_do() -> None:
    """The matrix that turns errors from o to i, by finite differences."""
    at, own = circle(np.array([77.0])), np.array([[10.0, -100.0, 5.0, 0.1, -0.2, 0.3]])
    R_oi, w = rtn_axes(at)
    T = state_turns(np.swapaxes(R_oi, 1, 2), w)[0]
    steps = np.eye(6)[:, None] * 1e-2
    found = [(from_rtn(own + d, at) - from_rtn(own - d, at))[0] / 2e-2 for d in steps]
    np.testing.assert_allclose(np.array(found).T, T, atol=1e-6)
    np.testing.assert_allclose(to_rtn(from_rtn(own, at), at), own, atol=1e-8)
    n, h = at[0, :3] / 7e6, np.cross(at[0, :3], at[0, 3:])
    np.testing.assert_allclose(R_oi[0, 0], n, atol=1e-12)
    np.testing.assert_allclose(R_oi[0, 2], h / np.linalg.norm(h), atol=1e-12)
    np.testing.assert_allclose(w[0], [0, 0, RATE], rtol=1e-12)


def test_between_states_errs_as_it_says() -> None:
    t = 0.19 / RATE * np.arange(8, dtype=np.float64)
    times = np.linspace(0.0, float(t[-1]), 200, dtype=np.float64)
    found = between_states(t, circle(t), times)
    error = np.abs(found - circle(times))
    inner = (times > t[1]) & (times < t[-2])
    assert error[inner, :3].max() < 1e-4
    assert error[inner, 3:].max() < 1e-5
    assert np.isnan(between_states(1.1 * t, circle(1.1 * t), times[1:3])).all()
    assert np.isnan(between_states(t, circle(t), np.array([-1.0, t[-1] + 1]))).all()
    one = between_states(t[:1], circle(t[:1]), np.array([0.0, 1.0]))
    np.testing.assert_array_equal(one[0], circle(t[:1])[0])
    assert np.isnan(one[1]).all()
