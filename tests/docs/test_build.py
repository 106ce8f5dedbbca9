"""The documentation is built offline, with warnings as errors, and asks for nothing outside."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
NEEDED = ("sphinx", "furo", "myst_nb", "sphinx_design", "sphinx_click", "ipykernel")
MISSING = [name for name in NEEDED if importlib.util.find_spec(name) is None]


def _built(out: Path) -> Path:
    """The built pages. Notebooks are run, and what they raise fails the build."""
    # No proxy leads anywhere: a build that asks for something outside fails, and says so.
    nowhere = dict.fromkeys(("http_proxy", "https_proxy", "all_proxy"), "http://127.0.0.1:9")
    options = ["-W", "--keep-going", "-q", "-b", "html", "-d", str(out / "doctrees")]
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", *options, str(DOCS), str(out / "html")],
        env={**os.environ, **nowhere},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return out / "html"


class _Fetched(HTMLParser):
    """What a browser fetches to show a page, and the anchors of links."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.fetched += [given[name] for name in ("src", "srcset", "poster") if name in given]
        if tag == "link" and given.get("rel") in ("stylesheet", "icon", "preload", "preconnect"):
            self.fetched.append(given.get("href", ""))


def _fetch_nothing_from_outside(pages: Path) -> None:
    found = {page: _Fetched(page.read_text("utf-8")).fetched for page in pages.rglob("*.html")}
    assert len(found) > 30
    assert sum(map(len, found.values())) > 100  # else nothing was looked at
    for page, addresses in found.items():
        outside = [one for one in addresses if re.match(r"(https?:)?//", one)]
        assert not outside, page.name
    for sheet in pages.rglob("*.css"):
        text = sheet.read_text("utf-8")
        assert not re.search(r"@import|url\(\s*['\"]?(https?:)?//", text), sheet.name


def _formulas_have_their_program(pages: Path) -> None:
    page = pages / "explanation" / "consistency.html"
    assert "../_static/mathjax-tex-svg.js" in page.read_text("utf-8")
    assert (pages / "_static" / "mathjax-tex-svg.js").stat().st_size > 1e6
    assert "Apache License" in (pages / "_static" / "mathjax-LICENSE.txt").read_text("utf-8")


def _notebooks_were_run(pages: Path) -> None:
    page = (pages / "tutorials" / "first_pass.html").read_text("utf-8")
    assert page.count("cell_output") >= 6
    assert re.search(r"batch +0\.0\d+ m, said 0\.0\d+ m", page)
    assert "data:image/png" in page or "_images/" in page


def _reference_has_every_kind(pages: Path) -> None:
    from relnav_graph.registry import classes

    folder = pages / "reference" / "generated"
    text = "".join(page.read_text("utf-8") for page in folder.glob("*.html"))
    for group in ("models", "estimators", "truths"):
        for kind in classes(f"relnav_graph.{group}"):
            assert f'<span class="pre">{kind}</span>' in text, kind


@pytest.mark.skipif(bool(MISSING), reason=f"needs the extra docs: {', '.join(MISSING)}")
def test_the_documentation_builds_without_a_warning(tmp_path: Path) -> None:
    """One test, since one build serves all that is looked at."""
    pages = _built(tmp_path)
    _fetch_nothing_from_outside(pages)
    _formulas_have_their_program(pages)
    _notebooks_were_run(pages)
    _reference_has_every_kind(pages)


def test_every_format_and_command_is_named() -> None:
    from relnav_graph.cli.main import COMMANDS
    from relnav_graph.io import readers, writers
    from relnav_graph.registry import modules

    page = (DOCS / "howto" / "formats.md").read_text("utf-8")
    for group, own in (("readers", readers), ("writers", writers)):
        for name in modules(f"relnav_graph.{group}", own.__name__):
            assert f"`{name}`" in page, name
    text = "".join(one.read_text("utf-8") for one in DOCS.rglob("*.md"))
    for command in COMMANDS:
        assert f"relnav {command}" in text, command
