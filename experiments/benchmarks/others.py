"""The same problem handed to general solvers: SciPy, Ceres, and FilterPy's filter.

Each gets our rows and Jacobians in the tangent of the trajectory that it starts from, the
smoothed filter's, so that all minimise one cost; what differs is the solver. In units of the
sigmas the Jacobian of a pass has a condition number of about 1e9.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import bsr_array, csc_array, csr_array, vstack
from scipy.sparse.linalg import LinearOperator, splu

from relnav_graph.arrays import Array
from relnav_graph.estimators.ekf import run_filter
from relnav_graph.estimators.rts import smooth
from relnav_graph.linear.conditionals import anchor_of
from relnav_graph.linear.elimination import linearize
from relnav_graph.linear.intervals import ProcessRows
from relnav_graph.linear.rows import MeasurementRows

from .batch import solve_ours
from .passes import SAME, Pass, seconds


class Tangent:
    """Rows and Jacobians of a pass as functions of d (N n,), in the tangent of x0."""

    def __init__(self, p: Pass, x0: Array) -> None:
        self.p, self.x0 = p, x0
        self.layout, self.anchor = p.assembly.layout, anchor_of(p.problem.prior)
        self.whiten = p.assembly.whitening(p.start[:-1])

    def at(self, d: Array) -> Array:
        """The trajectory (N, size)."""
        return self.layout.retract(self.x0, d.reshape(len(self.x0), -1))

    def rows(self, d: Array) -> tuple[tuple[Array, Array], ProcessRows, MeasurementRows]:
        """Of the prior, the intervals, the observations."""
        x, a = self.at(d), self.p.assembly
        prior = self.anchor.rows(self.layout, x[0])
        return prior, a.process(x, self.whiten), a.measure(x, self.p.weights)

    def residual(self, d: Array) -> Array:
        """All rows."""
        prior, process, measured = self.rows(d)
        return np.concatenate([prior[0], process.e.ravel(), measured.r])

    def jacobian(self, d: Array) -> Any:
        """Sparse."""
        (_, A), process, measured = self.rows(d)
        count, n = self.x0.shape[0], self.layout.dim
        step = d.reshape(count, n)
        turn = np.array([self.layout.right_jacobian(one) for one in step])
        blocks = np.stack([process.A @ turn[:-1], process.B @ turn[1:]], axis=1)
        k = np.arange(count - 1)
        columns = np.stack([k, k + 1], axis=1).ravel()
        intervals = bsr_array(
            (blocks.reshape(-1, n, n), columns, 2 * np.arange(count)),
            shape=(n * (count - 1), n * count),
        )
        epoch = np.repeat(np.arange(count), np.diff(self.p.assembly.row_offsets))
        H = np.einsum("ri,rij->rj", measured.H, turn[epoch])
        at = epoch[:, None] * n + np.arange(n)
        seen = csr_array(
            (H.ravel(), at.ravel(), n * np.arange(len(H) + 1)), shape=(len(H), n * count)
        )
        first = bsr_array(((A @ turn[0])[None], [0], [0, 1]), shape=(n, n * count))
        return csr_array(vstack([first, intervals, seen]))


def _ratio(p: Pass, took: float, found: Array) -> tuple[float | None, float]:
    """Time in units of ours, where the optimum is the same; and how far from it, in sigmas."""
    ours = min(seconds(lambda: solve_ours(p, p.start)) for _ in range(5))
    far = p.distance(found)
    return (took / ours if far < SAME else None), far


def _preconditioner(p: Pass, tangent: Tangent) -> Any:
    """The triangular factor of the system at the start, by our elimination; solves with it."""
    system = linearize(p.assembly, tangent.anchor, p.start, tangent.whiten, p.weights)
    R, S = system.conditionals.R, system.conditionals.S
    count, n = R.shape[:2]
    blocks = np.zeros((2 * count - 1, n, n))
    blocks[::2], blocks[1::2] = R, S
    columns = (np.arange(2 * count - 1) + 1) // 2
    starts = np.append(2 * np.arange(count), 2 * count - 1)
    factor = bsr_array((blocks, columns, starts), shape=(count * n, count * n))
    return splu(csc_array(factor), permc_spec="NATURAL", diag_pivot_thresh=0.0)


def scipy_solver(p: Pass) -> Callable[[], Array]:
    """`scipy.optimize.least_squares`, trust region, sparse analytic Jacobian; gives the trajectory.

    Its own iteration for the step, LSMR, does not converge at this condition number; so it
    gets the triangular factor of the start as a preconditioner, for nothing.
    """
    tangent = Tangent(p, p.start)
    factor = _preconditioner(p, tangent)

    def residual(y: Array) -> Array:
        return tangent.residual(factor.solve(y))

    def jacobian(y: Array) -> Any:
        J = tangent.jacobian(factor.solve(y))
        return LinearOperator(
            J.shape,
            matvec=lambda v: J @ factor.solve(np.ravel(v)),
            rmatvec=lambda r: factor.solve(J.T @ np.ravel(r), trans="T"),
            dtype=float,
        )

    def run() -> Array:
        result = least_squares(
            residual,
            np.zeros(p.sigma.size),
            jacobian,
            ftol=1e-15,
            xtol=1e-15,
            gtol=1e-15,
            tr_solver="lsmr",
            tr_options={"atol": 1e-15, "btol": 1e-15, "maxiter": 100, "regularize": False},
            max_nfev=40,
        )
        return tangent.at(factor.solve(result.x))

    return run


def faster_than_scipy(p: Pass) -> tuple[float | None, float]:
    """Time of `scipy_solver` in units of ours; and how far it ends from the optimum, in sigmas."""
    run, found = scipy_solver(p), list[Array]()
    took = seconds(lambda: found.append(run()))
    return _ratio(p, took, found[0])


def faster_than_pyceres(p: Pass) -> tuple[float | None, float]:
    """Ceres, sparse Cholesky, one Python cost function over one block per epoch and kind.

    Normal equations square the condition number: hundreds of iterations still end far above
    1e-6 of a sigma, and so does its dense QR.
    """
    import pyceres

    x0 = p.start
    count, n = len(x0), p.assembly.layout.dim
    tangent, blocks = Tangent(p, x0), [np.zeros(n) for _ in range(count)]
    scale, layout, a = p.sigma, p.assembly.layout, p.assembly
    singles = [a.at(k) for k in range(count)]

    class Rows(pyceres.CostFunction):  # type: ignore[misc]
        def __init__(self, size: int, parts: list[int]) -> None:
            super().__init__()
            self.parts = parts
            self.set_num_residuals(size)
            self.set_parameter_block_sizes([n] * len(parts))

        def of(self, x: list[Array]) -> tuple[Array, list[Array]]:
            raise NotImplementedError

        def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
            d = [scale[k] * np.asarray(s) for k, s in zip(self.parts, parameters, strict=True)]
            x = [layout.retract(x0[k], v) for k, v in zip(self.parts, d, strict=True)]
            r, Js = self.of(x)
            residuals[:] = r
            for i, (k, v, J) in enumerate(zip(self.parts, d, Js, strict=True)):
                if jacobians is not None and jacobians[i] is not None:
                    jacobians[i][:] = (J @ layout.right_jacobian(v) * scale[k]).ravel()
            return True

    class First(Rows):
        def of(self, x: list[Array]) -> tuple[Array, list[Array]]:
            e, A = tangent.anchor.rows(layout, x[0])
            return e, [A]

    class Interval(Rows):
        def of(self, x: list[Array]) -> tuple[Array, list[Array]]:
            k = self.parts[0]
            rows = singles[k + 1].process(np.array(x), tangent.whiten[k : k + 1])
            return rows.e[0], [rows.A[0], rows.B[0]]

    class Seen(Rows):
        def of(self, x: list[Array]) -> tuple[Array, list[Array]]:
            one = singles[self.parts[0]]
            rows = one.measure(x[0][None], np.ones(one.observations))
            return rows.r, [rows.H]

    problem = pyceres.Problem()
    functions: list[Rows] = [First(n, [0])]
    functions += [Interval(n, [k, k + 1]) for k in range(count - 1)]
    heights = np.diff(a.row_offsets)
    functions += [Seen(int(heights[k]), [k]) for k in range(count) if heights[k]]
    for one in functions:
        problem.add_residual_block(one, None, [blocks[k] for k in one.parts])
    options = pyceres.SolverOptions()
    options.linear_solver_type = pyceres.LinearSolverType.SPARSE_NORMAL_CHOLESKY
    options.minimizer_progress_to_stdout, options.max_num_iterations = False, 300
    options.function_tolerance = options.gradient_tolerance = 1e-16
    options.parameter_tolerance, options.initial_trust_region_radius = 1e-14, 1e16
    took = seconds(lambda: pyceres.solve(options, problem, pyceres.SolverSummary()))
    return _ratio(p, took, tangent.at((scale * np.array(blocks)).ravel()))


def faster_than_filterpy(p: Pass) -> tuple[float, float]:
    """FilterPy's Kalman filter and RTS smoother over the same models, in time of our own
    extended filter and smoother; and how far its filtered trajectory is from the optimum, in
    sigmas."""
    from filterpy.kalman import predict, rts_smoother, update

    layout, prior, count = p.assembly.layout, p.problem.prior, len(p.start)
    singles = [p.assembly.at(k) for k in range(count)]
    zero, found = np.zeros(layout.dim), []

    def run() -> None:
        x, P, xs, Ps, Fs, Qs = prior.x, prior.P, [], [], [], []
        for k, one in enumerate(singles):
            if k:
                x_next, F, Q = one.transition(x[None])
                x, P = x_next[0], predict(zero, P, F=F[0], Q=Q[0])[1]
                Fs.append(F[0])
                Qs.append(Q[0])
            rows = one.measure(x[None], np.ones(one.observations))
            d, P = update(zero, P, -rows.r, np.eye(len(rows.r)), H=rows.H)
            x = layout.retract(x, d)
            xs.append(x)
            Ps.append(P)
        # In tangents of the updates, the filter's means are zero, and so are the smoother's:
        # it does here what it does anywhere, and its covariances are what counts.
        rts_smoother(np.zeros((count, layout.dim)), np.array(Ps), Fs, Qs)
        found.append(np.array(xs))

    took = seconds(run)

    def ours() -> None:
        done = run_filter(p.problem, 1, p.assembly)
        smooth(done)

    return took / min(seconds(ours) for _ in range(5)), p.distance(found[0])
