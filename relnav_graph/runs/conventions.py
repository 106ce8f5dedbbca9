"""Whether a pass that does not fit would, had its data been written in another convention or unit.

A unit quaternion in another order, or of the inverse rotation, is a unit quaternion too, and a rate
in deg/s is a number like one in rad/s: nothing in a file tells. But beside the other sensors, or
known motion, it does not fit, and the right one does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from relnav_graph.core.cautions import Caution
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Innovations, Track
from relnav_graph.core.turning import TURNING
from relnav_graph.errors import RelnavError
from relnav_graph.estimators import try_estimator
from relnav_graph.runs.readings import Reading, of_axes, readings

__all__ = ["pass_cautions"]

#: Mean square of innovations, in sigmas, from which on something is wrong.
_WRONG = 5.0
#: Or it is further from one than that many of its sigmas, a 95 % band, and would not be, with a sum
#: of squares that is by so much smaller: a ratio of likelihoods of 5e8.
_BAND, _TELLING = 1.96, 40.0
#: Of two whose sums of squares are less apart than that none is better.
_ALIKE = 10.0
#: What is measured shrinks in another unit, and its misfit with it, to below this where the noise
#: is larger than declared, and no unit wrong.
_SHRUNK = 0.1
#: So many epochs are looked at, of a state of 30; of larger ones fewer, but for the second number.
_EPOCHS, _FEWEST = 600, 200


@dataclass(frozen=True)
class _Fit:
    """How well a filter fits: `worst`, of the sensor that fits worst the mean square of innovations
    at an epoch, in their own sigmas, the median over the second half: 1 or less where all is as
    declared; nis, rows: sum of squares of the last three quarters, and of how many."""

    worst: float
    nis: float
    rows: int

    @staticmethod
    def of(innovations: Mapping[str, Innovations]) -> _Fit:
        worst, nis, rows = 0.0, 0.0, 0
        for one in innovations.values():
            n = len(one.t)
            own = (one.nis / one.rows)[n // 2 :]
            worst = max(worst, float(np.median(own)) if n > 3 else 0.0)
            nis += float(one.nis[n // 4 :].sum())
            rows += int(one.rows[n // 4 :].sum())
        return _Fit(worst if np.isfinite(worst) else np.inf, nis, rows)

    @property
    def mean_square(self) -> float:
        return self.nis / self.rows if self.rows else 1.0

    @property
    def sigmas(self) -> float:
        """By how many of its own sigmas the mean square differs from one."""
        return (self.mean_square - 1) * float(np.sqrt(self.rows / 2))

    @property
    def doubtful(self) -> bool:
        return self.worst > _WRONG or self.sigmas > _BAND

    def mended_by(self, other: _Fit, reading: Reading) -> bool:
        """Whether another fit is so much better that there must be a reason."""
        if self.worst > _WRONG:
            least = _SHRUNK if reading.shrinks else 0.0
            return least <= other.worst < min(self.worst / reading.better, _WRONG)
        less = (self.nis - self.rows) - (other.nis - other.rows)
        return less > _TELLING and abs(other.sigmas) < _BAND < self.sigmas


_LOST = _Fit(np.inf, np.inf, 1)


def _fit(problem: Problem, reading: Reading | None = None) -> _Fit:
    """That of a filter over the pass, read in a way."""
    try:
        track = try_estimator("iekf", reading.of(problem) if reading else problem)
    except RelnavError:
        return _LOST
    return _LOST if track.status == "diverged" else _Fit.of(track.innovations)


def pass_cautions(problem: Problem, tracks: Sequence[Track]) -> tuple[Caution, ...]:
    """What is doubtful about the pass of some tracks. Where one of them is not ok, or fits worse
    than it should, and no caution of the problem says why, also whether the pass fits far better in
    another convention or unit: it is filtered once for each."""
    told = any(caution.name == TURNING for caution in problem.cautions)
    each = [t for track in tracks for t in (track, track.smoothed) if t is not None]
    wrong = any(t.status != "ok" or _Fit.of(t.innovations).doubtful for t in each)
    return problem.cautions + (_other_readings(problem) if wrong and not told else ())


def _other_readings(problem: Problem) -> tuple[Caution, ...]:
    count = max(_FEWEST, int(_EPOCHS * min(1.0, (30 / problem.layout.dim) ** 2)))
    # A filter that is lost, and has rejected nearly all, fits what is left: so there are no gates.
    problem = replace(problem, epochs=problem.epochs[:count], gates={})
    as_read = _fit(problem)
    if not as_read.doubtful:
        return ()
    first, second = [*readings(problem)], [*of_axes(problem)]
    slight = [one for one in (*first, *second) if one.slight]
    for tried in (first, second) if as_read.worst > _WRONG else (slight,):
        fits = [(one, _fit(problem, one)) for one in tried]
        mended = [(one, fit) for one, fit in fits if as_read.mended_by(fit, one)]
        if mended:
            least = min(fit.nis for _, fit in mended)
            # The simplest, which come first, of those that fit as well.
            best, fit = next(pair for pair in mended if pair[1].nis < least + _ALIKE)
            if not best.what:
                return ()
            before = "lost" if np.isinf(as_read.nis) else f"{as_read.mean_square:.3g}"
            text = (
                "the mean square of a filter's innovations, in their own sigmas, is"
                f" {before} as read, and {fit.mean_square:.3g} if {best.what}: is it so?"
            )
            return (Caution("other convention", text),)
    return ()
