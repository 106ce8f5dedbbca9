"""How filter and graph cope with a tumble that nobody has announced.

Draws the target's rate from the prior, N(0, 3 deg/s) per axis, for a number of passes of
`zhang2015.toml`, and prints each estimator's consistency (ANEES, 1 is right) and error.
A filter linearises each measurement once, at what it believed then; the graph comes back to
it. That is the difference at the *current* epoch, where smoothing as such gains nothing.

Run it: ``python experiments/tumbling_rates.py [PASSES] [EPOCHS]``
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from relnav_graph.core.models import derived_quantities
from relnav_graph.runs.comparison import compare
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scoring.metrics import score, with_smoothed

SCENARIO = Path(__file__).with_name("zhang2015.toml")


def main(passes: int = 16, epochs: int = 200) -> dict[str, list[float]]:
    """ANEES of each estimator in each pass."""
    rng = np.random.default_rng(5)
    found: dict[str, list[float]] = {}
    errors: dict[str, list[float]] = {}
    for seed in range(passes):
        rate = [f"{w} deg/s" for w in rng.normal(0, 3, 3)]
        scenario = load_scenario(SCENARIO, [f"time.epochs={epochs}", f"truth.target_rate={rate}"])
        made = compare(scenario, ("iekf", "incremental", "batch"), seed=seed)
        truth, derived = made.truths[0], derived_quantities(scenario.layout)
        assert truth is not None
        for name, track in with_smoothed(made.tracks).items():
            result = score(track, truth, derived)
            found.setdefault(name, []).append(result.anees or np.inf)
            error = result.states["relative_attitude"].rmse
            errors.setdefault(name, []).append(np.inf if error is None else error)
    print("estimator        ANEES median     worst   relative attitude, deg: median  worst")
    for name, values in found.items():
        e = errors[name]
        print(
            f"{name:15} {np.median(values):13.2f} {max(values):9.2f}"
            f" {np.median(e):31.3f} {max(e):6.3f}"
        )
    return found


if __name__ == "__main__":
    main(*(int(text) for text in sys.argv[1:3]))
