"""Planned manoeuvres: steps of the chaser's velocity, which are never flown quite as planned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.manoeuvres import IMPULSE, thrust_series
from relnav_graph.core.measurement import InputSeries
from relnav_graph.errors import InputError
from relnav_graph.units import Quantity, check_fields

__all__ = ["Manoeuvres"]


@dataclass(frozen=True, eq=False, kw_only=True)
class Manoeuvres:
    """Steps of the velocity, in the axes of the relative velocity (o). The input tells the plan and
    its covariance; the truth flies it with errors drawn from that.

    times: s, increasing; delta_v: m/s, one (3,) for each; sigma: m/s, of each axis, one for all.
    What is measured at the time of a step is measured before it. Raises InputError on times that
    do not increase, and on another number of steps than times.
    """

    kind: ClassVar[str] = "manoeuvres"

    times: Annotated[Array, Quantity("s", (None,))]
    delta_v: Annotated[Array, Quantity("m/s", (None, 3))]
    sigma: Annotated[Array, Quantity("m/s", (3,), nonnegative=True, fill=True)]

    def __post_init__(self) -> None:
        check_fields(self)
        if len(self.delta_v) != len(self.times):
            raise InputError(
                f"manoeuvres.delta_v: found {len(self.delta_v)}, expected one for each of the"
                f" {len(self.times)} times"
            )
        if not (np.diff(self.times) > IMPULSE).all():
            raise InputError(
                f"manoeuvres.times: found {self.times.tolist()} s, expected increasing ones,"
                f" more than {IMPULSE} s apart"
            )

    def planned(self, name: str, t_first: float, t_last: float) -> InputSeries:
        """The input that tells the plan, from t_first to t_last, s."""
        covariance = np.tile(np.diag(self.sigma**2), (len(self.times), 1, 1))
        ends = self.times + IMPULSE
        return thrust_series(name, self.times, ends, self.delta_v, covariance, t_first, t_last)

    def flown(self, rng: np.random.Generator) -> Array:
        """What is flown, (n, 4): time, s, and change of the velocity, m/s."""
        missed = self.sigma * rng.standard_normal(self.delta_v.shape)
        return np.column_stack([self.times, self.delta_v + missed])
