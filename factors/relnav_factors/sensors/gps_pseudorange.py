"""Pseudoranges from navigation satellites to a receiver on the chaser."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from relnav_factors.dynamics.receiver_clock import CLOCK_BIAS
from relnav_factors.shared.statuses import degenerate, length_status
from relnav_graph.arrays import Array, Indices
from relnav_graph.compiled import jit
from relnav_graph.constants import EARTH_RADIUS, MU_EARTH
from relnav_graph.core.catalogue import CHASER_POSITION
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.models import SensorModel
from relnav_graph.core.state import Block
from relnav_graph.errors import GeometryError, InputError
from relnav_graph.maths import dense
from relnav_graph.units import Quantity

#: Distances from the Earth's centre that a navigation satellite can have, m.
_LOWEST, _HIGHEST = 1e7, 5e7
#: Shortest pseudorange, m: a receiver sets a clock so wrong that it gives a shorter one.
_SHORTEST = 1e6


@jit
def kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """``r = |r_c - r_g| + b - measured``.

    p (0,). q (0,). z (4,): pseudorange (m), r_g_i of the satellite (m). x (4,): r_c_i (m), b (m),
    the clock's offset times the speed of light. r (1,), m. H (1, 4). Status: that of
    `length_status` for the distance.
    """
    line = dense.vector_at(x, 0)
    for i in range(3):
        line[i] -= z[1 + i]
    distance = dense.norm(line)
    status = length_status(distance, 0)
    if status != 0:
        return status
    r[0] = distance + x[3] - z[0]
    for i in range(3):
        H[0, i] = line[i] / distance
    H[0, 3] = 1.0
    return 0


@dataclass(frozen=True, kw_only=True)
class GpsPseudorange(SensorModel):
    """Pseudorange |r_c - r_g| + b of each satellite g in view, b the clock's offset.

    Each row brings the satellite's place in i at the time of transmission, as its ephemeris
    gives it. Light time, ionosphere and troposphere count as corrected, and what they leave
    as noise (Misra and Enge 2011, section 5.1).

    Simulated satellites fly on circles, evenly spread over `planes` planes (Walker 1984):
    sigma: m, white; satellites: their number; planes: of orbits; inclination: rad;
    semi_major_axis: m; mask: lowest elevation above the chaser's own horizon, rad; main_lobe: how
    far from their nadir they are heard, rad, None: in all directions; side_lobe: between which
    angles from it they are heard besides, rad; time: s, of the constellation, which the simulator
    sets.

    Raises InputError when the satellites do not fill the planes, and on a side lobe that is none.
    """

    kind: ClassVar[str] = "gps_pseudorange"
    columns: ClassVar[tuple[str, ...]] = ("pseudorange_m", "x_m", "y_m", "z_m")
    rows: ClassVar[int] = 1
    residual_columns: ClassVar[tuple[str, ...]] = ("pseudorange_m",)
    kernel = staticmethod(kernel)
    failures = degenerate("the distance from the receiver to the satellite")

    sigma: Annotated[float, Quantity("m", positive=True)]
    satellites: int = 24
    planes: int = 6
    inclination: Annotated[float, Quantity("rad")] = 0.96
    semi_major_axis: Annotated[float, Quantity("m", positive=True)] = 2.656e7
    mask: Annotated[float, Quantity("rad")] = 0.1
    main_lobe: Annotated[float | None, Quantity("rad", positive=True)] = None
    side_lobe: Annotated[Array | None, Quantity("rad", (2,), nonnegative=True)] = None
    time: Annotated[float, Quantity("s")] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.planes < 1 or self.satellites < 1 or self.satellites % self.planes:
            raise InputError(
                f"{self.kind}: found {self.satellites} satellites in {self.planes} planes,"
                " expected as many in each"
            )
        if self.side_lobe is not None:
            least = self.main_lobe
            if least is None or not least <= self.side_lobe[0] < self.side_lobe[1] <= np.pi:
                raise InputError(
                    f"{self.kind}.side_lobe: found {self.side_lobe} rad, expected two angles in"
                    f" order, not inside the main_lobe, {least} rad, and at most pi"
                )

    @property
    def reads(self) -> tuple[Block, ...]:
        return CHASER_POSITION, CLOCK_BIAS

    def observables(self) -> Indices:
        return np.arange(self.satellites)

    def accept(self, z: Array) -> Array:
        """z (k, 4). Raises InputError where no satellite can be, or no pseudorange."""
        z = super().accept(z)
        distance = np.sqrt((z[:, 1:] ** 2).sum(axis=1))
        bad = ~((distance > _LOWEST) & (distance < _HIGHEST))
        if bad.any():
            raise InputError(
                f"{self.kind}: found a satellite {distance[bad][0]:.6g} m from the Earth's"
                f" centre, expected {_LOWEST:g} to {_HIGHEST:g} m (km given for m?)"
            )
        bad = ~(z[:, 0] > _SHORTEST)
        if bad.any():
            raise InputError(
                f"{self.kind}: found a pseudorange of {z[bad][0, 0]:.6g} m, expected one above"
                f" {_SHORTEST:g} m (km given for m?)"
            )
        return z

    def at(self, t: float) -> GpsPseudorange:
        """The sensor with its satellites where they are at time t, s, for the simulator."""
        return replace(self, time=t)

    def places(self, ids: Indices) -> Array:
        """Simulated satellites at `time` in i, (k, 3), m."""
        per_plane = self.satellites // self.planes
        plane, slot = ids // per_plane, ids % per_plane
        node = 2 * np.pi * plane / self.planes
        motion = np.sqrt(MU_EARTH / self.semi_major_axis**3)
        angle = 2 * np.pi * (slot / per_plane + plane / self.satellites) + motion * self.time
        c, s = np.cos(angle), np.sin(angle)
        level, height = np.cos(self.inclination) * s, np.sin(self.inclination) * s
        x = c * np.cos(node) - level * np.sin(node)
        y = c * np.sin(node) + level * np.cos(node)
        return self.semi_major_axis * np.stack([x, y, height], axis=1)

    def _seen(self, ids: Indices, r_c: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Places (k, 3), m, and which of them are not heard (k,): below the mask, behind the Earth,
        or turned away."""
        places = self.places(ids)
        line = places - r_c
        distance = np.sqrt((line**2).sum(axis=1))
        square = r_c @ r_c
        # At the Earth's centre all of them are behind it.
        along = line @ r_c / np.maximum(distance * np.sqrt(square), 1e-30)
        behind = (along < 0) & (square * (1 - along**2) < EARTH_RADIUS**2)
        hidden: NDArray[np.bool_] = (along < np.sin(self.mask)) | behind
        if self.main_lobe is not None:
            nadir = -places / self.semi_major_axis
            off = np.arccos(np.clip((nadir * -line).sum(axis=1) / distance, -1, 1))
            heard = off <= self.main_lobe
            if self.side_lobe is not None:
                heard |= (off >= self.side_lobe[0]) & (off <= self.side_lobe[1])
            hidden |= ~heard
        return places, hidden

    def in_view(self, ids: Indices, *x: Array) -> Indices:
        """Those above the mask, not behind the Earth, and with a lobe towards the chaser."""
        return ids[~self._seen(ids, x[0])[1]]

    def predict(self, ids: Indices, *x: Array) -> Array:
        """Pseudorange and place (k, 4), m. Raises GeometryError when a satellite is below
        the mask, behind the Earth, or turned away."""
        places, hidden = self._seen(ids, x[0])
        if hidden.any():
            raise GeometryError(f"{self.kind}: satellite {ids[hidden][0]} is not heard")
        at_zero = np.hstack([np.zeros((len(ids), 1)), places])
        return np.hstack([self._call("", ids, at_zero, x)[0], places])

    def perturb(self, z: Array, e: Array) -> Array:
        """Add e (k, 1), m, to the pseudoranges."""
        return np.hstack([z[:, :1] + e, z[:, 1:]])

    def starts(
        self, ids: Indices, z: Array, known: Mapping[str, Array]
    ) -> Iterator[dict[str, Array]]:
        """A place below the satellites, and a clock without error: four of them tell the rest.

        z: (k, 4), m; known: values of the other blocks, of which none is needed.
        """
        up = z[:, 1:].mean(axis=0)
        below = EARTH_RADIUS / max(float(np.linalg.norm(up)), 1.0) * up
        yield {CHASER_POSITION.name: below, CLOCK_BIAS.name: np.zeros(1)}

    def noise(self, m: Measurement) -> Array:
        return np.full((len(m.z), 1, 1), self.sigma**2)
