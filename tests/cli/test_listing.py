"""`relnav list NAME`: formats with their options, and the keys of a scenario file."""

from __future__ import annotations

import pytest
from passes import relnav

from relnav_graph.io import readers, writers
from relnav_graph.scenario.json_schema import json_schema
from relnav_graph.scenario.keys import tables


@pytest.mark.parametrize("name", sorted({*readers.readers(), *writers.writers()}))
def test_a_format_is_described_with_all_its_options(
    capsys: pytest.CaptureFixture[str], name: str
) -> None:
    code, out, _ = relnav(capsys, "list", name)
    assert code == 0
    for what, module in (("reader", readers), ("writer", writers)):
        there = name in (module.readers() if module is readers else module.writers())
        assert (f"{name}, a {what}\n" in out) == there
        if there:
            for option in module.options_of(name):
                assert f"\n  {option} " in out
    assert "known" not in [line.split()[0] for line in out.splitlines() if line.strip()]


def test_what_a_docstring_points_at_is_shown_too(capsys: pytest.CaptureFixture[str]) -> None:
    _, tum, _ = relnav(capsys, "list", "tum")
    assert "\nrelnav_graph.io.declared\n" in tum
    assert '"gps", since 1980-01-06' in tum
    assert "\nrelnav_graph.io.poses\n" in tum  # at which that points
    _, table, _ = relnav(capsys, "list", "table")
    assert "`unit`, ns, us, ms" in table


def test_readers_and_writers_have_a_line_each(capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = relnav(capsys, "list")
    lines = [line.split(maxsplit=1) for line in out.splitlines() if line.startswith("  ")]
    said = {words[0] for words in lines if len(words) > 1}
    assert {*readers.readers(), *writers.writers()} <= said


def test_a_word_that_is_nothing_gets_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = relnav(capsys, "list", "tabel")
    assert code == 2
    assert "tabel: no such folder, kind or format; is it table?" in err


def test_the_keys_of_a_scenario_file_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = relnav(capsys, "list", "scenario")
    top, *others = tables()
    assert [key.name for key in top.keys] == [*json_schema()["properties"]]
    assert all(key.text for key in top.keys)
    for table in (top, *others):
        assert f"\n{table.name}\n" in f"\n{out}"
        for key in table.keys:
            assert f"\n    {key.name} " in out
    assert "gate" in {key.name for key in others[-1].keys}
