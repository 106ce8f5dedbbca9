"""What states in a file are to an estimate: truth, measurements or inputs; and the recording.

A file of trajectories holds states, and does not say what they are to be. A reader has it declared
(`Roles`):

- ``truth``: blocks, by quantity: ``{ position = "relative_position", attitude =
  "relative_attitude" }``. Of quantities with a covariance it is the truth's own noise.
- ``measured``: a sensor of the scenario, by its name: what of the states it measures its
  columns say; or, where the scenario is not known, sensors by quantity: ``{ pose = "tracker" }``,
  with "pose" for a position (m) and q_wxyz. How good they are its sigma in the scenario says.
- ``inputs``: inputs, by quantity: ``{ rate = "gyro", acceleration = "accelerometer" }``; with
  ``samples`` = "mean", each sample is the mean since the one before, as in a data set, and the
  first one only says when the first interval starts; = "instant", each is taken at its stamp, and
  the mean of an interval is that of both ends.
- ``inverse = true``: the file has the pose of a in b for that of b in a, see
  `relnav_graph.io.poses`.

A message of CCSDS names its quantities, frames and body itself. What it leaves open is one word,
``role`` = "truth", "measured" by the ``sensor``, or "target" (`check_role`, `given_columns`).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.epochs import epoch_times
from relnav_graph.core.measurement import QUATERNION, InputSeries, Measurement
from relnav_graph.core.track import Recording, Truth
from relnav_graph.errors import InputError
from relnav_graph.io.clocks import Clock
from relnav_graph.io.covariances import sigmas_of
from relnav_graph.io.known import Known
from relnav_graph.io.lines import Rows, rising
from relnav_graph.io.poses import Motion, Where, quaternions
from relnav_graph.io.truth import at_epochs, block_like
from relnav_graph.units import column_unit

__all__ = [
    "SAMPLES",
    "Collected",
    "Roles",
    "check_role",
    "check_roles",
    "given_columns",
    "poses",
    "wrong_sensor",
]

_LOG = logging.getLogger(__name__)
SAMPLES = ("mean", "instant")
#: Columns of the sensors, and which quantities of a motion they are, one after the other.
_COLUMNS: Mapping[tuple[str, ...], str] = {
    ("x_m", "y_m", "z_m", *QUATERNION): "pose",
    ("x_m", "y_m", "z_m"): "position",
    QUATERNION: "attitude",
    ("x_m_s", "y_m_s", "z_m_s"): "velocity",
    ("x_rad_s", "y_rad_s", "z_rad_s"): "rate",
}
_UNITS = {"rate": "rad/s", "acceleration": "m/s^2", "velocity": "m/s"}


def _named(where: str, found: Any) -> dict[str, str]:
    """Names by quantity. Raises InputError on anything else."""
    if not isinstance(found, Mapping) or not all(isinstance(v, str) for v in found.values()):
        raise InputError(f"{where}: found {found!r}, expected names by quantity")
    return dict(found)


def check_role(path: Path, what: str, role: str, roles: Mapping[str, str]) -> None:
    """Raise InputError unless a role is one of those that `what` can have, by name: what it is."""
    if role not in roles:
        found = f"found the role {role!r}" if role else "found no role"
        known = "; ".join(f"{name!r}, {text}" for name, text in roles.items())
        raise InputError(
            f"{path}: holds {what}, no measurements: {found}, expected one of: {known}"
        )


def check_roles(
    known: Known,
    truth: Any = None,
    measured: Any = None,
    inputs: Any = None,
    inverse: bool = False,
    samples: str = "mean",
    **_: Any,
) -> None:
    """What can be said of the options of a reader before there is a file: see `Roles.check`."""
    Roles.of("data.options", truth, measured, inputs, inverse, samples).check(known)


def _measures(where: str, name: str, known: Known) -> str:
    """Which quantity a sensor of the scenario measures, by its columns."""
    where, able = f"{where}.measured", f"a sensor of a {', '.join(_COLUMNS.values())}"
    hint = '; where it is not known, its quantity beside it, as { pose = "NAME" }'
    columns = known.columns_of(where, name, hint)
    if columns not in _COLUMNS:
        raise wrong_sensor(where, name, columns, able)
    return _COLUMNS[columns]


def wrong_sensor(where: str, name: str, columns: Sequence[str], expected: str) -> InputError:
    """The error of a sensor that measures something else."""
    measures = ", ".join(columns)
    return InputError(f"{where}: found {name!r}, which measures {measures}; expected {expected}")


def given_columns(path: Path, known: Known, name: str, there: Collection[str]) -> tuple[str, ...]:
    """The columns of a sensor, all of which must be `there`; of a file that is read without a
    scenario those of a position or an attitude. Raises InputError otherwise, and without a name."""
    where = f"{path}: option sensor"
    if not name:
        raise InputError(f"{where}: found none: measured by which sensor?")
    if not known.sensors:
        return tuple(c for c in there if column_unit(c) != "m/s")
    columns = known.columns_of(where, name)
    if not set(columns) <= set(there):
        raise wrong_sensor(where, name, columns, f"a sensor of {', '.join(there)}")
    return columns


@dataclass(frozen=True)
class Roles:
    """What the states of a file are: names by quantity, see above. where: the options' path.

    sensors: names of sensors whose columns say what they measure.
    """

    where: str
    truth: Mapping[str, str]
    measured: Mapping[str, str]
    sensors: tuple[str, ...]
    inputs: Mapping[str, str]
    inverse: bool = False
    samples: str = "mean"
    covariance: bool = False

    @staticmethod
    def of(
        where: str,
        truth: Any = None,
        measured: Any = None,
        inputs: Any = None,
        inverse: bool = False,
        samples: str = "mean",
        covariance: bool = False,
    ) -> Roles:
        """From options. Raises InputError when none is declared, or one is of another form."""
        if not truth and not measured and not inputs:
            raise InputError(
                f"{where}: found states without a role, expected truth = {{ position = BLOCK,"
                " attitude = BLOCK }, measured = SENSOR, or inputs = { rate = INPUT }"
            )
        one = (measured,) if isinstance(measured, str) else measured
        several = isinstance(one, list | tuple)
        if several and not all(isinstance(name, str) for name in one):
            raise InputError(f"{where}.measured: found {one!r}, expected names of sensors")
        if samples not in SAMPLES:
            expected = " or ".join(SAMPLES)
            raise InputError(f"{where}.samples: found {samples!r}, expected {expected}")
        for name, flag in (("inverse", inverse), ("covariance", covariance)):
            if not isinstance(flag, bool):
                raise InputError(f"{where}.{name}: found {flag!r}, expected true or false")
        return Roles(
            where,
            _named(f"{where}.truth", truth or {}),
            {} if several else _named(f"{where}.measured", one or {}),
            tuple(one) if several else (),
            _named(f"{where}.inputs", inputs or {}),
            inverse,
            samples,
            covariance,
        )

    def check(self, known: Known) -> None:
        """Raise InputError on sensors and inputs that the scenario does not have, and warn of
        truth that it does not."""
        for name in self.sensors if known.complete else ():
            _measures(self.where, name, known)
        for quantity, name in self.measured.items():
            known.check_sensor(f"{self.where}.measured.{quantity}", name)
        for quantity, name in self.inputs.items():
            known.check_input(f"{self.where}.inputs.{quantity}", name)
        for quantity, name in self.truth.items():
            known.check_truth(f"{self.where}.truth.{quantity}", name)

    def only(self, *kinds: str) -> Roles:
        """The same with some of "truth", "measured" and "inputs" alone; what of is inverted
        are the first two."""
        states = "measured" in kinds
        return replace(
            self,
            truth=self.truth if "truth" in kinds else {},
            measured=self.measured if states else {},
            sensors=self.sensors if states else (),
            inputs=self.inputs if "inputs" in kinds else {},
            inverse=self.inverse and kinds != ("inputs",),
        )


@dataclass(frozen=True, eq=False)
class _True:
    """Values of a block at t (N,), s, and their sigmas (N, dim), where known."""

    t: Array
    value: Array
    sigma: Array | None
    where: str


@dataclass
class Collected:
    """A recording in the making: measurements, inputs and truth of one file after the other."""

    known: Known
    source: str
    measurements: list[Measurement] = field(default_factory=list)
    inputs: dict[str, InputSeries] = field(default_factory=dict)
    truth: dict[str, _True] = field(default_factory=dict)

    def add(self, motion: Motion, roles: Roles) -> None:
        """What a motion is by its roles. Raises InputError on quantities that it does not have,
        names that are taken, and columns of another sensor."""
        motion = motion.inverse() if roles.inverse else motion
        for quantity, block in roles.truth.items():
            value, P = _value(motion, quantity, f"{roles.where}.truth"), motion.covariance(quantity)
            sigma = None if P is None else sigmas_of(P)
            self.known.check_truth(f"{roles.where}.truth.{quantity}", block)
            self.add_truth(f"{roles.where}.truth.{quantity}", block, motion.t, value, sigma)
        for name in roles.sensors:
            self._add_measured(motion, _measures(roles.where, name, self.known), name, roles)
        for quantity, name in roles.measured.items():
            self._add_measured(motion, quantity, name, roles)
        for quantity, name in roles.inputs.items():
            value = _value(motion, quantity, f"{roles.where}.inputs")
            self._check_input(f"{roles.where}.inputs.{quantity}", name, quantity)
            self.add_input(motion.where, name, motion.t, value, roles.samples)

    def _add_measured(self, motion: Motion, quantity: str, name: str, roles: Roles) -> None:
        """One measurement of a quantity, or of the "pose", at each time, for a sensor."""
        where = f"{roles.where}.measured"
        if name in self.known.sensors and _measures(roles.where, name, self.known) != quantity:
            columns = ", ".join(self.known.sensors[name].columns)
            raise InputError(f"{where}: found a {quantity} for {name!r}, which measures {columns}")
        parts = ("position", "attitude") if quantity == "pose" else (quantity,)
        found = [_value(motion, part, where) for part in parts]
        z = np.hstack([quaternions(v) if v.ndim == 3 else v for v in found])
        P = motion.covariance(quantity)
        if not roles.covariance:
            if P is not None and np.isfinite(P).any():
                _LOG.info(
                    f"{self.source}: {name!r} has the sigma of the scenario; with covariance = true"
                    " it has the covariances of the file"
                )
            P = None
        elif P is None or not np.isfinite(P).all():
            k = 0 if P is None else int(np.argmin(np.isfinite(P).all(axis=(1, 2))))
            raise InputError(f"{motion.where(k)}: found no covariance of the {quantity}")
        self.add_rows(name, motion.t, z, None, motion.arrival, P)

    def add_rows(
        self,
        name: str,
        t: Array,
        z: Array,
        ids: Indices | None = None,
        arrival: Array | None = None,
        covariance: Array | None = None,
    ) -> None:
        """Measurements of a sensor: z (N, columns) at t (N,), s, which do not fall; rows of one
        time are one measurement. ids (N,): default 0; arrival (N,): when they became known, s;
        covariance (N, rows, rows), SI."""
        if any(m.sensor == name for m in self.measurements):
            raise InputError(f"data.options: found measurements of {name!r} twice")
        ids = np.zeros(len(t), dtype=np.int64) if ids is None else ids
        edges = [*np.nonzero(np.diff(t, prepend=-np.inf) > 0)[0].tolist(), len(t)]
        for i, j in pairwise(edges):
            when = None if arrival is None else float(arrival[i])
            P = None if covariance is None else covariance[i:j]
            one = Measurement(name, float(t[i]), z[i:j], ids[i:j], when, covariance=P)
            self.measurements.append(one)

    def _check_input(self, where: str, name: str, quantity: str) -> None:
        """Raise InputError when an input of the scenario has other columns."""
        columns = self.known.inputs.get(name)
        unit = _UNITS.get(quantity)
        if columns is None or unit is None:
            return
        if len(columns) != 3 or any(column_unit(c) != unit for c in columns):
            raise InputError(f"{where}: found {name!r}, whose columns are {', '.join(columns)}")

    def add_input(self, where: Any, name: str, t: Array, value: Array, samples: str) -> None:
        """An input of samples (N, channels) at t (N,), s, rising."""
        if name in self.inputs:
            raise InputError(f"data.options: found the input {name!r} twice")
        if len(t) < 2:
            raise InputError(
                f"{where(0)}: found {len(t)} samples of {name!r}, expected two or more"
            )
        means = value[1:] if samples == "mean" else 0.5 * (value[1:] + value[:-1])
        self.inputs[name] = InputSeries(name, t[:-1], t[1:], means, None, self.source)

    def add_truth(
        self, where: str, name: str, t: Array, value: Array, sigma: Array | None = None
    ) -> None:
        """True values of a block at t (N,), s, rising. Raises InputError on a block that the
        scenario has in another form, and on one that is there already."""
        if name in self.truth:
            raise InputError(f"{where}: found the truth of {name!r} twice")
        block = self.known.blocks.get(name)
        if block is not None:
            shape = (3, 3) if block.manifold == "SO3" else (block.dim,)
            if value.shape[1:] != shape:
                raise InputError(f"{where}: found {value.shape[1:]} for {name!r}, expected {shape}")
        self.truth[name] = _True(t, value, sigma, where)

    def recording(self, settings: Mapping[str, Any] | None = None) -> Recording:
        """The recording: epochs are the times of measurements, without any those of truth."""
        self.measurements.sort(key=lambda m: m.t)
        times = epoch_times(np.array([m.t for m in self.measurements]), self.known.merge)
        if not len(times) and self.truth:
            times = np.unique(np.concatenate([one.t for one in self.truth.values()]))
        truth = self._truth(times) if self.truth else None
        return Recording(times, tuple(self.measurements), self.inputs, truth, settings or {})

    def _truth(self, times: Array) -> Truth:
        """All that is true at its own times and, between them, at the epochs."""
        own = np.unique(np.concatenate([one.t for one in self.truth.values()]))
        lacking = times[~Truth(own, {}).at(times)[1]]
        t = np.sort(np.concatenate([own, lacking]))
        values, sigmas = dict[str, Array](), dict[str, Array]()
        for name, one in self.truth.items():
            block = self.known.blocks.get(name) or block_like(name, one.value)
            values[name] = at_epochs(f"{self.source}: {name}", block, one.t, one.value, t)
            known = None if one.sigma is None else np.isfinite(one.sigma).all(axis=1)
            if one.sigma is not None and known is not None and known.any():
                columns = [np.interp(t, one.t[known], s[known]) for s in one.sigma.T]
                sigmas[name] = np.column_stack(columns)
        return Truth(t, values, self.source, sigmas)


def poses(
    known: Known,
    roles: Roles,
    rows: Rows,
    clock: Clock,
    stamps: Sequence[Decimal],
    pose: Callable[[Where, Array], tuple[Array, Array]],
) -> Recording:
    """What the poses of one table are by their roles.

    stamps: of the rows, by a clock; pose: position (N, 3), m, and attitude (N, 3, 3) of the rows'
    values. Raises InputError on times that do not rise, and as `Collected.add` and `pose` do.
    """
    begin = clock.begin(rows.where(0), min(stamps))
    t = clock.seconds(stamps, begin)
    rising(rows.where, t)
    r, R = pose(rows.where, rows.values)
    found = Collected(known, rows.path.name)
    found.add(Motion(t, {"position": r, "attitude": R}, rows.where), roles)
    return found.recording(clock.settings(begin))


def _value(motion: Motion, quantity: str, where: str) -> Array:
    if quantity not in motion.values:
        there: Sequence[str] = [*motion.values]
        raise InputError(f"{where}: found {quantity!r}, expected one of {', '.join(there)}")
    return motion.values[quantity]
