"""The commands of the README and the documentation as they stand, and what they print.

``python docs/run_blocks.py [PAGE ...]`` runs every block of code of some pages, or of all, at full
size, in an empty folder for each page, and stores what commands print in docs/outputs/, a file for
each page. Where numbers of a page's tables are not among what is stored, the tests fail. It is a
step of a release, and takes an hour or two; the tests run the same blocks at reduced size.

Blocks on recorded data (``<!-- data: NAME -->`` before them) read them below RELNAV_DATA in the
place of DIR. What only makes an environment (pip, pytest) is left out: CI does that.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from contextlib import chdir
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from types import CodeType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
OUTPUTS = ROOT / "docs" / "outputs"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PAGES = [p for p in PAGES if not {"_build", "generated"} & set(p.parts)]
#: Languages of blocks that run. Code cells are of notebooks, which each build runs as well.
PYTHON = {"python", "{code-cell} ipython3"}
RUN = PYTHON | {"console", "bash", "toml"}
#: What a clean environment does.
ELSEWHERE = ("pip ", "ruff ", "mypy", "lint-imports", "pytest", "sphinx-build ")
#: Fence, language, body, with the comment that may stand before.
_BLOCK = re.compile(
    r"(?:<!-- (?P<key>not run|file|data): (?P<value>[^>]+?) -->\n)?"
    r"^```(?P<language>[^\n`]*)\n(?P<body>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
#: Of output that is kept: characters of a line, and lines of a command, of which the schema of
#: scenarios, which is a file of its own, has 13,000.
WIDTH, LINES = 400, 1000


@dataclass(frozen=True)
class Block:
    """A block of code, where it begins, and what the comment before it says.

    why: it is not run; file: it is written to; data: the recorded data that it reads.
    """

    page: Path
    line: int
    language: str
    body: str
    why: str | None = None
    file: str | None = None
    data: str | None = None

    def __str__(self) -> str:
        return f"{name_of(self.page)}:{self.line}"

    @property
    def commands(self) -> list[str]:
        """The commands of a console, continued lines joined."""
        lines = self.body.replace("\\\n", " ").splitlines()
        return [" ".join(line.split()) for line in lines if line.strip(" ") and line[0] != "#"]


def name_of(page: Path) -> str:
    """Of a page, relative to the root of the sources."""
    return str(page.relative_to(ROOT)) if page.is_relative_to(ROOT) else page.name


def blocks(page: Path) -> list[Block]:
    """All blocks of code of a page."""
    text = page.read_text("utf-8")
    keys = {"not run": "why", "file": "file", "data": "data"}
    return [
        Block(
            page,
            text[: m.start("body")].count("\n") + 1,
            m["language"].strip(),
            m["body"],
            **({keys[m["key"]]: m["value"]} if m["key"] else {}),
        )
        for m in _BLOCK.finditer(text)
    ]


def to_run(page: Path) -> list[Block]:
    """The blocks of a page that run."""
    return [block for block in blocks(page) if block.language in RUN and block.why is None]


def stored(page: Path) -> Path:
    """Where what a page's commands print is stored."""
    return OUTPUTS / f"{name_of(page).removeprefix('docs/').removesuffix('.md')}.txt"


def full_size(block: Block) -> list[str]:
    """The commands of a block that are run at full size: those that make no environment."""
    if block.language not in ("console", "bash"):
        return []
    parts = [[part.strip() for part in one.split(" && ")] for one in block.commands]
    kept = [[part for part in one if not f"{part} ".startswith(ELSEWHERE)] for one in parts]
    return [" && ".join(one) for one in kept if one]


def compiled(block: Block) -> CodeType:
    """The code of a block, with the lines of its page."""
    return compile("\n" * block.line + block.body, str(block), "exec", dont_inherit=True)


def _printed(command: str, data: str | None) -> str:
    """What a command prints on both streams; ends the program where it fails.

    3, an estimate that says it is degraded, is an answer like any other.
    """
    folder = os.environ.get("RELNAV_DATA", "")
    if data is not None:
        command = re.sub(r"\bDIR\b", str(Path(folder) / data), command)
    binaries = Path(sys.executable).parent
    done = subprocess.run(
        ["bash", "-o", "pipefail", "-c", command],
        env={**os.environ, "PATH": f"{binaries}:{os.environ['PATH']}", "COLUMNS": "160"},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        check=False,
    )
    if done.returncode not in (0, 3):
        raise SystemExit(f"{command}\n{done.stdout[-2000:]}\nexit code {done.returncode}")
    text = done.stdout
    for path in filter(None, (folder, str(ROOT), str(Path.cwd()))):
        text = text.replace(f"{path}/", "")
    lines = [line[:WIDTH].rstrip() for line in text.splitlines()]
    left = len(lines) - LINES
    return "\n".join(lines[:LINES] + ([f"... ({left} lines more)"] if left > 0 else []))


def run(page: Path) -> str:
    """Run a page's blocks one after the other; what its commands print."""
    out: list[str] = []
    names: dict[str, Any] = {"__name__": "page"}
    with TemporaryDirectory() as folder, chdir(folder):
        (Path(folder) / "experiments").symlink_to(ROOT / "experiments")
        for block in to_run(page):
            if block.file is not None:
                Path(block.file).write_text(block.body, "utf-8")
            if block.language in PYTHON:
                exec(compiled(block), names)
            for command in full_size(block):
                begin = time.monotonic()
                out += [f"$ {command}", _printed(command, block.data), ""]
                print(f"{block}: {command}: {time.monotonic() - begin:.0f} s", flush=True)
    return "\n".join(out)


def main(names: list[str]) -> None:
    """Run some pages, by their path, or all of them."""
    chosen = [p for p in PAGES if not names or name_of(p) in names]
    missing = set(names) - {name_of(page) for page in chosen}
    if missing:
        raise SystemExit(f"no page {sorted(missing)}; there are {[name_of(p) for p in PAGES]}")
    for page in chosen:
        if any(block.data for block in to_run(page)) and not os.environ.get("RELNAV_DATA"):
            print(f"{name_of(page)}: RELNAV_DATA does not name the recorded data; left as it is")
        elif text := run(page):
            stored(page).parent.mkdir(parents=True, exist_ok=True)
            stored(page).write_text(text, "utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
