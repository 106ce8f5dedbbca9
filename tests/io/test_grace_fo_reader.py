"""The reader of precise orbits of two spacecraft, and sensors simulated on its truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from passes import EXPERIMENTS, recorded, relnav
from relnav_factors.dynamics.relative_two_body import RelativeTwoBody

from relnav_graph.arrays import Array
from relnav_graph.constants import MU_EARTH
from relnav_graph.core.absolute_time import AbsoluteTime
from relnav_graph.errors import InputError
from relnav_graph.io.readers import read_raw

GRACE = EXPERIMENTS / "grace_fo.toml"
EPOCHS, STEP, RADIUS, BEHIND = 40, 10.0, 6.87e6, 2.05e5
RATE = float(np.sqrt(MU_EARTH / RADIUS**3))
T = STEP * np.arange(EPOCHS, dtype=np.float64)


#: The circles below are about a sphere: as the scenario, without the harmonics.
SPHERE = tuple(
    word
    for process in ("relative_orbit", "chaser_orbit")
    for key in ("degree", "order")
    for word in ("--set", f"processes.{process}.{key}=0")
)


def circle(t: Array, late: float) -> Array:
    """Position and velocity (N, 6) on a polar circle, `late` seconds behind."""
    angle = RATE * (t - late)
    zero = np.zeros_like(t)
    r = RADIUS * np.stack([np.cos(angle), zero, np.sin(angle)], axis=1)
    v = RADIUS * RATE * np.stack([-np.sin(angle), zero, np.cos(angle)], axis=1)
    return np.hstack([r, v])


def lines_of(name: str, late: float, first: int = 0) -> list[str]:
    """A file of one spacecraft; it goes over midnight."""
    header = [
        "GEORB format file",
        "Data functional                   :  Orbit",
        f"Orbiting Object/Satellite         :  {name} ",
        "Reference Frame                   :  ICRF ",
        "Time scale                        :  Terrestrial Time ",
        "end_of_header                     ",
    ]
    t = T[first:]
    rows = []
    for s, y in zip(t + 86300.0, circle(t, late), strict=True):
        day, seconds = 59412 + s // 86400, s % 86400
        rows.append(f"  {day:.0f} {seconds:.9f} " + " ".join(f"{v:.12f}" for v in y))
    return header + rows


def write(folder: Path, *, first: int = 0, suffix: str = "", **changes: dict[int, str]) -> Path:
    """Both files; changes: lines to replace, by number, in the file of C or of D."""
    for letter, late in (("C", 0.0), ("D", BEHIND / (RADIUS * RATE))):
        lines = lines_of(f"GRACE-{letter}", late, first if letter == "D" else 0)
        for number, line in changes.get(letter, {}).items():
            lines[number - 1] = line
        (folder / f"pass_{letter}{suffix}.orb").write_text("\n".join(lines) + "\n")
    return folder


def test_what_the_recording_holds(tmp_path: Path) -> None:
    recording = read_raw("grace_fo", write(tmp_path, first=3))
    assert recording.truth is not None
    assert not recording.measurements
    np.testing.assert_allclose(recording.times, T[: EPOCHS - 3], atol=1e-6)
    t = T[3:]
    r_c, r_t = circle(t, BEHIND / (RADIUS * RATE)), circle(t, 0.0)
    values = recording.truth.values
    np.testing.assert_allclose(values["chaser_position"], r_c[:, :3], atol=1e-6)
    np.testing.assert_allclose(values["chaser_velocity"], r_c[:, 3:], atol=1e-6)
    np.testing.assert_allclose(values["relative_position"], (r_c - r_t)[:, :3], atol=1e-6)
    np.testing.assert_allclose(values["relative_velocity"], (r_c - r_t)[:, 3:], atol=1e-6)
    assert recording.settings == {"time": {"epoch": "2021-07-17T23:58:50 TT"}}  # over midnight
    later = read_raw("grace_fo", tmp_path, {"start": 70.0}).settings
    assert later == {"time": {"epoch": "2021-07-18T00:00:00 TT"}}


def test_roles_and_parts_of_a_pass(tmp_path: Path) -> None:
    whole = read_raw("grace_fo", write(tmp_path))
    other = read_raw("grace_fo", tmp_path, {"chaser": "GRACE-C"})
    part = read_raw("grace_fo", tmp_path, {"start": 50, "duration": 100})
    assert whole.truth is not None
    assert other.truth is not None
    assert part.truth is not None
    r = "relative_position"
    np.testing.assert_array_equal(whole.truth.values[r], -other.truth.values[r])
    np.testing.assert_array_equal(whole.truth.values[r][5:16], part.truth.values[r])
    np.testing.assert_allclose(part.times, T[:11], atol=1e-6)
    with pytest.raises(InputError, match=r"start = 500 s .*, expected two epochs or more of 0 to"):
        read_raw("grace_fo", tmp_path, {"start": 500})
    with pytest.raises(InputError, match="found 'GRACE-E', expected 'GRACE-C' or 'GRACE-D'"):
        read_raw("grace_fo", tmp_path, {"chaser": "GRACE-E"})
    write(tmp_path, suffix="_later")
    with pytest.raises(InputError, match=r"expected two files \*\.orb; name the pass by a part"):
        read_raw("grace_fo", tmp_path)
    assert len(read_raw("grace_fo", tmp_path, {"run": "later"}).times) == EPOCHS


ROW = lines_of("GRACE-D", 0.0)[9]
WORDS = ROW.split()
BAD: dict[str, tuple[dict[int, str], str]] = {
    "frame": ({4: "Reference Frame : ITRF"}, "line 4: found Reference Frame 'ITRF', expected ICRF"),
    "clock": ({5: "Time scale : GPS Time"}, "line 5: found Time scale 'GPS Time', expected Terr"),
    "no frame": ({4: ""}, "found no line 'Reference Frame' in the header"),
    "no name": ({3: ""}, "found no line 'Orbiting Object/Satellite'"),
    "no end": ({6: ""}, "no line 'end_of_header'"),
    "short": ({10: ROW[:40]}, "line 10: found .* numbers, expected 8"),
    "word": ({10: ROW.replace(WORDS[2], "none")}, "line 10: found .*none.*could not convert"),
    "nan": ({10: ROW.replace(WORDS[5], "nan")}, "line 10: found a number that is not finite"),
    "backwards": ({10: ROW.replace(WORDS[1], "86300.0")}, "line 10: found a time that is not"),
    "kilometres": (
        {10: " ".join(WORDS[:2] + [str(float(w) / 1e3) for w in WORDS[2:]])},
        r"line 10: found a position of 6870 m, expected .* \(km given\?\)",
    ),
    "same": ({3: "Orbiting Object/Satellite : GRACE-C"}, "found two orbits of GRACE-C"),
}


@pytest.mark.parametrize("fault", BAD)
def test_a_wrong_file_is_refused_by_file_and_line(tmp_path: Path, fault: str) -> None:
    changes, message = BAD[fault]
    with pytest.raises(InputError, match=message) as found:
        read_raw("grace_fo", write(tmp_path, D=changes))
    assert fault == "same" or "pass_D.orb" in str(found.value)


def test_files_that_are_missing_or_of_different_days(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"found no file, expected two files \*\.orb"):
        read_raw("grace_fo", tmp_path)
    write(tmp_path)
    later = (tmp_path / "pass_D.orb").read_text().replace(" 59413 ", " 59500 ")
    (tmp_path / "pass_D.orb").write_text(later.replace(" 59412 ", " 59499 "))
    with pytest.raises(InputError, match="found 0 epochs in common, expected two or more"):
        read_raw("grace_fo", tmp_path)
    (tmp_path / "pass_D.orb").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"pass_D\.orb: not a readable text"):
        read_raw("grace_fo", tmp_path)


def test_sensors_are_simulated_on_the_truth_from_the_seed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    raw = tmp_path / "raw"
    raw.mkdir()
    write(raw)
    one, same, other = (tmp_path / name for name in ("one", "same", "other"))
    for out, seed in ((one, 3), (same, 3), (other, 4)):
        code, _, err = relnav(
            capsys, "convert", raw, out, "--scenario", GRACE, "--set", f"seed={seed}"
        )
        assert code == 0, err
    assert (one / "laser.csv").read_bytes() == (same / "laser.csv").read_bytes()
    assert (one / "laser.csv").read_bytes() != (other / "laser.csv").read_bytes()
    table = np.loadtxt(one / "laser.csv", delimiter=",", skiprows=1)
    assert table.shape == (EPOCHS, 5)
    spread = 5 + 0.0006 * BEHIND
    assert 0.6 * spread < np.std(table[:, 2]) < 1.5 * spread
    # The data set has its measurements: they are read, not drawn again.
    code, _, err = relnav(capsys, "compare", GRACE, "--data", one, "-e", "ekf", "--json")
    assert code == 0, err


def test_what_to_simulate_must_be_a_sensor(capsys: pytest.CaptureFixture[str]) -> None:
    change = 'data.simulate=["lazer"]'
    code, _, err = relnav(capsys, "validate", GRACE, "--set", change)
    assert code == 2
    assert "data.simulate[0]: unknown sensor 'lazer'; known are laser, gps" in err


@pytest.fixture
def real() -> Path:
    return recorded("grace_fo")


def test_the_real_orbits_are_what_their_header_says(real: Path) -> None:
    """Positions and velocities agree (by the trapezium rule), and the craft are 205 km apart."""
    recording = read_raw("grace_fo", real)
    assert recording.truth is not None
    values, h = recording.truth.values, np.diff(recording.times)[:, None]
    for place, speed in (
        ("chaser_position", "chaser_velocity"),
        ("relative_position", "relative_velocity"),
    ):
        r, v = values[place], values[speed]
        moved = 0.5 * h * (v[1:] + v[:-1])
        # What the trapezium rule leaves out: h^3 / 12 times the second derivative of v.
        bound = h.max() / 12 * np.linalg.norm(np.diff(v, 2, axis=0), axis=1).max()
        assert np.abs(np.diff(r, axis=0) - moved).max() < 1.1 * bound
    apart = np.linalg.norm(values["relative_position"], axis=1)
    assert 1.9e5 < apart.min() < apart.max() < 2.2e5


@pytest.mark.parametrize(
    ("order", "epochs", "low", "high"),
    [(0, 6, 0.03, 0.06), (0, 60, 2.0, 3.2), (20, 6, 0.008, 0.015), (20, 60, 0.05, 0.3)],
)
def test_the_model_errs_on_the_real_orbits_as_the_scenario_says(
    real: Path, order: int, epochs: int, low: float, high: float
) -> None:
    """RMS of the relative position after a minute and after ten, m, of J2 alone and of 20x20."""
    recording = read_raw("grace_fo", real)
    assert recording.truth is not None
    names = ("relative_position", "relative_velocity", "chaser_position", "chaser_velocity")
    x, t = [recording.truth.values[n] for n in names], recording.times
    clock = AbsoluteTime(recording.settings["time"]["epoch"])
    field: dict[str, Any] = {"degree": max(order, 2), "order": order, "clock": clock}
    model, errors = RelativeTwoBody(acceleration_density=1e-4, **field), []
    for k in range(0, len(t) - epochs, 60):
        u = np.array([[t[k + epochs] - t[k]]])
        found, _ = model.propagate(float(t[k]), u, *(v[k] for v in x))
        errors.append(np.linalg.norm(found - x[0][k + epochs]))
    assert low < np.sqrt(np.mean(np.square(errors))) < high


def test_smoother_and_filter_on_the_real_orbits(
    real: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Over the middle half of twelve hours, at the noise of yang2016's laser: what ten runs have at
    most, 8.2 and 4.2 m, lies above the lower ends of the intervals of two."""
    arguments = ("study", GRACE, "--data", real, "-e", "ekf", "-e", "rts", "--runs", 2)
    code, out, err = relnav(capsys, *arguments, "--json")
    assert code == 0, err
    rows = json.loads(out)["estimators"]
    errors = {n: row["states"]["relative_position"] for n, row in rows.items()}
    assert errors["ekf"]["rmse_ci"][0] <= 8.2
    assert errors["rts"]["rmse_ci"][0] <= 4.2
    assert errors["rts"]["rmse"] < 0.6 * errors["ekf"]["rmse"]
    assert all(0.7 < row["anees"] < 1.5 for row in rows.values())


def test_a_study_draws_sensors_anew_on_recorded_orbits(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each run as `compare --run` has it; the data are known by what they hold, not by where."""
    raw, moved, out = (tmp_path / name for name in ("raw", "moved", "study"))
    raw.mkdir()
    write(raw)
    study = ("study", GRACE, *SPHERE, "-e", "ekf", "-e", "rts", "-j", 1, "-o", out, "--json")
    code, text, err = relnav(capsys, *study, "--data", raw, "--runs", 3)
    assert code == 0, err
    found = json.loads(text)
    assert (found["runs"], found["epochs"], found["failed"]) == (3, EPOCHS, [])
    squares = []
    for run in range(3):
        line = ("compare", GRACE, *SPHERE, "--data", raw, "-e", "ekf", "--run", run, "--json")
        code, one, err = relnav(capsys, *line)
        assert code == 0, err
        states = json.loads(one)["estimators"]["ekf"]["states"]
        squares.append(states["relative_position"]["rmse"] ** 2)
    state = found["estimators"]["ekf"]["states"]["relative_position"]
    assert state["rmse"] == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-12)
    assert len(set(squares)) == 3
    assert state["bound"] > 0
    raw.rename(moved)
    code, text, err = relnav(capsys, *study, "--data", moved, "--runs", 4)
    assert code == 0, err
    assert json.loads(text)["runs"] == 4
    assert "3 of 4 runs are there" in err
    write(moved, first=1)
    code, _, err = relnav(capsys, *study, "--data", moved, "--runs", 4)
    assert code == 2
    assert "holds another study: data." in err


def test_row_59_a_study_of_recorded_data_that_draws_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path)
    code, _, err = relnav(capsys, "study", GRACE, "--runs", 2)
    assert code == 2
    assert "recorded data (--data) with a truth" in err
    code, _, err = relnav(capsys, "study", GRACE, "--set", "data.simulate=[]", "--data", tmp_path)
    assert code == 2
    assert "expected sensors that are drawn anew" in err
