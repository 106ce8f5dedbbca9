"""A truth that was measured itself: its covariance is counted, and rmse is what it was."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from passes import ZHANG, relnav

from relnav_graph.arrays import Array
from relnav_graph.core.catalogue import BODY_RATE, POINT, RELATIVE_POSITION, TARGET_ATTITUDE
from relnav_graph.core.scored import InAxes
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Recording, Statics, Track, Truth
from relnav_graph.errors import InputError
from relnav_graph.io.results import read_results, write_results
from relnav_graph.maths import so3
from relnav_graph.runs.passes import open_dataset, open_pass
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scoring.deviations import errors
from relnav_graph.scoring.metrics import score, summary, table
from relnav_graph.scoring.truth_noise import Linear, TruthNoise, of_error
from relnav_graph.study.runs import StudySpec, prepare

Capture = pytest.CaptureFixture[str]
DEGREE = np.pi / 180
LAYOUT = Layout([RELATIVE_POSITION, TARGET_ATTITUDE, BODY_RATE])
#: Of position, attitude and rate: the truth's own noise is several times the estimate's.
SIGMA = np.array([0.01, 0.01, 0.02, *(np.array([0.2, 0.3, 0.2]) * DEGREE), 0.02, 0.02, 0.02])
TRUTH = {
    "relative_position": np.array([0.05, 0.02, 0.0]),
    "target_attitude": np.array([0.6, 3.0, 0.6]) * DEGREE,
    "body_rate": np.array([0.1, 0.0, 0.02]),
}
N = 3000


def made(sigmas: dict[str, Array] = TRUTH) -> tuple[Track, Truth]:
    """A track of known covariance beside a truth of known noise."""
    rng = np.random.default_rng(7)
    P = np.diag(SIGMA**2)
    t = np.arange(N, dtype=np.float64)
    true = np.tile(LAYOUT.retract(LAYOUT.identity, np.linspace(-1, 1, LAYOUT.dim)), (N, 1))
    x = LAYOUT.retract(true, SIGMA * rng.standard_normal((N, LAYOUT.dim)))
    noise = np.hstack([TRUTH[b.name] for b in LAYOUT]) * rng.standard_normal((N, LAYOUT.dim))
    values = LAYOUT.values(LAYOUT.retract(true, noise))
    tiled = {name: np.tile(s, (N, 1)) for name, s in sigmas.items()}
    track = Track("batch", "smoothed", LAYOUT, t, x, np.tile(P, (N, 1, 1)))
    return track, Truth(t, values, "", tiled)


def test_the_noise_of_the_truth_is_counted_per_state_and_jointly() -> None:
    track, truth = made()
    counted, exact = score(track, truth, []), score(track, Truth(truth.t, truth.values), [])
    assert counted.anees == pytest.approx(1, abs=0.03)
    assert counted.anees_without_truth_noise == exact.anees
    assert exact.anees is not None
    assert exact.anees > 5
    assert exact.anees_without_truth_noise is None
    for name, state in counted.states.items():
        assert state.anees == pytest.approx(1, abs=0.05), name
        assert state.anees_without_truth_noise == exact.states[name].anees
        assert state.rmse == exact.states[name].rmse
        assert state.sigma == exact.states[name].sigma
        assert state.inside_3sigma == pytest.approx(0.9973, abs=0.004)


def test_the_noise_of_blocks_reaches_what_follows_from_them() -> None:
    """Position in the target's axes, and the rate in o: jointly, as both owe to one attitude."""
    from relnav_factors.derived.relative_pose import PositionInTarget

    track, truth = made()
    seen = InAxes.of(BODY_RATE, "o", LAYOUT)
    found = score(track, truth, [PositionInTarget(), seen])
    assert found.states["position_in_target"].anees == pytest.approx(1, abs=0.05)
    assert found.states["body_rate"].anees == pytest.approx(1, abs=0.05)
    assert found.anees == pytest.approx(1, abs=0.03)
    # Said of the quantity itself, it wins over what follows.
    own = {**truth.sigmas, "position_in_target": np.full((N, 3), 10.0)}
    again = score(track, Truth(truth.t, truth.values, "", own), [PositionInTarget()])
    small = again.states["position_in_target"].anees
    assert small is not None
    assert small < 1e-3


def test_noise_in_the_body_axes_of_the_truth_is_turned_into_those_of_the_error() -> None:
    rng, h = np.random.default_rng(2), 1e-6
    R_est = so3.exp(np.array([0.3, -0.2, 0.9]))
    R_true = R_est @ so3.exp(np.array([1.1, -0.7, 0.4]))
    e = TARGET_ATTITUDE.local(R_est, R_true)
    one = np.eye(3)[None]
    noise = TruthNoise(Linear((TARGET_ATTITUDE,), one), rng.uniform(1, 2, (1, 3)))
    found = of_error(noise, TARGET_ATTITUDE, e[None])
    moved = [(TARGET_ATTITUDE.local(R_est, R_true @ so3.exp(h * d)) - e) / h for d in np.eye(3)]
    np.testing.assert_allclose(found.of.J[0], np.transpose(moved), atol=1e-5)
    half = np.diag([1.0, -1.0, -1.0])  # another value that says the same
    turned = of_error(
        noise, TARGET_ATTITUDE, TARGET_ATTITUDE.local(R_est, R_true @ half)[None], half[None]
    )
    e = TARGET_ATTITUDE.local(R_est, R_true @ half)
    moved = [
        (TARGET_ATTITUDE.local(R_est, R_true @ so3.exp(h * d) @ half) - e) / h for d in np.eye(3)
    ]
    np.testing.assert_allclose(turned.of.J[0], np.transpose(moved), atol=1e-5)


def test_points_and_what_follows_from_them_have_noise_too() -> None:
    """Two families' worth of constants, of which the truth was measured."""
    rng = np.random.default_rng(4)
    blocks = [POINT.numbered(i) for i in range(300)]
    statics, sigma, own = Layout(blocks), 1e-3, 2e-3
    X = rng.normal(size=(300, 3))
    seen = X + sigma * rng.standard_normal((300, 3))
    P = np.eye(900)[None] * sigma**2
    layout = Layout([RELATIVE_POSITION])
    track = Track(
        "batch", "smoothed", layout, np.zeros(1), np.zeros((1, 3)), np.eye(3)[None],
        statics=Statics(statics, seen.reshape(1, -1), P, np.zeros((1, 3, 900))),
    )  # fmt: skip
    values = {
        b.name: (x + own * rng.standard_normal(3))[None] for b, x in zip(blocks, X, strict=True)
    }
    sigmas = {b.name: np.full((1, 3), own) for b in blocks}
    found = score(track, Truth(np.zeros(1), values, "", sigmas), [])
    assert found.statics["point"].anees == pytest.approx(1, abs=0.15)
    assert found.statics_anees == pytest.approx(1, abs=0.15)
    middle, exact = found.statics["centre_of_mass"], found.statics["centre_of_mass"]
    assert middle.anees is not None
    assert exact.anees_without_truth_noise == pytest.approx(middle.anees * 5)  # 1 + (own/sigma)^2


def test_a_vector_in_axes_that_are_known_better_than_its_own() -> None:
    """Attitude errors of 15 degrees, a rate that is known to 0.1 deg/s in o: in its own axes no
    linear covariance says so."""
    rng, layout = np.random.default_rng(3), Layout([TARGET_ATTITUDE, BODY_RATE])
    seen = InAxes.of(BODY_RATE, "o", layout)
    w, R, x, P, values = np.array([1.0, 5.0, 0.5]) * DEGREE, np.eye(3), [], [], []
    sigma = np.array([15.0, 15, 15, 0.1, 0.1, 0.1]) * DEGREE
    for d in sigma * rng.standard_normal((500, 6)):
        R_true = R @ so3.exp(d[:3])
        values.append((R_true, R_true.T @ (R @ w + d[3:])))
        J = np.vstack([np.eye(3, 6), seen.value(R, w)[1]])
        K = np.linalg.inv(J)
        P.append(K @ np.diag(sigma**2) @ K.T)
        x.append(layout.pack({"target_attitude": R, "body_rate": w}))
    t = np.arange(500.0)
    track = Track("batch", "smoothed", layout, t, np.array(x), np.array(P))
    true = {b.name: np.array(v) for b, v in zip(layout, zip(*values, strict=True), strict=True)}
    body, outer = score(track, Truth(t, true), []), score(track, Truth(t, true), [seen])
    assert body.anees is not None
    assert body.anees > 4
    assert outer.anees == pytest.approx(1, abs=0.1)
    assert outer.states["body_rate"].anees == pytest.approx(1, abs=0.1)
    assert outer.states["body_rate"].rmse == pytest.approx(0.1 * np.sqrt(3), rel=0.05)
    left = score(track, Truth(t, true), [seen], without=["target_attitude"])
    assert left.anees_without == outer.states["body_rate"].anees
    assert (
        score(track, Truth(t, true), [], without=["target_attitude", "body_rate"]).anees_without
        is None
    )


@pytest.mark.parametrize("frame", ["o", "c", "i"])
def test_the_way_to_other_axes_is_that_of_the_attitudes(frame: str) -> None:
    from relnav_graph.core.catalogue import CHASER_ATTITUDE

    layout = Layout([CHASER_ATTITUDE, TARGET_ATTITUDE, BODY_RATE])
    if frame == "i":
        with pytest.raises(InputError, match="found 'i', expected other axes than its own, 't'"):
            InAxes.of(BODY_RATE, frame, layout)
        return
    seen, rng = InAxes.of(BODY_RATE, frame, layout), np.random.default_rng(1)
    x = layout.retract(layout.identity, rng.normal(size=layout.dim))
    own = layout.values(x)

    def at(x: Array) -> tuple[Array, Array]:
        values = layout.values(x)
        return seen.value(*(values[b.name] for b in seen.reads))

    v, J = at(x)
    R = own["target_attitude"]
    R = own["chaser_attitude"].T @ R if frame == "c" else R
    np.testing.assert_allclose(v, R @ own["body_rate"], atol=1e-14)
    columns = np.concatenate([np.arange(layout.dim)[layout.tangent(b.name)] for b in seen.reads])
    for j, k in enumerate(columns):
        d = np.zeros(layout.dim)
        d[k] = 1e-6
        slope = (at(layout.retract(x, d))[0] - at(layout.retract(x, -d))[0]) / 2e-6
        np.testing.assert_allclose(J[:, j], slope, atol=1e-8)


def test_summary_and_table_say_both() -> None:
    from relnav_graph.core.scored import Scored

    track, truth = made()
    scored = Scored((InAxes.of(BODY_RATE, "o", LAYOUT),), ("relative_position",))
    found = summary("a", None, [track], truth, list(scored.in_axes), None, N, (), scored)
    row = found["estimators"]["batch"]
    assert row["anees"] == pytest.approx(1, abs=0.03)
    assert row["anees_without_truth_noise"] > 5
    assert row["anees_without"] == pytest.approx(1, abs=0.04)
    assert row["states"]["target_attitude"]["anees_without_truth_noise"] > 5
    assert found["score"] == {"axes": {"body_rate": "o"}, "without": ["relative_position"]}
    text = table(json.loads(json.dumps(found, allow_nan=False)))
    assert "counts the covariance of the truth; were the truth exact, it would be: batch " in text
    assert "ANEES without relative_position: batch 1.0" in text
    assert "body_rate in o" in text
    plain = table(summary("a", None, [track], Truth(truth.t, truth.values), [], None, N))
    assert "truth exact" not in plain
    assert "ANEES without" not in plain


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from relnav_graph.cli.main import main

    folder = tmp_path_factory.mktemp("data") / "pass"
    with pytest.raises(SystemExit) as stop:
        main(["simulate", str(ZHANG), "--set", "time.epochs=40", "-o", str(folder)])
    assert not stop.value.code
    (folder / "dataset.toml").unlink()
    return folder


def recording(folder: Path, *settings: str) -> Recording:
    return open_pass(ZHANG, data=folder, assignments=settings).recording


def test_a_scenario_says_it_in_units(simulated: Path, capsys: Capture) -> None:
    noise = (
        'truth_noise={relative_position="1 m",relative_attitude=["0.6 deg","1.3 deg","0.6 deg"]}'
    )
    truth = recording(simulated, noise).truth
    assert truth is not None
    np.testing.assert_allclose(truth.sigmas["relative_position"][3], 1)
    np.testing.assert_allclose(np.degrees(truth.sigmas["relative_attitude"][0]), [0.6, 1.3, 0.6])
    arguments = ("compare", ZHANG, "-e", "batch", "--data", simulated, "--json")
    rows = {}
    for key, more in {"exact": (), "noisy": ("--set", noise)}.items():
        code, out, err = relnav(capsys, *arguments, *more)
        assert code == 0, err
        rows[key] = json.loads(out)["estimators"]["batch"]
    noisy, exact = (rows[k]["states"]["relative_position"] for k in ("noisy", "exact"))
    assert noisy["anees_without_truth_noise"] == exact["anees"]
    assert noisy["anees"] < exact["anees"]
    assert noisy["rmse"] == exact["rmse"]
    assert (
        rows["noisy"]["anees"]
        < rows["noisy"]["anees_without_truth_noise"]
        == rows["exact"]["anees"]
    )


@pytest.mark.parametrize(
    ("setting", "found"),
    [
        ("truth_noise.nothing=1", "truth_noise: found 'nothing', expected one of"),
        ("truth_noise.relative_position=-1", "truth_noise.relative_position: found -1.0 m"),
        ("truth_noise.relative_position=nan", "truth_noise.relative_position: found nan"),
        ('truth_noise.relative_position="1 deg"', "found unit 'deg', expected one like 'm'"),
        ("truth_noise.relative_position=[1,2]", "found shape (2,), expected (3,)"),
        ("truth_noise.relative_position=1e200", "expected one below 1e154"),
        ("truth_noise.relative_position=true", "truth_noise.relative_position: found True"),
        ("score.axes.nothing=o", "score.axes: found 'nothing', expected one of"),
        ("score.axes.target_attitude=o", "target_attitude is no vector of three"),
        ("score.axes.target_rate=x", "found 'x', expected other axes than its own"),
        ('score.without=["nothing"]', "score.without[0]: found 'nothing', expected one of"),
        ("score.nothing=1", "score.nothing"),
    ],
)  # fmt: skip
def test_row_36_what_is_wrong_with_it_is_named(setting: str, found: str, simulated: Path) -> None:
    with pytest.raises(InputError) as error:
        recording(simulated, setting)
    assert found in str(error.value)


def test_a_simulated_truth_is_exact(tmp_path: Path, simulated: Path) -> None:
    path = tmp_path / "noisy.toml"
    path.write_text(f'base = "{ZHANG}"\n[truth_noise]\nrelative_position = "1 m"\n')
    with pytest.raises(InputError, match="truth_noise: found one, but the truth is exact"):
        load_scenario(path)
    loaded = open_pass(path, data=simulated).scenario  # fits a recording
    with pytest.raises(InputError, match="truth_noise: found one, but the truth is exact"):
        open_pass(loaded)
    with pytest.raises(InputError, match="truth_noise"):
        prepare(StudySpec.of(loaded, 0, ()).to_json())


def with_sigmas(folder: Path, tmp_path: Path, **changes: Any) -> Path:
    """The data set with columns of sigmas beside the true position and attitude."""
    import shutil

    copy = tmp_path / "pass"
    shutil.copytree(folder, copy)
    for name, columns in changes.items():
        file = copy / f"truth_{name}.csv"
        head, *rows = file.read_text("utf-8").splitlines()
        named = ",".join(columns)
        values = ",".join(str(v) for v in columns.values())
        file.write_text("\n".join([f"{head},{named}", *(f"{r},{values}" for r in rows)]) + "\n")
    return copy


POSITION = {"sigma_x_m": 0.1, "sigma_y_m": 0.2, "sigma_z_m": 0.3}
ATTITUDE = {"sigma_x_rad": 0.01, "sigma_y_rad": 0.02, "sigma_z_rad": 0.03}


def test_truth_tables_may_have_columns_of_sigmas(simulated: Path, tmp_path: Path) -> None:
    folder = with_sigmas(simulated, tmp_path, relative_position=POSITION, target_attitude=ATTITUDE)
    opened = open_dataset(folder)
    truth = opened.recording.truth
    assert truth is not None
    np.testing.assert_allclose(truth.sigmas["relative_position"][7], [0.1, 0.2, 0.3])
    np.testing.assert_allclose(truth.sigmas["target_attitude"][7], [0.01, 0.02, 0.03])
    # What the scenario says wins, block by block.
    other = open_dataset(folder, ["truth_noise.relative_position=2"]).recording.truth
    assert other is not None
    np.testing.assert_array_equal(other.sigmas["relative_position"][7], [2, 2, 2])
    np.testing.assert_array_equal(other.sigmas["target_attitude"], truth.sigmas["target_attitude"])
    # Results hold them, and so does a data set that is written of this one.
    blocks = {b.name: b for b in opened.scenario.layout}
    write_results(tmp_path / "results.nc", [], truth, {}, list(blocks.values()))
    _, back, _ = read_results(tmp_path / "results.nc")
    assert back is not None
    for name, sigma in truth.sigmas.items():
        np.testing.assert_array_equal(back.sigmas[name], sigma)


def test_sigmas_between_rows_are_those_about_them(simulated: Path, tmp_path: Path) -> None:
    folder = with_sigmas(simulated, tmp_path, relative_position=POSITION)
    file = folder / "truth_relative_position.csv"
    head, *rows = file.read_text("utf-8").splitlines()
    rows[2] = rows[2].rsplit(",", 3)[0] + ",0.3,0.4,0.5"
    del rows[1]
    file.write_text("\n".join([head, *rows]) + "\n")
    truth = open_dataset(folder).recording.truth
    assert truth is not None
    np.testing.assert_allclose(truth.sigmas["relative_position"][1], [0.2, 0.3, 0.4])


@pytest.mark.parametrize(
    ("columns", "found"),
    [
        ({**POSITION, "sigma_y_m": -1}, "column sigma_y_m: found -1.0, expected a sigma of zero"),
        ({"sigma_x_m": 1}, "no column 'sigma_y_m'"),
        ({**POSITION, "sigma_x_rad": 1}, "unknown column 'sigma_x_rad'"),
        ({**POSITION, "sigma_z_m": "inf"}, "column sigma_z_m: found inf, expected a finite"),
    ],
)  # fmt: skip
def test_row_42_faulty_columns_of_sigmas_are_refused_with_their_place(
    columns: dict[str, Any], found: str, simulated: Path, tmp_path: Path
) -> None:
    folder = with_sigmas(simulated, tmp_path, relative_position=columns)
    with pytest.raises(InputError, match=r"truth_relative_position\.csv, line") as error:
        open_dataset(folder)
    assert found in str(error.value)


def test_an_unknown_truth_has_no_noise(simulated: Path, caplog: Any) -> None:
    truth = recording(simulated, "truth_noise.gyro_bias=1").truth
    assert truth is not None
    assert "gyro_bias" in truth.sigmas or "the truth does not know gyro_bias" in caplog.text


def test_errors_bear_the_noise_of_their_truth() -> None:
    track, truth = made({"relative_position": TRUTH["relative_position"]})
    found = errors(track, truth, [])
    assert found["target_attitude"].noise is None
    np.testing.assert_allclose(
        found["relative_position"].S[0],
        np.diag(SIGMA[:3] ** 2 + TRUTH["relative_position"] ** 2),
    )
