"""Our factors beside GTSAM's own, in an iSAM2 graph of your making.

A chaser turns and drifts past a target that keeps its attitude in the orbital frame o.
Over 20 epochs, 10 s apart, we want the chaser's attitude, the relative position and
velocity, and the target's attitude.

    variable   meaning                                GTSAM type
    c0 .. c19  R_oc, chaser attitude                  Rot3
    p0 .. p19  r_tc_o, relative position, m           Vector(3)
    v0 .. v19  r_tc_o', relative velocity, m/s        Vector(3)
    t0         R_ot, target attitude                  Rot3

    [prior]--c0---[between]---c1---[between]---c2 ...     GTSAM's PriorFactorRot3, BetweenFactorRot3
              |               |               |
           [beacons]       [beacons]       [beacons]      measurement_factor: ours, on c, t0, p
            |   |           |   |           |   |
    [prior]-t0  p0--[orbit]--p1 t0 --[orbit]-- p2 t0      process_factor: ours, on p, v, p', v'
                v0 /        v1 /              v2

QR is chosen because GTSAM's default factorisation, Cholesky, rejects ordinary ratios of process to
state noise. `ISAM2` then throws; `LevenbergMarquardtOptimizer` gives back what it began with after
0 iterations, without an error. `why_qr` shows it, and that the package makes the whole graph of a
problem by itself (`relnav_graph.to_gtsam`), or puts your factors into its own estimator:
``run_estimator("isam2", problem, extra=Extra(factors, values))``.

Run it: ``python experiments/native_gtsam.py``
"""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, P, T, V
from relnav_factors.dynamics.eccentric_relative_motion import EccentricRelativeMotion
from relnav_factors.sensors.beacon_los import BeaconLineOfSight

from relnav_graph.core.catalogue import (
    CHASER_ATTITUDE,
    RELATIVE_POSITION,
    RELATIVE_VELOCITY,
    TARGET_ATTITUDE,
)
from relnav_graph.core.measurement import Measurement
from relnav_graph.linear.gtsam_factors import (
    insert_block,
    measurement_factor,
    process_factor,
    read_block,
)
from relnav_graph.maths import dense, so3
from relnav_graph.maths.orbit import KeplerOrbit
from relnav_graph.runs.graph import to_gtsam
from relnav_graph.scenario.build import load_scenario

EPOCHS, STEP = 20, 10.0


def main() -> dict[str, float]:
    """Estimate; the errors of the last epoch, rad and m."""
    rng = np.random.default_rng(1)
    points = np.array([[0.5, 0.5, 0.0], [-0.5, -0.5, 0.0], [-0.5, 0.5, 0.0], [0.2, 0.5, 0.4]])
    beacons = BeaconLineOfSight(points=points, sigma=1e-4)
    orbit = EccentricRelativeMotion(
        orbit=KeplerOrbit(7.2e6, 0.05), acceleration_density=1e-6, gravity="exact"
    )
    turn = np.array([0.0, 0.0, 1e-3 * STEP])  # of the chaser in one step, in c

    R_oc, R_ot = so3.exp(np.array([0.1, 0.2, -0.3])), so3.exp(np.array([0.4, -0.1, 0.2]))
    r, v = np.array([3.0, 10.0, 2.0]), np.array([0.0, -0.02, 0.01])

    params = gtsam.ISAM2Params()
    params.setFactorization("QR")
    params.relinearizeSkip = 1
    params.setRelinearizeThreshold(1e-4)
    isam = gtsam.ISAM2(params)
    between = gtsam.noiseModel.Isotropic.Sigma(3, 1e-4)
    estimate = gtsam.Values()
    for k in range(EPOCHS):
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if k == 0:
            start = gtsam.Rot3(dense.matmul(R_oc, so3.exp(rng.normal(0, 0.01, 3))))
            guess_r, guess_v = r + rng.normal(0, 0.2, 3), v + rng.normal(0, 1e-3, 3)
            attitude = gtsam.noiseModel.Isotropic.Sigma(3, 0.01)
            graph.add(gtsam.PriorFactorRot3(C(0), start, attitude))
            graph.add(
                gtsam.PriorFactorVector(P(0), guess_r, gtsam.noiseModel.Isotropic.Sigma(3, 0.2))
            )
            graph.add(
                gtsam.PriorFactorVector(V(0), guess_v, gtsam.noiseModel.Isotropic.Sigma(3, 1e-3))
            )
            R_ot_guess = dense.matmul(R_ot, so3.exp(rng.normal(0, 0.05, 3)))
            graph.add(
                gtsam.PriorFactorRot3(
                    T(0), gtsam.Rot3(R_ot_guess), gtsam.noiseModel.Isotropic.Sigma(3, 0.05)
                )
            )
            values.insert(C(0), start)
            insert_block(values, T(0), TARGET_ATTITUDE, R_ot_guess)
        else:
            u = np.array([[STEP]])
            before = (guess_r, guess_v)
            t0 = (k - 1) * STEP
            graph.add(
                process_factor(orbit, t0, u, (P(k - 1), V(k - 1)), (P(k), V(k)), noise_at=before)
            )
            measured = gtsam.Rot3(so3.exp(turn + rng.normal(0, 1e-4, 3)))
            graph.add(gtsam.BetweenFactorRot3(C(k - 1), C(k), measured, between))
            guess_r, guess_v = orbit.propagate(t0, u, *before)
            r, v = orbit.propagate(t0, u, r, v)
            R_oc = dense.matmul(R_oc, so3.exp(turn))
            values.insert(C(k), estimate.atRot3(C(k - 1)).compose(measured))
        insert_block(values, P(k), RELATIVE_POSITION, guess_r)
        insert_block(values, V(k), RELATIVE_VELOCITY, guess_v)
        ids = beacons.observables()
        seen = beacons.perturb(
            beacons.predict(ids, R_oc, R_ot, r), rng.normal(0, beacons.sigma, (len(ids), 2))
        )
        m = Measurement("beacons", k * STEP, seen, ids)
        graph.add(measurement_factor(beacons, m, (C(k), T(0), P(k))))

        held = isam.getLinearizationPoint()  # without this, GTSAM copies it for each call
        isam.update(graph, values)
        del held
        estimate = isam.calculateEstimate()
        guess_r = read_block(estimate, P(k), RELATIVE_POSITION)
        guess_v = read_block(estimate, V(k), RELATIVE_VELOCITY)

    found = {
        "chaser attitude [rad]": CHASER_ATTITUDE.local(
            R_oc, read_block(estimate, C(EPOCHS - 1), CHASER_ATTITUDE)
        ),
        "target attitude [rad]": TARGET_ATTITUDE.local(
            R_ot, read_block(estimate, T(0), TARGET_ATTITUDE)
        ),
        "relative position [m]": guess_r - r,
    }
    errors = {name: float(np.linalg.norm(e)) for name, e in found.items()}
    for name, error in errors.items():
        print(f"error of the {name}: {error:.2g}")
    return errors


def why_qr(epochs: int = 40) -> dict[str, tuple[int, float]]:
    """Iterations, and error left, of GTSAM's optimiser by linear solver, on one graph."""
    scenario = load_scenario(
        Path(__file__).with_name("zhang2015_close.toml"), [f"time.epochs={epochs}"]
    )
    graph = to_gtsam(scenario.problem(scenario.simulate(0), 0))
    found = {}
    for solver in ("MULTIFRONTAL_CHOLESKY", "MULTIFRONTAL_QR"):
        params = gtsam.LevenbergMarquardtParams()  # Cholesky is its default
        params.setLinearSolverType(solver)
        params.setMaxIterations(8)
        optimizer = gtsam.LevenbergMarquardtOptimizer(graph.factors, graph.values, params)
        optimizer.optimize()
        found[solver] = (optimizer.iterations(), optimizer.error())
        print(f"{solver}: {found[solver][0]} iterations, error {found[solver][1]:.6g}")
    return found


if __name__ == "__main__":
    main()
    why_qr()
