"""What kernels say by their status: which length is zero, or what is beyond floats."""

from __future__ import annotations

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.compiled.contracts import DEGENERATE

#: Lengths that can be, m: no atom is smaller and no universe larger. Their sixth powers, and
#: those of their inverses, are finite.
SHORTEST, LONGEST = 1e-30, 1e30


@jit
def length_status(length: float, which: int) -> int:
    """0 when one can divide by a length; else the status that `degenerate` puts in words.

    length: m; which: number of the quantity among those given to `degenerate`.
    """
    if SHORTEST < length < LONGEST:
        return 0
    return DEGENERATE + 2 * which + (0 if length <= SHORTEST else 1)


def degenerate(*quantities: str) -> dict[int, str]:
    """What the statuses of `length_status` mean, for a model's `failures`."""
    return {
        DEGENERATE + 2 * which + k: f"{quantity} {what}"
        for which, quantity in enumerate(quantities)
        for k, what in enumerate(("is zero", f"is beyond {LONGEST:g} m"))
    }


#: Status of processes about an orbit, and what it means.
LOST_ORBIT = 1
NO_PLACE = "the target's place on its orbit cannot be told at these times: too many turns from 0"
#: Status of processes about an orbit in the state, and what it means.
NO_ORBIT = 4
ORBIT_FAILURES = {
    LOST_ORBIT: NO_PLACE,
    NO_ORBIT: "the estimated orbit of the target is none: no radius, or beyond what floats hold",
}
#: Statuses of processes of a rotation: of its rate, and of the inertia's parameters.
TOO_FAST, NO_BODY = 2, 3
ROTATION_FAILURES = {
    **ORBIT_FAILURES,
    TOO_FAST: "the rate of the target is beyond what floats hold",
    NO_BODY: "the inertia parameters are too large for any body: its moments are beyond floats",
}


@jit
def finite(rows: Array) -> bool:
    """Whether all numbers of a matrix (m, n) are finite."""
    for i in range(rows.shape[0]):
        for j in range(rows.shape[1]):
            if not np.isfinite(rows[i, j]):
                return False
    return True
