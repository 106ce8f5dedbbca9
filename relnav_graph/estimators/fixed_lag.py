"""Fixed-lag smoother: Gauss-Newton over a window of the newest epochs.

The window is a chain of nodes, eliminated in order of time by the same rows and the same
compiled code as the batch's (`relnav_graph.sweep`). A new epoch adds one node; the others
keep their linearisation until their estimate has moved away from it, and then the chain is
made anew from the first of those on, as in iSAM2 (Kaess et al. 2012), but along one line.
What has left the window stands in one linear summary at its start, at the linearisation with
which it left. So the estimate is the full batch's over all that was seen, up to the
relinearisation of what has left, or has moved by less than `MOVED` sigma; on a linear problem it
is the same. Cost and memory of a step are those of the window, for ever.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from relnav_graph.assembly import Assembly
from relnav_graph.errors import EstimationError
from relnav_graph.estimators.batch import UNSOLVED, Solution, solve_gated
from relnav_graph.estimators.ekf import ITERATIONS, FilterPass, KalmanFilter, judge
from relnav_graph.estimators.gating import (
    count_downweighted,
    count_rejected,
    lost,
    residual_weights,
)
from relnav_graph.estimators.packing import pack, unpack
from relnav_graph.problem import SAME_TIME, Epoch, Problem
from relnav_graph.sweep import Anchor, Conditionals, anchor_of, linearize
from relnav_graph.track import Status, Track

__all__ = ["FixedLag", "FixedLagEngine", "Left", "Node", "Window"]

Array = NDArray[np.float64]
#: Length of the window where the problem gives none: so many epochs.
EPOCHS = 30
#: How far an estimate may be from where it is linearised: in sigmas of what was known of it
#: when it was the newest, over all its states together. The first while nothing has left.
SETTLED, MOVED = 0.01, 0.5
#: Rounds of relinearisation, at most, before a step is searched for with damping; each must
#: halve the distance.
ROUNDS = 5


@dataclass(frozen=True, eq=False)
class Node:
    """An epoch linearised at x (size,) and all before it eliminated.

    U (n, n), u (n,): what is known of its d by then, U d - u ~ N(0, I). R, S (n, n), r (n,): of
    the node before, given this one, R d_before + S d = r; None at the first.
    """

    x: Array
    U: Array
    u: Array
    R: Array | None = None
    S: Array | None = None
    r: Array | None = None


@dataclass(frozen=True, eq=False)
class Left:
    """Epochs that left a window together: t (m,) s, x (m, size), weights of their
    observations. Their covariances wait to be asked for: they cost a pass back through the
    whole window."""

    t: Array
    x: Array
    weights: Array
    first: int
    conditionals: Conditionals

    def covariances(self) -> Array:
        """P (m, n, n)."""
        return self.conditionals.covariances()[self.first : self.first + len(self.t)]


@dataclass(frozen=True, eq=False)
class Window:
    """The smoother at one epoch: an immutable value.

    nodes: the K states of the window; d (K, n): their estimates, from where they are
    linearised. anchor: what is known of the first one beforehand. Before anything has left,
    that is the first epoch's state; then it is that of the newest epoch that has left.
    x (size,), P (n, n): the newest state. epochs, parts, weights: those in the window, all or
    the last K - 1. done: the filter's part in the newest epoch; left: what left with it.
    """

    t: float | None
    anchor: Anchor
    x: Array
    P: Array
    nodes: tuple[Node, ...] = ()
    d: Array | None = None
    epochs: tuple[Epoch, ...] = ()
    parts: tuple[Assembly, ...] = ()
    weights: tuple[Array, ...] = ()
    done: FilterPass | None = None
    left: Left | None = None

    @property
    def lead(self) -> int:
        """1 when the first node is of an epoch that has left, else 0."""
        return len(self.nodes) - len(self.parts)

    @property
    def joined(self) -> Assembly:
        """The parts as one, for all nodes."""
        assembly = Assembly.join(self.parts) if len(self.parts) > 1 else self.parts[0]
        return assembly.preceded() if self.lead else assembly

    @property
    def trajectory(self) -> Array:
        """The states of the window (K, size)."""
        x = np.array([node.x for node in self.nodes]).reshape(-1, len(self.x))
        return x if self.d is None else self.parts[0].layout.retract(x, self.d)


def _conditionals(nodes: Sequence[Node]) -> Conditionals:
    newest, n = nodes[-1], len(nodes[-1].u)
    R = np.array([*(node.R for node in nodes[1:]), newest.U])
    S = np.array([node.S for node in nodes[1:]]).reshape(-1, n, n)
    return Conditionals(R, S, np.array([*(node.r for node in nodes[1:]), newest.u]))


def _node(w: Window, k: int, x: Array, before: Node | None) -> Node:
    """Node k of a window, linearised at x (size,).

    Raises EstimationError when an observation that counts is impossible there.
    """
    i = k - w.lead
    if i < 0:
        e, A = w.anchor.rows(w.parts[0].layout, x)
        return Node(x, A, -e)
    part, n = w.parts[i], len(w.anchor.d)
    if before is None:
        system = linearize(part, w.anchor, x[None], np.zeros((0, n, n)), w.weights[i])
    else:
        part, both = part.preceded(), np.array([before.x, x])
        whiten = part.whitening(part.transition(both[:1])[2])
        anchor = Anchor(before.x, before.U, before.u)
        system = linearize(part, anchor, both, whiten, w.weights[i])
    if system.status.any():
        raise EstimationError("an observation has become impossible")
    c = system.conditionals
    if before is None:
        return Node(x, c.R[0], c.d[0])
    return Node(x, c.R[1], c.d[1], c.R[0], c.S[0], c.d[0])


def _relinearized(w: Window, x: Array, first: int = 0) -> Window:
    """The window with its nodes from `first` on linearised at x (K, size), and solved."""
    nodes = list(w.nodes)
    for k in range(first, len(nodes)):
        nodes[k] = _node(w, k, x[k], nodes[k - 1] if k else None)
    return replace(w, nodes=tuple(nodes), d=_conditionals(nodes).solution())


class FixedLagEngine:
    """The window's way from epoch to epoch.

    length: of the window, s; None for `EPOCHS` epochs. tolerance: of `solve_gated`.
    """

    compact = True

    def __init__(
        self, problem: Problem, length: float | None = None, tolerance: float = 1e-3
    ) -> None:
        self.problem, self.length, self.tolerance = problem, length, tolerance
        self._kalman = KalmanFilter(problem, ITERATIONS)

    def begin(self) -> Window:
        """At the prior, before the first epoch."""
        prior = self.problem.prior
        return Window(None, anchor_of(prior), prior.x, prior.P)

    def advance(self, state: Window, epoch: Epoch, assembly: Assembly | None = None) -> Window:
        """The window with one more epoch, and without those that are too old now.

        Raises EstimationError, naming the epoch, when there is no estimate.
        """
        p, kalman = self.problem, self._kalman
        if assembly is None:
            assembly = Assembly(p.layout, p.processes, p.sensors, [epoch], state.t)
        kalman.t, kalman.x, kalman.P = state.t, state.x, state.P
        done = kalman.step(epoch, assembly)  # where to start from, and what the gate rejects
        newest = Node(kalman.x, np.zeros_like(kalman.P), np.zeros(len(kalman.P)))
        longer = replace(
            state,
            t=epoch.t,
            nodes=(*state.nodes, newest),
            d=None if state.d is None else np.vstack([state.d, newest.u]),
            epochs=(*state.epochs, epoch),
            parts=(*state.parts, assembly),
            weights=(*state.weights, done.weights),
        )
        window = self._extended(longer)
        if window is None:
            window = self._solved(longer)
        assert window.d is not None
        x = p.layout.retract(window.nodes[-1].x, window.d[-1])
        inverse = np.linalg.inv(window.nodes[-1].U)
        P = inverse @ inverse.T
        if not (np.isfinite(x).all() and np.isfinite(P).all()):
            raise EstimationError(f"t = {epoch.t} s: the estimate is not finite")
        done = replace(done, weights=window.weights[-1])
        return self._without_old(replace(window, x=x, P=0.5 * (P + P.T), done=done, left=None))

    def _extended(self, w: Window) -> Window | None:
        """The window linearised anew only where it must be; None when that is not enough: an
        observation is not to count fully, or the way to the minimum is long."""
        if self.problem.losses or not all((weights == 1).all() for weights in w.weights):
            return None
        limit, first, before = MOVED if w.lead else SETTLED, len(w.nodes) - 1, np.inf
        x = np.array([node.x for node in w.nodes])
        try:
            for _ in range(ROUNDS):
                w = _relinearized(w, x, first)
                assert w.d is not None
                U = np.array([node.U for node in w.nodes])
                moved = np.sqrt(np.square(U @ w.d[:, :, None]).sum(axis=(1, 2)))
                far = np.flatnonzero(moved > limit)
                if not len(far):
                    return w if self._fits(w) else None
                if not moved.max() < 0.5 * before:
                    return None
                first, before, x = int(far[0]), moved.max(), w.trajectory
        except UNSOLVED:
            pass
        return None

    def _fits(self, w: Window) -> bool:
        """Whether no residual of the window is beyond its gate."""
        if not self.problem.gates:
            return True
        assembly = w.joined
        rows = assembly.measure(w.trajectory, np.ones(assembly.observations))
        return bool((residual_weights(assembly, rows, self.problem.gates, {}) == 1).all())

    def solve(self, w: Window) -> Solution:
        """The minimum over the window, with weights taken anew and steps damped."""
        weights = np.concatenate(w.weights)
        return solve_gated(
            w.joined, self.problem, w.trajectory, weights, self.tolerance, w.anchor
        )

    def _solved(self, w: Window) -> Window:
        """The window at its minimum. Raises EstimationError when there is none."""
        try:
            solution = self.solve(w)
            edges = np.cumsum([part.observations for part in w.parts])[:-1]
            weights = tuple(np.split(solution.weights, edges))
            return _relinearized(replace(w, weights=weights), solution.x)
        except UNSOLVED as error:
            raise EstimationError(
                f"t = {w.t} s: window of {len(w.parts)} epochs from {w.epochs[0].t} s: {error}"
            ) from error

    def _without_old(self, w: Window) -> Window:
        """Leave the epochs that are too old to a summary at the newest of them."""
        if self.length is None:
            gone = max(len(w.parts) - EPOCHS, 0)
        else:
            begin = w.epochs[-1].t - self.length - SAME_TIME
            gone = next(k for k, e in enumerate(w.epochs) if e.t >= begin)
        if not gone or w.d is None:
            return w
        keep = w.lead + gone - 1  # the state that becomes the first
        first = w.nodes[keep]
        left = Left(
            t=np.array([e.t for e in w.epochs[:gone]]),
            x=w.trajectory[w.lead : keep + 1],
            weights=np.concatenate(w.weights[:gone]),
            first=w.lead,
            conditionals=_conditionals(w.nodes),
        )
        return replace(
            w,
            anchor=Anchor(first.x, first.U, first.u),
            nodes=w.nodes[keep:],
            d=w.d[keep:],
            epochs=w.epochs[gone:],
            parts=w.parts[gone:],
            weights=w.weights[gone:],
            left=left,
        )

    def save(self, state: Window) -> dict[str, Array]:
        """The window as plain arrays; its epochs among them."""
        t = np.array(np.nan if state.t is None else state.t)
        a, linearized = state.anchor, np.array([node.x for node in state.nodes])
        out = {"t": t, "W": a.W, "d": a.d, "anchor": a.x, "x": state.x, "P": state.P}
        out |= {"linearized": linearized.reshape(-1, len(state.x))}
        out |= {f"weights.{k}": w for k, w in enumerate(state.weights)}
        before = state.parts[0].tables.starts[:1] if state.parts else np.zeros(0)
        return out | {"before": before} | {f"epochs.{k}": v for k, v in pack(state.epochs).items()}

    def load(self, arrays: Mapping[str, Array]) -> Window:
        """The window again."""
        p, a = self.problem, {name: np.array(array) for name, array in arrays.items()}
        epochs = unpack({k.removeprefix("epochs."): v for k, v in a.items() if k[:7] == "epochs."})
        first = float(a["before"][0]) if len(a["before"]) else None
        before = [first, *(e.t for e in epochs)]
        window = Window(
            t=None if np.isnan(a["t"]) else float(a["t"]),
            anchor=Anchor(a["anchor"], a["W"], a["d"]),
            x=a["x"],
            P=a["P"],
            nodes=tuple(Node(x, a["W"], a["d"]) for x in a["linearized"]),
            epochs=tuple(epochs),
            parts=tuple(
                Assembly(p.layout, p.processes, p.sensors, [epoch], t)
                for epoch, t in zip(epochs, before, strict=False)
            ),
            weights=tuple(a[f"weights.{k}"] for k in range(len(epochs))),
        )
        return _relinearized(window, a["linearized"]) if epochs else window


@dataclass(frozen=True)
class FixedLag:
    """Gauss-Newton over the newest `window` seconds, all that is older in one summary.

    window: s; None for the problem's, or, where it has none, 30 epochs. Gives two tracks:
    the current epoch's estimates as they came, and, as `smoothed`, each epoch as it left
    the window (those still in it as they are in the end).
    """

    kind: ClassVar[str] = "fixed_lag"
    window: float | None = None

    def engine(self, problem: Problem) -> FixedLagEngine:
        """For use online."""
        return FixedLagEngine(problem, problem.window if self.window is None else self.window)

    def run(self, problem: Problem) -> Track:
        """Estimate the pass epoch by epoch."""
        start, engine, layout = time.perf_counter(), self.engine(problem), problem.layout
        count, state, assembly = len(problem.epochs), engine.begin(), Assembly.of(problem)
        x, smoothed_x = np.full((2, count, layout.size), np.nan)
        P, smoothed_P = np.full((2, count, layout.dim, layout.dim), np.nan)
        seconds, misfit, used, behind = list[float](), 0.0, 0, 0
        # Weights: of the newest epoch, as it left, in the end.
        first, last, final = list[Array](), list[Array](), list[Array]()
        status: Status = "diverged"
        try:
            for k, epoch in enumerate(problem.epochs):
                begun = time.perf_counter()
                state = engine.advance(state, epoch, assembly.at(k))
                seconds.append(time.perf_counter() - begun)
                x[k], P[k], done = state.x, state.P, state.done
                assert done is not None
                misfit, used = misfit + float(done.nis[0]), used + int(done.used[0])
                first.append(done.weights)
                if state.left is not None:
                    gone = slice(behind, behind + len(state.left.t))
                    smoothed_x[gone] = state.left.x
                    smoothed_P[gone] = state.left.covariances()
                    last.append(state.left.weights)
                    behind = gone.stop
            end = engine.solve(state)
            final = [end.weights]
            smoothed_x[behind:] = end.x[behind - count :]
            smoothed_P[behind:] = end.conditionals.covariances()[behind - count :]
            status, message = judge(lost(assembly, np.concatenate(first)), problem, misfit, used)
        except UNSOLVED as error:
            message = str(error)
        own: dict[str, Any] = {"layout": layout, "t": problem.times}
        own |= {"status": status, "message": message}
        smoothed = Track(
            name=f"{self.kind}_smoothed",
            kind="fixed-lag",
            x=smoothed_x,
            P=smoothed_P,
            runtime_s=time.perf_counter() - start,
            **_counts(assembly, [*last, *final]),
            **own,
        )
        return Track(
            name=self.kind,
            kind="filtered",
            x=x,
            P=P,
            runtime_s=sum(seconds),
            step_s=np.array(seconds),
            smoothed=smoothed,
            **_counts(assembly, first),
            **own,
        )


def _counts(assembly: Assembly, weights: Sequence[Array]) -> dict[str, Any]:
    """Observations rejected and down-weighted in the epochs reached, by sensor."""
    every = np.ones(assembly.observations)
    reached = np.concatenate([np.zeros(0), *weights])
    every[: len(reached)] = reached
    return {
        "rejected": count_rejected(assembly, every),
        "downweighted": count_downweighted(assembly, every),
    }
