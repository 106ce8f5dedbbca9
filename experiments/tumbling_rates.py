"""How filters and graph cope with a tumble that nobody has announced.

Draws the target's rate from the prior, N(0, 3 deg/s) per axis, for a number of passes of
`zhang2015.toml` or another scenario, and prints each estimator's consistency (ANEES, 1 is right)
and error. A row `NAME_smoothed` is of the trajectory that the estimator ends with.

In `zhang2015` a filter that goes on from a batch over the first 100 s is, at the current epoch, as
good as the graph, which comes back to all epochs, and smoothed it is as good as the batch: what
filters lack there is a beginning, not relinearisation throughout. In `zhang2015_stress`, where the
chaser's own attitude is open for long, no estimate at the current epoch is consistent, nor is a
filter smoothed, whatever it began from: only what has relinearised the whole pass is.

Run it: ``python experiments/tumbling_rates.py [PASSES] [EPOCHS] [SCENARIO]``
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from relnav_graph.core.models import derived_quantities
from relnav_graph.runs.comparison import compare
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scoring.metrics import score, with_smoothed

ESTIMATORS = (
    *("ekf", "iekf", "ekf_batch_start", "iekf_batch_start", "ukf", "iukf"),
    *("isam2", "incremental", "rts", "batch"),
)


def main(passes: int = 16, epochs: int = 200, *, name: str = "zhang2015") -> dict[str, list[float]]:
    """ANEES of each estimator in each pass; infinite where it diverged."""
    rng = np.random.default_rng(5)
    found: dict[str, list[float]] = {}
    errors: dict[str, list[float]] = {}
    for seed in range(passes):
        rate = [f"{w} deg/s" for w in rng.normal(0, 3, 3)]
        settings = [f"time.epochs={epochs}", f"truth.target_rate={rate}"]
        scenario = load_scenario(Path(__file__).with_name(f"{name}.toml"), settings)
        made = compare(scenario, ESTIMATORS, seed=seed)
        truth, derived = made.truths[0], derived_quantities(scenario.layout)
        assert truth is not None
        for row, track in with_smoothed(made.tracks).items():
            result = score(track, truth, derived)
            found.setdefault(row, []).append(result.anees or np.inf)
            error = result.states["relative_attitude"].rmse
            errors.setdefault(row, []).append(np.inf if error is None else error)
    print(f"{'estimator':26} ANEES: median     worst   relative attitude, deg: median   worst")
    for row, values in found.items():
        e = errors[row]
        print(
            f"{row:26} {np.median(values):13.4g} {max(values):9.4g}"
            f" {np.median(e):31.3f} {max(e):7.3f}"
        )
    return found


if __name__ == "__main__":
    sizes, names = (int(text) for text in sys.argv[1:3]), sys.argv[3:4] or ["zhang2015"]
    main(*sizes, name=names[0])
