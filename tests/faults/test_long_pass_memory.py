"""Row 31: a batch of 100,000 epochs in a thread with a stack of 1 MiB."""

from __future__ import annotations

import threading

import numpy as np
from passes import FIX, PROCESSES

from relnav_graph.core.epochs import Epoch
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.core.track import Track
from relnav_graph.estimators import run_estimator

COUNT = 100_000


def test_row_31_a_batch_of_100000_epochs_on_a_stack_of_1_mib() -> None:
    """It completes: nothing recurses along the pass."""
    ids, rng = np.zeros(1, dtype=np.int64), np.random.default_rng(2)
    z = 0.1 * rng.standard_normal((COUNT, 1, 3))
    inputs = {"motion": np.ones((1, 1))}
    epochs = tuple(
        Epoch(float(k), (Measurement("fix", float(k), z[k], ids),), inputs if k else {})
        for k in range(COUNT)
    )
    processes, prior = {"motion": PROCESSES["motion"]}, Prior(np.zeros(6), np.eye(6))
    problem = Problem(processes, {"fix": FIX}, prior, epochs)
    tracks: list[Track] = []
    size = threading.stack_size(1 << 20)
    try:
        thread = threading.Thread(target=lambda: tracks.append(run_estimator("batch", problem)))
        thread.start()
    finally:
        threading.stack_size(size)
    thread.join()
    (track,) = tracks
    assert (track.status, len(track.t)) == ("ok", COUNT)
    # In the middle the estimate has forgotten the ends: one sigma everywhere. And it is no
    # further from the truth, which stands still, than it says.
    middle = slice(1000, COUNT - 1000)
    P = track.covariance("relative_position")[middle]
    assert np.abs(P - P[0]).max() < 1e-6 * P.max()
    assert (track.value("relative_position")[middle] ** 2).mean() < P[0, 0, 0]
