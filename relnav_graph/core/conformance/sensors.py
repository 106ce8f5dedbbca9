"""Sensors: where they are looked at, and what is wrong with their outputs, Jacobians and noise."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.special import chdtri

from relnav_graph.arrays import Array, Indices
from relnav_graph.core.conformance.draws import sizes
from relnav_graph.core.conformance.examples import SensorExample, reads_of
from relnav_graph.core.conformance.faults import Fault, badly_filled, covariance_fault, say_wrong
from relnav_graph.core.conformance.numeric import blocks_of, differences, steps_for, wrong_entries
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.models import Outputs
from relnav_graph.core.numbered import numbered_of
from relnav_graph.core.numerical import NumericalSensor
from relnav_graph.core.state import Layout
from relnav_graph.errors import GeometryError, InputError, ModelError

__all__ = ["Look", "arguments", "jacobian_faults", "looks", "noise_faults", "output_faults"]

#: When they look, s.
TIME = 1.0
#: Sigmas that all residuals of "large" exceed.
FAR = 10.0
#: Of a Jacobian, relative to its largest entry: how far it may be from differences; and one that is
#: made of differences itself, whose steps are long beside a state near zero.
EXACT, ROUGH = 1e-6, 1e-4


@dataclass(frozen=True, eq=False)
class Look:
    """A measurement taken at x_true (size,), looked at from x (size,)."""

    m: Measurement
    x_true: Array
    x: Array


def arguments(model: Any, x: Array, count: int) -> list[Array]:
    """What the methods of a sensor take at a state x (size,) of `reads_of`, for so many
    observations: of a numbered block, its value for each of them."""
    values = list(Layout(reads_of(model)).values(x).values())
    if numbered_of(model) is not None:
        values[-1] = np.tile(values[-1], (count, 1))
    return values


def _ids(model: Any, rng: np.random.Generator) -> Indices:
    """Some things to look at, up to three."""
    # Where each reads a block of its own, whatever its number.
    known = model.observables() if numbered_of(model) is None else np.array([7, 0, 10**6])
    found: Indices = rng.choice(known, size=min(3, len(known)), replace=False)
    return found


def _drawn(example: SensorExample, regime: str, rng: np.random.Generator) -> Array:
    """A state (size,) at which the sensor sees everything."""
    layout = Layout(reads_of(example.model))
    names = [b.name for b in layout]
    return layout.pack(dict(zip(names, example.draw(rng, regime), strict=True)))


def _look(example: SensorExample, regime: str, rng: np.random.Generator, far: float) -> Look | None:
    """One look; None where the observation is impossible, or the residual not large."""
    model, layout = example.model, Layout(reads_of(example.model))
    ids = _ids(model, rng)
    x_true = _drawn(example, regime, rng)
    clean = Measurement(
        "s", TIME, model.at(TIME).predict(ids, *arguments(model, x_true, len(ids))), ids
    )
    R = model.noise(clean)
    for one in R:
        if fault := covariance_fault("noise", regime, one):
            raise ModelError(fault.text)
    e = np.einsum("kij,kj->ki", np.linalg.cholesky(R), rng.normal(size=R.shape[:2]))
    m = Measurement("s", TIME, model.perturb(clean.z, e), ids)
    if regime == "large":
        x = _drawn(example, regime, rng)
    else:
        share = 1e-5 if regime == "near" else 1.0
        step = [np.full(b.dim, share * example.step.get(b.name, 0.1)) for b in layout]
        x = layout.retract(x_true, np.concatenate(step) * rng.normal(size=layout.dim))
    try:
        r, _ = model.residual(m, *arguments(model, x, len(ids)))
    except GeometryError:
        return None
    r = r.reshape(len(ids), -1)
    sigmas = np.sqrt(np.einsum("ki,kij,kj->k", r, np.linalg.inv(R), r))
    large = sigmas.min() > far and np.linalg.norm(r, axis=1).min() > example.least_large
    return Look(m, x_true, x) if regime != "large" or large else None


def looks(
    example: SensorExample, regime: str, count: int, rng: np.random.Generator, tries: int = 200
) -> list[Look]:
    """Seeded measurements and states. Of "large", residuals exceed 10 sigma, and `least_large`.

    tries: for each of them, of a sensor that cannot see everything where it is drawn. Raises
    InputError, with the reason, where that is not enough, ModelError where the noise is no
    covariance.
    """
    found, reason = list[Look](), "residuals are never large"
    for _ in range(tries * count):
        try:
            look = _look(example, regime, rng, FAR)
        except (GeometryError, InputError) as error:  # such as a distance below zero
            look, reason = None, str(error)
        found += [] if look is None else [look]
        if len(found) == count:
            return found
    raise InputError(
        f"{regime}: {len(found)} of {tries * count} states drawn can be looked at: {reason}; give"
        " an example with a `draw`"
    )


def _columns(model: Any) -> list[str]:
    """Names of the rows of the residual."""
    named = model.rows == len(model.columns)
    return [f"row {i}" + (f" ({model.columns[i]})" if named else "") for i in range(model.rows)]


def _z(model: Any, ids: Indices, x: Array, rng: np.random.Generator) -> Array:
    """Measured values (k, nz) for a kernel of which nothing is known yet."""
    shape = len(ids), len(model.columns)
    makers: list[Callable[[], Array]] = [
        lambda: model.at(TIME).predict(ids, *arguments(model, x, len(ids))),
        lambda: rng.normal(size=shape),
        lambda: np.tile(np.append(np.zeros(shape[1] - 1), 1.0), (shape[0], 1)),
    ]
    for make in makers:
        try:
            return np.ascontiguousarray(model.accept(make()))
        except (GeometryError, InputError, TypeError):  # TypeError: a ModelError is one
            continue
    raise InputError("accept: refuses each z that was tried")


def _calls(model: Any, ids: Indices, z: Array, x: Array) -> Iterator[Callable[[float], Any]]:
    """The kernel at a state, of each observation: with outputs that hold a number before."""
    now = model.at(TIME)
    p, q = now.constants(), now.observation_data(ids)
    dims = sum(b.dim for b in reads_of(model))

    def call(k: int, fill: float) -> tuple[int, Outputs]:
        outputs = Outputs(model.kind, fill, r=(model.rows,), H=(model.rows, dims))
        return int(now.kernel(p, q[k], z[k], x.copy(), *outputs.arrays)), outputs

    for k in range(len(ids)):
        yield partial(call, k)


def output_faults(
    example: SensorExample, regime: str, count: int, rng: np.random.Generator
) -> list[Fault]:
    """Where the kernel does not write all of its outputs, writes past them, or gives other numbers
    when they hold others before it is called."""
    model, found = example.model, list[Fault]()
    for _ in range(count):
        ids, x = _ids(model, rng), _drawn(example, regime, rng)
        for call in _calls(model, ids, _z(model, ids, x, rng), x):
            rows = _columns(model)
            found += badly_filled(call, regime, {"r": (rows,), "H": (rows, reads_of(model))})
        if found:
            break
    return found


def jacobian_faults(
    example: SensorExample, regime: str, looked: Sequence[Look], most: int = 3
) -> list[Fault]:
    """Where H is not what central differences say, on the manifold, right perturbation; at
    residuals that are anything but zero, too."""
    model, layout = example.model, Layout(reads_of(example.model))
    inputs, found = sizes(layout.blocks, "moderate"), list[Fault]()
    for look in looked:
        values = arguments(model, look.x, len(look.m.ids))
        r, parts = model.residual(look.m, *values)
        shapes, wanted = [p.shape for p in parts], [(len(r), b.dim) for b in layout]
        if r.shape != (len(look.m.ids) * model.rows,) or shapes != wanted:
            text = f"found r {r.shape} and H {shapes}, expected {wanted}"
            return [Fault("shapes", regime, "residual", text)]
        H, scale = np.hstack(parts), np.sqrt(np.diagonal(model.noise(look.m), 0, 1, 2)).ravel()

        def f(d: Array, m: Measurement = look.m, x: Array = look.x) -> Array:
            moved = arguments(model, layout.retract(x, d), len(m.ids))
            return np.asarray(model.residual(m, *moved)[0])

        outputs = np.abs(H * inputs).max(axis=1)  # no step moves a row by more than 1e-3 of it
        outputs = np.where(outputs > 0, outputs, 1.0)
        # Residuals up to half a turn.
        numeric = differences(f, 0.3 * steps_for(H, inputs, outputs)) / scale[:, None]
        # What has its Jacobian from differences itself is as good as its own steps.
        tolerance = ROUGH if isinstance(model, NumericalSensor) else EXACT
        wrong = wrong_entries(
            *(numeric, H / scale[:, None], [slice(None)], blocks_of(layout), inputs), tolerance
        )
        found += say_wrong("H", regime, wrong, _columns(model), layout.blocks, scale)
        if len(found) >= most:
            break
    return found[:most]


def noise_faults(
    example: SensorExample, looked: Sequence[Look], rng: np.random.Generator
) -> list[Fault]:
    """Where the noise is no covariance, the sensor's own prediction leaves a residual, or noise
    that is put on it (`perturb`) is not what it declares."""
    model, whitened = example.model, list[Array]()
    for look in looked:
        k, values = len(look.m.ids), arguments(model, look.x_true, len(look.m.ids))
        R = model.noise(look.m)
        if R.shape != (k, model.rows, model.rows):
            text = f"found {R.shape}, expected {(k, model.rows, model.rows)}"
            return [Fault("noise", "moderate", "noise", text)]
        for one in R:
            if fault := covariance_fault("noise", "moderate", one):
                return [fault]
        z = model.at(TIME).predict(look.m.ids, *values)
        r = model.residual(Measurement("s", TIME, z, look.m.ids), *values)[0]
        if np.abs(r).max() > 1e-12 * max(1.0, np.abs(z).max()):
            i = int(np.abs(r).argmax()) % model.rows
            text = f"{_columns(model)[i]}: {r[i]:.3g} against its own prediction, expected 0"
            return [Fault("residual", "moderate", "predict", text)]
        whitened.append(scattered(model, z, look, rng))
    w = np.concatenate(whitened)
    low, high = chdtri(w.size, 1 - 1e-4), chdtri(w.size, 1e-4)
    if not low < (w**2).sum() < high:
        ratio = (w**2).mean()
        text = f"residuals of noise put on a prediction have {ratio:.3g} times the variance of R"
        return [Fault("noise", "moderate", "perturb", text)]
    return []


def scattered(model: Any, z: Array, look: Look, rng: np.random.Generator) -> Array:
    """Whitened residuals (30, rows) of noise put on a prediction z (k, nz) thirty times."""
    ids, values = np.resize(look.m.ids, 30), arguments(model, look.x_true, 30)
    clean = Measurement("s", TIME, np.resize(z, (30, z.shape[1])), ids)
    L = np.linalg.cholesky(model.noise(clean))
    e = np.einsum("kij,kj->ki", L, rng.normal(size=(30, model.rows)))
    r = model.residual(Measurement("s", TIME, model.perturb(clean.z, e), ids), *values)[0]
    return np.asarray(np.linalg.solve(L, r.reshape(30, model.rows, 1))[..., 0])
