"""What a scenario's sensors can determine, before any data: noises after discretisation,
directions that are weakly or not observable, and the sigmas to expect.

All of it follows from the information along a nominal trajectory: the truth of a simulated
pass, or a smoothed estimate of a recorded one.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import Derived
from relnav_graph.core.problem import Problem
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Track
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.whitening import measurement_noise
from relnav_graph.scoring.bounds import Bounds, bounds
from relnav_graph.scoring.deviations import estimates
from relnav_graph.scoring.directions import (
    ACROSS,
    ALIKE,
    ALONG,
    GAUGE,
    INERTIA,
    SCALE,
    Direction,
    named_directions,
    spin,
)
from relnav_graph.scoring.metrics import StateScore, score_of
from relnav_graph.units import convert

__all__ = ["explain"]

#: A direction is called weak, or not observable, from this ratio of smoothed to prior sigma on.
WEAK, UNOBSERVABLE = 0.3, 0.9


def _along(d: Array, information: Array, P: Array) -> float:
    """1-sigma of an error's amplitude along d (n,), under its covariance P (n, n).

    The amplitude is w^T e, the projection in the metric L of the prior: w = L d / (d^T L d) and
    sigma = sqrt(w^T P w). information (n,): the diagonal of L.
    """
    weight = information * d / (d @ (information * d))
    return float(np.sqrt(weight @ P @ weight))


def _blocks_of(layout: Layout) -> list[Direction]:
    one = np.eye(layout.dim)
    return [
        Direction(
            b.name.replace("_", " ") + (f", in {b.frame[-1:]}" if b.frame != "-" else ""),
            one[:, layout.tangent(b.name)],
            b.table_unit,
            b.table_scale,
        )
        for b in layout
    ]


def _amplitude(d: Array, w: Array | None, information: Array, P: Array) -> float:
    """1-sigma of the amplitude along d (n,), of the states that w (n,) tells; see `Direction`."""
    return _along(d, information, P) if w is None else float(np.sqrt(w @ P @ w))


def _name(v: Array, inverse: Array, named: list[Direction], blocks: list[Direction]) -> str:
    """A name for the whitened direction v (n,): of a direction that the models name, else of a
    block, whichever is near enough, else the three blocks with the largest parts."""
    for candidates in (named, blocks):
        size, name = max((d.alike(v, inverse) for d in candidates), default=(0.0, ""))
        if size >= ALIKE:
            return name
    parts = sorted((d.alike(v, inverse) for d in blocks), reverse=True)
    return " + ".join(f"{size:.2f} {name}" for size, name in parts[:3])


def _covariance_at(track: Track, k: int) -> Array:
    """Joint covariance (n, n) of all blocks at an epoch."""
    one = track.at(slice(k, k + 1))
    P: Array = one.covariance(*(b.name for b in one.blocks))[0]
    return P


def _weak_directions(
    problem: Problem, bound: Bounds, x: Array, axis: Array | None
) -> list[dict[str, Any]]:
    """Directions of the first epoch's state, static blocks included, in which the data hardly
    improve the prior, worst first.

    Eigenvectors of W P_s W^T, where W^-1 W^-T is the prior's covariance and P_s the smoothed
    one; kept, the root of an eigenvalue, is the ratio of both sigmas and free of units.
    """
    inverse = np.linalg.inv(np.linalg.cholesky(problem.prior.P))
    left, vectors = np.linalg.eigh(inverse @ _covariance_at(bound.smoothed, 0) @ inverse.T)
    named, blocks = named_directions(problem, x, axis), _blocks_of(problem.layout)
    out = []
    for value, v in sorted(zip(left, vectors.T, strict=True), key=lambda pair: -pair[0]):
        kept = float(np.sqrt(max(value, 0.0)))
        if kept < WEAK:
            break
        word = "not observable" if kept >= UNOBSERVABLE else "weak"
        name = _name(v, inverse, named, blocks)
        out.append({"direction": name, "kept": kept, "verdict": word})
    return out


def _direction_rows(
    problem: Problem, bound: Bounds, x: Array, axis: Array | None
) -> list[dict[str, Any]]:
    """Of each direction that has a name: sigma of prior, filter (last epoch) and smoother (middle
    epoch), each at its own epoch's state. The prior's, where the amplitude is that of certain
    states, is what it says when all but the direction is known: 1 / sqrt(d^T L d)."""
    information, middle = 1 / np.diag(problem.prior.P), len(x) // 2
    moments = {
        "prior": (0, problem.prior.P),
        "filter_last": (-1, _covariance_at(bound.filtered, len(x) - 1)),
        "smoother_middle": (middle, _covariance_at(bound.smoothed, middle)),
    }
    rows: dict[str, dict[str, Any]] = {}
    for key, (k, P) in moments.items():
        for direction in named_directions(problem, x[k], axis):
            if direction.name == GAUGE and key != "prior":
                continue  # it is of the first epoch alone
            for name, d, w in direction.members():
                row = rows.setdefault(name, {"direction": name, "unit": direction.unit})
                own = None if key == "prior" else w
                row[key] = direction.scale * _amplitude(d, own, information, P)
    return list(rows.values())


#: From how many times the uncertainty across the spin axis on that along it stands out.
_STANDS_OUT = 10.0


def _verdict(row: Mapping[str, Any]) -> str:
    kept = row["smoother_middle"] / row["prior"]
    return "not observable" if kept >= UNOBSERVABLE else "weak" if kept >= WEAK else "observable"


def _told(row: Mapping[str, Any]) -> str:
    unit = "" if row["unit"] == "1" else f" {row['unit']}"
    return f"{row['smoother_middle']:.3g}{unit} of {row['prior']:.3g}{unit} a priori"


def words(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """What can be told of a target without a model, and what not; [] of one with a model.

    rows: of the named directions, with the sigmas of prior and smoother.
    """
    named = {row["direction"]: row for row in rows}
    out = []
    if ALONG in named:
        along = named[ALONG]
        others = [r["smoother_middle"] for n, r in named.items() if n.startswith(ACROSS)]
        across = float(np.sqrt(np.mean(np.square(others))))
        said = _verdict(along)
        if said == "observable" and along["smoother_middle"] > _STANDS_OUT * across:
            said = "hardly observable, the rotation does not tell it"
        out.append(f"{ALONG}: {said}: {_told(along)}; across it {across:.3g} {along['unit']}")
    if SCALE in named:
        out.append(f"{SCALE}: {_verdict(named[SCALE])}: {_told(named[SCALE])} (relative)")
    inertia = {n.removeprefix(INERTIA): r for n, r in named.items() if n.startswith(INERTIA)}
    for verdict, end in (("not observable", "stay at the prior"), ("weak", "are weak")):
        found = {n: r for n, r in inertia.items() if _verdict(r) == verdict}
        if found:
            parts = "; ".join(f"{n} ({_told(r)})" for n, r in found.items())
            out.append(f"{INERTIA}{len(found)} of {len(inertia)} parameters {end}: {parts}")
    if inertia and not any(o.startswith(INERTIA) for o in out):
        out.append(f"{INERTIA}all {len(inertia)} parameters are observable")
    gauge = [r for n, r in named.items() if n.startswith(GAUGE)]
    if gauge:
        held = f"{gauge[0]['prior']:.3g} {gauge[0]['unit']}"
        out.append(
            f"{GAUGE}: gauge, a choice and no observation: the axes of t are those of the target at"
            f" the first epoch, as the prior says to {held}"
        )
    return out


def _first_line(model: Any) -> str:
    return (inspect.getdoc(model) or "").split("\n")[0]


def _sensor_rows(problem: Problem) -> list[dict[str, Any]]:
    out = []
    for name, sensor in problem.sensors.items():
        seen = [m for e in problem.epochs for m in e.measurements if m.sensor == name]
        row: dict[str, Any] = {
            "name": name,
            "kind": sensor.kind,
            "meaning": _first_line(sensor),
            "measures": list(sensor.columns),
            "reads": [b.name for b in sensor.reads],
            "observations": sum(len(m.z) for m in seen),
            "epochs": len(seen),
        }
        if seen:
            row["sigma"] = _sigmas(measurement_noise(name, sensor, seen[0]))
        out.append(row)
    return out


def _sigmas(R: Array) -> list[float]:
    """Sigma of each residual row, from the mean variance over observations; R (k, m, m)."""
    variances = np.diagonal(R, axis1=1, axis2=2)
    return [float(s) for s in np.sqrt(variances.mean(axis=0))]


def _process_rows(problem: Problem, Q: Array) -> list[dict[str, Any]]:
    """Noise of each process over its first interval, in table units."""
    layout, dt = problem.layout, float(np.diff(problem.times[:2])[0])
    out = []
    for name, process in problem.processes.items():
        noise = []
        for block in process.advances:
            rows = layout.tangent(block.name)
            sigma = block.table_scale * np.sqrt(np.diag(Q[0])[rows])
            unit, values = block.table_unit, [float(s) for s in sigma]
            noise.append({"block": block.name, "unit": unit, "sigma": values})
        out.append(
            {
                "name": name,
                "kind": process.kind,
                "meaning": _first_line(process),
                "inputs": list(process.inputs),
                "interval_s": dt,
                "noise": noise,
            }
        )
    return out


def _state_rows(
    problem: Problem,
    bound: Bounds,
    derived: Sequence[Derived],
    evaluate: tuple[float, float] | None,
) -> Mapping[str, Any]:
    """Predicted 1-sigma of every state over the scored part of the pass; where there are any, of
    the static blocks at its last epoch."""
    f, s = (
        score_of(t, estimates(t, derived), {}, evaluate) for t in (bound.filtered, bound.smoothed)
    )
    found = {"states": _sigmas_of(problem, f.states, s.states)}
    return found | ({"statics": _sigmas_of(problem, f.statics, s.statics)} if f.statics else {})


def _sigmas_of(
    problem: Problem, filtered: Mapping[str, StateScore], smoothed: Mapping[str, StateScore]
) -> dict[str, Any]:
    """1-sigma of prior, filter and smoother, by state."""
    out = {}
    for name, state in filtered.items():
        prior = None
        if name in problem.layout:
            rows = problem.layout.tangent(name)
            block = problem.layout.block(name)
            trace = np.trace(problem.prior.P[rows, rows])
            prior = float(convert(np.sqrt(trace), block.unit, block.table_unit))
        out[name] = {
            "unit": state.unit,
            "prior": prior,
            "filter": state.sigma,
            "smoother": smoothed[name].sigma,
        }
    return out


def explain(
    name: str,
    problem: Problem,
    x: Array,
    derived: Sequence[Derived],
    evaluate: tuple[float, float] | None,
) -> dict[str, Any]:
    """The object of ``relnav explain --json``, at the nominal trajectory x (N, size).

    Raises what :func:`relnav_graph.scoring.bounds.bounds` raises.
    """
    bound = bounds(problem, x)
    axis = spin(problem.layout, x)
    rows = _direction_rows(problem, bound, x, axis)
    assembly = Assembly.of(problem)
    Q = assembly.transition(x[:-1])[2]
    return {
        "schema": 1,
        "scenario": name,
        "epochs": len(x),
        "sensors": _sensor_rows(problem),
        "processes": _process_rows(problem, Q) if len(x) > 1 else [],
        **_state_rows(problem, bound, derived, evaluate),
        "directions": rows,
        "weak": _weak_directions(problem, bound, x[0], axis),
        **({"target": told} if (told := words(rows)) else {}),
    }
