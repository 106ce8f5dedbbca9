"""Laws that hold for any input, which hypothesis looks for a breach of."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError
from relnav_graph.io.tabular import read_table, write_table
from relnav_graph.maths import so3
from relnav_graph.maths.instants import Instant
from relnav_graph.streaming.lines import LineError, parse_line
from relnav_graph.units import _UNITS, parse_quantity, si_scale, unit_scale

#: The same draws each time: a test that fails on one day alone helps nobody.
settings.register_profile("same", derandomize=True, deadline=None, max_examples=60, database=None)
settings.load_profile("same")

VECTORS = arrays(np.float64, 3, elements=st.floats(-3.0, 3.0))
FINITE = st.floats(allow_nan=False, allow_infinity=False)


@given(VECTORS)
def test_rotations_and_their_vectors(phi: Array) -> None:
    R = so3.exp(phi)
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(so3.exp(so3.log(R)), R, atol=1e-12)
    q = so3.quaternion(R)
    assert q[0] >= 0
    np.testing.assert_allclose(so3.from_quaternion(q), R, atol=1e-14)
    if np.linalg.norm(phi) < 3.0:
        np.testing.assert_allclose(so3.log(R), phi, atol=1e-10)
        J = so3.right_jacobian(phi) @ so3.right_jacobian_inverse(phi)
        np.testing.assert_allclose(J, np.eye(3), atol=1e-8)


@given(VECTORS, VECTORS)
def test_a_rotation_keeps_angles(phi: Array, v: Array) -> None:
    R = so3.exp(phi)
    w = v[::-1].copy()
    np.testing.assert_allclose((R @ v) @ (R @ w), v @ w, atol=1e-12)
    np.testing.assert_allclose(so3.cross(R @ v, R @ w), R @ so3.cross(v, w), atol=1e-12)


@given(st.sampled_from(sorted(_UNITS)), st.sampled_from(sorted(_UNITS)), st.floats(1e-6, 1e6))
def test_units_are_factors(one: str, other: str, value: float) -> None:
    """What is written in a unit is read in SI, and there and back is the same."""
    product = f"{one}*{other}"
    assert np.isclose(si_scale(product), si_scale(one) * si_scale(other), rtol=1e-14)
    assert np.isclose(unit_scale(f"{one}/{other}*{other}", one), 1.0, rtol=1e-14)
    found = parse_quantity(f"{value!r} {one}", one)
    assert np.isclose(found, value, rtol=1e-14)


@given(st.lists(st.tuples(FINITE, FINITE), max_size=20))
def test_tables_keep_every_bit(rows: list[tuple[float, float]]) -> None:
    columns = np.array(rows, dtype=np.float64).reshape(-1, 2).T
    with tempfile.TemporaryDirectory() as name:
        write_table(Path(name, "a.csv"), {"t_s": columns[0], "b": columns[1]})
        table = read_table(Path(name), "a")
    assert table is not None
    assert table["t_s"].tobytes() == columns[0].tobytes()
    assert table["b"].tobytes() == columns[1].tobytes()


@given(st.text(max_size=200))
def test_any_text_is_a_table_or_is_refused(text: str) -> None:
    with tempfile.TemporaryDirectory() as name:
        Path(name, "a.csv").write_text(text, "utf-8", newline="")
        try:
            table = read_table(Path(name), "a")
        except InputError as error:
            said = str(error)
        else:
            said = "a.csv"
            assert table is not None
            sound = [v for name, v in table.columns.items() if name not in table.faults]
            assert all(np.isfinite(column).all() for column in sound)
    assert "a.csv" in said


@given(st.binary(max_size=200))
def test_any_bytes_are_a_line_or_are_refused(line: bytes) -> None:
    try:
        parse_line(line, {}, {})
    except LineError as error:
        reason = error.reason
    else:
        reason = "none"
    assert reason


@given(
    st.integers(41500, 61000),
    st.integers(0, 86_399_999_999_999),
    st.sampled_from(["UTC", "TAI", "GPS", "TT", "TDB"]),
)
def test_instants_come_back_as_they_are_written(day: int, ns: int, scale: str) -> None:
    """To the nanosecond, in any time system."""
    instant = Instant.of(day, ns / 1e9, scale)
    assert Instant.parse(f"{instant.calendar(scale)} {scale}") == instant
