"""Readings of the inputs (gyro, accelerometer) over each interval of a flown pass.

A reading is the true mean over a sample, known once it is flown, plus the instrument's errors.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import DRIFTS
from relnav_graph.core.measurement import SAME_TIME, InputSeries
from relnav_graph.errors import InputError
from relnav_graph.memory import check_room
from relnav_graph.sim.contracts import IntervalInstrument, KnownInput

__all__ = ["IntervalInputs", "check_samples"]

#: Numbers that a sample takes while it is drawn: noises, biases, readings, each of three axes.
_SAMPLE = 30.0


def check_samples(name: str, source: Any, t0: float, t1: float) -> None:
    """Raise InputError when the samples of an input from t0 to t1, s, do not fit in memory."""
    period = getattr(source, "period", np.inf)
    samples = (t1 - t0) / period
    check_room(f"inputs.{name}.period = {period} s, {samples:.3g} samples", _SAMPLE * samples)


class IntervalInputs:
    """The inputs of a flown pass. Their errors do not depend on what is flown.

    sources: instruments by name; columns: how many channels each has; times: epochs (N,), s;
    rng_of: gives the random generator of an input, by its name. The errors of an
    `IntervalInstrument` are drawn interval by interval, those of others for the whole pass
    beforehand.
    """

    def __init__(
        self,
        sources: Mapping[str, Any],
        columns: Mapping[str, int],
        times: Array,
        rng_of: Callable[[str], np.random.Generator],
    ) -> None:
        self._steady: dict[str, InputSeries] = {}
        self._errors: dict[str, tuple[Array, Array]] = {}
        self._samplers: dict[str, tuple[Any, Any]] = {}
        self._truths: dict[str, Array] = {}
        t0, t1 = float(times[0]), float(times[-1])
        for name, source in sources.items():
            check_samples(name, source, t0, t1)
            if isinstance(source, KnownInput):
                self._steady[name] = source.series(name, t0, t1)
            elif isinstance(source, IntervalInstrument):
                self._samplers[name] = source, source.begin(rng_of(name))
            else:
                edges = source.edges(t0, t1)
                nothing = np.zeros((len(edges) - 1, columns[name]))
                series, bias = source.sample(nothing, edges[:-1], edges[1:], rng_of(name))
                self._errors[name] = edges, series.values
                self._truths[f"{name}_bias"] = bias[np.searchsorted(edges, times - SAME_TIME)]

    def biases(self, k: int) -> dict[str, Array]:
        """True biases, and drifts about them, (3,) by block name at epoch k, the newest one flown;
        SI, in the instrument's axes."""
        found = {name: values[k] for name, values in self._truths.items()}
        for source, sampler in self._samplers.values():
            found |= dict.fromkeys(source.measures, sampler.bias)
            drifts = (name for name, bias in DRIFTS.items() if bias in source.measures)
            found |= dict.fromkeys(drifts, sampler.drift)
        return found

    def edges(self, t0: float, t1: float) -> dict[str, Array]:
        """By input that the truth drives: edges (n + 1,), s, of its samples from t0 to t1, s."""
        found = {name: e[_span(name, e, t0, t1)] for name, (e, _) in self._errors.items()}
        return found | {n: source.edges(t0, t1) for n, (source, _) in self._samplers.items()}

    def over(self, t0: float, t1: float, means: Mapping[str, Array]) -> dict[str, InputSeries]:
        """Readings of the inputs from t0 to t1, s.

        means: by input, the true mean over each sample, (n, channels), SI. To be called once for
        each interval, in order.
        """
        found = dict(self._steady)
        for name, (e, errors) in self._errors.items():
            part = _span(name, e, t0, t1)
            own = slice(part.start, part.stop - 1)
            values = means[name] + errors[own]
            found[name] = InputSeries(name, e[own], e[own.start + 1 : part.stop], values)
        for name, (source, sampler) in self._samplers.items():
            e = source.edges(t0, t1)
            found[name] = InputSeries(name, e[:-1], e[1:], means[name] + sampler.take(e))
        return found


def _span(name: str, edges: Array, t0: float, t1: float) -> slice:
    """The edges from t0 to t1. Raises InputError when a sample lies across one of them."""
    a, b = (int(k) for k in np.searchsorted(edges, np.array([t0, t1]) - SAME_TIME))
    if max(abs(edges[a] - t0), abs(edges[b] - t1)) > SAME_TIME:
        raise InputError(f"inputs.{name}: a sample lies across an epoch at {t0} s or {t1} s")
    return slice(a, b + 1)
