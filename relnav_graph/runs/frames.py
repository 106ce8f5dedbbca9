"""Problems from data frames: see `problem_from_frames`. Any whose columns become arrays will do."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from relnav_graph.core import models
from relnav_graph.core.problem import Problem
from relnav_graph.errors import InputError
from relnav_graph.registry import find_class
from relnav_graph.runs.arrays import problem_from_arrays

__all__ = ["problem_from_frames"]

_LOG = logging.getLogger(__name__)
#: Columns of stamps, and of which thing a row is of.
STAMPS, IDS = ("t_s", "t"), ("id", "ids")


def problem_from_frames(
    *,
    processes: Mapping[str, Any],
    sensors: Mapping[str, Any],
    measurements: Mapping[str, Any],
    prior: Mapping[str, Any],
    inputs: Mapping[str, Any] | None = None,
    **options: Any,
) -> Problem:
    """A `Problem` from data frames (pandas, or others with `columns` and `to_numpy`).

    measurements: of each sensor a frame with its `columns` by name, the stamps in a column `t_s`
    or `t`, or as the index, where it has a name or dates, and maybe `id`. inputs: of each a frame
    with the columns that its process declares, `t_start_s` and `t_end_s`, or without `_s`. Others
    are left out, with a note. All else: see `relnav_graph.problem_from_arrays`; attitude priors,
    too, are arrays.

    Raises InputError that names missing columns, and as that does.
    """
    parts: dict[str, dict[str, Any]] = {"measurements": {}, "inputs": {}}
    for name, frame in measurements.items():
        if name not in sensors:
            raise InputError(f"measurements.{name}: unknown sensor, expected: {', '.join(sensors)}")
        where, columns = f"measurements.{name}", _model(sensors[name]).columns
        frame = _frame(where, frame)
        t, z, ids = _stamps(where, frame), _stacked(where, frame, columns), _first(frame, IDS)
        own = {"t": t, "z": z} | ({} if ids is None else {"ids": _array(frame, ids)})
        parts["measurements"][name] = own
        _say_others(where, frame, (*columns, *STAMPS, *IDS))
    known = {n: c for p in processes.values() for n, c in _model(p).inputs.items()}
    for name, frame in (inputs or {}).items():
        where = f"inputs.{name}"
        if name not in known:
            raise InputError(f"{where}: unknown input, expected: {', '.join(known) or 'none'}")
        frame = _frame(where, frame)
        ends = [_needed(where, frame, (f"{end}_s", end)) for end in ("t_start", "t_end")]
        own = dict(zip(("t_start", "t_end"), (_array(frame, e) for e in ends), strict=True))
        parts["inputs"][name] = {**own, "values": _stacked(where, frame, known[name])}
        _say_others(where, frame, (*known[name], *ends))
    return problem_from_arrays(
        processes=processes,
        sensors=sensors,
        prior=prior,
        measurements=parts["measurements"],
        inputs=parts["inputs"],
        **options,
    )


def _model(given: Any) -> Any:
    """A model, or the class of the kind that a dict names."""
    if isinstance(given, Mapping):
        return find_class(models.ENTRY_POINTS, str(given.get("kind")))
    return given


def _array(frame: Any, column: str) -> Any:
    """A column as an array; dates without a time zone, as UTC."""
    values = frame[column] if column in frame.columns else frame.index
    if getattr(getattr(values, "dtype", None), "tz", None) is not None:
        values = getattr(values, "dt", values).tz_convert("UTC")
        values = getattr(values, "dt", values).tz_localize(None)
    return values.to_numpy()


def _frame(where: str, given: Any) -> Any:
    """What is given, if it is a data frame. Raises InputError on another thing."""
    if hasattr(given, "columns"):
        return given
    raise InputError(
        f"{where}: found {type(given).__name__}, expected a data frame; arrays go to from_arrays"
    )


def _first(frame: Any, names: Sequence[str]) -> str | None:
    return next((name for name in names if name in frame.columns), None)


def _needed(where: str, frame: Any, names: Sequence[str]) -> str:
    found = _first(frame, names)
    if found is None:
        raise InputError(f"{where}: no column {names[0]!r}; found {', '.join(map(str, frame))}")
    return found


def _stamps(where: str, frame: Any) -> Any:
    """The stamps (N,) of a frame."""
    index = getattr(frame, "index", None)
    dated = str(getattr(index, "dtype", "")).startswith("datetime64")
    if _first(frame, STAMPS) is None and (dated or getattr(index, "name", None) in STAMPS):
        return _array(frame, "")
    return _array(frame, _needed(where, frame, STAMPS))


def _stacked(where: str, frame: Any, columns: Sequence[str]) -> Any:
    """Columns side by side, (N, columns)."""
    missing = [c for c in columns if c not in frame.columns]
    if missing:
        found, expected = ", ".join(map(str, frame.columns)), ", ".join(columns)
        raise InputError(f"{where}: no column {missing[0]!r}; found {found}; expected {expected}")
    return np.column_stack([_array(frame, c) for c in columns])


def _say_others(where: str, frame: Any, known: Sequence[str]) -> None:
    others = [str(c) for c in frame.columns if c not in known]
    noise = [c for c in others if c.startswith(("sigma_", "cov_"))]
    if noise:
        raise InputError(
            f"{where}: found the column {noise[0]!r}, expected none of noise, which is not read of"
            " data frames: the sensor says it, or a data set row by row"
        )
    if others:
        _LOG.warning("%s: not read: columns %s", where, ", ".join(others))
