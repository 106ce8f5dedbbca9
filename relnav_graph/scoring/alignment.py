"""An estimated map laid upon the true one, and the trajectory with it.

What an estimate cannot know, the frame t of a target without a model, is taken out of the errors
by one motion of the whole: X_est ~ A X_true + b by least squares over the points, with a rotation
A and a shift b (Umeyama 1991, without scale and with it).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import (
    BODY_RATE,
    POINT,
    RELATIVE_ATTITUDE,
    RELATIVE_POSITION,
    RELATIVE_POSITION_T,
    TARGET_ATTITUDE,
    TARGET_RATE,
)
from relnav_graph.core.contracts import Derived
from relnav_graph.core.numbered import members
from relnav_graph.core.track import Track, Truth
from relnav_graph.scoring.deviations import deviations, estimates, finite
from relnav_graph.scoring.maps import known_points

__all__ = ["Alignment", "align", "aligned"]

#: Fewer points, or points on one line, tell no rotation.
_FEWEST = 3


@dataclass(frozen=True, eq=False)
class Alignment:
    """X_est ~ scale A X_true + b: A (3, 3) a rotation, b (3,) m, scale a number; both in t."""

    A: Array
    b: Array
    scale: float = 1.0

    def points(self, X: Array) -> Array:
        """Estimated points (k, 3), m, in the true frame."""
        return (X - self.b) @ self.A / self.scale

    def track(self, track: Track) -> Track:
        """The track in the true frame t: its values of pose and rate, with `scale` lengths
        too; covariances, velocities and static blocks stay.

        With R_ot' = R_ot A and r_tc_o' = (r_tc_o - R_ot b) / scale, or R_tc' = A^T R_tc and r_tc_t'
        = A^T (r_tc_t - b) / scale, the sights R_ot X - r_tc_o of all points stay as they are but
        for their scale.
        """
        own, x = track.layout, track.x.copy()
        A, b = self.A, self.b

        def put(name: str, value: Array) -> None:
            x[:, own.stored(name)] = value.reshape(len(x), -1)

        if TARGET_ATTITUDE in own.blocks:
            R_ot = track.value(TARGET_ATTITUDE.name)
            put(TARGET_ATTITUDE.name, R_ot @ A)
            if RELATIVE_POSITION in own.blocks:
                r = track.value(RELATIVE_POSITION.name)
                put(RELATIVE_POSITION.name, (r - R_ot @ b) / self.scale)
        if RELATIVE_ATTITUDE in own.blocks:
            put(RELATIVE_ATTITUDE.name, A.T @ track.value(RELATIVE_ATTITUDE.name))
        if RELATIVE_POSITION_T in own.blocks:
            put(RELATIVE_POSITION_T.name, self.points(track.value(RELATIVE_POSITION_T.name)))
        for rate in (TARGET_RATE, BODY_RATE):
            if rate in own.blocks:
                put(rate.name, track.value(rate.name) @ A)
        return replace(track, x=x)


def align(true: Array, estimated: Array, scaled: bool = False) -> Alignment | None:
    """The motion from true points (k, 3) to estimated ones (k, 3), m, with least squares.

    None where the points do not tell it: fewer than three, on one line, or not finite. Umeyama
    1991, eq. 39 to 42.
    """
    if len(true) < _FEWEST or not np.isfinite([true, estimated]).all():
        return None
    middle, other = true.mean(axis=0), estimated.mean(axis=0)
    U, D, Vt = np.linalg.svd((estimated - other).T @ (true - middle))
    if not D[1] > 1e-9 * D[0]:
        return None
    S = np.array([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    A = (U * S) @ Vt
    scale = float((D * S).sum() / ((true - middle) ** 2).sum()) if scaled else 1.0
    return Alignment(A, other - scale * A @ middle, scale)


def _moved(track: Track, derived: Sequence[Derived]) -> set[str]:
    """States that an alignment moves: pose of the target, and what is derived of it."""
    blocks = {TARGET_ATTITUDE, RELATIVE_POSITION, RELATIVE_ATTITUDE, RELATIVE_POSITION_T}
    moved = blocks & set(track.layout.blocks)
    return {b.name for b in moved} | {
        d.block.name for d in derived if not moved.isdisjoint(d.reads)
    }


def _entry(
    motion: Alignment,
    points: tuple[Array, Array],
    track: Track,
    truth: Truth,
    derived: Sequence[Derived],
) -> dict[str, Any]:
    true, estimated = points
    off = np.linalg.norm(true - motion.points(estimated), axis=1)
    angle = np.arccos(np.clip((np.trace(motion.A) - 1) / 2, -1.0, 1.0))
    laid, names = motion.track(track), _moved(track, derived)
    found = deviations(estimates(laid, derived), laid.t, truth, derived)
    states = {}
    for name, s in found.items():
        if name in names and len(s.t):
            rmse = s.block.table_scale * np.sqrt((s.e**2).sum(axis=1).mean())
            states[name] = {"unit": s.block.table_unit, "rmse": float(rmse)}
    return {
        "rotation_deg": float(np.degrees(angle)),
        "shift_m": float(np.linalg.norm(motion.b)),
        "map_rmse_m": float(np.sqrt((off**2).mean())),
        "map_max_m": float(off.max()),
        "states": states,
    }


def aligned(
    track: Track, truth: Truth | None, derived: Sequence[Derived], inside: NDArray[np.bool_]
) -> Mapping[str, Any]:
    """Errors of map and pose after one alignment on the map, over the epochs of a mask (N,).

    The map is that of the last of them. points: how many; rotation_deg, shift_m: the alignment;
    map_rmse_m, map_max_m: what it leaves of the map; states: rmse by name, in table units; scale:
    of the alignment with a scale, and `scaled`: the same errors after that one. {} without truth
    of three points.
    """
    known = known_points(truth)
    numbered = members(track.mapped).get(POINT.name, ())
    names = [b.name for b in numbered if b.name in known]
    track = track.at(inside)
    if truth is None or len(names) < _FEWEST or not finite(track.states).all():
        return {}
    points = np.array([known[n] for n in names]), np.array([track.value(n)[-1] for n in names])
    motion, similar = align(*points), align(*points, scaled=True)
    if motion is None or similar is None:
        return {}
    of = (points, track, truth, derived)
    scaled = {"scale": similar.scale, "scaled": _entry(similar, *of)}
    return {"points": len(names), **_entry(motion, *of), **scaled}
