"""Data of another convention or unit than they were read in: named, where they cannot fit."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from board import BOARD
from passes import ZHANG, recorded
from scipy.spatial.transform import Rotation

import relnav_graph as rg
from relnav_graph.arrays import Array
from relnav_graph.report.contents import PassContents, read_contents
from relnav_graph.runs.comparison import compare, compare_pass
from relnav_graph.runs.outputs import Drawing, write_outputs
from relnav_graph.runs.passes import open_pass
from relnav_graph.scenario.build import load_scenario

Turn = Callable[[Array, Array], tuple[Array, Array]]
SCENARIO = (
    BOARD
    + """
[prior]
relative_attitude = { mean = "measured", sigma = "60 deg" }
relative_position = { mean = "measured", sigma = "10 m" }
relative_velocity = { mean = [0, 0, 0], sigma = "1 m/s" }
gyro_bias = { mean = [0, 0, 0], sigma = "100 deg/h" }
"""
)


def _drawn(turn: Turn, count: int = 40, size: float = 1.0) -> tuple[Array, Array, Array]:
    """Times (N,), poses (N, 7), their r (N, 3), q_wxyz (N, 4) as `turn` has them, and rates (N, 3)
    of a pass that turns: of `count` epochs, and rates that are `size` times as large."""
    rng, t = np.random.default_rng(0), np.arange(float(count))
    R = Rotation.from_rotvec([0.5, -0.2, 0.1])
    rate = np.array([0.01, 0.02, 0.05]) + 0.03 * np.sin(0.2 * t)[:, None] * [1, -1, 0.5]
    rate *= size
    q = [R]
    for w in rate[1:]:
        R = R * Rotation.from_rotvec(w)
        q.append(R)
    noise = Rotation.from_rotvec(np.deg2rad(1.0) * rng.normal(size=(count, 3)))
    q_wxyz = (Rotation.concatenate(q) * noise).as_quat(scalar_first=True)
    r = [10, -4, 2] + np.outer(t, [-0.1, 0.03, 0]) + 0.1 * rng.normal(size=(count, 3))
    return t, np.hstack(turn(r, q_wxyz)), rate


def _as_they_are(a: Array, *others: Array) -> Any:
    return (a, *others) if others else a


def _written(
    folder: Path,
    turn: Turn = _as_they_are,
    sampled: Callable[[Array], Array] = _as_they_are,
    scenario: str = SCENARIO,
    **options: Any,
) -> dict[str, Any]:
    """The summary of that pass, as tables, its rates as `sampled` has them."""
    (folder / "data").mkdir()
    t, poses, rate = _drawn(turn, **options)
    rate = sampled(rate)
    for name, columns, values in (
        ("board", "t_s,x_m,y_m,z_m,q_w,q_x,q_y,q_z", poses),
        ("gyro", "t_s,wx_rad_s,wy_rad_s,wz_rad_s", rate),
    ):
        table = np.column_stack([t, values])
        np.savetxt(
            folder / "data" / f"{name}.csv", table, "%.12g", ",", header=columns, comments=""
        )
    (folder / "a.toml").write_text(scenario)
    return compare(folder / "a.toml", ["ekf", "batch"], data=folder / "data").summary


def _inverse(r: Array, q: Array) -> tuple[Array, Array]:
    R = Rotation.from_quat(q, scalar_first=True).inv()
    return -R.apply(r), R.as_quat(scalar_first=True)


def _turned(q: Array, r: Array, order: list[int], sign: int = 1) -> tuple[Array, Array]:
    return r, (q * [1, sign, sign, sign])[:, order]


OURS, LAST, FIRST = [0, 1, 2, 3], [1, 2, 3, 0], [3, 0, 1, 2]
QUATERNIONS = "the quaternions of 'board' are "
#: What poses may have been written as, and what they are called.
POSES: list[tuple[Turn, str]] = [
    (lambda r, q: _turned(q, r, OURS, -1), QUATERNIONS + "those of the inverse rotation:"),
    (lambda r, q: _turned(q, r, LAST), QUATERNIONS + "written with the scalar last:"),
    (lambda r, q: _turned(q, r, LAST, -1), "scalar last and those of the inverse rotation:"),
    (lambda r, q: _turned(q, r, FIRST), QUATERNIONS + "written with the scalar first:"),
    (lambda r, q: (1000 * r, q), "'board' is in mm:"),
    (_inverse, "'board' has the inverse pose:"),
    (lambda r, q: (_inverse(r, q)[0], q), "places of 'board' are inverse:"),
    (
        lambda r, q: _turned(*_inverse(r, q)[::-1], LAST),
        "'board' has the inverse pose, its quaternion written with the scalar last:",
    ),
]
#: The same of rates.
RATES: list[tuple[Callable[[Array], Array], str]] = [
    (np.rad2deg, "'gyro' is in deg/s:"),
    (np.deg2rad, "'gyro' is in rad/s, and was taken for deg/s:"),
    (np.negative, "'gyro' has the other sign:"),
    (lambda w: w[:, [1, 0, 2]], "x, y, z are y, x, z of 'gyro':"),
    (lambda w: w[:, [1, 2, 0]] * [1, -1, 1], "x, y, z are z, x, -y of 'gyro':"),
    (lambda w: w * [1, 1, -1], "x, y, z are x, y, -z of 'gyro':"),
]


def _texts(found: dict[str, Any]) -> list[str]:
    return [c["text"] for c in found["cautions"] if c["name"] == "other convention"]


def test_nothing_is_said_of_what_fits(tmp_path: Path) -> None:
    found = _written(tmp_path)
    assert found["estimators"]["batch"]["status"] == "ok"
    assert _texts(found) == []


@pytest.mark.parametrize(("turn", "says"), POSES)
def test_the_convention_of_poses_that_fits_is_named(tmp_path: Path, turn: Turn, says: str) -> None:
    (text,) = _texts(_written(tmp_path, turn))
    assert text.startswith("the mean square of a filter's innovations, in their own sigmas, is ")
    assert says in text
    assert f" if {says}" in text or not says.startswith(("'", QUATERNIONS))


@pytest.mark.parametrize(("sampled", "says"), RATES)
def test_the_convention_of_rates_that_fits_is_named(
    tmp_path: Path, sampled: Callable[[Array], Array], says: str
) -> None:
    (text,) = _texts(_written(tmp_path, sampled=sampled))
    assert f" if {says} is it so?" in text


@pytest.mark.parametrize(
    ("sampled", "says"),
    [(_as_they_are, ""), RATES[2], (lambda w: w * [-1, 1, 1], "x, y, z are -x, y, z of 'gyro':")],
)
def test_where_the_gyro_says_little_likelihoods_tell(
    tmp_path: Path, sampled: Callable[[Array], Array], says: str
) -> None:
    """A chaser that turns by less than the camera sees: all estimates are ok."""
    found = _written(tmp_path, sampled=sampled, count=900, size=0.08)
    assert {row["status"] for row in found["estimators"].values()} == {"ok"}
    assert [says in text for text in _texts(found)] == [True] * bool(says)


def test_noise_that_is_larger_than_declared_has_no_convention(tmp_path: Path) -> None:
    """It fits as badly, and nothing else fits better."""
    rng = np.random.default_rng(4)
    found = _written(tmp_path, lambda r, q: (r + rng.normal(size=r.shape), q))
    assert found["estimators"]["ekf"]["status"] != "ok"
    assert _texts(found) == []


GATED = SCENARIO.replace("[prior]", "gate = 0.999\n[prior]")


@pytest.mark.parametrize("size", [10, 30])
def test_a_filter_that_its_gates_have_lost_tells_no_convention(size: int) -> None:
    """A quarter of outliers: after a filter has rejected all else, what is left fits any gyro."""
    outliers = f"sensors.beacons.outliers={{fraction=0.25,size={size}}}"
    scenario = load_scenario(ZHANG, [outliers, "sensors.beacons.gate=0.999", "time.epochs=120"])
    track = rg.run_estimator("ekf", scenario.problem(scenario.simulate(0), 0))
    assert track.rejected["beacons"] > 0
    assert [c for c in track.cautions if c.name == "other convention"] == []


def test_a_gyro_that_is_worse_than_declared_is_of_no_other_unit(tmp_path: Path) -> None:
    """Of a chaser that does not turn; in deg/s it would say nothing, which fits better, too."""
    rng = np.random.default_rng(3)

    def sampled(w: Array) -> Array:
        return np.asarray(w + np.deg2rad(0.15) * rng.normal(size=w.shape))

    found = _written(tmp_path, sampled=sampled, count=900, size=0.0)
    assert _texts(found) == []


def test_gates_hide_no_convention(tmp_path: Path) -> None:
    (text,) = _texts(_written(tmp_path, POSES[1][0], scenario=GATED))
    assert f" if {POSES[1][1]}" in text


@pytest.mark.parametrize(("noise", "unit", "told"), [(1, 1, 0), (10, 1, 0), (1, 1000, 1)])
def test_noise_that_a_smaller_unit_shrinks_is_no_sign_of_it(
    noise: float, unit: float, told: int
) -> None:
    """Places in mm are smaller by a thousand, and so is what they scatter by."""
    rng, t = np.random.default_rng(0), np.arange(200.0)
    r = [10, -4, 2] + np.outer(t, [-0.1, 0.03, 0]) + 0.1 * noise * rng.normal(size=(200, 3))
    problem = rg.Problem.from_arrays(
        processes={"move": {"kind": "white_noise_acceleration", "acceleration_density": 1e-3}},
        sensors={"fix": {"kind": "position_fix", "sigma": 0.1}},
        measurements={"fix": (t, unit * r)},
        prior={"relative_position": (unit * r[0], 10 * unit), "relative_velocity": ([0, 0, 0], 1)},
    )
    names = [c.name for c in rg.run_estimator("ekf", problem).cautions]
    assert names.count("other convention") == told


@pytest.mark.parametrize("mean", ["measured", [0.96, 0.25, -0.1, 0.05]])
@pytest.mark.parametrize("swapped", [False, True])
def test_arrays_in_another_order_are_named_by_the_track(swapped: bool, mean: Any) -> None:
    """Where nothing is compared and no file is read."""
    tables = tomllib.loads(SCENARIO)
    t, poses, rate = _drawn(lambda r, q: (r, q[:, [1, 2, 3, 0] if swapped else [0, 1, 2, 3]]))
    unit = mean if mean == "measured" else mean / np.linalg.norm(mean)
    tables["prior"]["relative_attitude"]["mean"] = unit
    problem = rg.Problem.from_arrays(
        processes=tables["processes"],
        sensors=tables["sensors"],
        measurements={"board": (t, poses)},
        inputs={"gyro": (t, rate[1:])},
        prior=tables["prior"],
    )
    assert problem.measured[-1] == "relative_position"
    for kind in ("ekf", "incremental"):
        track = rg.run_estimator(kind, problem)
        names = ["other convention"] if swapped else []
        assert (track.status == "ok", [c.name for c in track.cautions]) == (not swapped, names)
        assert track.smoothed is None or track.smoothed.cautions[:1] == track.cautions[:1]
        shown = " ".join(repr(track).split())
        assert ("of 'board' are written with the scalar last: is it so?" in shown) == swapped


def test_what_is_written_of_the_pass_has_the_caution(tmp_path: Path) -> None:
    """So that a report of the folder says it, too."""
    found = _written(tmp_path, lambda r, q: (r, q[:, [1, 2, 3, 0]]))
    opened = open_pass(tmp_path / "a.toml", data=tmp_path / "data")
    again = compare_pass(opened, ["ekf", "batch"])
    write_outputs(tmp_path / "out", opened, again, drawing=Drawing(formats=()))
    content = read_contents(tmp_path / "out")
    assert isinstance(content, PassContents)
    names = [c["name"] for c in content.summary["cautions"] if c["estimator"] is None]
    assert "other convention" in names or "attitude turns otherwise" in names
    assert [c["name"] for c in found["cautions"] if c["estimator"] is None] == names


def test_recorded_attitudes_that_are_right_are_not_doubted() -> None:
    """starloc's filter ends degraded, by outliers; its camera has no attitudes, astrobee's has."""
    for name in ("starloc", "astrobee_tumble"):
        scenario = load_scenario(name)
        found = rg.compare(scenario, ["ekf"], data=recorded(name)).summary
        assert [c for c in found["cautions"] if c["name"] == "other convention"] == []
