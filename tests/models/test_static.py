"""Constants by choice: a block that a process reads moves the rest as one that it advances."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from relnav_factors.dynamics.euler_rotation import EulerRotation
from relnav_factors.dynamics.gyro_bias import GyroBias
from relnav_factors.dynamics.receiver_clock import ReceiverClock

from relnav_graph.core.conformance.draws import draw_block
from relnav_graph.errors import InputError
from relnav_graph.maths.orbit import KeplerOrbit

LOW = KeplerOrbit(7.2e6, 0.05, 0.3)


@pytest.mark.parametrize(
    ("cls", "options", "density", "channels"),
    [
        (EulerRotation, {"torque_density": 1e-6, "orbit": LOW}, "inertia_density", 0),
        (EulerRotation, {"torque_density": 1e-6, "inertia": "full"}, "inertia_density", 0),
        (GyroBias, {"angle_random_walk_density": 1e-5}, "bias_random_walk_density", 3),
        (ReceiverClock, {"phase_density": 0.1}, "frequency_density", 0),
    ],
)
def test_a_constant_is_read_and_moves_the_rest_alike(
    cls: Any, options: dict[str, Any], density: str, channels: int
) -> None:
    walks, constant = cls(**{density: 1e-30}, **options), cls(**options)
    assert cls(**{density: 0.0}, **options).advances == constant.advances
    assert constant.advances + constant.reads == walks.advances
    assert (len(walks.noises), len(constant.noises)) == (len(walks.advances), len(walks.noises) - 1)
    rng = np.random.default_rng(4)
    x = [draw_block(b, rng, "moderate") for b in walks.advances]
    u = np.hstack([np.full((4, 1), 2.5), 0.05 * rng.normal(size=(4, channels))])
    after, F, Q = walks.transition(30.0, u, *x)
    found, F_found, Q_found = constant.transition(30.0, u, *x)
    n = sum(b.dim for b in constant.advances)
    for one, other in zip(found, after, strict=False):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(F_found, F[:n])
    np.testing.assert_allclose(Q_found, Q[:n, :n], rtol=1e-14, atol=1e-14 * np.abs(Q_found).max())
    assert np.linalg.eigvalsh(Q_found).min() > 0


def test_a_bias_is_constant_on_all_axes_or_on_none() -> None:
    noise, some = np.full(3, 1e-5), np.array([0.0, 1e-9, 1e-9])
    with pytest.raises(InputError, match=r"bias_random_walk_density: found \[0"):
        GyroBias(angle_random_walk_density=noise, bias_random_walk_density=some)
    with pytest.raises(InputError, match=r"bias_time_constant: found 600.0 s of a constant bias"):
        GyroBias(angle_random_walk_density=noise, bias_time_constant=600.0)
    with pytest.raises(InputError, match="expected one above"):
        ReceiverClock(phase_density=0.0)
