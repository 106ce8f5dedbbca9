"""The tumbling Astrobee: these estimators beside the original authors' own iSAM2.

Compares the target's rate vector, in chaser axes, with the simulation's truth at every
epoch, with the first half minute and without. How much of the authors' error is one of the
length of the vector alone is printed too; that does not depend on which axes it is in.

Run it: ``python experiments/astrobee_authors.py DATA [RUN]``, where RUN is a part of the
names of the files, for a folder that holds several runs.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.models import derived_quantities
from relnav_graph.io.readers import read_raw
from relnav_graph.io.readers.astrobee_tumble import authors_rate
from relnav_graph.runs.comparison import compare
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scoring.metrics import errors, with_smoothed

SCENARIO = Path(__file__).with_name("astrobee_tumble.toml")
SETTLED = 30.0  # s


def rms(e: Array, t: Array) -> tuple[float, float]:
    """Of vectors or numbers over all times and after `SETTLED`, deg/s."""
    squares = np.degrees(e) ** 2
    squares = squares.sum(axis=1) if squares.ndim == 2 else squares
    return float(np.sqrt(squares.mean())), float(np.sqrt(squares[t >= SETTLED].mean()))


def main(folder: Path, run: str = "") -> dict[str, tuple[float, float]]:
    """RMS errors of each estimator, deg/s: whole pass, and settled."""
    t, estimate, truth = authors_rate(folder, run)
    lengths = np.linalg.norm(estimate, axis=1) - np.linalg.norm(truth, axis=1)
    found = {"authors, vector": rms(estimate - truth, t), "authors, length only": rms(lengths, t)}
    scenario = load_scenario(SCENARIO, settings={})
    assert scenario.file.data is not None
    options = {**scenario.file.data.options, "run": run}
    recording = read_raw(scenario.file.data.reader, folder, options)
    assert recording.truth is not None
    derived = derived_quantities(scenario.layout)
    made = compare(scenario, ("iekf", "incremental", "batch"), seed=0, data=recording)
    for name, track in with_smoothed(made.tracks).items():
        rate = errors(track, recording.truth, derived)["target_rate"]
        found[name] = rms(rate.e, rate.t)
    print("rate of the target, deg/s RMS    whole pass    after 30 s")
    for name, (whole, settled) in found.items():
        print(f"{name:30} {whole:12.3f} {settled:13.3f}")
    return found


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:3])
