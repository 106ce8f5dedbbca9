"""One pass, given as tables, and as OEM, AEM and a table: the same estimate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from ccsds import message
from passes import relnav

from relnav_graph.arrays import Array
from relnav_graph.core.track import Track
from relnav_graph.errors import InputError
from relnav_graph.estimators import run_estimator
from relnav_graph.io.ccsds.message import unscaled
from relnav_graph.io.clocks import nanoseconds
from relnav_graph.io.covariances import covariance_columns
from relnav_graph.io.tabular import write_table
from relnav_graph.maths import so3
from relnav_graph.maths.instants import Instant
from relnav_graph.runs.passes import open_dataset, open_pass
from relnav_graph.scenario.schema import ScenarioError

#: A leap second follows 2.3 s later.
EPOCH = "2016-12-31T23:59:58.3 UTC"
SCENARIO: dict[str, Any] = {
    "title": "poses, positions and a gyro",
    "time": {"epoch": EPOCH},
    "processes": {
        "attitude": {
            "kind": "gyro_bias",
            "attitude": "relative_attitude",
            "angle_random_walk_density": 1e-4,
            "bias_random_walk_density": 1e-5,
        },
        "motion": {
            "kind": "white_noise_acceleration",
            "acceleration_density": 0.01,
            "pose": "target",
        },
    },
    "sensors": {
        "pose": {
            "kind": "pose_measurement",
            "pose": "target",
            "position_sigma": 0.02,
            "attitude_sigma": 0.01,
        },
        "fix": {"kind": "position_fix", "pose": "target", "sigma": 0.05},
    },
    "prior": {
        "relative_attitude": {"sigma": 0.1, "mean": [0.1, 0.2, 0.3]},
        "gyro_bias": {"sigma": 0.01, "mean": [0, 0, 0]},
        "relative_position": {"sigma": 1.0, "mean": [5, 1, 0]},
        "relative_velocity": {"sigma": 0.1, "mean": [0.1, 0, 0]},
    },
}
PARTS = {
    "pose": {
        "reader": "oem",
        "file": "pose.oem",
        "options": {"role": "measured", "sensor": "pose", "attitude": "pose.aem"},
    },
    "fix": {"reader": "oem", "file": "fix.oem", "options": {"role": "measured", "sensor": "fix"}},
    "gyro": {"reader": "tables", "options": {"epoch": "2016-12-31T23:59:30 TAI"}},
}
N, STEP = 21, 0.3


def recorded() -> tuple[Array, Array, Array, Array, Array]:
    """Times, positions and quaternions of the poses, fixes, rates of the gyro."""
    rng, t = np.random.default_rng(0), STEP * np.arange(N, dtype=np.float64)
    R = [so3.exp(np.array([0.1, 0.2, 0.3]) + s * np.array([0.05, -0.02, 0.1])) for s in t]
    q = np.array([so3.quaternion(one) for one in R])
    r = np.array([5.0, 1.0, 0.0]) + np.outer(t, [0.1, 0, 0]) + 0.02 * rng.normal(size=(N, 3))
    return t, r, q, r + 0.05 * rng.normal(size=(N, 3)), rng.normal(size=(N, 3)) * 0.05


def as_tables(folder: Path) -> Track:
    """Of a data set."""
    t, r, q, fix, rate = recorded()
    folder.mkdir()
    (folder / "scenario.toml").write_text(tomli_w.dumps(SCENARIO))
    one = np.zeros(N, int)
    poses = dict(zip(("q_w", "q_x", "q_y", "q_z"), q.T, strict=True))
    write_table(folder / "pose.csv", {"t_s": t, "id": one, **axes(r, "{}_m"), **poses})
    write_table(folder / "fix.csv", {"t_s": t + 0.1, "id": one, **axes(fix, "{}_m")})
    write_table(folder / "gyro.csv", {"t_s": np.append(-0.3, t + 0.3), **gyro(rate)})
    return run_estimator("batch", open_dataset(folder).problem)


def axes(values: Array, name: str) -> dict[str, Array]:
    return {name.format(a): v for a, v in zip("xyz", values.T, strict=True)}


def gyro(rate: Array) -> dict[str, Array]:
    return axes(np.vstack([np.zeros(3), rate]), "w{}_rad_s")


def lines(t: Array, values: Array, scale: str, power: int) -> list[str]:
    begin = Instant.parse(EPOCH)
    return [
        " ".join([begin.after(s).calendar(scale), *(unscaled(x, power) for x in row.tolist())])
        for s, row in zip(t.tolist(), values, strict=True)
    ]


def as_messages(folder: Path) -> Path:
    """The scenario of a folder with OEM, AEM and a table, each with a time system of its own."""
    t, r, q, fix, rate = recorded()
    folder.mkdir()
    still = np.zeros((N, 3))
    own = {"CENTER_NAME": "TARGET", "REF_FRAME": "SC_BODY_2"}
    for name, at, place, scale in (("pose", t, r, "UTC"), ("fix", t + 0.1, fix, "TDB")):
        rows = lines(at, np.hstack([place, still]), scale, 3)
        message(folder / f"{name}.oem", "OEM", rows, TIME_SYSTEM=scale, **own)
    rows = lines(t, q[:, [1, 2, 3, 0]], "GPS", 0)
    message(folder / "pose.aem", "AEM", rows, TIME_SYSTEM="GPS", REF_FRAME_A="SC_BODY_2")
    since = Instant.parse(EPOCH).since(Instant.parse("2016-12-31T23:59:30 TAI"))
    stamps = np.append(-0.3, t + 0.3) + since
    write_table(folder / "gyro.csv", {"t_s": stamps, **gyro(rate)})
    path = folder / "mine.toml"
    path.write_text(tomli_w.dumps({**SCENARIO, "data": {"parts": PARTS}}))
    return path


def test_as_tables_and_as_messages_it_is_the_same(tmp_path: Path) -> None:
    one = as_tables(tmp_path / "set")
    path = as_messages(tmp_path / "files")
    opened = open_pass(path, data=path.parent)
    # Whole nanoseconds: as they would be read.
    t = np.sort(np.concatenate([STEP * np.arange(N), STEP * np.arange(N) + 0.1]))
    np.testing.assert_array_equal(opened.recording.times, np.round(t, 9))
    other = run_estimator("batch", opened.problem)
    np.testing.assert_allclose(other.t, one.t, rtol=0, atol=1e-12)
    d = one.layout.local(one.x, other.x) / np.sqrt(np.einsum("nii->ni", one.P))
    assert np.abs(d).max() < 1e-6
    np.testing.assert_allclose(other.P, one.P, rtol=1e-6, atol=1e-15)
    # Without an epoch of its own, t = 0 is the beginning of the first part.
    raw = {k: v for k, v in SCENARIO.items() if k != "time"} | {"data": {"parts": PARTS}}
    path.write_text(tomli_w.dumps(raw))
    again = open_pass(path, data=path.parent)
    np.testing.assert_array_equal(again.recording.times, opened.recording.times)
    assert again.scenario.file.time.epoch == "2017-01-01T00:01:06.484 TT"


def as_npz(folder: Path) -> dict[str, Any]:
    """An .npz with stamps in whole nanoseconds of Unix time, and its [data]."""
    t, r, q, fix, rate = recorded()
    stamps = {"t": t, "t_fix": t + 0.1, "t_gyro": np.append(-0.3, t + 0.3)}
    ns = {name: unix(one) for name, one in stamps.items()}
    w = np.vstack([np.zeros(3), rate])
    np.savez(folder / "pass.npz", r=1e3 * r, q=q[:, [1, 2, 3, 0]], fix=fix, w=w, **ns)

    def time(column: str) -> dict[str, str]:
        return {"column": column, "unit": "ns", "clock": "unix"}

    pose = {"columns": "r", "unit": "mm", "quaternion": "q", "order": "xyzw"}
    sensors = {"pose": pose, "fix": {"columns": "fix", "unit": "m", "time": time("t_fix")}}
    inputs = {"gyro": {"columns": "w", "unit": "rad/s", "time": time("t_gyro")}}
    options = {"time": time("t"), "sensors": sensors, "inputs": inputs}
    return {"reader": "table", "options": options}


def unix(t: Array) -> Any:
    return nanoseconds(t, epoch=SUMMER)


#: Of a pass without a leap second, in which Unix time would stand still.
SUMMER = "2014-06-24T19:02:59.3 UTC"


def as_bag(folder: Path) -> dict[str, Any]:
    """A bag of ROS 2 as rosbags writes it, and its [data]."""
    typesys, rosbag2 = (pytest.importorskip(f"rosbags.{n}") for n in ("typesys", "rosbag2"))
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    T, geometry = store.types, "geometry_msgs/msg/"
    t, r, q, fix, rate = recorded()

    def header(ns: int) -> Any:
        stamp = T["builtin_interfaces/msg/Time"](*divmod(ns, 10**9))
        return T["std_msgs/msg/Header"](stamp, "target")

    def vector(v: Array, name: str = "Vector3") -> Any:
        return T[geometry + name](*v.tolist())

    def pose(ns: int, k: int) -> Any:
        turn = T[geometry + "Quaternion"](*q[k, [1, 2, 3, 0]].tolist())
        place = T[geometry + "Pose"](vector(r[k], "Point"), turn)
        return T[geometry + "PoseStamped"](header(ns), place)

    def imu(ns: int, k: int) -> Any:
        turn, no = T[geometry + "Quaternion"](0.0, 0.0, 0.0, 1.0), np.array([-1.0] + 8 * [0.0])
        w, f = vector(np.vstack([np.zeros(3), rate])[k]), vector(np.zeros(3))
        return T["sensor_msgs/msg/Imu"](header(ns), turn, no, w, no, f, no)

    def point(ns: int, k: int) -> Any:
        return T[geometry + "PointStamped"](header(ns), vector(fix[k], "Point"))

    gyro_t = np.append(-0.3, t + 0.3)
    with rosbag2.Writer(folder / "bag", version=8) as writer:
        for name, kind, at, made in (
            ("/pose", geometry + "PoseStamped", t, pose),
            ("/fix", geometry + "PointStamped", t + 0.1, point),
            ("/imu", "sensor_msgs/msg/Imu", gyro_t, imu),
        ):
            topic = writer.add_connection(name, kind, typestore=store)
            for k, ns in enumerate(unix(at).tolist()):
                writer.write(topic, ns + 1000, store.serialize_cdr(made(ns, k), kind))
    roles = {"/pose": {"measured": "pose"}, "/fix": {"measured": "fix"}}
    return {
        "reader": "ros",
        "options": {"topics": {**roles, "/imu": {"inputs": {"rate": "gyro"}}}},
    }


@pytest.mark.parametrize("made", [as_npz, as_bag])
def test_as_tables_and_as_arrays_or_a_bag_it_is_the_same(tmp_path: Path, made: Any) -> None:
    one = as_tables(tmp_path / "set")
    (tmp_path / "files").mkdir()
    data = made(tmp_path / "files")
    path = tmp_path / "mine.toml"
    path.write_text(tomli_w.dumps({**SCENARIO, "time": {"epoch": SUMMER}, "data": data}))
    opened = open_pass(path, data=tmp_path / "files")
    # Whole nanoseconds, which float64 at such a time has not.
    t = np.sort(np.concatenate([STEP * np.arange(N), STEP * np.arange(N) + 0.1]))
    np.testing.assert_array_equal(opened.recording.times, np.round(t, 9))
    other = run_estimator("batch", opened.problem)
    d = one.layout.local(one.x, other.x) / np.sqrt(np.einsum("nii->ni", one.P))
    assert np.abs(d).max() < 1e-6
    np.testing.assert_allclose(other.P, one.P, rtol=1e-6, atol=1e-15)


def test_it_is_a_data_set_of_its_own_and_converts_to_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = as_messages(tmp_path / "files")
    path.rename(path.parent / "scenario.toml")
    opened = open_dataset(path.parent)
    by_its_file = open_pass(path.parent / "scenario.toml", data=path.parent)
    np.testing.assert_array_equal(by_its_file.recording.times, opened.recording.times)
    assert relnav(capsys, "convert", path.parent, tmp_path / "set")[0] == 0
    copy = open_dataset(tmp_path / "set")
    np.testing.assert_array_equal(copy.recording.times, opened.recording.times)
    for a, b in zip(copy.recording.measurements, opened.recording.measurements, strict=True):
        assert (a.sensor, a.t) == (b.sensor, b.t)
        np.testing.assert_array_equal(a.z, b.z)


def test_wrong_parts_are_all_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    parts: dict[str, Any] = {
        "a": {"reader": "oen"},
        "b": {"reader": "oem", "options": {"rolle": "truth"}},
        "c": {"reader": "oem", "file": "../x.oem"},
    }
    path = tmp_path / "mine.toml"
    path.write_text(tomli_w.dumps({**SCENARIO, "data": {"parts": parts}}))
    code, _, said = relnav(capsys, "validate", path)
    assert code == 2
    for text in (
        "data.parts.a: unknown reader 'oen'; known are aem,",
        "data.parts.b: reader 'oem': unknown option 'rolle'",
        "data.parts.c: found file '../x.oem', expected one in the folder of the data",
    ):
        assert text in said
    with pytest.raises(ScenarioError, match=r"data: found neither|data\.parts"):
        open_pass(path, data=tmp_path)
    lacks = {"pose": {**PARTS["pose"], "file": "none.oem"}}
    path.write_text(tomli_w.dumps({**SCENARIO, "data": {"parts": lacks}}))
    with pytest.raises(InputError, match=r"data\.parts\.pose: .*none\.oem: no such file"):
        open_pass(path, data=tmp_path)


def test_covariances_of_files_count_in_the_place_of_sigmas(tmp_path: Path) -> None:
    """Of a pose: those of an OEM and of the table beside an AEM. Where they are those of the
    sensors, nothing changes."""
    path = as_messages(tmp_path / "files")
    plain = open_pass(path, data=path.parent)
    position, attitude = 0.02**2, 0.01**2
    file = path.parent / "pose.oem"
    times = [line.split()[0] for line in file.read_text().splitlines() if line[:2] == "20"]
    text = ["COVARIANCE_START"]
    for when in times:
        text.append(f"EPOCH = {when}")
        text += [" ".join([*["0"] * i, unscaled(position, 6)]) for i in range(6)]
    file.write_text(file.read_text() + "\n".join([*text, "COVARIANCE_STOP"]) + "\n")
    side: dict[str, Array] = {"t_s": np.round(STEP * np.arange(N), 9)}
    for name in covariance_columns(3):
        same = name[4] == name[6]
        side[name] = np.full(N, attitude if same else 0.0)
    write_table(path.parent / "pose_covariances.csv", side)
    options = {"data.parts.pose.options.covariance=true"}
    known = open_pass(path, data=path.parent, assignments=tuple(options))
    P = known.recording.measurements[0].covariance
    assert P is not None
    np.testing.assert_allclose(np.diag(P[0]), [position] * 3 + [attitude] * 3, rtol=1e-14)
    one, other = (run_estimator("batch", p.problem) for p in (plain, known))
    d = one.layout.local(one.x, other.x) / np.sqrt(np.einsum("nii->ni", one.P))
    assert np.abs(d).max() < 1e-6
    loose = {**side, **{f"cov_{i}_{i}": np.full(N, 100 * attitude) for i in (1, 2, 3)}}
    write_table(path.parent / "pose_covariances.csv", loose)
    again = open_pass(path, data=path.parent, assignments=tuple(options))
    worse = run_estimator("batch", again.problem).covariance("relative_attitude")
    assert (np.trace(worse, axis1=1, axis2=2) > np.trace(one.P[:, :3, :3], axis1=1, axis2=2)).all()
