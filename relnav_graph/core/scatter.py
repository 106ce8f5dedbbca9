"""Whether the samples of an input scatter by more than the noise that is declared of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.cautions import Caution, parameters_in
from relnav_graph.core.contracts import Dynamics
from relnav_graph.core.epochs import Epoch, channels
from relnav_graph.units import column_unit

__all__ = ["scatter_cautions"]

#: Of the columns of an input, by their unit, that of the density of its white noise.
_DENSITIES = {"rad/s": "rad/sqrt(s)", "m/s^2": "m/s^1.5"}
#: How a parameter with such a density is called.
_WHITE = "random_walk_density"
#: So many times more than declared a scatter must be before it is doubted: true motions add to it.
#: Less tells nothing: samples are filtered, and who knows a model to be wrong declares more.
MORE = 5.0
#: Orders of differences, and the sum of the squares of their coefficients. Of white noise both tell
#: the same; of a motion that is fast beside the samples the higher one tells far less, and of jumps
#: the lower one.
ORDERS = {2: 6, 4: 70}
#: Fewer differences tell too little, and more epochs are not looked at.
LEAST, LOOKED = 30, 2000


def scatter_cautions(
    processes: Mapping[str, Dynamics], epochs: Sequence[Epoch]
) -> tuple[Caution, ...]:
    """Of inputs whose samples scatter by far more than the declared density of their white
    noise: that is larger, or the input is of another unit.

    processes: by name. The scatter is that of differences of samples of one length, of which a
    smooth motion is no part: of second ones sigma^2 = 6 density^2 / length. Its size is the median,
    so that jumps do not count, and the least that differences of the `ORDERS` tell.
    """
    found = []
    for process, model in processes.items():
        u = [e.inputs[process] for e in epochs[1:LOOKED] if process in e.inputs]
        for name, own in channels(model).items():
            column = model.inputs[name][0]
            unit = _DENSITIES.get(str(column_unit(column)), "")
            for path in parameters_in(model, unit, _WHITE)[:1]:
                declared = float(np.sqrt(np.mean(np.square(getattr(model, path)))))
                seen = _seen([np.hstack([one[:, :1], one[:, own]]) for one in u])
                found += _caution(name, f"processes.{process}.{path}", unit, declared, seen)
    return tuple(found)


def _seen(rows: Sequence[Array]) -> float | None:
    """The density, SI, that rows (k, 1 + channels) of lengths, s, and means show; None: too few."""
    u = np.concatenate(rows) if rows else np.empty((0, 1))
    found = []
    for order, square in ORDERS.items():
        if len(u) < order + LEAST:
            continue
        lengths = np.lib.stride_tricks.sliding_window_view(u[:, 0], order + 1)
        alike = np.isclose(lengths, lengths[:, :1], 1e-3).all(axis=1)
        if alike.sum() >= LEAST:
            bends = np.diff(u[:, 1:], order, axis=0) * np.sqrt(lengths[:, :1] / square)
            # 0.6745: the median of the size of a normal variable of sigma 1.
            each = np.median(np.abs(bends[alike]), axis=0) / 0.6745
            found.append(float(np.sqrt(np.mean(each**2))))
    return min(found, default=None)


def _caution(name: str, path: str, unit: str, declared: float, seen: float | None) -> list[Caution]:
    if not seen or not declared or seen < declared * MORE:
        return []
    return [
        Caution(
            "input noise",
            f"samples of {name!r} scatter from one to the next as white noise of {seen:.3g} {unit},"
            f" {seen / declared:.3g} times what {path} says: is its noise so small, and in what"
            " unit is it?",
        )
    ]
