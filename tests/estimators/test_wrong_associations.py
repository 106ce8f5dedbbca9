"""Points of a map that bear the wrong id now and then: what a gate makes of it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from passes import EXPERIMENTS

from relnav_graph import run_estimator
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.track import Track
from relnav_graph.io.results import read_results, write_results
from relnav_graph.runs.passes import Pass, open_pass
from relnav_graph.scoring.alignment import aligned
from relnav_graph.scoring.metrics import summary

SHORT = ["time.epochs=60", "truth.map.count=20", "sensors.camera.gate=0.999"]


@cache
def _pass(errors: float) -> Pass:
    sets = [*SHORT, f"sensors.camera.association_errors={errors}"]
    return open_pass(EXPERIMENTS / "inspection.toml", assignments=sets)


def _map_error(track: Track) -> float:
    """Rms over the points, m, after one alignment; of all passes the truth is the same."""
    found = aligned(track, _pass(0.0).recording.truth, (), np.ones(len(track.t), np.bool_))
    return float(found["map_rmse_m"])


@cache
def _clean_error() -> float:
    return _map_error(run_estimator("batch", _pass(0.0).problem))


def _listed(track: Track) -> set[tuple[float, int]]:
    one = track.left_out["camera"]
    return set(zip(one.t.tolist(), one.ids.tolist(), strict=True))


def test_wrong_associations_are_listed_and_leave_the_map() -> None:
    """Also where the first sight of a point was wrong, by which the filter has placed it."""
    recording, track = _pass(0.1).recording, run_estimator("batch", _pass(0.1).problem)
    seen = [m for m in recording.measurements if m.sensor == "camera"]
    wrong = {(t, i) for _, t, i in recording.misassociated}
    every = {(m.t, int(i)) for m in seen for i in m.ids}
    first: dict[int, float] = {}
    for m in seen:
        for i in m.ids.tolist():
            first.setdefault(i, m.t)
    assert any((t, i) in wrong for i, t in first.items())
    listed = _listed(track)
    assert len(listed) == track.rejected["camera"]
    assert listed <= every
    assert len(listed & wrong) >= 0.95 * len(wrong) > 0
    assert len(listed - wrong) <= 0.01 * len(every - wrong)
    assert track.status == "ok"
    assert track.retired == ()
    assert _map_error(track) <= 1.5 * _clean_error()


def test_a_point_without_two_sights_that_agree_is_retired(tmp_path: Path) -> None:
    """It leaves the map and is named; what it was seen as is listed; the others stay."""
    opened, rng, lost = _pass(0.0), np.random.default_rng(1), 7

    def scattered(m: Measurement) -> Measurement:
        own = m.ids == lost
        if m.sensor != "camera" or not own.any():
            return m
        off = rng.uniform(-60.0, 60.0, 2)  # px: anywhere on the target
        return replace(m, z=m.z + np.where(own[:, None], [off[0], off[1], off[0], off[1]], 0.0))

    recording = opened.recording
    recording = replace(recording, measurements=tuple(map(scattered, recording.measurements)))
    track = run_estimator("incremental", opened.scenario.problem(recording, opened.seed)).smoothed
    assert track is not None
    assert track.status == "ok", track.message
    assert track.retired == (f"point[{lost}]",)
    times = {m.t for m in recording.measurements if m.sensor == "camera" and lost in m.ids}
    assert {t for t, i in _listed(track) if i == lost} == times
    assert lost not in [b.number for b in track.mapped]
    assert np.allclose(track.covariance(f"point[{lost}]")[-1], 100.0 * np.eye(3))
    assert _map_error(track) <= 1.5 * _clean_error()
    row = summary("s", 0, [track], recording.truth, (), None, 60)["estimators"][
        "incremental_smoothed"
    ]
    assert row["retired"] == list(track.retired)
    assert row["statics"]["point"]["rmse"] < 30.0  # mm

    path = tmp_path / "results.nc"
    write_results(path, [track], recording.truth, {})
    back = read_results(path)[0][0]
    assert back.retired == track.retired
    assert back.left_out.keys() == track.left_out.keys()
    for name, one in track.left_out.items():
        assert np.array_equal(back.left_out[name].t, one.t)
        assert np.array_equal(back.left_out[name].ids, one.ids)
