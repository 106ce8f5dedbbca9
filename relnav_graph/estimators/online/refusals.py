"""What a step leaves out of an epoch, and what it raises: both say where."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from relnav_graph.core.epochs import Epoch
from relnav_graph.errors import EstimationError, ModelError, RelnavError
from relnav_graph.estimators.ekf import FilterSweep
from relnav_graph.estimators.online.engine import Refusal

__all__ = ["named", "refusals"]


@contextmanager
def named(epoch: Epoch) -> Iterator[None]:
    """Whatever a model raises in an epoch becomes a ModelError that says where."""
    try:
        # What is far out overflows before it is found out.
        with np.errstate(over="ignore", invalid="ignore"):
            yield
    except RelnavError:
        raise
    except np.linalg.LinAlgError as error:
        raise EstimationError(f"t = {epoch.t} s: {error}") from error
    except Exception as error:
        seen = ", ".join(m.sensor for m in epoch.measurements) or "no sensor"
        raise ModelError(
            f"t = {epoch.t} s ({seen}): a model raised {type(error).__name__}: {error}"
        ) from error


def refusals(t: float, done: FilterSweep) -> tuple[Refusal, ...]:
    """What a filter left out of one epoch, or did not use fully."""
    weights = done.weights
    if (weights == 1).all():
        return ()
    a = done.assembly
    status = a.measure(done.x_predicted, np.ones(a.observations)).status
    reasons = {
        "impossible": (weights == 0) & (status > 0),
        "gated": (weights == 0) & (status == 0),
        "downweighted": (weights > 0) & (weights < 1),
    }
    out = []
    for reason, chosen in reasons.items():
        for i in np.unique(a.sensor_of[chosen]):
            ids = tuple(int(n) for n in a.ids[chosen & (a.sensor_of == i)])
            out.append(Refusal(a.sensor_names[i], t, ids, reason))
    return tuple(out)
