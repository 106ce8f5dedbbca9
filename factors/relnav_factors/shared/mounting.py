"""Sensors that are mounted on the chaser with an attitude, and maybe a place, of their own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar, Literal, Self

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.core.models import SensorModel
from relnav_graph.core.state import Block, check_rotation
from relnav_graph.errors import InputError
from relnav_graph.maths import dense
from relnav_graph.units import Quantity

#: How many numbers of the mounting a kernel's p starts with, see `MountedSensor.constants`.
MOUNTING = 13


@jit
def mounting_of(p: Array, x: Array) -> Array:
    """The mounting (12,): R_cs row by row, r_sc_c, m.

    p: starts with the (13,) of `MountedSensor.constants`; x: ends, where the mounting is estimated,
    with R_ns row by row, and maybe d_sn_c (m).

        R_cs = R_cn R_ns,  r_sc_c = r_nc_c + d_sn_c
    """
    out, columns = p[:12].copy(), int(p[12])
    if columns > 0:
        first = x.shape[0] - columns - 6
        dense.put_matrix(out, 0, dense.matmul(dense.matrix_at(p, 0), dense.matrix_at(x, first)))
        for i in range(columns - 3):
            out[9 + i] += x[first + 9 + i]
    return out


@jit
def without_mounting(p: Array, x: Array) -> Array:
    """x (m,) without an estimated mounting at its end; p, x and units: as of `mounting_of`."""
    return x[: x.shape[0] - (int(p[12]) + 6 if p[12] > 0.0 else 0)]


def misalignment(mount: str) -> Block:
    """The block of an estimated attitude of a mount: R_ns, from its axes s to nominal ones, n."""
    return Block(f"{mount}_misalignment", "R_ns", "SO3", 3, "rad", "ns", "deg")


def displacement(mount: str) -> Block:
    """The block of an estimated lever arm of a mount: d_sn_c, m, from its nominal place."""
    return Block(f"{mount}_displacement", "d_sn_c", "vector", 3, "m", "c", "m")


@dataclass(frozen=True, kw_only=True)
class Mounted(SensorModel):
    """What the sensors share whose mounting may be estimated.

    mounting: "known", or "estimated": what it is off from the one that the sensor states, which is
    then nominal, stands in the state as static blocks of the mount. mount: its name, by which their
    names begin, in a scenario by default that of the sensor; sensors of one mount share them.
    Raises InputError when it is needed and is none.
    """

    mounting: Literal["known", "estimated"] = "known"
    mount: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        letters = self.mount.translate(str.maketrans(".+-", "___"))
        if self.mounting == "estimated" and not (letters and f"_{letters}".isidentifier()):
            raise InputError(
                f"{self.kind}.mount: found {self.mount!r}, expected a name (letters, digits,"
                " _ . + -), by which the blocks of the estimated mounting are called"
            )

    def freed(self) -> Self:
        """The same with its mounting estimated. Raises InputError without the name of a mount."""
        return self if self.mounting == "estimated" else replace(self, mounting="estimated")


@dataclass(frozen=True, kw_only=True)
class MountedSensor(Mounted):
    """What the sensors share whose axes s are not those of c: R_cs = R_cn R_ns.

    sensor_attitude: R_cs, or R_cn of a mounting that is estimated. Raises InputError when it is
    not a rotation within 1e-6.
    """

    #: Whether its place matters, so that an estimated mounting has a lever arm, too.
    placed: ClassVar[bool] = False

    sensor_attitude: Annotated[Array, Quantity("1", (3, 3))] = field(
        default_factory=lambda: np.eye(3)
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        check_rotation(f"{self.kind}.sensor_attitude", self.sensor_attitude)

    @property
    def place(self) -> Array:
        """r_sc_c (3,), m, where that matters, else zero."""
        return np.zeros(3)

    @property
    def mounting_blocks(self) -> tuple[Block, ...]:
        """The static blocks of an estimated mounting: the last that the sensor reads."""
        if self.mounting == "known":
            return ()
        return misalignment(self.mount), *((displacement(self.mount),) if self.placed else ())

    def constants(self) -> Array:
        """(13,): R_cs row by row, r_sc_c (m), the tangent columns of an estimated mounting."""
        columns = sum(b.dim for b in self.mounting_blocks)
        return np.concatenate([self.sensor_attitude.ravel(), self.place, [columns]])

    def mounting_fields(self, values: Mapping[str, Array]) -> dict[str, Array]:
        """R_cs (3, 3) with these values of the mounting's blocks, by name."""
        return {"sensor_attitude": self._moved(values)[0]}

    def _moved(self, values: Mapping[str, Array]) -> tuple[Array, Array]:
        """R_cs (3, 3) and r_sc_c (3,), m: `mounted`, not moved by blocks that are not there."""
        free = self.freed()
        own = {
            b.name: np.eye(3) if b.manifold == "SO3" else np.zeros(3) for b in free.mounting_blocks
        }
        return free.mounted({**own, **values})

    def mounted(self, known: Mapping[str, Array]) -> tuple[Array, Array]:
        """R_cs (3, 3) and r_sc_c (3,), m; known: values of blocks, by name: where those of the
        mounting are not among them, it is the nominal one."""
        values = [known.get(b.name) for b in self.mounting_blocks]
        if not values or any(value is None for value in values):
            return self.sensor_attitude, self.place
        x = np.concatenate([np.ravel(value) for value in values])  # type: ignore[arg-type]
        found = mounting_of(self.constants(), x)
        return found[:9].reshape(3, 3), found[9:]


@dataclass(frozen=True, kw_only=True)
class PlacedSensor(MountedSensor):
    """What the sensors share whose place matters, too: r_sc_c = r_nc_c + d_sn_c.

    sensor_position: r_sc_c, m, or r_nc_c of a mounting that is estimated.
    """

    placed: ClassVar[bool] = True

    sensor_position: Annotated[Array, Quantity("m", (3,))] = field(
        default_factory=lambda: np.zeros(3)
    )

    @property
    def place(self) -> Array:
        """r_sc_c (3,), m."""
        return self.sensor_position

    def mounting_fields(self, values: Mapping[str, Array]) -> dict[str, Array]:
        """R_cs (3, 3) and r_sc_c (3,), m, with these values of the mounting's blocks, by name."""
        R_cs, r_sc_c = self._moved(values)
        return {"sensor_attitude": R_cs, "sensor_position": r_sc_c}
