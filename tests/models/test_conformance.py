"""Every registered model keeps its contract: Jacobians, noise, errors.

The models are found through the registry, so that a new file cannot escape; what each
needs beside itself stands in `examples`. The GTSAM factors made of them are tested in
`test_conformance_graph`.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from functools import cache
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from examples import EXAMPLES
from scipy.special import chdtri

from relnav_graph.core.conformance import sensors
from relnav_graph.core.conformance.checks import derived_faults
from relnav_graph.core.conformance.draws import REGIMES
from relnav_graph.core.conformance.examples import (
    DerivedExample,
    DynamicsExample,
    SensorExample,
)
from relnav_graph.core.conformance.sensors import Look, arguments, jacobian_faults
from relnav_graph.core.contracts import Derived, Dynamics, Sensor
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.models import ENTRY_POINTS
from relnav_graph.core.problem import check_covariance
from relnav_graph.errors import InputError
from relnav_graph.registry import classes
from relnav_graph.units import Quantity

MODELS = classes(ENTRY_POINTS)
STATES = 34  # of each regime and model, so that each sees more than a hundred


def named(*types: type) -> dict[str, Any]:
    """Examples of some types by name, for parametrisation."""
    return {
        f"{kind}-{n}": example
        for kind, examples in EXAMPLES.items()
        for n, example in enumerate(examples)
        if isinstance(example, types)
    }


SENSORS, DYNAMICS, DERIVED = (named(t) for t in (SensorExample, DynamicsExample, DerivedExample))
ALL = named(SensorExample, DynamicsExample, DerivedExample)


def states_of(name: str) -> int:
    """How many states an example sees of each regime: the examples of a model share."""
    return max(15, STATES // len(EXAMPLES[name.rpartition("-")[0]]) + 1)


def seed_of(name: str, regime: str) -> np.random.Generator:
    return np.random.default_rng([*name.encode(), *regime.encode()])


# What there is.


def test_every_model_has_an_example() -> None:
    missing = sorted(set(MODELS) - set(EXAMPLES))
    assert not missing, (
        f"no example of {missing}: add one to EXAMPLES in tests/support/examples.py, under the kind"
        " of the model, as SensorExample, DynamicsExample or DerivedExample, and every test here"
        " will run on it"
    )
    assert not set(EXAMPLES) - set(MODELS), "an example of a kind that no package registers"


@pytest.mark.parametrize("name", ALL)
def test_model_is_a_documented_frozen_dataclass_of_its_contract(name: str) -> None:
    model, cls = ALL[name].model, type(ALL[name].model)
    assert MODELS[cls.kind] is cls
    assert name.startswith(cls.kind)
    contract = {SensorExample: Sensor, DynamicsExample: Dynamics, DerivedExample: Derived}
    assert isinstance(model, contract[type(ALL[name])])
    assert cls.__dataclass_params__.frozen, f"{cls.__name__} is not frozen"
    for part in dataclasses.fields(cls):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(model, part.name, None)
    doc = vars(cls).get("__doc__") or ""
    assert re.search(r"[=/^]|\b(19|20)\d\d\b", doc), f"{cls.__name__}: no source and no equation"
    for field in dataclasses.fields(cls):
        docs = " ".join(base.__doc__ or "" for base in cls.__mro__[:-1])
        assert field.name in docs, f"{cls.__name__}.{field.name} stands in no docstring"


# Constructors.


def options(cls: type) -> Iterator[tuple[str, Any]]:
    """Fields and the types that they may have, without None."""
    for key, hint in get_type_hints(cls, include_extras=True).items():
        optional = get_origin(hint) is not Annotated and type(None) in get_args(hint)
        yield key, get_args(hint)[0] if optional else hint


def bad_values(quantity: Quantity, good: Any) -> Iterator[Any]:
    spoilt = np.array(good, dtype=np.float64)
    for bad in (np.nan, np.inf, *((0.0, -1.0) if quantity.positive else ())):
        spoilt.flat[-1] = bad
        yield float(spoilt) if quantity.shape == () else spoilt.copy()
    if quantity.nonnegative:
        yield -np.abs(good) - 1.0
    yield np.ones((2, 7, 5))
    yield np.ones(4 if quantity.shape == (3,) else 3) if len(quantity.shape) < 2 else np.ones(9)
    yield "three"


@pytest.mark.parametrize("name", ALL)
def test_constructor_refuses_bad_numbers_and_names_the_field(name: str) -> None:
    model = ALL[name].model
    for key, hint in options(type(model)):
        for quantity in getattr(hint, "__metadata__", ()):
            # Not of an option that is not given, or given by a word.
            if isinstance(quantity, Quantity) and not isinstance(getattr(model, key), str | None):
                for bad in bad_values(quantity, getattr(model, key)):
                    with pytest.raises(InputError, match=rf"{type(model).__name__}\.{key}: found"):
                        dataclasses.replace(model, **{key: bad})


@pytest.mark.parametrize("name", ALL)
def test_constructor_refuses_unknown_choices_and_names_the_field(name: str) -> None:
    model = ALL[name].model
    for key, hint in options(type(model)):
        if get_origin(hint) is Literal:
            with pytest.raises(InputError, match=key):
                dataclasses.replace(model, **{key: "no such choice"})


@pytest.mark.parametrize("name", ALL)
def test_array_fields_are_copies_that_cannot_be_written(name: str) -> None:
    model = ALL[name].model
    for key, _ in options(type(model)):
        value = getattr(model, key, None)
        if isinstance(value, np.ndarray):
            assert not value.flags.writeable, f"{type(model).__name__}.{key} can be overwritten"


@pytest.mark.parametrize("name", SENSORS)
def test_sensor_refuses_a_mounting_that_is_no_rotation(name: str) -> None:
    model = SENSORS[name].model
    if hasattr(model, "sensor_attitude"):
        for bad in (2 * np.eye(3), np.diag([1.0, 1.0, -1.0])):
            with pytest.raises(InputError, match=rf"{model.kind}\.sensor_attitude: not a rotation"):
                dataclasses.replace(model, sensor_attitude=bad)


# Sensors.


@cache
def looks(name: str, regime: str) -> list[Look]:
    """Seeded measurements and states; the same for every test."""
    return sensors.looks(SENSORS[name], regime, states_of(name), seed_of(name, regime))


@pytest.mark.parametrize("regime", REGIMES)
@pytest.mark.parametrize("name", SENSORS)
def test_sensor_jacobians_agree_with_central_differences(name: str, regime: str) -> None:
    """At residuals that are anything but zero, too."""
    assert not jacobian_faults(SENSORS[name], regime, looks(name, regime))


@pytest.mark.parametrize("name", SENSORS)
def test_sensor_fills_its_outputs(name: str) -> None:
    """All of them, the same whatever they hold before, and nothing beside them."""
    for regime in REGIMES:
        assert not sensors.output_faults(SENSORS[name], regime, 5, seed_of(name, regime))


@pytest.mark.parametrize("name", SENSORS)
def test_sensor_shapes_and_noise(name: str) -> None:
    model = SENSORS[name].model
    assert len(set(model.columns)) == len(model.columns)
    for look in looks(name, "moderate"):
        values = arguments(model, look.x_true, len(look.m.ids))
        z = model.predict(look.m.ids, *values)
        k = len(look.m.ids)
        assert z.shape == look.m.z.shape == (k, len(model.columns))
        assert model.noise(look.m).shape == (k, model.rows, model.rows)
        for R in model.noise(look.m):
            check_covariance(name, R)


@pytest.mark.parametrize("name", SENSORS)
def test_sensor_has_no_residual_against_its_own_prediction(name: str) -> None:
    model = SENSORS[name].model
    for look in looks(name, "large"):
        values = arguments(model, look.x, len(look.m.ids))
        m = Measurement("s", 1.0, model.predict(look.m.ids, *values), look.m.ids)
        r = model.residual(m, *values)[0]
        # 1e-12 of the sizes that are subtracted from each other
        assert np.abs(r).max() <= 1e-12 * max(1.0, np.abs(m.z).max())


@pytest.mark.parametrize("name", SENSORS)
def test_sampled_residuals_have_the_noise_that_the_sensor_declares(name: str) -> None:
    model, rng = SENSORS[name].model, seed_of(name, "noise")
    whitened = []
    for look in looks(name, "moderate"):
        values = arguments(model, look.x_true, 30)
        ids = np.resize(look.m.ids, 30)
        clean = Measurement("s", 1.0, model.predict(ids, *values), ids)
        L = np.linalg.cholesky(model.noise(clean))
        e = np.einsum("kij,kj->ki", L, rng.normal(size=(30, model.rows)))
        r = model.residual(Measurement("s", 1.0, model.perturb(clean.z, e), ids), *values)[0]
        whitened.append(np.linalg.solve(L, r.reshape(30, model.rows, 1))[..., 0])
    w = np.concatenate(whitened)
    low, high = chdtri(w.size, 1 - 1e-4), chdtri(w.size, 1e-4)
    assert low < (w**2).sum() < high
    assert np.abs(w.mean(axis=0)).max() < 5 / np.sqrt(len(w))
    assert np.abs(w.T @ w / len(w) - np.eye(model.rows)).max() < 6 / np.sqrt(len(w))


@pytest.mark.parametrize("name", SENSORS)
def test_perturbing_a_measurement_moves_the_residual_the_other_way(name: str) -> None:
    """r = -e for small e. Where the axes of a row depend on the measured value, they may
    turn between e and r, but no more than now and then, and the length stays."""
    model, rng, turned, count = SENSORS[name].model, seed_of(name, "e"), 0, 0
    for look in looks(name, "moderate"):
        values = arguments(model, look.x_true, len(look.m.ids))
        z = model.predict(look.m.ids, *values)
        e = 1e-2 * np.einsum(
            "kij,kj->ki",
            np.linalg.cholesky(model.noise(look.m)),
            rng.normal(size=(len(z), model.rows)),
        )
        m = Measurement("s", 1.0, model.perturb(z, e), look.m.ids)
        r = model.residual(m, *values)[0].reshape(e.shape)
        length = np.linalg.norm(e, axis=1)
        floor = 1e-13 * max(1.0, np.abs(z).max())
        assert (np.abs(np.linalg.norm(r, axis=1) - length) <= 1e-6 * length + floor).all()
        turned += int((np.linalg.norm(r + e, axis=1) > 1e-3 * length + floor).sum())
        count += len(z)
    assert turned <= 0.02 * count


@pytest.mark.parametrize("name", SENSORS)
def test_sensor_refuses_unknown_ids_and_wrong_values(name: str) -> None:
    model, look = SENSORS[name].model, looks(name, "moderate")[0]
    values = arguments(model, look.x, len(look.m.ids))
    plain, rest = values[: len(model.reads)], values[len(model.reads) :]
    names = re.escape(str([b.name for b in model.reads]))
    with pytest.raises(
        InputError,
        match=f"^{model.kind}: found {len(plain) - 1} values, expected one for each of {names}$"
        if not rest
        else f"^{model.kind}: found no values of point, expected one for each id$",
    ):
        model.residual(look.m, *values[:-1])
    with pytest.raises(InputError, match=f"^{model.reads[0].name}: found"):
        model.residual(look.m, np.full(5, 0.1), *values[1:])
    with pytest.raises(InputError, match=f"^{model.reads[-1].name}: found"):
        model.residual(look.m, *plain[:-1], np.full_like(plain[-1], np.nan), *rest)
    if rest:
        with pytest.raises(InputError, match=f"^{model.kind}: found point of"):
            model.residual(look.m, *plain, rest[0][:-1])
        below = dataclasses.replace(look.m, ids=np.full(len(look.m.ids), -1))
        with pytest.raises(InputError, match=f"{model.kind}: found id -1, expected zero or more"):
            model.residual(below, *values)
    if len(model.observation_data(look.m.ids)[0]):
        unknown = dataclasses.replace(look.m, ids=np.full(len(look.m.ids), 10**6))
        with pytest.raises(InputError, match=f"{model.kind}: found id 1000000"):
            model.residual(unknown, *values)


@pytest.mark.parametrize("name", SENSORS)
def test_sensor_refuses_rows_of_another_width(name: str) -> None:
    model, look = SENSORS[name].model, looks(name, "moderate")[0]
    values = arguments(model, look.x, len(look.m.ids))
    for z in (look.m.z[:, :-1], np.hstack([look.m.z, look.m.z])):
        with pytest.raises(InputError, match=model.kind):
            model.residual(dataclasses.replace(look.m, z=z), *values)


# Derived quantities.


@pytest.mark.parametrize("name", DERIVED)
def test_derived_jacobian_agrees_with_central_differences(name: str) -> None:
    for regime in REGIMES:
        rng = seed_of(name, regime)
        assert not derived_faults(DERIVED[name], regime, STATES, rng)
