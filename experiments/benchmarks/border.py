"""Eliminating static blocks: against LAPACK's floor, and GTSAM's elimination of the same rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import gtsam
import numpy as np
from scipy.linalg import blas, cholesky, cholesky_banded, lapack

from relnav_graph.arrays import Array
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Truth
from relnav_graph.linear import rows
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import anchor_of
from relnav_graph.linear.elimination import linearize
from relnav_graph.linear.gtsam_chain import chain_factors, chain_rows

from .mapped import mapped
from .online import incremental
from .passes import scenario_of, seconds


def mapped_pass(epochs: int, points: int) -> tuple[Problem, Truth]:
    """A pass with that many unknown points, and its truth."""
    scenario = scenario_of(epochs)
    recording = scenario.simulate(0)
    assert recording.truth is not None
    problem = scenario.problem(recording, 0)
    return mapped(problem, recording.truth, points), recording.truth


def floor_of(epochs: int, n: int, m: int) -> Callable[[], object]:
    """LAPACK's Cholesky of normal equations: a band of blocks, each tied to the next, and a border
    of m columns, tied to all."""
    rng = np.random.default_rng(0)
    band = rng.uniform(-1, 1, (2 * n, n * epochs))
    band[0] = 100.0  # diagonally dominant
    border, corner = np.asfortranarray(rng.uniform(-1, 1, (n * epochs, m))), 1e6 * np.eye(m)

    def factorise() -> object:
        L = cholesky_banded(band, lower=True, check_finite=False)
        solved, _ = lapack.dtbtrs(L, border, uplo="L")
        return cholesky(blas.dsyrk(-1.0, solved, 1.0, corner, trans=1), check_finite=False)

    return factorise


def elimination(epochs: int, points: int, rounds: int = 5) -> dict[str, float]:
    """Per epoch, us, medians of rounds in turn: our elimination (linearising, less the models'
    kernels), LAPACK's floor and GTSAM's QR in COLAMD's order; m, the static states."""
    problem, truth = mapped_pass(epochs, points)
    layout, assembly = problem.layout, Assembly.of(problem)
    start = [
        {
            **layout.values(problem.prior.x),
            **{n: v[k] for n, v in truth.values.items() if n in layout},
        }
        for k in range(epochs)
    ]
    x = layout.held(np.array([layout.pack(values) for values in start]))
    anchor, whiten = anchor_of(problem.prior), assembly.whitening(x[:-1])
    weight = np.ones(assembly.observations)
    r = np.empty(int(assembly.row_offsets[-1]))
    H, status = np.empty((len(r), layout.dim)), np.empty(assembly.observations, dtype=np.int64)

    def kernels() -> None:
        rows.measure(assembly.tables, x, weight, r, H, status)
        assembly.transition(x[:-1])

    graph = gtsam.GaussianFactorGraph()
    for factor in chain_factors(chain_rows(assembly, anchor, x, whiten, weight)):
        graph.push_back(factor)

    def theirs() -> None:
        ordering = gtsam.Ordering.ColamdGaussianFactorGraph(graph)
        graph.eliminateMultifrontal(ordering, gtsam.EliminateQR)

    runs: list[Callable[[], object]] = [
        lambda: linearize(assembly, anchor, x, whiten, weight),
        kernels,
        floor_of(epochs, layout.moving.dim, layout.statics.dim),
        theirs,
    ]
    took: Array = np.array([[seconds(run) for run in runs] for _ in range(rounds + 1)])[1:]
    ours = 1e6 * np.median(took[:, 0] - took[:, 1]) / epochs
    floor, gtsams = 1e6 * np.median(took[:, 2:], axis=0) / epochs
    return {
        "m": layout.statics.dim,
        "us": float(ours),
        "floor_us": float(floor),
        "gtsam_us": float(gtsams),
    }


def measure(
    say: Callable[[str], None], points: Sequence[int], lengths: tuple[int, int, int], steps: int
) -> dict[str, Any]:
    """The rows of static blocks.

    points: numbers of unknown points; lengths: of the passes with each of them, and of the short
    and the long pass that are compared; steps: of `incremental`, 0 for none.
    """
    out: dict[str, Any] = {}
    for count in points:
        one = elimination(lengths[0], count)
        ratio, m = one["us"] / one["floor_us"], one["m"]
        out[f"floor_ratio_{m}"], out[f"gtsam_{m}"] = ratio, one["gtsam_us"] / one["us"]
        say(
            f"{m} static states, {lengths[0]} epochs: eliminated in {one['us']:.0f} us per epoch,"
            f" {ratio:.2f} times LAPACK's floor; GTSAM's COLAMD-QR of the same rows takes"
            f" {one['gtsam_us']:.0f} us"
        )
    short, long = (elimination(length, points[0], 3)["us"] for length in lengths[1:])
    out["flatness"], out["incremental_growth"] = long / short, _growth(steps) if steps else None
    say(f"{lengths[2]} epochs cost {long / short:.2f} times as much each as {lengths[1]}")
    if steps:
        say(
            f"incremental, {steps} epochs, 150 static states: grows {out['incremental_growth']:.2f}"
        )
    return out


def _growth(steps: int) -> float:
    """The median of the last sixth of the steps of `incremental`, over that of the first, with 150
    static states."""
    problem, _ = mapped_pass(steps, 50)
    step = incremental(problem)
    took = [seconds(partial(step, k)) for k in range(steps)]
    part = steps // 6
    return float(np.median(took[-part:]) / np.median(took[:part]))
