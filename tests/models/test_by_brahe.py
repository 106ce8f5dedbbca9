"""Time, frames, gravity, orbits and messages are those of an independent library, brahe."""

from __future__ import annotations

from pathlib import Path

import by_brahe
import pytest
from ccsds import EPOCH, track

pytestmark = pytest.mark.skipif(not by_brahe.FOUND, reason="needs brahe, of the extra dev")


def test_times_and_leap_seconds() -> None:
    assert by_brahe.time_apart() == 0.0


def test_axes_that_turn_with_the_earth() -> None:
    position, velocity = by_brahe.frames_apart()
    assert position < 3e-4  # brahe knows the time to 0.6 us
    assert velocity < 3e-7


def test_the_pull_of_the_earth() -> None:
    assert by_brahe.gravity_apart() < 5e-14


def test_the_pull_of_sun_and_moon() -> None:
    """Two series of different length, of which the smallest pull is 2e-7 m/s^2."""
    assert by_brahe.third_bodies_apart() < 2e-9


def test_an_orbit_and_its_transition_matrix() -> None:
    position, matrix = by_brahe.orbit_apart()
    assert position < 1e-5
    assert matrix < 1e-8


def test_messages(tmp_path: Path) -> None:
    states, quaternions = by_brahe.messages_apart(track(), EPOCH, tmp_path)
    assert states < 2e-9
    assert quaternions < 1e-15
