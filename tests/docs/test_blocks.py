"""Every block of code in the README and the documentation runs.

Python blocks of a page share their names, in order, as a reader would type them. Commands `relnav`
run at reduced size, those of a pipe in processes of their own. A block that cannot run says why in
a comment before it, ``<!-- not run: why -->``; one of TOML is read, and written where it says so,
``<!-- file: my.toml -->``.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from relnav_graph.cli.main import main

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PAGES = [p for p in PAGES if not {"_build", "generated"} & set(p.parts)]
#: Fence, language, body, with the comment that may stand before.
_BLOCK = re.compile(
    r"(?:<!-- not run: (?P<why>[^>]+?) -->\n|<!-- file: (?P<file>[^>]+?) -->\n)?"
    r"^```(?P<language>[^\n`]*)\n(?P<body>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
RUN = {"python", "console", "bash", "toml"}
#: Commands whose pass may be shortened, and to how many epochs.
SHORT = {"compare", "simulate", "stream", "study", "explain", "calibrate", "tune", "smooth"}
EPOCHS = 5
#: What a clean environment does, and a test does not.
ELSEWHERE = ("pip ", "python ", "ruff ", "mypy", "lint-imports", "pytest", "sphinx-build ")


@dataclass(frozen=True)
class Block:
    """A block of code, where it begins, why it is not run, and the file that it is."""

    page: Path
    line: int
    language: str
    body: str
    why: str | None
    file: str | None = None

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


def blocks(page: Path) -> list[Block]:
    text = page.read_text("utf-8")
    return [
        Block(
            page,
            text[: m.start("body")].count("\n") + 1,
            m["language"].strip(),
            m["body"],
            m["why"],
            m["file"],
        )
        for m in _BLOCK.finditer(text)
    ]


def _is_notebook(page: Path) -> bool:
    """Sphinx runs it at each build (`test_build`)."""
    return page.read_text("utf-8").startswith("---\nfile_format: mystnb")


def commands(body: str) -> list[list[str]]:
    """The lines of a console block as words, without comments."""
    found: list[list[str]] = []
    for line in body.replace("\\\n", " ").splitlines():
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
    if words[1] == "study" and "--runs" in words:
        words[words.index("--runs") + 1] = "2"
        words = [*words, "--jobs", "1"]
        words += [] if "-e" in words else ["-e", "iekf", "-e", "batch"]
    if words[1] in ("compare", "smooth") and "--figures" not in words:
        words = [*words, "--figures", "none"]
    recorded = words[1] == "smooth" or "--data" in words  # as many epochs as the data have
    return words if recorded else [*words, "--set", f"time.epochs={EPOCHS}"]


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


def run_console(block: Block) -> None:
    """Run the commands of relnav in a block. Exit code 3 is an estimate that says it is degraded:
    it had so few epochs. Recorded data have all of theirs."""
    for words in commands(block.body):
        parts = []
        for part in _split(words):
            if part[0] == "relnav":
                parts.append(shortened(part))
            else:
                assert any(f"{part[0]} ".startswith(one) for one in ELSEWHERE), part
        for together in [parts] if "|" in words else [[part] for part in parts]:
            code = _piped(together) if len(together) > 1 else _here(together[0])
            recorded = "--data" in together[-1] or together[-1][1:3] == ["smooth", "my_data"]
            good = (0,) if recorded else (0, 3)
            assert code in good, f"{shlex.join(together[-1])}: exit code {code}"


def _split(words: list[str]) -> list[list[str]]:
    parts: list[list[str]] = [[]]
    for word in words:
        if word in ("|", "&&"):
            parts.append([])
        else:
            parts[-1].append(word)
    return parts


def _to_run(page: Path) -> list[Block]:
    return [block for block in blocks(page) if block.language in RUN and block.why is None]


@pytest.mark.parametrize(
    "page", [p for p in PAGES if _to_run(p)], ids=lambda p: str(p.relative_to(ROOT))
)
def test_blocks_of_a_page_run(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "experiments").symlink_to(ROOT / "experiments")
    names: dict[str, Any] = {"__name__": "page"}
    for block in _to_run(page):
        try:
            if block.language == "toml":
                tomllib.loads(block.body)
                if block.file is not None:
                    Path(block.file).write_text(block.body, "utf-8")
            elif block.language != "python":
                run_console(block)
            elif not _is_notebook(page):
                exec(compile("\n" * block.line + block.body, str(block), "exec"), names)
        except Exception as error:
            error.add_note(str(block))
            raise


def test_no_code_hides_in_another_language() -> None:
    """A block of code has one of the languages that run; commands do not stand in plain blocks."""
    plain = {"", "text", "json"}
    for page in PAGES:
        for block in blocks(page):
            directive = block.language.startswith("{")
            assert directive or block.language in RUN | plain, f"{block}: {block.language!r}"
            if block.language in plain:
                assert not re.match(r"(relnav|python|pip|import|from) ", block.body), str(block)
            if block.why is not None:
                assert block.language in RUN, str(block)


def test_the_runner_runs_what_it_reads(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "# A\n\n```python\nx = 1\n```\n\n<!-- not run: long -->\n```console\nrelnav nothing\n```\n"
    )
    one, two = blocks(page)
    assert (one.language, one.line, one.why) == ("python", 4, None)
    assert two.why == "long"
    body = "relnav study a --runs 50 -e batch  # many\nrelnav simulate a -o - | relnav stream a\n"
    study, piped = commands(body)
    assert shortened(study)[2:5] == ["a", "--runs", "2"]
    assert [part[1] for part in _split(piped)] == ["simulate", "stream"]
    with pytest.raises(AssertionError, match="exit code 2"):
        run_console(Block(page, 1, "console", "relnav validate no_such_scenario", None))
