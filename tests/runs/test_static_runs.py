"""A pass with a static block, from the scenario to files, figures, a study and a stream."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from passes import ESTIMATORS, EXPERIMENTS, relnav
from static_tracks import OFFSET

from relnav_graph.io.results import read_results
from relnav_graph.runs.comparison import compare
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scoring.agreement import distances
from relnav_graph.scoring.metrics import with_smoothed
from relnav_graph.study.collect import collect
from relnav_graph.study.folder import StudyFolder
from relnav_graph.study.record import RunRecord
from relnav_graph.study.runs import StudySpec, run_record
from relnav_graph.study.summary import summarize
from relnav_graph.study.verdict import verdict

Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("static") / "offset.toml"
    out.write_text(OFFSET, "utf-8")
    return out


def test_every_estimator_ends_at_the_same_constant(path: Path) -> None:
    found = compare(path, [*ESTIMATORS, "fixed_lag"])
    rows = with_smoothed(found.tracks)
    for name, row in found.summary["estimators"].items():
        assert row["status"] == "ok", row["message"]
        assert set(row["statics"]) == {"range_drift"}
        assert row["statics"]["range_drift"]["unit"] == "m"
        assert row["statics_anees"] == pytest.approx(row["statics"]["range_drift"]["anees"])
        assert row["distance"] is not None
        assert row["distance"] < (1.5 if name in ("fixed_lag_smoothed", "ukf_smoothed") else 0.3)
        last = rows[name].value("range_drift")[-1]
        sigma = np.sqrt(rows["batch"].covariance("range_drift")[-1, 0, 0])
        assert np.abs(last - rows["batch"].value("range_drift")[-1]) < 0.3 * sigma
    assert set(distances(rows)[0].values()) == {"batch"}


def test_what_compare_writes(path: Path, tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "out"
    code, text, _ = relnav(capsys, "compare", path, "-o", out)
    assert code == 0
    assert "range_drift [m]" in text.partition("constants, as at the last epoch")[2]
    tracks, truth, _ = read_results(out / "results.nc")
    summary = json.loads((out / "summary.json").read_text())
    for track in tracks:
        assert [b.name for b in track.blocks][-1] == "range_drift"
        e = track.value("range_drift")[-1, 0] - 0.15
        want = summary["estimators"][track.name]["statics"]["range_drift"]["rmse"]
        assert abs(e) == pytest.approx(want)
    assert truth is not None
    assert (truth.values["range_drift"] == 0.15).all()
    assert (out / "figures" / "range_drift.png").is_file()
    assert relnav(capsys, "convert", out / "results.nc", tmp_path / "csv")[0] == 0
    with (tmp_path / "csv" / "batch_statics.csv").open() as stream:
        (row,) = csv.DictReader(stream)
    assert float(row["range_drift_1_m"]) == tracks[1].value("range_drift")[0, 0]
    assert relnav(capsys, "report", out, "--trust")[0] == 0
    assert "<h3>Constants</h3>" in (out / "report.html").read_text("utf-8")


def test_a_data_set_with_the_constant_in_one_row(
    path: Path, tmp_path: Path, capsys: Capture
) -> None:
    folder = tmp_path / "set"
    assert relnav(capsys, "simulate", path, "-o", folder)[0] == 0
    smooth = ("smooth", folder, "--trust", "--json", "-o", tmp_path / "out")
    first = json.loads(relnav(capsys, *smooth)[1])
    (folder / "dataset.toml").unlink()
    (folder / "truth_range_drift.csv").write_text("1_m\n0.15\n", "utf-8")
    again = json.loads(relnav(capsys, *smooth)[1])
    statics = [one["estimators"]["batch"]["statics"] for one in (first, again)]
    assert statics[0] == statics[1]
    assert statics[0]["range_drift"]["rmse"] > 0


def test_a_study_has_bounds_of_constants(path: Path, tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "mc"
    code, text, _ = relnav(capsys, "study", path, "--runs", 40, "--jobs", 1, "-o", out)
    assert code == 0
    found: dict[str, Any] = json.loads((out / "summary.json").read_text())["estimators"]
    for row in found.values():
        one = row["statics"]["range_drift"]
        low, high = row["statics_anees_band"]
        assert one["anees_band"] == [low, high]
        assert low < row["statics_anees"] == one["anees"] < high
        assert 0.75 < one["efficiency"] < 1.25
        assert one["efficiency"] == pytest.approx(one["rmse"] / one["bound"])
        assert one["rmse_ci"][0] < one["rmse"] < one["rmse_ci"][1]
        assert one["sigma"] == pytest.approx(one["bound"], rel=0.05)
    # At the end a filter knows what a smoother knows.
    bounds = [row["statics"]["range_drift"]["bound"] for row in found.values()]
    assert bounds[0] == pytest.approx(bounds[1], rel=1e-9)
    assert "range_drift [m]" in text.partition("constants, as at the last epoch")[2]
    assert relnav(capsys, "report", out, "--trust")[0] == 0
    assert "<h3>Constants</h3>" in (out / "report.html").read_text("utf-8")


@pytest.mark.parametrize(("period", "residuals_tell"), [("200 s", False), ("2 s", True)])
def test_a_constant_that_is_not_estimated_is_among_what_may_be_wrong(
    path: Path, period: str, residuals_tell: bool
) -> None:
    # The offset is there, and taken as known to be nothing.
    known = ("prior.range_drift.sigma='1e-6 m'", "prior.range_drift.mean=[0.0]")
    scenario = load_scenario(path, (*known, f"sensors.fix.period='{period}'", "time.epochs=20"))
    spec = StudySpec.of(scenario, 0, ("batch",))
    found = collect(
        RunRecord.from_bytes(run_record(spec.to_json(), k), f"run {k}") for k in range(12)
    )
    said = verdict(summarize(spec, found, 20, ""), found, scenario)
    assert said["states"]["batch"]["relative_position"]["verdict"] == "optimistic"
    assert bool(said["causes"]) == residuals_tell
    assert said["text"][-1].endswith("or a constant that is not estimated.")


@pytest.mark.parametrize("kind", ["iekf", "incremental", "fixed_lag"])
def test_a_stream_says_the_constant_and_goes_on_where_it_was(
    path: Path, tmp_path: Path, capsys: Capture, kind: str
) -> None:
    lines = relnav(capsys, "simulate", path, "-o", "-")[1].splitlines(keepends=True)
    assert "range_drift" in json.loads(lines[0])["prior"]

    def streamed(name: str, count: int, *options: object) -> list[dict[str, Any]]:
        file = tmp_path / f"{name}.jsonl"
        file.write_text("".join(lines[:count]), "utf-8")
        out = tmp_path / f"{name}.out"
        relnav(capsys, "stream", path, "-e", kind, "--from", file, "-o", out, *options)
        found = [json.loads(line) for line in out.read_text().splitlines()]
        return [{k: v for k, v in line.items() if k != "latency_ms"} for line in found]

    whole = streamed("whole", len(lines))
    own = whole[-1]["estimate"]["range_drift"]
    track = compare(path, [kind]).tracks[0]
    assert own["value"][0] == pytest.approx(track.value("range_drift")[-1, 0], abs=1e-9)
    sigma = np.sqrt(track.covariance("range_drift")[-1, 0, 0])
    assert own["sigma"][0] == pytest.approx(sigma, rel=1e-6)
    journal = ("--journal", tmp_path / "journal", "--snapshot-every", 5)
    streamed("part", 20, *journal)
    (tmp_path / "part.jsonl").write_text("".join(lines), "utf-8")
    assert streamed("part", len(lines), *journal) == whole


def test_the_folder_of_such_a_study_reads_back(path: Path, tmp_path: Path) -> None:
    spec = StudySpec.of(load_scenario(path), None, ("batch",))
    folder = StudyFolder(tmp_path / "study", spec)
    folder.write(0, run_record(spec.to_json(), 0))
    (record,) = folder.records([0])
    assert record.scalars["rows"]["batch"]["statics"]["range_drift"]["bound"] > 0


def test_a_closed_loop_flies_by_whole_states() -> None:
    """The controller reads moving blocks; the misalignment beside them is found as it flies."""
    stars = "star_tracker_misalignment"
    settings = (
        *("time.epochs=60", 'sensors.star_tracker.mounting="estimated"'),
        f'prior.{stars}={{sigma="0.02 deg", mean=[0, 0, 0]}}',
        f'truth.statics.{stars}=["0.02 deg", "0 deg", "-0.01 deg"]',
    )
    found = compare(load_scenario(EXPERIMENTS / "yang2016.toml", settings), ["ekf", "batch"])
    for row in found.summary["estimators"].values():
        assert row["status"] == "ok", row["message"]
        assert row["statics"][stars]["anees"] < 4
    track = found.track("ekf")
    assert track.truth is not None
    assert np.ptp(track.truth.values[stars], axis=0).max() == 0
    sigma = track.covariance(stars)[[0, -1]].trace(axis1=1, axis2=2) ** 0.5
    assert sigma[1] < sigma[0] < 0.6 * np.radians(0.02) * 3**0.5
