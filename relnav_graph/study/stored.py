"""What a record of a run must hold when it is read back: types and sizes of all that is added
up, so that one from elsewhere is refused by name instead of half way through a sum."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydantic import ConfigDict
from pydantic_core import from_json

from relnav_graph.arrays import Array
from relnav_graph.core.track import Kind, Status
from relnav_graph.errors import InputError
from relnav_graph.io.stored import Count, check_json

__all__ = ["check_record"]

Number = float | None
Numbers = dict[str, Number]


@dataclass(frozen=True)
class _State:
    """Scores of a state; without truth only `unit` and `sigma`."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    unit: str
    sigma: Number
    rmse: Number = None
    rmse_last: Number = None
    anees: Number = None
    freedoms: Count = 0
    anees_without_truth_noise: Number = None
    inside_1sigma: Number = None
    inside_2sigma: Number = None
    inside_3sigma: Number = None
    settled_s: Number = None


@dataclass(frozen=True)
class _Static:
    """Scores of a static block at the last epoch."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    unit: str
    sigma: Number
    rmse: Number
    anees: Number
    freedoms: Count
    bound: Number
    count: Count | None = None


@dataclass(frozen=True)
class _AlignedState:
    """Error of a state after the alignment of the map."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    unit: str
    rmse: Number


@dataclass(frozen=True)
class _Aligned:
    """What the alignment of a map leaves."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    rotation_deg: Number
    shift_m: Number
    map_rmse_m: Number
    map_max_m: Number
    scale_error: Number
    states: dict[str, _AlignedState]


@dataclass(frozen=True)
class _Joint:
    """All static blocks jointly."""

    anees: Number = None
    freedoms: Count = 0


@dataclass(frozen=True)
class _Row:
    """A track of the run."""

    kind: Kind
    status: Status
    message: str
    rejected: dict[str, Count]
    anees: Number
    freedoms: Count
    states: dict[str, _State]
    innovations: dict[str, Numbers]
    anees_without_truth_noise: Number = None
    anees_without: Number = None
    freedoms_without: Count = 0
    bound: Numbers = field(default_factory=dict)
    statics: dict[str, _Static] = field(default_factory=dict)
    statics_joint: _Joint = field(default_factory=_Joint)
    aligned: _Aligned | None = None


@dataclass(frozen=True)
class _Noise:
    """Squared residuals by noise, or why there are none."""

    missing: str = ""
    squares: Numbers = field(default_factory=dict)
    cost: Number = None


@dataclass(frozen=True)
class _Done:
    """A run that has a result."""

    run: Count
    rows: dict[str, _Row]
    bound: dict[str, Numbers]
    noise: dict[str, _Noise]
    timing: dict[str, dict[str, Number | Numbers]]
    mcreynolds: dict[str, dict[str, dict[str, Numbers]]]
    cautions: dict[str, list[str]] = field(default_factory=dict)


@dataclass(frozen=True)
class _Failed:
    """A run without a result: why."""

    run: Count
    failed: str


def _sizes(found: _Done) -> dict[str, tuple[int, ...]]:
    """Sizes of the series that a run must have, without that over bins: of each state, and of
    all jointly, squared error, NEES and trace."""
    sizes: dict[str, tuple[int, ...]] = {
        f"bound {kind}": (len(states) + 1, 3) for kind, states in found.bound.items()
    }
    for name, row in found.rows.items():
        if row.status != "diverged":
            sizes |= {name: (len(row.states) + 1, 3), f"nis {name}": (len(row.innovations),)}
    return sizes


def check_record(where: str, text: bytes, series: Mapping[str, Array]) -> dict[str, Any]:
    """The scalars of a record, from their JSON, after a check of them and of its series.

    series: by name, (..., bins), see `relnav_graph.study.record`. Raises InputError with `where`
    and the field.
    """
    try:
        scalars: Any = from_json(text)
    except ValueError as error:
        raise InputError(f"{where}: damaged: scalars are not valid JSON: {error}") from error
    if not isinstance(scalars, dict) or "failed" in scalars:
        check_json(where, text, _Failed)
        return dict(scalars)
    found = check_json(where, text, _Done)
    for name, array in series.items():
        if array.dtype != np.float64:
            raise InputError(f"{where}: damaged: {name}: found {array.dtype}, expected numbers")
    coupled = {f"coupling {name}": len(noise.squares) for name, noise in found.noise.items()}
    for name, count in coupled.items():
        if name in series and series[name].shape != (count, count):
            raise InputError(f"{where}: damaged: {name}: found {series[name].shape}, of {count}")
    for name, size in _sizes(found).items():
        if name not in series:
            raise InputError(f"{where}: damaged: no series {name!r}")
        shape = series[name].shape
        if len(shape) != len(size) + 1 or shape[:-1] != size:
            raise InputError(
                f"{where}: damaged: series {name!r}: found {shape}, expected {(*size, 'bins')}"
            )
    untimed = [name for name in found.rows if name not in found.timing]
    if untimed:
        raise InputError(f"{where}: damaged: timing: found nothing for {untimed[0]!r}")
    return scalars
