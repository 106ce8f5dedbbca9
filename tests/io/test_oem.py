"""CCSDS OEM: round trips, an independent library, frames, time systems, roles, what is refused."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from against_brahe import eme2000_apart, needs_brahe
from ccsds import EPOCH, formation, message, track
from independent import ccsds_oem_apart

from relnav_graph import read_raw, write_track
from relnav_graph.arrays import Array
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError
from relnav_graph.io.ccsds.message import scaled, unscaled
from relnav_graph.io.ccsds.oem import read_ephemeris
from relnav_graph.io.known import Known
from relnav_graph.maths.earth import gcrf_from_itrf
from relnav_graph.maths.instants import SCALES, Instant

ndm = pytest.importorskip("ccsds_ndm")

ROW = "7000.0 0.0 0.0 0.0 4.6 6.1"
TRIANGLE = "\n".join(" ".join(["0"] * i + ["1e-6"]) for i in range(6))


def rows(*times: str) -> list[str]:
    return [f"{t} {ROW}" for t in times]


def true(path: Path, **options: Any) -> Recording:
    return read_raw("oem", path, {"role": "truth", **options})


def states(found: Recording) -> Array:
    assert found.truth is not None
    values = found.truth.values
    return np.hstack([values["chaser_position"], values["chaser_velocity"]])


@pytest.mark.parametrize(
    ("of", "options", "said"),
    [
        ("relative", {}, True),
        ("relative", {"frame": "eme2000"}, True),
        ("target", {}, True),
        ("target", {"orbital": False}, False),
        ("chaser", {}, False),  # chaser_position is in i whatever o is
    ],
)
def test_axes_of_which_nobody_knows_that_they_are_inertial_are_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, of: str, options: dict[str, Any], said: bool
) -> None:
    write_track("oem", track(), tmp_path / "a.oem", epoch=EPOCH, of=of, **options)
    frame = options.get("frame", "icrf").upper()
    expected = (
        f"a.oem: the axes o of 'one' are not known to be inertial, and are written as {frame}"
    )
    assert [r.levelname for r in caplog.records] == ["WARNING"] * said
    assert (expected in caplog.text) == said


def test_km_lose_no_bit() -> None:
    rng = np.random.default_rng(0)
    sizes = 10.0 ** rng.integers(-25, 25, 400)
    given = [*(rng.normal(size=400) * sizes).tolist(), 0.0, -0.0, 7e6, 0.5, 1e22, 5e-324, 123456.0]
    for x in given:
        for power in (3, 6):
            back = float(scaled(unscaled(x, power), power))
            assert (back, np.signbit(back)) == (x, np.signbit(x))
            assert float(unscaled(x, power)) == pytest.approx(x / 10.0**power, rel=1e-15)
    assert (unscaled(6999999.5, 3), unscaled(-12.0, 3), scaled("1.5E2", 3)) == (
        *("6999.9995", "-0.012"),
        "1.5e5",
    )


@pytest.mark.parametrize("scale", SCALES)
def test_a_track_comes_back_bit_for_bit(tmp_path: Path, scale: str) -> None:
    """In every time system, UTC across a leap second; covariances in the frame of the states."""
    one, path = track(), tmp_path / "a.oem"
    write_track("oem", one, path, epoch=EPOCH, time_system=scale)
    assert ("23:59:60" in path.read_text()) == (scale == "UTC")
    found = true(path, covariance=True)
    assert found.truth is not None
    np.testing.assert_array_equal(states(found), one.x[:, :6])
    np.testing.assert_allclose(found.times, one.t - 0.1, rtol=0, atol=1e-15)
    assert found.epoch is not None
    assert found.epoch.ns_since(Instant.parse(EPOCH)) == 100_000_000
    P = read_ephemeris(path).covariance
    lower = np.tril(one.covariance("chaser_position", "chaser_velocity"))
    np.testing.assert_array_equal(np.tril(P), lower)
    sigmas = np.sqrt(np.einsum("nii->ni", lower))
    np.testing.assert_array_equal(found.truth.sigmas["chaser_position"], sigmas[:, :3])


def test_an_independent_library_reads_the_same_and_we_read_its_files(tmp_path: Path) -> None:
    one, path = track(), tmp_path / "a.oem"
    write_track("oem", one, path, epoch=EPOCH, covariance="RTN", frame="EME2000")
    theirs = ndm.Oem.from_file(str(path))
    (segment,) = theirs.segments
    ours = read_ephemeris(path)
    meta = segment.metadata
    assert [meta.time_system, meta.center_name, meta.ref_frame] == ["UTC", "EARTH", "EME2000"]
    # In the axes and units of the file.
    rough = segment.data.state_vector_numpy
    assert rough.shape == (12, 6)
    text = [line.split() for line in path.read_text().splitlines() if line[:1] == "2"]
    np.testing.assert_array_equal(rough, np.array([w[1:] for w in text], dtype=float))
    assert [s.epoch for s in segment.data.state_vector] == [w[0] for w in text]
    assert {c.cov_ref_frame for c in segment.data.covariance_matrix} == {"RTN"}
    for form in ("kvn", "xml"):
        copy = tmp_path / f"copy.{form}"
        theirs.to_file(str(copy), form)
        again = read_ephemeris(copy)
        assert again.epoch == ours.epoch
        np.testing.assert_array_equal(again.t, ours.t)
        # It keeps doubles of km, and writes these.
        np.testing.assert_allclose(again.state, ours.state, rtol=4e-16, atol=2e-9)
        np.testing.assert_allclose(again.covariance, ours.covariance, rtol=1e-9)


def test_covariances_turn_as_the_axes_do(tmp_path: Path) -> None:
    """RTN by hand: r along y, v along z, so that N = r x v is x. And there and back."""
    cov = ["COVARIANCE_START", "EPOCH = 2020-01-01T00:00:00", "COV_REF_FRAME = RTN"]
    diagonal = [1.0, 4.0, 9.0, 16.0, 25.0, 36.0]
    for i, d in enumerate(diagonal):
        cov.append(" ".join([*["0"] * i, f"{d}e-6"]))
    state = "2020-01-01T00:00:00 0 7000 0 0 0 7.5"
    path = message(tmp_path / "a.oem", "OEM", [state, *cov, "COVARIANCE_STOP"])
    P = read_ephemeris(path).covariance[0]
    np.testing.assert_allclose(P, np.diag([9.0, 1.0, 4.0, 36.0, 16.0, 25.0]), atol=1e-12)
    one = track()
    write_track("oem", one, tmp_path / "c.oem", epoch=EPOCH, frame="EME2000")
    again = read_ephemeris(tmp_path / "c.oem")  # written in these axes, and turned back
    np.testing.assert_allclose(again.state, one.x[:, :6], rtol=0, atol=1e-8)
    for frame in ("RTN", "EME2000"):
        write_track("oem", one, tmp_path / "b.oem", epoch=EPOCH, covariance=frame)
        own = one.covariance("chaser_position", "chaser_velocity")
        np.testing.assert_allclose(read_ephemeris(tmp_path / "b.oem").covariance, own, rtol=1e-9)


def bias() -> Array:
    """From GCRF to EME2000, R1(-eta0) R2(xi0) R3(da0), with the numbers of IERS Conventions 2003
    (TN 32), section 5.1 and table 5.2."""
    xi, eta, da = (x * 1e-3 * np.pi / 648000 for x in (-16.6170, -6.8192, -14.6))
    R1 = np.array([[1, 0, 0], [0, 1, -eta], [0, eta, 1]])
    R2 = np.array([[1, 0, -xi], [0, 1, 0], [xi, 0, 1]])
    R3 = np.array([[1, da, 0], [-da, 1, 0], [0, 0, 1]])
    out: Array = R1 @ R2 @ R3
    return out


def test_eme2000_is_not_gcrf(tmp_path: Path) -> None:
    """23 mas, 0.8 m; to what is neglected in the small angles."""
    given = np.array([7e6, 0, 0, 0, 4600.0, 6100.0])
    both = {}
    for frame in ("EME2000", "GCRF", "ICRF"):
        path = message(tmp_path / "a.oem", "OEM", rows("2020-01-01T00:00:00"), REF_FRAME=frame)
        both[frame] = read_ephemeris(path).state[0]
    np.testing.assert_array_equal(both["GCRF"], given)
    np.testing.assert_array_equal(both["ICRF"], given)
    expected = np.kron(np.eye(2), bias().T) @ given
    np.testing.assert_allclose(both["EME2000"], expected, rtol=0, atol=1e-5)
    assert 0.7 < np.linalg.norm(both["EME2000"][:3] - given[:3]) < 0.8


def test_an_independent_library_reads_a_track_across_a_leap_second(tmp_path: Path) -> None:
    assert ccsds_oem_apart(track(), EPOCH, tmp_path / "a.oem") < 2e-9


@needs_brahe
def test_the_bias_is_that_of_an_independent_library() -> None:
    assert eme2000_apart() < 2e-5


def test_earth_fixed_states_are_turned(tmp_path: Path) -> None:
    fixed = "2020-01-01T00:00:00 4000.0 -5000.0 3000.0 1.0 5.0 6.0"
    path = message(tmp_path / "a.oem", "OEM", [fixed], REF_FRAME="ITRF2014")
    r, v = np.array([[4e6, -5e6, 3e6]]), np.array([[1e3, 5e3, 6e3]])
    r, v = gcrf_from_itrf(Instant.parse("2020-01-01T00:00:00 UTC"), np.zeros(1), r, v)
    np.testing.assert_allclose(read_ephemeris(path).state, np.hstack([r, v]), rtol=1e-15)


def test_utc_counts_a_leap_second(tmp_path: Path) -> None:
    times = [f"2016-12-31T23:59:{s}" for s in ("59", "59.5", "60", "60.5")]
    path = message(tmp_path / "a.oem", "OEM", rows(*times, "2017-001T00:00:00.5Z"))
    np.testing.assert_array_equal(true(path).times, [0.0, 0.5, 1.0, 1.5, 2.5])
    gps = message(tmp_path / "b.oem", "OEM", rows("2017-01-01T00:00:16"), TIME_SYSTEM="GPS")
    assert true(gps).epoch == Instant.parse("2016-12-31T23:59:59 UTC")
    path = message(tmp_path / "a.oem", "OEM", rows("2018-12-31T23:59:60"))
    with pytest.raises(InputError, match=r"a\.oem, line 14: .*no such time on that day"):
        true(path)


def test_measured_positions_go_to_a_sensor(tmp_path: Path) -> None:
    """Of the chaser's own orbit, or, with a target, relative; with the covariance of the file."""
    write_track("oem", track(), tmp_path / "a.oem", epoch=EPOCH)
    options = {"role": "measured", "sensor": "gps", "covariance": True}
    found = read_raw("oem", tmp_path / "a.oem", options)
    assert len(found.measurements) == 12
    m, P = found.measurements[3], track().covariance("chaser_position")[3]
    np.testing.assert_array_equal(m.z, track().x[3:4, :3])
    assert m.covariance is not None
    np.testing.assert_array_equal(np.tril(m.covariance[0]), np.tril(P))
    t = np.arange(0.0, 90.0, 7.0)
    target, chaser = formation(tmp_path, t, np.array([10.0, -100.0, 5.0, 0.0, 0.0, 0.0]))
    options = {"role": "measured", "sensor": "fix", "target": target.name}
    fixes = read_raw("oem", chaser, options, Known(orbital=True)).measurements
    np.testing.assert_allclose(fixes[4].z, [[10.0, -100.0, 5.0]], atol=1e-4)
    part = read_raw("oem", chaser, options | {"start": 21.0, "duration": 30.0})
    np.testing.assert_array_equal(part.times, [0.0, 7.0, 14.0, 21.0, 28.0])


@pytest.mark.parametrize(
    ("lines", "meta", "says"),
    [
        (rows("2020-01-01T00:00:00"), {"REF_FRAME": "TEME"}, "line 8: .*'TEME'.*SGP4"),
        (rows("2020-01-01T00:00:00"), {"REF_FRAME": "TOD"}, "line 8: .*'TOD'.*nutation"),
        (rows("2020-01-01T00:00:00"), {"REF_FRAME": "MOD"}, "line 8: .*'MOD'.*precession"),
        (rows("2020-01-01T00:00:00"), {"REF_FRAME": "J2000"}, "called EME2000"),
        (rows("2020-01-01T00:00:00"), {"REF_FRAME": "SC_BODY_1"}, "EARTH in SC_BODY_1"),
        (rows("2020-01-01T00:00:00"), {"TIME_SYSTEM": "UT1"}, "line 9: .*'UT1', expected TT"),
        (rows("2020-01-01T00:00:00"), {"TIME_SYSTEM": None}, "line 5: found no TIME_SYSTEM"),
        (rows("2020-01-01T00:00:00"), {"CENTER_NAME": "Moon"}, "line 7: found the centre MOON"),
        (
            rows("2020-01-01T00:00:00"),
            {"CENTER_NAME": "SOLAR_SYSTEM_BARYCENTER"},
            "expected EARTH or a spacecraft",
        ),
        (rows("2020-01-01T00:00:00"), {"STOP_TIME": None}, "found no STOP_TIME"),
        *(
            (
                ["2020-01-01T00:00:00 7000 0 0 0 7.5 " + word],
                {},
                rf"line \d+: found '{re.escape(word)}', expected a finite number{says}",
            )
            for word, says in (
                ("nan", ""),
                ("-inf", ""),
                ("1e400", ""),
                ("1.0D+00", ".*follows an E, not a D"),
            )
        ),
        (rows("2020-01-01T00:00:00"), {"CENTER_NAME": None}, "found no CENTER_NAME"),
        (rows("2020-01-01T00:00:00"), {"STOP_TIME": "2019-12-31T00:00:00"}, "line 11: .*but rows"),
        (rows("2020-01-01T00:00:01", "2020-01-01T00:00:00"), {}, "line 15: .*after the row above"),
        (rows("2020-01-01T00:00:00", "2020-01-01T00:00:00"), {}, "line 15: .*after the row above"),
        (rows("2020-01-01"), {}, "line 14: .*expected a date and a time"),
        (["2020-01-01T00:00:00 7000 0 0 0 4.6"], {}, "line 14: found 6 words, expected 7"),
        (["2020-01-01T00:00:00 7000 0 0 0 4.6 6,1"], {}, "line 14: .*6,1"),
        (["2020-01-01T00:00:00 7000 0 0 0 4.6 nan"], {}, "line 14: .*nan"),
        (["2020-01-01T00:00:00 7000000 0 0 0 4.6 6.1"], {}, r"line 14: .*\(m given\?\)"),
        ([], {}, "line 5: found no state"),
        ([*rows("2020-01-01T00:00:00"), "COVARIANCE_START", "1 2"], {}, "line 16: .*EPOCH"),
        (
            [*rows("2020-01-01T00:00:00"), "COVARIANCE_START", "EPOCH = 2020-01-01T00:00:00", "1"],
            {},
            "line 17: found the end of the file before COVARIANCE_STOP",
        ),
        (
            [
                *rows("2020-01-01T00:00:00"),
                *("COVARIANCE_START", "EPOCH = 2020-01-01T00:00:01", TRIANGLE, "COVARIANCE_STOP"),
            ],
            {},
            "line 16: found no state, but a covariance",
        ),
        (
            [
                *rows("2020-01-01T00:00:00"),
                *("COVARIANCE_START", "EPOCH = 2020-01-01T00:00:00", "1 2", "COVARIANCE_STOP"),
            ],
            {},
            "line 16: found 2 numbers in this covariance, expected 21",
        ),
        (
            [
                *rows("2020-01-01T00:00:00"),
                *("COVARIANCE_START", "EPOCH = 2020-01-01T00:00:00", "COV_REF_FRAME = TNW"),
                *(TRIANGLE, "COVARIANCE_STOP"),
            ],
            {},
            "line 17 .of a covariance; or RTN.: found the frame 'TNW'",
        ),
    ],
)
def test_what_no_ephemeris_says_is_refused_with_its_line(
    tmp_path: Path, lines: list[str], meta: dict[str, Any], says: str
) -> None:
    path = message(tmp_path / "a.oem", "OEM", lines, **meta)
    with pytest.raises(InputError, match=rf"a\.oem.*{says}"):
        true(path)


def test_segments_objects_roles_and_other_files(tmp_path: Path) -> None:
    first, path = tmp_path / "a.oem", tmp_path / "b.oem"
    message(first, "OEM", rows("2020-01-01T00:00:00", "2020-01-01T00:01:00"))
    text = first.read_text()
    second = text[text.index("META_START") :].replace("01T00:0", "01T00:1").replace("1:1", "0:2")
    path.write_text(text + second.replace("T00:10", "T00:01"))
    np.testing.assert_array_equal(true(path).times, [0.0, 60.0, 660.0])
    path.write_text(text + text[text.index("META_START") :])
    with pytest.raises(InputError, match="a segment that begins in the last one"):
        true(path)
    path.write_text(text + second.replace("CHASER", "OTHER"))
    with pytest.raises(InputError, match="found CHASER, OTHER: name one of them"):
        true(path)
    assert len(true(path, object="OTHER").times) == 2
    useable = {"USEABLE_START_TIME": "2020-01-01T00:00:30"}
    message(path, "OEM", rows("2020-01-01T00:00:00", "2020-01-01T00:01:00"), **useable)
    assert len(true(path).times) == 1
    for options, says in (
        ({}, "found no role, expected one of: 'truth', true states.*; 'target', .*; 'measured'"),
        ({"role": "position"}, "found the role 'position', expected one"),
        ({"role": "measured"}, "measured by which sensor"),
        ({"role": "truth", "covariance": True}, "found no covariance at 2020-01-01"),
    ):
        with pytest.raises(InputError, match=says):
            read_raw("oem", first, options)
    for content, says in (
        ("CCSDS_AEM_VERS = 2.0\n", "line 1: found 'CCSDS_AEM_VERS' first, expected CCSDS_OEM"),
        ("CCSDS_OEM_VERS = 7\n", "line 1: found version '7'"),
        ("hello\n", "line 1: found 'hello', expected KEYWORD"),
        ("", "line 1: found ''"),
        ("CCSDS_OEM_VERS = 2.0\nMETA_START\nOBJECT_NAME = A\n", "before META_STOP"),
        ("CCSDS_OEM_VERS = 2.0\nCREATION_DATE = 2020-01-01T00:00:00\n", "found no segment"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><oem/>', "line 1: found a DTD"),
        ("<oem>", "line 1: found 'oem' first|version ''"),
    ):
        path.write_text(content)
        with pytest.raises(InputError, match=says):
            true(path)


def test_what_a_track_lacks_and_files_of_others(tmp_path: Path) -> None:
    one, path = track(), tmp_path / "a.oem"
    for options, says in (
        ({}, r"when is t = 0 of 'one'\? expected epoch ="),
        ({"epoch": "2020-01-01T00:00:00"}, "without a time scale"),
        ({"epoch": EPOCH, "time_system": "UT1"}, "found time_system 'UT1'"),
        ({"epoch": EPOCH, "frame": "TEME"}, "found the frame 'TEME', .*SGP4"),
        ({"epoch": EPOCH, "of": "moon"}, "found of = 'moon', expected chaser, target or relative"),
        ({"epoch": EPOCH, "covariance": "TNW"}, "found the frame 'TNW'"),
        ({"epoch": EPOCH, "object": "A\nB"}, "expected a text of one line"),
    ):
        with pytest.raises(InputError, match=says):
            write_track("oem", one, path, **options)
    assert not path.exists()
    path.write_text("mine")
    with pytest.raises(InputError, match="is not of this package"):
        write_track("oem", one, path, epoch=EPOCH)
    assert path.read_text() == "mine"


def test_the_other_states_of_a_track(tmp_path: Path) -> None:
    """The target's, relative ones, and the chaser's from relative ones and the target's orbit."""
    one, paths = track(), {n: tmp_path / f"{n}.oem" for n in ("target", "relative", "chaser")}
    for of in ("target", "relative"):
        write_track("oem", one, paths[of], epoch=EPOCH, of=of)
    target = read_ephemeris(paths["target"])
    np.testing.assert_array_equal(target.state, one.x[:, :6] - one.x[:, 6:12])
    P = one.covariance("chaser_position", "relative_position")[0]
    J = np.hstack([np.eye(3), -np.eye(3)])
    np.testing.assert_allclose(target.covariance[0, :3, :3], J @ P @ J.T, rtol=1e-12)
    relative = true(paths["relative"]).truth
    assert relative is not None
    np.testing.assert_array_equal(relative.values["relative_velocity"], one.x[:, 9:12])
    own = one.layout.blocks
    keep = [b for b in own if b.name.startswith("relative")]
    part = replace(one, layout=Layout(keep), x=one.x[:, 6:12], P=one.P[:, 6:12, 6:12])
    for orbital in (False, True):
        options = {"epoch": EPOCH, "orbital": orbital, "covariance": "RTN"}
        with pytest.raises(InputError, match=r"no orbit of the target .*, or of=relative"):
            write_track("oem", part, paths["chaser"], **options)
        options["target"] = str(paths["target"])
        write_track("oem", part, paths["chaser"], **options)
        known = Known(orbital=orbital)
        read = {"role": "truth", "target": "target.oem", "covariance": True}
        found = read_raw("oem", paths["chaser"], read, known).truth
        assert found is not None
        for n, name in enumerate(("relative_position", "relative_velocity")):
            cut = slice(3 * n, 3 * n + 3)
            np.testing.assert_allclose(found.values[name], part.x[:, cut], atol=1e-8)
            sigma = np.sqrt(np.einsum("nii->ni", part.P))[:, cut]
            np.testing.assert_allclose(found.sigmas[name], sigma, rtol=1e-9)
