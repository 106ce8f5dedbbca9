"""The window of a fixed-lag smoother: a chain of epochs, and how it is linearised in part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.state import Layout
from relnav_graph.errors import EstimationError
from relnav_graph.estimators.ekf import FilterSweep
from relnav_graph.estimators.incremental import SmootherState
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.conditionals import Anchor, Conditionals
from relnav_graph.linear.elimination import linearize

__all__ = ["Chain", "Left", "Window", "joined", "linearized"]


@dataclass(frozen=True, eq=False)
class Left:
    """Epochs that left a window together: t (m,) s, x (m, size), weights (observations,).

    Their covariances are computed only when asked for: they cost a pass back through the whole
    window.
    """

    t: Array
    x: Array
    weights: Array
    first: int
    conditionals: Conditionals

    def covariances(self) -> Array:
        """P (m, n, n)."""
        part = slice(self.first, self.first + len(self.t))
        return self.conditionals.marginals().whole(part)


@dataclass(frozen=True, eq=False)
class Chain:
    """K epochs linearised at x (K, size), and eliminated; static blocks at one value for all.

    known (K, n, n + m + 1), statics (K, m + 1, m + 1): of each, see
    `relnav_graph.linear.elimination.System`; conditionals: of each given the next one;
    d (K, n + m): the estimates, from x.
    """

    x: Array
    known: Array
    statics: Array
    conditionals: Conditionals
    d: Array

    def summary(self, k: int) -> Anchor:
        """All that is known of epoch k from the data up to it, as a linear summary."""
        n, m, known = self.known.shape[1], self.statics.shape[1] - 1, self.known[k]
        if not m:
            return Anchor(self.x[k], np.ascontiguousarray(known[:, :n]), known[:, n].copy())
        W, d = np.zeros((n + m, n + m)), np.empty(n + m)
        W[:n, :n], d[:n], W[:n, n:] = known[:, :n], known[:, n], known[:, n + 1 :]
        W[n:, n:], d[n:] = self.statics[k, :m, :m], self.statics[k, :m, m]
        return Anchor(self.x[k], W, d)

    def estimates(self, layout: Layout, part: slice = slice(None)) -> Array:
        """The states (K, size), or some of them."""
        return layout.retract(self.x[part], self.d[part])

    def moved(self) -> Array:
        """How far each estimate is from its linearisation point, (K,), in sigmas of its
        covariance when it was the newest; the first one at least as far as the static blocks."""
        n, m = self.known.shape[1], self.statics.shape[1] - 1
        away = self.known[:, :, :n] @ self.d[:, :n, None]
        if m:
            away += self.known[:, :, n + 1 :] @ self.d[:, n:, None]
        distance: Array = np.sqrt(np.square(away).sum(axis=(1, 2)))
        if m:
            static = self.conditionals.R_s @ self.d[0, n:]
            distance[0] = max(distance[0], float(np.linalg.norm(static)))
        return distance

    def since(self, k: int) -> Chain:
        """The chain without its first k epochs."""
        rest = self.conditionals.since(k)
        return Chain(self.x[k:], self.known[k:], self.statics[k:], rest, self.d[k:])


@dataclass(frozen=True, eq=False)
class Window:
    """The smoother at one epoch: an immutable value.

    anchor: what is known of the window's first state beforehand. That state is the first
    epoch's until an epoch has left the window, then the newest one that has left. x (size,),
    P (n, n): the newest state. epochs, parts, weights: those in the window; chain: their
    states, after that of the newest epoch that has left. done: the filter's part in the newest
    epoch; left: what left with it; turned: by how much the target has turned, rad, see
    `relnav_graph.estimators.first_sights.turned`; begun: the smoother of a pass with a map until
    the window begins to move: there is no chain then.
    """

    t: float | None
    anchor: Anchor
    x: Array
    P: Array
    epochs: tuple[Epoch, ...] = ()
    parts: tuple[Assembly, ...] = ()
    weights: tuple[Array, ...] = ()
    chain: Chain | None = None
    done: FilterSweep | None = None
    left: Left | None = None
    turned: float = 0.0
    begun: SmootherState | None = None

    @property
    def lead(self) -> int:
        """1 when an epoch has left, else 0: then an interval leads to the oldest one here."""
        return len(self.parts[0].tables.starts) if self.parts else 0

    @property
    def joined(self) -> Assembly:
        """The parts as one, for all states."""
        return joined(self.parts, self.lead)


def linearized(w: Window, x: Array, first: int = 0) -> Chain:
    """The chain of a window linearised at x (K, size); the states before `first` as they
    were. Raises EstimationError when an observation that counts is impossible there."""
    old, anchor, at = w.chain, w.anchor, w.parts[0].layout.held(x)
    if first:
        assert old is not None
        anchor, size = old.summary(first - 1), w.parts[0].layout.moving.size
        at = np.concatenate([anchor.x[None], x[first:]])
        at[:, size:] = anchor.x[size:]  # static blocks move only where all is linearised anew
    begin = max(first - w.lead, 0)
    assembly = joined(w.parts[begin:], w.lead or first)
    whiten = assembly.whitening(at[:-1])
    weights = np.concatenate(w.weights[begin:])
    system = linearize(assembly, anchor, at, whiten, weights, keep=True)
    if system.status.any():
        raise EstimationError("an observation has become impossible")
    known, statics, c = system.known, system.statics, system.conditionals
    if first:
        assert old is not None
        known = np.concatenate([old.known[:first], known[1:]])
        statics = np.concatenate([old.statics[:first], statics[1:]])
        c = c.after(old.conditionals, first - 1)
        at = np.concatenate([old.x[:first], at[1:]])
    return Chain(at, known, statics, c, c.solution())


def joined(parts: Sequence[Assembly], preceded: int) -> Assembly:
    """The parts of a window as one; preceded: whether a state stands before them."""
    assembly = Assembly.join(parts) if len(parts) > 1 else parts[0]
    return assembly.preceded() if preceded else assembly
