"""A closed loop whose truth drives a gyro: true means with errors that no command changes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest
from passes import truth_of

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import CHASER_ATTITUDE
from relnav_graph.core.state import Block
from relnav_graph.core.track import Truth
from relnav_graph.errors import InputError
from relnav_graph.maths import so3
from relnav_graph.runs.closed_loop import fly
from relnav_graph.scenario.build import make_scenario
from relnav_graph.scoring.deviations import errors


class _Turning:
    """A chaser that turns at the rate that it is told to."""

    def __init__(self) -> None:
        self.t, self.R, self.w = 0.0, so3.exp(np.array([0.3, -0.2, 0.5])), np.zeros(3)

    def values(self) -> Mapping[str, Array]:
        return {"chaser_attitude": self.R, "chaser_rate": self.w}

    def advance(
        self, t: float, command: Array | None, edges: Mapping[str, Array]
    ) -> Mapping[str, Array]:
        self.w = np.zeros(3) if command is None else command
        self.R, self.t = self.R @ so3.exp(self.w * (t - self.t)), t
        return {name: np.tile(self.w, (len(e) - 1, 1)) for name, e in edges.items()}


@dataclass(frozen=True)
class TurningChaser:
    """The truth of it."""

    kind: ClassVar[str] = "turning_chaser"
    source: ClassVar[str] = "a toy"

    def fly(self, t: float, rng: np.random.Generator) -> _Turning:
        return _Turning()

    def simulate(self, times: Array, rng: np.random.Generator) -> Truth:
        raise NotImplementedError


@dataclass(frozen=True)
class TurnHome:
    """Turns it back to the identity."""

    kind: ClassVar[str] = "turn_home"
    reads: ClassVar[tuple[str, ...]] = ("chaser_attitude",)
    own: ClassVar[tuple[str, ...]] = ()
    controlled: ClassVar[tuple[Block, ...]] = ()
    start: float = 10.0

    def command(self, t: float, estimate: Mapping[str, Array], own: Mapping[str, Array]) -> Array:
        return -0.05 * so3.log(np.ascontiguousarray(estimate["chaser_attitude"]))

    def control_errors(self, values: Mapping[str, Array]) -> dict[str, Array]:
        return {}


GYRO = {
    "title": "a chaser that turns home by its own star tracker and gyro",
    "time": {"step": 1.0, "epochs": 201},
    "processes": {
        "chaser": {
            "kind": "gyro_bias",
            "angle_random_walk_density": 1e-5,
            "bias_random_walk_density": 1e-7,
        }
    },
    "sensors": {"stars": {"kind": "star_tracker", "sigma": 1e-3}},
    "prior": {"chaser_attitude": {"sigma": 1e-2}, "gyro_bias": {"sigma": 1e-4}},
    "truth": {"kind": "test_closed_loop_inputs:TurningChaser"},
    "control": {"kind": "test_closed_loop_inputs:TurnHome"},
    "inputs": {
        "gyro": {
            "kind": "rate_integrating_gyro",
            "period": 0.25,
            "angle_random_walk_density": 1e-5,
            "bias_random_walk_density": 1e-7,
            "initial_bias": [1e-4, -1e-4, 5e-5],
        }
    },
}


def test_inputs_are_true_means_with_errors_that_no_command_changes() -> None:
    scenario = make_scenario(GYRO, "gyro")
    one, other = fly(scenario, "ekf", seed=5), fly(scenario, "fixed_lag", seed=5)
    e = errors(one.track, truth_of(one), [])
    assert np.linalg.norm(e["gyro_bias"].e[-1]) < 2e-5
    assert one.track.status == "ok"
    R = truth_of(one).values["chaser_attitude"]
    assert np.linalg.norm(so3.log(np.ascontiguousarray(R[-1]))) < 3e-3
    assert np.linalg.norm(so3.log(np.ascontiguousarray(R[9]))) > 0.5
    # Gyro minus the true mean rate: the same errors, whoever flies.
    found = []
    for f in (one, other):
        R = truth_of(f).values["chaser_attitude"]
        mean = CHASER_ATTITUDE.local(R[:-1], R[1:])
        u = np.array([epoch.inputs["chaser"] for epoch in f.problem.epochs[1:]])
        assert u.shape == (200, 4, 4)
        found.append(u[:, :, 1:] - mean[:, None])
    np.testing.assert_allclose(found[0], found[1], atol=1e-12)
    assert (
        truth_of(one).values["chaser_attitude"] != truth_of(other).values["chaser_attitude"]
    ).any()
    bias = truth_of(one).values["gyro_bias"]
    np.testing.assert_array_equal(bias, truth_of(other).values["gyro_bias"])
    assert np.abs(found[0].mean(axis=1) - bias[:-1]).max() < 6e-5


def test_a_sample_across_an_epoch_is_refused() -> None:
    raw: Any = json.loads(json.dumps(GYRO))
    raw["inputs"]["gyro"]["period"] = 0.3
    with pytest.raises(InputError, match=r"inputs.gyro: a sample lies across an epoch at"):
        fly(make_scenario(raw, "gyro"), "ekf", seed=5)
