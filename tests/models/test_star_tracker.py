"""A star tracker beside an orbit: stars are at rest in i, and the state's attitudes turn with o."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from passes import EXPERIMENTS
from relnav_factors.sensors.star_tracker import StarTracker

from relnav_graph.core.measurement import Measurement
from relnav_graph.errors import InputError
from relnav_graph.maths import so3
from relnav_graph.maths.orbit import KeplerOrbit
from relnav_graph.runs.comparison import compare
from relnav_graph.scenario.build import load_scenario

ORBIT = KeplerOrbit(7.2e6, 0.05, 0.3)
PLANE = {"inclination": 0.9, "raan": -1.2, "argument_of_perigee": 2.2}
R_OC = so3.exp(np.array([0.4, -0.3, 0.9]))


def tracker(**options: Any) -> StarTracker:
    return StarTracker(sigma=np.full(3, 1e-4), **options)


def test_the_axes_are_those_of_the_orbit() -> None:
    """x of o points to the target and z along its angular momentum, as the elements have them
    (Vallado 2013, section 2.6), with the true anomaly from Kepler's equation by iteration."""
    t, e, a = 700.0, 0.05, 7.2e6
    E = 2 * np.arctan(np.sqrt((1 - e) / (1 + e)) * np.tan(0.15))
    M = E - e * np.sin(E) + t * np.sqrt(ORBIT.mu / a**3)
    for _ in range(50):
        E = M + e * np.sin(E)
    nu = 2 * np.arctan(np.sqrt((1 + e) / (1 - e)) * np.tan(E / 2))
    i, raan, u = PLANE["inclination"], PLANE["raan"], PLANE["argument_of_perigee"] + nu
    radial = [
        np.cos(raan) * np.cos(u) - np.sin(raan) * np.sin(u) * np.cos(i),
        np.sin(raan) * np.cos(u) + np.cos(raan) * np.sin(u) * np.cos(i),
        np.sin(u) * np.sin(i),
    ]
    normal = [np.sin(raan) * np.sin(i), -np.cos(raan) * np.sin(i), np.cos(i)]
    R_ic = tracker(orbit=ORBIT, **PLANE).at(t).attitude(R_OC)
    R_io = R_ic @ R_OC.T
    assert R_io[:, 0] == pytest.approx(radial, abs=1e-12)
    assert R_io[:, 2] == pytest.approx(normal, abs=1e-12)


def test_residual_and_jacobian() -> None:
    sensor = tracker(orbit=ORBIT, **PLANE)
    t, off = 700.0, np.array([0.02, -0.05, 0.04])
    z = so3.quaternion(sensor.at(t).attitude(R_OC) @ so3.exp(off))
    seen = Measurement("stars", t, z[None], np.zeros(1, np.int64))
    r, (H,) = sensor.residual(seen, R_OC)
    assert so3.exp(r) == pytest.approx(so3.exp(-off), abs=1e-12)
    for j in range(3):
        step = 1e-5 * np.eye(3)[j]
        ahead = sensor.residual(seen, R_OC @ so3.exp(step))[0]
        back = sensor.residual(seen, R_OC @ so3.exp(-step))[0]
        assert H[:, j] == pytest.approx((ahead - back) / 2e-5, abs=1e-8)
    started = next(iter(sensor.at(t).starts(np.zeros(1, np.int64), z[None], {})))
    assert started["chaser_attitude"] == pytest.approx(R_OC @ so3.exp(off), abs=1e-12)


def test_in_a_pass() -> None:
    """The chaser's attitude, which the beacons leave at 2 deg, is known with a star tracker; the
    truth's axes are its own, integrated in i."""
    plane = 'inclination="50 deg", raan="20 deg", argument_of_perigee="30 deg"'
    sets = [
        "time.epochs=40",
        f'sensors.stars={{kind="star_tracker", sigma="20 arcsec", {plane}}}',
        'prior.chaser_attitude.sigma="2 deg"',
        'truth.inclination="50 deg"',
        'truth.raan="20 deg"',
        'truth.argument_of_perigee="30 deg"',
    ]
    made = compare(load_scenario(EXPERIMENTS / "zhang2015_close.toml", sets), ("iekf", "batch"))
    for name in ("iekf", "batch"):
        found = made.summary["estimators"][name]
        assert made.track(name).status == "ok"
        assert found["states"]["chaser_attitude"]["rmse"] < 0.01
        assert found["anees"] < 2.0


def test_an_orbit_without_its_plane_is_refused() -> None:
    with pytest.raises(InputError, match=r"star_tracker.inclination: found an \[orbit\]"):
        tracker(orbit=ORBIT)
    with pytest.raises(InputError, match=r"star_tracker.raan: found no \[orbit\]"):
        tracker(raan=1.0)
