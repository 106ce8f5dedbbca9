"""Central differences, and the comparison of a Jacobian with them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.state import Block, Layout

__all__ = ["Wrong", "blocks_of", "components", "differences", "steps_for", "wrong_entries"]


def steps_for(jacobian: Array, inputs: Array, outputs: Array) -> Array:
    """Steps (n,) that change inputs (n,) and outputs (m,) by about 1e-3 of their sizes: large
    enough for rounding, small enough for the fourth-order stencil, however strong a sensitivity
    is, by a jacobian (m, n)."""
    strongest = (np.abs(jacobian) / outputs[:, None]).max(axis=0)
    return np.asarray(1e-3 * np.minimum(inputs, 1 / np.maximum(strongest, 1e-300)))


def differences(f: Callable[[Array], Array], steps: Array) -> Array:
    """Derivative (m, n) of f (a function of a tangent vector (n,)) at zero, by five-point
    stencils with steps (n,)."""
    columns = []
    for j, h in enumerate(steps):
        d = np.zeros(len(steps))
        values = []
        for k in (1, -1, 2, -2):
            d[j] = k * h
            values.append(f(d))
        columns.append((8 * (values[0] - values[1]) - (values[2] - values[3])) / (12 * h))
    return np.array(columns).T


def blocks_of(layout: Layout) -> list[slice]:
    """Where each block stands in the tangent."""
    return [layout.tangent(b.name) for b in layout]


def components(blocks: Iterable[Block]) -> list[str]:
    """Names of the tangent's components, one after the other, such as ``relative_position y``."""
    found = []
    for block in blocks:
        axes = "xyz" if block.dim <= 3 else [str(k + 1) for k in range(block.dim)]
        found += [
            f"{block.name} {axes[k]}" if block.dim > 1 else block.name for k in range(block.dim)
        ]
    return found


@dataclass(frozen=True)
class Wrong:
    """An entry of a Jacobian: row, column, what differences say of it, and what it is."""

    row: int
    column: int
    numeric: float
    found: float

    @property
    def looks(self) -> str:
        """What the mistake looks like; "" where it looks like none that is usual."""
        size = max(abs(self.numeric), abs(self.found))
        if abs(self.numeric + self.found) < 1e-4 * size:
            return "wrong sign?"
        if abs(self.found) < 1e-9 * size:
            return "missing?"
        return ""


def wrong_entries(
    numeric: Array,
    found: Array,
    rows: Iterable[slice],
    columns: Iterable[slice],
    inputs: Array,
    tolerance: float = 1e-6,
) -> list[Wrong]:
    """Entries where a Jacobian (m, n), `found`, is not what differences say, the worst first.

    A block (rows, columns) is right where it agrees to `tolerance` of its own largest entry. One
    that is zero, or as good as zero beside its row for changes of the size of `inputs` (n,), must
    be so to 1e-9 of that row.
    """
    wrong, columns = list[tuple[float, Wrong]](), list(columns)
    for i in rows:
        row = max(np.abs(found[i] * inputs).max(), 0.0)
        for j in columns:
            error = np.abs((numeric[i, j] - found[i, j]) * inputs[j])
            allowed = tolerance * np.abs(found[i, j] * inputs[j]).max() + 1e-9 * row
            for a, b in np.argwhere(~(error <= allowed)).tolist():
                at = i.indices(len(found))[0] + a, j.indices(found.shape[1])[0] + b
                entry = Wrong(*at, float(numeric[at]), float(found[at]))
                wrong.append((error[a, b] / max(row, 1e-300), entry))
    return [entry for _, entry in sorted(wrong, key=lambda pair: -pair[0])]
