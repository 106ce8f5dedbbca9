"""State blocks, their layout in one vector, and the operations of the state manifold.

A *block* is one physical quantity: an attitude on SO(3) or a vector. A `Layout` puts
blocks one after the other: a *stored* vector x (nine numbers, row by row, for an
attitude) and a *tangent* vector (three numbers for an attitude: the right perturbation,
rad, in the frame on the right of its name).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.errors import InputError, ModelError
from relnav_graph.maths.manifold import block_jacobian, local, local_all, retract, retract_all
from relnav_graph.units import unit_scale

__all__ = [
    "UNIT_QUATERNION",
    "Block",
    "Layout",
    "check_rotation",
]

#: How far from one the length of a quaternion in a file or a measurement may be: digits lost
#: there, not a number that is no quaternion. It is then normalised.
UNIT_QUATERNION = 1e-3


def check_rotation(where: str, matrix: Array) -> None:
    """Raise InputError unless a (3, 3) matrix is a rotation within 1e-6."""
    error = np.abs(matrix.T @ matrix - np.eye(3)).max()
    if error > 1e-6:
        raise InputError(f"{where}: not a rotation (R^T R - I up to {error:.1e})")
    if np.linalg.det(matrix) < 0:
        raise InputError(f"{where}: not a rotation but a reflection (determinant -1)")


@dataclass(frozen=True)
class Block:
    """One physical quantity of the state.

    name: as in tables and files; symbol: as in figures; manifold: "SO3" or "vector";
    dim: tangent dimension; unit: SI unit of the tangent; frame: letters of the frames
    (``tc`` for an attitude R_tc; ``o`` for components in o); table_unit: what people
    read in tables; number: of one of a family of blocks, such as the points of a map, see
    :meth:`numbered`.
    """

    name: str
    symbol: str
    manifold: Literal["SO3", "vector"]
    dim: int
    unit: str
    frame: str
    table_unit: str
    number: int | None = None

    def __post_init__(self) -> None:
        if self.manifold == "SO3" and self.dim != 3:
            raise ModelError(f"block {self.name}: an SO3 block has dimension 3, not {self.dim}")
        unit_scale(self.table_unit, self.unit)

    def numbered(self, number: int) -> Block:
        """The block ``name[number]`` of the family of which this one tells all but the number.

        Raises InputError on a number below zero, and when this one has a number itself.
        """
        if number < 0 or self.number is not None:
            raise InputError(f"{self.name}[{number}]: found, expected one number, zero or more")
        return replace(
            self,
            name=f"{self.name}[{number}]",
            symbol=f"{self.symbol}_{number}",
            number=number,
        )

    @property
    def family(self) -> str:
        """The name without the number."""
        return self.name if self.number is None else self.name[: self.name.rindex("[")]

    @property
    def size(self) -> int:
        """Number of stored values: 9 for an attitude, else `dim`."""
        return 9 if self.manifold == "SO3" else self.dim

    @property
    def table_scale(self) -> float:
        """Factor from SI to the unit of the tables."""
        return 1.0 / unit_scale(self.table_unit, self.unit)

    def unpack(self, stored: Array) -> Array:
        """Stored values (..., size) as (..., 3, 3) for an attitude, unchanged otherwise."""
        return stored.reshape(*stored.shape[:-1], 3, 3) if self.manifold == "SO3" else stored

    def pack(self, value: Any) -> Array:
        """Stored values (size,) of one value, (3, 3) for an attitude, else (dim,), SI.

        The inverse of :meth:`unpack`. Raises InputError when the shape is wrong, a number is
        not finite, or a matrix is not a rotation within 1e-6.
        """
        array = np.ascontiguousarray(value, dtype=np.float64)
        shape = (3, 3) if self.manifold == "SO3" else (self.dim,)
        if array.shape != shape or not np.isfinite(array).all():
            raise InputError(f"{self.name}: found {value!r}, expected finite numbers of {shape}")
        if self.manifold == "SO3":
            check_rotation(self.name, array)
        return array.reshape(-1)

    def local(self, a: Array, b: Array) -> Array:
        """Tangent vectors (..., dim) from values `a` to values `b`, (..., 3, 3) or (..., dim).

        ``Log(a^T b)``, rad, for attitudes, ``b - a`` for vectors. Raises InputError on two
        different shapes.
        """
        if a.shape != b.shape:
            raise InputError(f"{self.name}: found shapes {a.shape} and {b.shape}, expected one")
        if self.manifold == "SO3":
            stacks = (np.ascontiguousarray(m, dtype=np.float64).reshape(-1, 9) for m in (a, b))
            out = np.empty((*a.shape[:-2], 3))
            local_all(*stacks, _ROTATION, out.reshape(-1, 3))
            return out
        return b - a


#: The kinds, as in :func:`retract`, of one attitude.
_ROTATION = np.array([[1, 0, 0, 3]])


class Layout:
    """Blocks in order, and where each stands in the stored and in the tangent vector.

    blocks: those that move from epoch to epoch; statics: those that have one value for the whole
    pass, after them. Raises ModelError when one name is declared in two ways (two frames, say).
    """

    def __init__(self, blocks: Iterable[Block], statics: Iterable[Block] = ()) -> None:
        constant = list(statics)
        unique: dict[str, Block] = {}
        for block in (*blocks, *constant):
            if unique.setdefault(block.name, block) != block:
                raise ModelError(
                    f"block {block.name!r} is declared twice, and differently: "
                    f"{unique[block.name]} and {block}"
                )
        self._named = unique
        self.blocks: tuple[Block, ...] = tuple(unique.values())
        self._stored: dict[str, slice] = {}
        self._tangent: dict[str, slice] = {}
        self.size = self.dim = 0
        for block in self.blocks:
            self._stored[block.name] = slice(self.size, self.size + block.size)
            self._tangent[block.name] = slice(self.dim, self.dim + block.dim)
            self.size += block.size
            self.dim += block.dim
        self._moving = len(self.blocks) - len({block.name for block in constant})

    @cached_property
    def moving(self) -> Layout:
        """The layout of the blocks that move alone: its vectors are the first part of these."""
        return self if self._moving == len(self.blocks) else Layout(self.blocks[: self._moving])

    @cached_property
    def statics(self) -> Layout:
        """The layout of the static blocks alone: its vectors are the last part of these."""
        return Layout(self.blocks[self._moving :])

    def __iter__(self) -> Iterator[Block]:
        return iter(self.blocks)

    def __len__(self) -> int:
        return len(self.blocks)

    def __contains__(self, name: object) -> bool:
        return name in self._stored

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Layout)
            and self.blocks == other.blocks
            and self._moving == other._moving
        )

    def __hash__(self) -> int:
        return hash(self.blocks)

    def __repr__(self) -> str:
        names = [b.name for b in self.blocks]
        static = (
            f"; static: {', '.join(names[self._moving :])}" if self._moving < len(names) else ""
        )
        return f"Layout({', '.join(names[: self._moving])}{static})"

    def block(self, name: str) -> Block:
        """The block called `name`; raises ModelError when there is none."""
        if (block := self._named.get(name)) is None:
            raise ModelError(f"no block {name!r}; the state has {list(self._named)}")
        return block

    def stored(self, name: str) -> slice:
        """Where the stored values of a block stand."""
        return self._stored[self.block(name).name]

    def tangent(self, name: str) -> slice:
        """Where the tangent of a block stands: its rows and columns in a covariance."""
        return self._tangent[self.block(name).name]

    def slices(self, name: str) -> tuple[slice, slice]:
        """Where a block stands in the stored vector, and in the tangent."""
        return self.stored(name), self.tangent(name)

    @cached_property
    def kinds(self) -> Indices:
        """One row (is_SO3, stored offset, tangent offset, dim) per block."""
        return np.array(
            [
                (
                    b.manifold == "SO3",
                    self._stored[b.name].start,
                    self._tangent[b.name].start,
                    b.dim,
                )
                for b in self.blocks
            ],
            dtype=np.int64,
        ).reshape(-1, 4)

    @cached_property
    def identity(self) -> Array:
        """The stored vector (size,) of identity attitudes and zero vectors."""
        x = np.zeros(self.size)
        for block in self.blocks:
            if block.manifold == "SO3":
                x[self._stored[block.name]] = np.eye(3).reshape(-1)
        return x

    def gather(self, blocks: Iterable[Block]) -> tuple[Indices, Indices]:
        """Indices of `blocks`, one after the other: (s,) in the stored vector, (d,) in the tangent
        vector, with s the sum of their sizes and d that of their dims."""
        names = [block.name for block in blocks]
        stored = [np.arange(self.size)[self.stored(n)] for n in names]
        tangent = [np.arange(self.dim)[self.tangent(n)] for n in names]
        return np.concatenate(stored), np.concatenate(tangent)

    def pack(self, values: Mapping[str, Any]) -> Array:
        """Stored vector (size,) of a value per block, (3, 3) or (dim,), SI.

        Raises InputError on a missing block.
        """
        missing = [b.name for b in self.blocks if b.name not in values]
        if missing:
            raise InputError(f"no value for {missing}")
        return np.concatenate([b.pack(values[b.name]) for b in self.blocks])

    def value(self, x: Array, name: str) -> Array:
        """Value of one block in stored vectors x (..., size): (..., 3, 3) or (..., dim), SI."""
        return self.block(name).unpack(x[..., self.stored(name)])

    def values(self, x: Array) -> dict[str, Array]:
        """Value of each block in stored vectors x (..., size), by name; see :meth:`value`."""
        return {b.name: self.value(x, b.name) for b in self.blocks}

    def held(self, x: Array) -> Array:
        """The trajectory x (N, size) with the static blocks of its last row in every row."""
        if not self.statics:
            return x
        out = np.array(x)
        out[:, self.moving.size :] = x[-1, self.moving.size :]
        return out

    def retract(self, x: Array, d: Array) -> Array:
        """``x (+) d``: R Exp(d) on attitudes, sum on vectors.

        (size,), (dim,) -> (size,), or a whole trajectory, (N, size), (N, dim) -> (N, size).
        """
        if x.ndim == 1:
            return retract(x, d, self.kinds)
        out = np.empty((len(d), self.size))
        x, d = (np.ascontiguousarray(v, dtype=np.float64) for v in (x, d))
        self._check(x, (len(x), self.size), d, (len(x), self.dim))
        retract_all(x, d, self.kinds, out)
        return out

    def local(self, a: Array, b: Array) -> Array:
        """The tangent vector d (dim,) with ``a (+) d = b``; (N, dim) of trajectories (N, size)."""
        if a.ndim == 1:
            return local(a, b, self.kinds, self.dim)
        out = np.empty((len(a), self.dim))
        a, b = (np.ascontiguousarray(v, dtype=np.float64) for v in (a, b))
        self._check(a, (len(a), self.size), b, (len(a), self.size))
        local_all(a, b, self.kinds, out)
        return out

    def _check(self, a: Array, of_a: tuple[int, int], b: Array, of_b: tuple[int, int]) -> None:
        """Raise InputError on trajectories that do not fit: compiled loops do not look."""
        if a.shape != of_a or b.shape != of_b:
            raise InputError(
                f"trajectories: found {a.shape} and {b.shape}, expected {of_a} and {of_b}"
            )

    def check_states(self, x: Array, count: int) -> None:
        """Raise InputError unless x is (count, size), static blocks in every row: compiled loops
        would read beyond rows that are shorter."""
        if x.shape != (count, self.size):
            raise InputError(
                f"states: found an array {x.shape}, expected {(count, self.size)} of {self!r};"
                " a track has them, static blocks too, as `states`"
            )

    def right_jacobian(self, d: Array) -> Array:
        """J (dim, dim) with ``x (+) (d + e) = (x (+) d) (+) J e`` to first order, of d (dim,)."""
        return block_jacobian(d, self.kinds, False)

    def right_jacobian_inverse(self, d: Array) -> Array:
        """Inverse (dim, dim) of :meth:`right_jacobian` at d (dim,)."""
        return block_jacobian(d, self.kinds, True)
