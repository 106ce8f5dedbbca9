"""Each line of the conventions in `relnav_graph.__doc__` has a test here that bears it."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_args, get_type_hints

import gtsam
import numpy as np
import pytest
import relnav_factors
from example_makers import BEACONS, LOW, MOUNTED, gyro_model
from examples import EXAMPLES
from relnav_factors.derived.inertia_ratios import InertiaRatios
from relnav_factors.derived.relative_pose import PositionInTarget, RelativeAttitude
from relnav_factors.dynamics.euler_rotation import EulerRotation
from relnav_factors.dynamics.white_noise_acceleration import WhiteNoiseAcceleration
from relnav_factors.sensors.beacon_los import BeaconLineOfSight
from relnav_factors.sensors.stereo_point import StereoPointCartesian

import relnav_graph
from relnav_graph.core.catalogue import (
    CHASER_ATTITUDE,
    GYRO_BIAS,
    INERTIA,
    RELATIVE_POSITION,
    TARGET_ATTITUDE,
    TARGET_RATE,
)
from relnav_graph.core.conformance.examples import SensorExample
from relnav_graph.core.epochs import make_epochs, process_inputs
from relnav_graph.core.measurement import InputSeries, Measurement
from relnav_graph.core.models import ENTRY_POINTS
from relnav_graph.core.numbered import numbered_of
from relnav_graph.core.state import Layout
from relnav_graph.io.tabular import component_columns, from_components, to_components
from relnav_graph.linear.gtsam_factors import insert_block
from relnav_graph.maths import so3
from relnav_graph.maths.frames import rtn_from_inertial, xiong_from_rtn
from relnav_graph.maths.orbit import KeplerOrbit, chief_motion
from relnav_graph.registry import classes
from relnav_graph.sim.instruments.constant_input import ConstantInput
from relnav_graph.sim.instruments.gyro import RateIntegratingGyro
from relnav_graph.sim.passes import simulate
from relnav_graph.sim.sensors import Timing, stream
from relnav_graph.sim.truths.own_models import OwnModels
from relnav_graph.sim.truths.rigid_body_pair import RigidBodyPair
from relnav_graph.units import Quantity, parse_quantity

Test = Callable[..., None]

DEG = np.pi / 180
HOUSES = [Path(str(package.__file__)).parent for package in (relnav_graph, relnav_factors)]
SOURCES = sorted(path for house in HOUSES for path in house.rglob("*.py"))
ASSERTED: dict[str, Test] = {}


def conventions() -> list[str]:
    """The lines of the list, each in one piece."""
    _, _, text = str(relnav_graph.__doc__).partition("Conventions\n-----------\n")
    return [" ".join(item.split()) for item in re.split(r"^- ", text, flags=re.MULTILINE)[1:]]


def asserts(beginning: str) -> Callable[[Test], Test]:
    """Marks the test of the line that begins so."""

    def mark(test: Test) -> Test:
        assert beginning not in ASSERTED
        ASSERTED[beginning] = test
        return test

    return mark


def test_each_convention_has_its_test_and_each_test_its_convention() -> None:
    lines = conventions()
    assert len(lines) >= 10
    for line in lines:
        found = [b for b in ASSERTED if line.startswith(b)]
        assert len(found) == 1, f"no test, or more than one, asserts the convention {line!r}"
    for beginning in ASSERTED:
        assert any(line.startswith(beginning) for line in lines), f"{beginning!r} is no convention"


def model_classes() -> Iterator[type]:
    yield from classes(ENTRY_POINTS).values()
    yield from classes("relnav_graph.truths").values()
    yield from (KeplerOrbit, RateIntegratingGyro)


def quantities(cls: type) -> Iterator[tuple[str, Quantity]]:
    for name, hint in get_type_hints(cls, include_extras=True).items():
        for option in (hint, *get_args(hint)):
            for extra in getattr(option, "__metadata__", ()):
                if isinstance(extra, Quantity):
                    yield name, extra


@asserts("SI units and radians inside.")
def test_units_are_si_inside() -> None:
    assert parse_quantity("180 deg", "rad") == pytest.approx(np.pi)
    assert parse_quantity("3600 arcsec", "rad") == pytest.approx(DEG)
    assert parse_quantity("5 deg/h", "rad/s") == pytest.approx(5 * DEG / 3600)
    assert parse_quantity("1 deg/sqrt(h)", "rad/sqrt(s)") == pytest.approx(DEG / 60)
    assert parse_quantity(0.25, "rad") == 0.25
    for cls in model_classes():
        for name, quantity in quantities(cls):
            assert not re.search(r"deg|arc|\bh\b|km|mm|min", quantity.unit), f"{cls}.{name}"
    for block in (CHASER_ATTITUDE, TARGET_RATE, GYRO_BIAS):
        assert block.unit.startswith("rad")
    assert GYRO_BIAS.table_scale == pytest.approx(3600 / DEG)


@asserts("The *target* (chief) is the tumbling body; the *chaser*")
def test_the_chaser_carries_the_sensors() -> None:
    """Turning the chaser turns what is seen; target and points of it tumble."""
    sensor = StereoPointCartesian(points=BEACONS, sigma=np.full(3, 0.1))
    assert sensor.reads == (CHASER_ATTITUDE, TARGET_ATTITUDE, RELATIVE_POSITION)
    turn = so3.exp(np.array([0.3, 0.2, -0.1]))
    ids, place = np.arange(5), np.array([0.0, 0.0, -10.0])
    seen = sensor.predict(ids, np.eye(3), np.eye(3), place)
    np.testing.assert_allclose(seen, BEACONS - place, atol=1e-14)
    turned = sensor.predict(ids, turn, np.eye(3), place)
    np.testing.assert_allclose(turned, seen @ turn, atol=1e-14)
    assert "target" in TARGET_RATE.name
    assert EulerRotation(torque_density=1.0).advances[:2] == (TARGET_ATTITUDE, TARGET_RATE)
    assert gyro_model(1.0, 1.0).advances == (
        CHASER_ATTITUDE,
        GYRO_BIAS,
    )


@asserts("Frames: ``i`` inertial, ``o`` orbital frame of the target = RTN")
def test_o_is_radial_transverse_normal() -> None:
    r_i, v_i = np.array([7e6, 0, 0]), np.array([100.0, 0, 7.5e3])
    R_oi = rtn_from_inertial(r_i, v_i)
    np.testing.assert_allclose(R_oi @ [1, 0, 0], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(R_oi @ [0, 0, 1], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(R_oi @ [0, -1, 0], [0, 0, 1], atol=1e-15)
    # Another frame of the field is also called LVLH: along track, anti-normal, nadir.
    np.testing.assert_array_equal(xiong_from_rtn @ [1.0, 2.0, 3.0], [2.0, -3.0, -1.0])
    # o turns with the orbit, about its z; without an orbit it does not turn.
    still, model = np.zeros(3), EulerRotation(torque_density=1e-9, inertia_density=1e-8, orbit=LOW)
    R_ot, _, _ = model.propagate(0.0, np.array([[100.0]]), np.eye(3), still, np.zeros(2))
    turned = chief_motion(LOW.array(), 100.0)[2] - LOW.true_anomaly
    np.testing.assert_allclose(R_ot, so3.exp(np.array([0, 0, -turned])), atol=1e-12)
    free = EulerRotation(torque_density=1e-9, inertia_density=1e-8)
    R_ot, _, _ = free.propagate(0.0, np.array([[100.0]]), np.eye(3), still, np.zeros(2))
    np.testing.assert_array_equal(R_ot, np.eye(3))


@asserts("``R_ab`` takes b-components to a-components.")
def test_names_carry_frames() -> None:
    """R_ab is active, GTSAM's aRb; r_tc_o points from t to c."""
    R_oc, R_ot = so3.exp(np.array([0.1, 0.7, -0.4])), so3.exp(np.array([-0.5, 0.2, 0.9]))
    values = gtsam.Values()
    insert_block(values, 1, CHASER_ATTITUDE, R_oc)
    v_c = np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(values.atRot3(1).rotate(v_c), R_oc @ v_c, atol=1e-15)
    R_tc, _ = RelativeAttitude().value(R_oc, R_ot)
    np.testing.assert_allclose(R_ot @ (R_tc @ v_c), R_oc @ v_c, atol=1e-15)
    r_tc_o = np.array([10.0, -20.0, 5.0])
    r_tc_t, _ = PositionInTarget().value(R_ot, r_tc_o)
    np.testing.assert_allclose(R_ot @ r_tc_t, r_tc_o, atol=1e-14)
    # From the chaser, the target's origin is at -r_tc_o; R_cs and r_sc_c place the sensor.
    sensor = StereoPointCartesian(points=np.zeros((1, 3)), sigma=np.full(3, 0.1), **MOUNTED)
    seen_s = sensor.predict(np.array([0]), R_oc, R_ot, r_tc_o)[0]
    place_c = MOUNTED["sensor_attitude"] @ seen_s + MOUNTED["sensor_position"]
    np.testing.assert_allclose(R_oc @ place_c, -r_tc_o, atol=1e-14)
    # w_ti_t is the rate of t seen from i, in t: R' = R [w x].
    model, w = EulerRotation(torque_density=1e-9, inertia_density=1e-8), np.array([0.1, -0.2, 0.3])
    R_next, _, _ = model.propagate(0.0, np.array([[1e-4]]), R_ot, w, np.zeros(2))
    np.testing.assert_allclose((R_next - R_ot) / 1e-4, R_ot @ so3.skew(w), atol=1e-4)
    for block in (CHASER_ATTITUDE, TARGET_ATTITUDE, RELATIVE_POSITION, TARGET_RATE):
        assert block.symbol.split("_", 1)[1].endswith(block.frame)


@asserts("Perturbations act on the right:")
def test_perturbations_act_on_the_right() -> None:
    layout = Layout([TARGET_RATE, CHASER_ATTITUDE])
    R_oc, d = so3.exp(np.array([0.1, 0.7, -0.4])), np.array([0.3, -0.2, 0.5])
    x = layout.pack({"target_rate": np.ones(3), "chaser_attitude": R_oc})
    moved = layout.retract(x, np.concatenate([d, d]))
    got = layout.value(moved, "chaser_attitude")
    np.testing.assert_allclose(got, R_oc @ so3.exp(d), atol=1e-15)
    np.testing.assert_allclose(got, gtsam.Rot3(R_oc).retract(d).matrix(), atol=1e-15)
    np.testing.assert_allclose(layout.value(moved, "target_rate"), 1 + d)
    np.testing.assert_allclose(layout.local(x, moved), np.concatenate([d, d]), atol=1e-15)
    np.testing.assert_allclose(gtsam.Rot3(R_oc).localCoordinates(gtsam.Rot3(got)), d, atol=1e-15)


@asserts("Quaternions appear in files only:")
def test_quaternions_are_hamilton_scalar_first_and_only_in_files() -> None:
    quarter = so3.exp(np.array([0, 0, np.pi / 2]))
    np.testing.assert_allclose(so3.quaternion(quarter), [np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
    assert component_columns(CHASER_ATTITUDE) == ("q_w", "q_x", "q_y", "q_z")
    q_wxyz = to_components(CHASER_ATTITUDE, quarter[None])
    np.testing.assert_allclose(q_wxyz, [[np.sqrt(0.5), 0, 0, np.sqrt(0.5)]])
    for sign in (1, -1):
        back = from_components(CHASER_ATTITUDE, sign * q_wxyz)
        np.testing.assert_allclose(back, quarter[None], atol=1e-15)
    random = np.random.default_rng(0).normal(size=(100, 3))
    assert (to_components(CHASER_ATTITUDE, np.array([so3.exp(v) for v in random]))[:, 0] >= 0).all()
    assert CHASER_ATTITUDE.size == 9


@asserts("Residuals are prediction minus measured.")
def test_residual_is_prediction_minus_measured() -> None:
    for examples in EXAMPLES.values():
        for example in (e for e in examples if isinstance(e, SensorExample)):
            model, rng = example.model, np.random.default_rng(1)
            x = example.draw(rng, "moderate")
            ids = model.observables()[:1]
            if numbered_of(model) is not None:
                ids, x = np.array([5]), (*x[:-1], x[-1][None])
            z = model.predict(ids, *x)
            e = 1e-3 * np.linalg.cholesky(model.noise(Measurement("s", 0.0, z, ids)))
            e = e @ rng.normal(size=model.rows)
            m = Measurement("s", 0.0, model.perturb(z, e), ids)
            assert model.residual(m, *x)[0] @ e[0] < 0  # measured too much: negative
    sensor = StereoPointCartesian(points=BEACONS, sigma=np.full(3, 0.1))
    pose = np.eye(3), np.eye(3), np.array([0.0, 0, -10])
    measured = Measurement("s", 0.0, np.array([[9.0, 8.0, 7.0]]), np.array([1]))
    predicted = sensor.predict(measured.ids, *pose)[0]
    np.testing.assert_allclose(sensor.residual(measured, *pose)[0], predicted - measured.z[0])


@asserts("``*_density`` is a continuous noise (unit/sqrt(Hz)), ``*_sigma`` one per sample.")
def test_density_is_continuous_and_sigma_per_sample() -> None:
    for cls in model_classes():
        for name, quantity in quantities(cls):
            rooted = bool(re.search(r"sqrt|\^1\.5", quantity.unit))
            assert rooted == name.endswith("_density"), f"{cls.__name__}.{name}: {quantity.unit}"
            assert not ("sigma" in name and rooted)
    # A random walk has spread by density^2 T after T, however T is cut.
    gyro = gyro_model(3e-3, 1e-9)
    T = 8.0
    for rows in (1, 2, 16):
        u = np.hstack([np.full((rows, 1), T / rows), np.zeros((rows, 3))])
        _, _, Q = gyro.transition(0.0, u, np.eye(3), np.zeros(3))
        np.testing.assert_allclose(np.diag(Q)[:3], (3e-3) ** 2 * T, rtol=1e-9)
    # The white error of a rate sample over dt is density / sqrt(dt); a sigma has no dt.
    for period in (0.1, 10.0):
        source = RateIntegratingGyro(period, 3e-3, 0.0)
        edges = source.edges(0.0, 4000 * period)
        rng = np.random.default_rng(2)
        values = source.sample(np.zeros((4000, 3)), edges[:-1], edges[1:], rng)[0].values
        assert values.std() == pytest.approx(3e-3 / np.sqrt(period), rel=0.03)
    sensor = BeaconLineOfSight(points=BEACONS, sigma=2e-3)
    m = Measurement("s", 0.0, np.array([[0, 0, 1.0]]), np.array([0]))
    np.testing.assert_allclose(sensor.noise(m), [4e-6 * np.eye(2)])


@asserts("``P_*`` is a covariance, ``sigma_*`` a standard deviation.")
def test_p_is_a_covariance_and_sigma_a_standard_deviation() -> None:
    """By their use in the sources."""
    P_from_root = re.compile(r"\bP(_\w+)? = (np|math)\.sqrt\(")
    sigma_from_square = re.compile(r"\bsigma(_\w+)? = [^\n=]*\*\* ?2\s*$", re.MULTILINE)
    text = "\n".join(path.read_text() for path in SOURCES)
    assert not P_from_root.search(text)
    assert not sigma_from_square.search(text)
    for cls in model_classes():  # a sigma has the unit of what it is the deviation of
        for name, quantity in quantities(cls):
            if "sigma" in name:
                assert "^2" not in quantity.unit.replace("/s^2", ""), f"{cls.__name__}.{name}"


@asserts("Time is float seconds since the scenario's epoch;")
def test_times_are_of_validity_and_inputs_are_means() -> None:
    late = Measurement("s", 1.0, np.zeros((1, 3)), np.array([0]), t_arrival=9.0)
    soon = Measurement("s", 2.0, np.zeros((1, 3)), np.array([0]), t_arrival=2.5)
    epochs = make_epochs({}, [soon, late], {})
    assert [e.t for e in epochs] == [1.0, 2.0]
    assert epochs[0].measurements == (late,)
    # A sample holds over the interval it states, whole or in part: it is a mean, no sum
    # and no instant.
    values = np.array([[1.0, 2, 3], [4, 5, 6]])
    series = InputSeries("gyro", np.array([0.0, 4.0]), np.array([4.0, 8.0]), values)
    process: Any = gyro_model(1e-9, 1e-9)
    u = process_inputs(process, {"gyro": series}, 3.0, 5.0)
    np.testing.assert_allclose(u, [[1.0, 1, 2, 3], [1.0, 4, 5, 6]])
    # Of a rate that grows, the mean gives the angle.
    t, axis = np.linspace(0, 8, 9), np.array([0.0, 0.6, 0.8])
    angle = 0.01 * t**2
    mean = np.diff(angle)[:, None] * axis
    u = np.ascontiguousarray(np.hstack([np.ones((8, 1)), mean]))
    R_oc, _ = process.propagate(0.0, u, np.eye(3), np.zeros(3))
    np.testing.assert_allclose(R_oc, so3.exp(angle[-1] * axis), atol=1e-14)


@asserts("Random numbers come from ``SeedSequence(root, spawn_key=(run, stream))`` only")
def test_adding_a_sensor_leaves_the_others_as_they_were() -> None:
    process = WhiteNoiseAcceleration(acceleration_density=1e-3)
    attitude = EulerRotation(torque_density=1e-6, inertia_density=1e-8)
    gyro = gyro_model(1e-6, 1e-9)
    processes: dict[str, Any] = {"p": process, "t": attitude, "c": gyro}
    truth = OwnModels({"relative_position": [0.0, 0.0, -20.0]})
    one: dict[str, Any] = {"b": BeaconLineOfSight(points=BEACONS, sigma=1e-3)}
    two: dict[str, Any] = {"a": StereoPointCartesian(points=BEACONS, sigma=np.full(3, 0.1)), **one}
    runs = []
    for sensors, seed, run in ((one, 5, 0), (two, 5, 0), (one, 6, 0), (one, 5, 1)):
        inputs = {"gyro": ConstantInput(np.zeros(3))}
        times = np.arange(10.0)
        timings: dict[str, Timing] = {}
        pass_ = simulate(truth, inputs, processes, sensors, timings, times, seed, run)
        runs.append(np.array([m.z for m in pass_.measurements if m.sensor == "b"]))
    np.testing.assert_array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0], runs[2])
    assert not np.array_equal(runs[0], runs[3])
    own = np.random.SeedSequence(5, spawn_key=(3, zlib.crc32(b"sensor b")))
    want = np.random.default_rng(own).normal(size=4)
    np.testing.assert_array_equal(stream(5, 3, "sensor b").normal(size=4), want)
    for path in SOURCES:  # no other source of numbers: no global state, no fixed seed
        for line in path.read_text().splitlines():
            for call in re.findall(r"np\.random\.(\w+)\(|\bimport random\b", line):
                assert call in ("default_rng", "SeedSequence"), f"{path.name}: {line.strip()}"
                assert "SeedSequence(" in line, f"{path.name}: {line.strip()}"


@asserts("Of an inertia only the ratios are observable: l_x = (J_y - J_z) / J_x and cyclic.")
def test_inertia_stands_in_the_state_as_ratios() -> None:
    jx, jy, jz = 100.0, 80.0, 60.0
    ratios = np.array([(jy - jz) / jx, (jz - jx) / jy, (jx - jy) / jz])
    k = np.arctanh(ratios[:2])
    assert INERTIA.dim == 2
    l, _ = InertiaRatios().value(k)
    np.testing.assert_allclose(l, ratios)
    # They are those of Euler's equations: w_x' = l_x w_y w_z, cyclic.
    model, w = EulerRotation(torque_density=1e-9, inertia_density=1e-8), np.array([0.1, 0.2, -0.3])
    _, w_next, _ = model.propagate(0.0, np.array([[1e-5]]), np.eye(3), w, k)
    want = ratios * np.array([w[1] * w[2], w[2] * w[0], w[0] * w[1]])
    np.testing.assert_allclose((w_next - w) / 1e-5, want, atol=1e-7)
    # The truth speaks of the same ones, whatever the size of the body.
    for size in (1.0, 1e3):
        pair = RigidBodyPair(
            semi_major_axis=7e6,
            relative_position=np.zeros(3),
            relative_velocity=np.zeros(3),
            target_inertia=size * np.array([jx, jy, jz]),
            target_rate=w,
        )
        at_start = pair.simulate(np.zeros(1), np.random.default_rng(0)).values
        np.testing.assert_allclose(at_start["inertia_parameters"][0], k)


# What models may import, and who may build custom factors; all else of the house stands in
# test_layout.


def imported(path: Path) -> Iterator[str]:
    """Modules that a source file imports, at any place in it."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield str(node.module)


def test_factors_import_numpy_numba_and_the_contracts_only() -> None:
    allowed = {"__future__", "collections", "dataclasses", "math", "typing", "numba", "numpy"}
    allowed |= {"relnav_factors"}
    floors = {"arrays", "compiled", "constants", "core", "errors", "maths", "units"}
    for path in HOUSES[1].rglob("*.py"):
        for module in imported(path):
            top, *floor = module.split(".")
            known = top in allowed or (top == "relnav_graph" and floor[0] in floors)
            assert known, f"{path.name} imports {module}"


def test_only_the_adapter_builds_custom_factors() -> None:
    users = [path.name for path in SOURCES if "CustomFactor(" in path.read_text()]
    assert users == ["gtsam_factors.py"]


@pytest.mark.parametrize("module", ["relnav_graph", "relnav_graph.core.models", "relnav_factors"])
def test_importing_draws_in_no_matplotlib(module: str) -> None:
    code = (
        f"import sys, {module}\n"
        "print([m for m in ('matplotlib', 'pydantic', 'h5netcdf') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
