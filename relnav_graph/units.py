"""Units: parsing of quantities such as ``"0.0005 deg"`` and of typed model parameters.

Inside the package everything is SI and radians; other units exist in scenario files,
data-set columns and tables only.
"""

from __future__ import annotations

import dataclasses
import math
import re
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from relnav_graph.errors import InputError

__all__ = [
    "Quantity",
    "check_fields",
    "column_unit",
    "convert",
    "parse_quantity",
    "quantities",
    "si_scale",
    "unit_of",
    "unit_scale",
]


# Symbol -> (scale to SI, exponents of base units). Angles are dimensional on purpose:
# a rate in rad/s is not a frequency.
_UNITS: dict[str, tuple[float, dict[str, float]]] = {
    "1": (1.0, {}),
    "m": (1.0, {"m": 1}),
    "km": (1e3, {"m": 1}),
    "cm": (1e-2, {"m": 1}),
    "mm": (1e-3, {"m": 1}),
    "s": (1.0, {"s": 1}),
    "ms": (1e-3, {"s": 1}),
    "min": (60.0, {"s": 1}),
    "h": (3600.0, {"s": 1}),
    "Hz": (1.0, {"s": -1}),
    "rad": (1.0, {"rad": 1}),
    "mrad": (1e-3, {"rad": 1}),
    "urad": (1e-6, {"rad": 1}),
    "deg": (math.pi / 180, {"rad": 1}),
    "arcmin": (math.pi / 10800, {"rad": 1}),
    "arcsec": (math.pi / 648000, {"rad": 1}),
    "px": (1.0, {"px": 1}),
    "kg": (1.0, {"kg": 1}),
    "N": (1.0, {"kg": 1, "m": 1, "s": -2}),
    "g0": (9.80665, {"m": 1, "s": -2}),
}
#: No quantity of physics needs a higher one.
_HIGHEST_POWER = 12
_TERM = re.compile(r"([*/]?)\s*(?:sqrt\((\w+)\)|(\w+))(?:\^(-?\d+(?:\.\d+)?))?\s*")
_NUMBER = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*)", re.DOTALL)


@cache
def _parse_unit(unit: str) -> tuple[float, tuple[tuple[str, float], ...]]:
    scale, exponents, position = 1.0, dict[str, float](), 0
    text = unit.strip() or "1"
    while position < len(text):
        match = _TERM.match(text, position)
        symbol = match and (match[2] or match[3])
        if not match or symbol not in _UNITS or (position > 0) != bool(match[1]):
            raise InputError(f"unit {unit[:60]!r}: cannot read {text[position:][:60]!r}")
        power = (0.5 if match[2] else 1.0) * float(match[4] or 1)
        power = -power if match[1] == "/" else power
        if not abs(power) <= _HIGHEST_POWER:
            raise InputError(f"unit {unit[:60]!r}: found a power of {power:g}")
        factor, base = _UNITS[symbol]
        scale *= factor**power
        for name, exponent in base.items():
            exponents[name] = exponents.get(name, 0) + exponent * power
        position = match.end()
    if not 0 < scale < math.inf:
        raise InputError(f"unit {unit[:60]!r}: found a scale of {scale:g}")
    return scale, tuple(sorted((n, e) for n, e in exponents.items() if e))


#: Unit of a column of numbers, by the end of its name, the longest first.
_COLUMN_UNITS = {
    "_rad_s": "rad/s",
    "_m_s2": "m/s^2",
    "_m_s": "m/s",
    "_rad": "rad",
    "_m": "m",
}


def column_unit(column: str) -> str | None:
    """The SI unit that the name of a column says, such as rad/s of wx_rad_s; None for none."""
    return next((unit for end, unit in _COLUMN_UNITS.items() if column.endswith(end)), None)


def unit_scale(unit: str, si: str) -> float:
    """Factor from `unit` to the SI unit `si`.

    Raises InputError when a unit is unknown or the two measure different things.
    """
    scale, exponents = _parse_unit(unit)
    si_scale, si_exponents = _parse_unit(si)
    if exponents != si_exponents:
        raise InputError(f"found unit {unit!r}, expected one like {si!r}")
    return scale / si_scale


def si_scale(unit: str) -> float:
    """Factor from `unit` to SI, of whatever it measures. Raises InputError on an unknown one."""
    return _parse_unit(unit)[0]


def convert(value: Any, unit: str, to: str) -> Any:
    """`value` (number or array) in `unit`, expressed in `to`."""
    return value * unit_scale(unit, to)


def parse_quantity(value: Any, si: str) -> float:
    """A number in SI from a number (taken as SI) or a string with its unit.

    Raises InputError on anything else, on a unit of another kind, on NaN or infinity.
    """
    if isinstance(value, str):
        match = _NUMBER.fullmatch(value)
        if not match:
            raise InputError(f"found {value!r}, expected a number with a unit like {si!r}")
        number = float(match[1]) * unit_scale(match[2], si)
    elif isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
        raise InputError(f"found {value!r}, expected a number or a string with a unit like {si!r}")
    else:
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
    if not math.isfinite(number):
        raise InputError(f"found {value!r}, expected a finite number")
    return number


def unit_of(value: Any, si: str) -> str:
    """The unit in which a value of a scenario file is given, of lists that of the first element; a
    number is in SI."""
    if isinstance(value, (list, tuple)) and value:
        return unit_of(value[0], si)
    match = _NUMBER.fullmatch(value) if isinstance(value, str) else None
    return match[2].strip() if match and match[2].strip() else si


def _parse_nested(value: Any, si: str) -> Any:
    if isinstance(value, (list, tuple)):
        return [_parse_nested(item, si) for item in value]
    if isinstance(value, np.ndarray):
        return value
    return parse_quantity(value, si)


@dataclass(frozen=True)
class Quantity:
    """Unit, shape and sign of a parameter, as ``Annotated[float, Quantity("rad/s")]``.

    Scenario files may give it as a string with any unit of the same kind; code gives SI.
    shape: () for a number; None in a shape stands for any length. fill: one number may
    stand for all axes. words: what it may be instead of a value.
    """

    unit: str
    shape: tuple[int | None, ...] = ()
    positive: bool = False
    nonnegative: bool = False
    fill: bool = False
    words: tuple[str, ...] = ()

    def in_words(self) -> str:
        """What it is in words: unit, size, sign."""
        size = " x ".join("n" if n is None else str(n) for n in self.shape)
        many = (
            f"{size} numbers" + (", or one for all," if self.fill else "") if size else "a number"
        )
        sign = " above zero" if self.positive else " of zero or more" if self.nonnegative else ""
        other = "".join(f" or {word!r}" for word in self.words)
        return f"{many} in {self.unit}{sign}{other}"

    def check(self, value: Any) -> Any:
        """`value` as a float, or as a read-only C-contiguous float64 array.

        Raises InputError on a wrong shape, a value that is not finite, or a wrong sign.
        """
        if isinstance(value, str) and value in self.words:
            return value
        try:
            array = np.array(value, dtype=np.float64, order="C")
        except (TypeError, ValueError, OverflowError) as error:
            words = "".join(f" or {word!r}" for word in self.words)
            raise InputError(f"found {value!r}, expected numbers in {self.unit}{words}") from error
        if self.fill and array.ndim == 0:
            array = np.full([n or 1 for n in self.shape], array)
        if len(array.shape) != len(self.shape) or any(
            want is not None and want != got
            for want, got in zip(self.shape, array.shape, strict=True)
        ):
            want = tuple("n" if n is None else n for n in self.shape)
            raise InputError(f"found shape {array.shape}, expected {want}")
        bad = ~np.isfinite(array)
        bad |= (array <= 0) if self.positive else (array < 0) if self.nonnegative else False
        if bad.any():
            sign = "positive" if self.positive else "non-negative" if self.nonnegative else "finite"
            raise InputError(f"found {array[bad].flat[0]} {self.unit}, expected a {sign} value")
        if self.shape == ():
            return float(array)
        array.flags.writeable = False
        return array

    def parse(self, value: Any) -> Any:
        """`value` of a scenario file (numbers in SI, or strings with units), checked."""
        word = isinstance(value, str) and (value in self.words or (self.words and self.shape))
        return self.check(value if word else _parse_nested(value, self.unit))

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema  # only scenario files need pydantic

        return core_schema.no_info_plain_validator_function(self.parse)

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        one: dict[str, Any] = {"anyOf": [{"type": "number"}, {"type": "string"}]}
        items = one
        for _ in self.shape:
            items = {"type": "array", "items": items}
        choices = [items, *([one] if self.fill and self.shape else [])]
        if self.words:
            choices.append({"enum": list(self.words)})
        form = items if len(choices) == 1 else {"anyOf": choices}
        return {**form, "description": f"SI unit {self.unit}; strings may name another"}


@cache
def _choices(cls: type) -> dict[str, tuple[Any, ...]]:
    hints = get_type_hints(cls)
    return {name: get_args(hint) for name, hint in hints.items() if get_origin(hint) is Literal}


@cache
def quantities(cls: type) -> dict[str, Quantity]:
    """The fields of a model that are quantities, by name."""
    hints = get_type_hints(cls, include_extras=True)
    found = {}
    for name, hint in hints.items():
        options = (hint, *(get_args(hint) if type(None) in get_args(hint) else ()))
        for option in options:
            for extra in getattr(option, "__metadata__", ()):
                if isinstance(extra, Quantity):
                    found[name] = extra
    return found


def check_fields(instance: Any) -> None:
    """Check every `Quantity` field of a frozen dataclass and store it as a float or array;
    check that a `Literal` field is one of its choices.

    Call it in ``__post_init__``. Raises InputError with the name of the field.
    """
    known = quantities(type(instance))  # type: ignore[arg-type]
    choices = _choices(type(instance))  # type: ignore[arg-type]
    for field in dataclasses.fields(instance):
        value = getattr(instance, field.name)
        if field.name in choices and value not in choices[field.name]:
            raise InputError(
                f"{type(instance).__name__}.{field.name}: found {value!r},"
                f" expected one of {choices[field.name]}"
            )
        if field.name in known and value is not None:
            try:
                checked = known[field.name].check(value)
            except InputError as error:
                raise InputError(f"{type(instance).__name__}.{field.name}: {error}") from error
            object.__setattr__(instance, field.name, checked)
