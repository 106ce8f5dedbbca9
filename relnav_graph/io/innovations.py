"""Innovations, or standardised residuals, of each sensor as variables of a track's group."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from relnav_graph.core.track import Innovations
from relnav_graph.errors import InputError
from relnav_graph.io.netcdf import Attributes, Group, Variable

__all__ = ["innovation_variables", "stored_innovations"]

_HEAD = "innovations_"
_TIME, _ROWS = "innovation_time_", "innovation_rows_"


def innovation_variables(found: Mapping[str, Innovations]) -> dict[str, Variable]:
    """By sensor: times (m,), how many rows each has (m,), and all rows, epoch after epoch."""
    out = {}
    for name, i in found.items():
        rows: Attributes = {
            "units": "1",
            "long_name": f"whitened residual rows of {name}, prediction minus measured",
        }
        times: Attributes = {"units": "s", "long_name": f"epochs of the residual rows of {name}"}
        counts: Attributes = {"units": "1", "long_name": f"residual rows of {name} at each epoch"}
        epochs, each = (f"innovation_epoch_{name}",), (f"innovation_row_{name}",)
        out[_HEAD + name] = Variable(each, i.v, rows)
        out[_TIME + name] = Variable(epochs, i.t, times)
        out[_ROWS + name] = Variable(epochs, i.rows.astype(np.float64), counts)
    return out


def stored_innovations(where: str, group: Group) -> dict[str, Innovations]:
    """The inverse of `innovation_variables`. Raises InputError on damaged ones."""
    found = {}
    for key, rows in group.variables.items():
        if not key.startswith(_HEAD):
            continue
        name = key.removeprefix(_HEAD)
        parts = [group.variables.get(head + name) for head in (_TIME, _ROWS)]
        t, counts = (np.zeros(0) if part is None else part.values for part in parts)
        whole = counts.ndim == 1 and counts.shape == t.shape and bool((counts >= 0).all())
        whole = whole and not (counts % 1).any() and rows.values.shape == (counts.sum(),)
        if not whole:
            raise InputError(
                f"{where}/{key}: damaged: found rows, times and counts that do not fit"
            )
        offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        found[name] = Innovations(t, rows.values, offsets)
    return found
