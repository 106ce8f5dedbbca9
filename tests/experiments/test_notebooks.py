"""Notebooks run, cell by cell, and what they show is what is stored in them."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import Any

import numpy as np
from passes import EXPERIMENTS

from relnav_graph.core.track import Track


def shown(path: Path) -> tuple[dict[str, Any], list[tuple[Any, dict[str, Any]]]]:
    """The names that a notebook makes; of each cell the value of its last line, and what is stored
    of it. As a kernel does, but for its processes."""
    names: dict[str, Any] = {}
    found = []
    for cell in json.loads(path.read_text("utf-8"))["cells"]:
        if cell["cell_type"] != "code":
            continue
        body, value = ast.parse("".join(cell["source"])), None
        last = body.body.pop() if isinstance(body.body[-1], ast.Expr) else None
        exec(compile(body, str(path), "exec"), names)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), str(path), "eval"), names)
        outputs = cell["outputs"]
        found.append((value, outputs[0]["data"] if outputs else {}))
    return names, found


def test_from_arrays_to_track_figure_and_table() -> None:
    """In fewer than 30 lines of code, without a file."""
    path = EXPERIMENTS / "notebooks" / "arrays.ipynb"
    code = [c for c in json.loads(path.read_text("utf-8"))["cells"] if c["cell_type"] == "code"]
    lines = [line for c in code for line in "".join(c["source"]).splitlines() if line.strip()]
    assert len(lines) < 30
    names, cells = shown(path)
    (_, nothing), (track, text), (figure, picture), (table, numbers) = cells
    assert not nothing
    assert isinstance(track, Track)
    assert track.status == "ok"
    assert repr(track) == "".join(text["text/plain"])
    assert figure._repr_png_()[:4] == b"\x89PNG"
    assert len(figure.axes) == 3
    assert "image/png" in picture
    assert f"<td>{table.iloc[0, 0]}</td>" in "".join(numbers["text/html"])
    error = track.value("gyro_bias")[-1] - names["bias"]
    sigma = np.sqrt(np.diag(track.covariance("gyro_bias")[-1]))
    assert (np.abs(error) < 3 * sigma).all()
    assert (sigma < 4e-4).all()
