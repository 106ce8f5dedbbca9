"""Trajectories of TUM, EuRoC and KITTI: roles, quaternion orders, stamps; poses and covariances."""

from __future__ import annotations

import logging
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pose_tracks import IN_ORBIT, pose_track, rotations
from relnav_factors.sensors.pose_measurement import PoseMeasurement
from relnav_factors.sensors.position_fix import PositionFix
from relnav_factors.sensors.star_tracker import StarTracker
from scipy.spatial.transform import Rotation

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import RELATIVE_ATTITUDE, RELATIVE_POSITION_T
from relnav_graph.core.track import Recording, Track
from relnav_graph.errors import InputError
from relnav_graph.io.clocks import Clock, nanoseconds
from relnav_graph.io.known import Known
from relnav_graph.io.poses import from_mrp, in_body_axes, in_fixed_axes, pose_covariance_of_inverse
from relnav_graph.io.readers import read_raw
from relnav_graph.io.track_poses import pose_of
from relnav_graph.io.writers import write_track
from relnav_graph.maths import so3
from relnav_graph.maths.instants import Instant

TRUTH = {"position": "relative_position", "attitude": "relative_attitude"}
#: A quarter turn about z: x of the body is y of the frame.
Q = {"xyzw": "0 0 0.70710678 0.70710678", "wxyz": "0.70710678,0,0,0.70710678"}
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
UNIX = "1403636579.763555584"


def tum(folder: Path, *rows: str) -> Path:
    path = folder / "pose.tum"
    path.write_text("# timestamp tx ty tz qx qy qz qw\n" + "\n".join(rows) + "\n")
    return path


def euroc(folder: Path, stamps: tuple[int, ...], more: str = "") -> Path:
    states, imu = folder / "state_groundtruth_estimate0", folder / "imu0"
    for sub in (states, imu):
        sub.mkdir(parents=True)
    rows = [f"{s},1,2,3,{Q['wxyz']}{more}" for s in stamps]
    (states / "data.csv").write_text("#timestamp, p_RS_R_x [m], ...\n" + "\n".join(rows) + "\n")
    rows = [f"{s},{k},0,0,0,0,{10 * k}" for k, s in enumerate(stamps)]
    (imu / "data.csv").write_text("#timestamp [ns],w_RS_S_x\r\n" + "\r\n".join(rows) + "\r\n")
    return folder


def truth_of(recording: Recording, name: str) -> Array:
    assert recording.truth is not None
    return recording.truth.values[name]


def test_a_tum_file_has_its_scalar_last_and_its_decimals_are_subtracted(tmp_path: Path) -> None:
    path = tum(tmp_path, f"{UNIX} 1 2 3 {Q['xyzw']}", f"1403636580.763555585 1 2 4 {Q['xyzw']}")
    found = read_raw("tum", path, {"truth": TRUTH, "clock": "unix"})
    # 0.763555584 is not what float64 makes of the difference of such stamps.
    assert found.times.tolist() == [0.763555584, 1.763555585]
    assert found.epoch == Instant.parse("2014-06-24T19:02:59 UTC")
    np.testing.assert_allclose(truth_of(found, "relative_attitude")[0], QUARTER, atol=1e-8)
    np.testing.assert_array_equal(truth_of(found, "relative_position")[1], [1, 2, 4])


def test_the_inverse_of_a_pose(tmp_path: Path) -> None:
    path = tum(tmp_path, f"0 1 2 3 {Q['xyzw']}")
    found = read_raw("tum", path, {"truth": TRUTH, "inverse": True})
    np.testing.assert_allclose(truth_of(found, "relative_attitude")[0], QUARTER.T, atol=1e-8)
    np.testing.assert_allclose(truth_of(found, "relative_position")[0], [-2, 1, -3], atol=1e-7)


def test_euroc_loses_no_nanosecond_and_has_its_scalar_first(tmp_path: Path) -> None:
    stamps = (1403636579763555584, 1403636579763555585, 1403636580000000001)
    folder = euroc(tmp_path, stamps, ",4,5,6,0.1,0.2,0.3,7,8,9")
    found = read_raw(
        "euroc",
        folder,
        {
            "truth": TRUTH | {"velocity": "relative_velocity", "rate_bias": "gyro_bias"},
            "inputs": {"rate": "gyro", "acceleration": "force"},
        },
    )
    assert found.times.tolist() == [0.763555584, 0.763555585, 1.000000001]
    np.testing.assert_allclose(truth_of(found, "relative_attitude")[0], QUARTER, atol=1e-8)
    np.testing.assert_array_equal(truth_of(found, "gyro_bias")[2], [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(truth_of(found, "relative_velocity")[2], [4, 5, 6])
    gyro = found.inputs["gyro"]  # a row is the mean since the row before
    assert gyro.t_start.tolist() == found.times[:-1].tolist()
    assert gyro.values[:, 0].tolist() == [1, 2]
    instant = read_raw("euroc", folder, {"inputs": {"acceleration": "f"}, "samples": "instant"})
    assert instant.inputs["f"].values[:, 2].tolist() == [5, 15]


def test_kitti_takes_times_from_a_file_or_a_rate(tmp_path: Path) -> None:
    rows = ["0 -1 0 7 1 0 0 8 0 0 1 9", "1 0 0 1 0 1 0 2 0 0 1.0000004 3"]
    (tmp_path / "00.txt").write_text("\n".join(rows) + "\n")
    (tmp_path / "times.csv").write_text("0.000000e+00\n1.036224e-01\n")
    found = read_raw("kitti", tmp_path, {"truth": TRUTH, "times": "times.csv"})
    assert found.times.tolist() == [0.0, 0.1036224]
    np.testing.assert_allclose(truth_of(found, "relative_attitude")[0], QUARTER, atol=1e-12)
    np.testing.assert_array_equal(truth_of(found, "relative_position")[0], [7, 8, 9])
    R = truth_of(found, "relative_attitude")[1]
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-14)
    timed = read_raw("kitti", tmp_path / "00.txt", {"truth": TRUTH, "rate": "10 Hz"})
    assert timed.times.tolist() == [0.0, 0.1]
    with pytest.raises(InputError, match="found neither of times, a file, and rate"):
        read_raw("kitti", tmp_path / "00.txt", {"truth": TRUTH})


KNOWN = Known(
    sensors={
        "board": PoseMeasurement(position_sigma=np.ones(3), attitude_sigma=np.ones(3)),
        "fix": PositionFix(sigma=np.ones(3)),
        "stars": StarTracker(sigma=np.ones(3)),
    }
)


@pytest.mark.parametrize(
    ("name", "z"),
    [
        ("board", [1, 2, 3, 0.5**0.5, 0, 0, 0.5**0.5]),
        ("fix", [1, 2, 3]),
        ("stars", [0.5**0.5, 0, 0, 0.5**0.5]),
    ],
)
def test_what_a_sensor_measures_its_columns_say(tmp_path: Path, name: str, z: list[float]) -> None:
    path = tum(tmp_path, f"0.5 1 2 3 {Q['xyzw']}", f"1 1 2 3 {Q['xyzw']}")
    found = read_raw("tum", path, {"measured": name}, KNOWN)
    assert [(m.sensor, m.t) for m in found.measurements] == [(name, 0.5), (name, 1.0)]
    np.testing.assert_allclose(found.measurements[0].z, [z], atol=1e-8)
    assert found.truth is None


BAD: dict[str, tuple[str, dict[str, Any], str]] = {
    "no role": (f"0 1 2 3 {Q['xyzw']}", {}, r"states without a role, expected truth = \{"),
    "long": ("0 1 2 3 0 0 0.8 0.7", {"truth": TRUTH}, "pose.tum, line 2: found the quaternion"),
    "short": ("0 1 2 3 0 0 1", {"truth": TRUTH}, "line 2: found 7 columns, expected 8: timestamp"),
    "word": ("0 1 2 x 0 0 0 1", {"truth": TRUTH}, "line 2: could not convert string .*'x'"),
    "nan": ("0 1 2 nan 0 0 0 1", {"truth": TRUTH}, "line 2: found a number that is not finite"),
    "time": ("now 1 2 3 0 0 0 1", {"truth": TRUTH}, "line 2: found 'now', expected a time"),
    "undeclared": (f"{UNIX} 1 2 3 0 0 0 1", {"truth": TRUTH}, "expected data.options.clock, the c"),
    "boot": ("12 1 2 3 0 0 0 1", {"truth": TRUTH, "clock": "unix"}, 'before 1972; .*"none"'),
    "ms": ("1750000.1 1 2 3 0 0 0 1", {"truth": TRUTH, "clock": "unix"}, "in s, not in ms.*none"),
    "ns": ("1403636580863555584 1 2 3 0 0 0 1", {"truth": TRUTH, "clock": "unix"}, "stamps in s?"),
    "clock": (
        "0 1 2 3 0 0 0 1",
        {"truth": TRUTH, "clock": "utc"},
        "found 'utc', expected one of n",
    ),
    "quantity": ("0 1 2 3 0 0 0 1", {"truth": {"rate": "w"}}, "found 'rate', expected one of posi"),
    "sensor": ("0 1 2 3 0 0 0 1", {"measured": "bored"}, "found 'bored', .* board, fix, stars"),
    "other": ("0 1 2 3 0 0 0 1", {"measured": {"pose": "fix"}}, "a pose for 'fix', which meas"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_refused(tmp_path: Path, name: str) -> None:
    row, options, message = BAD[name]
    with pytest.raises(InputError, match=message) as caught:
        read_raw("tum", tum(tmp_path, row), options, KNOWN)
    assert name != "boot" or "in ms" not in str(caught.value)


def test_an_option_that_a_reader_needs_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"reader 'ros': found no option 'topics', expected it"):
        read_raw("ros", tmp_path, {})


def test_times_that_do_not_rise(tmp_path: Path) -> None:
    path = tum(tmp_path, f"1 1 2 3 {Q['xyzw']}", f"1 1 2 3 {Q['xyzw']}")
    with pytest.raises(InputError, match=r"line 3: found a time that is not after"):
        read_raw("tum", path, {"truth": TRUTH})


def test_a_block_that_the_scenario_does_not_have_is_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    blocks = {b.name: b for b in (RELATIVE_ATTITUDE, RELATIVE_POSITION_T)}
    path = tum(tmp_path, f"0 1 2 3 {Q['xyzw']}")
    with caplog.at_level(logging.WARNING):
        read_raw("tum", path, {"truth": {"position": "relative_positon"}}, Known(blocks=blocks))
    assert "is 'relative_position' meant?" in caplog.text


def test_a_track_through_tum_has_the_same_bits(tmp_path: Path) -> None:
    track, path = pose_track(), tmp_path / "out.tum"
    write_track("tum", track, path)
    found = read_raw("tum", path, {"truth": TRUTH})
    np.testing.assert_array_equal(found.times, track.t)
    np.testing.assert_array_equal(
        truth_of(found, "relative_position"), track.value("relative_position")
    )
    apart = RELATIVE_ATTITUDE.local(
        truth_of(found, "relative_attitude"), track.value("relative_attitude")
    )
    assert np.abs(apart).max() < 1e-15
    # As an independent reader has it: scalar last.
    table = np.loadtxt(path)
    matrices = Rotation.from_quat(table[:, 4:]).as_matrix()
    np.testing.assert_allclose(matrices, track.value("relative_attitude"), atol=1e-15)
    # The stamps of another clock, and back.
    write_track("tum", track, path, origin="1403636579")
    again = read_raw("tum", path, {"truth": TRUTH, "clock": "unix"})
    np.testing.assert_array_equal(again.times, track.t)
    assert "1403636579.0" in path.read_text()
    write_track("tum", track, path, epoch="2014-06-24T19:02:59 UTC")
    assert path.read_text().splitlines()[2].startswith("1403636579.0")
    same = read_raw("tum", path, {"truth": TRUTH, "clock": "unix"})
    np.testing.assert_array_equal(same.times, track.t)
    path.write_text("0 1 2 3 0 0 0 1\n")  # somebody's own
    with pytest.raises(InputError, match=r"out\.tum: is not of this package"):
        write_track("tum", track, path)


def test_a_leap_second_and_whole_nanoseconds() -> None:
    clock = Clock("unix")
    stamps = np.array([1483228799, 1483228800, 1483228801], dtype=np.int64) * 10**9
    begin = clock.begin("", int(stamps[0]))
    assert clock.seconds(stamps, begin).tolist() == [0.0, 2.0, 3.0]  # 23:59:60 in between
    assert clock.seconds([Decimal(int(s)) / 10**9 for s in stamps], begin).tolist() == [0, 2, 3]
    ns = nanoseconds(np.array([0.1, 1.000000001]), "1403636579")
    assert ns.tolist() == [1403636579100000000, 1403636580000000001]
    # Before the leap second and after it; within it Unix time has the stamps of the next one.
    midnight = "2016-12-31T23:59:59.5 UTC"
    late = nanoseconds(np.array([0.0, 2.0]), epoch=midnight)
    assert (late - 10**9 * 1483228799).tolist() == [500000000, 1500000000]
    with pytest.raises(InputError, match="found a leap second at t = 2 s"):
        nanoseconds(np.array([0.0, 1.0, 2.0]), epoch=midnight)
    gps = Clock("gps").settings(Decimal(1000000000))["time"]["epoch"]
    assert Instant.parse(gps) == Instant.parse("2011-09-14T01:46:25 UTC")


def samples_of_pose(R: Array, P: Array, fixed: bool, count: int) -> tuple[Array, Array]:
    """Draws of places and attitudes whose errors have the covariance P, by definition."""
    rng = np.random.default_rng(1)
    e = rng.multivariate_normal(np.zeros(6), P, size=count)
    small = Rotation.from_rotvec(e[:, 3:])
    turned = small * Rotation.from_matrix(R) if fixed else Rotation.from_matrix(R) * small
    return e[:, :3], turned.as_matrix()


def scatter(places: Array, attitudes: Array, R: Array) -> Array:
    """The covariance of draws about a pose at rest in the origin: right perturbations."""
    d = Rotation.from_matrix(R.T @ attitudes).as_rotvec()
    return np.cov(np.hstack([places, d]).T)


def test_covariances_about_fixed_axes_are_those_of_draws() -> None:
    rng = np.random.default_rng(0)
    R = rotations(1, rng)
    root = rng.normal(size=(6, 6)) * 1e-3
    P = root @ root.T
    places, attitudes = samples_of_pose(R[0], P, True, 200_000)
    want = scatter(places, attitudes, R[0])
    found = in_body_axes(R, P[None])[0]
    np.testing.assert_allclose(found, want, atol=0.02 * np.sqrt(np.outer(*2 * [np.diag(P)])).max())
    assert np.abs(want - P).max() > 0.1 * np.abs(P).max()  # the frames differ
    np.testing.assert_allclose(in_fixed_axes(R, found[None])[0], P, atol=1e-18)


def test_the_covariance_of_an_inverse_is_that_of_draws() -> None:
    rng = np.random.default_rng(2)
    R, r = rotations(1, rng)[0], np.array([3.0, -2.0, 1.0])
    root = rng.normal(size=(6, 6)) * 1e-3
    P = root @ root.T
    e, attitudes = samples_of_pose(R, P, False, 200_000)
    back = attitudes.transpose(0, 2, 1)
    places = -np.einsum("nij,nj->ni", back, r + e)
    want = scatter(places, back, R.T)
    found = pose_covariance_of_inverse(R.T[None], -(R.T @ r)[None], P[None])[0]
    scale = np.sqrt(np.outer(np.diag(want), np.diag(want)))
    assert (np.abs(found - want) / scale).max() < 0.02


def test_modified_rodrigues_parameters_are_those_of_others() -> None:
    mrp = np.random.default_rng(3).normal(size=(20, 3))
    want = Rotation.from_mrp(mrp).as_matrix()
    np.testing.assert_allclose(from_mrp(mrp), want, atol=1e-14)
    # [BN] of Schaub and Junkins, eq. 3.147, takes N to B: the transpose.
    s = mrp[0]
    cross, square = so3.skew(s), s @ s
    BN = np.eye(3) + (8 * cross @ cross - 4 * (1 - square) * cross) / (1 + square) ** 2
    np.testing.assert_allclose(from_mrp(mrp)[0], BN.T, atol=1e-14)


def test_a_pose_that_derives_from_others_has_their_joint_covariance() -> None:
    track = pose_track(IN_ORBIT)
    pose = pose_of(track).motion
    steps = 1e-6 * np.eye(9)
    numeric = np.empty((6, 9))
    for j, step in enumerate(steps):
        moved = [one_pose(track, sign * step) for sign in (1, -1)]
        numeric[:3, j] = (moved[0][0] - moved[1][0]) / 2e-6
        numeric[3:, j] = so3.log(moved[1][1].T @ moved[0][1]) / 2e-6
    want = numeric @ track.P[0] @ numeric.T
    np.testing.assert_allclose(pose.covariances["pose"][0], want, rtol=1e-6, atol=1e-9)


def one_pose(track: Track, step: Array) -> tuple[Array, Array]:
    """r_tc_t and R_tc at the first epoch, displaced."""
    x = track.layout.values(track.layout.retract(track.x[0], step))
    R_ot = x["target_attitude"]
    return R_ot.T @ x["relative_position"], R_ot.T @ x["chaser_attitude"]


def test_what_a_track_does_not_have(tmp_path: Path) -> None:
    track = pose_track(IN_ORBIT)
    for options, message in (
        ({"attitude": "spin"}, "found 'spin' as attitude, expected one of chaser_attitude"),
        ({"attitude": "chaser_attitude"}, "found position_in_target in t and chaser_attitude to o"),
    ):
        with pytest.raises(InputError, match=message):
            write_track("tum", track, tmp_path / "x.tum", **options)
    lost = pose_track()
    lost.x[3, 10] = np.nan
    with pytest.raises(InputError, match=r"t = 0\.3\d* s: found a position that is not finite"):
        write_track("tum", lost, tmp_path / "x.tum")
    assert not (tmp_path / "x.tum").exists()
