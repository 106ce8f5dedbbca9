"""A pass without truth: what is told of it, and that a filter far from its smoother says so."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from passes import ZHANG, relnav
from relnav_factors.sensors.beacon_los import BeaconLineOfSight

from relnav_graph.core.track import Track
from relnav_graph.estimators import try_estimator
from relnav_graph.io.results import read_results
from relnav_graph.io.track_tables import write_csv
from relnav_graph.report.contents import PassContents, read_contents
from relnav_graph.report.page import render
from relnav_graph.runs.comparison import Comparison, compare_pass
from relnav_graph.runs.outputs import write_outputs
from relnav_graph.runs.passes import Pass, open_pass
from relnav_graph.scoring.agreement import distances, row_cautions
from relnav_graph.scoring.metrics import table, with_smoothed
from relnav_graph.scoring.noise_verdict import noise_said
from relnav_graph.scoring.residuals import judge_by_residuals


@pytest.fixture(scope="module")
def opened() -> Pass:
    """A simulated pass whose truth, which has given the means of the prior, is taken away."""
    known = open_pass(ZHANG, 1, None, ("time.epochs=60",))
    assert known.problem  # with its prior
    object.__setattr__(known, "recording", replace(known.recording, truth=None))
    return known


@pytest.fixture(scope="module")
def found(opened: Pass) -> Comparison:
    return compare_pass(opened, ["iekf", "batch"])


def test_estimates_residuals_and_noises_are_told(found: Comparison) -> None:
    json.dumps(found.summary, allow_nan=False)
    row, batch = found.summary["estimators"]["batch"], found.track("batch")
    one = row["states"]["relative_position"]["estimate"]
    assert one["components"] == ["x", "y", "z"]
    np.testing.assert_allclose(one["value"], batch.value("relative_position")[-1])
    P = batch.covariance("relative_position")[-1]
    np.testing.assert_allclose(one["sigma"], np.sqrt(np.diag(P)))
    assert len(row["states"]["relative_attitude"]["estimate"]["value"]) == 4
    for name in ("iekf", "batch"):
        sensor = found.summary["estimators"][name]["sensors"]["beacons"]
        assert sensor["rows"] == 60 * 12
        assert sensor["nis"] == pytest.approx(1, abs=0.2)  # 720 rows: 4 sigmas
    noises = {n["noise"]: n for n in found.summary["noise"]["noises"]}
    assert noises["sensors.beacons"]["tested"]
    assert noises["sensors.beacons"]["factor"] == pytest.approx(1, abs=0.12)
    text = table(found.summary)
    x, sigma = one["value"][0], one["sigma"][0]
    (said,) = re.findall(r"relative_position .*\n.*\n.*\nbatch +smoothed +(\S+) ± (\S+)", text)
    assert float(said[0]) == pytest.approx(x, abs=sigma / 5)
    assert float(said[1]) == pytest.approx(sigma, rel=0.06)
    assert "declared noises, by the residuals of batch" in text


def test_files_hold_what_is_derived_and_the_report_tells_all(
    opened: Pass, found: Comparison, tmp_path: Path
) -> None:
    write_outputs(tmp_path, opened, found)
    tracks, truth, _ = read_results(tmp_path / "results.nc")
    assert truth is None
    for before, after in zip(found.tracks, tracks, strict=True):
        i, j = before.innovations["beacons"], after.innovations["beacons"]
        for a, b in ((i.t, j.t), (i.v, j.v), (i.offsets, j.offsets)):
            np.testing.assert_array_equal(a, b)
    write_csv(tmp_path, tracks)
    header = (tmp_path / "batch.csv").read_text().splitlines()[0].split(",")
    assert {"position_in_target_x_m", "sigma_relative_attitude_z_rad"} <= set(header)
    content = read_contents(tmp_path)
    assert isinstance(content, PassContents)
    assert content.summary["noise"] == found.summary["noise"]
    page = render(content, plotly="")
    for heading in ("Estimates", "Residuals", "Declared noises"):
        assert f"<h3>{heading}</h3>" in page
    assert "Orbit of the target: semi major axis" in page
    assert "Consistency over the pass" in page


@pytest.mark.parametrize("known", ["all", "derived alone"])
def test_a_recorded_pass_is_judged_by_its_residuals_with_truth_too(
    known: str, tmp_path: Path
) -> None:
    """A simulated one is not: it has the noises that are declared."""
    simulated = open_pass(ZHANG, 1, None, ("time.epochs=60",))
    truth = simulated.recording.truth
    assert simulated.problem  # with its prior
    assert truth
    row = compare_pass(simulated, ["batch"]).summary
    assert "noise" not in row
    assert "sensors" not in row["estimators"]["batch"]
    if known != "all":
        R_oc, R_ot = (truth.values[f"{body}_attitude"] for body in ("chaser", "target"))
        truth = replace(truth, values={"relative_attitude": R_ot.transpose(0, 2, 1) @ R_oc})
    opened = replace(
        simulated, simulated=False, recording=replace(simulated.recording, truth=truth)
    )
    object.__setattr__(opened, "problem", simulated.problem)
    found = compare_pass(opened, ["iekf", "batch"])
    assert found.summary["noise"]["residuals_of"] == "batch"
    for name in ("iekf", "batch"):
        assert found.summary["estimators"][name]["sensors"]["beacons"]["rows"] == 60 * 12
        assert found.summary["estimators"][name]["states"]["relative_attitude"]["rmse"] > 0
    text = table(found.summary)
    assert "residuals in their own sigmas" in text
    assert "declared noises, by the residuals of batch" in text
    lacking = re.findall(r"truth says only relative_attitude, .*it lacks (.*)", text)
    assert bool(lacking) == (known != "all")
    assert not lacking or "chaser_attitude" in lacking[0].split(", ")
    write_outputs(tmp_path, opened, found)
    page = render(read_contents(tmp_path), plotly="")
    for heading in ("Residuals", "Declared noises"):
        assert f"<h3>{heading}</h3>" in page


@pytest.mark.parametrize("off", [0.0, 6.0])
def test_a_filter_far_from_its_own_smoother_says_so(found: Comparison, off: float) -> None:
    smoothed, own = found.track("batch"), found.track("iekf")
    x = own.x.copy()
    x[:, 1] += off * np.sqrt(own.P[:, 1, 1])
    online: Track = replace(own, name="online", x=x, smoothed=replace(smoothed, name="online"))
    rows = with_smoothed([online])
    references, apart = distances(rows)
    assert references == {"online": "online_smoothed", "online_smoothed": ""}
    said = {c.name for c in row_cautions(rows, references, apart)["online"]}
    assert ("distance" in said) == (off > 0)
    distance = apart["online"]
    assert distance is not None
    assert distance == pytest.approx(6, abs=1.5) if off else distance < 2


@pytest.mark.parametrize("narrow", [False, True])
def test_a_filter_that_knows_more_than_its_smoother_says_so(
    found: Comparison, narrow: bool
) -> None:
    """In one direction of one block, a third of the sigma that all the data leave."""
    smoothed, own = found.track("batch"), found.track("iekf")
    P, one = own.P.copy(), own.layout.tangent("relative_velocity")
    axes = np.eye(P.shape[1])
    if narrow:
        _, vectors = np.linalg.eigh(P[-1, one, one])
        axes[one, one] = vectors @ np.diag([1 / 3, 1, 1]) @ vectors.T
    P[-1] = axes @ P[-1] @ axes.T
    rows = {"iekf": replace(own, P=P), "batch": smoothed}
    references, apart = distances(rows)
    said = [c for c in row_cautions(rows, references, apart)["iekf"] if c.name == "overconfident"]
    assert len(said) == narrow
    if narrow:
        assert "at the last epoch, where batch has seen no more, a sigma of" in said[0].text
        assert "relative_velocity is 0.3" in said[0].text


def test_a_row_that_is_none_is_refused_before_any_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = ("compare", ZHANG, "--set", "time.epochs=5", "-e", "ekf", "-o", tmp_path / "out")
    code, _, said = relnav(capsys, *short, "--draw", "batch")
    assert code == 2
    assert "--draw: found 'batch', expected an estimator of this pass: ekf" in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("interval", "named", "said"),
    [
        ([0.9, 1.2], False, "as declared"),
        ([0.0, 0.7], False, "in doubt"),
        ([2.0, 3.0], True, "likely cause"),
    ],
)
def test_few_rows_are_no_proof_of_a_noise(interval: list[float], named: bool, said: str) -> None:
    """36 rows that fit exactly: the interval is beside one, and yet names no cause."""
    assert noise_said({"factor_ci": interval, "named": named}) == said


def test_the_sentence_below_the_noises_does_not_contradict_them() -> None:
    """A sigma a seventh too large is beside one, and too little to be named as a cause."""
    known = open_pass(ZHANG, 1, None, ("time.epochs=150",))
    assert known.problem
    beacons = known.problem.sensors["beacons"]
    assert isinstance(beacons, BeaconLineOfSight)
    wider = replace(beacons, sigma=beacons.sigma / 0.86)
    problem = replace(known.problem, sensors={**known.problem.sensors, "beacons": wider})
    _, noise = judge_by_residuals(problem, (try_estimator("batch", problem),))
    (one,) = (n for n in noise["noises"] if n["noise"] == "sensors.beacons")
    assert (one["named"], noise_said(one)) == (False, "in doubt")
    low, high = one["factor_ci"]
    assert noise["causes"] == []
    assert noise["text"][0] == (
        "The residuals of batch are as the declared noises say, but for sensors.beacons"
        f" ({one['factor']:.2f} times, {low:.2f} to {high:.2f}), which is in doubt."
    )
