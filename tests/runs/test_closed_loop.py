"""Closed loops: each estimator flies a pass of its own, by its own estimates."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from passes import EXPERIMENTS, relnav, truth_of
from relnav_factors.sensors.vision_attitude import VisionAttitude

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import CHASER_ATTITUDE
from relnav_graph.core.track import Track, Truth
from relnav_graph.errors import EstimationError, InputError, ModelError
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.ekf import Ekf
from relnav_graph.estimators.source import Source
from relnav_graph.io.results import read_results
from relnav_graph.maths import so3
from relnav_graph.runs.closed_loop import ClosedLoop, Flown, fly, fly_all
from relnav_graph.scenario.build import load_scenario, make_scenario
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.scenario.toml import read_toml
from relnav_graph.scoring.deviations import errors
from relnav_graph.scoring.metrics import summary
from relnav_graph.sim.sensors import Timing, measure

THIENEL = EXPERIMENTS / "thienel2006.toml"
#: The published loop in ten minutes, with the better noise from 200 s on.
SHORT = (
    "time.epochs=601",
    'control.start="100 s"',
    'sensors.far.end="200 s"',
    'sensors.near.begin="200 s"',
    "evaluate=[0.8, 1.0]",
)
FLYING = ("momentum_observer", "ekf", "iekf", "incremental", "fixed_lag")


def short(*settings: str) -> Scenario:
    return load_scenario(THIENEL, [*SHORT, *settings])


def stamps(flown: Flown) -> list[tuple[float, str, Any]]:
    """All that was measured."""
    return [
        (m.t, m.sensor, m.z.tolist()) for epoch in flown.problem.epochs for m in epoch.measurements
    ]


def last_error(flown: Flown, name: str) -> float:
    """Size of an error over the last tenth of the pass, RMS, rad or rad/s."""
    e = errors(flown.track, truth_of(flown), [])[name].e
    return float(np.sqrt((e[-len(e) // 10 :] ** 2).sum(axis=1).mean()))


@dataclass(frozen=True)
class Biased(Ekf):
    """A filter that says that the target is turned by ten degrees more than it finds."""

    kind: ClassVar[str] = "biased"

    def drive(self, source: Source) -> Track:
        """Filter, and tell something else."""
        honest, layout = source.take, source.problem.layout
        turn = np.zeros(layout.dim)
        turn[layout.tangent("target_attitude")] = np.radians(10.0), 0.0, 0.0

        def take(x: Array, besides: Mapping[str, Array]) -> None:
            honest(layout.retract(x, turn), besides)

        source.take = take  # type: ignore[method-assign]
        return super().drive(source)


@dataclass(frozen=True)
class Failing(Ekf):
    """A filter that gives up after 60 s."""

    kind: ClassVar[str] = "failing"

    def drive(self, source: Source) -> Track:
        """Filter for a while."""
        for epoch in source:
            if epoch.t > 59.5:
                raise EstimationError("gave up")
            source.take(source.problem.prior.x, {})
        raise AssertionError("unreachable")


@pytest.fixture(scope="module")
def flown() -> dict[str, Flown]:
    """What each estimator flies in ten minutes; rts and batch smooth what the ekf has flown."""
    kinds = ("momentum_observer", "ekf", "rts", "batch", "incremental", "fixed_lag")
    return dict(zip(kinds, fly_all(short(), kinds, seed=3), strict=True))


def test_loops_end_well(flown: dict[str, Flown]) -> None:
    """The smoother-fed loops at a fraction of a degree; the observer still converges."""
    assert {f.track.status for f in flown.values()} == {"ok"}
    for kind in ("ekf", "incremental", "fixed_lag"):
        assert last_error(flown[kind], "control_attitude") < np.radians(0.4)
        assert last_error(flown[kind], "control_rate") < np.radians(0.01)
        assert last_error(flown[kind], "target_attitude") < np.radians(0.4)


def test_every_estimator_meets_the_same_noise_and_flies_its_own_pass(
    flown: dict[str, Flown],
) -> None:
    first = flown["ekf"]
    for kind in ("momentum_observer", "incremental", "fixed_lag"):
        assert stamps(flown[kind]) == stamps(first)
        own, other = (truth_of(f).values["control_rate"] for f in (flown[kind], first))
        before = truth_of(first).t < 100.5  # the first command, of 100 s, acts from then on
        np.testing.assert_array_equal(own[before], other[before])
        assert (own[~before] != other[~before]).any(axis=1).all()


def test_an_error_of_the_estimate_moves_the_craft_by_as_much() -> None:
    scenario = short()
    honest = fly(scenario, "ekf", seed=3)
    lying = fly(scenario, "test_closed_loop:Biased", seed=3)
    # The track is what the filter found; the craft went where it was told.
    np.testing.assert_array_equal(lying.track.x, honest.track.x)
    R_tc = truth_of(lying).values["control_attitude"][-1]
    assert np.degrees(so3.log(np.ascontiguousarray(R_tc))) == pytest.approx([10, 0, 0], abs=0.5)
    assert last_error(honest, "control_attitude") < np.radians(0.4)


def test_nothing_moves_before_the_controller_starts_and_something_does_after() -> None:
    never = fly(short('control.start="9999 s"'), "ekf", seed=3)
    wild = fly(short('control.start="9999 s"'), "momentum_observer", seed=3)
    np.testing.assert_array_equal(
        truth_of(never).values["control_attitude"], truth_of(wild).values["control_attitude"]
    )


def test_a_flight_is_repeated_bit_for_bit(flown: dict[str, Flown]) -> None:
    for kind in ("momentum_observer", "fixed_lag"):
        again = fly(short(), kind, seed=3)
        np.testing.assert_array_equal(again.track.x, flown[kind].track.x)
        for name, value in truth_of(again).values.items():
            np.testing.assert_array_equal(value, truth_of(flown[kind]).values[name])
    other = fly(short(), "momentum_observer", seed=3, run=1)
    assert stamps(other) != stamps(flown["momentum_observer"])


@pytest.mark.parametrize("kind", ["ekf", "incremental", "fixed_lag"])
def test_what_was_flown_is_a_pass_like_any_other(kind: str, flown: dict[str, Flown]) -> None:
    """The estimator on the recording of its own flight gives what it gave in flight."""
    track = run_estimator(kind, flown[kind].problem)
    np.testing.assert_array_equal(track.x, flown[kind].track.x)
    np.testing.assert_array_equal(track.P, flown[kind].track.P)
    ends, ended = track.smoothed, flown[kind].track.smoothed
    assert (ends is None) == (ended is None)
    if ends is not None and ended is not None:
        np.testing.assert_array_equal(ends.x, ended.x)


def test_estimators_of_whole_passes_smooth_what_was_flown(flown: dict[str, Flown]) -> None:
    for kind in ("rts", "batch"):
        assert flown[kind].problem is flown["ekf"].problem
        assert truth_of(flown[kind]) is truth_of(flown["ekf"])
        assert not flown[kind].track.controlled  # they have controlled nothing
    scenario = short("time.epochs=20")
    with pytest.raises(InputError, match="'batch' smooths what another has flown"):
        list(fly_all(scenario, ["batch", "ekf"], seed=0))
    with pytest.raises(ModelError, match="for whole passes"):
        fly(scenario, "rts", seed=0)


def test_one_that_diverges_ends_its_own_flight_only() -> None:
    kinds = ["test_closed_loop:Failing", "ekf"]
    failing, ekf = fly_all(short("time.epochs=121"), kinds, seed=3)
    assert failing.track.status == "diverged"
    assert "gave up" in failing.track.message
    assert len(failing.problem.epochs) == len(failing.track.t) == len(truth_of(failing).t) == 61
    assert ekf.track.status == "ok"
    assert len(ekf.problem.epochs) == 121


def test_a_command_that_is_not_finite_ends_the_flight() -> None:
    loop = ClosedLoop(short('control.start="1 s"'), seed=0)
    epochs = iter(loop)
    next(epochs)
    next(epochs)
    with pytest.raises(EstimationError, match=r"t = 1\.0 s: found the command"):
        loop.take(np.full(loop.problem.layout.size, np.nan), {})


def test_observer_converges_from_any_attitude_and_rate() -> None:
    """Published settings but for the times; the errors of the start are gone."""
    settings = ("time.epochs=4001", 'control.start="2000 s"')
    better = ('sensors.far.end="2000 s"', 'sensors.near.begin="2000 s"')
    scenario = load_scenario(THIENEL, [*settings, *better])
    for run in range(3):
        one = fly(scenario, "momentum_observer", 11, run)
        assert one.track.status == "ok"
        begun = errors(one.track, truth_of(one), [])["control_attitude"].e[2000]
        assert np.linalg.norm(begun) > np.radians(10)
        assert last_error(one, "target_attitude") < np.radians(0.3)
        assert last_error(one, "control_attitude") < np.radians(0.4)
        assert last_error(one, "control_rate") < np.radians(0.01)


def test_observer_without_noise_finds_attitude_and_rate_exactly() -> None:
    quiet = ('sensors.far.sigma="1e-9 deg"', 'sensors.near.sigma="1e-9 deg"')
    still = ("truth.atmosphere=0.0", "time.epochs=5001")  # drag is what it does not know
    one = fly(short(*quiet, *still), "momentum_observer", seed=3)
    assert last_error(one, "target_attitude") < np.radians(0.01)
    assert last_error(one, "target_rate") < np.radians(1e-4)
    assert last_error(one, "control_attitude") < np.radians(0.05)


def test_observer_refuses_another_system(capsys: pytest.CaptureFixture[str]) -> None:
    scenario = load_scenario(EXPERIMENTS / "hu2019.toml", ["time.epochs=5"])
    problem = scenario.problem(scenario.simulate(0), 0)
    with pytest.raises(ModelError, match="momentum_observer: found Layout"):
        run_estimator("momentum_observer", problem)


# --- scenarios ------------------------------------------------------------------------------


def test_a_truth_that_takes_no_commands_is_refused() -> None:
    other = {**read_toml(THIENEL), "truth": read_toml(EXPERIMENTS / "hu2019.toml")["truth"]}
    with pytest.raises(InputError, match=r"truth.kind: found 'tumbling_body', which takes no"):
        make_scenario(other, "other")
    other = {**read_toml(THIENEL), "control": other["truth"]}
    with pytest.raises(InputError, match=r"control.kind: found 'tumbling_body', expected a contr"):
        make_scenario(other, "other")


def test_scenario_without_control_does_not_fly() -> None:
    scenario = replace(short(), control=None)
    with pytest.raises(InputError, match=r"no \[control\]"):
        fly(scenario, "ekf", seed=0)


def test_compare_and_study_report_control_apart_from_estimation(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    settings = [part for s in (*SHORT, "time.epochs=201") for part in ("--set", s)]
    kinds = ["-e", "momentum_observer", "-e", "ekf", "-e", "rts", "-e", "fixed_lag"]
    code, out, _ = relnav(
        capsys, "study", THIENEL, *settings, *kinds, "--runs", 2, "-j", 1, "--json"
    )
    study = json.loads(out)["estimators"]
    assert code == 0
    states = {"target_attitude", "target_rate", "control_attitude", "control_rate"}
    for kind in ("momentum_observer", "ekf", "fixed_lag"):
        assert set(study[kind]["states"]) == states
        control = study[kind]["states"]["control_attitude"]
        assert control["unit"] == "deg"
        assert control["rmse"] > 0
        assert control["sigma"] is control["bound"] is control["anees"] is None
        assert study[kind]["states"]["target_attitude"]["bound"] > 0
    assert study["momentum_observer"]["states"]["target_attitude"]["sigma"] is None
    assert {"control_attitude"} & set(study["rts"]["states"]) == set()
    assert study["rts"]["states"]["target_attitude"]["bound"] > 0

    squares, out_pass = [], tmp_path / "pass"
    for run in range(2):  # each run alone
        code, out, _ = relnav(
            capsys, "compare", THIENEL, *settings, *kinds, "--run", run, "--json", "-o", out_pass
        )
        assert code == 0
        rows = json.loads(out)["estimators"]
        squares.append(
            [rows[k]["states"]["control_rate"]["rmse"] ** 2 for k in ("ekf", "fixed_lag")]
        )
    mean = np.sqrt(np.mean(squares, axis=0))
    want = [study[k]["states"]["control_rate"]["rmse"] for k in ("ekf", "fixed_lag")]
    np.testing.assert_allclose(mean, want, rtol=1e-12)
    assert (out_pass / "figures" / "control_attitude.png").is_file()


def test_results_and_report_of_flown_passes(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    settings = [part for s in (*SHORT, "time.epochs=151") for part in ("--set", s)]
    kinds = ["-e", "momentum_observer", "-e", "fixed_lag"]
    code, out, _ = relnav(capsys, "compare", THIENEL, *settings, *kinds, "--json", "-o", tmp_path)
    assert code == 0
    tracks, truth, _ = read_results(tmp_path / "results.nc")
    assert truth is None  # there is none that all share
    found = summary("thienel2006", 0, tracks, None, [], (0.8, 1.0), 151)["estimators"]
    for name, row in json.loads(out)["estimators"].items():
        for state, scores in row["states"].items():
            assert found[name]["states"][state]["rmse"] == pytest.approx(scores["rmse"], rel=1e-6)
    assert relnav(capsys, "report", tmp_path)[0] == 0
    page = (tmp_path / "report.html").read_text("utf-8")
    assert "Errors: control attitude" in page
    assert "no truth is known" not in page

    study = tmp_path / "study"
    runs = ["--runs", 3, "-j", 1, "-o", study]
    assert relnav(capsys, "study", THIENEL, *settings, *kinds, *runs)[0] == 0
    assert relnav(capsys, "report", study)[0] == 0
    assert "control attitude" in (study / "report.html").read_text("utf-8")


def test_sensors_see_their_part_of_the_pass(flown: dict[str, Flown]) -> None:
    seen = [(t, sensor) for t, sensor, _ in stamps(flown["ekf"])]
    assert seen == [(float(t), "far" if t < 200 else "near") for t in range(601)]


def test_noise_along_random_directions_is_normal_in_length() -> None:
    """As the paper draws it: a normal angle about a random direction; sigma is of an axis."""
    sensor = VisionAttitude(seen_from="fixed", sigma=np.full(3, 0.01))
    R = np.tile(so3.exp(np.array([0.4, 0.3, -1.0])), (5000, 1, 1))
    truth = Truth(np.arange(5000.0), {"target_attitude": R})
    sizes = []
    for law in ("gaussian", "random_direction"):
        rng = np.random.default_rng(0)
        found = measure("v", sensor, Timing(law=law), truth, rng)
        seen = np.array([so3.from_quaternion(m.z[0]) for m in found])
        e = CHASER_ATTITUDE.local(R, seen) / 0.01
        np.testing.assert_allclose(e.T @ e / 5000, np.eye(3), atol=0.08)
        sizes.append(np.linalg.norm(e, axis=1).mean() / np.sqrt(3))
    # Of a normal vector, and of a normal number.
    assert sizes == pytest.approx([np.sqrt(8 / np.pi) / np.sqrt(3), np.sqrt(2 / np.pi)], rel=0.02)


def test_a_sensor_that_ends_before_it_begins_is_refused() -> None:
    with pytest.raises(InputError, match=r"sensors.near: found begin at 30.* and end at 20"):
        load_scenario(THIENEL, ["sensors.near.end=20000.0"])
