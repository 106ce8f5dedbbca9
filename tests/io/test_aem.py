"""CCSDS AEM: round trips, an independent library, which way a quaternion turns, what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import erfa
import numpy as np
import pytest
from ccsds import EPOCH, circle, message, track
from independent import ccsds_aem_apart
from relnav_factors.sensors.position_fix import PositionFix
from relnav_factors.sensors.star_tracker import StarTracker

from relnav_graph import read_raw, write_track
from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError
from relnav_graph.io.ccsds.aem import read_attitudes
from relnav_graph.io.known import Known
from relnav_graph.maths import so3
from relnav_graph.maths.instants import Instant

ndm = pytest.importorskip("ccsds_ndm")

#: A body turned by 30 deg about z: its x axis is where (cos 30, sin 30, 0) of the stars is.
HALF = np.deg2rad(15.0)
TURN = f"2020-01-01T00:00:00 0 0 {float(np.sin(HALF))!r} {float(np.cos(HALF))!r}"


def true(path: Path, **options: Any) -> Recording:
    return read_raw("aem", path, {"role": "truth", **options})


def measured(path: Path, **options: Any) -> Recording:
    return read_raw("aem", path, {"role": "measured", "sensor": "stars", **options})


def test_axes_of_which_nobody_knows_that_they_are_inertial_are_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_track("aem", track(), tmp_path / "a.aem", epoch=EPOCH, orbital=False)
    assert caplog.text == ""
    write_track("aem", track(), tmp_path / "a.aem", epoch=EPOCH)
    (record,) = caplog.records
    assert record.levelname == "WARNING"
    assert "a.aem: the axes o of 'one' are not known to be inertial" in record.message


def test_a_track_comes_back_bit_for_bit(tmp_path: Path) -> None:
    """The quaternions that are written, and the covariances of the table beside them."""
    one, path = track(), tmp_path / "a.aem"
    write_track("aem", one, path, epoch=EPOCH)
    found = measured(path, covariance=True)
    for m, R, P in zip(
        found.measurements,
        one.value("chaser_attitude"),
        one.covariance("chaser_attitude"),
        strict=True,
    ):
        np.testing.assert_array_equal(m.z[0], so3.quaternion(np.ascontiguousarray(R)))
        assert m.covariance is not None
        np.testing.assert_array_equal(np.tril(m.covariance[0]), np.tril(P))
    truth = true(path, covariance=True).truth
    assert truth is not None
    R = one.value("chaser_attitude")
    np.testing.assert_allclose(truth.values["chaser_attitude"], R, atol=1e-15)
    sigmas = np.sqrt(np.einsum("nii->ni", one.covariance("chaser_attitude")))
    np.testing.assert_array_equal(truth.sigmas["chaser_attitude"], sigmas)
    write_track("aem", one, path, epoch=EPOCH, frame="EME2000")
    turned = true(path).truth
    assert turned is not None
    np.testing.assert_allclose(turned.values["chaser_attitude"], R, rtol=0, atol=1e-14)
    # Written anew without, the old table is gone, too.
    write_track("aem", one, path, epoch=EPOCH, covariance=False)
    with pytest.raises(InputError, match=r"found no table a_covariances\.csv beside it"):
        measured(path, covariance=True)
    (tmp_path / "a_covariances.csv").write_text("mine")
    with pytest.raises(InputError, match="is not a table of covariances"):
        write_track("aem", one, path, epoch=EPOCH)


def test_an_independent_library_reads_the_same_and_we_read_its_files(tmp_path: Path) -> None:
    one, path = track(), tmp_path / "a.aem"
    write_track("aem", one, path, epoch=EPOCH)
    theirs, ours = ndm.Aem.from_file(str(path)), read_attitudes(path)
    (segment,) = theirs.segments
    np.testing.assert_array_equal(segment.data.attitude_states_numpy[:, [3, 0, 1, 2]], ours.q_wxyz)
    meta = segment.metadata
    assert [meta.ref_frame_a, meta.ref_frame_b] == ["ICRF", "SC_BODY_1"]
    for form in ("kvn", "xml"):
        copy = tmp_path / f"copy.{form}"
        theirs.to_file(str(copy), form)
        again = read_attitudes(copy)
        assert again.epoch == ours.epoch
        np.testing.assert_array_equal(again.t, ours.t)
        np.testing.assert_array_equal(again.q_wxyz, ours.q_wxyz)


def test_an_independent_library_reads_a_track_across_a_leap_second(tmp_path: Path) -> None:
    assert ccsds_aem_apart(track(), EPOCH, tmp_path / "a.aem") < 1e-14


def test_which_way_a_quaternion_turns(tmp_path: Path) -> None:
    """By the standard it is the transformation from A to B: its matrix takes components in A to
    components in B; ours, R_ic, the other way round. ERFA says what such a matrix is."""
    path = message(tmp_path / "a.aem", "AEM", [TURN])
    truth = true(path).truth
    assert truth is not None
    R_ic = truth.values["chaser_attitude"][0]
    np.testing.assert_allclose(R_ic.T, erfa.rz(2 * HALF, np.eye(3)), atol=1e-15)
    np.testing.assert_allclose(R_ic[:, 0], [np.cos(2 * HALF), np.sin(2 * HALF), 0], atol=1e-15)
    # The reverse, in the first version, with the scalar where it says.
    turned = f"2020-01-01T00:00:00 {float(np.cos(HALF))!r} 0 0 {-float(np.sin(HALF))!r}"
    old = {"QUATERNION_TYPE": "FIRST", "ATTITUDE_DIR": "B2A"}
    message(path, "AEM", [turned], version="1.0", **old)
    c, s = np.cos(HALF), np.sin(HALF)
    np.testing.assert_allclose(measured(path).measurements[0].z, [[c, 0, 0, s]])
    message(path, "AEM", [TURN], version="1.0", QUATERNION_TYPE="LAST", ATTITUDE_DIR="A2B")
    np.testing.assert_allclose(read_attitudes(path).q_wxyz[0, [0, 3]], [c, s])
    # In a later one, which has neither, that cannot be meant.
    for key, value in old.items():
        message(path, "AEM", [turned], **{key: value})
        with pytest.raises(InputError, match=rf"line \d+: found {key} '{value}', expected .* 1\.0"):
            read_attitudes(path)
    # The body as A, the stars as B.
    other = {"REF_FRAME_A": "SC_BODY_1", "REF_FRAME_B": "ICRF"}
    message(path, "AEM", [TURN], **other)
    np.testing.assert_allclose(read_attitudes(path).q_wxyz[0, [0, 3]], [c, -s])
    # Rates beside it are left alone.
    message(path, "AEM", [TURN + " 0 0 0.1"], ATTITUDE_TYPE="QUATERNION/ANGVEL")
    np.testing.assert_allclose(read_attitudes(path).q_wxyz[0, [0, 3]], [c, s])
    # In EME2000 23 mas are between: by ERFA's bias from GCRF to it.
    message(path, "AEM", [TURN], REF_FRAME_A="EME2000")
    truth = true(path).truth
    assert truth is not None
    to_eme = erfa.bp00(2451545.0, 0.0)[0]
    found = to_eme @ truth.values["chaser_attitude"][0]
    np.testing.assert_allclose(found, R_ic, atol=1e-9)
    assert 7e-8 < np.abs(truth.values["chaser_attitude"][0] - R_ic).max() < 2e-7


def test_o_turns_with_the_target(tmp_path: Path) -> None:
    """R_oc = R_oi R_ic; there and back through the file."""
    one, target = track(), tmp_path / "target.oem"
    write_track("oem", one, target, epoch=EPOCH, of="target")
    write_track("aem", one, tmp_path / "a.aem", epoch=EPOCH, orbital=True, target=str(target))
    back = read_raw(
        "aem", tmp_path / "a.aem", {"role": "truth", "target": "target.oem"}, Known(orbital=True)
    ).truth
    assert back is not None
    R = one.value("chaser_attitude")
    np.testing.assert_allclose(back.values["chaser_attitude"], R, atol=1e-14)
    still = true(tmp_path / "a.aem").truth
    assert still is not None
    x = (one.x[:, :3] - one.x[:, 6:9])[0]
    # The radial direction of the target, in body axes, is the first row of R_oc.
    seen = still.values["chaser_attitude"][0].T @ x / np.linalg.norm(x)
    np.testing.assert_allclose(seen, R[0, 0], atol=1e-14)
    with pytest.raises(InputError, match=r"o turns with \[orbit\]; expected the target's"):
        read_raw("aem", tmp_path / "a.aem", {"role": "truth"}, Known(orbital=True))
    assert circle(np.zeros(1))[0, 0] == 7e6


@pytest.mark.parametrize(
    ("row", "meta", "options", "says"),
    [
        (TURN, {"REF_FRAME_A": "TEME"}, {}, "line 7: found the frame 'TEME'"),
        (TURN, {"REF_FRAME_B": "GCRF"}, {}, "line 8: found two inertial frames"),
        (TURN, {"ATTITUDE_TYPE": "SPIN"}, {}, "line 12: found ATTITUDE_TYPE 'SPIN', expected QUAT"),
        (TURN, {"TIME_SYSTEM": "MET"}, {}, "line 9: found TIME_SYSTEM 'MET'"),
        (TURN.replace(" 0 0", " 0 1"), {}, {}, "line 16: found the quaternion .* of length 1.4"),
        (TURN + " 0", {}, {}, "line 16: found 6 words, expected 5"),
        (TURN.replace(" 0 0", " 0 x"), {}, {}, "line 16: found 'x', expected a finite number"),
        (TURN.replace(" 0 0", " 0 nan"), {}, {}, "line 16: found 'nan', expected a finite number"),
        (TURN, {}, {"block": "relative_attitude"}, "found the block 'relative_attitude' with iner"),
        (TURN, {}, {"role": ""}, "found no role, expected one of: 'truth'"),
        (TURN, {"REF_FRAME_A": "SC_BODY_2"}, {}, "expected relative_attitude"),
    ],
)
def test_what_no_attitude_says_is_refused_with_its_line(
    tmp_path: Path, row: str, meta: dict[str, str], options: dict[str, str], says: str
) -> None:
    path = message(tmp_path / "a.aem", "AEM", [row], **meta)
    with pytest.raises(InputError, match=rf"a\.aem.*{says}"):
        true(path, **options)


@pytest.mark.parametrize(
    ("reader", "sensor", "says"),
    [
        ("aem", "", "option sensor: found none: measured by which"),
        ("aem", "star", "option sensor: found 'star', expected a sensor, one of stars, fix"),
        (
            "aem",
            "fix",
            "option sensor: found 'fix', which measures x_m, .*; expected .* q_w",
        ),
        ("oem", "star", "option sensor: found 'star', expected a sensor, one of stars, fix"),
        ("oem", "stars", "option sensor: found 'stars', which measures q_w, .*; expected .* x_m"),
    ],
)
def test_a_sensor_measures_what_the_file_has(
    tmp_path: Path, reader: str, sensor: str, says: str
) -> None:
    known = Known({"stars": StarTracker(sigma=np.ones(3)), "fix": PositionFix(sigma=np.ones(3))})
    one, path, target = track(), tmp_path / f"a.{reader}", tmp_path / "target.oem"
    write_track(reader, one, path, epoch=EPOCH)
    write_track("oem", one, target, epoch=EPOCH, of="target")
    options = {"role": "measured", "target": str(target)}
    with pytest.raises(InputError, match=rf"a\.{reader}: {says}"):
        read_raw(reader, path, options | {"sensor": sensor}, known)
    right, width = ("stars", 4) if reader == "aem" else ("fix", 3)
    found = read_raw(reader, path, options | {"sensor": right}, known)
    assert {(m.sensor, m.z.shape) for m in found.measurements} == {(right, (1, width))}


def test_what_a_track_and_a_table_lack(tmp_path: Path) -> None:
    one, path = track(), tmp_path / "a.aem"
    for options, says in (
        (
            {"block": "chaser_position"},
            "option block: found 'chaser_position', expected an attitude of",
        ),
        ({"frame": "TOD"}, "found the frame 'TOD', .*: convert with"),
        ({"orbital": True}, "found no orbit of the target"),
    ):
        with pytest.raises(InputError, match=says):
            write_track("aem", one, path, epoch=EPOCH, **options)
    message(path, "AEM", [TURN])
    for text, says in (
        ("t_s\n0\n", "found no columns cov_1_1"),
        ("t_s,cov_1_1\n0\n1\n", "found 1 of 2 columns"),
        ("t_s\n0\n1\n", "found 2 rows, expected 1"),
        ("t_s\n0.5\n", "the times of the attitudes"),
    ):
        (tmp_path / "a_covariances.csv").write_text(text)
        with pytest.raises(InputError, match=says):
            true(path)
    assert Instant.parse("2020-01-01T00:00:00 UTC") == Instant.parse("2020-001T00:00:00 UTC")
