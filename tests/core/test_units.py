"""Quantities with units: what is read, and what is refused and how."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from relnav_graph.errors import InputError
from relnav_graph.units import Quantity, convert, parse_quantity, unit_scale

DEGREE = math.pi / 180


@pytest.mark.parametrize(
    ("text", "si", "value"),
    [
        ("5", "1", 5.0),
        ("-1.5e3 mm", "m", -1.5),
        ("2km", "m", 2000.0),
        (".5 cm", "m", 0.005),
        ("30 min", "s", 1800.0),
        ("90 deg", "rad", math.pi / 2),
        ("1 arcsec", "rad", DEGREE / 3600),
        ("60 arcmin", "rad", DEGREE),
        ("3 urad", "rad", 3e-6),
        ("5 deg/h", "rad/s", 5 * DEGREE / 3600),
        ("36 km/h", "m/s", 10.0),
        ("60 deg/sqrt(h)", "rad/sqrt(s)", DEGREE),
        ("1 deg/h^1.5", "rad/s^1.5", DEGREE / 3600**1.5),
        ("2 m/s/sqrt(s)", "m/s^1.5", 2.0),
        ("2 m/s^2/sqrt(Hz)", "m/s^1.5", 2.0),
        ("3 deg/s/sqrt(Hz)", "rad/sqrt(s)", 3 * DEGREE),
        ("1 g0", "m/s^2", 9.80665),
        ("4 N*m", "kg*m^2/s^2", 4.0),
        ("7 px", "px", 7.0),
        ("10 1/s", "Hz", 10.0),
    ],
)
def test_quantities_with_units(text: str, si: str, value: float) -> None:
    assert parse_quantity(text, si) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(
    ("value", "si", "says"),
    [
        ("5", "m", "found unit '', expected one like 'm'"),
        ("5 s", "m", "found unit 's', expected one like 'm'"),
        ("5 Hz", "rad/s", "found unit 'Hz', expected one like 'rad/s'"),
        ("5 deg/sqrt(h)", "rad/s", r"found unit 'deg/sqrt\(h\)', expected one like 'rad/s'"),
        ("5 parsec", "m", "unit 'parsec': cannot read 'parsec'"),
        ("5 m s", "m", "cannot read 's'"),
        ("five m", "m", "found 'five m', expected a number with a unit like 'm'"),
        ("nan m", "m", "found 'nan m', expected a number"),
        ("1e999 m", "m", "expected a finite number"),
        (float("nan"), "m", "found nan, expected a finite number"),
        (float("-inf"), "m", "found -inf, expected a finite number"),
        (True, "m", "found True, expected a number or a string"),
        (None, "m", "found None, expected a number or a string"),
        ([1.0], "m", r"found \[1.0\], expected a number or a string"),
    ],
)
def test_what_is_no_quantity_is_refused(value: Any, si: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        parse_quantity(value, si)


def test_units_convert_there_and_back() -> None:
    for unit, si in (("deg/h", "rad/s"), ("km", "m"), ("deg/sqrt(h)", "rad/sqrt(s)")):
        assert unit_scale(unit, si) * unit_scale(si, unit) == pytest.approx(1.0, rel=1e-15)
    np.testing.assert_allclose(convert(np.array([180.0, 90.0]), "deg", "rad"), [np.pi, np.pi / 2])


@pytest.mark.parametrize(
    ("quantity", "value", "says"),
    [
        (Quantity("m", (3,)), [1, 2], r"found shape \(2,\), expected \(3,\)"),
        (Quantity("m", (None, 3)), [1, 2, 3], r"found shape \(3,\), expected \('n', 3\)"),
        (Quantity("m", positive=True), 0.0, "found 0.0 m, expected a positive value"),
        (
            Quantity("m", (2,), nonnegative=True),
            [0, "-1 km"],
            "found -1000.0 m, expected a non-neg",
        ),
        (Quantity("m", (2,)), ["1 m", "1 s"], "found unit 's', expected one like 'm'"),
        (Quantity("m", (2,)), [[1, 2], [3]], "expected numbers in m"),
    ],
)
def test_shape_and_sign_of_parameters(quantity: Quantity, value: Any, says: str) -> None:
    with pytest.raises(InputError, match=says):
        quantity.parse(value)


def test_one_number_may_stand_for_all_axes_and_arrays_are_read_only() -> None:
    found = Quantity("rad", (3,), fill=True).parse("2 deg")
    np.testing.assert_allclose(found, np.full(3, 2 * DEGREE))
    with pytest.raises(ValueError, match="read-only"):
        found[0] = 1.0
