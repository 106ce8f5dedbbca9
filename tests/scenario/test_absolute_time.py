"""When t = 0 is: in [time], by the data, and for what counts from it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from passes import EXPERIMENTS

from relnav_graph.core.absolute_time import AbsoluteTime
from relnav_graph.scenario.build import load_scenario, make_scenario
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.scenario.schema import ScenarioError
from relnav_graph.scenario.toml import read_toml

GRACE, YANG = EXPERIMENTS / "grace_fo.toml", EXPERIMENTS / "yang2016.toml"
ZHANG = EXPERIMENTS / "zhang2015.toml"
EPOCH = "2021-07-17T00:00:00 TT"


def grace(settings: dict[str, Any] | None, *assignments: str) -> Scenario:
    return load_scenario(GRACE, assignments, settings)


def test_the_data_bring_the_time_or_the_scenario_says_it() -> None:
    brought = grace({"time": {"epoch": EPOCH}})
    told = grace({}, f"time.epoch={EPOCH}")
    both = grace({"time": {"epoch": EPOCH}}, "time.epoch=2021-07-16T23:59:08.816 GPS")
    for scenario in (brought, told, both):
        clock = scenario.processes["chaser_orbit"].clock  # type: ignore[attr-defined]
        assert isinstance(clock, AbsoluteTime)
        assert abs(clock.begin.since(AbsoluteTime(EPOCH).begin)) < 1e-9
    shifted = grace({"time": {"epoch": EPOCH}}, "time.origin=60")
    assert shifted.file.time.epoch == "2021-07-17T00:01:00 TT"
    # What a run leaves says it, and is taken again beside the data.
    again = make_scenario(brought.raw, "again", {"time": {"epoch": EPOCH}})
    assert again.file.time.epoch == EPOCH


def test_row_59_the_scenario_contradicts_the_data() -> None:
    with pytest.raises(ScenarioError, match=r"time\.epoch: found 2021-07-17T00:00:00 UTC, but"):
        grace({"time": {"epoch": EPOCH}}, "time.epoch=2021-07-17T00:00:00 UTC")


def test_row_59_nobody_says_the_time() -> None:
    with pytest.raises(ScenarioError, match=r"chaser_orbit: needs the absolute time of t = 0"):
        grace({})
    # Until the data are read, they may.
    assert grace(None).processes["chaser_orbit"].undated  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("assignment", "says"),
    [
        ("time.epoch=2021-07-17T00:00:00", r"time\.epoch: .*without a time scale"),
        ("time.epoch=yesterday", r"time\.epoch: found 'yesterday'"),
        ("time.epoch=7", r"time\.epoch: "),
        ("processes.chaser_orbit.order=21", r"chaser_orbit: order: found 21"),
        ("processes.chaser_orbit.degree=99", r"chaser_orbit: degree: found 99, expected 0 to 60"),
        ('processes.chaser_orbit.third_bodies=["mars"]', "third_bodies: found 'mars'"),
    ],
)
def test_row_59_times_and_fields_that_cannot_be(assignment: str, says: str) -> None:
    with pytest.raises(ScenarioError, match=says):
        grace({}, f"time.epoch={EPOCH}", assignment)


def test_the_earths_orientation_comes_from_a_file(tmp_path: Path) -> None:
    rows = [
        f"210{712 + k:3d} {59407 + k:8.2f} I  0.200000 0.000091  0.400000 0.000091  I-0.1300000"
        for k in range(12)
    ]
    path = tmp_path / "finals"
    path.write_text("\n".join(rows) + "\n")
    with_file = grace({}, f"time.epoch={EPOCH}", f"time.orientation={path}")
    without = grace({}, f"time.epoch={EPOCH}")
    r, v, u = np.array([3e6, -4e6, 4.5e6]), np.array([5e3, 5e3, 0.0]), np.array([[600.0]])
    ends = [s.processes["chaser_orbit"].propagate(0.0, u, r, v)[0] for s in (with_file, without)]
    assert 1e-4 < float(np.linalg.norm(ends[0] - ends[1])) < 1.0
    (tmp_path / "late").write_text(rows[0] + "\n" + rows[1] + "\n")
    for name, says in (("late", "found days 59407 to 59408, expected"), ("none", "none: ")):
        with pytest.raises(ScenarioError, match=says):
            grace({}, f"time.epoch={EPOCH}", f"time.orientation={tmp_path / name}")


def test_the_epoch_of_an_orbit_may_be_absolute() -> None:
    """As seconds of the pass, whatever the scale."""
    raw = read_toml(ZHANG)
    raw["time"] |= {"epoch": EPOCH}
    raw["orbit"] |= {"epoch": "2021-07-17T00:01:30 TT"}
    absolute = make_scenario(raw, "absolute")
    raw["orbit"] |= {"epoch": "90 s"}
    relative = make_scenario(raw, "relative")
    for scenario in (absolute, relative):
        assert scenario.truth.epoch == 90.0
    for name, process in absolute.processes.items():
        np.testing.assert_array_equal(process.constants(), relative.processes[name].constants())
    del raw["time"]["epoch"]
    raw["orbit"] |= {"epoch": "2021-07-17T00:01:30 TT"}
    with pytest.raises(ScenarioError, match=r"orbit\.epoch: .*needs the absolute time of t = 0"):
        make_scenario(raw, "unknown")
    raw["orbit"] |= {"epoch": "2021-07-17T00:01:30"}
    with pytest.raises(ScenarioError, match=r"orbit\.epoch: .*without a time scale"):
        make_scenario(raw, "unknown")


def test_a_simulated_truth_turns_too() -> None:
    """With the field of 60 and Sun and Moon the craft end elsewhere than with J2 to J4."""
    field = ("truth.degree=60", "truth.order=60", 'truth.third_bodies=["sun", "moon"]')
    with pytest.raises(ScenarioError, match="truth: needs the absolute time of t = 0"):
        load_scenario(YANG, field)
    times = 30.0 * np.arange(11)
    ends = []
    for settings in ((), (*field, f"time.epoch={EPOCH}")):
        truth = load_scenario(YANG, settings).truth
        found = truth.simulate(times, np.random.default_rng(0))
        ends.append(found.values["chaser_position"][-1])
        assert ("EGM2008 to 60 x 60, Sun, Moon" in found.source) == bool(settings)
    assert 1.0 < float(np.linalg.norm(ends[0] - ends[1])) < 100.0
