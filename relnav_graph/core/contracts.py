"""What a sensor, a process model and a derived quantity provide: structural contracts.

A model is a frozen dataclass in a file of its own. Its formula stands once, in a compiled
kernel (`relnav_graph.compiled.contracts`), and simulator, filter and graph all reach it through
the same object. `relnav_graph.core.models` has mixins that make most of these methods of the
kernel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, ClassVar, Protocol, runtime_checkable

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.state import Block

__all__ = [
    "Derived",
    "Dynamics",
    "KnowsTorque",
    "NamesDirections",
    "ProposesStarts",
    "Sensor",
]

Kernel = Callable[..., Any]


@runtime_checkable
class Sensor(Protocol):
    """A measurement model h. Residuals are prediction minus measured, as in GTSAM."""

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
        """p of the kernel."""

    def observation_data(self, ids: Indices) -> Array:
        """q of the kernel, (k, nq): what belongs to each observation. Raises InputError
        on an id that the sensor does not know."""

    def observables(self) -> Indices:
        """Ids that a simulated sensor looks for."""

    def accept(self, z: Array) -> Array:
        """Measured values z (k, nz) as the kernel wants them. Raises InputError on values
        that this sensor cannot give."""

    def at(self, t: float) -> Sensor:
        """The sensor as it is at time t, s, for the simulator: transmitters may move."""

    def in_view(self, ids: Indices, *x: Array) -> Indices:
        """Those of the ids that are worth a try in simulation."""

    def predict(self, ids: Indices, *x: Array) -> Array:
        """z (k, nz) without noise, from one value per block read. Raises GeometryError."""

    def perturb(self, z: Array, e: Array) -> Array:
        """z (k, nz) moved by residual noise e (k, rows), for the simulator."""

    def noise(self, m: Measurement) -> Array:
        """R (k, rows, rows) of each observation."""

    def failure(self, status: int) -> str:
        """What a non-zero status of the kernel means."""

    def residual(self, m: Measurement, *x: Array) -> tuple[Array, tuple[Array, ...]]:
        """r (k rows,) and its Jacobian to each block (k rows, dim). Raises GeometryError."""


@runtime_checkable
class Dynamics(Protocol):
    """A process model: advances some blocks over an interval, reading maybe others."""

    kind: ClassVar[str]
    #: The inputs (gyro, accelerometer), each a known mean over sub-intervals: the columns
    #: of its table, with units, by name.
    inputs: ClassVar[Mapping[str, tuple[str, ...]]]
    #: For each advanced block, the field whose noise drives it; may be empty.
    noises: ClassVar[tuple[str, ...]]

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
        """p of the kernel."""

    def failure(self, status: int) -> str:
        """What a non-zero status of the kernel means."""

    def condense(self, u: Array) -> Array:
        """The rows of an interval as fewer, where that changes nothing: an epoch keeps them."""

    def propagate(self, t: float, u: Array, *x: Array) -> tuple[Array, ...]:
        """The advanced blocks at the end of the interval."""

    def transition(self, t: float, u: Array, *x: Array) -> tuple[tuple[Array, ...], Array, Array]:
        """The advanced blocks, F (to all blocks, advanced first) and Q."""

    def caution(self, length: float, *x: Array) -> str:
        """What cannot be told apart over an interval of `length` s at this state, or ""."""


@runtime_checkable
class Derived(Protocol):
    """A quantity computed from blocks, with its Jacobian, for tables and covariances."""

    kind: ClassVar[str]
    block: ClassVar[Block]
    reads: ClassVar[tuple[Block, ...]]

    def value(self, *x: Array) -> tuple[Array, Array]:
        """The value, and d(tangent of the value) / d(tangents of the blocks read)."""


# What a model may offer besides. Who needs one of these asks for it by its Protocol.


@runtime_checkable
class ProposesStarts(Protocol):
    """A sensor one look of which suggests values of blocks, to start an estimate from."""

    def starts(
        self, ids: Indices, z: Array, known: Mapping[str, Array]
    ) -> Iterator[dict[str, Array]]:
        """Hypotheses, values by block name, of observations ids (k,) and z (k, nz); known: of
        the other blocks."""


@runtime_checkable
class NamesDirections(Protocol):
    """A model that can name directions of the state in which its information is weak."""

    def directions(self, *x: Array) -> Mapping[str, tuple[Array, ...]]:
        """By name: for each block that the model reads, tangents (dim, k) of k directions."""


@runtime_checkable
class KnowsTorque(Protocol):
    """A process of a body of known inertia, (3, 3) in t, kg m^2, under a known torque."""

    known_inertia: Array

    def torque(self, t: float, R_it: Array) -> Array:
        """The torque (3,) in t, N m, at time t, s, and attitude R_it (3, 3)."""
