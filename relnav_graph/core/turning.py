"""Whether measured attitudes turn as a gyro does.

In another order of its components, or reversed, a quaternion has the length one, too, and no check
of it alone tells.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.cautions import Caution
from relnav_graph.core.contracts import Dynamics, ProposesStarts, Sensor
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.measurement import QUATERNION, Measurement
from relnav_graph.core.state import Block
from relnav_graph.errors import RelnavError
from relnav_graph.maths import so3

__all__ = ["TURNING", "turning_cautions"]

#: Name of the caution.
TURNING = "attitude turns otherwise"
#: What measured quaternions may be instead of what they are read as: where w, x, y, z then stand,
#: and the sign of x, y, z.
READINGS: Mapping[str, tuple[tuple[int, ...], float]] = {
    "as they are": ((0, 1, 2, 3), 1.0),
    "as conjugate quaternions": ((0, 1, 2, 3), -1.0),
    "as quaternions with the scalar last": ((3, 0, 1, 2), 1.0),
    "as conjugate quaternions with the scalar last": ((3, 0, 1, 2), -1.0),
}
#: An increment is taken where the gyro has turned by so much, rad: far more than what attitudes
#: that tell anything miss, and than what a gyro drifts by meanwhile.
TURN = 0.1
#: Fewer increments tell too little; more are not needed, nor more epochs looked at for them.
LEAST, MOST, LOOKED = 4, 100, 2000
#: So many times better another reading must fit, and so many times smaller than the turn its misses
#: must be, before the one that is declared is doubted.
BETTER = 5.0


def turning_cautions(
    processes: Mapping[str, Dynamics],
    sensors: Mapping[str, Sensor],
    epochs: Sequence[Epoch],
    known: Mapping[str, Array],
) -> tuple[Caution, ...]:
    """Of sensors whose quaternions, read in another way, turn as a gyro says, and do not as given.

    processes, sensors: by name; known: values of the blocks of the state, (3, 3) or (dim,), SI, for
    what else the models read. The attitude of one measurement is propagated by the process that
    the gyro drives to a later one, and compared.
    """
    found = []
    for process, model in processes.items():
        columns = [c for own in model.inputs.values() for c in own]
        turned = [b for b in model.advances if b.manifold == "SO3"]
        if not turned or not any(c.endswith("_rad_s") for c in columns):
            continue
        for name, sensor in sensors.items():
            block = next((b for b in turned if b in sensor.reads), None)
            if block is None or not set(QUATERNION) <= set(sensor.columns):
                continue
            if isinstance(sensor, ProposesStarts):
                missed = _missed(epochs, process, model, name, sensor, block, known)
                found += _caution(name, ", ".join(model.inputs), missed)
    return tuple(found)


def _caution(sensor: str, inputs: str, missed: Array) -> list[Caution]:
    """missed (increments, 1 + readings), rad: the turn, and by how much it is missed."""
    if len(missed) < LEAST:
        return []
    turn, *rms = np.sqrt((missed**2).mean(axis=0)).tolist()
    best = int(np.argmin(rms))
    if rms[best] * BETTER > min(rms[0], turn):
        return []
    return [
        Caution(
            TURNING,
            f"attitudes of {sensor!r} miss what {inputs!r} says of {len(missed)} turns of"
            f" {turn:.2g} rad (rms) by {rms[0]:.2g} rad, and by {rms[best]:.2g} rad read"
            f" {list(READINGS)[best]}: what order and direction have they?",
        )
    ]


def _missed(
    epochs: Sequence[Epoch],
    process: str,
    model: Dynamics,
    name: str,
    sensor: Sensor,
    block: Block,
    known: Mapping[str, Array],
) -> Array:
    """The turns, and in each reading by how much an attitude differs from the propagated one, rad:
    (increments, 1 + readings)."""
    width = 1 + sum(len(columns) for columns in model.inputs.values())
    begun: list[Array] = []  # of each reading the attitude at the last increment, and it propagated
    now: list[Array] = []
    found: list[list[float]] = []
    for k, epoch in enumerate(epochs[:LOOKED]):
        u = epoch.inputs.get(process)
        if now and (u is None or epoch.bridged.keys() & model.inputs.keys()):
            now = []  # nothing is known of that interval
        elif now and u is not None:
            own = np.ascontiguousarray(u[:, :width])
            try:
                now = [_after(model, epochs[k - 1].t, own, block, R, known) for R in now]
            except RelnavError:  # an estimate would say so: this is a doubt, no more
                now = []
        if now and _angle(begun[0], now[0]) < TURN:
            continue
        m = next((m for m in epoch.measurements if m.sensor == name and len(m.ids) == 1), None)
        seen = [] if m is None else _attitudes(sensor, m, block, known)
        if now and seen:
            missed = [_angle(R, S) for R, S in zip(now, seen, strict=True)]
            found.append([_angle(begun[0], now[0]), *missed])
        if seen:
            begun = now = seen
        if len(found) == MOST:
            break
    return np.array(found).reshape(-1, 1 + len(READINGS))


def _attitudes(
    sensor: Sensor, m: Measurement, block: Block, known: Mapping[str, Array]
) -> list[Array]:
    """The block (3, 3) as a measurement has it, in each reading; [] where it tells none."""
    places = [sensor.columns.index(c) for c in QUATERNION]
    others = {n: x for n, x in known.items() if n != block.name}
    now, found = sensor.at(m.t), []
    for order, sign in READINGS.values():
        z = m.z.copy()
        z[:, places] = m.z[:, [places[i] for i in order]] * np.array([1.0, sign, sign, sign])
        try:
            (values,) = now.starts(m.ids, sensor.accept(z), others)  # type: ignore[attr-defined]
        except (RelnavError, ValueError):  # several hypotheses, or none
            return []
        if block.name not in values:
            return []
        found.append(np.ascontiguousarray(values[block.name]))
    return found


def _after(
    model: Dynamics, t: float, u: Array, block: Block, R: Array, known: Mapping[str, Array]
) -> Array:
    """The block (3, 3) after an interval from t, s, that begins with R (3, 3)."""
    values = {**known, block.name: R}
    blocks = [*model.advances, *model.reads]
    after = model.propagate(t, u, *(values[b.name] for b in blocks))
    return after[[b.name for b in model.advances].index(block.name)]


def _angle(R: Array, S: Array) -> float:
    return float(np.linalg.norm(so3.log(np.ascontiguousarray(R.T @ S))))
