"""Row 34: a journal or a data set that is truncated, bit-flipped or of another version."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from passes import ZHANG, relnav
from streams import lines_of, write_scenario

from relnav_graph.scenario.build import load_scenario
from relnav_graph.streaming.journal import Journal, JournalError, read_segment


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A journal of two segments with ten lines each."""
    folder = tmp_path / "journal"
    with Journal(folder, "always") as journal:
        journal.belongs_to({"scenario": "toy"})
        for segment in range(2):
            journal.rotate(b"state %d" % segment)
            for k in range(10):
                journal.append(b"L", b'{"t": %d}' % k)
    return folder


def _reopened(folder: Path) -> tuple[bytes, list[tuple[bytes, bytes]], int]:
    with Journal(folder, "never") as journal:
        return journal.snapshot, journal.records, journal.cut


def test_row_34_a_journal_reads_back(folder: Path) -> None:
    snapshot, records, cut = _reopened(folder)
    assert (snapshot, len(records), cut) == (b"state 1", 10, 0)
    assert records[3] == (b"L", b'{"t": 3}')


def test_row_34_every_truncation_is_cut_to_a_record(folder: Path, tmp_path: Path) -> None:
    """Whatever the length at which the last segment stops: whole records before, no error;
    what is appended then reads back."""
    data = (folder / "00000001.journal").read_bytes()
    _, end = read_segment(folder / "00000001.journal", last=True)
    records_begin = data.index(b"state 1") + len(b"state 1")
    for length in range(records_begin, end):
        copy = tmp_path / f"copy{length}"
        shutil.copytree(folder, copy)
        (copy / "00000001.journal").write_bytes(data[:length])
        with Journal(copy, "never") as journal:
            kept = journal.records
            assert kept == [(b"L", b'{"t": %d}' % k) for k in range(len(kept))]
            assert journal.cut == length - read_segment(copy / "00000001.journal", last=True)[1]
            assert (copy / "00000001.journal").stat().st_size == length  # until it is written to
            journal.append(b"L", b"new")
        assert _reopened(copy)[1] == [*kept, (b"L", b"new")]


def test_row_34_every_flipped_bit_is_an_error(folder: Path) -> None:
    path = folder / "00000001.journal"
    data = path.read_bytes()
    for at in range(len(data)):
        damaged = bytearray(data)
        damaged[at] ^= 1 << (at % 8)
        path.write_bytes(damaged)
        with pytest.raises(JournalError, match=r"00000001\.journal: offset \d+: "):
            _reopened(folder)
        assert path.read_bytes() == damaged  # and nothing is repaired by stealth
        assert (folder / "00000000.journal").is_file()
    path.write_bytes(data)
    assert len(_reopened(folder)[1]) == 10


def test_row_34_a_segment_before_the_last_must_be_whole(folder: Path) -> None:
    path = folder / "00000000.journal"
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(JournalError, match="the file stops within a record"):
        read_segment(path, last=False)


def test_row_34_another_version_is_refused(folder: Path) -> None:
    path = folder / "00000001.journal"
    path.write_bytes(path.read_bytes().replace(b"relnav-journal 3", b"relnav-journal 9", 1))
    with pytest.raises(JournalError, match="found a journal of version 9, expected 3"):
        _reopened(folder)


def test_row_34_a_journal_of_the_former_isam2_says_what_to_do(folder: Path) -> None:
    path = folder / "00000001.journal"
    path.write_bytes(path.read_bytes().replace(b"relnav-journal 3", b"relnav-journal 2", 1))
    with pytest.raises(JournalError, match="isam2 is called incremental now; resume it with that"):
        _reopened(folder)


def test_row_34_another_run_and_a_second_process_are_refused(folder: Path) -> None:
    with Journal(folder, "never") as journal:
        journal.belongs_to({"scenario": "toy"})
        with pytest.raises(JournalError, match="another run: found scenario = 'toy'"):
            journal.belongs_to({"scenario": "other"})
    with (
        Journal(folder, "never"),
        pytest.raises(JournalError, match="another process writes it"),
    ):
        Journal(folder, "never")


@pytest.mark.parametrize("damage", ["truncated", "flipped", "version"])
def test_row_34_a_damaged_data_set_is_refused(
    damage: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = tmp_path / "pass"
    assert relnav(capsys, "simulate", ZHANG, "--set", "time.epochs=5", "-o", data)[0] == 0
    path = data / ("dataset.toml" if damage == "version" else "beacons.csv")
    content = path.read_bytes()
    middle = len(content) // 2
    changed = {
        "truncated": content[:middle],
        "flipped": content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :],
        "version": content.replace(b"format = 1", b"format = 7"),
    }
    path.write_bytes(changed[damage])
    code, _, err = relnav(capsys, "smooth", data, "-o", tmp_path / "out")
    assert code == 2
    assert str(path) in err
    assert ("found format 7, expected 1" if damage == "version" else "changed since") in err
    assert not (tmp_path / "out").exists()


def test_row_34_the_command_refuses_a_damaged_journal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_scenario(tmp_path)
    (tmp_path / "lines").write_text("\n".join(lines_of(load_scenario(path))) + "\n", "utf-8")
    journal = tmp_path / "journal"
    options = ("stream", path, "--from", tmp_path / "lines", "--journal", journal)
    assert relnav(capsys, *options, "-o", tmp_path / "out", "--snapshot-every", 25)[0] == 0
    before = (tmp_path / "out").read_bytes()
    last = sorted(journal.glob("*.journal"))[-1]
    whole = last.read_bytes()
    last.write_bytes(whole[:-30] + bytes([whole[-30] ^ 4]) + whole[-29:])
    code, _, err = relnav(capsys, *options, "-o", tmp_path / "out")
    assert code == 2
    assert f"{last}: offset " in err
    assert (tmp_path / "out").read_bytes() == before
    # The segment before is whole: without the damaged one, the stream goes on from there.
    last.unlink()
    code, _, err = relnav(capsys, *options, "-o", tmp_path / "out")
    assert code == 0, err
    assert (tmp_path / "out").read_bytes() == before
    # Nor is it taken for the journal of another scenario or estimator.
    code, _, err = relnav(capsys, *options, "-o", tmp_path / "out", "-e", "ekf")
    assert code == 2
    assert "the journal belongs to another run: found estimator = 'fixed_lag'" in err
