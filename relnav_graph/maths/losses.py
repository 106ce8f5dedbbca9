"""Robust losses: how much an observation that does not fit still counts.

An observation of m rows with whitened residual r is judged by s^2 = |r|^2 / m, its mean
square; its rows are multiplied by the square root of the weight w(s). Least squares repeated
with the weights of the last solution, until they no longer change, minimises the loss
(iteratively reweighted least squares: Holland and Welsch 1977).

    huber   1 up to c, then c / s                    (Huber 1964)
    cauchy  1 / (1 + (s / c)^2)
    dcs     (2 c^2 / (c^2 + s^2))^2, at most 1       (Agarwal, Tipaldi, Spinello, Stachniss,
                                                      Burgard 2013, eq. 17, with phi = c^2)
    tukey   (1 - (s / c)^2)^2, 0 beyond c
    student_t  (nu + m) / (nu + m s^2): the errors have a t-distribution of nu degrees of freedom
            and the scale of the noise (Lange, Little, Taylor 1989)

Of student_t the tuning is nu. Its weight is above 1 near zero and 1 in the mean where the errors
are of that law, so that the reported covariance is that of normal errors of the same scale. The
information of such errors is less, by (nu + m) / (nu + m + 2): with nu = 5 the reported sigmas of
pixel pairs on two cameras (m = 4) are 10 % too small.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.errors import InputError

__all__ = ["TUNING", "Loss", "LossKind", "loss_costs", "root_weight", "root_weights"]

LossKind = Literal["huber", "cauchy", "dcs", "tukey", "student_t"]

NONE, HUBER, CAUCHY, DCS, TUKEY, STUDENT_T = 0, 1, 2, 3, 4, 5
_NUMBERS: Mapping[str, int] = {
    "huber": HUBER,
    "cauchy": CAUCHY,
    "dcs": DCS,
    "tukey": TUKEY,
    "student_t": STUDENT_T,
}
#: Default c, in sigmas: 95 % efficient on one normal variable; for dcs full weight to 2 sigma; of
#: student_t degrees of freedom.
TUNING: Mapping[str, float] = {
    "huber": 1.345,
    "cauchy": 2.3849,
    "dcs": 2.0,
    "tukey": 4.6851,
    "student_t": 5.0,
}


@jit
def root_weight(kind: float, c: float, s2: float) -> float:
    """Square root of the weight w(s) of an observation of mean square ``s2 = s^2``.

    kind, c: number of the loss and its tuning, as `Loss.numbers` gives. 1 without a loss.
    """
    q, root = s2 / (c * c), 1.0
    if kind == HUBER and q > 1.0:
        root = 1.0 / math.sqrt(math.sqrt(q))
    elif kind == CAUCHY:
        root = 1.0 / math.sqrt(1.0 + q)
    elif kind == DCS:
        root = min(1.0, 2.0 / (1.0 + q))
    elif kind == TUKEY:
        root = max(1.0 - q, 0.0)
    elif kind == STUDENT_T:
        root = math.sqrt((c + 1.0) / (c + s2))
    return root


@jit
def root_weights(losses: Array, s2: Array) -> Array:
    """:func:`root_weight` of each observation.

    losses: (m, 2), kind and tuning c; s2: (m,), mean squares. Returns (m,).
    """
    out = np.empty(s2.shape[0])
    for i in range(s2.shape[0]):
        out[i] = root_weight(losses[i, 0], losses[i, 1], s2[i])
    return out


def loss_costs(losses: Array, s2: Array) -> Array:
    """The losses themselves, (m,), per row: half the integral of the weight over s^2, from zero.

    losses: (m, 2), kind and tuning c; s2: (m,), mean squares. ``s^2 / 2`` without a loss.
    """
    kind, c2 = losses[:, 0], losses[:, 1] ** 2
    out = s2.copy()
    beyond = (kind == HUBER) & (s2 > c2)
    out[beyond] = 2 * np.sqrt(c2[beyond] * s2[beyond]) - c2[beyond]
    own = kind == CAUCHY
    out[own] = c2[own] * np.log1p(s2[own] / c2[own])
    own = (kind == DCS) & (s2 > c2)
    out[own] = 3 * c2[own] - 4 * c2[own] ** 2 / (c2[own] + s2[own])
    own = kind == TUKEY
    out[own] = c2[own] / 3 * (1 - np.maximum(1 - s2[own] / c2[own], 0.0) ** 3)
    own, c = kind == STUDENT_T, losses[:, 1]
    out[own] = (c[own] + 1) * np.log1p(s2[own] / c[own])
    half: Array = 0.5 * out
    return half


@dataclass(frozen=True)
class Loss:
    """A loss and its tuning constant: c, in sigmas, of student_t the degrees of freedom nu; None
    stands for that of `TUNING`.

    Raises InputError on another kind, or a constant that is not positive.
    """

    kind: LossKind
    tuning: float | None = None

    def __post_init__(self) -> None:
        if self.kind not in TUNING:
            raise InputError(f"loss: found {self.kind!r}, expected one of {', '.join(TUNING)}")
        if self.tuning is not None and not 0 < self.tuning < np.inf:
            raise InputError(f"loss {self.kind}: found tuning {self.tuning}, expected > 0")

    @property
    def redescends(self) -> bool:
        """Whether the pull of an outlier falls as it moves away: the cost has many minima."""
        return self.kind != "huber"

    def numbers(self, rows: int) -> tuple[float, float]:
        """Kind and tuning, as `root_weight` takes them, of observations of so many rows: c, of
        student_t nu / m."""
        tuning = self.tuning or TUNING[self.kind]
        return float(_NUMBERS[self.kind]), tuning / rows if self.kind == "student_t" else tuning
