"""GRACE: what the K-band range tells of the relative position, axis by axis, against the orbits.

Smooths the pass of grace_kbr.toml and that of grace_kbr_fixes.toml, which has no range, and
compares both with the precise orbits, over all of the pass and over the part that is scored: the
distance, about the mean of its error, and the relative position radially, along the track and
across it. Of the range: how far its constant and its wander are from what range and orbits say, in
sigmas.

Run it: ``python experiments/ranging_axes.py DATA [--seed 0] [--set KEY=VALUE] [--json]``.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.track import Track, Truth
from relnav_graph.estimators import run_estimator
from relnav_graph.runs.passes import open_pass

HERE = Path(__file__).parent
CASES = {"with the range": "grace_kbr.toml", "without": "grace_kbr_fixes.toml"}
AXES = ("radial_m", "along_m", "across_m")


def axes(truth: Truth) -> Array:
    """Unit vectors (N, 3, 3) in i, in rows: radial, along the track and across it."""
    r, v = truth.values["chaser_position"], truth.values["chaser_velocity"]
    radial, across = r / np.linalg.norm(r, axis=1)[:, None], np.cross(r, v)
    across = across / np.linalg.norm(across, axis=1)[:, None]
    return np.stack([radial, np.cross(across, radial), across], axis=1)


def scores(track: Track, truth: Truth, part: slice) -> dict[str, float]:
    """RMS errors over a part of the epochs; deviations of the range's biases, in sigmas."""
    r, true = track.value("relative_position"), truth.values["relative_position"]
    off = (np.linalg.norm(r, axis=1) - np.linalg.norm(true, axis=1))[part]
    per_axis = np.einsum("nij,nj->ni", axes(truth), r - true)[part]
    found = {
        "distance_about_mean_mm": 1e3 * float(off.std()),
        "distance_mean_mm": 1e3 * float(off.mean()),
        **{name: float(np.sqrt((e**2).mean())) for name, e in zip(AXES, per_axis.T, strict=True)},
    }
    for name in ("range_bias", "range_drift"):
        if any(b.name == name for b in track.blocks):
            e = (track.value(name) - truth.values[name])[part, 0]
            sigmas = np.abs(e) / np.sqrt(track.covariance(name)[part, 0, 0])
            found[f"{name}_rms_sigmas"] = float(np.sqrt((sigmas**2).mean()))
            found[f"{name}_inside_3_sigma"] = float((sigmas < 3).mean())
    return found


def main(
    folder: Path, seed: int = 0, settings: tuple[str, ...] = ()
) -> dict[str, dict[str, dict[str, float]]]:
    """By case and part of the pass, what `scores` gives."""
    found = {}
    for case, file in CASES.items():
        opened = open_pass(HERE / file, seed, folder, settings)
        truth = opened.recording.truth
        assert truth is not None
        track = run_estimator("rts", opened.problem)
        low, high = opened.scenario.window(truth.t) or (0.0, 1.0)
        count = len(truth.t)
        part = slice(round(low * (count - 1)), round(high * (count - 1)) + 1)
        parts = {"whole pass": slice(None), "scored part": part}
        found[case] = {name: scores(track, truth, one) for name, one in parts.items()}
    return found


def _print(found: dict[str, dict[str, dict[str, float]]]) -> None:
    for case, parts in found.items():
        for part, row in parts.items():
            print(f"{case}, {part}")
            for name, value in row.items():
                print(f"    {name:28} {value:9.3f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--json", action="store_true")
    given: Any = parser.parse_args()
    result = main(given.folder, given.seed, tuple(given.set))
    print(json.dumps(result, indent=2)) if given.json else _print(result)
