"""The assumption that zhang2015 sets out to drop: the target's body frame is its orbital frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from relnav_graph.core.catalogue import TARGET_ATTITUDE
from relnav_graph.core.problem import Prior, Problem, layout_of
from relnav_graph.core.track import Track
from relnav_graph.errors import ModelError
from relnav_graph.estimators.ekf import Ekf

__all__ = ["BodyIsOrbital"]

#: rad: how well R_ot is taken to be known; as good as exactly, beside any line of sight.
EXACT = 1e-9


def assumed(problem: Problem, where: str) -> Problem:
    """The same pass with R_ot = I throughout: no process turns the target.

    Raises ModelError on a state without R_ot, or an o at rest.
    """
    own = [n for n, p in problem.processes.items() if TARGET_ATTITUDE in p.advances]
    if not own or problem.orbit is None:
        what = problem.layout if not own else "no orbit"
        raise ModelError(
            f"{where}: found {what}, expected a {TARGET_ATTITUDE.name} in the orbital frame of the"
            " target's orbit"
        )
    processes = {n: p for n, p in problem.processes.items() if n not in own}
    layout, whole = layout_of(processes, problem.sensors), problem.layout
    if TARGET_ATTITUDE not in layout.statics.blocks:
        raise ModelError(f"{where}: found no sensor that reads {TARGET_ATTITUDE.name}")
    stored, tangent = whole.gather(layout.blocks)
    x, P = problem.prior.x[stored], problem.prior.P[np.ix_(tangent, tangent)]
    at, axes = layout.slices(TARGET_ATTITUDE.name)
    x[at], P[axes, :], P[:, axes] = np.eye(3).ravel(), 0.0, 0.0
    P[axes, axes] = EXACT**2 * np.eye(3)
    epochs = tuple(epoch.of(processes) for epoch in problem.epochs)
    return replace(problem, processes=processes, prior=Prior(x, P), epochs=epochs)


@dataclass(frozen=True)
class BodyIsOrbital:
    """The filter that takes the target's body frame t for its orbital frame o.

    As Kim, Crassidis, Cheng, Fosbury, Junkins 2007 construct lines of sight, "for convenience",
    after Zhang et al. 2015, section 1: the chaser's attitude and position relative to o, and its
    gyro's bias, by `ekf`; R_ot = I, known; no rate and no inertia of the target. Right for a target
    that keeps its attitude in o, and for no other.
    """

    kind: ClassVar[str] = "kim2007_body_is_orbital"

    def run(self, problem: Problem) -> Track:
        """Filter the whole pass. Raises ModelError on a problem without a target's attitude, or
        without an orbit."""
        return replace(Ekf().run(assumed(problem, self.kind)), name=self.kind)
