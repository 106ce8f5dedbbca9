"""The table [time] of a scenario file."""

from __future__ import annotations

from datetime import date
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from relnav_graph.core.epochs import LONGEST, unit_hint
from relnav_graph.core.measurement import SAME_TIME
from relnav_graph.errors import InputError
from relnav_graph.maths.instants import EXAMPLE, Instant
from relnav_graph.units import Quantity

__all__ = ["STRICT", "Seconds", "TimeSettings"]

STRICT = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)
Seconds = Annotated[float, Quantity("s", positive=True)]


def _instant(found: Any) -> str:
    """The text of an absolute time; TOML's own dates, which know no scale, are refused alike."""
    text = found.isoformat() if isinstance(found, date) else found
    if not isinstance(text, str):
        raise InputError(f"found {found!r}, expected an absolute time as {EXAMPLE}")
    Instant.parse(text)
    return text


class TimeSettings(BaseModel):
    """The clock of a pass, and the epochs of a simulated one.

    step, epochs: of a simulated pass, which has so many epochs, so far apart, from t = 0, and
    between them those of sensors whose period is no multiple of the step; recorded data need
    neither. origin: what the stamps of files and streams say at t = 0, s: it
    is taken off when they are read, so that numbers stay small, and put back when data are
    written; all other times (`evaluate`, results) are of the pass's own clock.
    epoch: the absolute time of t = 0, in TT, TAI, UTC, GPS or TDB, as "2021-07-17T00:00:00 TT";
    data may bring their own, which is then that of a stamp of 0. `[orbit] epoch`, of the pass's
    clock, may be such a time, too.
    orientation: a file finals2000A of the IERS, from the working directory: UT1 and the motion of
    the pole, for gravity that turns with the Earth; without it UT1 = UTC, and the pole stands
    still: up to 0.9 s, and 0.6 arcsec.
    merge: s, measurements that close to the first of an epoch are of it; 0: only equal stamps.
    """

    model_config = STRICT

    step: Seconds | None = None
    epochs: int | None = Field(default=None, ge=1)
    epoch: Annotated[str, BeforeValidator(_instant)] | None = None
    orientation: str | None = None
    origin: Annotated[float, Quantity("s")] = 0.0
    merge: Annotated[float, Quantity("s", nonnegative=True)] = SAME_TIME

    @property
    def tolerance(self) -> float:
        """`merge` with room for the rounding of stamps that are just so far apart, s."""
        return self.merge * (1 + 1e-6) if self.merge > SAME_TIME else self.merge

    @model_validator(mode="after")
    def _reasonable(self) -> TimeSettings:
        if (self.step is None) != (self.epochs is None):
            raise ValueError(
                "found one of step and epochs, expected both, or neither for recorded data, which"
                " have their own (data.end cuts them short)"
            )
        if self.step is not None and self.step > LONGEST:
            hint = unit_hint(self.step).replace("stamps", "numbers")
            raise ValueError(f"found step {self.step:g} s, expected at most {LONGEST:g} s{hint}")
        return self
