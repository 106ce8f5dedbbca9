"""Problems from arrays: no file and no scenario; see `problem_from_arrays`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from pydantic import ValidationError

from relnav_graph.arrays import Array, Indices
from relnav_graph.core import models
from relnav_graph.core.contracts import Dynamics, Sensor
from relnav_graph.core.copies import with_copiers
from relnav_graph.core.epochs import make_epochs
from relnav_graph.core.measurement import SAME_TIME, Bridge, InputSeries, Measurement
from relnav_graph.core.numbered import families, first_seen, numbered_of
from relnav_graph.core.problem import Prior, Problem, check_covariance, layout_of
from relnav_graph.core.stamps import first_stamp, seconds
from relnav_graph.core.state import Block, Layout
from relnav_graph.errors import InputError
from relnav_graph.maths.losses import Loss
from relnav_graph.scenario.first_estimate import with_measured
from relnav_graph.scenario.gaps import bridge_of
from relnav_graph.scenario.priors import prior_mean, prior_sigma
from relnav_graph.scenario.schema import (
    Problems,
    ScenarioError,
    from_pydantic,
    make_kind,
    shared_orbit,
)
from relnav_graph.scenario.settings import GapSettings, SensorOptions
from relnav_graph.scenario.unit_check import check_units

__all__ = ["problem_from_arrays"]


def problem_from_arrays(
    *,
    processes: Mapping[str, Any],
    sensors: Mapping[str, Any],
    prior: Mapping[str, Any],
    measurements: Mapping[str, Any] | None = None,
    inputs: Mapping[str, Any] | None = None,
    orbit: Mapping[str, Any] | None = None,
    times: Any = None,
    origin: Any = None,
    gaps: Mapping[str, Mapping[str, Any]] | None = None,
    window: float | None = None,
    merge: float = SAME_TIME,
    considered: Sequence[str] = (),
) -> Problem:
    """A `Problem` from arrays, with models by name.

    processes, sensors: models, or dicts with a `kind` and its parameters, SI or strings with units
    ("5 deg/h"), as in a scenario; of a sensor also `gate`, `loss` and `tuning`. orbit: of the
    target, as [orbit] there, for models that take one.

    measurements: of each sensor (t, z) or (t, z, ids), or a dict of these names: t (N,), z
    (N, columns) in the units that the sensor's `columns` name, (N,) where there is one; ids (N,),
    which beacon or point a row is of; they may be left out where a sensor sees one thing; in a dict
    also covariance (N, rows, rows) of the residual. In any order. Without any, and without times,
    it is a problem for `relnav_graph.Online`.

    inputs: of each input of the processes (edges, values): values (n, channels) are means between
    neighbours of edges (n + 1,); or (t_start, t_end, values), with n each.

    prior: of each block of the state (mean, spread), or a dict of `mean` and `sigma` or
    `covariance`: mean (dim,), of an attitude (3, 3), a quaternion, scalar first, or a rotation
    vector, or "measured", for sensors whose first measurements suffice; spread: sigma, one number
    or (dim,), or a covariance (dim, dim), SI, of attitudes rad about the axes on the right of the
    frame's letters. Of points of an unknown map one for all, by the family's name.

    Stamps are seconds as floats, whole nanoseconds, or datetime64. Of the latter two `origin`, by
    default the earliest stamp, is subtracted in whole numbers; the pass then counts seconds from
    there. Floats stay, less an `origin`; in Unix time they are a caution. times: of the epochs, by
    default those of the measurements. gaps: by input, see `relnav_graph.scenario.gaps`; window, s,
    merge, s, considered: see `Problem`.

    Raises ScenarioError with all that is wrong with models and prior, by its path, InputError on
    arrays that do not fit.
    """
    problems: Problems = []
    made, options = _models(processes, sensors, orbit, problems)
    if problems:
        raise ScenarioError("arrays", problems)
    own, known = made["processes"], with_copiers(made["sensors"])
    columns = {name: c for p in own.values() for name, c in p.inputs.items()}
    unpacked: list[_Samples | _Means] = [
        *(_Samples.of(f"measurements.{n}", n, m, known) for n, m in (measurements or {}).items()),
        *(_Means.of(f"inputs.{n}", n, u, columns) for n, u in (inputs or {}).items()),
    ]
    stamps = [pair for one in unpacked for pair in one.stamps]
    stamps += [] if times is None else [("times", times)]
    start = first_stamp(stamps) if origin is None else origin
    seen = [m for one in unpacked if isinstance(one, _Samples) for m in one.made(known, start)]
    bridges = _bridges(columns, gaps or {}, problems)
    series = [one.made(start, bridges) for one in unpacked if isinstance(one, _Means)]
    at = None if times is None else seconds("times", times, start)
    epochs = make_epochs(own, seen, {s.name: s for s in series}, at, merge)
    means = _Priors.of(own, known, prior, problems, first_seen(known, seen))
    if problems:
        raise ScenarioError("arrays", problems)
    problem = Problem(
        *(own, known, means.prior, epochs),
        gates={n: o.gate for n, o in options.items() if o.gate is not None},
        losses={n: Loss(o.loss, o.tuning) for n, o in options.items() if o.loss is not None},
        window=window,
        bridges=bridges,
        merge=merge,
        numbered=means.numbered,
        considered=tuple(considered),
    )
    if means.measured and not epochs:
        raise InputError("prior: found 'measured', but no measurements; Online can measure it")
    problem = with_measured(problem, means.measured)
    check_units(problem)
    return problem


def _models(
    processes: Mapping[str, Any],
    sensors: Mapping[str, Any],
    orbit: Mapping[str, Any] | None,
    problems: Problems,
) -> tuple[dict[str, dict[str, Any]], dict[str, SensorOptions]]:
    """Models by section and name, and the options of the sensors given as dicts."""
    made: dict[str, dict[str, Any]] = {"processes": {}, "sensors": {}}
    options: dict[str, SensorOptions] = {}
    for section, given in (("processes", processes), ("sensors", sensors)):
        contract = Dynamics if section == "processes" else Sensor
        for name, model in given.items():
            path = f"{section}.{name}"
            if isinstance(model, Mapping):
                own = shared_orbit(models.ENTRY_POINTS, model, orbit)
                if section == "sensors":
                    general = {k: own.pop(k) for k in ("gate", "loss", "tuning") if k in own}
                    try:
                        options[name] = SensorOptions.model_validate(general)
                    except ValidationError as error:
                        problems += from_pydantic(path, error)
                listed = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in own.items()}
                model = make_kind(models.ENTRY_POINTS, path, listed, problems, contract)
                if model is None:
                    continue
            if not isinstance(model, contract):
                problems.append((path, f"found {model!r}, expected a model that is one of these"))
                continue
            made[section][name] = model
    return made, options


def _parts(where: str, given: Any, forms: Sequence[tuple[str, ...]]) -> dict[str, Any]:
    """Arrays by name, given as a tuple of one of the forms or as a dict."""
    known = {name for form in forms for name in form}
    if isinstance(given, Mapping):
        found = dict(given)
        if any(found.keys() == set(form) for form in forms) and found.keys() <= known:
            return found
    elif isinstance(given, tuple | list):
        for form in forms:
            if len(form) == len(given):
                return dict(zip(form, given, strict=True))
    expected = " or ".join(f"({', '.join(form)})" for form in forms)
    names = ", ".join(map(str, given)) if isinstance(given, Mapping) else type(given).__name__
    raise InputError(f"{where}: found {names}, expected {expected}")


def _rows(where: str, given: Any, columns: Sequence[str], count: int) -> Array:
    """Values (N, columns), with as many rows as there are times."""
    array = np.asarray(given)
    if array.ndim == 1 and len(columns) == 1:
        array = array[:, None]
    if array.shape != (count, len(columns)) or array.dtype.kind not in "fiu":
        raise InputError(
            f"{where}: found {array.dtype} {array.shape}, expected real numbers"
            f" {(count, len(columns))}: columns {', '.join(columns)}"
        )
    return array.astype(np.float64)


@dataclass(frozen=True, eq=False)
class _Samples:
    """What one sensor saw, as given: t (N,), z (N, columns), ids (N,), covariance of each row."""

    name: str
    t: Any
    z: Array
    ids: Indices | None
    P: Array | None

    @staticmethod
    def of(where: str, name: str, given: Any, sensors: Mapping[str, Sensor]) -> _Samples:
        if name not in sensors:
            raise InputError(f"{where}: unknown sensor, expected one of: {', '.join(sensors)}")
        forms = (("t", "z"), ("t", "z", "ids"))
        if isinstance(given, Mapping):
            forms += tuple((*form, "covariance") for form in forms)
        parts = _parts(where, given, forms)
        t, ids = np.atleast_1d(np.asarray(parts["t"])), parts.get("ids")
        if t.ndim != 1:
            raise InputError(f"{where}: found t of {t.shape}, expected (N,)")
        z = _rows(f"{where}: z", parts["z"], sensors[name].columns, len(t))
        if ids is not None:
            ids = np.asarray(ids)
            if ids.shape != t.shape or ids.dtype.kind not in "iu":
                found = f"{where}: found ids {ids.dtype} {ids.shape}"
                raise InputError(f"{found}, expected whole numbers {t.shape}")
        P, shape = parts.get("covariance"), (len(t), *2 * (sensors[name].rows,))
        if P is not None and np.shape(P) != shape:
            raise InputError(f"{where}: found covariance {np.shape(P)}, expected {shape}")
        return _Samples(name, t, z, ids, None if P is None else np.asarray(P))

    @property
    def stamps(self) -> list[tuple[str, Any]]:
        return [(f"measurements.{self.name}: t", self.t)]

    def made(self, sensors: Mapping[str, Sensor], origin: Any) -> list[Measurement]:
        """One measurement for each time."""
        where, sensor = f"measurements.{self.name}", sensors[self.name]
        t, ids = seconds(f"{where}: t", self.t, origin), self.ids
        if not np.isfinite(t).all():
            raise InputError(f"{where}: t holds a value that is not finite")
        if ids is None:
            if numbered_of(sensor) is not None or len(sensor.observables()) != 1:
                raise InputError(f"{where}: found no ids, expected which thing each row is of")
            ids = np.full(len(t), int(sensor.observables()[0]))
        order = np.lexsort((ids, t))
        t, z, ids = t[order], self.z[order], ids[order].astype(np.int64)
        twice = np.flatnonzero((np.diff(t) == 0) & (np.diff(ids) == 0))
        if len(twice):
            k = twice[0]
            raise InputError(f"{where}: found id {ids[k]} twice at t = {t[k]} s, expected once")
        edges = np.append(np.flatnonzero(np.diff(t, prepend=-np.inf)), len(t)).tolist()
        return [
            Measurement(
                *(self.name, float(t[i]), z[i:j], ids[i:j]),
                covariance=None if self.P is None else self.P[order[i:j]],
            )
            for i, j in pairwise(edges)
        ]


@dataclass(frozen=True, eq=False)
class _Means:
    """One input as given: its means between t_start and t_end."""

    name: str
    t_start: Any
    t_end: Any
    values: Array

    @staticmethod
    def of(where: str, name: str, given: Any, columns: Mapping[str, Sequence[str]]) -> _Means:
        if name not in columns:
            known = ", ".join(columns) or "none"
            raise InputError(f"{where}: unknown input, expected those of the processes: {known}")
        parts = _parts(where, given, (("edges", "values"), ("t_start", "t_end", "values")))
        if "edges" in parts:
            edges, rows = np.asarray(parts["edges"]), len(np.asarray(parts["values"]))
            if edges.shape != (rows + 1,):
                raise InputError(
                    f"{where}: found edges {edges.shape} for {rows} values, expected ({rows + 1},):"
                    " a value is the mean between two edges"
                )
            parts |= {"t_start": edges[:-1], "t_end": edges[1:]}
        t_start, t_end = np.asarray(parts["t_start"]), np.asarray(parts["t_end"])
        if t_start.ndim != 1 or t_start.shape != t_end.shape:
            found = f"t_start {t_start.shape} and t_end {t_end.shape}"
            raise InputError(f"{where}: found {found}, expected (n,) both")
        values = _rows(f"{where}: values", parts["values"], columns[name], len(t_start))
        return _Means(name, t_start, t_end, values)

    @property
    def stamps(self) -> list[tuple[str, Any]]:
        where = f"inputs.{self.name}"
        return [(f"{where}: t_start", self.t_start), (f"{where}: t_end", self.t_end)]

    def made(self, origin: Any, bridges: Mapping[str, Bridge]) -> InputSeries:
        """The input, in order of time."""
        start, end = (seconds(where, t, origin) for where, t in self.stamps)
        order = np.argsort(start, kind="stable")
        kept = start[order], end[order], self.values[order]
        return InputSeries(self.name, *kept, bridges.get(self.name))


def _bridges(
    columns: Mapping[str, tuple[str, ...]],
    gaps: Mapping[str, Mapping[str, Any]],
    problems: Problems,
) -> dict[str, Bridge]:
    """How gaps are bridged, by input."""
    found = dict[str, Bridge]()
    unknown = [name for name in gaps if name not in columns]
    problems += [(f"gaps.{n}", f"unknown input; there are: {', '.join(columns)}") for n in unknown]
    for name, own in columns.items():
        try:
            bridge = bridge_of(own, GapSettings.model_validate(gaps.get(name, {})))
        except ValidationError as error:
            problems += from_pydantic(f"gaps.{name}", error)
        except InputError as error:
            problems.append((f"gaps.{name}.spread", str(error)))
        else:
            found |= {} if bridge is None else {name: bridge}
    return found


def _mean(block: Block, given: Any) -> Array:
    """The mean of a block, (3, 3) or (dim,)."""
    value = given if isinstance(given, list) else np.asarray(given)
    if isinstance(value, list) and value and isinstance(value[0], list):
        value = np.asarray(value, dtype=np.float64)
    if isinstance(value, np.ndarray) and value.shape == (3, 3) and block.manifold == "SO3":
        return block.unpack(block.pack(value))
    return prior_mean(block, [value.item()] if np.ndim(value) == 0 else list(value))  # type: ignore[union-attr]


def _spread(block: Block, given: Any) -> Array:
    """The covariance (dim, dim) of a block, from sigmas or a covariance."""
    array = None if isinstance(given, str | list) else np.asarray(given)
    if array is not None and array.ndim == 2:
        if array.shape != (block.dim, block.dim):
            raise InputError(f"found a covariance {array.shape}, expected {(block.dim, block.dim)}")
        check_covariance("it", array)
        return array.astype(np.float64)
    return np.diag(prior_sigma(block, given if array is None else array.tolist()) ** 2)


@dataclass(frozen=True, eq=False)
class _Priors:
    """The prior of the state, of numbered blocks by family, and what is to be measured first."""

    prior: Prior
    numbered: dict[str, Prior]
    measured: tuple[str, ...]

    @staticmethod
    def of(
        processes: Mapping[str, Dynamics],
        sensors: Mapping[str, Sensor],
        given: Mapping[str, Any],
        problems: Problems,
        seen: Iterable[Block],
    ) -> _Priors:
        """Of models, with numbered blocks `seen`; what is wrong goes into `problems`."""
        layout, own = layout_of(processes, sensors), families(sensors)
        blocks = {b.name: b for b in layout} | own
        for name in given:
            if name not in blocks:
                problems.append((f"prior.{name}", f"unknown block; there are {', '.join(blocks)}"))
        means, spreads, measured = dict[str, Array](), dict[str, Array](), list[str]()
        for name, block in blocks.items():
            identity = block.unpack(Layout([block]).identity)
            means[name], spreads[name] = identity, np.eye(block.dim)
            if name not in given:
                read = "" if name not in layout.statics else ", a constant"
                what = f"a mean and a sigma, {block.unit}, of {block.symbol}{read}"
                problems.append((f"prior.{name}", f"missing: every block needs one: {what}"))
                continue
            parts = _tried(f"prior.{name}", partial(_both, given[name]), problems)
            if parts is None:
                continue
            mean, spread = parts
            if isinstance(mean, str) and mean == "measured":
                measured.append(name)
            elif mean is not None or name not in own:  # of a point about nowhere: the origin
                found = _tried(f"prior.{name}.mean", partial(_mean, block, mean), problems)
                means[name] = identity if found is None else found
            cov = _tried(f"prior.{name}.sigma", partial(_spread, block, spread), problems)
            spreads[name] = np.eye(block.dim) if cov is None else cov
        numbered = {n: Prior(block.pack(means[n]), spreads[n]) for n, block in own.items()}
        P = np.zeros((layout.dim, layout.dim))
        for block in layout:
            rows = layout.tangent(block.name)
            P[rows, rows] = spreads[block.name]
        return _Priors(Prior(layout.pack(means), P), numbered, tuple(measured))


def _both(given: Any) -> tuple[Any, Any]:
    """Mean and spread of a prior."""
    forms = (("mean", "sigma"), ("mean", "covariance"), ("sigma",), ("covariance",))
    if isinstance(given, Mapping):
        parts = _parts("it", given, forms)
        return parts.get("mean"), parts.get("sigma", parts.get("covariance"))
    parts = _parts("it", given, forms[:1])
    return parts["mean"], parts["sigma"]


def _tried(path: str, make: Callable[[], Any], problems: Problems) -> Any:
    """What is made, or None: `problems` says why."""
    try:
        return make()
    except (InputError, TypeError, ValueError) as error:
        problems.append((path, str(error).removeprefix("it: ")))
        return None
