"""Tracks and texts for the tests of CCSDS messages."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import (
    CHASER_ATTITUDE,
    CHASER_POSITION,
    CHASER_VELOCITY,
    RELATIVE_POSITION,
    RELATIVE_VELOCITY,
)
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Track
from relnav_graph.io.ccsds.message import unscaled
from relnav_graph.maths import so3
from relnav_graph.maths.frames import from_rtn
from relnav_graph.maths.instants import Instant

#: Eleven seconds that have a leap second in the middle.
EPOCH = "2016-12-31T23:59:55.3 UTC"
RATE = 1.1e-3


def circle(t: Array, phase: float = 0.0) -> Array:
    """States (N, 6), m and m/s, of an inclined circular orbit of 7000 km."""
    a = RATE * t + phase
    x, y = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.6, 0.8])
    r = 7e6 * (np.outer(np.cos(a), x) + np.outer(np.sin(a), y))
    v = 7e6 * RATE * (np.outer(-np.sin(a), x) + np.outer(np.cos(a), y))
    return np.hstack([r, v])


def track(n: int = 12, seed: int = 0, step: float = 1.0) -> Track:
    """A track with the orbits of both craft, an attitude, and covariances between all."""
    rng = np.random.default_rng(seed)
    blocks = [CHASER_POSITION, CHASER_VELOCITY, RELATIVE_POSITION, RELATIVE_VELOCITY]
    layout = Layout([*blocks, CHASER_ATTITUDE])
    t: Array = step * np.arange(n, dtype=np.float64) + 0.1
    R = np.array([so3.exp(phi).reshape(9) for phi in rng.normal(size=(n, 3))])
    x = np.hstack([circle(t), rng.normal(size=(n, 6)) * 100, R])
    A = rng.normal(size=(n, layout.dim, layout.dim))
    return Track("one", "smoothed", layout, t, x, A @ A.transpose(0, 2, 1))


def message(path: Path, kind: str, rows: Sequence[str], version: str = "2.0", **meta: Any) -> Path:
    """A file with one segment. meta: entries in place of the usual ones, None: without it."""
    usual: dict[str, str | None] = {"OBJECT_NAME": "CHASER", "OBJECT_ID": "2000-001A"}
    own = {"OEM": ("CENTER_NAME", "EARTH"), "AEM": ("REF_FRAME_A", "ICRF")}[kind]
    usual |= dict([own])
    usual |= {"REF_FRAME": "ICRF"} if kind == "OEM" else {"REF_FRAME_B": "SC_BODY_1"}
    dated = (row for row in rows if row[4:5] == "-" and row[:4].isdigit())
    words = [row.split()[0] for row in dated] or ["2020-01-01T00:00:00"]
    usual |= {"TIME_SYSTEM": "UTC", "START_TIME": words[0], "STOP_TIME": words[-1]}
    usual |= {"ATTITUDE_TYPE": "QUATERNION"} if kind == "AEM" else {}
    entries = [f"{k} = {v}" for k, v in (usual | meta).items() if v is not None]
    head = [f"CCSDS_{kind}_VERS = {version}", "CREATION_DATE = 2020-01-01T00:00:00"]
    lines = [*head, "ORIGINATOR = US", "META_START", *entries, "META_STOP", "COMMENT one"]
    data = ["DATA_START", *rows, "DATA_STOP"] if kind == "AEM" else list(rows)
    path.write_text("\n".join([*lines, *data]) + "\n")
    return path


def formation(folder: Path, t: Array, own: Array) -> tuple[Path, Path]:
    """Files of a target on `circle` every 60 s and of a chaser at `own` (6,), in its RTN, that
    turns with it."""
    begin = Instant.parse("2020-01-01T00:00:00 TT")
    steps = 60.0 * np.arange(int(t[-1] // 60) + 3, dtype=np.float64) - 60.0
    out = []
    for name, at, state in (
        ("target", steps, circle(steps)),
        ("chaser", t, from_rtn(np.tile(own, (len(t), 1)), circle(t))),
    ):
        lines = [
            " ".join([begin.after(s).calendar("TT"), *(unscaled(x, 3) for x in row.tolist())])
            for s, row in zip(at.tolist(), state, strict=True)
        ]
        out.append(message(folder / f"{name}.oem", "OEM", lines, TIME_SYSTEM="TT"))
    return out[0], out[1]
