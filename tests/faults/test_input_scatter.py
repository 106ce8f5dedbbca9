"""An input that scatters by far more than its noise was declared."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from passes import ZHANG

from relnav_graph.arrays import Array
from relnav_graph.core.problem import Problem
from relnav_graph.core.scatter import scatter_cautions
from relnav_graph.scenario.build import load_scenario


@pytest.fixture(scope="module", name="problem")
def problem_() -> Problem:
    scenario = load_scenario(ZHANG, ["time.epochs=120"])
    return scenario.problem(scenario.simulate(0), 0)


def declared(problem: Problem, times: float) -> Problem:
    """The same with a density of the gyro's white noise that is so many times as large."""
    gyro: Any = problem.processes["chaser"]
    other = replace(gyro, angle_random_walk_density=times * gyro.angle_random_walk_density)
    return replace(problem, processes={**problem.processes, "chaser": other})


def _times(text: str) -> float:
    (found,) = re.findall(r"(\S+) times what processes.chaser.angle_random_walk_density", text)
    return float(found)


@pytest.mark.parametrize("times", [1.0, 0.3, 100.0])
def test_row_6_a_declared_noise_that_can_be_is_not_doubted(problem: Problem, times: float) -> None:
    assert declared(problem, times).cautions == ()


def test_row_6_a_noise_declared_ten_times_too_small_is_told(problem: Problem) -> None:
    (one,) = declared(problem, 0.1).cautions
    assert one.name == "input noise"
    assert "samples of 'gyro' scatter from one to the next as white noise of 3." in one.text
    assert _times(one.text) == pytest.approx(10, rel=0.2)


def test_row_6_degrees_declared_as_radians_are_told(problem: Problem) -> None:
    def in_degrees(u: Array) -> Array:
        return np.hstack([u[:, :1], np.rad2deg(u[:, 1:])])

    epochs = [
        replace(
            e,
            inputs=dict(e.inputs)
            | {n: in_degrees(u) for n, u in e.inputs.items() if n == "chaser"},
        )
        for e in problem.epochs
    ]
    (one,) = scatter_cautions(problem.processes, epochs)
    assert _times(one.text) == pytest.approx(180 / np.pi, rel=0.2)


def test_row_6_a_motion_that_is_fast_beside_the_samples_is_no_noise(problem: Problem) -> None:
    """A hundred seconds for a swing, in steps of ten: second differences alone doubt it."""
    gyro: Any = problem.processes["chaser"]
    size = 20 * float(np.mean(gyro.angle_random_walk_density))
    t = 10.0 * np.arange(len(problem.epochs))
    rates = np.outer(size * np.sin(2 * np.pi * t / 100), [1, -1, 0.5])
    epochs = [
        replace(e, inputs=dict(e.inputs) | {"chaser": np.r_[[10.0], w][None]})
        for e, w in zip(problem.epochs, rates, strict=True)
    ]
    assert scatter_cautions(problem.processes, epochs) == ()


def test_row_6_a_smooth_motion_and_a_few_jumps_are_no_noise(problem: Problem) -> None:
    t = np.arange(len(problem.epochs))
    rate = np.outer(0.02 * np.sin(0.05 * t), [1, -1, 2])
    rate[::40] += 1.0
    epochs = [
        replace(e, inputs=dict(e.inputs) | {"chaser": np.r_[[1.0], w][None]})
        for e, w in zip(problem.epochs, rate, strict=True)
    ]
    assert scatter_cautions(problem.processes, epochs) == ()
