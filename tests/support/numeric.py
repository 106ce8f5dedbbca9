"""The comparison of a Jacobian with central differences, as an assertion."""

from __future__ import annotations

from collections.abc import Iterable

from relnav_graph.arrays import Array
from relnav_graph.core.conformance.numeric import wrong_entries


def assert_jacobian(
    got: Array,
    want: Array,
    rows: Iterable[slice],
    columns: Iterable[slice],
    inputs: Array,
    tolerance: float = 1e-6,
) -> None:
    """Every block (rows, columns) agrees; see `wrong_entries`."""
    assert got.shape == want.shape
    assert not wrong_entries(got, want, rows, columns, inputs, tolerance)[:3]
