"""The same quantities by this package and by independent software, and how far they are apart.

Tests assert the tolerances; `experiments/validation.py` prints what is found, with versions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import erfa
import gtsam
import numpy as np
from passes import FIX, PRIOR, RANGER, linear_problem, sigmas, toy_measurements, toy_problem
from relnav_factors.shared.harmonics import harmonic_pull, harmonic_table
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from relnav_graph import write_track
from relnav_graph.arrays import Array
from relnav_graph.constants import MU_EARTH
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track
from relnav_graph.estimators import run_estimator
from relnav_graph.estimators.ukf import Ukf
from relnav_graph.maths import so3
from relnav_graph.maths.earth import EarthTable, gcrf_from_itrf
from relnav_graph.maths.geopotential import geopotential
from relnav_graph.maths.instants import Instant
from relnav_graph.maths.orbit import KeplerOrbit, two_body
from relnav_graph.runs.graph import Graph, to_gtsam

# --- time and frames: ERFA ------------------------------------------------------------------


def erfa_tdb_apart() -> float:
    """TDB - TT, s."""
    tt, tdb = (Instant.parse(f"2021-07-17T00:00:00 {scale}") for scale in ("TT", "TDB"))
    u1, u2 = erfa.tdbtt(2459412.5, 0.0, erfa.dtdb(2459412.5, 0.0, 0.0, 0.0, 0.0, 0.0))
    return float(abs(tdb.since(tt) - (u1 - 2459412.5 + u2) * 86400))


def turning_earth() -> tuple[Instant, Array, EarthTable, Array, Array]:
    """Begin, times, orientation of the Earth, positions and velocities in Earth-fixed axes."""
    begin, t = Instant.parse("2010-07-27T00:00:00 GPS"), np.array([0.0, 30000.0, 86000.0])
    mjd = np.arange(55402.0, 55408.0)
    table = EarthTable(mjd, np.full(6, -0.05), np.full(6, 1e-6), np.full(6, 2e-6))
    r, v = np.array([[7e6, 1e5, -2e6]] * 3), np.array([[1e3, 7e3, 5e2]] * 3)
    return begin, t, table, r, v


def erfa_frames_apart() -> float:
    """Of positions 7000 km away, m, by the whole chain from ITRF to GCRF (c2t06a)."""
    begin, t, table, r, v = turning_earth()
    r_i, _ = gcrf_from_itrf(begin, t, r, v, table)
    found = []
    for k in range(len(t)):
        tt = (2400000.5 + begin.day, (begin.seconds + t[k]) / 86400)
        ut1 = (tt[0], tt[1] + (-0.05 - 34.0 - 32.184) / 86400)
        R_ei = erfa.c2t06a(*tt, *ut1, 1e-6, 2e-6)
        found.append(np.abs(R_ei @ r_i[k] - r[k]).max())
    return float(max(found))


# --- gravity, for `against_brahe` -------------------------------------------------------------

FIELD = geopotential()
#: Low, high, at the equator, near both poles, at one of them.
PLACES = np.array(
    [
        [3e6, -4e6, 4.5e6],
        [6.5e6, 1e3, 0.0],
        [2e7, 3e7, -1e7],
        [1e-3, 2e-3, 6.8e6],
        [-40.0, 3.0, -6.6e6],
        [0.0, 0.0, 6.8e6],
    ]
)


def pull(r: Array, degree: int, order: int) -> tuple[Array, Array]:
    """Of the harmonics alone, in Earth-fixed axes."""
    table = harmonic_table(*FIELD.upto(degree, order))
    return harmonic_pull(*table, FIELD.gm, FIELD.radius, r)


def sphere(r: Array) -> Array:
    return -FIELD.gm * r / float(np.linalg.norm(r)) ** 3


# --- propagation: SciPy's DOP853 --------------------------------------------------------------

ORBITS = {
    "circular": KeplerOrbit(7.0e6, 0.0, 0.4),
    "near circular": KeplerOrbit(7.0e6, 1e-9, 2.0),
    "low": KeplerOrbit(7.2e6, 0.05, 0.3),
    "highly eccentric": KeplerOrbit(4.0e7, 0.83, -2.4),
    "hyperbolic": KeplerOrbit(-2.0e7, 1.4, -1.0),
}


def integrate(f: Callable[[float, Array], Any], t0: float, t1: float, y0: Array) -> Array:
    y = solve_ivp(f, (t0, t1), y0, "DOP853", rtol=1e-13, atol=1e-13 * np.abs(y0).max())
    return np.asarray(y.y[:, -1])


def start(orbit: KeplerOrbit, tilted: bool = True) -> tuple[Array, Array]:
    """Position and velocity at t = 0, in a plane that is no coordinate plane."""
    p, e, nu, mu, _ = orbit.array()
    r = p / (1 + e * np.cos(nu)) * np.array([np.cos(nu), np.sin(nu), 0])
    v = np.sqrt(mu / p) * np.array([-np.sin(nu), e + np.cos(nu), 0])
    turn, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    return (turn @ r, turn @ v) if tilted else (r, v)


def length(v: Any) -> float:
    return float(np.linalg.norm(v))


def integrated_two_body(r0: Array, v0: Array, dt: float) -> Array:
    """State (6,) after dt, by DOP853."""

    def gravity(t: float, y: Array) -> Array:
        return np.concatenate([y[3:], -MU_EARTH * y[:3] / length(y[:3]) ** 3])

    y0 = np.concatenate([r0, v0])
    return integrate(gravity, 0, dt, y0) if dt else y0


def scipy_two_body_apart() -> float:
    """Positions after 5000 s, relative: circular, eccentric, hyperbolic."""
    found = []
    for orbit in ORBITS.values():
        r0, v0 = start(orbit)
        want = integrated_two_body(r0, v0, 5000.0)[:3]
        found.append(length(two_body(r0, v0, MU_EARTH, 5000.0)[0] - want) / length(want))
    return max(found)


# --- attitude: SciPy's Rotation ---------------------------------------------------------------


def scipy_attitude_apart() -> float:
    """Exp and Log of rotation vectors from 1e-9 rad to pi - 1e-6, rad."""
    rng, found = np.random.default_rng(0), []
    for angle in (1e-9, 1e-4, 0.3, 1.0, 3.0, np.pi - 1e-6):
        axis = rng.normal(size=3)
        phi = angle * axis / length(axis)
        R_ab = Rotation.from_rotvec(phi)
        found.append(np.abs(so3.exp(phi) - R_ab.as_matrix()).max())
        found.append(np.abs(so3.log(R_ab.as_matrix()) - R_ab.as_rotvec()).max())
    return float(max(found))


# --- filters: FilterPy ------------------------------------------------------------------------


def vector_models(problem: Problem, k: int) -> tuple[Any, Array, Any, Array, Array]:
    """f, Q, h, z, R of the interval to epoch k of the toy and of what was measured there."""
    epoch = problem.epochs[k]
    f, Q = None, np.zeros((7, 7))
    if k:
        dt = epoch.t - problem.epochs[k - 1].t
        (motion, electronics) = problem.processes.values()
        u = np.array([[dt]])

        def f(x: Array, dt: float = dt) -> Array:
            r, v = motion.transition(0.0, u, x[:3], x[3:6])[0]
            (drift,) = electronics.transition(0.0, u, x[6:])[0]
            return np.concatenate([r, v, drift])

        Q[:6, :6] = motion.transition(0.0, u, PRIOR.x[:3], PRIOR.x[3:6])[2]
        Q[6:, 6:] = electronics.transition(0.0, u, PRIOR.x[6:])[2]
    fix, ranges = epoch.measurements

    def h(x: Array) -> Array:
        return np.concatenate([x[:3], np.linalg.norm(x[:3] - RANGER.points, axis=1) + x[6]])

    R = np.zeros((6, 6))
    R[:3, :3], R[3:, 3:] = FIX.covariance, RANGER.sigma**2 * np.eye(3)
    return f, Q, h, np.concatenate([fix.z[0], ranges.z[:, 0]]), R


def wide_toy() -> Problem:
    """The toy with a prior so wide that the ranges are far from linear."""
    prior = replace(PRIOR, P=np.diag([25.0] * 3 + [1.0] * 3 + [1.0]))
    return toy_problem(toy_measurements(), prior=prior)


def _apart(x: Array, P: Array, of: Array, its: Array) -> float:
    """Of a mean in sigmas, and of a covariance as of correlations."""
    off = np.abs(x - of) / np.sqrt(np.diag(its))
    return max(float(off.max()), _correlations_apart(P, its))


def _correlations_apart(P: Array, its: Array) -> float:
    """Of a covariance from another, in products of the other's sigmas."""
    sigma = np.sqrt(np.diag(its))
    return float(np.abs((P - its) / np.outer(sigma, sigma)).max())


def filterpy_ukf_apart() -> list[float]:
    """At each epoch of a nonlinear pass, in sigmas."""
    import filterpy.kalman as filterpy

    problem, n = wide_toy(), 7
    points = filterpy.MerweScaledSigmaPoints(n, 0.3, 2.0, 0.0)
    _, _, h, _, R = vector_models(problem, 0)
    one = filterpy.UnscentedKalmanFilter(n, 6, 1.0, h, None, points)
    one.x, one.P, one.R = problem.prior.x.copy(), problem.prior.P.copy(), R
    track, found = Ukf().run(problem), []
    for k in range(len(problem.epochs)):
        f, Q, _, z, _ = vector_models(problem, k)
        one.Q = Q
        one.predict(fx=f if f is not None else lambda x, dt: x)
        one.update(z)
        found.append(_apart(track.x[k], track.P[k], one.x, one.P))
    return found


def filterpy_kalman_apart() -> tuple[float, float]:
    """Of filter and smoother of a linear pass with irregular epochs, in sigmas."""
    from filterpy.kalman import KalmanFilter

    problem = linear_problem(0.02)
    motion, sensor = problem.processes["motion"], problem.sensors["fix"]
    one = KalmanFilter(6, 3)
    one.x, one.P = problem.prior.x.copy(), problem.prior.P.copy()
    one.H, one.R = np.eye(3, 6), sensor.covariance  # type: ignore[attr-defined]
    xs, Ps, Fs, Qs = [], [], [np.eye(6)], [np.zeros((6, 6))]
    for k, epoch in enumerate(problem.epochs):
        if k:
            u = np.array([[epoch.t - problem.epochs[k - 1].t]])
            _, F, Q = motion.transition(0.0, u, one.x[:3], one.x[3:])
            Fs.append(F)
            Qs.append(Q)
            one.predict(F=F, Q=Q)
        for z in (row for m in epoch.measurements for row in m.z):
            one.update(z)
        xs.append(one.x.copy())
        Ps.append(one.P.copy())
    smooth_x, smooth_P, *_ = one.rts_smoother(np.array(xs), np.array(Ps), Fs, Qs)
    ekf, rts = run_estimator("ekf", problem), run_estimator("rts", problem)
    return (
        max(map(_apart, ekf.x, ekf.P, xs, Ps)),
        max(map(_apart, rts.x, rts.P, smooth_x, smooth_P)),
    )


# --- optima: GTSAM ----------------------------------------------------------------------------


def far(a: Track, b: Track) -> float:
    """Largest difference of two tracks, in sigmas of the second."""
    return float(np.abs(b.layout.local(b.x, a.x) / sigmas(b.P)).max())


def levenberg_marquardt(graph: Graph) -> gtsam.Values:
    """As its documentation has it, but for QR."""
    params = gtsam.LevenbergMarquardtParams()
    params.setLinearSolverType("MULTIFRONTAL_QR")
    params.setRelativeErrorTol(0.0)
    params.setAbsoluteErrorTol(1e-10)
    params.setMaxIterations(8)  # then it only tries what rounding allows
    return gtsam.LevenbergMarquardtOptimizer(graph.factors, graph.values, params).optimize()


def at_the_end(online: Track, optimum: Track) -> float:
    """Of an online estimate at the last epoch, in sigmas of the optimum of all that it has seen."""
    off = optimum.layout.local(optimum.x[-1], online.x[-1])
    return float(np.abs(off / sigmas(optimum.P)[-1]).max())


def marginals_apart(problem: Problem) -> float:
    """Covariances of all epochs of `batch` from those of `gtsam.Marginals` at GTSAM's optimum, as
    correlations. It squares the noises' ratios (Cholesky): only for problems that bear it."""
    batch, graph = run_estimator("batch", problem), to_gtsam(problem)
    theirs, found = gtsam.Marginals(graph.factors, levenberg_marquardt(graph)), []
    for k, P in enumerate(batch.P):
        keys = graph.keys.at(k, problem.layout.moving)
        joint = theirs.jointMarginalCovariance(keys)
        want = np.block([[joint.at(i, j) for j in keys] for i in keys])
        found.append(_correlations_apart(P, want))
    return max(found)


def dense_covariances_apart(graph: Graph, there: gtsam.Values, batch: Track) -> float:
    """Covariances of all epochs of `batch` from those that GTSAM's Jacobian of the whole pass has,
    at its optimum, by NumPy's QR, as correlations. For problems without static blocks."""
    order, layout = gtsam.Ordering(), batch.layout
    for k in range(len(batch.t)):
        for key in graph.keys.at(k, layout):
            order.push_back(key)
    A, _ = graph.factors.linearize(there).jacobian(order)
    scale = np.linalg.norm(A, axis=0)  # QR bears any rows, not any columns
    half = np.linalg.inv(np.linalg.qr(A / scale, mode="r")) / scale[:, None]
    of_epochs = half.reshape(len(batch.t), layout.dim, -1)
    return max(map(_correlations_apart, batch.P, of_epochs @ of_epochs.transpose(0, 2, 1)))


# --- files: ccsds-ndm-py ------------------------------------------------------------------------


def _late(epochs: list[str], epoch: str, t: Array) -> float:
    """How far epochs of a file, in UTC, are from times t (N,), s since an epoch in UTC, by ERFA."""
    found = []
    for text in (epoch.removesuffix(" UTC"), *epochs):
        day, clock = text.split("T")
        fields = [*map(int, day.split("-")), *map(int, clock.split(":")[:2])]
        found.append(erfa.utctai(*erfa.dtf2d("UTC", *fields, float(clock.split(":")[2]))))
    tai = np.array(found)
    return float(np.abs((tai[1:] - tai[0]).sum(axis=1) * 86400 - t).max())


def ccsds_oem_apart(one: Track, epoch: str, path: Path) -> float:
    """States that an OEM of ours has for another reader, m and m/s; infinite where its epochs or
    axes are others. one: a track of the chaser's orbit and attitude."""
    import ccsds_ndm

    write_track("oem", one, path, epoch=epoch)
    (segment,) = ccsds_ndm.Oem.from_file(str(path)).segments
    epochs = [state.epoch for state in segment.data.state_vector]
    if _late(epochs, epoch, one.t) > 1e-9 or segment.metadata.ref_frame != "ICRF":
        return np.inf
    state = np.hstack([one.value("chaser_position"), one.value("chaser_velocity")])
    return float(np.abs(1e3 * segment.data.state_vector_numpy - state).max())


def ccsds_aem_apart(one: Track, epoch: str, path: Path) -> float:
    """Attitudes that an AEM of ours has for another reader and SciPy, as matrices; infinite where
    its epochs or axes are others."""
    import ccsds_ndm

    write_track("aem", one, path, epoch=epoch)
    (segment,) = ccsds_ndm.Aem.from_file(str(path)).segments
    meta, data = segment.metadata, segment.data
    epochs = [state.epoch for state in data.attitude_states]
    axes = (meta.ref_frame_a, meta.ref_frame_b, meta.attitude_type)
    if _late(epochs, epoch, one.t) > 1e-9 or axes != ("ICRF", "SC_BODY_1", "QUATERNION"):
        return np.inf
    # The scalar last, as SciPy has it; from A to B takes components in i to those in c.
    R_ic = Rotation.from_quat(data.attitude_states_numpy).as_matrix()
    return float(np.abs(R_ic - one.value("chaser_attitude")).max())
