"""The covariance of a truth that was measured itself, in the coordinates of errors.

The truth found is the true state (+) n, n ~ N(0, diag(sigma^2)), so that the error e from an
estimate to it has the covariance P + T, with T = G diag(sigma^2) G^T and G = de/dn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.state import Block, Layout

__all__ = ["Linear", "TruthNoise", "joint_noise", "noise_of", "of_error", "stacked"]


@dataclass(frozen=True, eq=False)
class Linear:
    """How a quantity depends on tangents of blocks: J (N, dim, n), n of all `blocks` in order."""

    blocks: tuple[Block, ...]
    J: Array

    def where(self, mask: Any) -> Linear:
        """The epochs of a mask (N,)."""
        return replace(self, J=self.J[mask])


@dataclass(frozen=True, eq=False)
class TruthNoise:
    """How an error depends on the noise of the truth, and sigmas (N, n) of that, SI."""

    of: Linear
    sigmas: Array

    def where(self, mask: Any) -> TruthNoise:
        """The epochs of a mask (N,)."""
        return TruthNoise(self.of.where(mask), self.sigmas[mask])

    @property
    def T(self) -> Array:
        """T (N, dim, dim), SI."""
        return _squared(self.of.J * self.sigmas[:, None, :])


def _squared(root: Array) -> Array:
    return root @ root.transpose(0, 2, 1)


def stacked(parts: Sequence[Linear], names: Sequence[str]) -> Array:
    """J (N, sum of dims, n) of several quantities together, to the tangents of the blocks `names`,
    one after the other."""
    blocks = {b.name: b for part in parts for b in part.blocks}
    layout, count = Layout(blocks[n] for n in names), len(parts[0].J)
    rows = []
    for part in parts:
        row = np.zeros((count, part.J.shape[1], layout.dim))
        at = 0
        for b in part.blocks:
            row[:, :, layout.tangent(b.name)] = part.J[:, :, at : at + b.dim]
            at += b.dim
        rows.append(row)
    return np.concatenate(rows, axis=1)


def joint_noise(noises: Sequence[TruthNoise | None], dims: Sequence[int], count: int) -> Array:
    """T (N, sum of dims, sum of dims) of several errors of `dims` components, some without noise:
    what two of them owe to one block is correlated."""
    empty = Linear((), np.zeros((count, 0, 0)))
    parts = [
        n.of if n is not None else replace(empty, J=np.zeros((count, dim, 0)))
        for n, dim in zip(noises, dims, strict=True)
    ]
    sigmas: dict[str, Array] = {}
    for noise in noises:
        at = 0
        for b in noise.of.blocks if noise is not None else ():
            assert noise is not None
            sigmas[b.name] = noise.sigmas[:, at : at + b.dim]
            at += b.dim
    return _squared(stacked(parts, list(sigmas)) * np.hstack(list(sigmas.values()))[:, None, :])


def noise_of(
    blocks: Sequence[Block], J: Array, sigmas: Mapping[str, Array], rows: Any
) -> TruthNoise | None:
    """The noise of a quantity of Jacobian J (N, dim, n) to `blocks`; None where all are exact.

    sigmas: (M, dim) by name, of a truth of which `rows` are the N epochs.
    """
    if not any(b.name in sigmas for b in blocks):
        return None
    found = [
        sigmas[b.name][rows] if b.name in sigmas else np.zeros((len(J), b.dim)) for b in blocks
    ]
    return TruthNoise(Linear(tuple(blocks), J), np.hstack(found))


def of_error(noise: TruthNoise | None, block: Block, e: Array, turned: Array | None = None) -> Any:
    """Noise of a true value as noise of the error e (N, dim) to it: of an attitude, ``Log(R_est^T
    R_true Exp(n))``, by the inverse of the right Jacobian at e.

    turned: H (N, 3, 3), where R_true H is meant instead, which says the same.
    """
    if noise is None or block.manifold != "SO3":
        return noise
    layout = Layout([block])
    slope = np.array([layout.right_jacobian_inverse(d) for d in np.ascontiguousarray(e)])
    slope = slope.reshape(-1, 3, 3)
    if turned is not None:
        slope = slope @ np.swapaxes(turned, 1, 2)
    return replace(noise, of=replace(noise.of, J=slope @ noise.of.J))
