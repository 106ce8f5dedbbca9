"""A study counts the cautions of its runs: row 58, over many runs."""

from __future__ import annotations

from pathlib import Path

from passes import ZHANG

from relnav_graph.runs.comparison import compare
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scoring.text import study_table
from relnav_graph.study.conduct import do_runs, study_summary
from relnav_graph.study.folder import StudyFolder
from relnav_graph.study.runs import StudySpec

#: A far target with coarse lines of sight; and an orbit whose epoch is many revolutions away.
FAR = (
    'time.step="1.26 s"',
    "time.epochs=50",
    'sensors.beacons.sigma="2 mrad"',
    'truth.relative_position=["3487 m", "1357 m", "-417 m"]',
    'inputs.gyro.period="1.26 s"',
    'prior.relative_position.sigma="83 m"',
    'prior.target_rate.sigma="3.9 deg/s"',
    'orbit.epoch="1e6 s"',
)
KINDS, RUNS, SEED = ("iekf", "batch"), 3, 3


def test_row_58_a_study_says_how_many_runs_have_which_caution(tmp_path: Path) -> None:
    scenario = load_scenario(ZHANG, FAR)
    folder = StudyFolder(tmp_path / "study", StudySpec.of(scenario, SEED, KINDS))
    do_runs(folder, range(RUNS))
    summary, _ = study_summary(folder, range(RUNS), {})
    expected: dict[tuple[str | None, str], list[int]] = {}
    for run in range(RUNS):
        found = compare(scenario, KINDS, seed=SEED, run=run).summary["cautions"]
        for key in sorted({(c["estimator"] or "", c["name"]) for c in found}):
            expected.setdefault((key[0] or None, key[1]), []).append(run)
    assert ("batch", "bent posterior") in expected
    assert (None, "orbit epoch") in expected
    counted = {(c["estimator"], c["name"]): c["runs"] for c in summary["cautions"]}
    assert counted == {key: len(runs) for key, runs in expected.items()}
    listed = {(c["estimator"], c["name"]): c["text"] for c in summary["cautions"]}
    for key, runs in expected.items():
        assert listed[key] == f"in {len(runs)} of {RUNS} runs: {', '.join(map(str, runs))}"
    bent = len(expected["batch", "bent posterior"])
    own = sorted((name, len(runs)) for (row, name), runs in expected.items() if row == "batch")
    counts = ", ".join(f"{name} {runs}" for name, runs in own)
    sentence = f"batch: runs with a caution, of {RUNS}: {counts}."
    assert sentence in summary["verdict"]["text"]
    assert sentence in study_table(summary)
    assert f"caution: batch: bent posterior: in {bent} of {RUNS} runs" in study_table(summary)


def test_a_study_of_good_runs_says_nothing_of_cautions(tmp_path: Path) -> None:
    scenario = load_scenario(ZHANG, ["time.epochs=12"])
    folder = StudyFolder(tmp_path / "study", StudySpec.of(scenario, SEED, ("batch",)))
    do_runs(folder, range(2))
    summary, _ = study_summary(folder, range(2), {})
    assert summary["cautions"] == []
    assert "caution" not in study_table(summary)
