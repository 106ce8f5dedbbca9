"""First-order Gauss-Markov processes: biases that wander about zero."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, Self

import numpy as np

from relnav_factors.shared.white_noise import duration
from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.models import DynamicsModel
from relnav_graph.units import Quantity

#: What of a bias a process advances: the bias as a whole, or what drifts about a constant one.
Part = Literal["bias", "drift"]


@jit
def decay(length: float, time_constant: float, sigma: float) -> tuple[float, float]:
    """Factor ``exp(-h / T)`` of a bias over h seconds, and the variance that it gains.

    length: h, s; time_constant: T, s; sigma: in the long run, in the unit of the bias.
    """
    kept = np.exp(-length / time_constant)
    return kept, -sigma * sigma * np.expm1(-2 * length / time_constant)


@jit
def walk_and_integral(length: float, time_constant: float) -> tuple[float, float, float, float]:
    """Exact moments of ``b' = -b / T + white``, of density 1, and of its integral, over h seconds.

    length: h, s; time_constant: T, s; inf: a random walk. Returns the factor that b keeps; the
    time, s, by which its first value counts in the integral; the variance of b, s; that of the
    integral, s^3. The covariance of b and the integral is half the square of that time.
    """
    a = length / time_constant
    kept = np.exp(-a)
    if a < 0.05:  # the closed forms lose their digits; the series are good to 1e-7
        counts = length * (1 - a / 2 * (1 - a / 3 * (1 - a / 4 * (1 - a / 5))))
        own = length * (1 - a * (1 - 2 * a / 3 * (1 - a / 2 * (1 - 2 * a / 5))))
        of_integral = length**3 * (1 / 3.0 - a / 4 + 7 * a**2 / 60 - a**3 / 24 + 31 * a**4 / 2520)
        return kept, counts, own, of_integral
    T, once, twice = time_constant, -np.expm1(-a), -np.expm1(-2 * a)
    return kept, T * once, T * twice / 2, T**3 * (a - 2 * once + twice / 2)


@jit
def kernel(p: Array, t: float, u: Array, x: Array, x_next: Array, F: Array, Q: Array) -> int:
    """``b_next = exp(-h / T) b``, with noise of variance ``sigma^2 (1 - exp(-2 h / T))``.

    p (2,): T (s), sigma (unit of b). u (rows, 1): dt, s. x, x_next (n,): b, such as m/s^2 or rad.
    F, Q (n, n).
    """
    kept, gained = decay(duration(u), p[0], p[1])
    for i in range(x.shape[0]):
        x_next[i] = kept * x[i]
        for j in range(x.shape[0]):
            F[i, j] = kept if i == j else 0.0
            Q[i, j] = gained if i == j else 0.0
    return 0


@dataclass(frozen=True, kw_only=True)
class GaussMarkov(DynamicsModel):
    """b' = -b / T + white, of standard deviation sigma in the long run.

    Exact over any interval: b(t + h) = exp(-h / T) b(t) + noise of variance sigma^2
    (1 - exp(-2 h / T)) (Gelb 1974, example 3.8-1). A bias that is constant needs no process: read
    and not advanced, it is a static block.

    time_constant: T, s; part: "bias", or "drift": what drifts about a constant bias, which is a
    static block of its own.
    """

    noises: ClassVar[tuple[str, ...]] = ("sigma",)
    kernel = staticmethod(kernel)

    sigma: float  # each kind has a unit of its own
    time_constant: Annotated[float, Quantity("s", positive=True)]
    part: Part = "bias"

    def without_drift(self) -> Self | None:
        """None where it is a drift, see `relnav_graph.core.contracts.Drifts`."""
        return None if self.part == "drift" else self

    def constants(self) -> Array:
        return np.array([self.time_constant, self.sigma])

    def wandering(self, times: Array, rng: np.random.Generator) -> dict[str, Array]:
        """True values (N, dim) at `times` (N,), s, in the unit of sigma; see
        `relnav_graph.core.contracts.Wanders`."""
        (block,) = self.advances
        draws = rng.standard_normal((len(times), block.dim))
        out = self.sigma * draws
        for k, length in enumerate(np.diff(times), 1):
            kept, gained = decay(length, self.time_constant, self.sigma)
            out[k] = kept * out[k - 1] + np.sqrt(gained) * draws[k]
        return {block.name: out}
