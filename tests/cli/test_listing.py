"""`relnav list NAME`: formats with their options, and the keys of a scenario file."""

from __future__ import annotations

import pytest
from passes import relnav

from relnav_graph.core import models
from relnav_graph.core.contracts import Dynamics
from relnav_graph.io import readers, writers
from relnav_graph.registry import classes, provides
from relnav_graph.runs.described import _blocks_of
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
    assert "tabel: no such folder, kind, state or format; is it table?" in err


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


def test_a_state_is_described_with_the_models_that_have_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    code, out, _ = relnav(capsys, "list", "inertia_parameters")
    assert code == 0
    assert "k_t: 2 numbers, without a unit, frame t" in out
    rows = dict(line.strip().split("  ", 1) for line in out.splitlines() if line.startswith("  "))
    assert rows["advanced by"].strip() == "none by default: a constant then"
    assert {"euler_rotation", "inertia_ratios"} <= {*rows["read by"].strip().split(", ")}
    _, out, _ = relnav(capsys, "list", "relative_position")
    for own in ("r_tc_o: 3 numbers, in m, frame o", "r_tc_t: 3 numbers, in m, frame t"):
        assert own in out
    assert out.count("eccentric_relative_motion") == 1  # of r_tc_o alone
    assert out.count("white_noise_acceleration") == 2  # of either, as one word says
    _, out, _ = relnav(capsys, "list", "chaser_attitude")
    assert "R_oc: an attitude (SO3), 3 axes, in rad, frame oc" in out
    assert "orbit_radius, a state" in relnav(capsys, "list", "orbit_radius")[1]


def test_a_name_that_is_a_kind_and_a_state_is_described_as_both(
    capsys: pytest.CaptureFixture[str],
) -> None:
    _, out, _ = relnav(capsys, "list", "gyro_bias")
    assert "angle_random_walk_density" in out
    assert "gyro_bias, a state" in out


def test_every_state_of_the_models_is_known() -> None:
    """None is left out because its model cannot tell without parameters."""
    found = classes(models.ENTRY_POINTS)
    silent = {
        kind
        for kind, cls in found.items()
        if provides(cls, Dynamics)
        if not _blocks_of(cls, "advances")
    }
    assert silent <= {"pose_copy"}
