"""Stamps that are late, or unsteady: of inputs and of sensors, recorded, simulated and online."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from passes import ZHANG, relnav

from relnav_graph.core.measurement import InputSeries
from relnav_graph.errors import InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.runs.passes import open_dataset, open_pass
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.toml import read_toml

FEW = ("time.epochs=20",)
LATE = (*FEW, "stamps.gyro.lag=2.5 s", "stamps.beacons.lag=130 ms")


def test_what_is_put_on_in_simulation_is_taken_off_again() -> None:
    plain, late = open_pass(ZHANG, assignments=FEW), open_pass(ZHANG, assignments=LATE)
    np.testing.assert_allclose(
        late.recording.inputs["gyro"].t_start, plain.recording.inputs["gyro"].t_start + 2.5
    )
    first = [p.recording.measurements[0] for p in (plain, late)]
    assert {m.sensor for m in first} == {"beacons"}
    assert first[1].t == pytest.approx(first[0].t + 0.13)
    batch = [run_estimator("batch", p.problem) for p in (plain, late)]
    np.testing.assert_allclose(batch[0].t, batch[1].t, atol=1e-9)
    np.testing.assert_allclose(batch[0].x, batch[1].x, atol=1e-9)


def test_a_lag_that_is_not_known_is_an_error_of_the_estimate(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The data set has stamps that are late; who knows that has the estimate of before."""
    assert relnav(capsys, "simulate", ZHANG, *_set(LATE), "-o", tmp_path / "a")[0] == 0
    known = open_dataset(tmp_path / "a")
    plain = open_pass(ZHANG, assignments=FEW)
    x = run_estimator("batch", plain.problem).x
    np.testing.assert_allclose(run_estimator("batch", known.problem).x, x, atol=1e-6)
    unknown = open_dataset(tmp_path / "a", ["stamps.gyro.lag=0 s", "gaps.gyro.bridge=30 s"])
    assert np.abs(run_estimator("batch", unknown.problem).x - x).max() > 1e-4


def test_a_stream_waits_for_the_samples_that_tell(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = relnav(capsys, "simulate", ZHANG, *_set(LATE), "-o", "-")[1]
    (tmp_path / "lines").write_text(lines)
    scenario = tmp_path / "late.toml"
    scenario.write_text(
        f'base = "{ZHANG}"\n[time]\nepochs = 20\n'
        '[stamps.gyro]\nlag = "2.5 s"\n[stamps.beacons]\nlag = "130 ms"\n'
    )
    files = ["--from", tmp_path / "lines", "-o", tmp_path / "out"]
    code, _, err = relnav(capsys, "stream", scenario, "-e", "iekf", *files)
    assert code == 0, err
    assert "gyro: stamps lag by 2.5 s: estimates come that much later" in err
    last = json.loads((tmp_path / "out").read_text().splitlines()[-1])
    track = run_estimator("iekf", open_pass(ZHANG, assignments=LATE).problem)
    found = last["estimate"]["relative_position"]["value"]
    np.testing.assert_allclose(found, track.value("relative_position")[-1], atol=1e-6)
    assert last["t"] == pytest.approx(190.0)


def _set(assignments: tuple[str, ...]) -> list[str]:
    return [part for a in assignments for part in ("--set", a)]


def test_jitter_adds_what_a_rate_and_its_change_make_of_it() -> None:
    t = np.arange(4.0)
    values = np.array([[1.0, 0.0], [1.0, 2.0], [1.0, 4.0], [1.0, 6.0]])
    series = InputSeries("gyro", t, t + 1, values, jitter=0.01)
    sigma = series.spreads(np.array([1.0, 1.5, 2.0, 2.4]))
    # Of the integral: the parts add up to it, by their lengths.
    variance = np.square(sigma * np.array([[0.5], [0.5], [0.4]])).sum(axis=0)
    mean = np.array([1.0, (2.0 + 0.4 * 4.0) / 1.4])
    change = np.array([0.0, 2.0 * 1.4])
    np.testing.assert_allclose(variance, 0.01**2 * (mean**2 + change**2))
    assert not InputSeries("gyro", t, t + 1, values).spreads(np.array([1.0, 2.0])).any()


def test_jitter_makes_an_estimate_less_sure_and_is_no_gap() -> None:
    plain = open_pass(ZHANG, assignments=FEW).problem
    unsteady = open_pass(ZHANG, assignments=(*FEW, "stamps.gyro.jitter=20 ms")).problem
    assert not unsteady.bridged
    sure, less = run_estimator("iekf", plain), run_estimator("iekf", unsteady)
    assert (less.P[-1].trace() > sure.P[-1].trace()).all()


@pytest.mark.parametrize(
    ("assignment", "says"),
    [
        ("stamps.giro.lag=1 s", "stamps.giro: neither input nor sensor; there are: gyro, beacons"),
        ("stamps.beacons.jitter=1 ms", "stamps.beacons.jitter: found that of a sensor"),
        ("stamps.gyro.jitter=-1 ms", "stamps.gyro.jitter"),
        ("stamps.gyro.lag=1 m", "stamps.gyro.lag"),
    ],
)
def test_stamps_of_nothing(assignment: str, says: str) -> None:
    with pytest.raises(InputError) as error:
        load_scenario(ZHANG, [assignment])
    assert says in str(error.value)


def test_later_bases_win(tmp_path: Path) -> None:
    for name, text in (("a", "x = 1\ny = 1\nz = 1"), ("b", "y = 2\nz = 2\n[t]\nu = 1")):
        (tmp_path / f"{name}.toml").write_text(text)
    (tmp_path / "c.toml").write_text('base = ["a.toml", "b.toml"]\nz = 3')
    assert read_toml(tmp_path / "c.toml") == {"x": 1, "y": 2, "z": 3, "t": {"u": 1}}
    (tmp_path / "d.toml").write_text('base = ["a.toml", 7]')
    with pytest.raises(InputError, match=r"base\[1\]: found 7, expected another file"):
        read_toml(tmp_path / "d.toml")


def test_bases_that_double_at_each_step_come_to_an_end(tmp_path: Path) -> None:
    for i in range(12):
        (tmp_path / f"{i}.toml").write_text(f'base = ["{i + 1}.toml", "{i + 1}.toml"]')
    (tmp_path / "12.toml").write_text("x = 1")
    with pytest.raises(InputError, match="found more than 64 files"):
        read_toml(tmp_path / "0.toml")
