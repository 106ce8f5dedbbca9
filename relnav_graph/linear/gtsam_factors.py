"""Any of our models as a `gtsam.CustomFactor` in anybody's own factor graph.

The only module that builds a `CustomFactor`. Keys map to blocks in the order in which a
model names them: an attitude block is a `gtsam.Rot3`, any other a vector. The residual is
whitened inside, so the factor's noise model is a unit one. Every Jacobian comes out of a
buffer of the right size and is checked to be filled. A kernel that writes past its buffer is
found out before GTSAM sees the factor, since GTSAM answers a wrong shape with a segmentation
fault.

Inside `ISAM2` keep a reference to ``isam.getLinearizationPoint()`` while updating: without
it, GTSAM copies all its values for each call of each factor.
"""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import Dynamics, Sensor
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.state import Block, Layout
from relnav_graph.errors import GeometryError, InputError
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.intervals import process_rows

__all__ = ["insert_block", "measurement_factor", "process_factor", "read_block"]


def insert_block(values: gtsam.Values, key: int, block: Block, value: Array) -> None:
    """Insert the value of a block under a key, as the factors expect it.

    value: (3, 3) for an attitude, (dim,) otherwise; SI. Raises InputError when the value has
    another shape, is not finite, or is no rotation.
    """
    stored = block.pack(value)
    values.insert(key, gtsam.Rot3(block.unpack(stored)) if block.manifold == "SO3" else stored)


def read_block(values: gtsam.Values, key: int, block: Block) -> Array:
    """The value of a block under a key: (3, 3) for an attitude, (dim,) otherwise; SI."""
    if block.manifold == "SO3":
        return values.atRot3(key).matrix()
    return values.atVector(key)


class _Reader:
    """Reads blocks from GTSAM's values into one stored vector x (1, size)."""

    def __init__(self, layout: Layout) -> None:
        self.x = layout.identity[None].copy()
        parts = [(b.manifold == "SO3", self.x[0, layout.stored(b.name)]) for b in layout]
        self._places = [(so3, part.reshape(3, 3) if so3 else part) for so3, part in parts]

    def read(self, values: gtsam.Values, keys: Sequence[int]) -> Array:
        for key, (so3, place) in zip(keys, self._places, strict=True):
            place[...] = values.atRot3(key).matrix() if so3 else values.atVector(key)
        return self.x


def _check_keys(kind: str, keys: Sequence[int], blocks: Sequence[Block]) -> None:
    whole = all(isinstance(k, (int, np.integer)) and k >= 0 for k in keys)
    if not whole or len(keys) != len(blocks) or len(set(keys)) != len(keys):
        names = [b.name for b in blocks]
        raise InputError(f"{kind}: found keys {list(keys)}, expected a different one for {names}")


def measurement_factor(sensor: Sensor, m: Measurement, keys: Sequence[int]) -> gtsam.CustomFactor:
    """The factor of one measurement: whitened residuals (count * rows,) of its observations.

    keys: of the blocks that the sensor reads, in their order.
    Evaluating it raises GeometryError when an observation is impossible at the values,
    and ModelError when the model breaks its contract. Raises InputError on wrong keys.
    """
    layout = Layout(sensor.reads)
    _check_keys(sensor.kind, keys, layout.blocks)
    assembly = Assembly(layout, {}, {m.sensor: sensor}, [Epoch(m.t, (m,))])
    weight = np.ones(assembly.observations)
    columns = [layout.tangent(b.name) for b in layout]
    reader = _Reader(layout)

    def error(
        factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None
    ) -> Array:
        rows = assembly.measure(reader.read(values, factor.keys()), weight)
        if np.count_nonzero(rows.status):
            bad = np.nonzero(rows.status)[0][0]
            raise GeometryError(
                f"{sensor.kind}: id {m.ids[bad]} at t = {m.t} s:"
                f" {sensor.failure(int(rows.status[bad]))}"
            )
        if jacobians is not None:
            for i, part in enumerate(columns):
                jacobians[i] = rows.H[:, part]
        return rows.r

    count = int(assembly.row_offsets[-1])
    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(count), list(keys), error)


def process_factor(
    process: Dynamics,
    t: float,
    u: Array,
    keys: Sequence[int],
    keys_next: Sequence[int],
    noise_at: Sequence[Array],
) -> gtsam.CustomFactor:
    """The factor of one interval, ``local(propagate(x_k), x_k+1)``.

    t: start of the interval, s; u (rows, 1 + channels): its inputs, see
    `relnav_graph.core.models`; keys: of the blocks advanced and read, at the start; keys_next:
    of the advanced blocks, at the end; noise_at: values of the blocks of `keys`, (3, 3) or
    (dim,), at which the process noise is evaluated, once. Raises InputError on wrong keys or
    a noise covariance that is not positive definite.
    """
    blocks = process.advances + process.reads
    layout, advanced = Layout(blocks), Layout(process.advances)
    _check_keys(process.kind, [*keys, *keys_next], [*blocks, *process.advances])
    t_end = float(t + np.sum(np.asarray(u)[:, 0]))
    epoch = Epoch(t_end, (), {"process": np.ascontiguousarray(u, dtype=np.float64)})
    assembly = Assembly(layout, {"process": process}, {}, [epoch], t_before=float(t))
    n, size = advanced.dim, advanced.size
    start = layout.pack(dict(zip([b.name for b in blocks], noise_at, strict=True)))
    whiten = assembly.whitening(start[None])[:, :n, :n].copy()
    columns = [layout.tangent(b.name) for b in layout]
    columns_next = [advanced.tangent(b.name) for b in advanced]
    reader, reader_next = _Reader(layout), _Reader(advanced)

    def error(
        factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None
    ) -> Array:
        at = factor.keys()
        x_next, F, _ = assembly.transition(reader.read(values, at[: len(columns)]))
        x1 = reader_next.read(values, at[len(columns) :])
        rows = process_rows(advanced, x_next[:, :size], x1, F[:, :n], whiten)
        if jacobians is not None:
            for i, part in enumerate(columns):
                jacobians[i] = rows.A[0][:, part]
            for i, part in enumerate(columns_next, len(columns)):
                jacobians[i] = rows.B[0][:, part]
        residual: Array = rows.e[0]
        return residual

    unit = gtsam.noiseModel.Unit.Create(n)
    return gtsam.CustomFactor(unit, [*keys, *keys_next], error)
