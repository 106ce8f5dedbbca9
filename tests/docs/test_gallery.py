"""The gallery has every scenario, and its pages are those that the command makes."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest
from passes import EXPERIMENTS
from scripts import loaded

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def gallery() -> ModuleType:
    return loaded(DOCS / "make_gallery.py")


def test_every_scenario_stands_in_one_group(gallery: ModuleType) -> None:
    named = [name for group in gallery.GROUPS.values() for name in group.scenarios]
    assert sorted(named) == sorted(path.stem for path in EXPERIMENTS.glob("*.toml"))


def test_pages_are_those_of_the_command(gallery: ModuleType) -> None:
    """But for the scores, which another machine rounds in another way."""
    readme = (EXPERIMENTS / "README.md").read_text("utf-8")
    assert (DOCS / "gallery" / "index.md").read_text("utf-8") == gallery.index()
    for key, group in gallery.GROUPS.items():
        stored = (DOCS / "gallery" / f"{key}.md").read_text("utf-8")
        table = stored.partition("-o out\n```\n\n")[2].partition("\n\n## ")[0]
        assert table.count("\n") >= 2, key
        assert stored == gallery.page(key, group, group.figures, table), key
        for section in group.sections:
            assert f"\n## {section}\n" in readme, section
        for name in group.figures:
            assert (DOCS / "gallery" / f"{key}_{name}.png").stat().st_size > 5000, (key, name)


def test_a_group_is_drawn(
    gallery: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from dataclasses import replace

    group = replace(gallery.GROUPS["hu2019"], settings=("time.epochs=12",))
    monkeypatch.setattr(gallery, "OUT", tmp_path)
    monkeypatch.setattr(gallery, "GROUPS", {"hu2019": group})
    gallery.main()
    page = (tmp_path / "hu2019.md").read_text("utf-8")
    assert "--set time.epochs=12" in page
    assert "| `batch` | smoothed |" in page
    assert (tmp_path / "hu2019_target_attitude.png").read_bytes()[:4] == b"\x89PNG"
    monkeypatch.delenv("RELNAV_DATA", raising=False)
    assert gallery.draw("starloc", replace(group, data="starloc")) is None
