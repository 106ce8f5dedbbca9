"""The reader of the range between two spacecraft and of their orbits, Earth-fixed."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
from passes import EXPERIMENTS, recorded, relnav

from relnav_graph.arrays import Array
from relnav_graph.constants import MU_EARTH
from relnav_graph.errors import InputError
from relnav_graph.io.readers import read_raw
from relnav_graph.maths.earth import itrf_from_gcrf
from relnav_graph.maths.instants import Instant

KBR = EXPERIMENTS / "grace_kbr.toml"
EPOCHS, RADIUS, BEHIND, OFFSET = 40, 6.87e6, 2.2e5, -0.5
RATE = float(np.sqrt(MU_EARTH / RADIUS**3))
#: 100 s before a midnight of GPS time.
T = 10.0 * np.arange(EPOCHS, dtype=np.float64)
BEGIN = Instant.of(55404, 86300.0, "GPS")


def circle(late: float) -> Array:
    """Position and velocity (N, 6) in i on a polar circle, `late` seconds behind."""
    angle, zero = RATE * (T - late), np.zeros_like(T)
    r = RADIUS * np.stack([np.cos(angle), zero, np.sin(angle)], axis=1)
    v = RADIUS * RATE * np.stack([-np.sin(angle), zero, np.cos(angle)], axis=1)
    return np.hstack([r, v])


ORBITS = {"grca": circle(0.0), "grcb": circle(BEHIND / (RADIUS * RATE))}


def stamps() -> list[str]:
    seconds = (86300 + T).astype(int)
    days = [f"{27 + s // 86400}/7/2010" for s in seconds]
    return [
        f"{day},{s % 86400 // 3600:02d}:{s % 3600 // 60:02d}:{s % 60:02d}"
        for day, s in zip(days, seconds, strict=True)
    ]


def lines_of(name: str) -> list[str]:
    if name == "grc_kb":
        apart = np.linalg.norm(ORBITS["grcb"][:, :3] - ORBITS["grca"][:, :3], axis=1)
        return [f"{s},{z:.6f}" for s, z in zip(stamps(), apart + OFFSET, strict=True)]
    r, v = itrf_from_gcrf(BEGIN, T, ORBITS[name][:, :3], ORBITS[name][:, 3:])
    rows = np.hstack([1e-3 * r, 10 * v])
    return [
        f"{s}," + ",".join(f"{x:.12g}" for x in row) for s, row in zip(stamps(), rows, strict=True)
    ]


def write(folder: Path, **changes: dict[int, str]) -> Path:
    """All three files; changes: lines to replace, by number, in that of a name."""
    for name, end in (("grca", "truth"), ("grcb", "truth"), ("grc_kb", "rng")):
        lines = lines_of(name)
        for number, line in changes.get(name, {}).items():
            lines[number - 1] = line
        packed = gzip.compress(("\n".join(lines) + "\n").encode())
        (folder / f"{name}_{end}.csv.gz").write_bytes(packed)
    return folder


def test_orbits_are_turned_to_the_stars_over_a_midnight(tmp_path: Path) -> None:
    recording = read_raw("grace_kbr", write(tmp_path))
    assert recording.truth is not None
    np.testing.assert_allclose(recording.times, T)
    values = recording.truth.values
    want = {"chaser_position": ORBITS["grcb"][:, :3], "chaser_velocity": ORBITS["grcb"][:, 3:]}
    between = ORBITS["grcb"] - ORBITS["grca"]
    want |= {"relative_position": between[:, :3], "relative_velocity": between[:, 3:]}
    for name, numbers in want.items():
        np.testing.assert_allclose(values[name], numbers, atol=1e-3 if "pos" in name else 1e-6)
    assert recording.settings is not None
    assert recording.settings["time"]["epoch"] == str(BEGIN)
    assert str(BEGIN) == "2010-07-27T23:59:11.184 TT"


def test_the_range_and_what_it_has_too_much(tmp_path: Path) -> None:
    write(tmp_path)
    recording = read_raw("grace_kbr", tmp_path, {"sensor": "link", "start": 50.0, "chaser": "grca"})
    assert [m.t for m in recording.measurements] == list(T[: EPOCHS - 5])
    assert {m.sensor for m in recording.measurements} == {"link"}
    assert recording.truth is not None
    bias, drift = (recording.truth.values[n] for n in ("range_bias", "range_drift"))
    np.testing.assert_allclose(bias, OFFSET, atol=1e-3)
    assert np.ptp(bias) == 0.0
    assert abs(drift.mean()) < 1e-9
    r = recording.truth.values["chaser_position"]
    np.testing.assert_allclose(r, ORBITS["grca"][5:, :3], atol=1e-3)
    bare = read_raw("grace_kbr", tmp_path, {"sensor": ""})
    assert not bare.measurements
    assert bare.truth is not None
    assert "range_bias" not in bare.truth.values


ROW = lines_of("grcb")[9].split(",")
BAD = {
    "short": ("grcb", ",".join(ROW[:7]), "line 10: found 7 columns, expected 8: day, time, X"),
    "word": ("grcb", ",".join([*ROW[:7], "none"]), "line 10: found .*none.*could not convert"),
    "nan": ("grcb", ",".join([*ROW[:7], "nan"]), "line 10: found a number that is not finite"),
    "day": ("grcb", ",".join(["31/2/2010", *ROW[1:]]), "line 10: found the day '31/2/2010'"),
    "iso": (
        "grcb",
        ",".join(["2010-07-27", *ROW[1:]]),
        "line 10: found '2010-07-27', .*expec",
    ),
    "clock": ("grcb", ",".join([ROW[0], "24:00:00", *ROW[2:]]), "line 10: .*no such time of a day"),
    "back": ("grcb", ",".join([ROW[0], "00:00:00", *ROW[2:]]), "line 10: found a time that is not"),
    "metres": (
        "grcb",
        ",".join([*ROW[:2], *(str(1e3 * float(x)) for x in ROW[2:5]), *ROW[5:]]),
        r"line 10: found a position of 6.87e\+09 m, expected .*\(m for km given\?\)",
    ),
    "speed": (
        "grcb",
        ",".join([*ROW[:5], *(str(10 * float(x)) for x in ROW[5:])]),
        r"line 10: found a velocity of .* m/s, expected .*\(another unit for dm/s given\?\)",
    ),
    "range": ("grc_kb", ",".join([*ROW[:2], "-1"]), r"line 10: found a range of -1\.0 m, expected"),
}


@pytest.mark.parametrize("fault", BAD)
def test_a_wrong_row_is_refused_by_file_and_line(tmp_path: Path, fault: str) -> None:
    name, line, message = BAD[fault]
    with pytest.raises(InputError, match=message) as found:
        read_raw("grace_kbr", write(tmp_path, **{name: {10: line}}))
    assert f"{name}_" in str(found.value)


def test_files_that_are_missing_damaged_or_of_another_pass(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"found no file, expected two files \*_truth"):
        read_raw("grace_kbr", tmp_path)
    write(tmp_path)
    own = tmp_path / "grc_kb_rng.csv.gz"
    in_km = [line[: line.rindex(",")] + ",220.0" for line in lines_of("grc_kb")]
    own.write_bytes(gzip.compress("\n".join(in_km).encode()))
    with pytest.raises(InputError, match=r"found ranges of 220 m, but the orbits are 2\d{5} m"):
        read_raw("grace_kbr", tmp_path)
    later = [line.replace("/2010", "/2011") for line in lines_of("grc_kb")]
    own.write_bytes(gzip.compress("\n".join(later).encode()))
    with pytest.raises(InputError, match="found no epoch in common with the orbits"):
        read_raw("grace_kbr", tmp_path)
    own.write_bytes(own.read_bytes()[:40])
    with pytest.raises(InputError, match=r"grc_kb_rng\.csv\.gz: not a readable CSV table"):
        read_raw("grace_kbr", tmp_path)
    own.unlink()
    with pytest.raises(InputError, match=r"no file \*_rng\.csv\*"):
        read_raw("grace_kbr", tmp_path)


@pytest.fixture
def real() -> Path:
    return recorded("grace_kbr")


def test_real_range_and_real_orbits_agree_to_a_centimetre(real: Path) -> None:
    """And positions agree with velocities, by central differences of the eighth order."""
    recording = read_raw("grace_kbr", real)
    assert recording.truth is not None
    values = recording.truth.values
    assert float(values["range_bias"][0, 0]) == pytest.approx(-0.0128, abs=1e-3)
    assert float(values["range_drift"].std()) == pytest.approx(0.0099, abs=5e-4)
    weights = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
    for of in ("chaser", "relative"):
        r, v = values[f"{of}_position"], values[f"{of}_velocity"]
        n = len(r) - 8
        moved = sum(w * (r[4 + k : 4 + k + n] - r[4 - k : 4 - k + n]) for k, w in weights.items())
        assert np.abs(moved / 10.0 - v[4:-4]).max() < 1e-3


def test_smoothed_distance_is_as_good_as_range_and_orbits(
    real: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ("compare", KBR, "--data", real, "-e", "rts", "--json")
    code, out, err = relnav(capsys, *arguments)
    assert code == 0, err
    states = json.loads(out)["estimators"]["rts"]["states"]
    assert states["range_drift"]["rmse"] < 0.015
    assert states["relative_position"]["rmse"] < 0.5
    assert states["relative_position"]["anees"] < 2.5
    assert states["range_drift"]["anees"] < 1.6
