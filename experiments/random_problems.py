#!/usr/bin/env python3
"""How often an estimate is wrong, says ok, and is given no caution: random variants of zhang2015.

    random_problems.py SEED COUNT [-e KIND ...]

3 to 12 beacons of 0.3 to 3 m spread, 3 m to 10 km away, eccentricities up to 0.7, steps of 0.1 to
20 s, 40 to 200 epochs, lines of sight of 0.2 arcsec to 0.2 deg, tumbles of 0.001 to 5 deg/s (less
than a quarter turn a step), priors from tight to wide. An estimate is wrong where its normalised
squared error, over all states and the last three quarters of the pass, is more than 5 times the
number of states; right where it is less than twice that. A line for each problem that took an
exception, or more than a minute, or was wrong without a word.
"""

from __future__ import annotations

import argparse
import json
import logging
import time
from collections import Counter
from pathlib import Path

import numpy as np

from relnav_graph import Track
from relnav_graph.arrays import Array
from relnav_graph.core.track import Truth
from relnav_graph.runs.comparison import compare_pass
from relnav_graph.runs.passes import open_pass
from relnav_graph.scoring.metrics import with_smoothed

ZHANG = Path(__file__).parent / "zhang2015.toml"
WRONG, RIGHT, SLOW = 5.0, 2.0, 60.0


def _quantities(values: Array, unit: str) -> str:
    return json.dumps([f"{v} {unit}" for v in values])


def variant(rng: np.random.Generator) -> list[str]:
    """Settings of one problem, as "key=value" assignments."""
    while True:
        beacons, distance = int(rng.integers(3, 13)), 10 ** rng.uniform(0.5, 4)
        e, step = float(rng.choice([0, 1e-3, 0.05, 0.3, 0.7])), 10 ** rng.uniform(-1, 1.3)
        sigma, rate = 10 ** rng.uniform(-5.5, -2.5), 10 ** rng.uniform(-3, 0.7)
        epochs, size = int(rng.integers(40, 200)), rng.uniform(0.3, 3)
        points, line, w = rng.normal(0, size, (beacons, 3)), rng.normal(size=3), rng.normal(size=3)
        position = line / np.linalg.norm(line) * max(distance, 4 * size)
        velocity = rng.normal(0, 1e-4 * np.linalg.norm(position), 3)
        wide = 10 ** rng.uniform(-2, 0) * np.linalg.norm(position) * 0.05
        attitude = 10 ** rng.uniform(-1, 1)
        if rate * step <= 90:
            break
    w *= rate / np.linalg.norm(w)
    return [
        f'time.step="{step} s"',
        f"time.epochs={epochs}",
        f"orbit.eccentricity={e}",
        f'orbit.semi_major_axis="{7200 / (1 - e)} km"',
        f'sensors.beacons.sigma="{sigma} rad"',
        "sensors.beacons.points=" + json.dumps([[f"{v} m" for v in p] for p in points]),
        "truth.relative_position=" + _quantities(position, "m"),
        "truth.relative_velocity=" + _quantities(velocity, "m/s"),
        "truth.target_rate=" + _quantities(w, "deg/s"),
        f'inputs.gyro.period="{step} s"',
        f'prior.relative_position.sigma="{wide} m"',
        f'prior.target_rate.sigma="{max(rate, 1e-3)} deg/s"',
        f'prior.target_attitude.sigma="{attitude} deg"',
    ]


def error(track: Track, truth: Truth) -> float:
    """Mean normalised squared error per state over the last three quarters of a pass."""
    late = slice(len(track.t) // 4, None)
    rows, _ = truth.at(track.t[late])
    own = {b.name: truth.values[b.name][rows] for b in track.layout if b.name in truth.values}
    x = np.array(
        [
            track.layout.pack({**track.layout.values(at), **{n: v[k] for n, v in own.items()}})
            for k, at in enumerate(track.x[late])
        ]
    )
    columns = track.layout.gather([track.layout.block(n) for n in own])[1]
    d = track.layout.local(track.x[late], x)[:, columns]
    P = track.P[late][:, columns[:, None], columns]
    with np.errstate(over="ignore", invalid="ignore"):
        squares = np.einsum("ki,ki->k", d, np.linalg.solve(P, d[:, :, None])[:, :, 0])
    return float(squares.mean() / len(columns))


def main() -> None:
    """Draw, estimate, count."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("seed", type=int)
    parser.add_argument("count", type=int)
    parser.add_argument("-e", dest="kinds", action="append")
    options = parser.parse_args()
    kinds = options.kinds or ["iekf", "batch", "incremental"]
    rng, counts, slowest = np.random.default_rng(options.seed), dict[str, Counter[str]](), 0.0
    for number in range(options.count):
        settings, begun = variant(rng), time.process_time()
        logging.disable(logging.CRITICAL)
        try:
            opened = open_pass(ZHANG, assignments=settings)
            found = compare_pass(opened, kinds)
        except Exception as failure:
            print(f"{number}: {type(failure).__name__}: {failure}", flush=True)
            counts.setdefault("(exceptions)", Counter())["problems"] += 1
            continue
        finally:
            logging.disable(logging.NOTSET)
        took = time.process_time() - begun
        slowest = max(slowest, took)
        if took > SLOW:
            print(f"{number}: took {took:.0f} s", flush=True)
        truth = opened.recording.truth
        assert truth is not None
        for name, track in with_smoothed(found.tracks).items():
            count, said = counts.setdefault(name, Counter()), found.summary["estimators"][name]
            count["problems"] += 1
            if track.status != "ok":
                count["not ok"] += 1
                continue
            wrong, words = error(track, truth), [c["name"] for c in said["cautions"]]
            if wrong > WRONG:
                count["wrong, ok"] += 1
                if not words:
                    count["of these without a word"] += 1
                    print(f"{number}: {name}: {wrong:.3g}, ok, no caution", flush=True)
            elif wrong < RIGHT:
                count["right, ok"] += 1
                count["of these cautioned"] += bool(words)
    columns = (
        "problems",
        "not ok",
        "wrong, ok",
        "of these without a word",
        "right, ok",
        "of these cautioned",
    )
    print(f"{'estimator':<16}" + "".join(f"{c:>25}" for c in columns))
    for name, count in counts.items():
        print(f"{name:<16}" + "".join(f"{count[c]:>25}" for c in columns))
    print(f"slowest problem: {slowest:.1f} s")


if __name__ == "__main__":
    main()
