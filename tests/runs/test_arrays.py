"""Problems from arrays and data frames: the same estimate as of files; errors that say where."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas
import pytest
from relnav_factors.sensors.pose_measurement import PoseMeasurement
from scipy.spatial.transform import Rotation

import relnav_graph as rg
from relnav_graph.core.problem import Problem
from relnav_graph.core.track import Track
from relnav_graph.errors import InputError
from relnav_graph.runs.passes import open_dataset

COUNT = 12
START = 1_700_000_000_123_456_789  # ns; no float tells them apart
COLUMNS = ("x_m", "y_m", "z_m", "q_w", "q_x", "q_y", "q_z")
RATES = ("wx_rad_s", "wy_rad_s", "wz_rad_s")

MODELS: dict[str, Any] = {
    "processes": {
        "turn": {
            "kind": "gyro_bias",
            "attitude": "relative_attitude",
            "angle_random_walk_density": "1 deg/sqrt(h)",
            "bias_random_walk_density": 1e-7,
        },
        "move": {
            "kind": "white_noise_acceleration",
            "pose": "target",
            "acceleration_density": 1e-3,
        },
    },
    "sensors": {
        "pose": {
            "kind": "pose_measurement",
            "pose": "target",
            "position_sigma": 0.05,
            "attitude_sigma": "1 deg",
        }
    },
}
PRIOR = {
    "relative_attitude": (np.eye(3), "20 deg"),
    "relative_position": ([5.0, -3.0, 0.0], 1.0),
    "relative_velocity": (np.zeros(3), np.diag([0.01, 0.01, 0.02])),
    "gyro_bias": {"mean": [0.0, 0.0, 0.0], "sigma": "100 deg/h"},
}
SCENARIO = """
title = "a pose and a gyro"
[data]
reader = "none"
[processes.turn]
kind = "gyro_bias"
attitude = "relative_attitude"
angle_random_walk_density = "1 deg/sqrt(h)"
bias_random_walk_density = 1e-7
[processes.move]
kind = "white_noise_acceleration"
pose = "target"
acceleration_density = 1e-3
[sensors.pose]
kind = "pose_measurement"
pose = "target"
position_sigma = 0.05
attitude_sigma = "1 deg"
[prior]
relative_attitude = { mean = [1, 0, 0, 0], sigma = "20 deg" }
relative_position = { mean = [5, -3, 0], sigma = 1.0 }
relative_velocity = { mean = [0, 0, 0], sigma = [0.1, 0.1, 0.1414213562373095] }
gyro_bias = { mean = [0, 0, 0], sigma = "100 deg/h" }
"""


def drawn() -> tuple[Any, ...]:
    """Times, poses, edges and rates of a chaser that turns."""
    rng, t = np.random.default_rng(4), np.arange(COUNT) * 0.5
    rate = np.array([0.01, -0.02, 0.03])
    noise = Rotation.from_rotvec(0.02 * rng.normal(size=(COUNT, 3)))
    q = (Rotation.from_rotvec(np.outer(t, rate)) * noise).as_quat(scalar_first=True)
    r = [5, -3, 0] + np.outer(t, [0.1, 0, 0.2]) + 0.05 * rng.normal(size=(COUNT, 3))
    edges = np.arange(5 * (COUNT - 1) + 1) * 0.1
    gyro = rate + 1e-3 * rng.normal(size=(len(edges) - 1, 3))
    return t, np.hstack([r, q]), edges, gyro


T, Z, EDGES, GYRO = drawn()


def from_arrays(**changes: Any) -> Problem:
    given = {**MODELS, "measurements": {"pose": (T, Z)}, "inputs": {"gyro": (EDGES, GYRO)}}
    made: Problem = rg.Problem.from_arrays(**{**given, "prior": PRIOR, **changes})
    return made


def batch(problem: Problem) -> Track:
    return rg.run_estimator("batch", problem)


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Track:
    """Of the same pass as CSV."""
    folder = tmp_path_factory.mktemp("csv")
    (folder / "scenario.toml").write_text(SCENARIO.replace('[data]\nreader = "none"\n', ""))
    rows = np.column_stack([T, np.zeros(COUNT), Z])
    ends = np.column_stack([EDGES[:-1], EDGES[1:], GYRO])
    for name, columns, table in (
        ("pose", ("t_s", "id", *COLUMNS), rows),
        ("gyro", ("t_start_s", "t_end_s", *open_columns()), ends),
    ):
        text = "\n".join([",".join(columns), *(",".join(map(repr, r)) for r in table.tolist())])
        (folder / f"{name}.csv").write_text(text + "\n")
    return batch(open_dataset(folder).problem)


def open_columns() -> tuple[str, ...]:
    process: Any = from_arrays().processes["turn"]
    columns: tuple[str, ...] = process.inputs["gyro"]
    return columns


def shuffled() -> Problem:
    order = np.random.default_rng(0).permutation(COUNT)
    return from_arrays(measurements={"pose": {"t": T[order], "z": Z[order]}})


def in_nanoseconds() -> Problem:
    t, edges = START + np.rint(T * 1e9).astype(np.int64), START + np.rint(EDGES * 1e9).astype(int)
    return from_arrays(measurements={"pose": (t, Z)}, inputs={"gyro": (edges, GYRO)})


def dated() -> Problem:
    t = np.datetime64(START, "ns") + np.rint(T * 1e9).astype("timedelta64[ns]")
    edges = np.datetime64(START, "ns") + np.rint(EDGES * 1e9).astype("timedelta64[ns]")
    halves = {"t_start": edges[:-1], "t_end": edges[1:], "values": GYRO}
    return from_arrays(measurements={"pose": (t, Z)}, inputs={"gyro": halves})


def of_instances() -> Problem:
    sensor = PoseMeasurement(
        pose="target", position_sigma=np.full(3, 0.05), attitude_sigma=np.full(3, np.deg2rad(1))
    )
    return from_arrays(sensors={"pose": sensor})


def frames(index: bool) -> Problem:
    pose = pandas.DataFrame(Z, columns=list(COLUMNS))
    gyro = pandas.DataFrame(GYRO, columns=list(open_columns()))
    stamps = pandas.to_datetime(START + np.rint(T * 1e9).astype(np.int64), unit="ns", utc=True)
    ends = pandas.to_datetime(START + np.rint(EDGES * 1e9).astype(np.int64), unit="ns", utc=True)
    if index:
        pose.index, gyro["t_start"], gyro["t_end"] = stamps, ends[:-1], ends[1:]
    else:
        pose["t_s"], gyro["t_start_s"], gyro["t_end_s"] = T, EDGES[:-1], EDGES[1:]
    pose["battery"] = 3.3
    tables = {"measurements": {"pose": pose}, "inputs": {"gyro": gyro}}
    made: Problem = rg.Problem.from_frames(**MODELS, **tables, prior=PRIOR)
    return made


def test_columns_that_are_not_read_are_named(caplog: pytest.LogCaptureFixture) -> None:
    frames(False)
    (said,) = [one for one in caplog.records if "not read" in one.getMessage()]
    assert said.levelname == "WARNING"
    assert said.getMessage().endswith("pose: not read: columns battery")


@pytest.mark.parametrize(
    "make",
    [
        from_arrays,
        shuffled,
        in_nanoseconds,
        dated,
        of_instances,
        lambda: frames(False),
        lambda: frames(True),
    ],
)
def test_the_estimate_is_that_of_the_files(make: Any, reference: Track) -> None:
    problem = make()
    np.testing.assert_array_equal(problem.times, T)  # whole nanoseconds: no digit is lost
    track = batch(problem)
    e = track.layout.local(reference.x, track.x)
    sigma = np.sqrt(np.diagonal(reference.P, axis1=1, axis2=2))
    assert np.abs(e / sigma).max() < 1e-6
    np.testing.assert_allclose(track.P, reference.P, rtol=1e-6, atol=1e-12)


def test_a_first_estimate_may_be_measured() -> None:
    measured = dict.fromkeys(("relative_attitude", "relative_position"), ("measured", 1.0))
    problem = from_arrays(prior={**PRIOR, **measured})
    x = problem.layout.values(problem.prior.x)
    np.testing.assert_allclose(x["relative_position"], Z[0, :3], atol=0.01)


POSE = MODELS["sensors"]["pose"]
NO_INERTIA = {k: v for k, v in PRIOR.items() if k != "gyro_bias"}
TWO = {"pose": POSE, "beacons": {"kind": "beacon_los", "points": [[0, 0, 1], [0, 1, 0]]}}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"prior": NO_INERTIA}, r"prior.gyro_bias: missing: every block .* rad/s, of b_c"),
        ({"prior": {**PRIOR, "mass": (1, 1)}}, "prior.mass: unknown block; there are relative_att"),
        ({"prior": {**PRIOR, "gyro_bias": ([0, 0], 1)}}, r"prior.gyro_bias.mean: found shape"),
        ({"prior": {**PRIOR, "gyro_bias": (np.zeros(3), -np.eye(3))}}, "prior.gyro_bias.sigma: "),
        ({"prior": {**PRIOR, "gyro_bias": 3.0}}, r"prior.gyro_bias: found float, expected \(mean"),
        ({"sensors": {"pose": {**POSE, "sigma": 1}}}, "sensors.pose.sigma: unknown key"),
        ({"sensors": {"pose": {"kind": "pose"}}}, "sensors.pose.kind: found kind 'pose'"),
        ({"sensors": {"pose": 3}}, "sensors.pose: found 3, expected a model"),
        ({"measurements": {"p": (T, Z)}}, "measurements.p: unknown sensor, expected one of: pose"),
        ({"measurements": {"pose": (T, Z[:, :3])}}, r"pose: z: found float64 \(12, 3\).*x_m.*q_z"),
        ({"measurements": {"pose": (T, Z[1:])}}, r"expected real numbers \(12, 7\)"),
        ({"measurements": {"pose": (T[:1], Z[:1], 1, 2)}}, r"expected \(t, z\) or \(t, z, ids\)"),
        ({"measurements": {"pose": (np.append(T[1:], 0.5), Z)}}, "id 0 twice at t = 0.5 s"),
        ({"measurements": {"pose": (np.arange(COUNT), Z)}}, "whole numbers .* nanoseconds"),
        (
            {"measurements": {"pose": (START + np.arange(COUNT) * 10**9, Z)}},
            "in whole nanoseconds .* inputs.gyro: t_end in seconds",
        ),
        (
            {"prior": {**PRIOR, "relative_attitude": (-np.eye(3), 1)}},
            "relative_attitude: not a rotation but a reflection",
        ),
        ({"inputs": {"gyro": (EDGES[1:], GYRO)}}, r"edges \(55,\) for 55 values, expected \(56,\)"),
        ({"inputs": {"accelerometer": (EDGES, GYRO)}}, "unknown input, .* processes: gyro"),
        ({"inputs": {}}, "needs the input 'gyro'"),
        (
            {
                "measurements": {"pose": (T, Z * [1e3, 1e3, 1e3, 1, 1, 1, 1])},
                "prior": {**PRIOR, "relative_position": ([5, -3, 0], 0.1)},
            },
            "'pose' at t = 0.0 s: mm given for m",
        ),
        ({"gaps": {"gyro": {"spread": "1 m"}}}, "gaps.gyro.spread: "),
    ],
)
def test_what_is_wrong_is_named(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        from_arrays(**changes)


def test_columns_and_ids_that_are_missing_are_named() -> None:
    frame = pandas.DataFrame(Z[:, 1:], columns=list(COLUMNS[1:]))
    with pytest.raises(InputError, match=r"pose: no column 't_s'; found y_m"):
        rg.Problem.from_frames(**MODELS, measurements={"pose": frame}, prior=PRIOR)
    table = {"pose": frame.assign(t=T)}
    with pytest.raises(InputError, match=r"no column 'x_m'; found y_m.*expected x_m"):
        rg.Problem.from_frames(**MODELS, measurements=table, prior=PRIOR)
    whole = pandas.DataFrame(Z, columns=list(COLUMNS)).assign(t=T)
    for given, says in (
        (dict(whole), "found dict, expected a data frame"),
        (whole.assign(sigma_x_m=1.0), "found the column 'sigma_x_m', expected none of noise"),
    ):
        with pytest.raises(InputError, match=says):
            rg.Problem.from_frames(**MODELS, measurements={"pose": given}, prior=PRIOR)
    los = {"kind": "beacon_los", "points": [[0, 0, 1], [0, 1, 0]], "sigma": 1e-3, "pose": "target"}
    with pytest.raises(InputError, match=r"measurements.b: found no ids"):
        from_arrays(sensors={"b": los}, measurements={"b": (T, Z[:, :3])})


def test_whole_milliseconds_taken_for_nanoseconds_are_a_caution() -> None:
    """Of a pass of 20 minutes and more, which may be one of 1.2 ms in ns."""
    t, z = 10_000 * np.arange(130), np.zeros((130, 3))
    found = rg.Problem.from_arrays(
        processes={"free": {"kind": "white_noise_acceleration", "acceleration_density": 1e-3}},
        sensors={"fix": {"kind": "position_fix", "sigma": 0.1}},
        measurements={"fix": (t, z)},
        prior={"relative_position": (z[0], 1.0), "relative_velocity": (z[0], 1.0)},
    )
    assert ["1e-05 s apart (median): are they whole" in c.text for c in found.cautions] == [True]
    track = rg.run_estimator("batch", found)
    assert track.cautions == found.cautions
    for noun in (found, track):  # said in full, in lines that are read
        lines = repr(noun).splitlines()
        assert "caution: intervals: the epochs are 1e-05 s apart" in repr(noun)
        assert lines[-1].endswith("taken for ns?")
        assert max(map(len, lines)) <= 96
        assert "taken for ns?" in noun._repr_html_()


def test_floats_of_unix_time_are_a_caution() -> None:
    """They have lost what is below 240 ns; an origin, or whole nanoseconds, and nothing is said."""
    z = np.zeros((9, 3))
    models: dict[str, Any] = {
        "processes": {"free": {"kind": "white_noise_acceleration", "acceleration_density": 1e-3}},
        "sensors": {"fix": {"kind": "position_fix", "sigma": 0.1}},
        "prior": {"relative_position": (z[0], 1.0), "relative_velocity": (z[0], 1.0)},
    }
    late, whole = 1.75e9 + np.arange(9.0), 1_750_000_000_000_000_000 + 10**9 * np.arange(9)
    for t, origin, doubted in ((late, None, 1), (late, 1.75e9, 0), (whole, None, 0)):
        made = rg.Problem.from_arrays(**models, measurements={"fix": (t, z)}, origin=origin)
        said = [c.text for c in made.cautions if c.name == "late stamps"]
        assert len(said) == doubted
        assert all("t = 1750000000 s, where float64 has steps of 2.4e-07 s" in s for s in said)


def test_a_row_may_bring_its_own_covariance() -> None:
    """Counted in place of the sensor's noise, whatever the order of the rows."""
    t, z = np.array([1.0, 0.0]), np.array([[2.0, 0, 0], [0.0, 0, 0]])
    P = np.array([4.0, 1.0])[:, None, None] * np.eye(3)
    sensors = {"fix": {"kind": "position_fix", "sigma": 1.0}}
    processes = {"move": {"kind": "white_noise_acceleration", "acceleration_density": 1e-9}}
    prior = {"relative_position": (np.zeros(3), 100.0), "relative_velocity": (np.zeros(3), 1e-6)}

    def found(measured: Any) -> Problem:
        return rg.problem_from_arrays(
            processes=processes, sensors=sensors, prior=prior, measurements={"fix": measured}
        )

    track = rg.run_estimator("batch", found({"t": t, "z": z, "covariance": P}))
    assert track.value("relative_position")[-1, 0] == pytest.approx(2.0 / 5.0, rel=1e-3)
    with pytest.raises(InputError, match=r"found covariance \(2,\), expected \(2, 3, 3\)"):
        found({"t": t, "z": z, "covariance": np.ones(2)})
