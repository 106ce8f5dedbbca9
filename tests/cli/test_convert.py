"""``relnav convert`` to and from files of others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from ccsds import EPOCH, track
from passes import relnav

from relnav_graph import read_raw, write_track
from relnav_graph.io.results import read_results, write_results
from relnav_graph.io.tabular import read_table
from relnav_graph.io.writers import writers
from relnav_graph.runs.passes import open_dataset, open_pass

Capture = pytest.CaptureFixture[str]
SCENARIO: dict[str, Any] = {
    "title": "fixes on orbits of others",
    "data": {"reader": "tables", "simulate": ["fix"]},
    "processes": {"motion": {"kind": "white_noise_acceleration", "acceleration_density": 0.1}},
    "sensors": {"fix": {"kind": "position_fix", "sigma": 1.0}},
    "prior": {"relative_position": {"sigma": 5.0}, "relative_velocity": {"sigma": 1.0}},
}


def test_results_go_to_files_of_others(capsys: Capture, tmp_path: Path) -> None:
    """By the suffix or by name; when t = 0 is, the results say, or an option."""
    one, stored = track(), tmp_path / "results.nc"
    write_results(stored, [one], None, {"time_epoch": EPOCH, "o": "i"})
    assert set(writers()) >= {"aem", "csv", "nc", "oem", "parquet"}
    code, _, said = relnav(capsys, "convert", stored, tmp_path / "a.oem")
    assert (code, said) == (0, f"{tmp_path / 'a.oem'}: one\n")
    truth = read_raw("oem", tmp_path / "a.oem", {"role": "truth"}).truth
    assert truth is not None
    np.testing.assert_array_equal(truth.values["chaser_position"], one.x[:, :3])
    arguments = ("convert", stored, tmp_path / "b", "--to", "aem", "--option", "time_system=TAI")
    assert relnav(capsys, *arguments)[0] == 0
    assert "TIME_SYSTEM = TAI" in (tmp_path / "b").read_text()
    for form in ("csv", "parquet"):
        assert relnav(capsys, "convert", stored, tmp_path / form, "--to", form)[0] == 0
        assert (tmp_path / form / f"one.{form}").is_file()
    assert relnav(capsys, "convert", stored, tmp_path / "c.nc")[0] == 0
    (again,), _, _ = read_results(tmp_path / "c.nc")
    np.testing.assert_array_equal(again.x[:, :12], one.x[:, :12])  # attitudes are quaternions there
    np.testing.assert_array_equal(again.P, one.P)
    for extra, says in (
        (("--to", "sp3"), "unknown writer 'sp3'; known are aem,"),
        (("--track", "two"), "found track 'two', expected one by --track: one"),
        (("--option", "colour=red"), "writer 'oem': unknown option 'colour'"),
    ):
        code, _, said = relnav(capsys, "convert", stored, tmp_path / "d.oem", *extra)
        assert code == 2
        assert says in said
    code, _, said = relnav(capsys, "convert", stored, tmp_path / "d.foo")
    assert code == 2
    assert "no writer makes files .foo; expected one of .aem, .bag, .csv, .mcap," in said
    assert not (tmp_path / "d.foo").exists()
    write_results(stored, [one], None, {})
    code, _, said = relnav(capsys, "convert", stored, tmp_path / "d.oem")
    assert code == 2
    assert "when is t = 0 of 'one'?" in said


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_one_track_goes_to_one_table(capsys: Capture, tmp_path: Path, form: str) -> None:
    """Of a file of results, or of the folder that has it; a folder of that name stays one."""
    one, stored, out = track(), tmp_path / "out" / "results.nc", tmp_path / f"mine.{form}"
    stored.parent.mkdir()
    other = replace(track(seed=1), name="other", smoothed=replace(one, name="other"))
    write_results(stored, [one, other], None, {})
    code, _, said = relnav(capsys, "convert", stored.parent, out)
    assert code == 2
    assert "found several tracks, expected one by --track: one, other, other_smoothed" in said
    for name, means in (("other", other), ("other_smoothed", one)):
        code, _, said = relnav(capsys, "convert", stored.parent, out, "--track", name)
        assert (code, said) == (0, f"{out}: {name}\n")
        assert {p.name for p in tmp_path.iterdir()} == {"out", out.name}
        table = read_table(tmp_path, "mine")
        assert table is not None
        np.testing.assert_array_equal(
            table["relative_position_x_m"], means.value("relative_position")[:, 0]
        )
    folder = tmp_path / f"tables.{form}"
    folder.mkdir()
    code, _, said = relnav(capsys, "convert", stored, folder)
    assert (code, said) == (0, f"{folder}: 2 tracks\n")
    assert {p.stem for p in folder.iterdir()} == {"one", "other", "other_smoothed"}


@pytest.mark.parametrize("o", ["i", ""])
def test_results_that_know_their_axes_need_no_caution(
    capsys: Capture, tmp_path: Path, o: str, caplog: pytest.LogCaptureFixture
) -> None:
    """Those of a scenario with an absolute time do; older ones do not say so."""
    stored, out = tmp_path / "results.nc", tmp_path / "a.oem"
    write_results(stored, [track()], None, {"time_epoch": EPOCH} | ({"o": o} if o else {}))
    assert relnav(capsys, "convert", stored, out, "--option", "of=relative")[0] == 0
    assert ("are not known to be inertial" in caplog.text) == (not o)


def test_two_orbits_become_data(capsys: Capture, tmp_path: Path) -> None:
    """A folder of truth, on which a scenario simulates its sensors; or at once a data set."""
    one, paths = track(), [tmp_path / f"{n}.oem" for n in ("chaser", "target")]
    for path in paths:
        write_track("oem", one, path, epoch=EPOCH, of=path.stem)
    out, mine = tmp_path / "pass", tmp_path / "mine.toml"
    mine.write_text(tomli_w.dumps(SCENARIO))
    both = (paths[0], out, "--target", paths[1])
    code, _, said = relnav(capsys, "convert", *both)
    assert code == 0
    assert f"{out}: 12 epochs of truth" in said
    opened = open_pass(mine, data=out)
    assert opened.recording.truth is not None
    relative = opened.recording.truth.values["relative_position"]
    np.testing.assert_allclose(relative, one.x[:, 6:9], atol=1e-8)
    assert len(opened.recording.measurements) == 12
    assert opened.scenario.file.time.epoch == "2017-01-01T00:01:03.584 TT"
    code, _, _ = relnav(capsys, "convert", *both, "--scenario", mine)
    assert code == 0
    again = open_dataset(out)
    for a, b in zip(again.recording.measurements, opened.recording.measurements, strict=True):
        np.testing.assert_array_equal(a.z, b.z)
    code, _, said = relnav(capsys, "convert", paths[0], tmp_path / "mine.toml")
    assert code == 2
