"""Published filters: the scenario's measurements and noise, a prediction and errors of their own.

What such a filter shares with `ekf` is all that a comparison should not depend on: sensors,
noise, prior, gates and losses. What is its own is what the paper prints: the error states, and how
they are predicted.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import ClassVar, Protocol

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.problem import Problem
from relnav_graph.core.state import Block, Layout
from relnav_graph.core.track import Track
from relnav_graph.errors import ModelError
from relnav_graph.estimators.ekf import FilterState, FilterSweep, KalmanEngine, KalmanState
from relnav_graph.estimators.ekf import filter_step as update
from relnav_graph.estimators.source import Driven, RecordedSource, Source, drive
from relnav_graph.linear.assembly import Assembly

__all__ = ["Published", "PublishedFilter", "require"]


class Published(Protocol):
    """The states y of a published filter, beside those of the scenario, x, and how it predicts.

    layout: of y (m,), stored, with the published errors as its tangent (n,): as many as x has.
    """

    @property
    def layout(self) -> Layout: ...

    def own(self, x: Array) -> Array:
        """y (m,) of x (size,), SI. Raises EstimationError where there is none."""

    def scenario(self, y: Array) -> Array:
        """x (size,) of y (m,), SI. Raises EstimationError where there is none."""

    def jacobian(self, y: Array) -> Array:
        """d(tangent of x) / d(tangent of y), (n, n), at y (m,), SI."""

    def predict(self, y: Array, interval: Assembly) -> tuple[Array, Array, Array]:
        """y (m,) at the end of an interval, Phi (n, n) and the noise Q (n, n), in the tangent of y,
        SI, from y (m,) at its start."""


def require(problem: Problem, blocks: Sequence[Block], where: str) -> Layout:
    """The layout of a problem of just these blocks. Raises ModelError on another, InputError where
    blocks are considered."""
    problem.expect_none_considered(where)
    if set(problem.layout.blocks) != set(blocks):
        names = ", ".join(block.name for block in blocks)
        raise ModelError(f"{where}: found {problem.layout}, expected a state of just {names}")
    return problem.layout


def _at_its_end(interval: Assembly) -> Assembly:
    """The epoch that an interval leads to, without the interval."""
    one, tables = copy(interval), interval.tables
    one.tables = tables._replace(intervals=tables.intervals[:0], starts=tables.starts[:0])
    return one


class PublishedEngine(KalmanEngine):
    """The filter from epoch to epoch: state and covariance stand in the scenario's coordinates."""

    def __init__(self, problem: Problem, published: Published) -> None:
        super().__init__(problem, iterations=1)
        self.published = published

    def advance(
        self, state: KalmanState, epoch: Epoch, assembly: Assembly | None = None
    ) -> KalmanState:
        """Predict as published, update with the scenario's measurements, and correct the published
        states by their published errors. Raises EstimationError when that is impossible."""
        p, own = self.problem, self.published
        if assembly is None:
            assembly = Assembly.ahead(p, epoch, state.t)
        x, P, y = state.x, state.P, own.own(state.x)
        slopes = own.jacobian(y)
        if state.t is not None:
            back = np.linalg.inv(slopes)
            y, Phi, Q = own.predict(y, assembly)
            x, slopes = own.scenario(y), own.jacobian(y)
            P = slopes @ (Phi @ (back @ P @ back.T) @ Phi.T + Q) @ slopes.T
            P = 0.5 * (P + P.T)
        before = FilterState(state.t, x, P)
        done = update(p, self.iterations, before, epoch, _at_its_end(assembly))
        d: Array = np.linalg.inv(slopes) @ p.layout.local(x, done.end.x)
        end = done.end._replace(x=own.scenario(own.layout.retract(y, d)))
        return KalmanState(*end, replace(done, x=end.x[None], end=end))


class PublishedFilter:
    """What the published filters share; each says of which problems it is, and how it predicts."""

    kind: ClassVar[str]

    def of(self, problem: Problem) -> Published:
        """Its states and prediction. Raises ModelError on a problem of another system."""
        raise NotImplementedError

    def engine(self, problem: Problem) -> PublishedEngine:
        """For use online."""
        return PublishedEngine(problem, self.of(problem))

    def run(self, problem: Problem) -> Track:
        """Filter the whole pass. Raises ModelError as `of`."""
        return self.drive(RecordedSource(problem))

    def drive(self, source: Source) -> Track:
        """Filter epochs as they come. Raises ModelError as `of`."""
        steps = list[FilterSweep]()

        def notice(state: KalmanState) -> None:
            if state.done is not None:
                steps.append(state.done)

        driven = drive(source, self.engine(source.problem), notice)
        done = _sweep(driven, steps)
        status, message = done.verdict(driven.problem)
        return driven.track(
            self.kind,
            status=status,
            message=message,
            rejected=done.rejected,
            left_out=done.left_out,
            downweighted=done.downweighted,
            innovations=done.innovations(),
        )


def _sweep(driven: Driven, steps: Sequence[FilterSweep]) -> FilterSweep:
    """Single steps as one filter's way through the whole pass."""
    assembly, n = Assembly.of(driven.problem), driven.problem.layout.dim
    missing = len(driven.x) - len(steps)

    def whole(found: Sequence[Array], *shape: int) -> Array:
        return np.concatenate([*found, np.zeros((missing, *shape))])

    weights = np.ones(assembly.observations)
    reached = np.concatenate([np.zeros(0), *(s.weights for s in steps)])
    weights[: len(reached)] = reached
    nis = np.array([float(s.nis.sum()) for s in steps])
    used = np.array([int(s.used.sum()) for s in steps], dtype=np.int64)
    return FilterSweep(
        assembly,
        x_predicted=whole([s.x_predicted for s in steps], driven.x.shape[1]),
        P_predicted=whole([s.P_predicted for s in steps], n, n),
        F=np.zeros((1, n, n)),
        Q=np.zeros((1, n, n)),
        x=driven.x,
        P=driven.P,
        weights=weights,
        nis=nis,
        used=used,
        end=steps[-1].end if steps else FilterState.at_prior(driven.problem),
        reached=len(steps),
        stopped=driven.stopped,
    )
