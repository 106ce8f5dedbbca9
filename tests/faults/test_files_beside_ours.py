"""Rows 34 and 52: files of ours that were changed, copied or made by somebody else.

Every field may come back as something else; each is an error that names the file (and the
field), never a traceback, a hang, or a file outside the folder.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from passes import ZHANG, relnav

from relnav_graph.core.catalogue import RELATIVE_POSITION
from relnav_graph.core.models import derived_quantities
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Track
from relnav_graph.errors import InputError
from relnav_graph.io import netcdf
from relnav_graph.io.netcdf import Group, Variable, read_groups, write_groups
from relnav_graph.io.results import read_results, write_results
from relnav_graph.io.track_tables import write_csv
from relnav_graph.report.contents import read_contents
from relnav_graph.study.folder import StudyFolder
from relnav_graph.study.record import RunRecord

Capture = pytest.CaptureFixture[str]
OTHERS: tuple[Any, ...] = (None, True, -1, 0.5, 10**400, "", "../../x", "a\0b", [], [1], {"a": 1})
RESULTS = "relnav-graph results", 1


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folders `pass`, of compare, and `study`, of two runs."""
    folder = tmp_path_factory.mktemp("made")
    short = ("--set", "time.epochs=8", "-e", "ekf")
    from relnav_graph.cli.main import main

    for command in (
        ("compare", ZHANG, *short, "-o", folder / "pass"),
        ("study", ZHANG, *short, "--runs", 2, "-j", 1, "-o", folder / "study"),
    ):
        with pytest.raises(SystemExit) as stop:
            main([str(a) for a in command])
        assert not stop.value.code
    return folder


def _places(tree: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    yield at
    if isinstance(tree, dict):
        for key, value in tree.items():
            yield from _places(value, (*at, key))


def _changed(tree: Any, at: tuple[Any, ...], value: Any) -> Any:
    if not at:
        return value
    return {**tree, at[0]: _changed(tree[at[0]], at[1:], value)}


@pytest.mark.parametrize(
    ("kind", "file", "typed"),
    [
        ("pass", "pass.json", ("name", "raw", "seed", "run", "simulated", "versions", "command")),
        ("study", "study.json", ("name", "raw", "seed", "estimators", "versions", "rerun")),
        ("study", "summary.json", ("failed",)),
    ],
)
def test_row_34_any_field_of_another_type_is_named(
    made: Path, tmp_path: Path, kind: str, file: str, typed: tuple[str, ...]
) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(made / kind, folder)
    whole = json.loads((folder / file).read_text("utf-8"))
    refused = dict.fromkeys(typed, 0)
    for at in [(), *((key,) for key in whole)]:
        for value in OTHERS:
            (folder / file).write_text(json.dumps(_changed(whole, at, value)), "utf-8")
            try:
                read_contents(folder)
            except InputError as error:
                assert file in str(error)  # noqa: PT017
                for key in at:
                    refused[key] = refused.get(key, 0) + (key in str(error))
    assert min(refused[key] for key in typed) > 3, refused


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("name", "../../x", r"study\.json: damaged: name: found '../../x', expected a name"),
        ("estimators", ["ekf", "magic"], r"study\.json: estimators\[1\]: found kind 'magic'"),
        ("estimators", ["os:system"], r"study\.json: estimators: found 'os:system', which has"),
        ("seed", -1, r"study\.json: damaged: seed: "),
        ("raw", {}, r"study\.json, raw: .*"),
    ],
)
def test_row_34_a_study_of_what_cannot_be(
    made: Path, tmp_path: Path, key: str, value: object, says: str
) -> None:
    shutil.copytree(made / "study", tmp_path / "copy")
    file = tmp_path / "copy" / "study.json"
    found = json.loads(file.read_text("utf-8"))
    file.write_text(json.dumps({**found, key: value}), "utf-8")
    with pytest.raises(InputError, match=says):
        read_contents(tmp_path / "copy")


@pytest.mark.parametrize("name", ["000001 (copy).npz", "1.npz", "0000001.npz", "٠٠٠٠٠١.npz"])
def test_row_34_a_copy_of_a_record(made: Path, tmp_path: Path, capsys: Capture, name: str) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(made / "study", folder)
    shutil.copy(folder / "runs" / "000001.npz", folder / "runs" / name)
    again = ("study", ZHANG, "--set", "time.epochs=8", "-e", "ekf", "--runs", 2, "-j", 1)
    for command in (("report", folder), (*again, "-o", folder)):
        code, _, err = relnav(capsys, *command)
        assert code == 2
        assert f"{folder / 'runs' / name}: found a name that no record of a run has" in err
    (folder / "runs" / name).unlink()
    (folder / "runs" / ".000002.npz.left").mkdir()  # what a killed process leaves
    assert StudyFolder.open(folder).runs() == [0, 1]


def test_row_34_any_field_of_a_record(made: Path) -> None:
    content = (made / "study" / "runs" / "000000.npz").read_bytes()
    record = RunRecord.from_bytes(content, "r")
    assert RunRecord.from_bytes(record.to_bytes(), "r").scalars == record.scalars
    refused = 0
    for at in list(_places(record.scalars))[::3]:
        for value in OTHERS:
            changed: Any = _changed(record.scalars, at, value)
            try:
                RunRecord.from_bytes(
                    RunRecord(changed, record.series).to_bytes(), "runs/000000.npz"
                )
            except InputError as error:
                refused += 1
                assert str(error).startswith("runs/000000.npz: damaged: ")  # noqa: PT017
    assert refused > 100
    for name in record.series:
        for array in (np.zeros(3), np.array(["a"]), None):
            series: Any = {**record.series, name: array}
            if array is None:
                del series[name]
            with pytest.raises(InputError, match=r"runs/000000\.npz: damaged: .*"):
                RunRecord.from_bytes(
                    RunRecord(record.scalars, series).to_bytes(), "runs/000000.npz"
                )


def test_row_34_results_with_flipped_bytes_never_reach_hdf5(made: Path, tmp_path: Path) -> None:
    """A flip anywhere: refused in no time, or, in the seal itself, read apart and whole."""
    data, rng = (made / "pass" / "results.nc").read_bytes(), np.random.default_rng(4)
    file, begin = tmp_path / "results.nc", time.monotonic()
    for at in [*range(100), *rng.integers(0, len(data) - 97, 100)]:
        damaged = bytearray(data)
        damaged[at] ^= 1 << int(rng.integers(8))
        file.write_bytes(damaged)
        with pytest.raises(InputError, match=r"results\.nc: damaged or changed"):
            read_results(file)
    assert time.monotonic() - begin < 20


def test_row_34_results_of_an_older_version(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a seal: read as before; damaged, by a process that may die or hang in our place."""
    data = (made / "pass" / "results.nc").read_bytes()
    old = data[: data.rindex(b"\nsha256 of all")]
    file = tmp_path / "results.nc"
    file.write_bytes(old)
    assert [t.name for t in read_results(file)[0]] == ["ekf"]
    file.write_bytes(old[: len(old) // 2])
    with pytest.raises(InputError, match=r"results\.nc: not a readable file"):
        read_results(file)
    monkeypatch.setattr(netcdf, "_START", 0.01)  # as long as HDF5 hangs
    file.write_bytes(old)
    with pytest.raises(InputError, match=r"results\.nc: damaged: HDF5 did not end within"):
        read_results(file)


def test_row_34_results_that_fit_their_seal_and_nothing_else(made: Path, tmp_path: Path) -> None:
    """Somebody may seal anything: attributes of another type, arrays of another shape."""
    groups = read_groups(made / "pass" / "results.nc", *RESULTS)
    file, refused = tmp_path / "results.nc", 0
    group = groups["ekf"]
    for key in group.attributes:
        for value in ("", "ekf", 7, -1.0, '{"a": "b"}'):
            write_groups(
                file, *RESULTS, {**groups, "ekf": Group({**group.attributes, key: value},
                                                       group.variables)}
            )  # fmt: skip
            try:
                read_results(file)
            except InputError as error:
                refused += 1
                assert str(file) in str(error)  # noqa: PT017
    assert refused > 20
    (track,), _, _ = read_results(made / "pass" / "results.nc")
    derived = {d.block.name for d in derived_quantities(track.layout)}  # for others: not read
    unread = {"time", "step_s", *derived, *(f"{name}_covariance" for name in derived)}
    for name in set(group.variables) - unread:
        v = group.variables[name]
        axes = tuple(f"other_{i}" for i in range(v.values.ndim))
        half = Variable(axes, v.values[:4], v.attributes)
        changed = Group(group.attributes, {**group.variables, name: half})
        write_groups(file, *RESULTS, {**groups, "ekf": changed})
        with pytest.raises(InputError, match=r"ekf/.*: damaged: found"):
            read_results(file)


def test_row_52_no_table_outside_its_folder(tmp_path: Path) -> None:
    layout = Layout([RELATIVE_POSITION])
    track = Track("../../x", "filtered", layout, np.zeros(1), np.zeros((1, 3)), np.eye(3)[None])
    with pytest.raises(InputError, match=r"'\.\./\.\./x\.csv' cannot name a file"):
        write_csv(tmp_path / "a" / "b", [track])
    assert not list(tmp_path.rglob("*"))


def test_row_34_texts_that_no_file_can_hold_do_not_undo_the_work(tmp_path: Path) -> None:
    """As a truth's source that bears a file's name may be."""
    write_results(tmp_path / "r.nc", [], None, {"title": "a\0b" + os.fsdecode(b"caf\xe9")})
    assert read_results(tmp_path / "r.nc")[2] == {"title": "a\\x00bcaf\\xe9"}
