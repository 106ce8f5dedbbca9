"""Bags of ROS 1 and ROS 2, and MCAP: written by rosbags and read by us, and the other way round."""

from __future__ import annotations

import struct
import sys
from binascii import crc32
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pose_tracks import IN_ORBIT, pose_track
from scipy.spatial.transform import Rotation

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import RELATIVE_ATTITUDE, RELATIVE_POSITION
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Recording, Track
from relnav_graph.errors import InputError
from relnav_graph.io.readers import read_raw
from relnav_graph.io.writers import by_suffix, write_track
from relnav_graph.maths.instants import Instant

rosbags = pytest.importorskip("rosbags.highlevel")
from rosbags import rosbag1, rosbag2, typesys  # noqa: E402

FIRST = 1403636579763555584
STAMPS = [FIRST, FIRST + 2_000_001, FIRST + 10**9]
LATE = 40_000_001
RNG = np.random.default_rng(0)
TURNS = Rotation.from_rotvec(RNG.normal(size=(3, 3)))
PLACES, SPINS, SPEEDS = RNG.normal(size=(3, 3, 3))
ROOTS = RNG.normal(size=(3, 6, 6))
COVARIANCES = ROOTS @ ROOTS.transpose(0, 2, 1)
FORMS = ("ros1", "mcap", "sqlite3")


def messages(store: Any, ros1: bool) -> dict[str, tuple[str, list[Any]]]:
    """By topic, the type and a message for each of the stamps."""
    T = store.types
    geometry, nothing = "geometry_msgs/msg/", np.zeros(9)

    def vector(name: str, v: Array) -> Any:
        return T[geometry + name](*v.tolist())

    def made(k: int) -> dict[str, tuple[str, Any]]:
        second, ns = divmod(STAMPS[k], 10**9)
        stamp = T["builtin_interfaces/msg/Time"](second, ns)
        seq = (0,) if ros1 else ()
        header = T["std_msgs/msg/Header"](*seq, stamp, "vicon")
        q = T[geometry + "Quaternion"](*TURNS[k].as_quat().tolist())  # x, y, z, w
        pose = T[geometry + "Pose"](vector("Point", PLACES[k]), q)
        twist = T[geometry + "Twist"](vector("Vector3", SPEEDS[k]), vector("Vector3", SPINS[k]))
        own = COVARIANCES[k].reshape(-1)
        with_P = T[geometry + "PoseWithCovariance"](pose, own)
        of_twist = T[geometry + "TwistWithCovariance"](twist, own)
        missing = np.array([-1.0, *nothing[1:]])
        w, f = vector("Vector3", SPINS[k]), vector("Vector3", SPEEDS[k])
        imu = T["sensor_msgs/msg/Imu"](header, q, missing, w, nothing, f, nothing)
        return {
            "/pose": (geometry + "PoseStamped", T[geometry + "PoseStamped"](header, pose)),
            "/pose_cov": (
                geometry + "PoseWithCovarianceStamped",
                T[geometry + "PoseWithCovarianceStamped"](header, with_P),
            ),
            "/twist": (
                geometry + "TwistWithCovarianceStamped",
                T[geometry + "TwistWithCovarianceStamped"](header, of_twist),
            ),
            "/odom": (
                "nav_msgs/msg/Odometry",
                T["nav_msgs/msg/Odometry"](header, "base", with_P, of_twist),
            ),
            "/point": (
                geometry + "PointStamped",
                T[geometry + "PointStamped"](header, vector("Point", PLACES[k])),
            ),
            "/imu": ("sensor_msgs/msg/Imu", imu),
            "/time": ("std_msgs/msg/Header", header),
        }

    parts = [made(k) for k in range(len(STAMPS))]
    return {name: (parts[0][name][0], [p[name][1] for p in parts]) for name in parts[0]}


def bag(folder: Path, form: str, again: bool = False, zipped: bool = False) -> Path:
    """A bag as rosbags writes it by itself; each message is received a little later."""
    ros1 = form == "ros1"
    stores = typesys.Stores
    store = typesys.get_typestore(stores.ROS1_NOETIC if ros1 else stores.ROS2_HUMBLE)
    path = folder / ("pass.bag" if ros1 else "pass")
    plugin = rosbag2.StoragePlugin.MCAP if form == "mcap" else rosbag2.StoragePlugin.SQLITE3
    writer: Any = (
        rosbag1.Writer(path) if ros1 else rosbag2.Writer(path, version=8, storage_plugin=plugin)
    )
    if zipped:
        writer.set_compression(rosbag2.CompressionMode.STORAGE, rosbag2.CompressionFormat.ZSTD)
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    with writer:
        for name, (kind, rows) in messages(store, ros1).items():
            connection = writer.add_connection(name, kind, typestore=store)
            for stamp, message in zip(STAMPS, rows, strict=True):
                for _ in range(1 + again):
                    writer.write(connection, stamp + LATE, serialize(message, kind))
    return path


def read(path: Path, topic: str, role: dict[str, Any], **options: Any) -> Recording:
    return read_raw("ros", path, {"topics": {topic: role}, **options})


def truth_of(path: Path, topic: str, *quantities: str, clock: str = "unix") -> dict[str, Array]:
    """True values by quantity, and sigmas by "sigma_" and the quantity."""
    found = read(path, topic, {"truth": {q: q for q in quantities}}, clock=clock).truth
    assert found is not None
    return {**found.values, **{f"sigma_{n}": s for n, s in found.sigmas.items()}}


@pytest.mark.parametrize("form", FORMS)
def test_all_messages_of_a_bag_that_another_has_written(tmp_path: Path, form: str) -> None:
    path, R = bag(tmp_path, form), TURNS.as_matrix()
    roles = {"/pose": {"truth": {"position": "r", "attitude": "R"}}}
    roles["/imu"] = {"inputs": {"rate": "gyro", "acceleration": "force"}, "samples": "instant"}  # type: ignore[dict-item]
    roles["/point"] = {"measured": {"position": "fix"}}
    found = read_raw("ros", tmp_path, {"topics": roles, "arrival": True})
    assert found.times.tolist() == [0.763555584, 0.765555585, 1.763555584]
    assert found.epoch == Instant.parse("2014-06-24T19:02:59 UTC")
    assert found.truth is not None
    np.testing.assert_allclose(found.truth.values["R"], R, atol=1e-15)
    np.testing.assert_array_equal(found.truth.values["r"], PLACES)
    np.testing.assert_array_equal(found.inputs["gyro"].values, 0.5 * (SPINS[1:] + SPINS[:-1]))
    np.testing.assert_array_equal(found.inputs["force"].t_end, found.times[1:])
    np.testing.assert_array_equal(np.vstack([m.z for m in found.measurements]), PLACES)
    assert [m.t_arrival for m in found.measurements] == [0.803555585, 0.805555586, 1.803555585]
    # An Imu whose orientation is not given has none.
    with pytest.raises(InputError, match="found 'attitude', expected one of rate, acceleration"):
        truth_of(path, "/imu", "attitude")
    # That of a twist is in the frame of the header, that of an odometry in the child's.
    twist, odom = (truth_of(path, name, "velocity", "rate") for name in ("/twist", "/odom"))
    np.testing.assert_array_equal(twist["velocity"], SPEEDS)
    np.testing.assert_array_equal(twist["rate"], SPINS)
    np.testing.assert_array_equal(odom["rate"], SPINS)
    np.testing.assert_allclose(odom["velocity"], TURNS.apply(SPEEDS), atol=1e-14)
    turned = np.einsum("nij,njk,nlk->nil", R, COVARIANCES[:, :3, :3], R)
    sigmas = np.sqrt(np.einsum("nii->ni", turned))
    np.testing.assert_allclose(odom["sigma_velocity"], sigmas, rtol=1e-12)


def test_covariances_of_poses_are_turned_to_the_body(tmp_path: Path) -> None:
    """With errors about fixed axes Exp(e) R, to first order by differences."""
    found = read(
        bag(tmp_path, "mcap"), "/pose_cov", {"measured": {"pose": "m"}, "covariance": True}
    )
    for k, m in enumerate(found.measurements):
        slope = np.eye(6)
        for j, e in enumerate(1e-6 * np.eye(3)):
            turned = TURNS[k].inv() * Rotation.from_rotvec(e) * TURNS[k]
            slope[3:, 3 + j] = turned.as_rotvec() / 1e-6
        assert m.covariance is not None
        np.testing.assert_allclose(m.covariance[0], slope @ COVARIANCES[k] @ slope.T, atol=1e-8)
        np.testing.assert_allclose(m.z[0, :3], PLACES[k])
        w_first = TURNS[k].as_quat(canonical=True)[[3, 0, 1, 2]]
        np.testing.assert_allclose(m.z[0, 3:], w_first, atol=1e-15)


@pytest.mark.parametrize(
    ("topic", "role", "options", "message"),
    [
        ("/vicon", {"truth": {"position": "r"}}, {}, r"no topic '/vicon'; .*/imu \(sensor_msgs/"),
        ("/time", {"truth": {"position": "r"}}, {}, "topic /time: found std_msgs/msg/Header, exp"),
        ("/pose", {}, {}, "topics./pose: found states without a role"),
        ("/pose", {"truths": {}}, {}, "unknown option 'truths'; known are truth, meas"),
        ("/pose", {"measured": {"pose": "m"}, "covariance": True}, {}, "no covariance of the"),
        ("/pose", {"truth": {"position": "r"}}, {"stamps": "x"}, "expected header or receive"),
        ("/pose", {"truth": {"position": "r"}}, {"clock": "none"}, "a float64 does not hold"),
    ],
)
def test_what_is_refused(
    tmp_path: Path, topic: str, role: dict[str, Any], options: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        read(bag(tmp_path, "mcap"), topic, role, **options)


def test_a_message_that_is_there_twice_and_a_damaged_bag(tmp_path: Path) -> None:
    path, role = bag(tmp_path, "mcap", again=True), {"truth": {"position": "r"}}
    with pytest.raises(InputError, match=r"/pose, stamp 1403636579\.763555584: found 3 messages"):
        read(path, "/pose", role)
    (file,) = path.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:300])
    with pytest.raises(InputError, match="not a readable bag"):
        read(path, "/pose", role)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="found none, expected one bag"):
        read(tmp_path / "empty", "/pose", role)


POSE = {"truth": {"position": "relative_position", "attitude": "relative_attitude"}}


@pytest.mark.parametrize(
    ("writer", "name", "options"),
    [
        ("mcap", "out.mcap", {}),
        ("ros", "out.bag", {}),
        ("ros", "out", {}),
        ("ros", "out", {"storage": "sqlite3"}),
    ],
)
def test_a_track_as_a_bag_and_back(
    tmp_path: Path, writer: str, name: str, options: dict[str, Any]
) -> None:
    track, path = pose_track(), tmp_path / name
    for _ in range(2):  # what it would itself have written is replaced
        write_track(
            *(writer, track, path),
            **{"origin": "1403636579", **options},
        )
    assert (path.is_dir(), by_suffix(path)) == ("." not in name, writer if "." in name else None)
    back = read_raw("ros", path, {"topics": {"/batch/pose": POSE}})
    assert back.truth is not None
    np.testing.assert_array_equal(back.times, track.t)
    np.testing.assert_array_equal(
        back.truth.values["relative_position"], track.value("relative_position")
    )
    R = back.truth.values["relative_attitude"]
    apart = RELATIVE_ATTITUDE.local(R, track.value("relative_attitude"))
    assert np.abs(apart).max() < 1e-15
    role = {"measured": {"pose": "m"}, "covariance": True}
    seen = read_raw("ros", path, {"topics": {"/batch/pose_with_covariance": role}}).measurements
    P = np.vstack([m.covariance for m in seen if m.covariance is not None])
    want = track.covariance("relative_position", "relative_attitude")
    np.testing.assert_allclose(P, want, rtol=1e-13, atol=1e-18)
    w = truth_of(path, "/batch/twist", "rate")
    np.testing.assert_array_equal(w["rate"], track.value("body_rate"))
    variances = np.einsum("nii->ni", track.covariance("body_rate"))
    np.testing.assert_allclose(w["sigma_rate"] ** 2, variances, rtol=1e-14)


def test_another_reads_what_we_write(tmp_path: Path) -> None:
    track, path = pose_track(), tmp_path / "out.mcap"
    write_track("mcap", track, path, velocity="relative_velocity", rate="body_rate", origin=7)
    with rosbags.AnyReader([path]) as reader:
        kinds = {c.topic: c.msgtype for c in reader.connections}
        rows = {name: list[Any]() for name in kinds}
        for c, received, raw in reader.messages():
            rows[c.topic].append((received, reader.deserialize(raw, c.msgtype)))
    stamped = [f"geometry_msgs/msg/{n}Stamped" for n in ("Pose", "PoseWithCovariance")]
    assert [kinds["/batch/pose"], kinds["/batch/pose_with_covariance"]] == stamped
    ns = [r for r, _ in rows["/batch/pose"]]
    assert ns == [7 * 10**9 + round(t * 1e9) for t in track.t]
    R = track.value("relative_attitude")
    for k, (_, m) in enumerate(rows["/batch/pose_with_covariance"]):
        assert m.header.frame_id == "target"
        assert m.header.stamp.sec * 10**9 + m.header.stamp.nanosec == ns[k]
        q = m.pose.pose.orientation
        np.testing.assert_allclose(
            Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), R[k], atol=1e-15
        )
        A = np.eye(6)
        A[3:, 3:] = R[k]  # Exp(R d) R = R Exp(d)
        P = track.covariance("relative_position", "relative_attitude")[k]
        np.testing.assert_allclose(m.pose.covariance.reshape(6, 6), A @ P @ A.T, rtol=1e-12)
    P = track.covariance("relative_velocity", "body_rate")
    for k, (_, m) in enumerate(rows["/batch/twist"]):
        np.testing.assert_array_equal(m.twist.covariance.reshape(6, 6), P[k])


def test_a_track_without_an_attitude_and_what_it_lacks(tmp_path: Path) -> None:
    orbit = pose_track(Layout([RELATIVE_POSITION]))
    write_track("mcap", orbit, tmp_path / "orbit.mcap")
    found = truth_of(tmp_path / "orbit.mcap", "/batch/position", "position", clock="none")
    np.testing.assert_array_equal(found["position"], orbit.value("relative_position"))
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("kept")
    close = pose_track(t=np.array([0.0, 1e-10, 1, 2, 3, 4]))

    def refused(message: str, track: Track, path: str, **options: Any) -> None:
        with pytest.raises(InputError, match=message):
            write_track("ros", track, tmp_path / path, **options)

    refused("is no bag of this package", orbit, "mine")
    bag(tmp_path, "ros1")
    refused("is no bag of this package", orbit, "pass.bag")
    refused("expected some, of zero or more", close, "close")
    refused("storage 'zip', expected one of mcap, sqlite3", orbit, "x", storage="zip")
    refused("found no velocity and spin|found 'spin' as rate", orbit, "x", rate="spin")
    refused(
        "found .relative_velocity. as velocity",
        pose_track(IN_ORBIT),
        "x",
        velocity="relative_velocity",
    )
    assert (tmp_path / "mine" / "notes.txt").read_text() == "kept"


def with_checksums(path: Path) -> tuple[Path, int, int]:
    """The MCAP file of a bag, with the checksums that its writer left out; where its chunk and the
    summary are. Layout: https://mcap.dev/spec."""
    (file,) = path.glob("*.mcap")
    data, at, chunk, summary = bytearray(file.read_bytes()), 8, 0, 0
    while at < len(data) - 8:
        op, size = struct.unpack_from("<BQ", data, at)
        if op == 0x06:  # times, length, checksum, name of the compression, length of the rest
            chunk, body = at, at + 9
            (name,) = struct.unpack_from("<I", data, body + 28)
            packed = bytes(data[body + 40 + name : body + size])
            raw = import_module("backports.zstd").decompress(packed) if name else packed
            struct.pack_into("<I", data, body + 24, crc32(raw))
        elif op == 0x0F:
            struct.pack_into("<I", data, at + 9, crc32(data[:at]))
        elif op == 0x02:
            (summary,) = struct.unpack_from("<Q", data, at + 9)
            struct.pack_into("<I", data, at + 25, crc32(data[summary : at + 25]))
        at += 9 + size
    file.write_bytes(data)
    return file, chunk, summary


@pytest.mark.parametrize("zipped", [False, True])
@pytest.mark.parametrize(
    ("where", "says"),
    [
        ("chunk", "found the chunk at byte {chunk} with another checksum"),
        ("before", "found the data up to byte .* with another checksum"),
        ("summary", "found the summary at byte {summary} with another checksum"),
    ],
)
def test_a_damaged_mcap_file_is_named_with_the_place(
    tmp_path: Path, where: str, says: str, zipped: bool
) -> None:
    """One bit, in a number of a message, in a stamp that nobody reads, and in the summary."""
    path = bag(tmp_path, "mcap", zipped=zipped)
    file, chunk, summary = with_checksums(path)
    whole = file.read_bytes()
    number = whole.find(PLACES[1].tobytes()) if not zipped else chunk + 200
    flipped = bytearray(whole)
    # Of the summary the time of the first message, in the index of its chunk.
    index = whole.rfind(struct.pack("<Q", STAMPS[0] + LATE))
    flipped[{"chunk": number, "before": chunk + 9, "summary": index}[where]] ^= 1
    role = {"truth": {"position": "r"}}
    np.testing.assert_array_equal(truth_of(path, "/pose", "position")["position"], PLACES)
    for place in (path, file):
        file.write_bytes(flipped)
        expected = says.format(chunk=chunk, summary=summary)
        with pytest.raises(InputError, match=rf"pass\.mcap: damaged: {expected}"):
            read(place, "/pose", role)
    file.write_bytes(whole[:-1000])
    with pytest.raises(InputError, match="not a readable bag"):
        read(path, "/pose", role)


def test_without_the_extra_it_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = bag(tmp_path, "mcap")
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(InputError, match=r"bags need rosbags: install relnav-graph\[ros\]"):
        read(path, "/pose", {"truth": {"position": "r"}})
