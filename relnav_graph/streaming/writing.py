"""What is written as lines: recordings, and the estimates of a stream.

The format is described in `relnav_graph.streaming.lines`.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import Derived
from relnav_graph.core.measurement import SAME_TIME, Measurement
from relnav_graph.core.numbered import members
from relnav_graph.core.problem import Prior
from relnav_graph.core.state import Block, Layout
from relnav_graph.core.track import Recording
from relnav_graph.io.tabular import to_components
from relnav_graph.streaming.lines import FORMAT, VERSION, InputSample

__all__ = ["dump", "estimate_object", "input_object", "measurement_object", "recording_lines"]


def dump(value: Mapping[str, Any]) -> str:
    """One line of strict JSON, without its end; the shortest digits that read back the same."""
    return json.dumps(value, allow_nan=False, separators=(", ", ": "))


def _components(block: Block, value: Array) -> list[float]:
    out: list[float] = to_components(block, value[None])[0].tolist()
    return out


def _sigmas(P: Array) -> list[float | None]:
    """Null where there is none, as of the axes of two equal moments."""
    return [value if np.isfinite(value) else None for value in np.sqrt(np.diag(P)).tolist()]


def estimate_object(
    layout: Layout, derived: Iterable[Derived], x: Array, P: Array
) -> dict[str, dict[str, list[Any]]]:
    """`estimate` of an output line: blocks, and quantities derived from them, with sigmas.

    x (size,): stored vector; P (n, n): its covariance; SI. Attitudes come as quaternions, w first.
    A family of numbered blocks is one entry, with lists of `id`, value and sigma.
    """
    found: dict[str, dict[str, list[Any]]] = {}
    values = layout.values(x)
    for family, blocks in members(layout).items():
        sigmas = [_sigmas(P[rows, rows]) for rows in (layout.tangent(b.name) for b in blocks)]
        found[family] = {
            "id": [b.number for b in blocks],
            "value": [_components(b, values[b.name]) for b in blocks],
            "sigma": sigmas,
        }
    for block in layout:
        if block.number is not None:
            continue
        rows = layout.tangent(block.name)
        value = _components(block, values[block.name])
        found[block.name] = {"value": value, "sigma": _sigmas(P[rows, rows])}
    for quantity in derived:
        derived_value, J = quantity.value(*(values[b.name] for b in quantity.reads))
        _, tangent = layout.gather(quantity.reads)
        found[quantity.block.name] = {
            "value": _components(quantity.block, derived_value),
            "sigma": _sigmas(J @ P[np.ix_(tangent, tangent)] @ J.T),
        }
    return found


def measurement_object(m: Measurement) -> dict[str, Any]:
    """A measurement as a line in."""
    line = {"sensor": m.sensor, "t": float(m.t), "id": m.ids.tolist(), "z": m.z.tolist()}
    if m.t_arrival is not None:
        line["t_arrival"] = float(m.t_arrival)
    return line if m.covariance is None else {**line, "covariance": m.covariance.tolist()}


def input_object(sample: InputSample) -> dict[str, Any]:
    """A sample of an input as a line in."""
    line = {
        "input": sample.name,
        "t_start": sample.t_start,
        "t_end": sample.t_end,
        "values": sample.values.tolist(),
    }
    return line if sample.t_arrival is None else {**line, "t_arrival": sample.t_arrival}


def recording_lines(
    recording: Recording, name: str, seed: int, layout: Layout, prior: Prior
) -> Iterator[str]:
    """A recording as the lines of a stream, in order of arrival, numbered.

    prior: its mean goes into the header, as the estimators of a comparison get it; one of numbered
    blocks is that of the scenario.
    """
    own = [b for b in layout if b.number is None]
    mean = {b.name: _components(b, layout.value(prior.x, b.name)) for b in own}
    lines: list[tuple[float, int, dict[str, Any]]] = []
    for key, series in recording.inputs.items():
        edges = zip(series.t_start.tolist(), series.t_end.tolist(), strict=True)
        for (t_start, t_end), values in zip(edges, series.values, strict=True):
            lines.append((t_end, 0, input_object(InputSample(key, t_start, t_end, values))))
    for m in recording.measurements:
        arrival = m.t if m.t_arrival is None else m.t_arrival
        lines.append((float(arrival), 1, measurement_object(m)))
    measured = np.array(sorted([*(m.t for m in recording.measurements), np.inf]))
    nearest = measured[np.searchsorted(measured, recording.times - SAME_TIME)]
    silent = recording.times[nearest > recording.times + SAME_TIME]
    lines += [(t, 1, {"epoch": t}) for t in silent.tolist()]
    header = {"format": FORMAT, "version": VERSION, "scenario": name, "seed": seed}
    settings = {"settings": dict(recording.settings)} if recording.settings else {}
    yield dump({**header, "t": float(recording.times[0]), "prior": mean, **settings, "n": 0})
    lines.sort(key=lambda entry: entry[:2])
    for n, (_, _, line) in enumerate(lines, 1):
        yield dump({**line, "n": n})
