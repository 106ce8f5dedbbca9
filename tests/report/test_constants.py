"""The report's table of constants."""

from __future__ import annotations

from dataclasses import replace

from static_tracks import filtered, smoothed, truth_of_statics

from relnav_graph.report import cells
from relnav_graph.scoring.metrics import summary


def test_constants_have_a_table_of_their_own() -> None:
    found = summary("s", 0, [filtered(), smoothed()], truth_of_statics(), [], None, 40)
    table = cells.constants(found)
    assert table is not None
    rows = [[c.text for c in row] for row in table.rows]
    assert [row[0] for row in rows] == [
        *("mounting [deg]", "ekf", "batch"),
        *("lever arm [cm]", "ekf", "batch"),
        *("all of them, jointly", "ekf", "batch"),
    ]
    assert all(len(row) in (1, len(table.head)) for row in rows)
    value = found["estimators"]["batch"]["statics"]["mounting"]["rmse"]
    assert rows[2][2] == cells.number(value)
    moving = [row[0].text for t in cells.results(found).values() for row in t.rows]
    assert "relative position [m]" in moving
    assert "mounting [deg]" not in moving


def test_without_constants_there_is_no_such_table() -> None:
    track = replace(filtered(), statics=None)
    assert cells.constants(summary("s", 0, [track], truth_of_statics(), [], None, 40)) is None
