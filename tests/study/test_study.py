"""Studies: the same numbers whoever makes the runs, nothing lost, nothing mixed up."""

from __future__ import annotations

import errno
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import distributed
import numpy as np
import pytest
from passes import ZHANG

from relnav_graph.cli.main import main
from relnav_graph.errors import EstimationError, InputError
from relnav_graph.estimators import try_estimator
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.study import runs
from relnav_graph.study.collect import collect
from relnav_graph.study.conduct import Progress, Workers, do_runs, do_until, merge, study_summary
from relnav_graph.study.folder import StudyFolder
from relnav_graph.study.record import BINS, RunRecord, bin_edges
from relnav_graph.study.runs import StudySpec, run_record

SHORT = ("time.epochs=12",)
KINDS = ("iekf", "batch")
RUNS = 6
Capture = pytest.CaptureFixture[str]


def _spec(*settings: str, kinds: tuple[str, ...] = KINDS, seed: int = 3) -> StudySpec:
    return StudySpec.of(load_scenario(ZHANG, (*SHORT, *settings)), seed, kinds)


def _untimed(tree: Any) -> Any:
    """Without timings and what depends on where a study was made."""
    if isinstance(tree, dict):
        left = ("runtime_s", "step_ms", "command")
        return {k: _untimed(v) for k, v in tree.items() if k not in left}
    return [_untimed(v) for v in tree] if isinstance(tree, list) else tree


def _summary(folder: StudyFolder, runs: int = RUNS) -> Any:
    return _untimed(study_summary(folder, range(runs), {})[0])


def _relnav(capsys: Capture, *arguments: object) -> tuple[int, str, str]:
    capsys.readouterr()
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    return int(stop.value.code or 0), out, err


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    """A study, made in this process, one run after the other."""
    folder = StudyFolder(tmp_path_factory.mktemp("study") / "done", _spec(), "relnav compare X")
    assert do_runs(folder, range(RUNS)) == {}
    return folder


@pytest.fixture(scope="module")
def expected(done: StudyFolder) -> Any:
    return _summary(done)


# --- the same numbers, wherever the runs are made -------------------------------------------


def test_two_processes_give_the_same_numbers(tmp_path: Path, expected: Any) -> None:
    folder = StudyFolder(tmp_path / "two", _spec())
    do_runs(folder, range(RUNS), Workers(2))
    assert _summary(folder) == expected


def test_any_executor_gives_the_same_numbers(tmp_path: Path, expected: Any) -> None:
    folder = StudyFolder(tmp_path / "threads", _spec())
    with ThreadPoolExecutor(2) as executor:
        do_runs(folder, range(RUNS), Workers(2, executor))
        assert executor.submit(int).result() == 0  # it is the caller's, and still open
    assert _summary(folder) == expected


def test_four_shards_merged_give_the_same_numbers(tmp_path: Path, expected: Any) -> None:
    shards = []
    for i in range(4):
        folder = StudyFolder(tmp_path / f"shard{i}", _spec())
        do_runs(folder, range(i, RUNS, 4))
        shards.append(folder.path)
    assert _summary(merge(tmp_path / "all", shards[::-1])) == expected


def test_dask_gives_the_same_numbers(capsys: Capture, expected: Any) -> None:
    """A real scheduler, with workers in processes of their own."""
    kinds = [part for kind in KINDS for part in ("-e", kind)]
    settings = ["--seed", "3", "--set", *SHORT, "--runs", RUNS]
    code, out, _ = _relnav(
        capsys, "study", ZHANG, *kinds, *settings, "--dask", "local", "-j", 2, "--json"
    )
    assert code == 0
    assert _untimed(json.loads(out)) == expected


def test_a_run_of_a_study_can_be_made_alone(capsys: Capture, done: StudyFolder) -> None:
    (record,) = done.records([4])
    code, out, _ = _relnav(
        capsys, "compare", ZHANG, "--seed", 3, "--run", 4, "--set", *SHORT, "-e", "batch", "--json"
    )
    alone = json.loads(out)["estimators"]["batch"]["states"]
    assert code == 0
    for name, state in record.scalars["rows"]["batch"]["states"].items():
        assert state["rmse"] == alone[name]["rmse"]
        assert state["anees"] == alone[name]["anees"]


def test_runs_differ_and_estimators_share_them(done: StudyFolder) -> None:
    records = list(done.records([0, 1]))
    values = [r.scalars["rows"]["batch"]["states"]["relative_position"]["rmse"] for r in records]
    assert values[0] != values[1]
    more = StudySpec.of(load_scenario(ZHANG, SHORT), 3, ("batch", "ekf"))
    again = RunRecord.from_bytes(run_record(more.to_json(), 1), "")
    assert again.scalars["rows"]["batch"] == records[1].scalars["rows"]["batch"]


# --- killed, and resumed ----------------------------------------------------------------------


@pytest.mark.parametrize("jobs", [1, 2])
def test_killed_and_resumed_it_ends_the_same(
    tmp_path: Path, capsys: Capture, expected: Any, jobs: int
) -> None:
    out = tmp_path / "killed"
    command = ["study", ZHANG, "--seed", 3, "--set", *SHORT, "--runs", RUNS, "-j", jobs, "-o", out]
    command += [part for kind in KINDS for part in ("-e", kind)]
    start = "from relnav_graph.cli.main import main; main()"
    program = [sys.executable, "-c", start, *map(str, command)]
    with subprocess.Popen(program, stderr=subprocess.DEVNULL, start_new_session=True) as process:
        deadline = time.monotonic() + 120
        while not list(out.glob("runs/*.npz")) and time.monotonic() < deadline:
            time.sleep(0.01)
        time.sleep(random.uniform(0.0, 0.5))
        process.send_signal(signal.SIGKILL)
    assert 0 < len(list(out.glob("runs/[0-9]*.npz"))) <= RUNS
    code, text, err = _relnav(capsys, *command, "--json")
    assert code == 0
    assert "are there" in err
    assert _untimed(json.loads(text)) == expected


# --- folders ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        (_spec("time.step='11 s'"), "raw.time.step: found '10 s', expected '11 s'"),
        (_spec(seed=4), "seed: found 3, expected 4"),
        (_spec(kinds=("ekf",)), "estimators: found"),
    ],
)
def test_a_folder_of_another_study_is_refused(
    done: StudyFolder, spec: StudySpec, words: str
) -> None:
    with pytest.raises(InputError, match="another study") as error:
        StudyFolder(done.path, spec)
    assert words in str(error.value)


def test_a_folder_of_another_version_is_refused(tmp_path: Path, done: StudyFolder) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(done.path, copy)
    manifest = json.loads((copy / "study.json").read_text())
    manifest["versions"]["relnav-graph"] = "0.0.1"
    (copy / "study.json").write_text(json.dumps(manifest))
    with pytest.raises(InputError, match=r"versions\.relnav-graph: found '0\.0\.1'"):
        StudyFolder.open(copy)


def test_a_folder_of_the_former_isam2_is_refused(tmp_path: Path, done: StudyFolder) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(done.path, copy)
    manifest = json.loads((copy / "study.json").read_text())
    manifest["versions"]["relnav-graph"] = "0.2.0"
    manifest["estimators"] = ["ekf", "isam2"]
    (copy / "study.json").write_text(json.dumps(manifest))
    with pytest.raises(InputError, match=r"isam2 of relnav-graph 0\.2\.0 is called incremental"):
        StudyFolder.open(copy)


def test_a_folder_with_other_things_in_it_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("dear")
    with pytest.raises(InputError, match="is not empty"):
        StudyFolder(tmp_path, _spec())
    with pytest.raises(InputError, match=r"no study\.json"):
        StudyFolder.open(tmp_path)


@pytest.mark.parametrize("damage", ["truncated", "flipped", "renamed"])
def test_a_damaged_record_is_refused(tmp_path: Path, done: StudyFolder, damage: str) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(done.path, copy)
    file = copy / "runs" / "000002.npz"
    content = file.read_bytes()
    if damage == "renamed":
        file.rename(copy / "runs" / "000007.npz")
    else:
        half = len(content) // 2
        flipped = content[:half] + bytes([content[half] ^ 1]) + content[half + 1 :]
        file.write_bytes(content[:half] if damage == "truncated" else flipped)
    with pytest.raises(InputError, match=r"00000[27]"):
        collect(StudyFolder.open(copy).records(StudyFolder.open(copy).runs()))


def test_a_full_disk_leaves_nothing_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = StudyFolder(tmp_path / "full", _spec())
    write = Path.write_bytes

    def full(path: Path, content: Any) -> int:
        if path.name == "000001.npz":
            write(path, content[: len(content) // 2])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(path, content)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(InputError, match="No space left on device"):
        do_runs(folder, range(3))
    assert [f.name for f in (folder.path / "runs").iterdir()] == ["000000.npz"]
    monkeypatch.undo()
    assert do_runs(folder, range(3)) == {}
    assert folder.runs() == [0, 1, 2]


def test_merging_different_studies_is_refused(tmp_path: Path, done: StudyFolder) -> None:
    other = StudyFolder(tmp_path / "other", _spec(seed=4))
    with pytest.raises(InputError, match="seed"):
        merge(tmp_path / "merged", [done.path, other.path])


def test_missing_shards_are_named(tmp_path: Path, capsys: Capture, done: StudyFolder) -> None:
    first = StudyFolder(tmp_path / "first", _spec())
    for run in (0, 2):
        first.write(run, done.read_bytes(run))
    code, out, _ = _relnav(capsys, "study", "--merge", first.path, "-o", tmp_path / "m", "--json")
    assert code == 3
    assert [(f["run"], f["message"]) for f in json.loads(out)["failed"]] == [
        (1, "no shard has this run")
    ]


# --- failures, precision, progress ------------------------------------------------------------


@pytest.fixture
def fragile(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """An ekf that fails in run 1, and a simulation that fails in run 2."""
    simulate, estimate = Scenario.simulate, try_estimator
    current: list[int] = []

    def simulate_or_fail(self: Scenario, seed: int, run: int = 0) -> Any:
        current[:] = [run]
        if run == 2:
            raise InputError("no such sky")
        return simulate(self, seed, run)

    def estimate_or_fail(kind: str, problem: Any) -> Any:
        if kind == "iekf" and current == [1]:
            return replace(estimate("test_study:Failing", problem), name=kind)
        return estimate(kind, problem)

    monkeypatch.setattr(Scenario, "simulate", simulate_or_fail)
    monkeypatch.setattr(runs, "try_estimator", estimate_or_fail)
    yield
    runs._prepared.cache_clear()


class Failing:
    """An estimator that never succeeds."""

    kind = "iekf"

    def run(self, problem: Any) -> Any:
        raise EstimationError("lost its way")


@pytest.mark.usefixtures("fragile")
def test_a_failed_run_is_kept_counted_and_named(tmp_path: Path) -> None:
    folder = StudyFolder(tmp_path / "f", _spec(), "relnav compare zhang2015.toml --seed 3")
    do_runs(folder, range(4))
    found, _ = study_summary(folder, range(4), {})
    named = {(f["run"], f["estimator"]): f for f in found["failed"]}
    assert set(named) == {(2, None), (1, "iekf")}
    assert "no such sky" in named[2, None]["message"]
    assert "lost its way" in named[1, "iekf"]["message"]
    assert named[1, "iekf"]["command"] == ("relnav compare zhang2015.toml --seed 3 --run 1 -e iekf")
    rows = found["estimators"]
    assert (rows["iekf"]["runs"], rows["batch"]["runs"]) == (2, 3)
    assert (rows["iekf"]["kind"], rows["iekf"]["status"]) == ("filtered", "degraded")
    # Pairs are of the runs that both have.
    (pair,) = found["paired"]
    assert pair["states"]["relative_position"]["runs"] == 2


def test_runs_stop_at_the_precision_asked_for(tmp_path: Path, done: StudyFolder) -> None:
    folder = StudyFolder(tmp_path / "until", _spec())
    for run in range(RUNS):
        folder.write(run, done.read_bytes(run))
    count, _ = do_until(folder, 0.9, 100)
    assert count == 10
    assert do_until(folder, 1e-6, 13) == (13, {})
    assert folder.runs() == list(range(13))


def test_progress_counts_what_was_there(done: StudyFolder, tmp_path: Path) -> None:
    folder = StudyFolder(tmp_path / "p", _spec())
    folder.write(0, done.read_bytes(0))
    events: list[Progress] = []
    do_runs(folder, range(3), listener=events.append)
    assert [(e.done, e.total, e.run) for e in events] == [(2, 3, 1), (3, 3, 2)]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--shard", "5/4"), "expected i/n"),
        (("--shard", "1/4"), "--shard needs -o"),
        (("--until-ci", "200%"), "expected a part"),
        (("--merge",), "--merge needs -o"),
        (("-e", "nothing"), "found kind 'nothing'"),
        (("--dask", "tcp://127.0.0.1:1"), "--dask tcp://127.0.0.1:1"),
    ],
)
def test_wrong_options_say_what_was_expected(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], words: str
) -> None:
    client = partial(distributed.Client, timeout=1)
    monkeypatch.setattr(distributed, "Client", lambda place, **_: client(place))
    code, _, err = _relnav(capsys, "study", ZHANG, *arguments)
    assert code == 2
    assert words in err


def test_a_scenario_without_truth_has_no_runs() -> None:
    scenario = load_scenario(ZHANG.parent / "starry_night.toml")
    with pytest.raises(InputError, match=r"no \[truth\]"):
        StudySpec.of(scenario, None, ())


# --- records ----------------------------------------------------------------------------------


def test_a_record_is_of_one_size_however_long_the_pass() -> None:
    assert len(bin_edges(7)) == 8
    for count in (BINS, 12345):
        edges = bin_edges(count)
        assert len(edges) == BINS + 1
        assert (edges[0], edges[-1]) == (0, count)
        assert np.diff(edges).min() >= count // BINS


def test_a_record_survives_its_file(done: StudyFolder) -> None:
    (record,) = done.records([1])
    again = RunRecord.from_bytes(record.to_bytes(), "")
    assert again.scalars == record.scalars
    assert all(np.array_equal(again.series[k], v, equal_nan=True) for k, v in record.series.items())


def test_wrong_paths_are_named(capsys: Capture, tmp_path: Path) -> None:
    code, _, err = _relnav(capsys, "study", tmp_path / "none.toml")
    assert (code, "cannot be read" in err) == (2, True)
    code, _, err = _relnav(capsys, "study", ZHANG, ZHANG)
    assert (code, "expected one" in err) == (2, True)
