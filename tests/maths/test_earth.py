"""Absolute time and the turning of the Earth, against ERFA as a whole and against real orbits."""

from __future__ import annotations

import logging

import erfa
import numpy as np
import pytest
from against_brahe import bodies_apart, frames_apart, needs_brahe, tdb_apart, time_apart
from independent import erfa_frames_apart, erfa_tdb_apart, turning_earth

from relnav_graph.errors import InputError
from relnav_graph.maths.earth import (
    EARTH_RATE,
    EarthTable,
    gcrf_from_itrf,
    itrf_from_gcrf,
    read_finals,
)
from relnav_graph.maths.instants import SCALES, Instant, moved


def _line(mjd: float, xp: float, yp: float, ut1: float) -> str:
    """A row of a finals2000A file."""
    return f"210717 {mjd:8.2f} I {xp:9.6f} 0.000091 {yp:9.6f} 0.000091  I{ut1:10.7f} 0.0000100"


def test_time_scales_agree() -> None:
    tt = Instant.parse("2021-07-17T00:00:00 TT")
    assert (tt.day, tt.seconds) == (59412, 0.0)
    same = (
        "2021-07-16T23:59:27.816 TAI",
        "2021-07-16T23:59:08.816 GPS",
        "2021-07-16T23:58:50.816 UTC",
    )
    for text in same:
        assert abs(Instant.parse(text).since(tt)) < 1e-9
    tdb = Instant.parse("2021-07-17T00:00:00 TDB")
    assert erfa_tdb_apart() < 1e-8
    assert 1e-6 < abs(tdb.since(tt)) < 2e-3
    assert Instant.parse(str(tt.after(0.25))) == tt.after(0.25)
    assert Instant.of(59412, -1.0, "TT") == Instant.parse("2021-07-16T23:59:59 TT")


@needs_brahe
def test_time_scales_are_those_of_an_independent_library() -> None:
    """Before, in and after every leap second since 1973."""
    assert time_apart() < 1e-9
    assert tdb_apart() < 5e-5


@needs_brahe
def test_frames_and_bodies_are_those_of_an_independent_library() -> None:
    position, velocity = frames_apart()
    assert position < 1e-7
    assert velocity < 1e-10
    assert max(bodies_apart().values()) < 2e-3


def test_a_leap_second_is_counted() -> None:
    before, leap, after = (
        Instant.parse(f"{text} UTC")
        for text in ("2016-12-31T23:59:59", "2016-12-31T23:59:60", "2017-01-01T00:00:00")
    )
    assert leap.since(before) == pytest.approx(1.0)
    assert after.since(leap) == pytest.approx(1.0)
    assert (before.tai_utc, leap.tai_utc, after.tai_utc) == (36, 36, 37)


def test_instants_are_whole_nanoseconds() -> None:
    """Written and read in every scale without loss, also within a leap second."""
    end = Instant.parse("2016-12-31T23:59:60.5 UTC")
    assert Instant.parse("2017-01-01T00:00:00.5 UTC").ns_since(end) == 1_000_000_000
    rng = np.random.default_rng(0)
    for ns in [*rng.integers(0, 10**18, 50).tolist(), *range(-1_500_000_000, 10**9, 499_999_999)]:
        one = Instant(end.tai + ns)
        for scale in SCALES:
            assert Instant.parse(f"{one.calendar(scale)} {scale}") == one, scale
        assert Instant.parse(str(one)) == one
        day, of_day = one.in_scale("GPS")
        assert Instant(Instant.of(day, 0.0, "GPS").tai + of_day) == one
    assert end.calendar("UTC") == "2016-12-31T23:59:60.5"
    assert Instant.parse("2016-366T23:59:60.5Z UTC") == end
    assert Instant.parse("2021-07-17T00:00:00.1234567894999 TAI").tai % 10**9 == 123456789
    assert end.after(1e9 + 0.1).ns_since(end) == 10**18 + round((1e9 + 0.1 - 1e9) * 1e9)
    with pytest.raises(InputError, match="day 366 is not in the year 2017"):
        Instant.parse("2017-366T00:00:00 TT")
    with pytest.raises(InputError, match="found nan seconds"):
        end.after(float("nan"))


def test_stamps_move_as_integers() -> None:
    """One instant has one number, from whichever epoch it is counted; large stamps lose nothing."""
    t = np.array([0.1, 0.2, 0.3, 1e5 + 0.7])
    there = moved(t, 86_400_000_000_001)
    np.testing.assert_array_equal(moved(there, -86_400_000_000_001), t)
    unix = np.array([1626480000.25, 1626480000.5])
    np.testing.assert_array_equal(moved(unix, -1626480000 * 10**9), [0.25, 0.5])
    assert float(moved(0.1, 200_000_000)) == 0.3  # where 0.1 + 0.2 is not


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("2021-07-17T00:00:00", "without a time scale"),
        ("2021-07-17T00:00:00 EST", "'EST', expected one of TT"),
        ("2021-02-30T00:00:00 TT", "found '2021-02-30T00:00:00 TT'"),
        ("2021-07-17T24:00:00 TT", "no such time"),
        ("2021-07-17T23:59:60 UTC", "no such time"),
        ("1969-07-20T20:17:40 UTC", "from 1972 on"),
        ("17.7.2021 TT", "expected a date, a time and a scale"),
        ("2021-07-17 TT", "expected a date, a time and a scale"),
    ],
)
def test_row_59_times_that_say_too_little(text: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        Instant.parse(text)


def test_days_beyond_the_known_leap_seconds_are_told(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        Instant.parse("2048-01-02T00:00:00 UTC")
    assert "leap seconds are known until" in caplog.text
    with caplog.at_level(logging.WARNING):
        caplog.clear()
        Instant.parse("2048-01-03T00:00:00 GPS")
    assert caplog.text == ""


def test_the_frame_is_that_of_erfa() -> None:
    assert erfa_frames_apart() < 1e-7
    begin, t, table, r, v = turning_earth()
    r_i, v_i = gcrf_from_itrf(begin, t, r, v, table)
    ahead = gcrf_from_itrf(begin, t + 1.0, r + v, v, table)[0]
    behind = gcrf_from_itrf(begin, t - 1.0, r - v, v, table)[0]
    # The third derivative of a step of a second, and the motion of the pole.
    np.testing.assert_allclose((ahead - behind) / 2, v_i, atol=5e-4)
    back = itrf_from_gcrf(begin, t, r_i, v_i, table)
    np.testing.assert_allclose(back[0], r, atol=1e-7)
    np.testing.assert_allclose(back[1], v, atol=1e-10)


def test_without_a_table_ut1_is_utc() -> None:
    begin, t, r = Instant.parse("2021-07-17T00:00:00 UTC"), np.zeros(1), np.array([[7e6, 0.0, 0.0]])
    found, _ = gcrf_from_itrf(begin, t, r, 0 * r)
    R_ei = erfa.c2t06a(2459412.5, (37 + 32.184) / 86400, 2459412.5, 0.0, 0.0, 0.0)
    np.testing.assert_allclose(found[0], R_ei.T @ r[0], atol=1e-7)
    late = EarthTable(np.array([59411.0, 59414.0]), np.full(2, 0.3), np.zeros(2), np.zeros(2))
    turned, _ = gcrf_from_itrf(begin, t, r, 0 * r, late)
    assert np.linalg.norm(turned - found) == pytest.approx(7e6 * 0.3 * EARTH_RATE, rel=1e-3)


def test_finals_of_the_iers_are_read_across_a_leap_second() -> None:
    days = ((57752.0, -0.4), (57753.0, -0.41), (57754.0, 0.59), (57755.0, 0.58))
    text = "\n".join(_line(mjd, 0.1, 0.3, ut1) for mjd, ut1 in days)
    table = read_finals(text + "\n" + " " * 68 + "\n170105 57758.00\n", "finals")
    assert table.mjd.tolist() == [day for day, _ in days]
    np.testing.assert_allclose(table.xp, 0.1 * np.pi / 648000)
    begin = Instant.of(57753, 0.0, "UTC")
    ut1_tt, _, yp = table.at(begin, np.array([0.0, 43200.5, 86401.0]))
    np.testing.assert_allclose(ut1_tt + 32.184 + 36, [-0.41, -0.41, -0.41], atol=1e-9)
    np.testing.assert_allclose(yp, 0.3 * np.pi / 648000)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text.replace("-0.13", "-1.93"), "found UT1 - UTC of -1.9"),
        (lambda text: text.replace("0.30", "9.30"), "found polar motion"),
        (lambda text: text.replace("59413.00", "59410.00"), "found day 59410 after a later one"),
        (lambda text: text.replace("59413.00", "5941x.00"), "finals, line 2: "),
        (lambda text: "MJD,UT1\n", "no row of a finals2000A file"),
    ],
)
def test_row_59_tables_of_orientation_that_are_wrong(change: object, says: str) -> None:
    text = "\n".join(_line(mjd, 0.1, 0.3, -0.13) for mjd in (59412.0, 59413.0, 59414.0))
    with pytest.raises(InputError, match=says):
        read_finals(change(text), "finals")  # type: ignore[operator]


def test_row_59_a_table_that_ends_too_early() -> None:
    text = "\n".join(_line(mjd, 0.1, 0.3, -0.13) for mjd in (59412.0, 59413.0))
    begin, r = Instant.parse("2021-07-17T12:00:00 UTC"), np.ones((2, 3))
    with pytest.raises(InputError, match="found days 59412 to 59413, expected the time from 2021"):
        gcrf_from_itrf(begin, np.array([0.0, 5e4]), r, r, read_finals(text, "finals"))
