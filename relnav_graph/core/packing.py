"""Epochs changed by late or repeated measurements, and epochs as plain arrays for saving."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import Dynamics
from relnav_graph.core.epochs import Epoch, stamped
from relnav_graph.core.manoeuvres import THRUST_COLUMNS
from relnav_graph.core.measurement import SAME_TIME, Measurement
from relnav_graph.errors import InputError

__all__ = [
    "held",
    "merged",
    "pack",
    "packed_time",
    "time_in",
    "under",
    "unpack",
    "without_repeats",
]

#: What was left out: sensor, time, ids.
Repeats = list[tuple[str, float, tuple[int, ...]]]


def without_repeats(epoch: Epoch) -> tuple[Epoch, Repeats]:
    """The epoch without observations that repeat an earlier one of it: the same sensor, id
    and value; and which those are."""
    seen: set[tuple[str, int, bytes]] = set()
    kept, repeats = list[Measurement](), Repeats()
    for m in epoch.measurements:
        names = [(m.sensor, int(i), z.tobytes()) for i, z in zip(m.ids, m.z, strict=True)]
        fresh = np.array([name not in seen for name in names], dtype=bool)
        first = np.array([names.index(name) == k for k, name in enumerate(names)], dtype=bool)
        fresh &= first
        seen.update(names)
        if not fresh.all():
            repeats.append((m.sensor, m.t, tuple(int(i) for i in m.ids[~fresh])))
        if fresh.all() or fresh.any():
            kept.append(m if fresh.all() else m.only(fresh))
    return (replace(epoch, measurements=tuple(kept)) if repeats else epoch), repeats


def _channels(process: Dynamics) -> int:
    return sum(len(columns) for columns in process.inputs.values())


def split(u: Array, length: float, channels: int) -> tuple[Array, Array]:
    """An interval's inputs u (rows, 1 + channels) cut in two after `length` s.

    Both parts have the same columns: length of the sub-interval, s, then the inputs, SI. The
    spreads of a row that is cut grow, so that its halves add up to the variance of the whole.
    """
    ends = np.cumsum(u[:, 0])
    starts = ends - u[:, 0]
    closer = min(SAME_TIME, 0.25 * length, 0.25 * (ends[-1] - length))
    before, after = u[starts < length - closer].copy(), u[ends > length + closer].copy()
    before[-1, 0] = length - starts[len(before) - 1]
    after[0, 0] = ends[len(u) - len(after)] - length
    if len(before) + len(after) > len(u):
        a, b = before[-1, 0], after[0, 0]
        before[-1, channels + 1 :] *= (a + b) / np.hypot(a, b)
        after[0, channels + 1 :] *= (a + b) / np.hypot(a, b)
    return before, after


def merged(
    epochs: Sequence[Epoch],
    m: Measurement,
    processes: Mapping[str, Dynamics],
    merge: float = SAME_TIME,
) -> list[Epoch]:
    """Epochs in order with one more measurement, not after the last of them: it joins the
    epoch of its time, within `merge`, s, or makes one and cuts the interval there."""
    out = list(epochs)
    k = next(i for i, e in enumerate(out) if e.t >= m.t - merge)
    if out[k].t <= m.t + merge:
        out[k] = replace(out[k], measurements=(*out[k].measurements, stamped(m, out[k].t)))
        return out
    halves = {}
    for name, u in out[k].inputs.items():
        length = float(u[:, 0].sum()) - (out[k].t - m.t)
        halves[name] = split(u, length, _channels(processes[name]))
    out[k : k + 1] = [
        Epoch(m.t, (m,), {name: a for name, (a, _) in halves.items()}),
        replace(out[k], inputs={name: b for name, (_, b) in halves.items()}),
    ]
    return out


def held(
    last: Mapping[str, Array], processes: Mapping[str, Dynamics], length: float
) -> dict[str, Array]:
    """Inputs over `length` s for every process, with the last known values held.

    last: by process, u (rows, 1 + channels), of which the last row counts. Result: by process,
    u (1, 1 + channels): the length in s, then the inputs, SI. Raises InputError when a process
    has inputs and none was seen yet.
    """
    out = {}
    for name, process in processes.items():
        channels = _channels(process)
        if name in last:
            out[name] = np.array([[length, *last[name][-1, 1 : 1 + channels]]])
            coasting = [c in THRUST_COLUMNS for cs in process.inputs.values() for c in cs]
            out[name][0, 1:][coasting] = 0.0  # a manoeuvre ends when its table says so
        elif channels:
            raise InputError(f"process {name!r} ({process.kind}): no input was seen yet to hold")
        else:
            out[name] = np.array([[length]])
    return out


def pack(epochs: Sequence[Epoch]) -> dict[str, Array]:
    """Epochs as plain arrays, by name; `unpack` gives the same again.

    times (N,), s; of measurement j of epoch k: ``k.z.j.sensor`` (m, nz), ``k.ids.j.sensor``
    (m,) and ``k.stamps.j.sensor`` (2,): time and arrival, s, NaN where not known, and, where it has
    its own, ``k.cov.j.sensor`` (m, rows, rows), SI; of its inputs: ``k.u.process`` (rows, 1 +
    channels).
    """
    out = {"times": np.array([e.t for e in epochs])}
    for k, epoch in enumerate(epochs):
        for j, m in enumerate(epoch.measurements):
            name = f"{k}.z.{j}.{m.sensor}"
            arrival = np.nan if m.t_arrival is None else m.t_arrival
            out[name] = m.z
            out[f"{k}.ids.{j}.{m.sensor}"] = m.ids.astype(np.float64)
            out[f"{k}.stamps.{j}.{m.sensor}"] = np.array([m.t, arrival])
            if m.covariance is not None:
                out[f"{k}.cov.{j}.{m.sensor}"] = m.covariance
        for process, u in epoch.inputs.items():
            out[f"{k}.u.{process}"] = np.asarray(u, dtype=np.float64)
    return out


def packed_time(t: float | None) -> Array:
    """The time of the newest epoch, s, as an array (): NaN for None, before the first one."""
    return np.array(np.nan if t is None else t)


def time_in(array: Array) -> float | None:
    """The time that `packed_time` made an array () of, s."""
    return None if np.isnan(array) else float(array)


def under(arrays: Mapping[str, Array], prefix: str) -> dict[str, Array]:
    """The arrays whose names begin with `prefix`, by the rest of the name; of any shape."""
    return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}


def unpack(arrays: Mapping[str, Array]) -> list[Epoch]:
    """The epochs that `pack` made `arrays` of: times (N,), z (m, nz) and so on."""
    measurements: dict[int, dict[int, Measurement]] = {}
    inputs: dict[int, dict[str, Array]] = {}
    for key, value in arrays.items():
        parts = key.split(".", 3)
        if len(parts) > 2 and parts[1] == "z":
            rest = f"{parts[2]}.{parts[3]}"
            t, arrival = arrays[f"{parts[0]}.stamps.{rest}"]
            ids = arrays[f"{parts[0]}.ids.{rest}"].astype(np.int64)
            known = None if np.isnan(arrival) else float(arrival)
            P = arrays.get(f"{parts[0]}.cov.{rest}")
            m = Measurement(parts[3], float(t), value, ids, known, covariance=P)
            measurements.setdefault(int(parts[0]), {})[int(parts[2])] = m
        elif len(parts) > 2 and parts[1] == "u":
            name = key.split(".", 2)[2]
            inputs.setdefault(int(parts[0]), {})[name] = value
    epochs = []
    for k, t in enumerate(arrays["times"]):
        own = measurements.get(k, {})
        epochs.append(Epoch(float(t), tuple(own[j] for j in sorted(own)), inputs.get(k, {})))
    return epochs
