"""Bodies of the scene: ellipsoids of positions and cones of attitudes, as meshes."""

from __future__ import annotations

from typing import Any

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.maths import so3

__all__ = ["cones", "ellipsoids", "extent", "xyz"]

#: Points of the rim of a cone.
_RIM = 16


def xyz(points: Array) -> dict[str, Array]:
    """Points (n, 3) as plotly has them."""
    return dict(zip("xyz", np.ascontiguousarray(points.T), strict=True))


def _ijk(faces: Indices) -> dict[str, Indices]:
    return dict(zip("ijk", np.ascontiguousarray(faces.T), strict=True))


def _sphere(n: int = 10) -> tuple[Array, Indices]:
    """Unit vectors (m, 3) and triangles of a sphere."""
    u, v = np.meshgrid(np.linspace(0, np.pi, n), np.linspace(0, 2 * np.pi, 2 * n), indexing="ij")
    grid = np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)], axis=-1)
    a = (np.arange(n - 1)[:, None] * 2 * n + np.arange(2 * n - 1)).ravel()
    faces = np.vstack([np.column_stack([a, a + 1, a + 2 * n]),
                       np.column_stack([a + 1, a + 2 * n + 1, a + 2 * n])])  # fmt: skip
    return grid.reshape(-1, 3), faces


def extent(P: Array) -> Array:
    """Three sigmas along the longest axis of covariances (k, 3, 3): (k,)."""
    return np.asarray(3 * np.sqrt(np.maximum(np.linalg.eigvalsh(P)[:, -1], 0)))


def ellipsoids(centres: Array, P: Array, scale: float, n: int = 10) -> dict[str, Any]:
    """One mesh of the ellipsoids |P^-1/2 d| = 3 `scale` about centres (k, 3); P (k, 3, 3), SI; each
    of n parallels."""
    sphere, faces = _sphere(n)
    w, V = np.linalg.eigh(P)
    half = V * (3 * scale * np.sqrt(np.maximum(w, 0)))[:, None, :]
    vertices = centres[:, None, :] + np.einsum("mj,kij->kmi", sphere, half)
    all_faces = (faces + len(sphere) * np.arange(len(P))[:, None, None]).reshape(-1, 3)
    return {**xyz(vertices.reshape(-1, 3)), **_ijk(all_faces)}


def cones(R: Array, P: Array, scale: float, reach: float) -> dict[str, Any]:
    """One mesh of the cones in which the three axes of a body lie within 3 `scale` sigmas.

    R: (3, 3) from the body; P: (3, 3), rad^2, of its right perturbation; reach: length of a cone,
    m. An axis e is turned by a small angle d to e + d x e, so that its cone is elliptical.
    """
    angle = np.linspace(0, 2 * np.pi, _RIM, endpoint=False)
    vertices = [np.zeros((1, 3))]
    for e in np.eye(3):
        turned = so3.skew(e) @ P @ so3.skew(e).T
        w, V = np.linalg.eigh(turned)
        half = V[:, 1:] * (3 * scale * np.sqrt(np.maximum(w[1:], 0)))
        vertices.append(e + np.column_stack([np.cos(angle), np.sin(angle)]) @ half.T)
    rim = np.arange(_RIM)
    one = np.column_stack([0 * rim, 1 + rim, 1 + (rim + 1) % _RIM])
    faces = np.vstack([one + (one > 0) * _RIM * k for k in range(3)])
    return {**xyz(reach * np.vstack(vertices) @ R.T), **_ijk(faces)}
