"""What a scenario says of scores: axes that carry no other error, and what is left out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.models import DerivedQuantity
from relnav_graph.core.state import Block
from relnav_graph.errors import InputError

__all__ = ["AS_USUAL", "InAxes", "Scored"]


@dataclass(frozen=True)
class InAxes(DerivedQuantity):
    """A vector of the state in the axes of another frame: ``v_a = R_ab v_b``.

    Where b is badly known, errors of v_b are those of b; those of v_a are not, and its covariance
    is taken jointly with that of b. The block has the name of the vector, whose place it takes in
    scores. reads: the attitudes that lead there, from the vector's frame on, then the vector.
    """

    block: Block
    reads: tuple[Block, ...]

    @property
    def kind(self) -> str:
        return f"{self.block.name} in {self.block.frame}"

    @staticmethod
    def of(vector: Block, frame: str, state: Iterable[Block]) -> InAxes:
        """A vector in the axes `frame`, by the attitudes of a state, as few as can be.

        Raises InputError where it is no vector of three components, or none leads there.
        """
        if vector.manifold != "vector" or vector.dim != 3:
            raise InputError(f"{vector.name} is no vector of three components")
        turns = [b for b in state if b.manifold == "SO3" and len(b.frame) == 2]
        paths: dict[str, tuple[Block, ...]] = {vector.frame: ()}
        waiting = [vector.frame]
        for letter in waiting:
            for turn in turns:
                a, b = turn.frame[0], turn.frame[1]
                to = {a: b, b: a}.get(letter, letter)
                if to not in paths:
                    paths[to] = (*paths[letter], turn)
                    waiting.append(to)
        if frame not in paths or frame == vector.frame:
            known = ", ".join(paths.keys() - {vector.frame}) or "none"
            raise InputError(
                f"found {frame!r}, expected other axes than its own, {vector.frame!r}, to which"
                f" attitudes of the state lead: {known}"
            )
        symbol = f"{vector.symbol.rpartition('_')[0]}_{frame}"
        return InAxes(replace(vector, symbol=symbol, frame=frame), (*paths[frame], vector))

    def values(self, *x: Array) -> tuple[Array, Array]:
        """v_a (N, 3) and its Jacobian (N, 3, dims read), SI; x: (N, 3, 3) per attitude, (N, 3).

        With a right perturbation, R Exp(d) v = R v + R (d x v) and (R Exp(d))^T v = R^T v - d x R^T
        v.
        """
        frame, v, parts = self.reads[-1].frame, x[-1], list[Array]()
        slope = np.tile(np.eye(3), (len(v), 1, 1))
        for block, R in zip(self.reads[:-1], x[:-1], strict=True):
            a, b = block.frame[0], block.frame[1]
            forward = frame == b
            turn = R if forward else np.swapaxes(R, 1, 2)
            before, v = v, np.einsum("kij,kj->ki", turn, v)
            own = -turn @ _skews(before) if forward else _skews(v)
            parts = [turn @ p for p in parts] + [own]
            slope, frame = turn @ slope, a if forward else b
        return v, np.concatenate([*parts, slope], axis=2)


def _skews(v: Array) -> Array:
    """``[v x]`` (N, 3, 3) of vectors v (N, 3)."""
    skews: Array = -np.cross(v[:, None], np.eye(3)[None])
    return skews


@dataclass(frozen=True)
class Scored:
    """How tracks are scored: `in_axes`, vectors that are compared in other axes than their own;
    `without`, names of the blocks (or families) that a second joint ANEES leaves out."""

    in_axes: Sequence[InAxes] = ()
    without: tuple[str, ...] = ()

    def describe(self) -> Mapping[str, object]:
        """As a summary says it; {} where nothing is said."""
        axes = {q.block.name: q.block.frame for q in self.in_axes}
        return ({"axes": axes} if axes else {}) | (
            {"without": list(self.without)} if self.without else {}
        )


#: Every block in its own axes.
AS_USUAL = Scored()
