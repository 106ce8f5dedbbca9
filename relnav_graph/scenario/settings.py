"""The tables of a scenario file that are not of a model, each with its checks."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import PurePath
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, Field, model_validator

from relnav_graph.errors import InputError
from relnav_graph.maths.losses import LossKind
from relnav_graph.scenario.time_settings import STRICT, Seconds
from relnav_graph.sim.sensors import Law, Timing
from relnav_graph.units import Quantity, parse_quantity

__all__ = ["BlockPrior", "GapSettings", "SensorOptions", "besides"]


def _checked_bound(value: float | str) -> float | str:
    if isinstance(value, str):
        parse_quantity(value, "s")
    elif not 0 <= value <= 1:
        raise InputError(f"found {value}, expected a fraction of the pass or a time like '60 s'")
    return value


Bound = Annotated[float | str, AfterValidator(_checked_bound)]


class PartSettings(BaseModel):
    """One part of recorded data: a reader with its options, and the file (or folder) in the folder
    of the data that it reads; by default that folder."""

    model_config = STRICT

    reader: str
    file: str = ""
    options: dict[str, Any] = {}

    @model_validator(mode="after")
    def _inside(self) -> PartSettings:
        path = PurePath(self.file)
        if path.is_absolute() or ".." in path.parts:
            raise ValueError(f"found file {self.file!r}, expected one in the folder of the data")
        return self


class DataSettings(BaseModel):
    """Where recorded data come from: a reader of `relnav_graph.io.readers`, or several, `parts` by
    name, whose recordings become one (`relnav_graph.io.parts`); `simulate`: the sensors that raw
    data lack, simulated on their truth. `begin`, `end`: of recorded data only what is from begin
    until before end, s of the pass's clock; times stay as they are. Of a data set: `sort` puts rows
    in order of time; between rows of truth that are further apart than `truth_gap` (by default 1.5
    times the median step) nothing is interpolated."""

    model_config = STRICT

    reader: str = ""
    options: dict[str, Any] = {}
    parts: dict[str, PartSettings] = {}
    simulate: list[str] = []
    begin: Annotated[float, Quantity("s")] | None = None
    end: Annotated[float, Quantity("s")] | None = None
    sort: bool = False
    truth_gap: Seconds | None = None

    @model_validator(mode="after")
    def _one_or_several(self) -> DataSettings:
        alone = self.sort, self.truth_gap, self.begin, self.end  # of a data set
        told = self.reader or self.parts or any(x is not None and x is not False for x in alone)
        if not told or (self.reader and self.parts) or (self.parts and self.options):
            both = "both" if self.reader else "options beside parts" if self.parts else "neither"
            raise ValueError(f"found {both}, expected a reader with its options, or parts")
        if self.begin is not None and self.end is not None and not self.begin < self.end:
            raise ValueError(f"found begin at {self.begin} s and end at {self.end} s")
        return self


class OutlierSettings(BaseModel):
    """Simulated outliers: `fraction` of the observations, with errors of `size` sigmas, each
    in a direction drawn at random."""

    model_config = STRICT

    fraction: float = Field(gt=0, lt=1)
    size: float = Field(gt=0)


class SensorOptions(BaseModel):
    """Settings that every sensor has, whatever its model.

    gate: probability of the chi-square gate on each observation; of unknown points, smoothers
    decide it again at a robust estimate of the whole history, and retire points of which no more
    observations fit than do not. loss: a robust loss, tuning: its constant in sigmas, of student_t
    degrees of freedom. In simulation: period, between measurements, from begin until before end;
    law of the noise, "gaussian" or "random_direction" (of a normal length along a direction drawn
    at random, of the same covariance); outliers; most: observations of one time, drawn from all
    that are seen; association_errors: fraction of the observations that get the values of another
    one of the same time.
    """

    model_config = STRICT

    gate: float | None = Field(default=None, gt=0, lt=1)
    loss: LossKind | None = None
    tuning: float | None = Field(default=None, gt=0)
    period: Seconds | None = None
    begin: Seconds | None = None
    end: Seconds | None = None
    law: Law = "gaussian"
    outliers: OutlierSettings | None = None
    most: int | None = Field(default=None, ge=1)
    association_errors: float = Field(default=0.0, ge=0, lt=1)

    @model_validator(mode="after")
    def _in_order(self) -> SensorOptions:
        if self.begin is not None and self.end is not None and not self.begin < self.end:
            raise ValueError(f"found begin at {self.begin} s and end at {self.end} s")
        return self

    def timing(self) -> Timing:
        """The settings as the simulator takes them."""
        begin = -math.inf if self.begin is None else self.begin
        end = math.inf if self.end is None else self.end
        o = self.outliers
        struck = (0.0, 0.0) if o is None else (o.fraction, o.size)
        few = self.most, self.association_errors
        return Timing(self.period, *struck, begin, end, self.law, *few)


def besides(step: float | None, options: Iterable[SensorOptions]) -> set[float]:
    """Periods of sensors, s, that are no multiples of the step of a simulated pass, s: they measure
    between its epochs, so that it has these besides."""
    if step is None:
        return set()
    periods = {o.period for o in options if o.period is not None}
    return {p for p in periods if p / step < 1 - 1e-6 or abs(p / step - round(p / step)) > 1e-6}


class OnlineSettings(BaseModel):
    """Settings of estimators that take one epoch at a time. window: length of the fixed-lag
    smoother's window, and how late a measurement may come; by default 30 epochs. Also of the batch
    that `ekf_batch_start` begins with; by default 100 s."""

    model_config = STRICT

    window: Seconds | None = None


class GapSettings(BaseModel):
    """How gaps in an input are bridged, before, between and after its samples: for `bridge`
    seconds at most the last mean goes on, and the variance (spread x length)^2 is added to what
    is integrated of it. `spread`, in the unit of the input, is one number or one for each of its
    channels; by default 0.1 deg/s for rates, 0.01 m/s^2 for accelerations, 0.1 m/s for
    velocities; an input of another unit is bridged only where it is given. A longer gap is an
    error; a stream begins again after it."""

    model_config = STRICT

    bridge: Annotated[float, Quantity("s", nonnegative=True)] = 30.0
    spread: Any = None


class StampSettings(BaseModel):
    """How late the stamps of an input or a sensor are, and how unsteady.

    lag: what it says at a stamp was so that much earlier, s; it is taken off when data are read,
    and put on when a pass is simulated. Of an input, an estimate needs samples with stamps up to
    that much later: online it waits for them. jitter: of an input, one sigma of how long an
    interval between epochs is, s, and of how far it and the samples are apart: the integral of an
    input of mean v, which changes by dv over the interval, has the variance jitter^2 (v^2 + dv^2)
    then.
    """

    model_config = STRICT

    lag: Annotated[float, Quantity("s")] = 0.0
    jitter: Annotated[float, Quantity("s", nonnegative=True)] = 0.0


class BlockPrior(BaseModel):
    """Prior of one block. sigma: one for all axes or one each, SI or strings with units.

    mean: "drawn" about the truth with sigma (simulation only), "truth" itself, "measured"
    by the first frames, or values (an attitude as a rotation vector, or as q_wxyz: scalar first,
    normalised within 1e-3). Of a family of blocks (`point`, of an unknown map) one prior stands for
    each: values, by default zero, or "measured", which is the same: a point starts from where it is
    first seen, and is within sigma of the target's centre of mass; or "drawn" or "truth", written
    out, of each its own. considered: not estimated, but counted in the covariances of all others
    (Schmidt 1966), by `ekf`, and of static blocks by `batch` and `isam2`.
    """

    model_config = STRICT

    sigma: Any
    mean: Literal["drawn", "truth", "measured"] | list[Any] = "drawn"
    considered: bool = False
