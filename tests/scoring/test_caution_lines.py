"""Cautions in a table: each is said once, with the names of all of whom it is."""

from __future__ import annotations

import dataclasses
import json

from passes import ZHANG

from relnav_graph.core.cautions import Caution
from relnav_graph.runs.comparison import compare
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scoring.metrics import summary, table
from relnav_graph.scoring.text import caution_lines


def test_what_is_said_of_several_is_said_once() -> None:
    """Of a bent posterior, which the reference has found and its filters bear too."""
    found = compare(load_scenario(ZHANG, ["time.epochs=60"]), ["ekf", "iekf", "batch"], seed=1)
    bent, own = Caution("bent posterior", "of old: far"), Caution("gap", "bridged")
    tracks = [
        dataclasses.replace(t, cautions=(bent,) if t.name == "batch" else (own,))
        for t in found.tracks
    ]
    said = summary("a pass", 1, tracks, None, [], None, 60, [Caution("gap", "bridged")])
    before = json.dumps(said)
    of = [(c["estimator"], c["text"]) for c in said["cautions"] if c["name"] == bent.name]
    assert of == [(n, f"of batch: {bent.text}") for n in ("ekf", "iekf")] + [("batch", bent.text)]
    assert caution_lines(said)[:2] == [
        "the pass, ekf, iekf: gap: bridged",
        "ekf, iekf, batch: bent posterior: of old: far",
    ]
    text = table(said)
    assert text.count("caution: ekf, iekf, batch: bent posterior: of old: far\n") == 1
    assert text.count("bent posterior") == 1
    assert json.dumps(said) == before
