"""Central differences, and the comparison of a Jacobian with them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.state import Layout


def steps_for(jacobian: Array, inputs: Array, outputs: Array) -> Array:
    """Steps that change inputs and outputs by about 1e-3 of their sizes: large enough for
    rounding, small enough for the fourth-order stencil, however strong a sensitivity is."""
    strongest = (np.abs(jacobian) / outputs[:, None]).max(axis=0)
    return np.asarray(1e-3 * np.minimum(inputs, 1 / np.maximum(strongest, 1e-300)))


def differences(f: Callable[[Array], Array], steps: Array) -> Array:
    """Derivative of f (a function of a tangent vector) at zero, by five-point stencils."""
    columns = []
    for j, h in enumerate(steps):
        d = np.zeros(len(steps))
        values = []
        for k in (1, -1, 2, -2):
            d[j] = k * h
            values.append(f(d))
        columns.append((8 * (values[0] - values[1]) - (values[2] - values[3])) / (12 * h))
    return np.array(columns).T


def assert_jacobian(
    got: Array,
    want: Array,
    rows: Iterable[slice],
    columns: Iterable[slice],
    inputs: Array,
    tolerance: float = 1e-6,
) -> None:
    """Every block (rows, columns) agrees to `tolerance` of its own largest entry.

    A block that is zero, or as good as zero beside its row for changes of the size of
    `inputs`, must be so to 1e-9 of that row.
    """
    assert got.shape == want.shape
    columns = list(columns)
    for i in rows:
        row = np.abs(want[i] * inputs).max()
        for j in columns:
            error = np.abs((got[i, j] - want[i, j]) * inputs[j]).max()
            size = np.abs(want[i, j] * inputs[j]).max()
            assert error <= tolerance * size + 1e-9 * row, (i, j, error / max(size, 1e-300))


def blocks_of(layout: Layout) -> list[slice]:
    return [layout.tangent(b.name) for b in layout]
