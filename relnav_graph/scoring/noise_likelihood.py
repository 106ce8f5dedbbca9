"""How well declared noises fit the residuals of one smoothed pass, and which way they are wrong.

Of a pass that is linear about its smoothed trajectory, the likelihood of the measurements (the
product of those of a filter's innovations) is, with whitened rows A y + e,

    ln L = ln |W| - ln |R| - |e*|^2 / 2 + const,

W: what the rows are whitened with, R: the root of the information, e*: the residuals after
smoothing. With variance sigma_g^2 of the noises of group g, its slope is

    d ln L / d ln sigma_g^2 = (e_g*^T e_g* - r_g) / 2,    r_g = n_g - tr(A_g P A_g^T),

r_g: the redundancy of its n_g rows, and its information T / 2, with T as in
`relnav_graph.scoring.variance_components` (Patterson, Thompson 1971; Koch 1999, sec. 3.6).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relnav_graph.arrays import Array
from relnav_graph.core.problem import Problem
from relnav_graph.estimators.gauss_newton import Solution
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import Conditionals, anchor_of
from relnav_graph.linear.elimination import linearize
from relnav_graph.linear.gtsam_chain import Rows, chain_rows
from relnav_graph.linear.whitening import measurement_noise
from relnav_graph.scoring.variance_components import (
    PRIOR,
    Groups,
    coupling,
    process_groups,
    residuals_after,
)

__all__ = ["Fit", "explained", "fit"]

#: The group of all noises that are not asked for.
REST = "rest"


@dataclass(frozen=True, eq=False)
class Fit:
    """By noise group, (groups,): squares, sums of squared whitened residuals after smoothing;
    redundancy, what they should be; T (groups, groups); log_likelihood: of all measurements, but
    for a constant of them."""

    squares: Array
    redundancy: Array
    T: Array
    log_likelihood: float

    @property
    def step(self) -> Array:
        """By which part each variance should grow (groups,): Fisher's scoring."""
        return np.asarray(np.linalg.solve(self.T, self.squares - self.redundancy))

    @property
    def sigmas(self) -> Array:
        """1-sigma (groups,) of the logarithms of the variances."""
        return np.asarray(np.sqrt(np.diag(2 * np.linalg.inv(self.T))))


def _groups(
    problem: Problem,
    assembly: Assembly,
    asked: Sequence[str],
    of_rows: Mapping[str, Sequence[str]],
) -> Groups:
    names = [*asked, PRIOR, REST]
    place = {name: i for i, name in enumerate(names)}
    of_state = process_groups(problem.processes, assembly)
    rest = place[REST]
    of_process = [place.get(of_state[i], rest) for i in range(assembly.layout.moving.dim)]
    own = [
        [place.get(n, rest) for n in of_rows.get(s, [REST] * problem.sensors[s].rows)]
        for s in assembly.sensor_names
    ]
    rows = [np.array(own[s]) for s in assembly.sensor_of]
    measured = np.concatenate(rows) if rows else np.zeros(0, dtype=np.int64)
    return Groups(names, measured, np.array(of_process))


def explained(rows: Rows, c: Conditionals) -> tuple[Array, Array, Array]:
    """What each row of prior, process (N - 1, n) and measurements takes of its own noise: the
    diagonal of A P A^T."""
    m, n = c.marginals(), rows.states
    whole, cross, P_s = m.whole(slice(1))[0], m.cross, m.statics
    prior = np.einsum("ij,jk,ik->i", rows.A, whole, rows.A)
    at = np.repeat(np.arange(len(m.P)), np.diff(rows.offsets))
    H, H_s = rows.measurements.H[:, :n], rows.measurements.H[:, n:]
    measured = np.einsum("ri,rij,rj->r", H, m.P[at], H)
    measured += 2 * np.einsum("ri,rij,rj->r", H, cross[at], H_s)
    measured += np.einsum("ri,ij,rj->r", H_s, P_s, H_s)
    A, A_s, B = rows.process.A[:, :, :n], rows.process.A[:, :, n:], rows.process.B
    after = c.S @ m.P[1:] + c.T[:-1] @ cross[1:].transpose(0, 2, 1)
    between = -np.linalg.solve(c.R[:-1], after)  # covariance of y_k with y_k+1
    process = np.einsum("kai,kij,kaj->ka", A, m.P[:-1], A)
    process += np.einsum("kai,kij,kaj->ka", B, m.P[1:], B)
    process += 2 * np.einsum("kai,kij,kaj->ka", A, between, B)
    process += 2 * np.einsum("kai,kij,kaj->ka", A, cross[:-1], A_s)
    process += 2 * np.einsum("kai,kij,kaj->ka", B, cross[1:], A_s)
    process += np.einsum("kai,ij,kaj->ka", A_s, P_s, A_s)
    return prior, process, measured


def _log_likelihood(
    problem: Problem, rows: Rows, c: Conditionals, cost: float, used: NDArray[np.bool_]
) -> float:
    """See above. cost: half the sum of squares after the step; used: of the observations."""
    found = np.linalg.slogdet(rows.A)[1] + np.linalg.slogdet(rows.process.B)[1].sum()
    found -= np.log(np.abs(np.einsum("kii->ki", c.R))).sum()
    found -= np.log(np.abs(np.diag(c.R_s))).sum()
    at = 0
    for epoch in problem.epochs:
        for m in epoch.measurements:
            noise = measurement_noise(m.sensor, problem.sensors[m.sensor], m)
            found -= 0.5 * np.linalg.slogdet(noise)[1][used[at : at + len(m.z)]].sum()
            at += len(m.z)
    return float(found - cost)


def fit(
    problem: Problem,
    solution: Solution,
    asked: Sequence[str],
    of_rows: Mapping[str, Sequence[str]],
    probes: int = 1,
) -> Fit:
    """How noises of a smoothed pass fit, at its solution, of the groups `asked`.

    asked: names of noises, as of `process_groups`, or in of_rows, which names the noise of each
    residual row of one observation, by sensor; probes: draws of random signs from which T is
    estimated, always the same; 0 leaves it zero. Raises GeometryError, ModelError and
    EstimationError where the
    trajectory cannot be linearised.
    """
    assembly = Assembly.of(problem)
    x, weights, anchor = solution.x, solution.weights, anchor_of(problem.prior)
    whiten = assembly.whitening(x[:-1])
    system = linearize(assembly, anchor, x, whiten, weights)
    rows = chain_rows(assembly, anchor, x, whiten, weights)
    groups, used = _groups(problem, assembly, asked, of_rows), assembly.rows_of(weights > 0)
    after = residuals_after(rows, system.conditionals.solution())
    squares = groups.sums(*(e**2 for e in after))
    prior, process, measured = explained(rows, system.conditionals)
    redundancy = groups.sums(1 - prior, 1 - process, np.where(used, 1 - measured, 0.0))
    rng = np.random.default_rng(np.random.SeedSequence(0))
    n, cost, T = len(asked), 0.5 * float(squares.sum()), np.zeros((len(asked), len(asked)))
    for _ in range(probes):
        T += coupling(rows, groups, used, rng, n)[:n] / probes
    return Fit(
        squares[:n],
        redundancy[:n],
        0.5 * (T + T.T),
        _log_likelihood(problem, rows, system.conditionals, cost, weights > 0),
    )
