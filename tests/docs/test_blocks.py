"""Every block of code in the README and the documentation runs.

Python blocks of a page share their names, in order, as a reader would type them. Commands `relnav`
run at reduced size, those of a pipe in processes of their own; other scripts do in their own tests.
A block that cannot run says why in a comment before it, ``<!-- not run: why -->``; one that is a
file is written, ``<!-- file: my.toml -->``; one on recorded data names them, ``<!-- data: NAME
-->``. At full size all run by `docs/run_blocks.py`, which stores what they print.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from passes import recorded
from scripts import loaded

from relnav_graph.cli.main import main

ROOT = Path(__file__).parents[2]
#: Commands whose pass may be shortened, and to how many epochs.
SHORT = {"compare", "simulate", "stream", "study", "explain", "calibrate", "tune", "smooth"}
EPOCHS = 5
MORE = {"closures": 250}  # its loops close late
#: Of recorded passes that are long.
PART = {"starry_night": ["--set", "data.options.frames=[131,260]", "--set", "evaluate=[0,1]"]}


docs = loaded(ROOT / "docs" / "run_blocks.py")
#: What a test does not run: environments, and scripts that have tests of their own.
ELSEWHERE = (*docs.ELSEWHERE, "python ")


def words_of(block: Any) -> list[list[str]]:
    """The lines of a console block as words, without comments."""
    found: list[list[str]] = []
    for line in block.commands:
        lexer = shlex.shlex(line, posix=True, punctuation_chars="|&")
        lexer.whitespace_split, lexer.commenters = True, "#"
        words = list(lexer)
        if words:
            found.append(words)
    return found


def shortened(words: list[str]) -> list[str]:
    """A command of relnav with few epochs, where it makes any."""
    if words[1] not in SHORT:
        return words
    if words[1] in ("study", "compare") and "-e" not in words:
        words = [*words, "-e", "ekf", *(["-e", "batch"] if words[1] == "compare" else [])]
    if words[1] == "study" and "--runs" in words:
        words[words.index("--runs") + 1] = "2"
        words = [*words, "--jobs", "1"]
    if words[1] in ("compare", "smooth") and "--figures" not in words:
        words = [*words, "--figures", "none"]
    recorded = words[1] == "smooth" or "--data" in words  # as many epochs as the data have
    return words if recorded else [*words, "--set", f"time.epochs={MORE.get(words[2], EPOCHS)}"]


def _here(words: list[str]) -> int:
    """Run a command of relnav in this process; its exit code."""
    try:
        main(words[1:])
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def _piped(parts: list[list[str]]) -> int:
    """Run commands that read what the one before has written; the worst exit code."""
    given, codes = b"", [0]
    for words in parts:
        command = [sys.executable, "-m", "relnav_graph", *words[1:]]
        done = subprocess.run(command, input=given, capture_output=True, check=False)
        given = done.stdout
        codes.append(done.returncode)
    assert given, shlex.join(parts[-1])
    return max(codes)


def run_console(block: Any) -> None:
    """Run the commands of relnav in a block. Exit code 3 is an estimate that says it is degraded:
    it had so few epochs. What a page makes of data of one's own is to be sound."""
    for words in words_of(block):
        if block.data is not None:
            words = [str(recorded(block.data)) if word == "DIR" else word for word in words]
            words += PART.get(block.data, [])
        parts = []
        for part in _split(words):
            if part[0] == "relnav":
                parts.append(shortened(part))
            else:
                assert f"{part[0]} ".startswith(ELSEWHERE), part
        for together in [parts] if "|" in words else [[part] for part in parts]:
            code = _piped(together) if len(together) > 1 else _here(together[0])
            good = (0,) if "my_data" in together[-1] else (0, 3)
            assert code in good, f"{shlex.join(together[-1])}: exit code {code}"


def _split(words: list[str]) -> list[list[str]]:
    parts: list[list[str]] = [[]]
    for word in words:
        if word in ("|", "&&"):
            parts.append([])
        else:
            parts[-1].append(word)
    return parts


@pytest.mark.parametrize("page", [p for p in docs.PAGES if docs.to_run(p)], ids=docs.name_of)
def test_blocks_of_a_page_run(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "experiments").symlink_to(ROOT / "experiments")
    names: dict[str, Any] = {"__name__": "page"}
    for block in docs.to_run(page):
        try:
            if block.file is not None:
                Path(block.file).write_text(block.body, "utf-8")
            if block.language == "toml":
                tomllib.loads(block.body)
            elif block.language in docs.PYTHON:
                exec(docs.compiled(block), names)
            else:
                run_console(block)
        except Exception as error:
            error.add_note(str(block))
            raise


def test_no_code_hides_in_another_language() -> None:
    """A block of code has one of the languages that run; commands do not stand in plain blocks."""
    plain = {"", "text", "json"}
    for page in docs.PAGES:
        for block in docs.blocks(page):
            directive = block.language.startswith("{")
            assert directive or block.language in docs.RUN | plain, f"{block}: {block.language!r}"
            if block.language in plain:
                assert not re.match(r"(relnav|python|pip|import|from) ", block.body), str(block)
            if block.why is not None:
                assert block.language in docs.RUN, str(block)


def test_the_runner_runs_what_it_reads(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "# A\n\n```python\nx = 1\n```\n\n<!-- not run: long -->\n```console\nrelnav nothing\n```\n"
    )
    one, two = docs.blocks(page)
    assert (one.language, one.line, one.why) == ("python", 4, None)
    assert two.why == "long"
    body = "relnav study a --runs 50 -e batch  # many\nrelnav simulate a -o - | relnav stream a\n"
    study, piped = words_of(docs.Block(page, 1, "console", body))
    assert shortened(study)[2:5] == ["a", "--runs", "2"]
    assert [part[1] for part in _split(piped)] == ["simulate", "stream"]
    with pytest.raises(AssertionError, match="exit code 2"):
        run_console(docs.Block(page, 1, "console", "relnav validate no_such_scenario"))
