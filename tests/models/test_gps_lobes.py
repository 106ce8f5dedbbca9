"""Which navigation satellites are heard: by their lobes, from below and from above them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from relnav_factors.sensors.gps_pseudorange import GpsPseudorange

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError

ALL = GpsPseudorange(sigma=30.0, mask=-np.pi / 2)
MAIN = replace(ALL, main_lobe=np.radians(21.3))
BOTH = replace(MAIN, side_lobe=np.radians([28.0, 35.0]))


def heard(sensor: GpsPseudorange, r_c: Array) -> set[int]:
    return set(sensor.in_view(sensor.observables(), r_c, np.zeros(1)).tolist())


def off_nadir(r_c: Array) -> Array:
    """Of each satellite, the angle at it between the Earth's centre and the chaser, deg, from the
    three sides of the triangle."""
    a = np.linalg.norm(ALL.places(ALL.observables()), axis=1)
    b = np.linalg.norm(ALL.places(ALL.observables()) - r_c, axis=1)
    angle: Array = np.degrees(np.arccos((a**2 + b**2 - r_c @ r_c) / (2 * a * b)))
    return angle


def test_a_low_orbit_lies_in_all_main_lobes() -> None:
    """asin(6878 km / 26560 km) = 15 deg: side lobes bring nothing there."""
    for seed in range(20):
        r_c = np.random.default_rng(seed).normal(size=3)
        r_c *= 6.878e6 / np.linalg.norm(r_c)
        assert heard(ALL, r_c) == heard(MAIN, r_c) == heard(BOTH, r_c)
        assert off_nadir(r_c).max() < 15.1


def test_above_the_satellites_side_lobes_bring_more() -> None:
    counts = []
    for seed in range(20):
        r_c = np.random.default_rng(seed).normal(size=3)
        r_c *= 4.2164e7 / np.linalg.norm(r_c)
        angle, there = off_nadir(r_c), heard(ALL, r_c)
        main = {i for i in there if angle[i] <= 21.3}
        side = {i for i in there if 28.0 <= angle[i] <= 35.0}
        assert heard(MAIN, r_c) == main
        assert heard(BOTH, r_c) == main | side
        counts.append((len(main), len(main | side), len(there)))
    few, more, most = np.mean(counts, axis=0)
    assert 0 < few < more < most


@pytest.mark.parametrize(
    "lobes",
    [
        {"side_lobe": np.array([0.5, 0.6])},
        {"main_lobe": 0.4, "side_lobe": np.array([0.3, 0.6])},
        {"main_lobe": 0.4, "side_lobe": np.array([0.6, 0.5])},
        {"main_lobe": 0.4, "side_lobe": np.array([0.6, 28.0])},
    ],
)
def test_a_side_lobe_that_is_none_is_refused(lobes: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"gps_pseudorange\.side_lobe: found .* main_lobe"):
        GpsPseudorange(sigma=30.0, **lobes)
