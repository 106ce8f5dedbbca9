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
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.elimination import Anchor, Conditionals, linearize

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
        return self.conditionals.covariances()[self.first : self.first + len(self.t)]


@dataclass(frozen=True, eq=False)
class Chain:
    """K epochs linearised at x (K, size), and eliminated.

    known (K, n, n + 1): U, u of each, see `relnav_graph.linear.elimination.System`; conditionals:
    of each given the next one; d (K, n): the estimates, from x.
    """

    x: Array
    known: Array
    conditionals: Conditionals
    d: Array

    def summary(self, k: int) -> Anchor:
        """All that is known of epoch k from the data up to it, as a linear summary."""
        known = self.known[k]
        return Anchor(self.x[k], np.ascontiguousarray(known[:, :-1]), known[:, -1].copy())

    def estimates(self, layout: Layout, part: slice = slice(None)) -> Array:
        """The states (K, size), or some of them."""
        return layout.retract(self.x[part], self.d[part])

    def moved(self) -> Array:
        """How far each estimate is from its linearisation point, (K,), in sigmas of its
        covariance when it was the newest."""
        away = self.known[:, :, :-1] @ self.d[:, :, None]
        distance: Array = np.sqrt(np.square(away).sum(axis=(1, 2)))
        return distance

    def since(self, k: int) -> Chain:
        """The chain without its first k epochs."""
        c = self.conditionals
        rest = Conditionals(c.R[k:], c.S[k:], c.d[k:])
        return Chain(self.x[k:], self.known[k:], rest, self.d[k:])


@dataclass(frozen=True, eq=False)
class Window:
    """The smoother at one epoch: an immutable value.

    anchor: what is known of the window's first state beforehand. That state is the first
    epoch's until an epoch has left the window, then the newest one that has left. x (size,),
    P (n, n): the newest state. epochs, parts, weights: those in the window; chain: their
    states, after that of the newest epoch that has left. done: the filter's part in the newest
    epoch; left: what left with it.
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
    old, anchor, at = w.chain, w.anchor, x
    if first:
        assert old is not None
        anchor = old.summary(first - 1)
        at = np.concatenate([anchor.x[None], x[first:]])
    begin = max(first - w.lead, 0)
    assembly = joined(w.parts[begin:], w.lead or first)
    whiten = assembly.whitening(at[:-1])
    weights = np.concatenate(w.weights[begin:])
    system = linearize(assembly, anchor, at, whiten, weights, keep=True)
    if system.status.any():
        raise EstimationError("an observation has become impossible")
    known, c = system.known, system.conditionals
    if first:
        assert old is not None
        before, keep = old.conditionals, first - 1
        known = np.concatenate([old.known[:first], known[1:]])
        c = Conditionals(
            np.concatenate([before.R[:keep], c.R]),
            np.concatenate([before.S[:keep], c.S]),
            np.concatenate([before.d[:keep], c.d]),
        )
        x = np.concatenate([old.x[:first], x[first:]])
    return Chain(x, known, c, c.solution())


def joined(parts: Sequence[Assembly], preceded: int) -> Assembly:
    """The parts of a window as one; preceded: whether a state stands before them."""
    assembly = Assembly.join(parts) if len(parts) > 1 else parts[0]
    return assembly.preceded() if preceded else assembly
