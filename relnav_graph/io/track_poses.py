"""The pose that a track says, with the covariance of place and attitude together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import RELATIVE_ATTITUDE
from relnav_graph.core.contracts import Derived
from relnav_graph.core.models import derived_quantities
from relnav_graph.core.state import Block, Layout
from relnav_graph.core.track import Track
from relnav_graph.errors import InputError
from relnav_graph.io.poses import Motion

__all__ = ["FRAMES", "TrackPose", "pose_of", "twist_of"]

#: Names of frames by their letters, as other programs may call them.
FRAMES: Mapping[str, str] = {
    "i": "inertial",
    "o": "orbital",
    "t": "target",
    "c": "chaser",
    "s": "sensor",
}


@dataclass(frozen=True, eq=False)
class TrackPose:
    """motion: its values and covariances; frame: the name of the frame that they are in; body: of
    what has the attitude, "" where there is none."""

    motion: Motion
    frame: str
    body: str

    def check(self) -> None:
        """Raise InputError where a value, or its covariance, is not finite."""
        for part in (self.motion.values, self.motion.covariances):
            for name, value in part.items():
                bad = np.nonzero(~np.isfinite(value.reshape(len(value), -1)).all(axis=1))[0]
                if len(bad):
                    raise InputError(
                        f"{self.motion.where(int(bad[0]))}: found a {name} that is not finite"
                    )


def _quantities(track: Track) -> dict[str, Block | Derived]:
    """Blocks of a track, and what derives from them, by name."""
    found: dict[str, Block | Derived] = {b.name: b for b in track.blocks if b.number is None}
    for quantity in derived_quantities(Layout(track.blocks)):
        found.setdefault(quantity.block.name, quantity)
    return found


def _block(one: Block | Derived) -> Block:
    return one if isinstance(one, Block) else one.block


def _joint(track: Track, chosen: list[Block | Derived]) -> tuple[list[Array], Array]:
    """Values of quantities, and the covariance (N, n, n) of all of them together."""
    reads = list(
        dict.fromkeys(
            b for one in chosen for b in ((one,) if isinstance(one, Block) else one.reads)
        )
    )
    starts = np.cumsum([0, *(b.dim for b in reads)])
    at = {b.name: slice(i, i + b.dim) for b, i in zip(reads, starts, strict=False)}
    n, values, rows = len(track.t), list[Array](), list[Array]()
    for one in chosen:
        J = np.zeros((n, _block(one).dim, starts[-1]))
        if isinstance(one, Block):
            values.append(track.value(one.name))
            J[:, :, at[one.name]] = np.eye(one.dim)
        else:
            # Where an estimate has no number, what derives from it has none.
            x = [track.value(b.name) for b in one.reads]
            found = [one.value(*(v[k] for v in x)) for k in range(n)]
            values.append(np.array([value for value, _ in found]))
            own = np.array([jacobian for _, jacobian in found])
            widths = np.cumsum([0, *(b.dim for b in one.reads)])
            for b, i in zip(one.reads, widths, strict=False):
                J[:, :, at[b.name]] = own[:, :, i : i + b.dim]
        rows.append(J)
    A = np.concatenate(rows, axis=1)
    P = A @ track.covariance(*(b.name for b in reads)) @ np.swapaxes(A, 1, 2)
    return values, P


def _chosen(
    track: Track, there: Mapping[str, Block | Derived], what: str, name: str, usual: tuple[str, ...]
) -> Block | Derived | None:
    """The quantity of that name; without one, the first of the usual that the track has."""
    manifold = "SO3" if what == "attitude" else "vector"
    fitting = {
        n: q
        for n, q in there.items()
        if _block(q).manifold == manifold and (manifold == "SO3" or _block(q).dim == 3)
    }
    if name:
        if name not in fitting:
            raise InputError(
                f"track {track.name!r}: found {name!r} as {what}, expected one of"
                f" {', '.join(fitting) or 'those that it has, which are none'}"
            )
        return fitting[name]
    return next((fitting[n] for n in usual if n in fitting), None)


def pose_of(
    track: Track, attitude: str = "", position: str = "", inverse: bool = False
) -> TrackPose:
    """Position and attitude at the epochs of a track, with their joint covariance.

    attitude, position: names of blocks, or of what derives from them. By default the chaser's pose
    in the target's frame, R_tc and r_tc_t, where the track says it, else the one attitude that it
    has, and relative_position. inverse: the other pose of the two.

    Raises InputError on names that the track has not, on several attitudes with none named, without
    any position, and on a position in other axes than the attitude's.
    """
    there = _quantities(track)
    turn = _chosen(track, there, "attitude", attitude, (RELATIVE_ATTITUDE.name,))
    if turn is None:
        turns = [q for q in there.values() if _block(q).manifold == "SO3"]
        if len(turns) > 1:
            names = ", ".join(_block(q).name for q in turns)
            raise InputError(f"track {track.name!r}: found {names}; name one, option attitude")
        turn = turns[0] if turns else None
    place = _chosen(track, there, "position", position, ("position_in_target", "relative_position"))
    if place is None:
        names = ", ".join(there)
        raise InputError(f"track {track.name!r}: found no position among {names}; option position")
    if turn is None:
        (r,), P = _joint(track, [place])
        motion = _motion(track, {"position": r}, {"position": P})
        return TrackPose(motion, _frame(_block(place).frame), "")
    axes, other = _block(turn).frame[:1], _block(place).frame
    if axes != other:
        raise InputError(
            f"track {track.name!r}: found {_block(place).name} in {other} and"
            f" {_block(turn).name} to {axes}, expected one frame; options position, attitude"
        )
    (r, R), P = _joint(track, [place, turn])
    motion = _motion(track, {"position": r, "attitude": R}, {"pose": P})
    frame, body = _frame(axes), _frame(_block(turn).frame[1:])
    return TrackPose(motion.inverse(), body, frame) if inverse else TrackPose(motion, frame, body)


def twist_of(track: Track, rate: str = "", velocity: str = "") -> TrackPose:
    """A velocity (m/s) and a rate (rad/s) of a track, one of them or both, by their names; their
    covariance as "twist", (N, 6, 6) or (N, 3, 3), the velocity first.

    Raises InputError on names that the track has not, and on two in different frames.
    """
    there = _quantities(track)
    named = {"velocity": velocity, "rate": rate}
    parts = {k: _chosen(track, there, k, name, ()) for k, name in named.items() if name}
    found = {k: one for k, one in parts.items() if one is not None}
    frames = {_block(one).frame for one in found.values()}
    if len(frames) != 1:
        raise InputError(
            f"track {track.name!r}: found {velocity or 'no velocity'} and {rate or 'no rate'} in"
            f" frames {', '.join(sorted(frames)) or 'none'}, expected one"
        )
    values, P = _joint(track, list(found.values()))
    motion = _motion(track, dict(zip(found, values, strict=True)), {"twist": P})
    return TrackPose(motion, _frame(frames.pop()), "")


def _motion(track: Track, values: dict[str, Array], covariances: dict[str, Array]) -> Motion:
    def where(k: int) -> str:
        return f"track {track.name!r}, t = {track.t[k]:.9g} s"

    return Motion(track.t, values, where, covariances)


def _frame(letters: str) -> str:
    return FRAMES.get(letters, letters)
