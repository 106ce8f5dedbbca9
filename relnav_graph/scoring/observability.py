"""What a scenario's sensors can determine, before any data: noises after discretisation,
directions that are weakly or not observable, and the sigmas to expect.

All of it follows from the information along a nominal trajectory: the truth of a simulated
pass, or a smoothed estimate of a recorded one.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import Derived, NamesDirections
from relnav_graph.core.problem import Problem
from relnav_graph.core.state import Block, Layout
from relnav_graph.core.track import Track
from relnav_graph.linear.assembly import Assembly
from relnav_graph.scoring.bounds import Bounds, bounds
from relnav_graph.scoring.deviations import estimates
from relnav_graph.scoring.metrics import StateScore, score_of
from relnav_graph.units import convert

__all__ = ["Direction", "explain", "named_directions"]

#: A direction is called weak, or not observable, from this ratio of smoothed to prior sigma on.
WEAK, UNOBSERVABLE = 0.3, 0.9
#: A direction is named after another one when the cosine between them is at least this.
ALIKE = 0.8


@dataclass(frozen=True, eq=False)
class Direction:
    """A direction of the error state, or several that share a name: the columns of D (n, k).

    unit: shown in tables; scale: from SI to that unit.
    """

    name: str
    D: Array
    unit: str
    scale: float

    def members(self) -> Iterator[tuple[str, Array]]:
        """Each column with its name."""
        for k, d in enumerate(self.D.T):
            yield (self.name if self.D.shape[1] == 1 else f"{self.name} ({_LETTERS[k]})"), d

    def alike(self, v: Array, inverse: Array) -> tuple[float, str]:
        """Cosine of the angle between v and the span of these directions, and a name for v.

        With whitened directions W D = Q R: |Q^T v|. v (n,): whitened, of length 1; inverse
        (n, n): W, the inverse Cholesky factor of the prior's covariance. Of several directions
        the name tells the combination that comes nearest.
        """
        basis, mixing = np.linalg.qr(inverse @ self.D)
        part = basis.T @ v
        size = float(np.linalg.norm(part))
        if self.D.shape[1] == 1 or size < ALIKE:
            return size, self.name
        weights = np.linalg.solve(mixing, part)
        weights /= np.linalg.norm(weights) * np.sign(weights[np.abs(weights).argmax()])
        text = ", ".join(f"{round(w, 2) + 0.0:.2f}" for w in weights)
        return size, f"{self.name} ({text})"


_LETTERS = "xyz123456"


def named_directions(problem: Problem, x: Array) -> list[Direction]:
    """Directions that the models name at the state x (size,).

    A model names directions by a method ``directions(*x)``: by name, for every block that
    it reads (a process: advances and reads) the tangents (dim, k) of k directions.
    """
    layout, found = problem.layout, dict[str, Direction]()
    models: list[tuple[Any, tuple[Block, ...]]] = [
        (p, p.advances + p.reads) for p in problem.processes.values()
    ]
    models += [(s, s.reads) for s in problem.sensors.values()]
    for model, blocks in models:
        if not isinstance(model, NamesDirections):
            continue
        values = [layout.value(x, b.name) for b in blocks]
        for name, parts in model.directions(*values).items():
            D = np.zeros((layout.dim, parts[0].shape[1]))
            D[layout.gather(blocks)[1]] = np.concatenate(parts)
            first = next((b for b, p in zip(blocks, parts, strict=True) if p.any()), None)
            if first is not None:
                one = Direction(name, D, first.table_unit, first.table_scale)
                found.setdefault(name, one)
    return list(found.values())


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
            f"{b.name.replace('_', ' ')}, in {b.frame[-1:]}",
            one[:, layout.tangent(b.name)],
            b.table_unit,
            b.table_scale,
        )
        for b in layout
    ]


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


def _weak_directions(problem: Problem, bound: Bounds, x: Array) -> list[dict[str, Any]]:
    """Directions of the first epoch's state, static blocks included, in which the data hardly
    improve the prior, worst first.

    Eigenvectors of W P_s W^T, where W^-1 W^-T is the prior's covariance and P_s the smoothed
    one; kept, the root of an eigenvalue, is the ratio of both sigmas and free of units.
    """
    inverse = np.linalg.inv(np.linalg.cholesky(problem.prior.P))
    left, vectors = np.linalg.eigh(inverse @ _covariance_at(bound.smoothed, 0) @ inverse.T)
    named, blocks = named_directions(problem, x), _blocks_of(problem.layout)
    out = []
    for value, v in sorted(zip(left, vectors.T, strict=True), key=lambda pair: -pair[0]):
        kept = float(np.sqrt(max(value, 0.0)))
        if kept < WEAK:
            break
        word = "not observable" if kept >= UNOBSERVABLE else "weak"
        name = _name(v, inverse, named, blocks)
        out.append({"direction": name, "kept": kept, "verdict": word})
    return out


def _direction_rows(problem: Problem, bound: Bounds, x: Array) -> list[dict[str, Any]]:
    """Of each direction that a model names: sigma of prior, filter (last epoch) and
    smoother (middle epoch), each at its own epoch's state."""
    information, middle = 1 / np.diag(problem.prior.P), len(x) // 2
    moments = {
        "prior": (0, problem.prior.P),
        "filter_last": (-1, _covariance_at(bound.filtered, len(x) - 1)),
        "smoother_middle": (middle, _covariance_at(bound.smoothed, middle)),
    }
    rows: dict[str, dict[str, Any]] = {}
    for key, (k, P) in moments.items():
        for direction in named_directions(problem, x[k]):
            for name, d in direction.members():
                row = rows.setdefault(name, {"direction": name, "unit": direction.unit})
                row[key] = direction.scale * _along(d, information, P)
    return list(rows.values())


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
            row["sigma"] = _sigmas(sensor.noise(seen[0]))
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
    assembly = Assembly.of(problem)
    Q = assembly.transition(x[:-1])[2]
    return {
        "schema": 1,
        "scenario": name,
        "epochs": len(x),
        "sensors": _sensor_rows(problem),
        "processes": _process_rows(problem, Q) if len(x) > 1 else [],
        **_state_rows(problem, bound, derived, evaluate),
        "directions": _direction_rows(problem, bound, x),
        "weak": _weak_directions(problem, bound, x[0]),
    }
