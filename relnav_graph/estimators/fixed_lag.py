"""Fixed-lag smoother: Gauss-Newton over a window of the newest epochs.

What has left the window stands in one linear summary at its start, made by the same
elimination as the window's own (`relnav_graph.sweep`), at the estimate with which it left.
So the estimate is the full batch's over all that was seen, up to the relinearisation of what
has left; on a linear problem it is the same. Cost and memory of a step are those of the
window, for ever.
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
from relnav_graph.estimators.gating import count_downweighted, count_rejected, lost
from relnav_graph.estimators.packing import pack, unpack
from relnav_graph.problem import SAME_TIME, Epoch, Problem
from relnav_graph.sweep import Anchor, Conditionals, anchor_of, linearize
from relnav_graph.track import Status, Track

__all__ = ["FixedLag", "FixedLagEngine", "Left", "Window"]

Array = NDArray[np.float64]
#: Length of the window where the problem gives none: so many epochs.
EPOCHS = 30


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

    trajectory (K, size): the states of the window; anchor: what is known of the first one
    beforehand. Before anything has left, that is the first epoch's state; then it is that of
    the newest epoch that has left. epochs, parts, weights: those in the window, all or the
    last K - 1. done: the filter's part in the newest epoch; left: what left with it.
    """

    t: float | None
    anchor: Anchor
    trajectory: Array
    P: Array
    epochs: tuple[Epoch, ...] = ()
    parts: tuple[Assembly, ...] = ()
    weights: tuple[Array, ...] = ()
    done: FilterPass | None = None
    left: Left | None = None
    smoothed: Solution | None = None

    @property
    def x(self) -> Array:
        """Estimate at the newest epoch (size,)."""
        x: Array = self.trajectory[-1] if self.t is not None else self.anchor.x
        return x


def _joined(parts: tuple[Assembly, ...], states: int) -> Assembly:
    """The parts of a window with so many states as one."""
    assembly = Assembly.join(parts) if len(parts) > 1 else parts[0]
    return assembly.preceded() if states > len(parts) else assembly


class FixedLagEngine:
    """The window's way from epoch to epoch.

    length: of the window, s; None for `EPOCHS` epochs. tolerance: length of the last
    Gauss-Newton step, in sigmas over all states of the window.
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
        return Window(None, anchor_of(prior), np.zeros((0, len(prior.x))), prior.P)

    def advance(self, state: Window, epoch: Epoch, assembly: Assembly | None = None) -> Window:
        """The window with one more epoch, and without those that are too old now.

        Raises EstimationError, naming the epoch, when there is no estimate.
        """
        p, kalman = self.problem, self._kalman
        if assembly is None:
            assembly = Assembly(p.layout, p.processes, p.sensors, [epoch], state.t)
        kalman.t, kalman.x, kalman.P = state.t, state.x, state.P
        done = kalman.step(epoch, assembly)  # where to start from, and what the gate rejects
        parts, epochs = (*state.parts, assembly), (*state.epochs, epoch)
        weights = (*state.weights, done.weights)
        start = np.concatenate([state.trajectory, kalman.x[None]])
        try:
            solution = solve_gated(
                _joined(parts, len(start)),
                *(p, start, np.concatenate(weights), self.tolerance, state.anchor),
            )
        except UNSOLVED as error:
            raise EstimationError(
                f"t = {epoch.t} s: window of {len(parts)} epochs from {epochs[0].t} s: {error}"
            ) from error
        inverse = np.linalg.inv(solution.conditionals.R[-1])
        P = inverse @ inverse.T
        if not (np.isfinite(solution.x).all() and np.isfinite(P).all()):
            raise EstimationError(f"t = {epoch.t} s: the estimate is not finite")
        edges = np.cumsum([part.observations for part in parts])[:-1]
        weights = tuple(np.split(solution.weights, edges))
        window = Window(
            t=epoch.t,
            anchor=state.anchor,
            trajectory=solution.x,
            P=0.5 * (P + P.T),
            epochs=epochs,
            parts=parts,
            weights=weights,
            done=replace(done, weights=weights[-1]),
            smoothed=solution,
        )
        return self._without_old(window)

    def _without_old(self, w: Window) -> Window:
        """Leave the epochs that are too old to a summary at the newest of them."""
        if self.length is None:
            gone = max(len(w.parts) - EPOCHS, 0)
        else:
            begin = w.epochs[-1].t - self.length - SAME_TIME
            gone = next(k for k, e in enumerate(w.epochs) if e.t >= begin)
        if not gone or w.smoothed is None:
            return w
        lead = len(w.trajectory) - len(w.parts)
        keep = lead + gone - 1  # the state that becomes the first
        assembly = _joined(w.parts[:gone], lead + gone)
        x = w.trajectory[: keep + 1]
        whiten = assembly.whitening(assembly.transition(x[:-1])[2])
        system = linearize(assembly, w.anchor, x, whiten, np.concatenate(w.weights[:gone]))
        c = system.conditionals
        left = Left(
            t=np.array([e.t for e in w.epochs[:gone]]),
            x=x[lead:],
            weights=np.concatenate(w.weights[:gone]),
            first=lead,
            conditionals=w.smoothed.conditionals,
        )
        return replace(
            w,
            anchor=Anchor(x[-1], c.R[-1], c.d[-1]),
            trajectory=w.trajectory[keep:],
            epochs=w.epochs[gone:],
            parts=w.parts[gone:],
            weights=w.weights[gone:],
            left=left,
        )

    def save(self, state: Window) -> dict[str, Array]:
        """The window as plain arrays; its epochs among them."""
        t = np.array(np.nan if state.t is None else state.t)
        a = state.anchor
        out = {"t": t, "x": a.x, "W": a.W, "d": a.d, "trajectory": state.trajectory, "P": state.P}
        out |= {f"weights.{k}": w for k, w in enumerate(state.weights)}
        before = state.parts[0].tables.starts[:1] if state.parts else np.zeros(0)
        return out | {"before": before} | {f"epochs.{k}": v for k, v in pack(state.epochs).items()}

    def load(self, arrays: Mapping[str, Array]) -> Window:
        """The window again."""
        p, a = self.problem, {name: np.array(array) for name, array in arrays.items()}
        epochs = unpack({k.removeprefix("epochs."): v for k, v in a.items() if k[:7] == "epochs."})
        first = float(a["before"][0]) if len(a["before"]) else None
        before = [first, *(e.t for e in epochs)]
        parts = tuple(
            Assembly(p.layout, p.processes, p.sensors, [epoch], t)
            for epoch, t in zip(epochs, before, strict=False)
        )
        weights = tuple(a[f"weights.{k}"] for k in range(len(epochs)))
        t = None if np.isnan(a["t"]) else float(a["t"])
        anchor = Anchor(a["x"], a["W"], a["d"])
        return Window(t, anchor, a["trajectory"], a["P"], tuple(epochs), parts, weights)


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
        first, last = list[Array](), list[Array]()  # weights, of the newest epoch, and later
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
                    end = behind + len(state.left.t)
                    smoothed_x[behind:end] = state.left.x
                    smoothed_P[behind:end] = state.left.covariances()
                    last.append(state.left.weights)
                    behind = end
            assert state.smoothed is not None
            smoothed_x[behind:] = state.trajectory[behind - count :]
            smoothed_P[behind:] = state.smoothed.conditionals.covariances()[behind - count :]
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
            **_counts(assembly, [*last, *state.weights]),
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
