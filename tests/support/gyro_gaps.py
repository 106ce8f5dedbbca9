"""A short pass of zhang2015, and its lines with gaps in the gyro."""

from __future__ import annotations

import json
from collections.abc import Sequence

from passes import ZHANG
from streams import changed, lines_of

from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.scenario import Scenario

EPOCHS, SEED = 20, 7


def scenario_of(*settings: str) -> Scenario:
    return load_scenario(ZHANG, [f"time.epochs={EPOCHS}", f"seed={SEED}", *settings])


def lines_of_gap(gone: Sequence[int]) -> list[str]:
    starts = [10.0 * k for k in gone]
    return [
        changed(line)
        for line in lines_of(scenario_of(), SEED)
        if json.loads(line).get("t_start") not in starts
    ]
