"""Other ways in which the numbers of sensors and inputs may have been meant: orders of quaternions,
inverse rotations and poses, units, signs, axes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import Dynamics
from relnav_graph.core.epochs import Epoch, channels
from relnav_graph.core.measurement import QUATERNION, Measurement
from relnav_graph.core.problem import Problem
from relnav_graph.io.poses import ORDERS, Motion, from_quaternions, quaternions
from relnav_graph.scenario.first_estimate import with_measured
from relnav_graph.units import column_unit

__all__ = ["BETTER", "Reading", "of_axes", "readings"]

#: How many times smaller a misfit must be where another reading mends it.
BETTER = 4.0
_POSE = ("x_m", "y_m", "z_m", *QUATERNION)
#: Where q_w, q_x, q_y, q_z stand in what was read, by how that was written.
_ORDERS: Mapping[str, Sequence[int]] = {
    "": ORDERS["wxyz"],
    "written with the scalar last": ORDERS["xyzw"],
    "written with the scalar first": (1, 2, 3, 0),
}
#: By SI unit of a column what it may be in, and how many SI units one of that is. What is in km and
#: was taken for m, fits too well: the verdict on the noise says it.
_UNITS: Mapping[str, Mapping[str, float]] = {
    "m": {"mm": 1e-3},
    "rad": {"deg": np.pi / 180},
    "rad/s": {"deg/s": np.pi / 180, "rad/s, and was taken for deg/s": 180 / np.pi},
    "m/s^2": {"g": 9.80665},
}


@dataclass(frozen=True, eq=False)
class Reading:
    """Another way to read a sensor or an input: its name, what it would be in words, and what that
    makes of a measurement, or of samples (k, channels); without words: an input that says nothing.

    better: how many times smaller the misfit must then be; slight: a pass may fit nearly as well
    without it; shrinks: residuals are smaller in it, of noise too.
    """

    name: str
    what: str
    measured: Callable[[Measurement], Measurement] | None = None
    sampled: Callable[[Array], Array] | None = None
    better: float = BETTER
    slight: bool = False
    shrinks: bool = False

    def of(self, problem: Problem) -> Problem:
        """The problem, read so, and what was measured of the prior measured again. Raises
        EstimationError when that is impossible."""
        epochs = tuple(self._epoch(problem.processes, e) for e in problem.epochs)
        return with_measured(replace(problem, epochs=epochs), problem.measured)

    def _epoch(self, processes: Mapping[str, Dynamics], epoch: Epoch) -> Epoch:
        if (measured := self.measured) is not None:
            own = (measured(m) if m.sensor == self.name else m for m in epoch.measurements)
            return replace(epoch, measurements=tuple(own))
        inputs = dict(epoch.inputs)
        for process, u in epoch.inputs.items():
            columns = channels(processes[process]).get(self.name)
            if columns is not None and self.sampled is not None:
                inputs[process] = u.copy()
                inputs[process][:, columns] = self.sampled(u[:, columns])
        return replace(epoch, inputs=inputs)


def readings(problem: Problem) -> Iterator[Reading]:
    """What first comes to mind."""
    for name, sensor in problem.sensors.items():
        columns = tuple(sensor.columns)
        if columns[-4:] == QUATERNION:
            yield from _attitudes(name)
        if columns == _POSE:
            yield from _poses(problem, name)
        for what, factors in _units(columns):
            # All residuals are smaller in another unit: by its square, if that is what is wrong.
            better = max(BETTER, 0.1 / factors.min() ** 2)
            yield Reading(
                name,
                f"{name!r} is in {what}",
                _multiplied(factors),
                better=better,
                shrinks=bool(factors.min() < 1),
            )
    for name, columns in _inputs(problem).items():
        # What fits as well as this one has only taken away an input that is worse than declared.
        yield Reading(name, "", None, np.zeros_like, slight=True)
        for what, factors in _units(columns):
            yield Reading(name, f"{name!r} is in {what}", None, factors.__mul__, slight=True)
        yield Reading(name, f"{name!r} has the other sign", None, np.negative, slight=True)


def of_axes(problem: Problem) -> Iterator[Reading]:
    """Inputs of three axes, of which some are swapped or reversed: the fewest first."""
    every = [*product(permutations(range(3)), product((1, -1), repeat=3))]
    changes = [sum(k != i for i, k in enumerate(order)) + s.count(-1) for order, s in every]
    for name, columns in _inputs(problem).items():
        for count, (order, signs) in (
            sorted(zip(changes, every, strict=True)) if len(columns) == 3 else ()
        ):
            if order == (0, 1, 2) and len({*signs}) == 1:
                continue  # what was read, and what was tried before
            axes = [f"{'-' * (s < 0)}{'xyz'[k]}" for k, s in zip(order, signs, strict=True)]

            def read(u: Array, o: Sequence[int] = order, s: Sequence[int] = signs) -> Array:
                return u[:, o] * s

            what = f"x, y, z are {', '.join(axes)} of {name!r}"
            yield Reading(name, what, None, read, slight=count < 3)


def _inputs(problem: Problem) -> dict[str, tuple[str, ...]]:
    """Columns of the inputs, by name."""
    processes = problem.processes.values()
    return {name: tuple(columns) for p in processes for name, columns in p.inputs.items()}


def _units(columns: Sequence[str]) -> Iterator[tuple[str, Array]]:
    """Units that columns may be in, and factors to SI of all columns."""
    own = [None if c in QUATERNION else column_unit(c) for c in columns]
    for unit, others in _UNITS.items():
        for other, factor in others.items() if unit in own else ():
            yield other, np.array([factor if u == unit else 1.0 for u in own])


def _multiplied(factors: Array) -> Callable[[Measurement], Measurement]:
    return lambda m: replace(m, z=m.z * factors)


def _ordered(z: Array, order: Sequence[int], sign: float = 1.0) -> Array:
    """Rows with their last four columns in another order, and x, y, z of another sign."""
    return np.hstack([z[:, :-4], z[:, -4:][:, order] * [1, sign, sign, sign]])


def _attitudes(name: str) -> Iterator[Reading]:
    """Quaternions in another order, or of the inverse rotation."""
    for how, order in _ORDERS.items():
        for sign, direction in ((1.0, ""), (-1.0, "those of the inverse rotation")):
            if how or direction:
                said = " and ".join(part for part in (how, direction) if part)

                def read(m: Measurement, o: Sequence[int] = order, s: float = sign) -> Measurement:
                    return replace(m, z=_ordered(m.z, o, s))

                yield Reading(name, f"the quaternions of {name!r} are {said}", read)


def _poses(problem: Problem, name: str) -> Iterator[Reading]:
    """The pose of b in a for that of a in b, or its place alone: with the noise that the other one
    has then, or, if that was inverted before, as declared."""

    def where(k: int) -> str:
        return f"row {k}"

    for (how, order), whole, other in product(_ORDERS.items(), (True, False), (True, False)):

        def read(
            m: Measurement, o: Sequence[int] = order, w: bool = whole, n: bool = other
        ) -> Measurement:
            P = m.covariance if m.covariance is not None else problem.sensors[name].noise(m)
            z = _ordered(m.z, o)
            R = from_quaternions(where, z[:, 3:])
            pose = {"position": z[:, :3], "attitude": R}
            inverse = Motion(np.full(len(z), m.t), pose, where, {"pose": P}).inverse()
            r, q = inverse.values["position"], quaternions(inverse.values["attitude"])
            if not w:  # the place is one seen from b, whose axes R takes to those of a
                r, q = -np.einsum("nij,nj->ni", R, z[:, :3]), z[:, 3:]
            noise = inverse.covariance("pose") if n else m.covariance
            return replace(m, z=np.hstack([r, q]), covariance=noise)

        what = f"{name!r} has the inverse pose" if whole else f"places of {name!r} are inverse"
        yield Reading(name, what + (f", its quaternion {how}" if how else ""), read)
