"""Row 52, and what a stream must not do: touch others' files, import what data name."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from passes import relnav
from streams import RELNAV, SCENARIO, feed, lines_of, session_of, toy, write_scenario

from relnav_graph.errors import InputError
from relnav_graph.scenario.build import load_scenario, make_scenario
from relnav_graph.streaming.journal import Journal
from relnav_graph.streaming.options import Options
from relnav_graph.streaming.run import JournaledSession

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def here(tmp_path: Path) -> Path:
    """A scenario, and its lines."""
    _, lines = toy(tmp_path)
    (tmp_path / "lines").write_text("\n".join(lines) + "\n", "utf-8")
    return tmp_path


def _stream(here: Path, capsys: Capture, *options: Any) -> tuple[int, str, str]:
    return relnav(capsys, "stream", here / "toy.toml", "--from", here / "lines", *options)


def _begun(here: Path, capsys: Capture, count: int) -> None:
    """A run that ended after some lines, with its journal and output."""
    lines = (here / "lines").read_text("utf-8").splitlines(True)
    (here / "lines").write_text("".join(lines[:count]), "utf-8")
    options = "--journal", here / "journal", "-o", here / "out", "--allow-rejects"
    assert _stream(here, capsys, *options)[0] == 0
    (here / "lines").write_text("".join(lines), "utf-8")


# --- 52 ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "content",
    [
        b"title = 'a scenario'\n",
        b"no end of line",
        b'{"format": "relnav-lines", "version": 1}\n',
        b'{"seq": "x"}\n',
        b'notes\n{"seq": 5, "t": 1.0}\n',
        b"\x00\xff\x00",
        b"\n",
        b"{",
    ],
)
@pytest.mark.parametrize("resumed", [False, True])
def test_row_52_output_that_names_an_unrelated_file(
    here: Path, capsys: Capture, content: bytes, resumed: bool
) -> None:
    """Refused before a byte of it changes; with a journal, that neither."""
    if resumed:
        _begun(here, capsys, 20)
    file = here / "precious"
    file.write_bytes(content)
    options = ("--journal", here / "journal") if resumed else ()
    before = {p.name: p.read_bytes() for p in here.glob("journal/*")}
    code, _, err = _stream(here, capsys, *options, "-o", file)
    assert code == 2
    assert "holds no lines of a stream" in err
    assert file.read_bytes() == content
    assert {p.name: p.read_bytes() for p in here.glob("journal/*")} == before


def test_row_52_output_of_another_stream_is_not_gone_on_with(here: Path, capsys: Capture) -> None:
    """It has enough lines, the last of them torn, but not those of this journal."""
    scenario = load_scenario(here / "toy.toml")
    _begun(here, capsys, 30)
    other = feed(session_of(scenario, lines_of(scenario, 9)[0]), lines_of(scenario, 9))
    content = "\n".join(json.dumps({**line, "latency_ms": 1.0}) for line in other) + '\n{"seq": 40'
    (here / "other").write_text(content, "utf-8")
    code, _, err = _stream(here, capsys, "--journal", here / "journal", "-o", here / "other")
    assert code == 2
    assert "not the file of this journal" in err
    assert (here / "other").read_text("utf-8") == content
    torn = (here / "out").read_bytes() + b'{"seq": 1'
    (here / "out").write_bytes(torn)
    assert _stream(here, capsys, "--journal", here / "journal", "-o", here / "out")[0] == 0
    found = [json.loads(line) for line in (here / "out").read_text("utf-8").splitlines()]
    assert [line["seq"] for line in found] == list(range(len(found)))
    assert found[-1]["t"] == 39.0


def test_row_52_output_of_an_earlier_stream_is_written_anew(here: Path, capsys: Capture) -> None:
    for _ in range(2):
        assert _stream(here, capsys, "-o", here / "out")[0] == 0
        assert len((here / "out").read_bytes().splitlines()) == 40


def test_row_52_journal_in_an_unrelated_folder(here: Path, capsys: Capture) -> None:
    folder = here / "papers"
    folder.mkdir()
    (folder / ".00000000.journal.x").mkdir()
    (folder / "thesis.tex").write_text("x", "utf-8")
    code, _, err = _stream(here, capsys, "--journal", folder)
    assert code == 2
    assert "found 'thesis.tex' and no journal" in err
    assert sorted(p.name for p in folder.iterdir()) == [".00000000.journal.x", "thesis.tex"]
    (folder / "thesis.tex").rename(folder / "00000003.journal")
    assert "not a journal; found b'x'" in _stream(here, capsys, "--journal", folder)[2]
    assert (folder / "00000003.journal").read_text("utf-8") == "x"
    assert (folder / ".00000000.journal.x").is_dir()
    code, _, err = _stream(here, capsys, "--journal", here / "lines")
    assert (code, "--journal" in err) == (2, True)


def test_row_52_a_torn_journal_of_another_run_is_left_as_it_is(here: Path, capsys: Capture) -> None:
    _begun(here, capsys, 30)
    segment = here / "journal/00000000.journal"
    torn = segment.read_bytes()[:-3]
    segment.write_bytes(torn)
    code, _, err = _stream(here, capsys, "--journal", here / "journal", "-e", "ekf")
    assert code == 2
    assert "belongs to another run" in err
    assert segment.read_bytes() == torn


# --- 50, in the journal --------------------------------------------------------------------


def test_row_50_a_refused_line_goes_into_the_journal_and_comes_out_the_same(here: Path) -> None:
    """Resumed after each: the same state, and the same lines out."""
    scenario = load_scenario(here / "toy.toml")
    lines = lines_of(scenario)
    wrong = ['{"epoch": 1' + 309 * "0" + "}", '{"sensor": "x", "t": 5}', "[1]", '{"epoch": -9.0}']
    mixed = [*lines[:12], wrong[0], *lines[12:20], *wrong[1:], *lines[20:]]
    whole = feed(session_of(scenario, lines[0]), mixed)
    out: list[dict[str, Any]] = []
    for k, line in enumerate(mixed):
        with Journal(here / "journal", "never") as journal:
            recorder = JournaledSession(session_of(scenario, lines[0]), journal, 7)
            again = recorder.begin()
            fresh = [*again[max(len(out) - recorder.kept - 1, 0) :], *recorder.take(line.encode())]
            out += fresh
            assert recorder.session.lines == k + 1
            for told in fresh:
                recorder.told(told)
    assert json.loads(json.dumps(out)) == whole[: len(out)]


# --- data are not code -----------------------------------------------------------------------


def _trap(folder: Path) -> None:
    (folder / "trap.py").write_text(
        "import pathlib\npathlib.Path('sprung').touch()\nclass Model:\n    kind = 'trap'\n", "utf-8"
    )


@pytest.mark.parametrize("section", ["sensors", "processes"])
@pytest.mark.parametrize("name", ["extra", "fix", "motion"])
def test_a_header_never_names_a_module(here: Path, section: str, name: str) -> None:
    """Over whatever it comes; the module is not even imported."""
    _trap(here)
    settings = {section: {name: {"kind": "trap:Model"}}}
    header = {"format": "relnav-lines", "version": 1, "settings": settings}
    done = subprocess.run(
        [*RELNAV, "stream", "toy.toml"],
        cwd=here,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([*sys.path, str(here)])},
        input=json.dumps(header) + "\n",
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 2
    assert f"{section}.{name}.kind: found 'trap:Model', which has a module" in done.stderr
    assert not (here / "sprung").exists()


def test_what_a_scenario_file_names_it_may_name() -> None:
    """The toy scenario's own models are of a module."""
    import tomllib

    raw = tomllib.loads(SCENARIO)
    assert make_scenario(raw, "toy").sensors
    with pytest.raises(InputError, match="only a scenario file may, or data"):
        make_scenario(raw, "toy", {"sensors": raw["sensors"]})


# --- how it is begun and ended ---------------------------------------------------------------


def test_a_closed_standard_output_takes_no_journal_for_it(here: Path) -> None:
    """Whatever of the three streams is closed: an error, or a run that needs none of them."""

    def run(rest: str) -> subprocess.CompletedProcess[str]:
        command = " ".join(map("'{}'".format, RELNAV)) + f" stream toy.toml --from lines {rest}"
        return subprocess.run(
            ["bash", "-c", command],
            cwd=here,
            env={**os.environ, "PYTHONPATH": os.pathsep.join([*sys.path])},
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            timeout=120,
        )

    done = run("--journal j >&-")
    assert done.returncode == 2
    assert "standard output: cannot be written" in done.stderr
    assert run("--journal k -o out <&- >&- 2>&-").returncode == 0
    assert len((here / "out").read_text("utf-8").splitlines()) == 40
    with Journal(here / "k", "never") as journal:
        assert journal.records


@pytest.mark.parametrize(
    ("first", "says"),
    [
        ("{\n", "an object over many lines, expected an object on each line"),
        ("[{}, {}]\n", "an array, expected an object on each line"),
        ("\ufeff[\n", "an array, expected an object on each line"),
    ],
)
def test_another_form_of_json_says_what_it_is(
    here: Path, capsys: Capture, first: str, says: str
) -> None:
    (here / "lines").write_text(first + (here / "lines").read_text("utf-8"), "utf-8")
    code, out, err = _stream(here, capsys)
    assert (code, out) == (2, "")
    assert says in err
    assert "found '" in err


def test_a_mark_before_the_first_line_is_none_of_it(here: Path, capsys: Capture) -> None:
    """As some editors write; in UTF-16 nothing can be read."""
    text = (here / "lines").read_text("utf-8")
    code, plain, _ = _stream(here, capsys)
    (here / "lines").write_text(text, "utf-8-sig")
    code, marked, _ = _stream(here, capsys)
    assert code == 0
    assert [json.loads(x)["estimate"] for x in plain.splitlines()] == [
        json.loads(x)["estimate"] for x in marked.splitlines()
    ]
    (here / "lines").write_text(text, "utf-16")
    code, _, err = _stream(here, capsys)
    assert (code, "UTF-16, expected UTF-8" in err) == (2, True)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--max-gap", "nan"], "--max-gap: found nan s"),
        (["--max-gap", "-1"], "--max-gap: found -1.0 s"),
        (["--patience", "nan"], "--patience: found nan s"),
        (["--settle", "nan"], "--settle: found nan s"),
        (["--settle", "-1"], "--settle: found -1.0 s"),
        (["--follow", "--for", "nan"], "--for: found nan s"),
    ],
)
def test_lengths_of_time_that_cannot_be(
    here: Path, capsys: Capture, options: list[str], says: str
) -> None:
    code, out, err = _stream(here, capsys, *options)
    assert (code, out) == (2, "")
    assert says in err
    with pytest.raises(InputError):
        Options(max_gap=-1.0)


def test_names_with_odd_signs_go_through_a_journal(here: Path) -> None:
    """Of sensors and processes, through a session's bytes and back."""
    text = SCENARIO.replace("[sensors.fix]", '[sensors."fix.a+b-\\u00e9"]')
    text = text.replace("[processes.motion]", '[processes."0.u.z"]')
    scenario = load_scenario(write_scenario(here, text))
    lines = lines_of(scenario)
    session = session_of(scenario, lines[0])
    begun = feed(session, lines[:30], end=False)
    resumed = session_of(scenario, lines[0])
    resumed.load(session.save())
    whole = feed(session_of(scenario, lines[0]), lines)
    assert begun + feed(resumed, lines[30:]) == whole
