"""What the processes share that move a craft in the gravity of the Earth, Sun and Moon."""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

import numpy as np

from relnav_factors.shared.earth import earth_numbers
from relnav_factors.shared.gravity import FIELD, Degree, earth_field
from relnav_factors.shared.thrust import Thrusted
from relnav_graph.arrays import Array
from relnav_graph.constants import MU_THIRD
from relnav_graph.core.absolute_time import AbsoluteTime
from relnav_graph.errors import InputError
from relnav_graph.maths.geopotential import geopotential


@dataclass(frozen=True, kw_only=True)
class EarthBound(Thrusted):
    """Gravity about the Earth's centre, in inertial axes: those of GCRF.

    degree: of the highest harmonic of the Earth. With order 0 and a degree of 0 or 2 to 4 the field
    does not turn: zonal harmonics about z of the inertial frame. A higher degree, or an order, the
    highest of the harmonics that depend on longitude, takes the field of EGM2008, to degree 60,
    that turns with the Earth, about its axis of date; third_bodies: "sun", "moon", as point masses.
    Both need the absolute time of t = 0, [time] epoch, which makes the clock.

    Left out: tides (1e-7 m/s^2 in a low orbit), drag and radiation pressure, relativity.
    """

    degree: int = 0
    order: int = 0
    third_bodies: tuple[str, ...] = ()
    clock: AbsoluteTime | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "third_bodies", tuple(self.third_bodies))
        for name in self.third_bodies:
            if name not in MU_THIRD:
                raise InputError(f"third_bodies: found {name!r}, expected {' or '.join(MU_THIRD)}")
        if self.degree == 1:
            raise InputError(
                "degree: found 1, expected 0 or from 2 on: the Earth's centre is known"
            )
        geopotential().upto(self.degree, self.order)
        made = np.zeros(0)
        if self.turns and self.clock is not None:
            made = earth_numbers(self.degree, self.order, self.third_bodies, self.clock)
        object.__setattr__(self, "_earth", made)

    @property
    def turns(self) -> bool:
        """Whether the pull depends on the time."""
        still = self.order == 0 and self.degree in get_args(Degree)
        return not still or bool(self.third_bodies)

    @property
    def undated(self) -> bool:
        """Whether the absolute time of t = 0 is needed, and missing."""
        return self.turns and self.clock is None

    @property
    def sphere(self) -> Array:
        """The field that does not turn, (5,), see `relnav_factors.shared.gravity`, SI."""
        if not self.turns:
            return earth_field(self.degree)
        field = geopotential()
        return np.array([field.gm, field.radius, *np.zeros(FIELD - 2)])

    @property
    def earth(self) -> Array:
        """What turns and is added to it, (n,), see `earth_numbers`; empty where nothing is.

        Raises InputError where the absolute time is missing.
        """
        if self.undated:
            raise InputError(f"{self.kind}: found no absolute time of t = 0, expected [time] epoch")
        return self._earth  # type: ignore[attr-defined,no-any-return]
