"""The Earth's gravity field as spherical harmonics: the coefficients of a public model.

    U = GM / r (1 + sum over n, m of (R / r)^n Pn(m, sin lat) (C_nm cos(m lon) + S_nm sin(m lon)))

fully normalised, in Earth-fixed axes (ITRF), with GM, R and tide system of the model itself: its
head says them. "tide_free": without the permanent tide and the deformation that it makes. No tides
are added: solid tides and the permanent one are 1e-7 m/s^2 in a low orbit each, less than what a
field to degree 60 leaves out.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError

__all__ = ["Geopotential", "geopotential"]


@dataclass(frozen=True, eq=False)
class Geopotential:
    """A field to a degree n: model and tide_system, by name; gm: m^3/s^2; radius: m; C and S:
    (n + 1, n + 1), fully normalised, by degree and order; C[0, 0] = 1."""

    model: str
    tide_system: str
    gm: float
    radius: float
    C: Array
    S: Array

    def upto(self, degree: int, order: int) -> tuple[Array, Array]:
        """C and S (degree + 1, degree + 1) with zeros beyond an order.

        Raises InputError on a degree that the model does not have, and an order above the degree.
        """
        most = len(self.C) - 1
        if not 0 <= degree <= most:
            raise InputError(f"degree: found {degree}, expected 0 to {most}, as {self.model} has")
        if not 0 <= order <= degree:
            raise InputError(f"order: found {order}, expected 0 to the degree, {degree}")
        C, S = (a[: degree + 1, : degree + 1].copy() for a in (self.C, self.S))
        C[:, order + 1 :] = S[:, order + 1 :] = 0.0
        return C, S


@cache
def geopotential() -> Geopotential:
    """The model that comes with the package, EGM2008 (its source is in its head)."""
    text = files("relnav_graph.maths").joinpath("egm2008.txt").read_text("utf-8")
    head, rows = text.split("n,m,C,S\n")
    lines = [line for line in head.splitlines() if not line.startswith("#")]
    told = dict(line.split(" = ") for line in lines)
    size = int(told["degree"]) + 1
    C, S = np.zeros((size, size)), np.zeros((size, size))
    C[0, 0] = 1.0
    for row in rows.splitlines():
        n, m, c, s = row.split(",")
        C[int(n), int(m)], S[int(n), int(m)] = float(c), float(s)
    numbers = float(told["gm_m3_s2"]), float(told["radius_m"])
    for a in (C, S):
        a.flags.writeable = False
    return Geopotential(told["model"], told["tide_system"], *numbers, C, S)
