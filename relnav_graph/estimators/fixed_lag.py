"""Fixed-lag smoother: Gauss-Newton over a window of the newest epochs.

The window is a chain of nodes, eliminated in order of time by the same rows and the same
compiled code as the batch's (`relnav_graph.linear.elimination`). A new epoch adds one node; the
others keep their linearisation until their estimate has moved away from it, and then the chain is
made anew from the first of those on, as in iSAM2 (Kaess et al. 2012), but along one line.
What has left the window stands in one linear summary at its start, at the linearisation with
which it left. So the estimate is the full batch's over all that was seen, up to the
relinearisation of what has left, or has moved by less than `MOVED` sigma; on a linear problem it
is the same. Cost and memory of a step are those of the window, for ever.

Why not GTSAM's ISAM2 with a constrained ordering and `marginalizeLeaves`: on the same rows it
gives the same numbers (`tests/test_fixed_lag.py`) and takes 1.8 times as long, without
relinearising anything (2.24 ms a step, median, against 1.24 ms; on average 2.25 against 1.94).
Of what keeping linearisations costs, 0.007 sigma in the median and 0.036 at most, the same
command tells: `python experiments/window_accuracy.py experiments/zhang2015_close.toml`.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.measurement import SAME_TIME
from relnav_graph.core.packing import pack, packed_time, time_in, under, unpack
from relnav_graph.core.problem import Problem, lengthened, padded
from relnav_graph.core.track import Track, estimates
from relnav_graph.errors import EstimationError
from relnav_graph.estimators.ekf import ITERATIONS, FilterState, filter_step
from relnav_graph.estimators.first_sights import has_map, turned_between
from relnav_graph.estimators.gauss_newton import Solution, solve_gated
from relnav_graph.estimators.incremental import RATIO, IncrementalSmoother
from relnav_graph.estimators.source import UNSOLVED, RecordedSource, Source, drive
from relnav_graph.estimators.trust import judge
from relnav_graph.estimators.weights import (
    count_downweighted,
    count_rejected,
    left_out,
    lost,
    residual_weights,
    retired,
)
from relnav_graph.estimators.window import Left, Window, linearized
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import Anchor, anchor_of, grown

__all__ = ["FixedLag", "FixedLagEngine"]

#: Length of the window where the problem gives none: so many epochs.
EPOCHS = 30
#: How far an estimate may be from where it is linearised: in sigmas of what was known of it
#: when it was the newest, over all its states together. The first while nothing has left.
SETTLED, MOVED = 0.01, 1.0
#: By how much the target must have turned before an epoch of a pass with a map may leave, rad.
BEGUN = 4 * np.pi
#: Rounds of relinearisation, at most, before a step is searched for with damping; each must
#: halve the distance.
ROUNDS = 5


class FixedLagEngine:
    """Carries the window of the smoother from epoch to epoch.

    length: of the window, s; None for `EPOCHS` epochs. tolerance: of `solve_gated`.
    """

    compact = True

    def __init__(
        self, problem: Problem, length: float | None = None, tolerance: float = 1e-3
    ) -> None:
        problem.expect_none_considered("a fixed-lag smoother")
        self.problem, self.length, self.tolerance = problem, length, tolerance

    def begin(self) -> Window:
        """At the prior, before the first epoch."""
        prior = self.problem.prior
        return Window(None, anchor_of(prior), prior.x, prior.P)

    def advance(self, state: Window, epoch: Epoch, assembly: Assembly | None = None) -> Window:
        """The window with one more epoch, and without those that are too old now.

        Raises EstimationError, naming the epoch, when there is no estimate.
        """
        p = self.problem
        if assembly is None:
            assembly = Assembly.ahead(p, epoch, state.t)
        if state.turned < BEGUN and has_map(p.layout):
            return self._beginning(state, epoch, assembly)
        # Where to start from, and what the gate rejects.
        before = FilterState(state.t, state.x, state.P)
        done = filter_step(p, ITERATIONS, before, epoch, assembly)
        longer = replace(
            state,
            t=epoch.t,
            epochs=(*state.epochs, epoch),
            parts=(*state.parts, assembly),
            weights=(*state.weights, done.weights),
        )
        window = self._extended(longer, done.end.x)
        if window is None:
            window = self._solved(longer, done.end.x)
        chain = window.chain
        assert chain is not None
        x, P = chain.estimates(p.layout, slice(-1, None))[0], chain.conditionals.last_covariance()
        P = 0.5 * (P + P.T)
        if not (np.isfinite(x).all() and np.isfinite(P).all()):
            raise EstimationError(f"t = {epoch.t} s: the estimate is not finite")
        if window.weights[-1] is not done.weights:
            done = replace(done, weights=window.weights[-1])
        return self._without_old(replace(window, x=x, P=P, done=done, left=None))

    def _beginning(self, state: Window, epoch: Epoch, assembly: Assembly) -> Window:
        """The window of a pass with a map until it has been seen from all sides: with all epochs,
        since what leaves is linearised for good, in an incremental smoother."""
        smoother = IncrementalSmoother(self.problem, RATIO)
        begun = smoother.advance(state.begun or smoother.begin(), epoch, assembly)
        assert begun.done is not None
        before = begun.x if state.t is None else state.x
        window = Window(
            *(epoch.t, state.anchor, begun.x, begun.P),
            epochs=(*state.epochs, epoch),
            parts=(*state.parts, assembly),
            weights=(*state.weights, begun.done.weights),
            done=begun.done,
            turned=state.turned + turned_between(self.problem.layout, before, begun.x),
            begun=begun,
        )
        return window if window.turned < BEGUN else self._without_old(self.whole(window))

    def whole(self, w: Window) -> Window:
        """A window of all epochs, with its chain at the minimum."""
        if w.begun is None:
            return w
        smoother = IncrementalSmoother(self.problem, RATIO)
        smoother.state = w.begun
        solution = smoother.finish()[1]
        edges = np.cumsum([part.observations for part in w.parts])[:-1]
        w = replace(w, weights=tuple(np.split(solution.weights, edges)), begun=None)
        return replace(w, chain=linearized(w, solution.x))

    def _extended(self, w: Window, newest: Array) -> Window | None:
        """The window relinearised only where it must be.

        newest (size,): first estimate of the newest epoch. None when that is not enough: when
        the gates now decide otherwise, or the minimum is far.
        """
        if self.problem.losses:  # each step changes every weight a little
            return None
        layout, old = self.problem.layout, w.chain
        x = newest[None] if old is None else np.concatenate([old.x, newest[None]])
        limit, first, before = MOVED if w.lead else SETTLED, len(x) - 1, np.inf
        try:
            for _ in range(ROUNDS):
                chain = linearized(w, x, first)
                w, moved = replace(w, chain=chain), chain.moved()
                far = np.flatnonzero(moved > limit)
                if not len(far):
                    return w if self._fits(w) else None
                if not moved.max() < 0.5 * before:
                    return None
                first, before, x = int(far[0]), moved.max(), chain.estimates(layout)
        except UNSOLVED:
            pass
        return None

    def _fits(self, w: Window) -> bool:
        """Whether the gates, at the window's residuals, still leave out the same observations."""
        before = np.concatenate(w.weights)
        if w.chain is None or (not self.problem.gates and before.min(initial=1.0) == 1):
            return True
        assembly, x = w.joined, w.chain.estimates(self.problem.layout)
        rows = assembly.measure(x, np.ones(assembly.observations))
        weights = residual_weights(assembly, rows, self.problem.gates, {})
        return bool((weights == before).all())

    def solve(self, w: Window, x: Array) -> Solution:
        """The minimum over the window, searched for from x (K, size) with damped steps and
        weights renewed."""
        weights = np.concatenate(w.weights)
        return solve_gated(w.joined, self.problem, x, weights, self.tolerance, w.anchor)

    def _solved(self, w: Window, newest: Array) -> Window:
        """The window at its minimum, by a full search. Raises EstimationError when there is
        none."""
        old = [] if w.chain is None else [w.chain.estimates(self.problem.layout)]
        try:
            solution = self.solve(w, np.concatenate([*old, newest[None]]))
            edges = np.cumsum([part.observations for part in w.parts])[:-1]
            w = replace(w, weights=tuple(np.split(solution.weights, edges)))
            return replace(w, chain=linearized(w, solution.x))
        except UNSOLVED as error:
            raise EstimationError(
                f"t = {w.t} s: window of {len(w.parts)} epochs from {w.epochs[0].t} s: {error}"
            ) from error

    def _without_old(self, w: Window) -> Window:
        """Replace the epochs that are too old by a linear summary at the newest of them."""
        if self.length is None:
            gone = max(len(w.parts) - EPOCHS, 0)
        else:
            begin = w.epochs[-1].t - self.length - SAME_TIME
            gone = next(k for k, e in enumerate(w.epochs) if e.t >= begin)
        if not gone or w.chain is None:
            return w
        keep = w.lead + gone - 1  # the state that becomes the first
        left = Left(
            t=np.array([e.t for e in w.epochs[:gone]]),
            x=w.chain.estimates(self.problem.layout, slice(w.lead, keep + 1)),
            weights=np.concatenate(w.weights[:gone]),
            first=w.lead,
            conditionals=w.chain.conditionals,
        )
        return replace(
            w,
            anchor=w.chain.summary(keep),
            chain=w.chain.since(keep),
            epochs=w.epochs[gone:],
            parts=w.parts[gone:],
            weights=w.weights[gone:],
            left=left,
        )

    def grown(self, state: Window, before: FixedLagEngine) -> Window:
        """The state of an engine whose problem has fewer numbered blocks: linearised anew."""
        if state.t is None:
            return self.begin()
        layout, prior = self.problem.layout, self.problem.prior
        x, P = padded(prior, state.x, state.P)
        parts = tuple(part.within(layout) for part in state.parts)
        window = replace(state, x=x, P=P, parts=parts, anchor=grown(state.anchor, prior))
        if state.begun is not None:
            smoother = IncrementalSmoother(self.problem, RATIO)
            return replace(window, begun=smoother.grown(state.begun, smoother))
        assert state.chain is not None
        at = lengthened(prior, state.chain.estimates(before.problem.layout))
        return replace(window, chain=linearized(replace(window, chain=None), at))

    def save(self, state: Window) -> dict[str, Array]:
        """The window and its epochs as plain arrays by name.

        t (), s, NaN before the first epoch; turned (), rad; x (size,), P (n, n): the newest state;
        anchor (size,), W (n, n), d (n,): the anchor's state, matrix and vector; chain (K, size):
        where the states are linearised; ``weights.k`` (observations,); before (1,), s: start of the
        first interval, (0,) without one; ``epochs.*``: see `relnav_graph.core.packing.pack`.
        """
        t, a = packed_time(state.t), state.anchor
        out = {"t": t, "W": a.W, "d": a.d, "anchor": a.x, "x": state.x, "P": state.P}
        if state.chain is not None:
            out["chain"] = state.chain.x
        out["turned"] = np.array(state.turned)
        out |= {f"weights.{k}": w for k, w in enumerate(state.weights)}
        before = state.parts[0].tables.starts[:1] if state.parts else np.zeros(0)
        return out | {"before": before} | {f"epochs.{k}": v for k, v in pack(state.epochs).items()}

    def load(self, arrays: Mapping[str, Array]) -> Window:
        """The window that `save` made `arrays` of: x (size,), P (n, n) and so on."""
        p, a = self.problem, {name: np.array(array) for name, array in arrays.items()}
        epochs = unpack(under(a, "epochs."))
        first = float(a["before"][0]) if len(a["before"]) else None
        before = [first, *(e.t for e in epochs)]
        if epochs and "chain" not in a:  # of a pass with a map, at its beginning
            window = self.begin()
            for epoch in epochs:
                window = self.advance(window, epoch)
            return window
        window = Window(
            t=time_in(a["t"]),
            anchor=Anchor(a["anchor"], a["W"], a["d"]),
            x=a["x"],
            P=a["P"],
            epochs=tuple(epochs),
            parts=tuple(
                Assembly.ahead(p, epoch, t) for epoch, t in zip(epochs, before, strict=False)
            ),
            weights=tuple(a[f"weights.{k}"] for k in range(len(epochs))),
            turned=float(a["turned"]),
        )
        return replace(window, chain=linearized(window, a["chain"])) if epochs else window


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
        return self.drive(RecordedSource(problem))

    def drive(self, source: Source) -> Track:
        """Estimate epochs as they come."""
        engine = self.engine(source.problem)
        kept = _Kept(engine.begin())
        done, begun = drive(source, engine, kept.notice), time.perf_counter()
        problem, assembly = done.problem, Assembly.of(done.problem)
        x, P = np.full_like(done.x, np.nan), np.full_like(done.P, np.nan)
        if kept.x:
            behind = sum(len(part) for part in kept.x)
            x[:behind], P[:behind] = np.concatenate(kept.x), np.concatenate(kept.P)
        status, message, last = "diverged", done.stopped, kept.weights
        if not done.stopped:
            try:
                kept.newest = engine.whole(kept.newest)
                inside, chain = len(kept.newest.epochs), kept.newest.chain
                assert chain is not None
                end = engine.solve(kept.newest, chain.estimates(problem.layout))
                last = [*last, end.weights]
                x[-inside:] = end.x[-inside:]
                P[-inside:] = end.conditionals.marginals().whole()[-inside:]
                away = lost(assembly, np.concatenate(kept.first))
                status, message = judge(away, problem, kept.misfit, kept.used)
            except UNSOLVED as error:
                message = str(error)
        ended = {"kind": "fixed-lag", **estimates(problem.layout, x, P)} | _counts(assembly, last)
        found = {"status": status, "message": message} | _counts(assembly, kept.first)
        return done.tracks(self.kind, ended, time.perf_counter() - begun, **found)


@dataclass
class _Kept:
    """What is wanted, when all epochs have come, of the windows on the way.

    newest: the last one; misfit, used: normalised innovations squared, and their number, of all
    epochs; first: weights of each epoch when it was the newest; x, P, weights: of each part of
    the pass as it left.
    """

    newest: Window
    misfit: float = 0.0
    used: int = 0
    first: list[Array] = field(default_factory=list)
    x: list[Array] = field(default_factory=list)
    P: list[Array] = field(default_factory=list)
    weights: list[Array] = field(default_factory=list)

    def notice(self, w: Window) -> None:
        """Keep what is wanted of one more window."""
        assert w.done is not None
        self.newest = w
        self.misfit += float(w.done.nis[0])
        self.used += int(w.done.used[0])
        self.first.append(w.done.weights)
        if w.left is not None:
            self.x.append(w.left.x)
            self.P.append(w.left.covariances().copy())  # not a view that holds the whole window's
            self.weights.append(w.left.weights)


def _counts(assembly: Assembly, weights: Sequence[Array]) -> dict[str, Any]:
    """Observations rejected and down-weighted in the epochs reached, by sensor."""
    every = np.ones(assembly.observations)
    reached = np.concatenate([np.zeros(0), *weights])
    every[: len(reached)] = reached
    return {
        "rejected": count_rejected(assembly, every),
        "left_out": left_out(assembly, every),
        "retired": retired(assembly, every),
        "downweighted": count_downweighted(assembly, every),
    }
