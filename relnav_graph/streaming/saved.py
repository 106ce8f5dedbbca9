"""A session as bytes, for snapshots: its own state as JSON, with the estimator's arrays.

The functions whose names end in ``_in`` read back what the others wrote.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.measurement import Measurement
from relnav_graph.streaming.buffers import WaitingEpoch
from relnav_graph.streaming.lines import Header, InputSample
from relnav_graph.streaming.writing import input_object, measurement_object

__all__ = [
    "header_in",
    "header_object",
    "pack",
    "samples",
    "samples_in",
    "unpack",
    "waiting",
    "waiting_in",
]

_OWN = "session"


def pack(own: Mapping[str, Any], arrays: Mapping[str, Array]) -> bytes:
    """JSON and named arrays, each of any shape (n, ...), as bytes; the same for the same state."""
    stream = io.BytesIO()
    text = np.frombuffer(json.dumps(own).encode(), dtype=np.uint8)
    everything: dict[str, Any] = {_OWN: text, **arrays}
    np.savez(stream, **everything)
    return stream.getvalue()


def unpack(data: bytes) -> tuple[dict[str, Any], dict[str, Array]]:
    """The JSON object and the named arrays, each of any shape (n, ...), given to `pack`."""
    with np.load(io.BytesIO(data), allow_pickle=False) as found:
        arrays = {name: found[name] for name in found}
    return json.loads(arrays.pop(_OWN).tobytes()), arrays


def header_object(header: Header) -> dict[str, Any]:
    """A header as plain values."""
    return {**vars(header), "prior": dict(header.prior), "settings": dict(header.settings)}


def header_in(data: bytes) -> Header:
    """The header of the session that gave `data`."""
    return Header(**unpack(data)[0]["header"])


def samples(inputs: Sequence[InputSample]) -> list[dict[str, Any]]:
    """Samples of inputs as plain values."""
    return [input_object(sample) for sample in inputs]


def samples_in(found: Sequence[Mapping[str, Any]]) -> list[InputSample]:
    """The samples of inputs that `samples` made plain values of."""
    return [
        InputSample(
            *(s["input"], s["t_start"], s["t_end"], np.array(s["values"])), s.get("t_arrival")
        )
        for s in found
    ]


def waiting(epochs: Sequence[WaitingEpoch]) -> list[Any]:
    """Epochs that wait as plain values."""
    return [(e.t, e.arrival, [measurement_object(m) for m in e.measurements]) for e in epochs]


def waiting_in(found: Sequence[Any]) -> list[WaitingEpoch]:
    """The waiting epochs that `waiting` made plain values of."""
    return [WaitingEpoch(t, arrival, [_measurement(m) for m in ms]) for t, arrival, ms in found]


def _measurement(line: Mapping[str, Any]) -> Measurement:
    z, ids = np.array(line["z"]), np.array(line["id"], dtype=np.int64)
    R = None if line.get("covariance") is None else np.array(line["covariance"])
    return Measurement(line["sensor"], line["t"], z, ids, line.get("t_arrival"), covariance=R)
