"""Sensors for prototypes: h(x) in plain Python, the Jacobian by differences."""

from __future__ import annotations

import ctypes
from _thread import interrupt_main
from collections.abc import Mapping
from functools import cached_property
from itertools import count
from typing import Any, ClassVar
from weakref import WeakValueDictionary

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.compiled import jit
from relnav_graph.compiled.callbacks import call_python
from relnav_graph.compiled.contracts import DEGENERATE
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.models import SensorModel
from relnav_graph.core.state import Block, Layout
from relnav_graph.errors import GeometryError, InputError
from relnav_graph.maths.manifold import retract

__all__ = ["NumericalSensor"]

#: What h may end with: an observation that is impossible, and anything else.
IMPOSSIBLE, RAISED = 1, DEGENERATE
#: Of central differences, relative to the size of a block: the cube root of the rounding error.
STEP = np.finfo(np.float64).eps ** (1 / 3)

#: The sensors that compiled code may ask for, by number. Weakly: one that is gone raises nothing.
_SENSORS: WeakValueDictionary[int, NumericalSensor] = WeakValueDictionary()
_NUMBERS = count(1)


@ctypes.CFUNCTYPE(*[ctypes.c_int64] * 5)  # type: ignore[untyped-decorator]
def _evaluate(number: int, out: int, x: int, q: int) -> int:
    """h of the sensor of a number at stored values x; addresses of arrays. The status."""
    sensor = _SENSORS.get(number)
    return RAISED if sensor is None else sensor._fill(out, x, q)


#: Where that is: one address for all sensors, as long as the process lives.
_ADDRESS = ctypes.cast(_evaluate, ctypes.c_void_p).value or 0


@jit
def numerical_kernel(p: Array, q: Array, z: Array, x: Array, r: Array, H: Array) -> int:
    """r (rows,) = h(x) - z and H (rows, dims) by central differences on the manifold.

    p: number of the sensor, address of `_evaluate`, number of blocks, then rows (is_SO3, stored
    offset, tangent offset, dim, step) of each; q: data of the observation; x: stored values.
    """
    number, address, blocks = int(p[0]), int(p[1]), int(p[2])
    kinds = np.empty((blocks, 4), np.int64)
    for k in range(blocks):
        for i in range(4):
            kinds[k, i] = int(p[3 + 5 * k + i])
    status = call_python(address, number, r.ctypes.data, x.ctypes.data, q.ctypes.data)
    if status != 0:
        return int(status)
    ahead, behind, d = np.empty(r.shape[0]), np.empty(r.shape[0]), np.zeros(H.shape[1])
    for k in range(blocks):
        size = 1.0
        for i in range(kinds[k, 3] if kinds[k, 0] == 0 else 0):
            size = max(size, abs(x[kinds[k, 1] + i]))
        h = p[3 + 5 * k + 4] * size
        for j in range(kinds[k, 2], kinds[k, 2] + kinds[k, 3]):
            d[j] = h
            for side in (1, -1):
                d[j] = side * h
                moved, out = retract(x, d, kinds), ahead if side > 0 else behind
                status = call_python(
                    address, number, out.ctypes.data, moved.ctypes.data, q.ctypes.data
                )
                if status != 0:
                    return int(status)
            d[j] = 0.0
            for i in range(r.shape[0]):
                H[i, j] = (ahead[i] - behind[i]) / (2.0 * h)
    for i in range(r.shape[0]):
        r[i] -= z[i]
    return 0


def _array(address: int, size: int) -> Array:
    """The numbers (size,) at an address, where they are."""
    return np.frombuffer(memoryview((ctypes.c_double * size).from_address(address)), np.float64)


class NumericalSensor(SensorModel):
    """Base of a sensor of which only h(x) is written, in plain Python: for prototypes.

    ::

        @dataclass(frozen=True)
        class Bearing(NumericalSensor):
            kind: ClassVar[str] = "bearing"
            columns: ClassVar[tuple[str, ...]] = ("azimuth_rad", "elevation_rad")
            blocks: ClassVar[tuple[Block, ...]] = (CHASER_ATTITUDE, RELATIVE_POSITION)
            sigma: Annotated[float, Quantity("rad", positive=True)]

            def h(self, R_oc, r_tc_o):
                x, y, z = -R_oc.T @ r_tc_o
                return np.arctan2(y, x), np.arcsin(z / np.sqrt(x * x + y * y + z * z))

    h takes a value of each of `blocks`, (3, 3) or (dim,), SI, and gives one number for each of
    `columns`. It raises GeometryError where it sees nothing. A sensor that overrides
    `observation_data` gets the data (nq,) of the observation first: h(self, q, *x). `sigma`, a
    number or one for each column, is its noise, unless `noise` is overridden. Residuals are
    h(x) - z: an angle that may wrap round needs a sensor with a kernel of its own.

    It runs in the simulator, the filters and the smoothers like any other, with one compiled kernel
    for all. The Jacobian is that of central differences, right perturbation, of 1e-10 to 1e-8 of an
    entry where h is smooth over `step` (by default 6e-6 of the size of the block, or 6e-6 below
    one). The cost: 1 + 2 dims calls of h for each observation and linearisation, each of them 5 to
    10 us and what h takes; of a pose that is some 0.1 ms, where a written kernel takes 1 us. h is
    called while Python's lock is held; what it raises ends the estimate, with its words.
    """

    kernel = staticmethod(numerical_kernel)
    blocks: ClassVar[tuple[Block, ...]]
    #: Steps of the differences by name of a block, relative where the block is larger than one.
    steps: ClassVar[Mapping[str, float]] = {}

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "columns" in vars(cls):
            cls.rows = len(cls.columns)

    @property
    def reads(self) -> tuple[Block, ...]:
        return self.blocks

    def h(self, *x: Any) -> Any:
        """One number for each of `columns`, of a value per block, (3, 3) or (dim,), SI."""
        raise NotImplementedError

    def noise(self, m: Measurement) -> Array:
        """R (k, rows, rows) of `sigma`."""
        sigma = np.broadcast_to(getattr(self, "sigma"), (self.rows,))  # noqa: B009
        return np.tile(np.diag(sigma**2), (len(m.z), 1, 1))

    def constants(self) -> Array:
        layout = Layout(self.blocks)
        steps = [[self.steps.get(b.name, STEP)] for b in layout]
        rows = np.hstack([layout.kinds.astype(np.float64), steps])
        return np.concatenate([[self._number, _ADDRESS, len(rows)], rows.ravel()])

    def failure(self, status: int) -> str:
        """What h raised."""
        return self.__dict__.get("_said", "") or super().failure(status)

    @cached_property
    def _form(self) -> tuple[Layout, int]:
        """The blocks, and how many numbers belong to each observation."""
        return Layout(self.blocks), self.observation_data(np.zeros(0, np.int64)).shape[1]

    @property
    def _number(self) -> int:
        """Under which compiled code asks for this one in this process."""
        number: int = self.__dict__.get("_own_number", 0)
        if _SENSORS.get(number) is not self:
            number = next(_NUMBERS)
            object.__setattr__(self, "_own_number", number)
            _SENSORS[number] = self
        return number

    def _fill(self, out: int, x: int, q: int) -> int:
        """h at x, put where the kernel wants it; the status."""
        try:
            layout, width = self._form
            values = list(layout.values(_array(x, layout.size)).values())
            found = self.h(*([_array(q, width)] if width else []), *values)
            filled = np.asarray(found, dtype=np.float64).reshape(-1)
            if filled.shape != (self.rows,):
                raise InputError(f"found {filled.shape}, expected {self.rows}: {self.columns}")
            _array(out, self.rows)[:] = filled
        except GeometryError as error:
            object.__setattr__(self, "_said", str(error))
            return IMPOSSIBLE
        except KeyboardInterrupt:  # for Python, once the compiled loop is left
            interrupt_main()
            return RAISED
        except BaseException as error:  # ctypes would print and swallow it
            object.__setattr__(self, "_said", f"h raised {type(error).__name__}: {error}")
            return RAISED
        return 0
