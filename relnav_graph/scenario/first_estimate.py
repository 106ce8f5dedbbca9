"""A first estimate from the first measurements, where these suffice.

Blocks whose prior mean is "measured" have no mean beforehand. Sensors with a method `starts`
propose rough values for them from the measurements of one epoch, a frame; each proposal is
improved by least squares on that frame, with the sensors' own residuals. Proposals may end in
different minima: mirror poses of coplanar points, say. Each minimum is a hypothesis, which the
batch smoother extends over a few more frames, rates included; the one that fits best is taken.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.contracts import ProposesStarts
from relnav_graph.core.copies import without_copies
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.core.state import Layout
from relnav_graph.errors import EstimationError
from relnav_graph.estimators.ekf import ITERATIONS, filter_problem
from relnav_graph.estimators.gauss_newton import solve_gated
from relnav_graph.estimators.rts import smooth
from relnav_graph.estimators.source import UNSOLVED
from relnav_graph.linear.assembly import Assembly

__all__ = ["FRAMES", "Hypothesis", "decide", "hypotheses", "initialise", "with_measured"]

_LOG = logging.getLogger(__name__)

#: Difference in cost, half the squared residuals, by which the best hypothesis must fit better
#: than the next: the likelihood ratio is then e^8, 3000 to 1.
DECISIVE = 8.0
#: Epochs over which several hypotheses are told apart.
FRAMES = 6
#: A direction is not seen when its eigenvalue of the frame's information, in units of the
#: prior's sigmas, is below this fraction of the largest one.
UNSEEN = 1e-6


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A minimum: state x (size,) at the first epoch, and half its squared residuals."""

    x: Array
    cost: float


def _same(layout: Layout, a: Array, b: Array, names: Sequence[str]) -> bool:
    """Whether two states are one minimum: attitudes within half a degree, vectors a percent."""
    d = layout.local(a, b)
    for name in names:
        flat = layout.block(name).manifold != "SO3"
        size = np.linalg.norm(a[layout.stored(name)]) if flat else 1.0
        if np.linalg.norm(d[layout.tangent(name)]) > 0.01 * size:
            return False
    return True


def _improve(assembly: Assembly, x: Array, columns: Indices) -> tuple[Array, float, Array]:
    """Least squares on one epoch over some tangent columns (Levenberg-Marquardt).

    Steps d = -(H^T H + damping diag(H^T H))^-1 H^T r of the whitened rows r, H, kept where they
    lower |r|^2, or the number of observations that cannot be computed at x. x (size,).
    Returns x, the cost |r|^2 / 2 (infinite where an observation is left without residual) and
    H (rows, n).
    """
    every, damping = np.ones(assembly.observations), 1e-3
    rows = assembly.measure(x[None], every)
    lost, cost = int((rows.status > 0).sum()), float(rows.r @ rows.r)
    for _ in range(60):
        H = rows.H[:, columns]
        A = H.T @ H
        A[np.diag_indices_from(A)] *= 1 + damping
        d = np.zeros(assembly.layout.dim)
        d[columns] = -np.linalg.lstsq(A, H.T @ rows.r, rcond=None)[0]
        moved = assembly.layout.retract(x, d)
        after = assembly.measure(moved[None], every)
        lost_after, cost_after = int((after.status > 0).sum()), float(after.r @ after.r)
        if lost_after > lost or (lost_after == lost and cost_after > cost):
            damping *= 10
            if damping > 1e8:
                break
            continue
        settled = cost - cost_after < 1e-9 * (1 + cost_after) and lost == lost_after
        x, rows, cost, lost = moved, after, cost_after, lost_after
        damping = max(damping / 10, 1e-12)
        if settled:
            break
    return x, np.inf if lost else 0.5 * cost, rows.H


def _starts(problem: Problem, epoch: Epoch, names: Sequence[str]) -> Iterator[Array]:
    """Rough states at an epoch, from its sensors."""
    layout = problem.layout
    known = {b.name: layout.value(problem.prior.x, b.name) for b in layout if b.name not in names}
    for values in _proposed(problem, epoch, names, known):
        if not values.keys().isdisjoint(names):
            yield layout.pack({**layout.values(problem.prior.x), **values})


def _proposed(
    problem: Problem, epoch: Epoch, names: Sequence[str], known: Mapping[str, Array]
) -> Iterator[dict[str, Array]]:
    """Values of the blocks known, and of all those of `names` that sensors can tell: what one
    of them says of an attitude, say, lets the next one tell a position."""
    for name in names:
        if name in known:
            continue
        told = False
        for m in epoch.measurements:
            sensor = problem.sensors[m.sensor].at(m.t)
            if not isinstance(sensor, ProposesStarts):
                continue
            for values in sensor.starts(m.ids, sensor.accept(m.z), known):
                if name in values:
                    told = True
                    own = {n: v for n, v in values.items() if n in names}
                    yield from _proposed(problem, epoch, names, {**own, **known})
        if told:
            return
    yield dict(known)


def _check_seen(problem: Problem, epoch: Epoch, H: Array, names: Sequence[str]) -> None:
    """Raise EstimationError, naming them, when directions of the blocks are not seen.

    They are eigenvectors of S H^T H S with small eigenvalues; H (rows, n): whitened Jacobian;
    S: the prior's sigmas.
    """
    layout = problem.layout
    _, columns = layout.gather([layout.block(n) for n in names])
    sigma = np.sqrt(np.diag(problem.prior.P))[columns]
    w, V = np.linalg.eigh((H[:, columns] * sigma).T @ (H[:, columns] * sigma))
    weak = w < UNSEEN * max(w[-1], 1e-300)
    if not weak.any():
        return
    labels = [f"{n}[{i}]" for n in names for i in range(layout.block(n).dim)]
    found = []
    for v in V[:, weak].T:
        strong = [i for i in np.argsort(-np.abs(v)) if abs(v[i]) > 0.2]
        found.append(" ".join(f"{v[i]:+.2f} {labels[i]}" for i in strong))
    sensors = ", ".join(f"{m.sensor} ({len(m.z)})" for m in epoch.measurements)
    raise EstimationError(
        f"initialise: the first frame, t = {epoch.t} s, with {sensors or 'no measurement'}, does"
        f" not determine {weak.sum()} directions, in units of the prior's sigmas: "
        + "; ".join(found)
    )


def hypotheses(problem: Problem, names: Sequence[str]) -> list[Hypothesis]:
    """Minima of the first frame's residuals over the blocks `names`, the best first.

    Raises EstimationError, naming what is missing, when there is no sensor that can tell, or
    when it does not see enough.
    """
    # Copies have no values yet: they would draw what they copy to their priors.
    layout, epoch = problem.layout, without_copies(problem.epochs[0], problem.sensors)
    able = [n for n, s in problem.sensors.items() if isinstance(s, ProposesStarts)]
    starts = list(_starts(problem, epoch, names))
    if not starts:
        raise EstimationError(
            f"initialise: nothing at the first epoch, t = {epoch.t} s, says where to start for"
            f" {', '.join(names)}; it takes a frame of one of: {', '.join(able) or 'no sensor'}"
        )
    assembly = Assembly(layout, problem.processes, problem.sensors, [epoch])
    _, columns = layout.gather([layout.block(n) for n in names])
    found: list[Hypothesis] = []
    seen: Array | None = None
    for start in starts:
        x, cost, H = _improve(assembly, start, columns)
        if seen is None or (found and cost < found[0].cost):
            seen = H
        if np.isfinite(cost) and not any(_same(layout, h.x, x, names) for h in found):
            found.append(Hypothesis(x, cost))
            found.sort(key=lambda h: h.cost)
    if seen is not None:
        _check_seen(problem, epoch, seen, names)
    if not found:
        raise EstimationError(
            f"initialise: no pose at the first epoch, t = {epoch.t} s, can be, of"
            f" {len(starts)} tried for {', '.join(names)}"
        )
    # Minima that fit so much worse that noise cannot be the reason are dropped.
    limit = found[0].cost + 25.0 + 0.5 * len(assembly.tables.observations)
    return [h for h in found if h.cost <= limit]


def _extended(problem: Problem, hypothesis: Hypothesis, frames: int) -> Hypothesis:
    """The hypothesis over more frames: its first state, and half the squared residuals."""
    prior = Prior(hypothesis.x, problem.prior.P)
    short = replace(problem, prior=prior, epochs=problem.epochs[:frames])
    done = filter_problem(short, ITERATIONS)
    if done.stopped:
        return Hypothesis(hypothesis.x, np.inf)
    begin = smooth(done, covariances=False)[0]
    try:
        solution = solve_gated(done.assembly, short, begin, done.weights)
    except UNSOLVED:
        return Hypothesis(hypothesis.x, np.inf)
    return Hypothesis(solution.x[0], solution.cost)


def initialise(problem: Problem, names: Sequence[str], frames: int = FRAMES) -> Prior:
    """The prior that `decide` finds; where hypotheses remain in doubt, a warning is logged."""
    prior, doubt = decide(problem, names, frames)
    if doubt:
        _LOG.warning("%s", doubt)
    return prior


def with_measured(problem: Problem, names: Sequence[str]) -> Problem:
    """The problem with the mean of the blocks `names` measured, where there are any: see `decide`.
    Raises EstimationError as that does."""
    if not names:
        return problem
    prior = initialise(replace(problem, considered=()), names)
    return replace(problem, prior=prior, measured=tuple(names))


def decide(problem: Problem, names: Sequence[str], frames: int = FRAMES) -> tuple[Prior, str]:
    """The problem's prior with the mean of the blocks `names` taken from the first frames.

    The covariance stays that of the scenario. It must be wide beside the information of these
    frames, which the estimator uses again as measurements. Several hypotheses are told apart
    over `frames` epochs; where they cannot be, the best is taken, and the text, else "", says
    so. Raises EstimationError as `hypotheses` does.
    """
    found, doubt = hypotheses(problem, names), ""
    if len(found) > 1:
        after = [(_extended(problem, h, frames).cost, h) for h in found]
        after.sort(key=lambda pair: pair[0])
        found = [h for _, h in after]
        if not after[1][0] - after[0][0] > DECISIVE:
            doubt = (
                f"initialise: {len(found)} hypotheses for {', '.join(names)} fit the first"
                f" {min(frames, len(problem.epochs))} epochs about as well (half the squared"
                f" residuals: {[round(c, 1) for c, _ in after]})"
            )
    return Prior(found[0].x, problem.prior.P), doubt
