"""Every registered process model: transition matrices, noise, composition, errors.

The second part of `test_conformance`.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
import pytest
from test_conformance import DYNAMICS, seed_of, states_of

from relnav_graph.arrays import Array
from relnav_graph.core.conformance import dynamics
from relnav_graph.core.conformance.draws import REGIMES, sizes
from relnav_graph.core.conformance.dynamics import Interval, transition
from relnav_graph.core.state import Layout
from relnav_graph.errors import InputError

#: A copy of another epoch is no flow: its intervals do not compose.
FLOWS = [name for name, example in DYNAMICS.items() if example.flow]


def input_rows(name: str, lengths: Array, rng: np.random.Generator, regime: str) -> Array:
    """u (rows, 1 + channels) with random inputs, or one row when there are none."""
    example = DYNAMICS[name]
    assert list(example.channels) == list(example.model.inputs)
    return dynamics.input_rows(example, lengths, rng, regime)


def layout_of(name: str) -> Layout:
    return Layout(DYNAMICS[name].model.advances + DYNAMICS[name].model.reads)


@cache
def intervals(name: str, regime: str) -> list[Interval]:
    """Seeded intervals; the same for every test."""
    return dynamics.intervals(DYNAMICS[name], regime, states_of(name), seed_of(name, regime))


@pytest.mark.parametrize("regime", REGIMES)
@pytest.mark.parametrize("name", DYNAMICS)
def test_transition_matrix_agrees_with_central_differences(name: str, regime: str) -> None:
    """To the advanced blocks, and to those that are only read."""
    assert not dynamics.transition_faults(DYNAMICS[name], regime, intervals(name, regime))


@pytest.mark.parametrize("name", DYNAMICS)
def test_process_fills_its_outputs(name: str) -> None:
    """All of them, the same whatever they hold before, and nothing beside them."""
    for regime in REGIMES:
        assert not dynamics.output_faults(DYNAMICS[name], regime, intervals(name, regime)[:5])


@pytest.mark.parametrize("name", DYNAMICS)
def test_propagation_stays_on_the_manifold(name: str) -> None:
    assert not dynamics.manifold_faults(DYNAMICS[name], intervals(name, "large"))


class Chain:
    """A model with the companions that advance what it reads, over sub-intervals."""

    def __init__(self, name: str) -> None:
        self.example = DYNAMICS[name]
        self.model, self.own = self.example.model, layout_of(name)
        blocks = list(self.own.blocks)
        for companion in self.example.companions:
            blocks += companion.advances + companion.reads
        self.layout = Layout(blocks)
        self.n = Layout(self.model.advances).dim

    def companion_inputs(self, companion: Any, u: Array) -> Array:
        """The columns of u that a companion wants."""
        edges = np.cumsum([1, *self.example.channels.values()])
        parts = [u[:, :1]]
        for wanted in companion.inputs:
            k = list(self.example.channels).index(wanted)
            parts.append(u[:, edges[k] : edges[k + 1]])
        return np.ascontiguousarray(np.hstack(parts))

    def start(self, x: Array) -> Array:
        """A state of all blocks; those of companions only (biases) are zero."""
        out = self.layout.identity.copy()
        out[: len(x)] = x
        return out

    def advance(self, t: float, u: Array, x: Array) -> tuple[Array, Array, Array]:
        """x_next, F of all blocks, and Q of the model's own."""
        x_next, F = x.copy(), np.eye(self.layout.dim)
        own, F_own, Q = transition(self.model, t, u, x[: self.own.size])
        x_next[: len(own)] = own
        F[: self.n] = 0.0
        F[: self.n, : self.own.dim] = F_own
        for c in self.example.companions:
            stored, tangent = self.layout.gather(c.advances)
            read, columns = self.layout.gather(c.advances + c.reads)
            part, F_part, _ = transition(c, t, self.companion_inputs(c, u), x[read])
            x_next[stored] = part
            F[tangent] = 0.0
            F[np.ix_(tangent, columns)] = F_part
        return x_next, F, Q


def assert_same_covariance(P: Array, want: Array, tolerance: float) -> None:
    """Equal as correlations and relative variances, whatever the units."""
    sigma = np.sqrt(np.diag(want))
    scaled = P / np.outer(sigma, sigma), want / np.outer(sigma, sigma)
    np.testing.assert_allclose(*scaled, rtol=0, atol=tolerance)


def halves(u: Array) -> tuple[Array, Array]:
    """u of the first and the second half of an interval of rows of equal length."""
    if len(u) > 1:
        return u[: len(u) // 2].copy(), u[len(u) // 2 :].copy()
    half = u.copy()
    half[0, 0] /= 2
    return half, half


@pytest.mark.parametrize("name", FLOWS)
def test_two_half_intervals_compose_to_the_whole(name: str) -> None:
    """Chapman and Kolmogorov: x, F = F2 F1 and Q = F2 Q1 F2^T + Q2 of 40 s."""
    chain, rng = Chain(name), seed_of(name, "compose")
    n, own = chain.n, chain.own.dim
    for i in intervals(name, "moderate"):
        u = input_rows(name, np.full(20, 2.0), rng, "moderate")
        first, second = halves(u)
        x0 = chain.start(i.x)
        whole, F, Q = chain.advance(i.t, u, x0)
        middle, F1, Q1 = chain.advance(i.t, first, x0)
        end, F2, Q2 = chain.advance(i.t + 20.0, second, middle)
        size = sizes(chain.layout.blocks, "moderate")
        error = chain.layout.local(whole, end) / size
        assert np.abs(error[:n]).max() < 1e-10
        composed = (F2 @ F1)[:n, :own]
        np.testing.assert_allclose(
            composed * size[:own] / size[:n, None],
            F[:n, :own] * size[:own] / size[:n, None],
            rtol=0,
            atol=1e-10 * np.abs(F[:n, :own] * size[:own] / size[:n, None]).max(),
        )
        Q12 = F2[:n, :n] @ Q1 @ F2[:n, :n].T + Q2
        assert_same_covariance(Q12, Q, 1e-9)


def pieces(u: Array, count: int) -> Iterator[Array]:
    """u in `count` pieces per row."""
    for row in u:
        for _ in range(count):
            yield np.array([[row[0] / count, *row[1:]]])


def integrated_noise(name: str, i: Interval, count: int) -> Array:
    """Integral of F(T, s) D F(T, s)^T ds, each row of u in `count` pieces; D comes from the
    declared densities alone."""
    chain = Chain(name)
    n, t, x = chain.n, i.t, chain.start(i.x)
    out = np.zeros((n, n))
    for u in pieces(i.u, count):
        half = halves(u)[0]
        h = u[0, 0]
        x, F1, _ = chain.advance(t, half, x)
        D = DYNAMICS[name].diffusion(*chain.own.values(x[: chain.own.size]).values())
        x, F2, _ = chain.advance(t + h / 2, half, x)
        to_end = F2[:n, :n] @ F1[:n, :n]
        out = to_end @ out @ to_end.T + h * F2[:n, :n] @ D @ F2[:n, :n].T
        t += h
    return out


@pytest.mark.parametrize("name", FLOWS)
def test_noise_is_the_integral_of_the_diffusion(name: str) -> None:
    """Within a step of their own, models may neglect how the state turns: in short steps
    they must have the integral, in their usual ones a good share of it."""
    model, count = DYNAMICS[name].model, 4 if DYNAMICS[name].channels else 80
    short = model
    if hasattr(short, "max_step"):
        short = dataclasses.replace(short, max_step=0.1 * short.max_step)
    for i in intervals(name, "moderate")[:8]:
        want = integrated_noise(name, i, count)
        rows = np.concatenate(list(pieces(i.u, count))) if DYNAMICS[name].channels else i.u
        assert_same_covariance(transition(short, i.t, rows, i.x)[2], want, 0.01)
        assert_same_covariance(transition(model, i.t, i.u, i.x)[2], want, 0.05)


@pytest.mark.parametrize("name", FLOWS)
def test_noise_of_one_long_step_is_the_integral_where_little_turns(name: str) -> None:
    """Where every power of the step counts."""
    model, rng = DYNAMICS[name].model, seed_of(name, "long step")
    if hasattr(model, "max_step"):
        model = dataclasses.replace(model, max_step=10.0)
    for near in intervals(name, "near")[:8]:
        i = dataclasses.replace(near, u=input_rows(name, np.array([10.0]), rng, "near"))
        want = integrated_noise(name, i, 80)
        assert_same_covariance(transition(model, i.t, i.u, i.x)[2], want, 0.01)


@pytest.mark.parametrize("name", FLOWS)
def test_noise_goes_with_the_square_of_the_densities_and_nothing_else_does(name: str) -> None:
    model = DYNAMICS[name].model
    fields = [f.name for f in dataclasses.fields(model)]
    densities = [f for f in fields if f.endswith("_density") or f in model.noises]
    assert densities, f"{name}: a process model declares the densities of its noise"
    quiet = dataclasses.replace(model, **{d: 1e-6 * getattr(model, d) for d in densities})
    for i in intervals(name, "moderate"):
        x_next, F, Q = transition(model, i.t, i.u, i.x)
        x_quiet, F_quiet, Q_quiet = transition(quiet, i.t, i.u, i.x)
        np.testing.assert_array_equal(x_quiet, x_next)
        np.testing.assert_array_equal(F_quiet, F)
        assert_same_covariance(Q_quiet, 1e-12 * Q, 1e-12)


@pytest.mark.parametrize("name", FLOWS)
def test_nothing_happens_in_no_time(name: str) -> None:
    model, i = DYNAMICS[name].model, intervals(name, "moderate")[0]
    u = i.u[:1].copy()
    u[0, 0] = 1e-9
    x_next, F, Q = transition(model, i.t, u, i.x)
    advanced = Layout(model.advances)
    assert np.abs(advanced.local(i.x[: advanced.size], x_next)).max() < 1e-7
    outputs, inputs = (sizes(b, "moderate") for b in (model.advances, layout_of(name).blocks))
    scaled = F * inputs / outputs[:, None]
    np.testing.assert_allclose(scaled, np.eye(*F.shape), rtol=0, atol=1e-7)
    assert np.abs(Q).max() < 1e-9


@pytest.mark.parametrize("name", DYNAMICS)
def test_process_refuses_wrong_values(name: str) -> None:
    model, i = DYNAMICS[name].model, intervals(name, "moderate")[0]
    blocks = model.advances + model.reads
    values = list(layout_of(name).values(i.x).values())
    names = re.escape(str([b.name for b in blocks]))
    message = f"^{model.kind}: found {len(values) + 1} values, expected one for each of {names}$"
    with pytest.raises(InputError, match=message):
        model.transition(i.t, i.u, *values, values[0])
    with pytest.raises(InputError, match=f"^{blocks[0].name}: found"):
        model.transition(i.t, i.u, np.zeros(7), *values[1:])
    with pytest.raises(InputError, match=f"^{blocks[-1].name}: found"):
        model.transition(i.t, i.u, *values[:-1], np.full_like(values[-1], np.nan))


@pytest.mark.parametrize("name", [n for n in DYNAMICS if DYNAMICS[n].channels])
def test_process_refuses_inputs_of_another_width(name: str) -> None:
    model, i = DYNAMICS[name].model, intervals(name, "moderate")[0]
    values = layout_of(name).values(i.x).values()
    for u in (i.u[:, :-1], i.u[:, :1], i.u[0]):
        with pytest.raises(InputError, match=model.kind):
            model.transition(i.t, u, *values)
