"""The reader of Level-1B data of GRACE-FO: files as the handbook has them, of two circles."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from relnav_graph.arrays import Array
from relnav_graph.constants import MU_EARTH
from relnav_graph.errors import InputError
from relnav_graph.io.readers import read_raw
from relnav_graph.maths.earth import itrf_from_gcrf
from relnav_graph.maths.instants import Instant

EPOCHS, RADIUS, BEHIND = 30, 6.87e6, 2.2e5
RATE = float(np.sqrt(MU_EARTH / RADIUS**3))
#: 2019-01-01 00:00:10 GPS time.
FIRST = 599572810
BEGIN = Instant.parse("2019-01-01T00:00:10 GPS")
T = 5.0 * np.arange(EPOCHS, dtype=np.float64)
BIAS, LIGHT, ANTENNA = -1234567.5, 3e-4, -1.5


def circle(late: float) -> Array:
    """Position and velocity (N, 6) in i on a polar circle, `late` seconds behind."""
    angle, zero = RATE * (T - late), np.zeros_like(T)
    r = RADIUS * np.stack([np.cos(angle), zero, np.sin(angle)], axis=1)
    v = RADIUS * RATE * np.stack([-np.sin(angle), zero, np.cos(angle)], axis=1)
    return np.hstack([r, v])


ORBITS = {"C": circle(BEHIND / (RADIUS * RATE)), "D": circle(0.0)}
#: Axes of D: x to C, which is behind, z down.
DOWN = -ORBITS["D"][:, :3] / RADIUS
BACK = -ORBITS["D"][:, 3:] / (RADIUS * RATE)
R_ID = np.stack([BACK, np.cross(DOWN, BACK), DOWN], axis=2)
APART = ORBITS["D"][:, :3] - ORBITS["C"][:, :3]
DISTANCE = np.linalg.norm(APART, axis=1)
HEADER = (
    "header:\n  dimensions:\n    num_records: 30\n  non-standard_attributes:\n"
    "    epoch_time: 2000-01-01T12:00:00.00\n# End of YAML header\n"
)


def orbit(craft: str, fixed: bool) -> list[str]:
    r, v = ORBITS[craft][:, :3], ORBITS[craft][:, 3:]
    if fixed:
        r, v = itrf_from_gcrf(BEGIN, T, r, v)
    frame, error = "E" if fixed else "I", " 0.01  0.01 0.01"
    return [
        f"{FIRST + 5 * k} {craft} {frame} {' '.join(map(repr, r[k].tolist()))}{error}"
        f"   {' '.join(map(repr, v[k].tolist()))} {error} 00000000"
        for k in range(EPOCHS)
    ]


def link() -> list[str]:
    """What is measured lacks the light time and the antennas, which stand beside it."""
    rows = []
    for k in range(0, EPOCHS, 2):
        z = float(DISTANCE[k]) + BIAS - LIGHT - ANTENNA
        flag = "00000001" if k == 4 else "00000000"
        corrections = f"{LIGHT} 1e-7 0 {ANTENNA} 2e-7 0"
        rows.append(f"{FIRST + 5 * k} {z!r} -3e-7 0 0.25 {corrections} 600 700 600 700 {flag}")
    return rows


def attitude() -> list[str]:
    q = Rotation.from_matrix(R_ID).as_quat(scalar_first=True)
    return [
        f"{FIRST + 5 * k} D 3 {' '.join(map(repr, q[k].tolist()))} 0.001  00000000"
        for k in range(EPOCHS)
    ]


FILES = {
    "GNV1B_2019-01-01_C_04.txt": orbit("C", True),
    "GNV1B_2019-01-01_D_04.txt": orbit("D", True),
    "KBR1B_2019-01-01_Y_04.txt": link(),
    "SCA1B_2019-01-01_D_04.txt": attitude(),
}


def write(folder: Path, header: str = HEADER, **changes: dict[int, str]) -> Path:
    """All files; changes: rows to replace, from zero, by product and spacecraft (GNV1B_C)."""
    for name, rows in FILES.items():
        key = name[:6] + name[17]
        lines = [changes.get(key, {}).get(k, row) for k, row in enumerate(rows)]
        text = (header + "\n".join(lines) + "\n").encode()
        if name.startswith("SCA"):
            (folder / f"{name}.gz").write_bytes(gzip.compress(text))
        else:
            (folder / name).write_bytes(text)
    return folder


def read(folder: Path, **options: Any) -> Any:
    return read_raw("grace_l1b", folder, options)


def test_earth_fixed_orbits_and_attitudes_are_those_among_the_stars(tmp_path: Path) -> None:
    found = read(write(tmp_path))
    assert found.epoch == BEGIN
    np.testing.assert_array_equal(found.times, T)
    values = found.truth.values
    np.testing.assert_allclose(values["chaser_position"], ORBITS["D"][:, :3], atol=1e-5)
    np.testing.assert_allclose(values["chaser_velocity"], ORBITS["D"][:, 3:], atol=1e-7)
    np.testing.assert_allclose(values["relative_position"], APART, atol=1e-5)
    np.testing.assert_allclose(values["chaser_attitude"], R_ID, atol=1e-14)
    # x of the science reference frame is along the line to the other one, but for the pitch.
    ahead = np.einsum("ni,ni->n", values["chaser_attitude"][:, :, 0], -APART) / DISTANCE
    np.testing.assert_allclose(ahead, np.cos(0.5 * BEHIND / RADIUS), rtol=1e-3)


def test_ranges_have_both_corrections_and_a_bias(tmp_path: Path) -> None:
    found = read(write(tmp_path), range="link", range_rate="rate", attitude="stars", start=10.0)
    z = {n: np.array([m.z[0] for m in found.measurements if m.sensor == n]) for n in NAMES}
    t = [m.t for m in found.measurements if m.sensor == "link"]
    assert t == list(T[:-2:2])  # from the third epoch on
    np.testing.assert_allclose(z["link"][:, 0], DISTANCE[2::2] + BIAS, atol=1e-9)
    np.testing.assert_allclose(z["rate"], -3e-7 + 1e-7 + 2e-7, atol=1e-20)
    q = Rotation.from_matrix(R_ID[2:]).as_quat(canonical=True, scalar_first=True)
    np.testing.assert_allclose(z["stars"], q, atol=1e-14)
    values = found.truth.values
    assert "chaser_attitude" not in values
    np.testing.assert_allclose(values["range_bias"], BIAS, atol=1e-4)
    np.testing.assert_allclose(values["range_drift"], 0, atol=1e-4)
    np.testing.assert_allclose(values["range_rate_bias"], 0, atol=1e-6)
    other = read(tmp_path, range="link", leave_flagged=True)
    assert 20.0 not in [m.t for m in other.measurements]
    assert len(other.measurements) == EPOCHS // 2 - 1


NAMES = ("link", "rate", "stars")


def test_inertial_orbits_come_first_and_either_one_is_the_chaser(tmp_path: Path) -> None:
    write(tmp_path)
    for craft in "CD":
        text = HEADER + "\n".join(orbit(craft, False)) + "\n"
        (tmp_path / f"GNI1B_2019-01-01_{craft}_04.txt").write_text(text)
    found = read(tmp_path, chaser="C", duration=50.0)
    assert len(found.times) == 11
    np.testing.assert_array_equal(found.truth.values["chaser_position"], ORBITS["C"][:11, :3])
    also = read(tmp_path, orbit="GNV1B", chaser="C")
    np.testing.assert_allclose(also.truth.values["relative_position"], -APART, atol=1e-5)
    with pytest.raises(InputError, match=r"expected one LRI1B_\*_Y_\*"):
        read(tmp_path, range="link", instrument="LRI1B")
    with pytest.raises(InputError, match="found 'E', expected 'C' or 'D'"):
        read(tmp_path, chaser="E")
    (tmp_path / "GNI1B_2019-01-02_C_04.txt").write_text("")
    assert len(read(tmp_path, run="01-01").times) == EPOCHS


ROW = FILES["GNV1B_2019-01-01_C_04.txt"][3].split()
BAD = {
    "short": ("GNV1B_C", " ".join(ROW[:-1]), "line 10: found 15 columns, expected 16: gps_time GR"),
    "word": ("GNV1B_C", " ".join(["now", *ROW[1:]]), "line 10, column gps_time: found 'now'"),
    "back": ("GNV1B_C", " ".join(["1", *ROW[1:]]), "line 10: found a time that is not after"),
    "km": ("GNV1B_C", " ".join([*ROW[:3], "6870", "0", "0", *ROW[6:]]), r"line 10: .*km given\?"),
    "frame": ("GNV1B_C", " ".join([*ROW[:2], "I", *ROW[3:]]), "found coord_ref E, I of C, expect"),
    "long": ("SCA1B_D", f"{FIRST + 15} D 3 1 1 0 0 0 0", "line 10: found the quaternion"),
}


@pytest.mark.parametrize("name", BAD)
def test_damaged_files(tmp_path: Path, name: str) -> None:
    key, row, message = BAD[name]
    with pytest.raises(InputError, match=message):
        read(write(tmp_path, HEADER, **{key: {3: row}}))


def test_another_zero_of_time_or_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="line 5: found epoch_time 1980-01-06"):
        read(write(tmp_path, HEADER.replace("2000-01-01T12", "1980-01-06T00")))
    with pytest.raises(InputError, match="no line '# End of YAML header'"):
        read(write(tmp_path, "header:\n"))
    with pytest.raises(InputError, match="found no file, expected two of GNI1B or GNV1B"):
        read(tmp_path, run="2020")


def test_a_file_that_was_cut_says_so(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    read(write(tmp_path, HEADER.replace("30", str(EPOCHS + 1))))
    assert f"found {EPOCHS} rows, and num_records {EPOCHS + 1}: is it a part?" in caplog.text
