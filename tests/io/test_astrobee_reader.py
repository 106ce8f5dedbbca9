"""The reader of the tumbling Astrobee: conventions on a made-up dump, and the data itself."""

from __future__ import annotations

import csv
import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from example_makers import HU_INERTIA
from passes import EXPERIMENTS, recorded
from relnav_factors.derived.relative_pose import TargetRateInChaser
from relnav_factors.sensors.pose_odometry import PoseOdometry

from relnav_graph.arrays import Array
from relnav_graph.cli.main import main
from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError
from relnav_graph.io.readers import read_raw
from relnav_graph.io.readers.astrobee_tumble import authors_rate
from relnav_graph.maths import so3
from relnav_graph.sim.truths.inertial import inertia_parameters

START, COUNT = 40.0, 12
RATE = np.array([0.05, -0.06, 0.04])  # of the target, in world axes
TURN = np.array([0.01, 0.02, -0.015])  # of the chaser, in its own axes
QUARTER = so3.exp(np.array([0.0, 0.0, np.pi / 2]))


def chaser(t: float) -> tuple[Array, Array]:
    R = so3.exp(np.array([0.2, 0.3, 1.4])) @ so3.exp(t * TURN)
    return R, np.array([10.9 + 0.01 * t, -8.6 - 0.02 * t, 4.9])


def target(t: float) -> tuple[Array, Array]:
    return so3.exp(t * RATE) @ so3.exp(np.array([1.0, -0.4, 0.2])), np.array([10.9, -6.6, 4.9])


def columns(prefix: str, names: str, axes: str) -> list[str]:
    return [f"field.{prefix}.{names}.{axis}" for axis in axes]


POSE = columns("pose", "position", "xyz") + columns("pose", "orientation", "xyzw")


def pose_row(R: Array, r: Array) -> list[float]:
    w, x, y, z = so3.quaternion(np.ascontiguousarray(R))
    return [*r, x, y, z, w]


def write_topic(folder: Path, name: str, header: list[str], rows: dict[float, list[float]]) -> None:
    """Stamped by the simulation, unless it is odometry or an estimate."""
    stamped = "gt" in name or "imu" in name
    with gzip.open(folder / f"{name}_orbit7.csv.gz", "wt", newline="") as stream:
        out = csv.writer(stream)
        first = ["%time", "field.header.seq", "field.header.stamp", "field.header.frame_id"]
        out.writerow([*first, *header])
        for n, (t, row) in enumerate(rows.items()):
            stamp = round(1e9 * t)
            received = stamp + 7_000_000 if stamped else stamp
            numbers = [repr(float(v)) for v in row]
            out.writerow([received, n, stamp if stamped else 0, "world", *numbers])


def write(folder: Path) -> Path:
    grid = np.arange(START - 1.0, START + COUNT + 1.0, 0.02)
    epochs = START + np.arange(COUNT) + 0.1 * np.sin(np.arange(COUNT))
    moves = {}
    for before, now in zip([START - 1.0, *epochs[:-1]], epochs, strict=True):
        poses = []
        for t in (before, now):
            (R_oc, r_c), (R_ob, r_b) = chaser(t), target(t)
            poses.append((R_ob.T @ R_oc, R_ob.T @ (r_c - r_b)))
        (A, a), (B, b) = poses
        moves[now] = pose_row(A.T @ B, A.T @ (b - a))
    write_topic(folder, "chaser_deltapose", POSE, moves)
    for name, body in (("chaser", chaser), ("target", target)):
        write_topic(folder, f"{name}_gt_pose", POSE, {t: pose_row(*body(t)) for t in grid})
    twist = columns("twist", "angular", "xyz")
    write_topic(folder, "target_gt_twist", twist, {t: list(RATE) for t in grid})
    gyro = list(QUARTER.T @ TURN)
    imu = columns("angular_velocity", "", "xyz")
    write_topic(
        folder, "chaser_imu", [c.replace("..", ".") for c in imu], dict.fromkeys(grid, gyro)
    )
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("orbit7"))


@pytest.fixture(scope="module")
def recording(folder: Path) -> Recording:
    moments = np.linalg.eigvalsh(HU_INERTIA).tolist()
    return read_raw("astrobee_tumble", folder, {"target_inertia": moments})


def values(recording: Recording, name: str) -> Array:
    assert recording.truth is not None
    return np.asarray(recording.truth.values[name])


def test_odometry_is_what_the_model_predicts_from_truth(recording: Recording) -> None:
    model = PoseOdometry(position_sigma=np.full(3, 1e-3), attitude_sigma=np.full(3, 1e-3))
    names = "chaser_attitude", "target_attitude", "relative_position"
    assert len(recording.measurements) == COUNT - 1
    for k, m in enumerate(recording.measurements, 1):
        assert m.t == pytest.approx(recording.times[k], abs=1e-9)
        before, now = ([values(recording, n)[i] for n in names] for i in (k - 1, k))
        r, _ = model.residual(m, *before, *now)
        assert np.abs(r).max() < 1e-5  # of the interpolation of truth


def test_axes_of_the_target_are_the_chasers_at_the_start(recording: Recording) -> None:
    R_oc, R_ot = (values(recording, n) for n in ("chaser_attitude", "target_attitude"))
    np.testing.assert_allclose(R_oc[0], R_ot[0], atol=1e-14)
    # Held by the target from then on: they turn with it.
    turned = R_ot[-1] @ R_ot[0].T
    np.testing.assert_allclose(turned, so3.exp(RATE * recording.times[-1]), atol=1e-6)


def test_rates_and_inertia_are_in_those_axes(recording: Recording) -> None:
    R_oc, R_ot, w = (
        values(recording, n) for n in ("chaser_attitude", "target_attitude", "body_rate")
    )
    np.testing.assert_allclose(np.einsum("nij,nj->ni", R_ot, w)[5], RATE, atol=1e-9)
    in_c, _ = TargetRateInChaser().values(R_oc, R_ot, w)
    np.testing.assert_allclose(in_c, values(recording, "target_rate"), atol=1e-12)
    R_bt = target(float(START))[0].T @ R_oc[0]
    J = R_bt.T @ np.diag(np.linalg.eigvalsh(HU_INERTIA)) @ R_bt
    k = values(recording, "inertia_matrix_parameters")[0]
    np.testing.assert_allclose(k, inertia_parameters(J), atol=1e-6)


def test_gyro_is_turned_into_chaser_axes_and_covers_the_pass(recording: Recording) -> None:
    gyro = recording.inputs["gyro"]
    np.testing.assert_allclose(gyro.values, np.tile(TURN, (len(gyro.values), 1)), atol=1e-12)
    assert gyro.t_start[0] <= 0
    assert gyro.t_end[-1] >= recording.times[-1]


def test_a_message_that_comes_twice_counts_once(folder: Path, tmp_path: Path) -> None:
    for path in folder.iterdir():
        lines = gzip.decompress(path.read_bytes()).decode().splitlines()
        (tmp_path / path.name.removesuffix(".gz")).write_text("\n".join([*lines, lines[-1]]))
    assert len(read_raw("astrobee_tumble", tmp_path).times) == COUNT


def spoilt(folder: Path, to: Path, topic: str, change: Any) -> Path:
    for path in folder.iterdir():
        text = gzip.decompress(path.read_bytes()).decode()
        if path.name.startswith(topic):
            text = change(text)
        if text is not None:
            (to / path.name).write_bytes(gzip.compress(text.encode()))
    return to


@pytest.mark.parametrize(
    ("topic", "change", "says"),
    [
        ("chaser_imu", lambda s: None, r"no file \*chaser_imu\*"),
        ("chaser_imu", lambda s: s.replace("angular_velocity.x", "other"), "found 0 columns"),
        ("chaser_imu", lambda s: "\n".join(s.splitlines()[:9]), "does not cover"),
        ("chaser_deltapose", lambda s: s.replace("\n", "\n1,2", 3), "cut off|expected|length"),
        ("chaser_deltapose", lambda s: s.splitlines()[0], "0 rows"),
        ("target_gt_pose", lambda s: s.rsplit(",", 1)[0] + ",nan\n", "not finite"),
        ("target_gt_pose", lambda s: s.rsplit(",", 1)[0] + ",9.0\n", "the quaternion"),
    ],
)
def test_damaged_files_are_refused(
    folder: Path, tmp_path: Path, topic: str, change: Any, says: str
) -> None:
    with pytest.raises(InputError, match=says):
        read_raw("astrobee_tumble", spoilt(folder, tmp_path, topic, change))


def test_several_runs_need_a_name(folder: Path, tmp_path: Path) -> None:
    for path in folder.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
        (tmp_path / path.name.replace("orbit7", "still")).write_bytes(path.read_bytes())
    with pytest.raises(InputError, match=r"data\.options\.run"):
        read_raw("astrobee_tumble", tmp_path)
    assert len(read_raw("astrobee_tumble", tmp_path, {"run": "still"}).times) == COUNT


def test_without_ground_truth_there_is_none(folder: Path, tmp_path: Path) -> None:
    spoilt(folder, tmp_path, "target_gt", lambda s: None)
    assert read_raw("astrobee_tumble", tmp_path).truth is None
    with pytest.raises(InputError, match="target_est_twist"):
        authors_rate(tmp_path)


def test_the_published_run(capsys: pytest.CaptureFixture[str]) -> None:
    """Rate of the target within 0.24 deg/s, where the authors' own is at 1.2, and a covariance
    that says so."""
    data = recorded("astrobee_tumble")
    arguments = [str(EXPERIMENTS / "astrobee_tumble.toml"), "-e", "batch", "--data", str(data)]
    with pytest.raises(SystemExit) as stop:
        main(["compare", *arguments, "--json"])
    out, err = capsys.readouterr()
    assert not stop.value.code, err
    row = json.loads(out)["estimators"]["batch"]
    assert row["states"]["target_rate"]["rmse"] <= 0.24
    assert row["states"]["relative_position"]["rmse"] <= 0.05
    assert row["anees_without"] <= 1.5
    assert "bent posterior" in [caution["name"] for caution in row["cautions"]]
    assert row["states"]["inertia_ratios"]["inside_3sigma"] == 1
    assert 0 < row["rejected"]["odometry"] < 10
    t, estimate, truth = authors_rate(data)
    assert len(t) == 172
    assert np.degrees(np.sqrt(((estimate - truth) ** 2).sum(axis=1).mean())) > 1
