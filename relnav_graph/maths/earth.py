"""How the Earth turns: between the celestial frame GCRF and the Earth-fixed frame ITRF.

Precession and nutation of IAU 2006/2000A, the Earth rotation angle of IAU 2000, by ERFA, through
the intermediate origins (IERS Conventions 2010, chapter 5): ``r_gcrf = Q(X, Y, s) R3(-ERA) W
r_itrf``.

Orientation of the Earth (UT1, polar motion) is measured, not computed. Without a table of it UT1
counts as UTC and the pole as unmoved. Their size: |UT1 - UTC| < 0.9 s, in 2017 to 2026 below 0.3 s,
140 m at the equator and 150 m in a low orbit; polar motion up to 0.6 arcsec, 18 m. Such an error
turns a gravity field by 7 and 0.6 arcsec at most; it turns positions, too, that are converted, of
two craft alike. What a table leaves out: offsets of the celestial pole (0.3 mas, 1 cm), and tides
of less than a day in UT1 and the pole (2 cm).
"""

from __future__ import annotations

from dataclasses import dataclass

import erfa
import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError
from relnav_graph.maths.instants import DAY, TT_TAI, Instant, leap_seconds

__all__ = ["EarthTable", "gcrf_from_itrf", "itrf_from_gcrf", "read_finals", "third_body"]

_ARCSEC = np.pi / 648000
_JD = 2400000.5
#: Rate of the Earth rotation angle, rad/s of UT1 (IERS Conventions 2010, eq. 5.15).
EARTH_RATE = 2 * np.pi * 1.00273781191135448 / DAY


@dataclass(frozen=True, eq=False)
class EarthTable:
    """Orientation of the Earth as measured: mjd (N,), days of UTC, rising; ut1_utc (N,), s; and
    xp, yp (N,), rad, the pole. source: the name that errors give it.

    Raises InputError on other shapes, on days out of order, and on numbers that none can be.
    """

    mjd: Array
    ut1_utc: Array
    xp: Array
    yp: Array
    source: str = "orientation of the Earth"

    def __post_init__(self) -> None:
        columns = [self.mjd, self.ut1_utc, self.xp, self.yp]
        if len(self.mjd) < 2 or any(c.shape != self.mjd.shape or c.ndim != 1 for c in columns):
            shapes = [c.shape for c in columns]
            raise InputError(f"{self.source}: found {shapes}, expected two days or more")
        if not (np.diff(self.mjd) > 0).all():
            bad = self.mjd[1 + int(np.argmin(np.diff(self.mjd)))]
            raise InputError(f"{self.source}: found day {bad:g} after a later one")
        for name, values, most in (
            ("UT1 - UTC", self.ut1_utc, 1.0),
            ("polar motion", np.hypot(self.xp, self.yp), 2 * _ARCSEC),
        ):
            wrong = ~(np.abs(values) < most)
            if wrong.any():
                k = int(np.argmax(wrong))
                raise InputError(
                    f"{self.source}: day {self.mjd[k]:g}: found {name} of {values[k]:g}, expected"
                    f" less than {most:g} in size"
                )

    def covers(self, begin: Instant) -> tuple[float, float]:
        """From which to which time, s since an instant, the table goes."""
        tt = self._seconds(begin)
        return float(tt[0]), float(tt[-1])

    def _tai_utc(self) -> Array:
        return np.array([leap_seconds(int(day)) for day in self.mjd], dtype=np.float64)

    def _seconds(self, begin: Instant) -> Array:
        """The days (N,) in seconds since an instant."""
        first = int(self.mjd[0])
        since = Instant.of(first, 0.0, "TT").since(begin)
        return (self.mjd - first) * DAY + self._tai_utc() + TT_TAI + since

    def at(self, begin: Instant, t: Array) -> tuple[Array, Array, Array]:
        """UT1 - TT, s, xp and yp, rad, (N,) each, at t (N,), s since an instant; between days
        linear, in UT1 - TAI, which does not jump.

        Raises InputError on times that the table does not cover.
        """
        own = self._seconds(begin)
        if not (own[0] <= t.min() and t.max() <= own[-1]):
            raise InputError(
                f"{self.source}: found days {self.mjd[0]:g} to {self.mjd[-1]:g}, expected the time"
                f" from {begin.after(float(t.min()))} to {begin.after(float(t.max()))}"
            )
        ut1_tt = self.ut1_utc - self._tai_utc() - TT_TAI
        return np.interp(t, own, ut1_tt), np.interp(t, own, self.xp), np.interp(t, own, self.yp)


def read_finals(text: str, source: str) -> EarthTable:
    """The table in the text of a file of the IERS, "finals2000A" (all, daily, data).

    Bulletin A: columns 8-15 MJD, 19-27 and 38-46 the pole in arcsec, 59-68 UT1 - UTC in s; the last
    rows, that have no values yet, are left out. source: the file's name. Raises InputError, with
    the line, on what is no such row.
    """
    rows = []
    for number, line in enumerate(text.splitlines(), 1):
        words = [line[7:15], line[58:68], line[18:27], line[37:46]]
        if not line.strip() or not all(word.strip() for word in words[1:]):
            continue
        try:
            rows.append([float(word) for word in words])
        except ValueError as error:
            raise InputError(
                f"{source}, line {number}: found {line[:68]!r}, expected a row of a finals2000A"
                f" file of the IERS: {error}"
            ) from error
    if not rows:
        raise InputError(f"{source}: found no row of a finals2000A file of the IERS")
    mjd, ut1_utc, xp, yp = np.array(rows).T
    return EarthTable(mjd, ut1_utc, xp * _ARCSEC, yp * _ARCSEC, source)


def orientation(begin: Instant, t: Array, table: EarthTable | None) -> tuple[Array, Array, Array]:
    """UT1 - TT, s, xp and yp, rad, (N,) each, at t (N,), s since an instant.

    Without a table UT1 is UTC as counted at `begin`: it does not jump at a leap second. Raises
    InputError on times that a table does not cover.
    """
    if table is not None:
        return table.at(begin, t)
    none = np.zeros(len(t))
    return none - begin.tai_utc - TT_TAI, none, none


def rotation_angle(begin: Instant, t: Array, ut1_tt: Array) -> Array:
    """The Earth rotation angle (N,), rad, at t (N,), s since an instant; ut1_tt: (N,), s."""
    found: Array = erfa.era00(_JD + begin.day, (begin.seconds + t + ut1_tt) / DAY)
    return found


def celestial_pole(begin: Instant, t: Array) -> tuple[Array, Array, Array]:
    """X, Y of the intermediate pole in GCRF and s of the intermediate origin, (N,) each, rad.

    t: (N,), s since an instant.
    """
    x, y, s = erfa.xys06a(_JD + begin.day, (begin.seconds + t) / DAY)
    return x, y, s


def origin_offset(begin: Instant, t: Array) -> Array:
    """s' (N,), rad, of the terrestrial intermediate origin, at t (N,), s since an instant."""
    found: Array = erfa.sp00(_JD + begin.day, (begin.seconds + t) / DAY)
    return found


def turns(begin: Instant, t: Array, table: EarthTable | None) -> tuple[Array, Array]:
    """``R_ie`` (N, 3, 3), from ITRF to GCRF, and its rate of turn in ITRF (N, 3), rad/s.

    t: (N,), s since an instant; table: the Earth's orientation. Raises InputError on times that it
    does not cover.
    """
    ut1_tt, xp, yp = orientation(begin, t, table)
    to_celestial = erfa.c2ixys(*celestial_pole(begin, t))
    to_terrestrial = erfa.pom00(xp, yp, origin_offset(begin, t))
    R_ei = erfa.c2tcio(to_celestial, rotation_angle(begin, t, ut1_tt), to_terrestrial)
    return np.swapaxes(R_ei, -1, -2), EARTH_RATE * to_terrestrial[..., 2]


def third_body(name: str, begin: Instant, t: Array) -> Array:
    """Where the "sun" or the "moon" is from the Earth's centre, (N, 3), m, in GCRF.

    t: (N,), s since an instant. Series of ERFA (Simon et al. 1994; Meeus 1998): the Sun within 1e-7
    of its distance, the Moon within 1e-4: 1e-10 m/s^2 of its pull on a low orbit.
    """
    jd = _JD + begin.day, (begin.seconds + t) / DAY
    found = erfa.moon98(*jd)["p"] if name == "moon" else -erfa.epv00(*jd)[0]["p"]
    return np.asarray(found, dtype=np.float64) * float(erfa.DAU)


def _checked(t: Array, r: Array, v: Array) -> tuple[Array, Array, Array]:
    t, r, v = (np.asarray(a, dtype=np.float64) for a in (t, r, v))
    if t.ndim != 1 or r.shape != (len(t), 3) or v.shape != r.shape:
        found = f"found times {t.shape}, positions {r.shape}, velocities {v.shape}"
        raise InputError(f"{found}, expected (N,), (N, 3), (N, 3)")
    return t, r, v


def gcrf_from_itrf(
    begin: Instant, t: Array, r: Array, v: Array, table: EarthTable | None = None
) -> tuple[Array, Array]:
    """Positions (N, 3), m, and velocities (N, 3), m/s, in GCRF of what is given in ITRF.

    begin: the instant from which t (N,), s, counts, as of `Instant.of(day, seconds, "GPS")`; r
    (N, 3), m; v (N, 3), m/s: the rate of r in ITRF, which turns with ``w x r``. table: the Earth's
    orientation, None: UT1 = UTC, no polar motion. What v leaves out: the motion of the pole (2e-5
    m/s in a low orbit) and of the length of day (4e-6 m/s).

    Raises InputError on other shapes, and on times that the table does not cover.
    """
    t, r, v = _checked(t, r, v)
    R_ie, w_e = turns(begin, t, table)
    return (
        np.einsum("nij,nj->ni", R_ie, r),
        np.einsum("nij,nj->ni", R_ie, v + np.cross(w_e, r)),
    )


def itrf_from_gcrf(
    begin: Instant, t: Array, r: Array, v: Array, table: EarthTable | None = None
) -> tuple[Array, Array]:
    """The reverse of `gcrf_from_itrf`: from positions (N, 3), m, and velocities (N, 3), m/s, in
    GCRF to those in ITRF, at t (N,), s since an instant.

    Raises InputError on other shapes, and on times that the table does not cover.
    """
    t, r, v = _checked(t, r, v)
    R_ie, w_e = turns(begin, t, table)
    r_e = np.einsum("nji,nj->ni", R_ie, r)
    return r_e, np.einsum("nji,nj->ni", R_ie, v) - np.cross(w_e, r_e)
