"""What a sensor, a process model and a derived quantity provide: structural contracts.

A model is a frozen dataclass in a file of its own. Its formula stands once, in a compiled
kernel (`relnav_graph.compiled.contracts`), and simulator, filter and graph all reach it through
the same object. `relnav_graph.core.models` has mixins that make most of these methods of the
kernel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.state import Block
from relnav_graph.maths.orbit import KeplerOrbit

__all__ = [
    "Ambiguous",
    "BringsTruth",
    "CopiesBlocks",
    "Derived",
    "Drifts",
    "Dynamics",
    "IntegratesBySteps",
    "KnowsInertialOrbit",
    "KnowsOrbit",
    "KnowsTorque",
    "Mappable",
    "Mountable",
    "NamesDirections",
    "NamesResiduals",
    "ProposesStarts",
    "ReadsCopies",
    "ReadsNumbered",
    "ReadsTime",
    "ScattersRaw",
    "Sensor",
    "Wanders",
]

Kernel = Callable[..., Any]


@runtime_checkable
class Sensor(Protocol):
    """A measurement model h. Residuals are prediction minus measured, as in GTSAM.

    Everywhere below: x, one value per block of `reads`, (3, 3) for an attitude and (dim,)
    for a vector, in the block's SI unit and frame; ids (k,), which beacon or point each
    observation is of; z (k, nz), in the units that `columns` name.
    """

    kind: ClassVar[str]
    #: Names of the components of z, with units: the columns of the sensor's table.
    columns: ClassVar[tuple[str, ...]]
    #: Residual rows of one observation.
    rows: ClassVar[int]

    @property
    def kernel(self) -> Kernel:
        """Compiled function of the signature `relnav_graph.compiled.contracts.SENSOR_KERNEL`."""

    @property
    def reads(self) -> tuple[Block, ...]:
        """Blocks that the model reads, in the order of its arguments."""

    def constants(self) -> Array:
        """p of the kernel, (np,): numbers of the sensor itself, SI."""

    def observation_data(self, ids: Indices) -> Array:
        """q of the kernel, (k, nq), SI: what belongs to each observation, such as the place of
        its beacon. Raises InputError on an id that the sensor does not know."""

    def observables(self) -> Indices:
        """Ids (k,) that a simulated sensor looks for."""

    def accept(self, z: Array) -> Array:
        """Measured values z (k, nz) as the kernel wants them. Raises InputError on values
        that this sensor cannot give."""

    def at(self, t: float) -> Sensor:
        """The sensor as it is at time t, s: transmitters may move, frame o turns."""

    def in_view(self, ids: Indices, *x: Array) -> Indices:
        """Those of the ids (k,) that a simulated sensor should try to see at the state x."""

    def predict(self, ids: Indices, *x: Array) -> Array:
        """z (k, nz) without noise at the state x. Raises GeometryError when an observation
        is impossible there."""

    def perturb(self, z: Array, e: Array) -> Array:
        """z (k, nz) with noise e (k, rows) added, in the units of the residual, for the
        simulator."""

    def noise(self, m: Measurement) -> Array:
        """Covariance R (k, rows, rows) of each observation's residual."""

    def failure(self, status: int) -> str:
        """What a non-zero status of the kernel means."""

    def residual(self, m: Measurement, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        """r (k * rows,) and its Jacobian to the tangent of each block, (k * rows, dim).

        Not whitened. Raises GeometryError when an observation is impossible at the state x.
        """


@runtime_checkable
class Dynamics(Protocol):
    """A process model: advances some blocks over an interval, reading maybe others.

    Everywhere below: x, one value per block, those of `advances` and then of `reads`, (3, 3)
    for an attitude and (dim,) for a vector, SI, in the block's frame, at the start of the
    interval; t: that start, s; u (rows, 1 + channels): one row per sub-interval, its length in
    s and then the mean of each input over it, SI.
    """

    kind: ClassVar[str]
    #: For each advanced block, the field whose noise drives it; may be empty.
    noises: ClassVar[tuple[str, ...]]

    @property
    def inputs(self) -> Mapping[str, tuple[str, ...]]:
        """The inputs (gyro, accelerometer, thrust), each a known mean over sub-intervals: the
        columns of its table, with units, by name."""

    @property
    def kernel(self) -> Kernel:
        """Compiled function of the signature `relnav_graph.compiled.contracts.DYNAMICS_KERNEL`."""

    @property
    def advances(self) -> tuple[Block, ...]:
        """Blocks that the model moves forward; first of the arguments."""

    @property
    def reads(self) -> tuple[Block, ...]:
        """Blocks that it only reads; after the advanced ones."""

    def constants(self) -> Array:
        """p of the kernel, (np,): numbers of the process itself, SI."""

    def failure(self, status: int) -> str:
        """What a non-zero status of the kernel means."""

    def condense(self, u: Array) -> Array:
        """u (rows, 1 + channels) with sub-intervals joined where that leaves the model's result
        the same: an epoch stores what this gives."""

    def propagate(self, t: float, u: Array, *x: Array) -> tuple[Array, ...]:
        """Values of the advanced blocks at the end of the interval, (3, 3) or (dim,) each."""

    def transition(self, t: float, u: Array, *x: Array) -> tuple[tuple[Array, ...], Array, Array]:
        """Values of the advanced blocks at the end of the interval, F and Q.

        With n the tangent dimension of the advanced blocks: F (n, n + tangent dimension of the
        blocks read), their Jacobian to the tangents of x; Q (n, n), covariance of the noise.
        """

    def caution(self, length: float, *x: Array) -> str:
        """A warning, or "": what an interval of `length` s leaves ambiguous at the state x, such
        as an aliased rate. x: (3, 3) or (dim,) per block."""


@runtime_checkable
class Derived(Protocol):
    """A quantity computed from blocks, with its Jacobian, for tables and covariances."""

    @property
    def kind(self) -> str: ...

    @property
    def block(self) -> Block: ...

    @property
    def reads(self) -> tuple[Block, ...]: ...

    def value(self, *x: Array) -> tuple[Array, Array]:
        """The value, and d(tangent of the value) / d(tangents of the blocks read).

        x: one value per block of `reads`, (3, 3) or (dim,), SI, in the block's frame. Value:
        (3, 3) or (dim,), in the unit and frame of `block`; Jacobian: (dim, sum of dims read).
        """


# Optional abilities of a model. Code that needs one tests for it by isinstance.


@runtime_checkable
class Ambiguous(Protocol):
    """A derived quantity of which several values say the same, such as axes without a sign."""

    def nearest(self, value: Array, to: Array) -> Array:
        """Of what says the same as the values (N, 3, 3) or (N, dim), those nearest to `to`."""


@runtime_checkable
class ProposesStarts(Protocol):
    """A sensor of which one measurement suggests values of blocks, to start an estimate from."""

    def starts(
        self, ids: Indices, z: Array, known: Mapping[str, Array]
    ) -> Iterator[dict[str, Array]]:
        """Hypotheses from observations ids (k,) and z (k, nz), each as values by block name.

        Values, and those in `known` of the other blocks: (3, 3) or (dim,), SI, in the block's
        frame.
        """


@runtime_checkable
class NamesResiduals(Protocol):
    """A sensor whose residual rows are not its columns: their names, with units, so that a table
    can state their noise (`relnav_graph.io.noise_columns`)."""

    residual_columns: tuple[str, ...]


@runtime_checkable
class ReadsTime(Protocol):
    """A sensor whose kernel may have to know the time: `Sensor.observation_data` of a measurement
    is then that of the sensor `at` its time, and cannot be had for all measurements at once."""

    @property
    def reads_time(self) -> bool: ...

    def at(self, t: float) -> Sensor:
        """See `Sensor.at`."""


@runtime_checkable
class Mountable(Protocol):
    """A sensor whose mounting may stand in the state."""

    def freed(self) -> Sensor:
        """The same sensor with its mounting in the state, in static blocks that it reads last."""

    def mounting_fields(self, values: Mapping[str, Array]) -> dict[str, Array]:
        """Its fields that say how it is mounted, by name, with what they are when the blocks of its
        mounting have these values, by name, (3, 3) or (3,), SI; those that are not there: zero."""


@runtime_checkable
class CopiesBlocks(Protocol):
    """A sensor that measures nothing: at one epoch, its keyframe, s, it ties static blocks to the
    present values of others. It reads the copies, then what they copy, in the same order; z is
    zero."""

    rows: ClassVar[int]
    keyframe: float
    copies: Mapping[str, Block]
    """By the name of the copy, what it copies."""


@runtime_checkable
class ReadsCopies(Protocol):
    """A sensor that compares an epoch with an earlier one, in copies that `copier` makes there.

    keyframe: time of the earlier one, s; None: what it reads of it is no copy.
    """

    keyframe: float | None

    def copier(self) -> Sensor:
        """The sensor that ties the copies to what they copy: a `CopiesBlocks`."""


@runtime_checkable
class ReadsNumbered(Protocol):
    """A sensor of which each observation may read a static block of its own, too: the one with the
    observation's id, such as a point of a map.

    Its kernel has that block last in x and H. Where the sensor is given x, one value per block of
    `reads`, it gets one argument more: the values (k, dim), one for each id; where it returns
    Jacobians, one more (k * rows, dim), of each row to its own.
    """

    sees_depth: bool
    """Whether one sight tells where a block is; else only on which line."""

    @property
    def numbered(self) -> Block | None:
        """The block without its number, a vector; None where the sensor reads none."""

    def sights(self, ids: Indices, z: Array, *x: Array) -> tuple[Array, Array]:
        """Where observations ids (k,), z (k, nz) see their blocks, from the state x of `reads`
        alone: origins (k, 3) and lines (k, 3) in the frame of the block, m. A block is at origin +
        line where the sensor sees depth, else somewhere along the line, which has length one. NaN
        where an observation tells nothing."""


@runtime_checkable
class Mappable(Protocol):
    """A sensor of unknown points that can be given them, for the simulator."""

    def mapped(self, points: Array, normals: Array | None) -> Sensor:
        """The same sensor with points (n, 3) in t, m, by id, that are known; normals (n, 3):
        outward, None where points are seen from all sides."""


@runtime_checkable
class ScattersRaw(Protocol):
    """A sensor whose residual is computed of raw values that have the noise, such as points of
    which a frame is made: its `noise` follows from theirs."""

    def scattered(self, z: Array, unit: Array) -> Array:
        """z (k, nz) with unit noise (k, nz), without unit, put on its raw values, for the
        simulator."""


@runtime_checkable
class NamesDirections(Protocol):
    """A model that can name directions of the state in which its information is weak."""

    def directions(self, *x: Array) -> Mapping[str, tuple[Array, ...]]:
        """By name, for each block that the model reads, tangents (dim, k) of k directions.

        x: one value per block, (3, 3) or (dim,), SI, in the block's frame.
        """


@runtime_checkable
class Drifts(Protocol):
    """A model of which a bias may be two blocks, a constant and what drifts about it
    (`relnav_graph.core.catalogue.DRIFTS`)."""

    def without_drift(self) -> Any:
        """The model for which there is no such drift; None where nothing is left of it."""


@runtime_checkable
class Wanders(Protocol):
    """A process that nothing else drives, so that a truth without it can be completed: a bias."""

    def wandering(self, times: Array, rng: np.random.Generator) -> dict[str, Array]:
        """True values (N, dim) of what it advances, at `times` (N,), s, by name, SI: drawn as it
        goes on, not as it begins."""


@runtime_checkable
class BringsTruth(Protocol):
    """A sensor that brings the truth of what it alone knows of, such as how far its clock is off:
    blocks that it reads, and that a simulated truth may lack."""

    def own_truth(self, times: Array, rng: np.random.Generator) -> Mapping[str, Array]:
        """True values (N, dim), (N, 3, 3) or, of what is constant, (dim,) or (3, 3), at `times`
        (N,), s, by name of the block, SI."""


@runtime_checkable
class KnowsOrbit(Protocol):
    """A model to which it matters how frame o turns: with the target's orbit, which is known, or
    `estimated` and read from the state; None for an o at rest."""

    @property
    def orbit(self) -> KeplerOrbit | None: ...


@runtime_checkable
class KnowsInertialOrbit(Protocol):
    """A model that knows the orbit of the target in a frame o that is at rest."""

    @property
    def inertial_orbit(self) -> KeplerOrbit: ...


@runtime_checkable
class IntegratesBySteps(Protocol):
    """A process or truth that cuts an interval into steps of at most max_step, s."""

    max_step: float


@runtime_checkable
class KnowsTorque(Protocol):
    """A process of a body of known inertia, (3, 3) in t, kg m^2, under a known torque."""

    known_inertia: Array

    def torque(self, t: float, R_it: Array) -> Array:
        """The torque (3,) in t, N m, at time t, s, and attitude R_it (3, 3)."""
