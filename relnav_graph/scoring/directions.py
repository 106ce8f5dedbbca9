"""Directions of the error state that have a name: those that models tell, and what a target
without a model may hide: its centre of mass, its scale, its inertia, its frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import expm_frechet, null_space

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import (
    BODY_RATE,
    INERTIA_MATRIX,
    POINT,
    RELATIVE_ATTITUDE,
    RELATIVE_POSITION,
    RELATIVE_POSITION_T,
    RELATIVE_VELOCITY,
    RELATIVE_VELOCITY_T,
    TARGET_ATTITUDE,
    TARGET_RATE,
)
from relnav_graph.core.contracts import NamesDirections
from relnav_graph.core.numbered import members, numbered_of
from relnav_graph.core.problem import Problem
from relnav_graph.core.state import Block, Layout
from relnav_graph.maths import so3
from relnav_graph.maths.inertia import TRACELESS

__all__ = [
    "ACROSS",
    "ALIKE",
    "ALONG",
    "GAUGE",
    "INERTIA",
    "SCALE",
    "Direction",
    "named_directions",
    "spin",
]

#: A direction is named after another one when the cosine between them is at least this.
ALIKE = 0.8

#: Names of what a target without a model may hide; `INERTIA` begins those of its inertia.
ALONG = "centre of mass along the spin axis"
ACROSS = "centre of mass across the spin axis"
SCALE = "scale of the map, with position and velocity"
GAUGE = "frame t turned, with attitude, map and inertia"
INERTIA = "inertia: "


@dataclass(frozen=True, eq=False)
class Direction:
    """A direction of the error state, or several that share a name: the columns of D (n, k).

    unit: shown in tables; scale: from SI to that unit; W (n, k): where the amplitude along d is
    that of certain states, w^T e with w^T d = 1; None: of all states, by the prior's metric.
    """

    name: str
    D: Array
    unit: str
    scale: float
    W: Array | None = None

    def members(self) -> Iterator[tuple[str, Array, Array | None]]:
        """Each column with its name, and its w (n,)."""
        for k, d in enumerate(self.D.T):
            name = self.name if self.D.shape[1] == 1 else f"{self.name} ({_LETTERS[k]})"
            yield name, d, None if self.W is None else self.W[:, k]

    def alike(self, v: Array, inverse: Array) -> tuple[float, str]:
        """Cosine of the angle between v and the span of these directions, and a name for v.

        With whitened directions W D = Q R: |Q^T v|. v (n,): whitened, of length 1; inverse
        (n, n): W, the inverse Cholesky factor of the prior's covariance. Of several directions
        the name tells the combination that comes nearest.
        """
        basis, mixing = np.linalg.qr(inverse @ self.D)
        part = basis.T @ v
        size = float(np.linalg.norm(part))
        if self.D.shape[1] == 1 or size < ALIKE:
            return size, self.name
        weights = np.linalg.solve(mixing, part)
        weights /= np.linalg.norm(weights) * np.sign(weights[np.abs(weights).argmax()])
        text = ", ".join(f"{round(w, 2) + 0.0:.2f}" for w in weights)
        return size, f"{self.name} ({text})"


_LETTERS = "xyz123456"


def spin(layout: Layout, x: Array) -> Array | None:
    """The axis (3,), in t, about which the target turns most in the states x (N, size): of the
    largest mean square of its rate; None where it rests, or no rate is in the state."""
    rate = next((b for b in (TARGET_RATE, BODY_RATE) if b in layout.blocks), None)
    if rate is None:
        return None
    w = layout.value(x, rate.name)
    square, axes = np.linalg.eigh(w.T @ w)
    return axes[:, -1] if square[-1] > 0 else None


def named_directions(problem: Problem, x: Array, axis: Array | None = None) -> list[Direction]:
    """Directions that the models name at the state x (size,); and of an unknown map, where there is
    one, with the spin axis (3,) of the target in t, by default that of the state.

    A model names directions by a method ``directions(*x)``: by name, for every block that
    it reads (a process: advances and reads) the tangents (dim, k) of k directions. Those of a
    sensor of unknown points would leave the points where they are: they are not asked for.
    """
    layout, found = problem.layout, dict[str, Direction]()
    models: list[tuple[Any, tuple[Block, ...]]] = [
        (p, p.advances + p.reads) for p in problem.processes.values()
    ]
    models += [(s, s.reads) for s in problem.sensors.values() if numbered_of(s) is None]
    for model, blocks in models:
        if not isinstance(model, NamesDirections):
            continue
        values = [layout.value(x, b.name) for b in blocks]
        for name, parts in model.directions(*values).items():
            D = np.zeros((layout.dim, parts[0].shape[1]))
            D[layout.gather(blocks)[1]] = np.concatenate(parts)
            first = next((b for b, p in zip(blocks, parts, strict=True) if p.any()), None)
            if first is not None:
                one = Direction(name, D, first.table_unit, first.table_scale)
                found.setdefault(name, one)
    points = members(layout.statics).get(POINT.name, ())
    if not points:
        return list(found.values())
    own = _of_map(layout, points, x, spin(layout, x[None]) if axis is None else axis)
    if INERTIA_MATRIX in layout.blocks:  # named by the spin instead
        rows = layout.tangent(INERTIA_MATRIX.name)
        found = {n: d for n, d in found.items() if np.delete(d.D, np.r_[rows], axis=0).any()}
    return [*own, *found.values()]


def _of_map(
    layout: Layout, points: tuple[Block, ...], x: Array, axis: Array | None
) -> list[Direction]:
    value = layout.value
    there = set(layout.blocks)
    X = np.array([value(x, b.name) for b in points])
    rows = layout.gather(points)[1]
    R_ot = value(x, TARGET_ATTITUDE.name) if TARGET_ATTITUDE in there else np.eye(3)
    rate = next((b for b in (TARGET_RATE, BODY_RATE) if b in there), None)
    w = np.zeros(3) if rate is None else value(x, rate.name)

    def filled(parts: Mapping[Block, Array], of_points: Array | None = None) -> Array:
        """Tangents (n, k) from those of blocks, where they are there, and of points (3 m, k)."""
        columns = next(iter(parts.values())) if of_points is None else of_points
        D = np.zeros((layout.dim, columns.shape[1]))
        if of_points is not None:
            D[rows] = of_points
        for block, part in parts.items():
            if block in there:
                D[layout.tangent(block.name)] = part
        return D

    def shifted(a: Array) -> tuple[Array, Array]:
        """The origin of t moved by -a (3, k) in the body, and the mean of the points."""
        still = np.tile(a, (len(points), 1))
        parts = {
            RELATIVE_POSITION: R_ot @ a,
            RELATIVE_VELOCITY: R_ot @ so3.skew(w) @ a,
            RELATIVE_POSITION_T: a,
        }
        return filled(parts, still), filled({}, still / len(points))

    out = []
    if axis is None:
        D, W = shifted(np.eye(3))
        out.append(Direction("centre of mass in the map", D, "mm", 1e3, W))
    else:
        for name, a in ((ALONG, axis[:, None]), (ACROSS, null_space(axis[None]))):
            D, W = shifted(a)
            out.append(Direction(name, D, "mm", 1e3, W))
    lengths = (RELATIVE_POSITION, RELATIVE_VELOCITY, RELATIVE_POSITION_T, RELATIVE_VELOCITY_T)
    grown = {b: value(x, b.name)[:, None] for b in lengths if b in there}
    centred = (X - X.mean(axis=0)).reshape(-1, 1)
    if centred.any():
        W = filled({}, centred / (centred**2).sum())
        out.append(Direction(SCALE, filled(grown, X.reshape(-1, 1)), "1", 1.0, W))
    turned: dict[Block, Array] = {TARGET_ATTITUDE: np.eye(3)}
    if RELATIVE_ATTITUDE in there:
        turned[RELATIVE_ATTITUDE] = -value(x, RELATIVE_ATTITUDE.name).T
    for block in (TARGET_RATE, BODY_RATE, RELATIVE_POSITION_T, RELATIVE_VELOCITY_T):
        if block in there:
            turned[block] = so3.skew(value(x, block.name))
    if INERTIA_MATRIX in there:
        k = value(x, INERTIA_MATRIX.name)
        S = np.tensordot(k, TRACELESS, 1)
        turns = [S @ so3.skew(e) - so3.skew(e) @ S for e in np.eye(3)]
        turned[INERTIA_MATRIX] = np.array([_shape(dS) for dS in turns]).T
        if axis is not None:
            out += _of_inertia(lambda part: filled({INERTIA_MATRIX: part}), S, axis)
    D = filled(turned, np.vstack([so3.skew(one) for one in X]))
    attitude = TARGET_ATTITUDE if TARGET_ATTITUDE in there else RELATIVE_ATTITUDE
    if attitude in there:
        out.append(Direction(GAUGE, D, "deg", float(np.degrees(1.0))))
    return out


def _shape(M: Array) -> Array:
    """k (5,) of a symmetric matrix without trace: M = sum k_a TRACELESS[a]."""
    return np.asarray(np.tensordot(TRACELESS, M, 2) / 2)


def _of_inertia(fill: Callable[[Array], Array], S: Array, axis: Array) -> list[Direction]:
    """Changes of the inertia's shape, in the axes of the spin.

    With D = exp(S) the second moments of the mass: what changes D, and with it J = tr(D) I - D, in
    one of its entries in axes a (spin), b, c; b and c without a product.
    """
    across = null_space(axis[None])
    second = across.T @ S @ across
    b, c = (across @ np.linalg.eigh(second)[1]).T
    a = axis

    def mixed(u: Array, v: Array) -> Array:
        return np.asarray(np.outer(u, v) + np.outer(v, u))

    slopes = np.array([expm_frechet(S, T, compute_expm=False) for T in TRACELESS]).reshape(5, 9).T
    named = {
        "moment about the spin axis": [mixed(a, a) - 0.5 * mixed(b, b) - 0.5 * mixed(c, c)],
        "difference of the moments across the spin axis": [mixed(b, b) - mixed(c, c)],
        "product of the axes across the spin axis": [mixed(b, c)],
        "products with the spin axis": [mixed(a, b), mixed(a, c)],
    }
    out = []
    for name, entries in named.items():
        k = np.column_stack([np.linalg.lstsq(slopes, M.ravel(), rcond=None)[0] for M in entries])
        k /= np.linalg.norm(k, axis=0)
        D = fill(k)
        out.append(Direction(INERTIA + name, D, "1", 1.0, D))
    return out
