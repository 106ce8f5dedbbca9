"""Sensors whose kernel gets the time of each observation."""

from __future__ import annotations

import copy
from typing import Self

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.models import SensorModel

__all__ = ["TimedSensor"]


class TimedSensor(SensorModel):
    """Base of a sensor that depends on time: its kernel has the time of the observation, s of the
    pass's clock, as the last number of q, after what `data_of` gives.

    For a beacon that blinks, a mount that turns, an error that grows. With `NumericalSensor` as
    the second base, h gets q first: ``class Own(TimedSensor, NumericalSensor)``, ``h(self, q, *x)``
    with t = q[-1].
    """

    @property
    def reads_time(self) -> bool:
        return True

    def at(self, t: float) -> Self:  # type: ignore[override]
        """The same, at time t, s."""
        now = copy.copy(self)
        object.__setattr__(now, "_now", float(t))
        return now

    def data_of(self, ids: Indices) -> Array:
        """What belongs to each observation besides (k, nq); nothing, unless a model says so."""
        return np.zeros((len(ids), 0))

    def observation_data(self, ids: Indices) -> Array:
        """q (k, nq + 1): `data_of`, and the time, s."""
        times = np.full((len(ids), 1), self.__dict__.get("_now", 0.0))
        return np.ascontiguousarray(np.hstack([self.data_of(ids), times]))
