"""Every registered model as an assembled GTSAM factor, and the assembly itself.

The third part of `test_conformance`. The factor's own linearisation is compared with
central differences of its error through GTSAM's retraction, at large residuals too: there
a process factor without the inverse right Jacobians of its chain rule is wrong.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from itertools import pairwise
from typing import Any

import gtsam
import numpy as np
import pytest
from example_makers import BEACONS, MOUNTED
from numeric import assert_jacobian
from relnav_factors.sensors.stereo_point import StereoPointCartesian
from test_conformance import DYNAMICS, looks, seed_of
from test_conformance import SENSORS as ALL_SENSORS
from test_conformance_dynamics import intervals, layout_of

from relnav_graph.arrays import Array
from relnav_graph.core.conformance.draws import REGIMES, sizes
from relnav_graph.core.conformance.dynamics import Interval, transition
from relnav_graph.core.conformance.numeric import differences, steps_for
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.numbered import numbered_of
from relnav_graph.core.state import Block, Layout
from relnav_graph.errors import GeometryError, InputError
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.gtsam_factors import (
    insert_block,
    measurement_factor,
    process_factor,
    read_block,
)
from relnav_graph.maths import so3

#: Those whose observations have all blocks in common.
SENSORS = {n: e for n, e in ALL_SENSORS.items() if numbered_of(e.model) is None}
#: A block that no model knows: nothing may leak into its columns.
STRANGER = Block("stranger", "s", "SO3", 3, "rad", "ab", "deg")


@dataclasses.dataclass(frozen=True)
class Assembled:
    """A factor, its keys with their blocks, and the values at which to look at it."""

    factor: gtsam.CustomFactor
    keys: list[int]
    blocks: tuple[Block, ...]
    values: gtsam.Values

    def columns(self) -> list[slice]:
        edges = np.cumsum([0, *(b.dim for b in self.blocks)])
        return [slice(a, b) for a, b in pairwise(edges)]

    def moved(self, d: Array) -> Array:
        """The error after GTSAM's retraction by d, in order of the keys."""
        step = gtsam.VectorValues()
        for key, part in zip(self.keys, self.columns(), strict=True):
            step.insert(key, d[part])
        return np.asarray(self.factor.whitenedError(self.values.retract(step)))


def values_of(keys: list[int], blocks: tuple[Block, ...], values: list[Array]) -> gtsam.Values:
    out = gtsam.Values()
    for key, block, value in zip(keys, blocks, values, strict=True):
        insert_block(out, key, block, value)
    return out


@cache
def assembled_sensor(name: str, regime: str) -> list[Assembled]:
    model, found = SENSORS[name].model, []
    for look in looks(name, regime):
        keys = [90 - 7 * i for i in range(len(model.reads))]  # not in order of the blocks
        values = values_of(keys, model.reads, list(Layout(model.reads).values(look.x).values()))
        factor = measurement_factor(model, look.m, keys)
        found.append(Assembled(factor, keys, model.reads, values))
    return found


def end_of(name: str, regime: str, i: Interval, rng: np.random.Generator) -> Array:
    """Where the interval ends: near the prediction, or attitudes up to 3 rad from it and
    the rest a hundred sigmas."""
    model = DYNAMICS[name].model
    advanced = Layout(model.advances)
    x_next, _, Q = transition(model, i.t, i.u, i.x)
    d = rng.normal(size=advanced.dim)
    if regime != "near":
        d *= 100 / np.linalg.norm(d)
    d *= np.sqrt(np.diag(Q))
    for b in advanced:
        if b.manifold == "SO3" and regime != "near":
            axis = rng.normal(size=3)
            angle = 0.3 if regime == "moderate" else rng.uniform(1.0, 3.0)
            d[advanced.tangent(b.name)] = angle * axis / np.linalg.norm(axis)
    return advanced.retract(x_next, d)


@cache
def assembled_process(name: str, regime: str) -> list[Assembled]:
    model, rng, found = DYNAMICS[name].model, seed_of(name, regime + " end"), []
    blocks = model.advances + model.reads
    for i in intervals(name, regime):
        keys = [90 - 7 * k for k in range(len(blocks))]
        keys_next = [5 + 3 * k for k in range(len(model.advances))]
        start = list(layout_of(name).values(i.x).values())
        end = list(Layout(model.advances).values(end_of(name, regime, i, rng)).values())
        every = (*blocks, *model.advances)
        values = values_of([*keys, *keys_next], every, [*start, *end])
        factor = process_factor(model, i.t, i.u, keys, keys_next, start)
        found.append(Assembled(factor, [*keys, *keys_next], every, values))
    return found


def check_linearisation(a: Assembled, inputs: Array, steps: Array) -> None:
    assert list(a.factor.keys()) == a.keys
    J, b = a.factor.linearize(a.values).jacobian()
    np.testing.assert_allclose(-b, a.factor.whitenedError(a.values), rtol=1e-14)
    numeric = differences(a.moved, steps)
    assert_jacobian(numeric, J, [slice(None)], a.columns(), inputs)


@pytest.mark.parametrize("regime", REGIMES)
@pytest.mark.parametrize("name", SENSORS)
def test_measurement_factor_is_linearised_exactly(name: str, regime: str) -> None:
    inputs = sizes(SENSORS[name].model.reads, "moderate")
    for a in assembled_sensor(name, regime):
        J, _ = a.factor.linearize(a.values).jacobian()
        if regime == "large":
            assert np.linalg.norm(a.factor.whitenedError(a.values)) > 10
        steps = 0.3 * steps_for(J, inputs, np.abs(J * inputs).max(axis=1))
        check_linearisation(a, inputs, steps)


@pytest.mark.parametrize("regime", REGIMES)
@pytest.mark.parametrize("name", DYNAMICS)
def test_process_factor_is_linearised_exactly(name: str, regime: str) -> None:
    model = DYNAMICS[name].model
    inputs = sizes(model.advances + model.reads, regime)
    outputs = sizes(model.advances, regime)
    for a, i in zip(assembled_process(name, regime), intervals(name, regime), strict=True):
        if regime == "large":
            assert np.linalg.norm(a.factor.whitenedError(a.values)) > 10
        F = transition(model, i.t, i.u, i.x)[1]
        steps = np.concatenate([steps_for(F, inputs, outputs), 1e-3 * outputs])
        check_linearisation(a, np.concatenate([inputs, outputs]), steps)


@pytest.mark.parametrize("name", SENSORS)
def test_measurement_factor_is_the_model_whitened(name: str) -> None:
    """r^T R^-1 r, H^T R^-1 H and H^T R^-1 r are those of the model, from its own methods."""
    model = SENSORS[name].model
    for regime in REGIMES:
        for look, a in zip(looks(name, regime), assembled_sensor(name, regime), strict=True):
            r, parts = model.residual(look.m, *Layout(model.reads).values(look.x).values())
            H, W = np.hstack(parts), np.zeros((len(r), len(r)))
            for k, R in enumerate(model.noise(look.m)):
                one = slice(k * model.rows, (k + 1) * model.rows)
                W[one, one] = np.linalg.inv(R)
            J, b = a.factor.linearize(a.values).jacobian()
            information = H.T @ W @ H
            np.testing.assert_allclose(J.T @ J, information, atol=1e-10 * np.abs(information).max())
            np.testing.assert_allclose(b @ b, r @ W @ r, rtol=1e-10)
            gradient = H.T @ W @ r
            np.testing.assert_allclose(-J.T @ b, gradient, atol=1e-10 * np.abs(gradient).max())


@pytest.mark.parametrize("name", DYNAMICS)
def test_process_factor_is_the_model_whitened(name: str) -> None:
    """e = local(propagate(x_k), x_k+1), with the noise of the model: e^T Q^-1 e."""
    model = DYNAMICS[name].model
    advanced = Layout(model.advances)
    for regime in REGIMES:
        both = zip(intervals(name, regime), assembled_process(name, regime), strict=True)
        for i, a in both:
            x_next, _, Q = transition(model, i.t, i.u, i.x)
            keys = a.keys[-len(model.advances) :]
            after = zip(keys, model.advances, strict=True)
            end = np.concatenate([read_block(a.values, k, b).ravel() for k, b in after])
            e, sigma = advanced.local(x_next, end), np.sqrt(np.diag(Q))
            want = e / sigma @ np.linalg.solve(Q / np.outer(sigma, sigma), e / sigma)
            assert 2 * a.factor.error(a.values) == pytest.approx(want, rel=1e-6)


class Correlated(StereoPointCartesian):
    """A sensor whose rows are correlated, as no sensor of ours is: the order of a whitening
    matrix matters only then."""

    def noise(self, m: Measurement) -> Array:
        L = 0.01 * np.array([[1.0, 0, 0], [0.8, 1.2, 0], [-0.5, 0.9, 0.7]])
        return np.tile(L @ L.T, (len(m.z), 1, 1))


def test_correlated_noise_is_whitened() -> None:
    model: Any = Correlated(points=BEACONS, sigma=np.full(3, 0.01), **MOUNTED)
    for look in looks("stereo_point_cartesian-0", "large"):
        keys, values = [7, 3, 5], list(Layout(model.reads).values(look.x).values())
        r, parts = model.residual(look.m, *values)
        W = np.kron(np.eye(len(look.m.ids)), np.linalg.inv(model.noise(look.m)[0]))
        factor = measurement_factor(model, look.m, keys)
        J, b = factor.linearize(values_of(keys, model.reads, values)).jacobian()
        information = np.hstack(parts).T @ W @ np.hstack(parts)
        np.testing.assert_allclose(J.T @ J, information, atol=1e-10 * np.abs(information).max())
        np.testing.assert_allclose(b @ b, r @ W @ r, rtol=1e-10)


# The assembly.


@pytest.mark.parametrize("name", SENSORS)
def test_assembly_measures_as_the_factors_do(name: str) -> None:
    """Of many epochs in one call, with blocks in another order and others in between."""
    model, some = SENSORS[name].model, looks(name, "large")
    layout = Layout([STRANGER, *reversed(model.reads)])
    epochs = [Epoch(float(k), (dataclasses.replace(s.m, t=float(k)),)) for k, s in enumerate(some)]
    own = Layout(model.reads)
    x = np.array([layout.pack({"stranger": np.eye(3), **own.values(s.x)}) for s in some])
    assembly = Assembly(layout, {}, {"s": model}, epochs)
    rows = assembly.measure(x, np.ones(assembly.observations))
    assert not rows.status.any()
    _, columns = layout.gather(model.reads)
    for k, a in enumerate(assembled_sensor(name, "large")):
        part = slice(assembly.row_offsets[k], assembly.row_offsets[k + 1])
        J, b = a.factor.linearize(a.values).jacobian()
        np.testing.assert_allclose(rows.r[part], -b, rtol=1e-14)
        np.testing.assert_allclose(rows.H[part][:, columns], J, rtol=1e-14)
    assert not rows.H[:, layout.tangent("stranger")].any()


@pytest.mark.parametrize("name", DYNAMICS)
def test_assembly_processes_as_the_factors_do(name: str) -> None:
    model = DYNAMICS[name].model
    blocks = model.advances + model.reads
    layout = Layout([STRANGER, *reversed(blocks)])
    both = zip(intervals(name, "large"), assembled_process(name, "large"), strict=True)
    for i, a in list(both)[:10]:
        read = {"stranger": np.eye(3), **layout_of(name).values(i.x)}
        after = zip(a.keys[len(blocks) :], model.advances, strict=True)
        end = read | {b.name: read_block(a.values, k, b) for k, b in after}
        t_end = i.t + i.u[:, 0].sum()
        epochs = [Epoch(i.t), Epoch(t_end, (), {"p": i.u})]
        assembly = Assembly(layout, {"p": model}, {}, epochs)
        x = np.array([layout.pack(read), layout.pack(end)])
        whiten = assembly.whitening(x[:1])
        rows = assembly.process(x, whiten)
        J, b = a.factor.linearize(a.values).jacobian()
        _, at = layout.gather(blocks)
        _, to = layout.gather(model.advances)
        n = layout_of(name).dim
        np.testing.assert_allclose(rows.e[0][to], -b, rtol=1e-12)
        np.testing.assert_allclose(rows.A[0][np.ix_(to, at)], J[:, :n], rtol=1e-12)
        np.testing.assert_allclose(rows.B[0][np.ix_(to, to)], J[:, n:], rtol=1e-12)
        assert not rows.A[0][:, layout.tangent("stranger")].any()


# What the adapter refuses.


def test_factors_refuse_keys_that_do_not_fit() -> None:
    model, look = SENSORS["beacon_los-0"].model, looks("beacon_los-0", "near")[0]
    for keys in ([1, 2], [1, 2, 2]):
        with pytest.raises(InputError, match=r"beacon_los: found keys .* 'relative_position'"):
            measurement_factor(model, look.m, keys)
    process, i = DYNAMICS["gyro_bias-0"].model, intervals("gyro_bias-0", "near")[0]
    start = list(layout_of("gyro_bias-0").values(i.x).values())
    for keys, after in (([1, 2], [3]), ([1, 2], [2, 3])):
        with pytest.raises(InputError, match="gyro_bias: found keys"):
            process_factor(process, i.t, i.u, keys, after, start)


def test_factor_raises_with_the_reason_where_the_geometry_is_impossible() -> None:
    """A point behind the camera, met in the middle of a solver's work."""
    a = assembled_sensor("stereo_point-0", "near")[0]
    behind = gtsam.Values(a.values)
    R_oc = behind.atRot3(a.keys[0]).matrix()
    turned = R_oc @ so3.exp(np.array([0.0, np.pi, 0.0]))
    behind.update(a.keys[0], gtsam.Rot3(turned))
    with pytest.raises(GeometryError, match=r"stereo_point: id \d at t = 1\.0 s: the point is"):
        a.factor.linearize(behind)


def test_values_keep_their_type() -> None:
    values: Any = gtsam.Values()
    attitude, vector = STRANGER, Block("v", "v", "vector", 2, "m", "o", "m")
    insert_block(values, 1, attitude, so3.exp(np.ones(3)))
    insert_block(values, 2, vector, np.array([1.0, 2.0]))
    np.testing.assert_allclose(read_block(values, 1, attitude), so3.exp(np.ones(3)), atol=1e-15)
    np.testing.assert_array_equal(read_block(values, 2, vector), [1.0, 2.0])
    with pytest.raises(InputError, match="stranger: not a rotation"):
        insert_block(values, 3, attitude, 2 * np.eye(3))
    with pytest.raises(InputError, match="v: found"):
        insert_block(values, 3, vector, np.zeros(3))
