"""Whether `relnav tune` finds a noise that is declared wrong, and leaves right ones as they are.

Passes of `zhang2015_close`, with the gyro's angle random walk declared as it is, three times too
small and three times too large. Prints, of each case, the median over the passes of found over
true, and in how many cases the true value of a noise that was told lies in its 95 % interval.

Run it: ``python experiments/tune_check.py [PASSES] [EPOCHS] [JOBS]``
"""

from __future__ import annotations

import sys
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from relnav_graph.runs.passes import open_pass
from relnav_graph.study.tune import tune

#: What is declared wrong, and the value that is true.
NOISE, TRUE = "processes.chaser.angle_random_walk_density", 3.16227766e-5
WRONG = (1.0, 1 / 3, 3.0)


def found(case: tuple[int, float, int]) -> dict[str, Any]:
    """By noise that was told, what the true value is in parts of the one found, and of both ends
    of its interval: (3,)."""
    seed, wrong, epochs = case
    settings = [f"time.epochs={epochs}", f'{NOISE}="{wrong * TRUE} rad/sqrt(s)"']
    path = Path(__file__).with_name("zhang2015_close.toml")
    rows = tune(open_pass(path, seed, assignments=settings))["noises"]
    print(f"seed {seed}, declared {wrong:.3g} times", file=sys.stderr, flush=True)
    return {
        name: np.array([row["factor"], *row["factor_ci"]]) * (wrong if name == NOISE else 1.0)
        for name, row in rows.items()
        if row["told"]
    }


def main(passes: int = 20, epochs: int = 1000, jobs: int = 1) -> dict[float, dict[str, float]]:
    """By factor of what is declared over the truth: median of found over true of the gyro's noise,
    and the part of all intervals that hold the truth."""
    cases = [(seed, wrong, epochs) for wrong, seed in product(WRONG, range(passes))]
    if jobs == 1:
        rows = [found(case) for case in cases]
    else:
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
            rows = list(pool.map(found, cases))
    out = {}
    print("declared / true   found / true (median)   told   in their 95 % intervals")
    for k, wrong in enumerate(WRONG):
        own = rows[k * passes : (k + 1) * passes]
        gyro = [row[NOISE][0] for row in own if NOISE in row]
        inside = [low <= 1 <= high for row in own for _, low, high in row.values()]
        held, told = float(np.mean(inside)), len(gyro)
        out[wrong] = {"median": float(np.median(gyro)), "inside": held, "told": told}
        text = f"{wrong:15.3f} {out[wrong]['median']:23.3f} {told:6d} {held:12.1%} of {len(inside)}"
        print(text)
    return out


if __name__ == "__main__":
    main(*(int(text) for text in sys.argv[1:4]))
