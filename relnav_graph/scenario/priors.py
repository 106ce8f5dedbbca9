"""Priors of scenarios: a mean and a sigma for each block, checked and made."""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.problem import Prior
from relnav_graph.core.state import UNIT_QUATERNION, Block, Layout
from relnav_graph.core.track import Truth
from relnav_graph.errors import InputError
from relnav_graph.maths import so3
from relnav_graph.scenario.schema import Problems, ScenarioFile
from relnav_graph.scenario.settings import BlockPrior
from relnav_graph.units import Quantity

__all__ = [
    "check_prior",
    "make_prior",
    "numbered_priors",
    "prior_mean",
    "prior_sigma",
    "true_statics",
]


def prior_sigma(block: Block, value: Any) -> Array:
    """One sigma of a block (dim,), SI, as a prior gives it. Raises InputError on what is none."""
    if isinstance(value, list):
        sigma = Quantity(block.unit, (block.dim,), positive=True).parse(value)
    else:
        sigma = np.full(block.dim, Quantity(block.unit, positive=True).parse(value))
    least, most = np.sqrt(np.finfo(np.float64).tiny), np.sqrt(np.finfo(np.float64).max)
    for one in np.asarray(sigma):
        if not least < one < most:  # nor would its square be a variance
            between = f"expected one from {least:.0e} to {most:.0e}"
            raise InputError(f"found {one:g} {block.unit}, {between} {block.unit}")
    return np.asarray(sigma)


def prior_mean(block: Block, value: list[Any]) -> Array:
    """The value of a block, (3, 3) or (dim,), SI, that a prior gives as a quaternion, scalar first,
    a rotation vector, or components, with units or in SI. Raises InputError on what is none."""
    if block.manifold == "SO3" and len(value) == 4:
        q_wxyz = np.array(Quantity("1", (4,)).parse(value))
        if abs(np.linalg.norm(q_wxyz) - 1) > UNIT_QUATERNION:
            raise InputError(f"found {value}, expected a unit quaternion, scalar first")
        return so3.from_quaternion(q_wxyz)
    tangent = np.array(Quantity(block.unit, (block.dim,)).parse(value))
    return so3.exp(tangent) if block.manifold == "SO3" else tangent


def _example(block: Block) -> str:
    """A prior of a block as a scenario has it: how many numbers, and their unit."""
    mean = [1, 0, 0, 0] if block.manifold == "SO3" else [0] * block.dim
    unit = f'"1 {block.unit}"' if block.unit not in ("", "1") else "1.0"
    turned = '"1 deg"' if block.unit == "rad" else unit
    return f"{{ mean = {mean}, sigma = {turned} }}"


def check_prior(
    layout: Layout,
    file: ScenarioFile,
    problems: Problems,
    numbered: Mapping[str, Block],
    spare: Container[str] = (),
) -> None:
    """Note in `problems` what is wrong with the priors of a file.

    numbered: families of numbered blocks, each with one prior; spare: names of blocks that may
    have one, and are not in the state as it is.
    """
    names = [*(b.name for b in layout), *numbered]
    for name in file.prior:
        if name not in names and name not in spare:
            problems.append((f"prior.{name}", f"unknown block; the state has {', '.join(names)}"))
    for block in (*layout, *numbered.values()):
        prior = file.prior.get(block.name)
        if prior is None:
            static = " (it is static: no process advances it)"
            if block.name in numbered:
                static = " (here one for each, where no sensor knows them)"
            elif block.name not in layout.statics:
                static = ""
            message = f"missing: every block needs a prior{static}, as {_example(block)}"
            problems.append((f"prior.{block.name}", message))
            continue
        try:
            prior_sigma(block, prior.sigma)
        except InputError as error:
            problems.append((f"prior.{block.name}.sigma", str(error)))
        try:
            if isinstance(prior.mean, list):
                prior_mean(block, prior.mean)
        except InputError as error:
            problems.append((f"prior.{block.name}.mean", str(error)))


def numbered_priors(
    numbered: Mapping[str, Block], priors: Mapping[str, BlockPrior]
) -> dict[str, Prior]:
    """The prior of each block of a family, x (size,), P (dim, dim), by the family's name: about its
    mean, zero where there is none."""
    out = {}
    for name, block in numbered.items():
        mean = priors[name].mean
        x = prior_mean(block, mean) if isinstance(mean, list) else np.zeros(block.size)
        out[name] = Prior(x, np.diag(prior_sigma(block, priors[name].sigma) ** 2))
    return out


def true_statics(layout: Layout, tables: Any, problems: Problems) -> dict[str, Array]:
    """True values of static blocks by name, (3, 3) or (dim,), SI, from the [truth.statics] of a
    file, which gives them as means of a prior; `problems` collects what is wrong."""
    found: dict[str, Array] = {}
    statics = {b.name: b for b in layout.statics}
    if not isinstance(tables, Mapping):
        problems.append(("truth.statics", f"found {tables!r}, expected a value for each block"))
        return found
    for name, value in tables.items():
        path = f"truth.statics.{name}"
        if name in statics and isinstance(value, list):
            try:
                found[name] = prior_mean(statics[name], value)
            except InputError as error:
                problems.append((path, str(error)))
        elif name in statics:
            problems.append((path, f"found {value!r}, expected a list of values"))
        elif name in layout:
            problems.append((path, "the block is not static: a process advances it"))
        else:
            known = ", ".join(statics) or "none"
            problems.append((path, f"unknown block; the static ones of the state are {known}"))
    return found


def make_prior(
    layout: Layout,
    priors: Mapping[str, BlockPrior],
    truth: Truth | None,
    t: float,
    rng: np.random.Generator,
) -> Prior:
    """The prior at time t, s: mean ``x = mean (+) d``, d ~ N(0, diag(sigma^2)) for the blocks that
    are "drawn" about the truth, else d = 0; covariance diag(sigma^2).

    Raises InputError when it needs a truth that is not known.
    """
    sigma = np.concatenate([prior_sigma(b, priors[b.family].sigma) for b in layout])
    draw = sigma * rng.standard_normal(layout.dim)
    means: dict[str, Array] = {}
    for block in layout:
        prior = priors[block.family]
        mean = prior.mean
        if isinstance(mean, list):
            means[block.name] = prior_mean(block, mean)
            draw[layout.tangent(block.name)] = 0.0
            continue
        default = block.number is not None and "mean" not in prior.model_fields_set
        if mean == "measured" or default:  # the identity, until the first frames give a value
            means[block.name] = block.unpack(layout.identity[layout.stored(block.name)])
            draw[layout.tangent(block.name)] = 0.0
            continue
        value = np.full(1, np.nan)
        if truth is not None and block.name in truth.values:
            rows, there = truth.at(np.array([t]))
            if there[0]:
                value = truth.values[block.name][rows[0]]
        if not np.isfinite(value).all():
            of = "" if block.number is None else f" of {block.name}"
            raise InputError(
                f"prior.{block.family}: mean = {mean!r} needs the truth at t = {t} s, which is"
                f" not known{of}; give the mean as values"
            )
        means[block.name] = value
        if mean == "truth":
            draw[layout.tangent(block.name)] = 0.0
    return Prior(layout.retract(layout.pack(means), draw), np.diag(sigma**2))
