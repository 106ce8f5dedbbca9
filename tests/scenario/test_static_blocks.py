"""Static blocks in scenarios: mountings, their priors, and what is true of them."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from passes import EXPERIMENTS, changed_tables

from relnav_graph.errors import InputError
from relnav_graph.io.dataset import read_dataset, write_dataset
from relnav_graph.maths import so3
from relnav_graph.scenario.build import load_scenario, make_scenario
from relnav_graph.scenario.schema import ScenarioError
from relnav_graph.sim.sensors import Timing, measure

MOUNTING = EXPERIMENTS / "mounting.toml"
SHORT = ["time.epochs=12"]
STATICS = ["gyro_bias", "inertia_matrix_parameters", "camera_misalignment", "camera_displacement"]
OFF = so3.exp(np.radians([0.3, -0.3, 0.26]))


def raw(*path: str, value: Any = None) -> dict[str, Any]:
    """The tables of mounting.toml with one of them changed; None: taken out."""
    return changed_tables(load_scenario(MOUNTING, SHORT).raw, *path, value=value)


def test_what_is_read_and_not_advanced_is_static() -> None:
    layout = load_scenario(MOUNTING, SHORT).layout
    assert [b.name for b in layout.statics] == STATICS


def test_sensors_of_one_mount_share_its_blocks_and_others_have_their_own() -> None:
    tables = raw("sensors", "other", value={**raw("x")["sensors"]["camera"], "mount": "camera"})
    assert [b.name for b in make_scenario(tables, "one mount").layout.statics] == STATICS
    del tables["sensors"]["other"]["mount"]
    tables["prior"] |= {"other_misalignment": {"sigma": 0.01}, "other_displacement": {"sigma": 1}}
    names = [b.name for b in make_scenario(tables, "two mounts").layout.statics]
    assert names == [*STATICS, "other_misalignment", "other_displacement"]


@pytest.mark.parametrize("name", STATICS)
def test_a_static_block_without_a_prior_is_named_with_its_path(name: str) -> None:
    with pytest.raises(ScenarioError) as raised:
        make_scenario(raw("prior", name), "no prior")
    (where, says), *others = raised.value.problems
    assert (where, others) == (f"prior.{name}", [])
    begin = "missing: every block needs a prior (it is static: no process advances it), as { mean"
    assert says.startswith(begin)
    # What it shows is one.
    tables = raw("prior", name)
    tables["prior"][name] = tomllib.loads(f"prior = {says.partition(', as ')[2]}")["prior"]
    make_scenario(tables, "as it says")


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("camera_misalignmnt", [0, 0, 0], "unknown block; the static ones of the state are gyro"),
        ("target_rate", [0, 0, 0], "the block is not static: a process advances it"),
        ("camera_misalignment", [1, 2], "found shape (2,), expected (3,)"),
        ("camera_misalignment", [2, 0, 0, 0], "expected a unit quaternion"),
        ("camera_displacement", ["1 deg", 0, 0], "found unit 'deg', expected one like 'm'"),
        ("camera_displacement", "1 cm", "found '1 cm', expected a list of values"),
    ],
)
def test_a_wrong_true_static_is_named_with_its_path(name: str, value: Any, message: str) -> None:
    with pytest.raises(ScenarioError) as raised:
        make_scenario(raw("truth", "statics", name, value=value), "wrong")
    assert message in dict(raised.value.problems)[f"truth.statics.{name}"]


def test_a_true_static_that_is_missing_or_given_twice_is_named() -> None:
    missing = make_scenario(raw("truth", "statics", "camera_displacement"), "missing")
    with pytest.raises(InputError, match=r"'camera' .* truth\.statics\.camera_displacement"):
        missing.simulate(0)
    twice = make_scenario(raw("truth", "statics", "gyro_bias", value=[0, 0, 0]), "twice")
    with pytest.raises(InputError, match=r"truth\.statics\.gyro_bias: found a value, but the tr"):
        twice.simulate(0)


@pytest.mark.parametrize("mount", ["", "a/b", "a b", "..\n"])
def test_a_mount_that_is_no_name_is_refused(mount: str) -> None:
    with pytest.raises(ScenarioError) as raised:
        make_scenario(raw("sensors", "camera", "mount", value=mount), "mount")
    found = dict(raised.value.problems)
    assert "expected a name" in found["sensors.camera"]
    assert repr(mount) in found["sensors.camera"]


def test_the_simulated_camera_is_mounted_as_the_truth_says() -> None:
    scenario = load_scenario(MOUNTING, SHORT)
    truth = scenario.simulate(0).truth
    assert truth is not None
    shift = np.array([0.03, -0.03, 0.026])
    np.testing.assert_allclose(truth.values["camera_misalignment"], np.tile(OFF, (12, 1, 1)))
    np.testing.assert_allclose(truth.values["camera_displacement"], np.tile(shift, (12, 1)))
    camera: Any = scenario.sensors["camera"]
    turned = replace(camera, sensor_attitude=so3.exp(np.array([0.1, 0.2, 0.3])))
    known = replace(
        turned,
        mounting="known",
        sensor_attitude=turned.sensor_attitude @ OFF,
        sensor_position=turned.sensor_position + shift,
    )
    rngs = (np.random.default_rng(1) for _ in range(2))
    seen, same = (
        measure("camera", s, Timing(), truth, r) for s, r in zip((turned, known), rngs, strict=True)
    )
    assert len(seen) == len(same) == 12
    for one, other in zip(seen, same, strict=True):
        np.testing.assert_allclose(one.z, other.z, rtol=0, atol=1e-9)


def test_a_mounting_may_be_taken_for_known_and_be_another_one() -> None:
    """The same measurements, whatever the estimators believe of the mounting."""
    estimated = load_scenario(MOUNTING, SHORT).simulate(0)
    scenario = load_scenario(MOUNTING, [*SHORT, "sensors.camera.mounting=known"])
    believed = scenario.simulate(0)
    assert [b.name for b in scenario.layout.statics] == STATICS[:2]
    assert believed.truth is not None
    assert not {*STATICS[2:]} & {*believed.truth.values}
    for one, other in zip(estimated.measurements, believed.measurements, strict=True):
        np.testing.assert_array_equal(one.z, other.z)
    tables = dict(scenario.raw)
    tables["truth"] = {k: v for k, v in tables["truth"].items() if k != "statics"}
    right = make_scenario(tables, "right").simulate(0)
    seen, same = (
        next(m for m in r.measurements if m.sensor == "camera") for r in (right, believed)
    )
    assert np.abs(seen.z - same.z).max() > 3  # pixels of half a degree and 5 cm
    mid = scenario.problem(believed, 0)
    assert mid.layout == scenario.layout


def test_recorded_data_may_have_true_statics_beside_them() -> None:
    """[truth] of [truth.statics] alone: nothing is simulated from it but sensors of [data]."""
    scenario = load_scenario(MOUNTING, SHORT)
    tables = {k: v for k, v in scenario.raw.items() if k != "inputs"}
    tables["truth"] = {"statics": tables["truth"]["statics"]}
    tables["data"] = {"reader": "starry_night", "simulate": ["camera"]}
    recorded = make_scenario(tables, "recorded", settings={})
    with pytest.raises(InputError, match=r"no \[truth\] and \[time\] to simulate from"):
        recorded.simulate(0)
    simulated = scenario.simulate(0)
    assert simulated.truth is not None
    values = {n: v for n, v in simulated.truth.values.items() if not n.startswith("camera_")}
    bare = replace(simulated, measurements=(), truth=replace(simulated.truth, values=values))
    completed = recorded.completed(bare, 0)
    assert completed.truth is not None
    assert completed.truth.values.keys() == simulated.truth.values.keys()
    wanted = [m for m in simulated.measurements if m.sensor == "camera"]
    for one, other in zip(completed.measurements, wanted, strict=True):
        np.testing.assert_array_equal(one.z, other.z)


def shortened(path: Path) -> None:
    """A table with its header and first row only."""
    lines = path.read_text("utf-8").splitlines()
    path.write_text("\n".join(lines[:2]) + "\n", "utf-8")


@pytest.mark.parametrize("change", [lambda path: None, shortened])
def test_true_statics_are_written_and_read_back(
    tmp_path: Path, change: Callable[[Path], None]
) -> None:
    """One row is enough for what is one value."""
    scenario = load_scenario(MOUNTING, SHORT)
    blocks = {b.name: b for b in scenario.layout}
    recording = scenario.simulate(0)
    models = scenario.sensors, scenario.input_columns, blocks
    write_dataset(tmp_path / "set", scenario.raw, recording, *models)
    (tmp_path / "set/dataset.toml").unlink()
    for name in STATICS:
        change(tmp_path / f"set/truth_{name}.csv")
    found = read_dataset(tmp_path / "set", *models, statics=scenario.layout.statics).truth
    assert found is not None
    assert recording.truth is not None
    for name in STATICS:
        np.testing.assert_allclose(
            found.values[name], recording.truth.values[name], rtol=0, atol=1e-15
        )


def test_a_truth_of_the_own_models_takes_statics_from_either_table() -> None:
    """The rate of the target obeys the inertia that is given."""

    def rates(truth: dict[str, Any]) -> Any:
        tables: dict[str, Any] = {
            "title": "own",
            "time": {"step": 1.0, "epochs": 30},
            "processes": {"target": {"kind": "euler_rotation", "torque_density": 1e-9}},
            "sensors": {"vision": {"kind": "vision_attitude", "seen_from": "fixed", "sigma": 0.01}},
            "prior": {
                n: {"sigma": 0.1} for n in ("target_attitude", "target_rate", "inertia_parameters")
            },
            "truth": {"kind": "own_models", **truth},
        }
        found = make_scenario(tables, "own").simulate(3).truth
        assert found is not None
        return found.values["target_rate"], found.values["inertia_parameters"]

    spin = {"target_rate": [0.05, 0.06, 0.02]}
    w, k = rates({"initial": spin, "statics": {"inertia_parameters": [0.3, -0.2]}})
    same, _ = rates({"initial": {**spin, "inertia_parameters": [0.3, -0.2]}})
    other, _ = rates({"initial": spin})
    np.testing.assert_array_equal(k, np.tile([0.3, -0.2], (30, 1)))
    np.testing.assert_array_equal(w, same)
    assert np.abs(w - other).max() > 1e-3
    both = {"initial": {"inertia_parameters": [0, 0]}, "statics": {"inertia_parameters": [0, 0]}}
    with pytest.raises(InputError, match=r"truth\.statics\.inertia_parameters: found a value"):
        rates(both)
