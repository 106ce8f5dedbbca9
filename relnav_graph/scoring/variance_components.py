"""Which noise is declared too small or too large: variance components of a smoothed pass.

Noises are put in groups: each sensor, each noise density of a process, and the prior. With
whitened residuals e_i of group i after smoothing and sigma_j^2 the ratio of the true to the
declared variance of group j, E[e_i^T e_i] = sum_j T_ij sigma_j^2, where T_ij = ||Q_ij||^2
(Frobenius) of the blocks of Q, the projector that gives the residuals of the noises.
Solving for sigma_j^2 is Helmert's estimate (Helmert 1907; Grafarend 1984; Amiri-Simkooei
2007, eq. 22), of covariance 2 T^-1 where the declared noises are true and T is known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.contracts import Dynamics
from relnav_graph.core.problem import Problem
from relnav_graph.estimators.weights import residual_weights
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import Conditionals, anchor_of
from relnav_graph.linear.elimination import linearize
from relnav_graph.linear.gtsam_chain import Rows, chain_factors, chain_rows, eliminate

__all__ = [
    "Groups",
    "NoiseResiduals",
    "Smoothed",
    "coupling",
    "estimate_factors",
    "noise_residuals",
    "process_groups",
    "residuals_after",
]

#: The prior is a group too: what it says is part of what the residuals say.
PRIOR = "prior"


@dataclass(frozen=True, eq=False)
class NoiseResiduals:
    """Sums of squared whitened residuals by group of noises.

    squares: by the group's path in the scenario; coupling: T (groups, groups), where it was
    asked for; cost: half the sum of all squares at the trajectory itself.
    """

    squares: Mapping[str, float]
    cost: float
    coupling: Array | None = None


def process_groups(processes: Mapping[str, Dynamics], assembly: Assembly) -> Mapping[int, str]:
    """The group of each error state, as the noise that drives it."""
    found = dict[int, str]()
    for name, process in processes.items():
        noises = process.noises or tuple(b.name for b in process.advances)
        for block, noise in zip(process.advances, noises, strict=True):
            places = assembly.layout.tangent(block.name)
            found |= dict.fromkeys(range(places.start, places.stop), f"processes.{name}.{noise}")
    return found


@dataclass(frozen=True, eq=False)
class Groups:
    """Names of the groups, and to which each row of the measurements and each column of
    the process rows belongs."""

    names: list[str]
    of_measurement: Indices
    of_process: Indices

    def sums(self, prior: Array, process: Array, measurements: Array) -> Array:
        """Totals by group of values for each row: (n,), (M, n), (R,)."""
        count = len(self.names)
        out = np.bincount(self.of_measurement, measurements, count).astype(np.float64)
        out += np.bincount(self.of_process, process.sum(axis=0), count)
        out[self.names.index(PRIOR)] += prior.sum()
        return out


def _groups(problem: Problem, assembly: Assembly) -> Groups:
    of_state, n = process_groups(problem.processes, assembly), assembly.layout.moving.dim
    names = [f"sensors.{s}" for s in assembly.sensor_names]
    names += [PRIOR, *dict.fromkeys(of_state[i] for i in range(n))]
    of_process = np.array([names.index(of_state[i]) for i in range(n)])
    return Groups(names, np.repeat(assembly.sensor_of, assembly.heights), of_process)


def residuals_after(rows: Rows, d: Array) -> tuple[Array, Array, Array]:
    """Whitened residuals of prior, process and measurements after the step d (N, n + m), n of the
    blocks that move, m of the static ones, the same in all rows."""
    q, m = rows.process, rows.measurements
    at, n = np.repeat(np.arange(len(d)), np.diff(rows.offsets)), rows.states
    return (
        rows.e + rows.A @ d[0],
        q.e + np.einsum("kij,kj->ki", q.A, d[:-1]) + np.einsum("kij,kj->ki", q.B, d[1:, :n]),
        m.r + np.einsum("rj,rj->r", m.H, d[at]),
    )


def coupling(
    rows: Rows,
    groups: Groups,
    used: NDArray[np.bool_],
    rng: np.random.Generator,
    columns: int | None = None,
) -> Array:
    """T (groups, groups), or its first `columns` columns, estimated with random signs z.

    The estimate is Hutchinson's (1990).

    T_ij = ||Q_ij||^2 = E[|Q_ij z_j|^2]: the noises of group j alone are replaced by z_j, and the
    squared residuals after smoothing are summed by group i.
    """
    q, m = rows.process, rows.measurements
    prior, process, measured = (rng.choice((-1.0, 1.0), a.shape) for a in (rows.e, q.e, m.r))
    count, n = len(rows.offsets) - 1, rows.states
    names = groups.names[:columns]
    out = np.empty((len(groups.names), len(names)))
    for j, name in enumerate(names):
        probe = replace(
            rows,
            e=prior * (name == PRIOR),
            process=replace(q, e=process * (groups.of_process == j)),
            measurements=replace(m, r=measured * (used & (groups.of_measurement == j))),
        )
        d = eliminate(chain_factors(probe), count, n, len(rows.e) - n).solution()
        out[:, j] = groups.sums(*(e**2 for e in residuals_after(probe, d)))
    return out


@dataclass(frozen=True, eq=False)
class Smoothed:
    """A pass linearised about a smoothed trajectory: its rows, whitened, and their elimination;
    used: which rows of the measurements are (R,)."""

    assembly: Assembly
    rows: Rows
    conditionals: Conditionals
    cost: float
    used: NDArray[np.bool_]

    @staticmethod
    def of(problem: Problem, x: Array) -> Smoothed:
        """At the trajectory x (N, size). Raises GeometryError, ModelError and EstimationError where
        it cannot be linearised."""
        assembly = Assembly.of(problem)
        measured = assembly.measure(x, np.ones(assembly.observations))
        weights = residual_weights(assembly, measured, problem.gates, problem.losses)
        whiten = assembly.whitening(x[:-1])
        anchor = anchor_of(problem.prior)
        system = linearize(assembly, anchor, x, whiten, weights)
        rows = chain_rows(assembly, anchor, x, whiten, weights)
        used = assembly.rows_of(weights > 0)
        return Smoothed(assembly, rows, system.conditionals, system.cost, used)

    def noises(
        self, problem: Problem, rng: np.random.Generator | None = None, probes: int = 1
    ) -> NoiseResiduals:
        """See `noise_residuals`; probes: independent estimates of T, (probes, groups, groups) where
        there are several."""
        groups = _groups(problem, self.assembly)
        after = residuals_after(self.rows, self.conditionals.solution())
        by_name = dict(zip(groups.names, groups.sums(*(e**2 for e in after)).tolist(), strict=True))
        if rng is None:
            return NoiseResiduals(by_name, self.cost)
        each = [coupling(self.rows, groups, self.used, rng) for _ in range(probes)]
        return NoiseResiduals(by_name, self.cost, each[0] if probes == 1 else np.array(each))


def noise_residuals(
    problem: Problem, x: Array, rng: np.random.Generator | None = None
) -> NoiseResiduals:
    """Residuals by group at the smoothed trajectory x (N, size).

    They are taken after one more Gauss-Newton step of the linearised problem, so that it does
    not matter whether the smoother stopped a little early.

    rng: for the coupling T of the groups, None to leave that out. Raises GeometryError,
    ModelError and EstimationError where the trajectory cannot be linearised.
    """
    return Smoothed.of(problem, x).noises(problem, rng)


def _of_mean(samples: Array) -> Array:
    """Covariance (groups, groups) of the mean of independent samples (probes, groups). Of one
    alone its spread is not known, and taken for none."""
    count = len(samples)
    e = samples - samples.mean(axis=0)
    return np.asarray(e.T @ e / max(count - 1, 1) / count)


def estimate_factors(squares: Array, coupling: Array) -> tuple[Array, Array]:
    """Solve T f = squares: true over declared variances f (groups,), and their sigmas (groups,).

    squares (groups,): e_i^T e_i summed over runs; coupling (groups, groups): T, summed over the
    same runs, or (probes, groups, groups): independent estimates of it, whose mean is taken. The
    sigmas hold where all declared noises are true: the covariance of f is 2 T^-1, and of estimates
    T_p besides T^-1 C T^-1 with C that of the mean of T_p 1, by which T f = squares is off. (Of a
    noise that residuals hardly show, a few probes tell T less well than many runs the squares.) A
    group that the data hardly test is left as declared: its factor is 1, its sigma infinite.
    """
    probes = coupling.reshape(-1, *coupling.shape[-2:])
    T = probes.mean(axis=0)
    T = 0.5 * (T + T.T)
    keep = np.diag(T) > 10.0  # below, the factor itself would be known to 45 % at best
    factor, sigma = np.ones(len(T)), np.full(len(T), np.inf)
    if keep.any():
        inner = T[np.ix_(keep, keep)]
        factor[keep] = np.linalg.solve(inner, squares[keep] - T[np.ix_(keep, ~keep)].sum(axis=1))
        inverse = np.linalg.inv(inner)
        C = _of_mean(0.5 * (probes + probes.transpose(0, 2, 1)).sum(axis=2))[np.ix_(keep, keep)]
        sigma[keep] = np.sqrt(np.diag(2 * inverse + inverse @ C @ inverse))
    return factor, sigma
