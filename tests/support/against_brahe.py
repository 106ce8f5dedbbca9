"""The same quantities by this package and by brahe, a library of astrodynamics in Rust, and how far
they are apart: gravity, time, frames, Sun and Moon, orbits.

Not all of it is independent. Both take precession and nutation from the IAU's SOFA (here as ERFA),
so that frames compare how it is put together, and which time goes in. Both hold the coefficients of
EGM2008. Harmonics, integrators, time scales and the pull of third bodies are other code.

Where brahe has no wheel, the tests skip (`needs_brahe`). It never asks a network: `library` tells
it the Earth's orientation, and Sun and Moon are its own series, not files of the JPL.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from typing import Any

import erfa
import numpy as np
import pytest
from independent import FIELD, PLACES, length, pull, sphere
from relnav_factors.dynamics.orbit_two_body import OrbitTwoBody
from relnav_factors.dynamics.relative_two_body import RelativeTwoBody
from relnav_factors.shared.earth import earth_numbers, earth_pull

from relnav_graph.arrays import Array
from relnav_graph.constants import MU_THIRD
from relnav_graph.core.absolute_time import AbsoluteTime
from relnav_graph.io.ccsds.axes import gcrf_from
from relnav_graph.maths.earth import EarthTable, gcrf_from_itrf, itrf_from_gcrf, third_body
from relnav_graph.maths.instants import DAY, Instant
from relnav_graph.sim.truths.earth_gravity import TurningEarth

needs_brahe = pytest.mark.skipif(
    find_spec("brahe") is None,
    reason="needs brahe, of the extra dev: it has wheels for Linux and for macOS on arm64",
)


def library(ut1_utc: float = 0.0, xp: float = 0.0, yp: float = 0.0) -> Any:
    """brahe, told how the Earth turns: UT1 - UTC, s, and the pole, rad."""
    import brahe

    # Its documentation names them in another order than it takes them in, that of `get_eop`.
    eop = brahe.StaticEOPProvider.from_values(xp, yp, ut1_utc, 0.0, 0.0, 0.0)
    assert (eop.get_ut1_utc(0.0), eop.get_pm(0.0)) == (ut1_utc, (xp, yp))
    brahe.set_global_eop_provider_from_static_provider(eop)
    return brahe


# --- gravity ----------------------------------------------------------------------------------


def coefficients_apart() -> float:
    """Of EGM2008 to degree 60, fully normalised; infinite where GM or the radius is another."""
    brahe = library()
    model = brahe.GravityModel.from_model_type(brahe.GravityModelType.EGM2008_120)
    if (model.gm, model.radius) != (FIELD.gm, FIELD.radius) or "TideFree" not in str(
        model.tide_system
    ):
        return np.inf
    pairs = [(n, m) for n in range(2, 61) for m in range(n + 1)]
    return max(
        float(np.abs(np.subtract(model.get(n, m), (FIELD.C[n, m], FIELD.S[n, m]))).max())
        for n, m in pairs
    )


def gravity_apart(degree: int) -> float:
    """The Earth's pull to a degree and order at all `PLACES`, m/s^2; brahe's of its own file."""
    brahe = library()
    model = brahe.GravityModel.from_model_type(brahe.GravityModelType.EGM2008_120)
    found = []
    for r in PLACES:
        want = model.compute_spherical_harmonics(r, degree, degree)
        found.append(np.abs(sphere(r) + pull(r, degree, degree)[0] - want).max())
    return float(max(found))


# --- time -------------------------------------------------------------------------------------


def about_leap_seconds() -> list[Instant]:
    """Before, in and after each leap second since 1973, and days that are far from any."""
    leaps = [
        Instant.parse(f"{y}-{m:02d}-01T00:00:00 UTC").after(s)
        for y, m, _ in erfa.leap_seconds.get()
        if y >= 1973
        for s in (-2.0, -1.5, -1.0, -0.5, 0.0, 0.25, 1.0)
    ]
    begin = Instant.parse("1999-08-22T00:00:13 UTC")
    days = np.random.default_rng(0).uniform(0, 26 * 365.25 * DAY, 40)
    return leaps + [begin.after(float(s)) for s in days]


def _epoch(brahe: Any, one: Instant, scale: str) -> Any:
    """What brahe makes of the date and the clock that we write in a scale."""
    day, clock = one.calendar(scale).split("T")
    hour, minute, second = clock.split(":")
    system = getattr(brahe.TimeSystem, scale)
    fields = [*map(int, day.split("-")), int(hour), int(minute)]
    return brahe.Epoch.from_datetime(*fields, float(second), 0.0, system)


def _written(fields: Sequence[float], scale: str) -> Instant:
    """What we make of brahe's fields of a date and a clock in a scale."""
    y, mo, d, h, mi, s = (int(x) for x in fields[:6])
    text = f"{y}-{mo:02d}-{d:02d}T{h:02d}:{mi:02d}:{s:02d} {scale}"
    return Instant.parse(text).after(fields[6] / 1e9)


def time_apart() -> float:
    """Of UTC, TAI, GPS and TT, each from each, s: brahe reads what we write, converts, and we read
    what it has."""
    brahe, found = library(), [0.0]
    scales = ("UTC", "TAI", "GPS", "TT")
    for one in about_leap_seconds():
        utc = _epoch(brahe, one, "UTC")
        for scale in scales:
            read = _epoch(brahe, one, scale)
            found.append(abs(read - utc))
            for other in scales:
                fields = read.to_datetime_as_time_system(getattr(brahe.TimeSystem, other))
                found.append(abs(_written(fields, other).since(one)))
    return max(found)


def tdb_apart() -> float:
    """Of TDB, s, over two years. brahe's series is one of two terms, good to some 1e-5 s."""
    brahe, begin = library(), Instant.parse("2020-01-01T00:00:00 TT")
    days = [begin.after(DAY * k) for k in range(0, 731, 10)]
    apart = (_epoch(brahe, one, "TDB") - _epoch(brahe, one, "TT") for one in days)
    return max(abs(float(s)) for s in apart)


# --- frames -----------------------------------------------------------------------------------

BEGIN = Instant.parse("2021-07-17T00:00:00 UTC")
#: UT1 - UTC of this many seconds is 2^-20 of a day. brahe counts UT1 in days since 1858, in one
#: double: to 3e-7 s, or 0.2 mm of a low orbit, but for days and fractions that a double holds.
UT1_UTC = DAY * 2.0**-20
POLE = (1e-6, 2e-6)


def _at(brahe: Any, t: float) -> Any:
    return _epoch(brahe, BEGIN, "UTC") + t


def frames_apart() -> tuple[float, float]:
    """Of positions 7000 km away, m, and of velocities, m/s, from ITRF to GCRF and back: with UT1 =
    UTC and the pole at rest, and with both elsewhere."""
    t = 21600.0 * np.array([0.0, 1.0, 2.0, 7.0, 1001.0])
    r, v = np.array([[7e6, 1e5, -2e6]] * 5), np.array([[1e3, 7e3, 5e2]] * 5)
    mjd = np.arange(59410.0, 59700.0)
    ones = np.ones(len(mjd))
    found = []
    for ut1, pole in ((0.0, (0.0, 0.0)), (UT1_UTC, POLE)):
        brahe = library(ut1, *pole)
        table = EarthTable(mjd, ut1 * ones, pole[0] * ones, pole[1] * ones)
        for there, theirs in (
            (gcrf_from_itrf, brahe.state_itrf_to_gcrf),
            (itrf_from_gcrf, brahe.state_gcrf_to_itrf),
        ):
            states = zip(t.tolist(), np.hstack([r, v]), strict=True)
            want = np.array([theirs(_at(brahe, s), x) for s, x in states])
            off = np.abs(np.hstack(there(BEGIN, t, r, v, table)) - want)
            found.append((off[:, :3].max(), off[:, 3:].max()))
    return float(max(p for p, _ in found)), float(max(w for _, w in found))


def eme2000_apart() -> float:
    """Of positions 7000 km away, m, from EME2000 to GCRF. brahe's bias is one of second order."""
    R_ie = gcrf_from("EME2000")
    assert R_ie is not None
    r = 7e6 * np.eye(3)
    want = np.array([library().position_eme2000_to_gcrf(x) for x in r])
    return float(np.abs(r @ R_ie.T - want).max())


# --- Sun and Moon -------------------------------------------------------------------------------

CLOCK = AbsoluteTime("2021-07-17T00:00:00 UTC")


def bodies_apart() -> dict[str, float]:
    """Of Sun and Moon over two years, relative to their distance. brahe's are the short series of
    Montenbruck and Gill (2000, section 3.3.2), arcminutes: what differs is theirs."""
    brahe, t = library(), DAY * np.arange(0.0, 731.0, 3.7)
    found = {}
    for name, theirs in (("sun", brahe.sun_position), ("moon", brahe.moon_position)):
        ours = third_body(name, BEGIN, t)
        want = np.array([theirs(_at(brahe, float(s))) for s in t])
        found[name] = float(
            (np.linalg.norm(ours - want, axis=1) / np.linalg.norm(ours, axis=1)).max()
        )
    return found


def tides_apart() -> float:
    """The pull of Sun and Moon where this package has them, less that on the Earth, m/s^2."""
    brahe, found = library(), []
    for name, mu in MU_THIRD.items():
        earth = earth_numbers(0, 0, (name,), CLOCK)
        for t in (0.0, 12345.6, 20.3 * DAY):
            s = third_body(name, CLOCK.begin, np.array([t]))[0]
            for r in PLACES:
                want = brahe.accel_point_mass_gravity(r, s, mu)
                found.append(np.abs(earth_pull(earth, t, r)[0] - want).max())
    return float(max(found))


# --- orbits -----------------------------------------------------------------------------------

#: A polar orbit of 500 km, and a target 4 km behind.
CHASER = np.array([1.2e6, 3e5, 6.75e6, 7.4e3, 2e2, -1.2e3])
APART = np.array([-1.9e3, 2e2, 3e3, 3.0, 0.5, 2.0])
#: Seconds of an interval, and how many: a little more than an orbit.
INTERVAL, INTERVALS = 500.0, 12


def brahe_flies(y: Array, third_bodies: str) -> Array:
    """The state (6,) after all intervals, by brahe's Runge-Kutta-Nystroem 12(10), with its own
    harmonics of 20 by 20 and no Sun and Moon ("none"), its own ("own"), or its own pull of those
    where this package has them ("ours")."""
    brahe = library()

    def tides(t: float, y: Array, p: Any) -> Array:
        out = np.zeros(6)
        for name, mu in MU_THIRD.items():
            s = third_body(name, CLOCK.begin, np.array([t]))[0]
            out[3:] += brahe.accel_point_mass_gravity(y[:3], s, mu)
        return out

    source = brahe.EphemerisSource.LowPrecision
    bodies = (brahe.ThirdBody.SUN, brahe.ThirdBody.MOON) if third_bodies == "own" else ()
    forces = brahe.ForceModelConfig(
        gravity=brahe.GravityConfiguration(degree=20, order=20),
        third_body=[brahe.ThirdBodyConfiguration(body, source) for body in bodies] or None,
    )
    one = brahe.NumericalOrbitPropagator(
        _at(brahe, 0.0),
        y,
        brahe.NumericalPropagationConfig.high_precision(),
        forces,
        None,
        # Its way to add an acceleration to a state of six.
        control_input=tides if third_bodies == "ours" else None,
    )
    one.propagate_to(_at(brahe, INTERVAL * INTERVALS))
    return np.asarray(one.current_state())


def orbits_apart(third_bodies: str = "ours") -> dict[str, float]:
    """After an orbit in gravity of 20 by 20, with third bodies as in `brahe_flies`: position, m,
    and velocity, m/s, of `orbit_two_body`; relative position, m, and velocity, m/s, of
    `relative_two_body`; position, m, of the simulated truth."""
    bodies = () if third_bodies == "none" else tuple(MU_THIRD)
    options: dict[str, Any] = {"degree": 20, "order": 20, "third_bodies": bodies, "clock": CLOCK}
    orbit = OrbitTwoBody(acceleration_density=1e-6, max_step=1.0, **options)
    relative = RelativeTwoBody(acceleration_density=1e-6, max_step=1.0, **options)
    r_c, v_c, r_tc, v_tc = *np.split(CHASER, 2), *np.split(APART, 2)
    for k in range(INTERVALS):
        t, u = INTERVAL * k, np.array([[INTERVAL]])
        r_tc, v_tc = relative.propagate(t, u, r_tc, v_tc, r_c, v_c)
        r_c, v_c = orbit.propagate(t, u, r_c, v_c)
    both = np.concatenate([CHASER - APART, CHASER])
    steps = round(INTERVAL * INTERVALS)
    truth = TurningEarth(20, 20, bodies, CLOCK).fly(both, np.zeros(6), 0.0, 1.0, steps)
    want = brahe_flies(CHASER, third_bodies)
    other = want - brahe_flies(CHASER - APART, third_bodies)
    return {
        "position": length(r_c - want[:3]),
        "velocity": length(v_c - want[3:]),
        "relative position": length(r_tc - other[:3]),
        "relative velocity": length(v_tc - other[3:]),
        "true position": length(truth[6:9] - want[:3]),
    }


def transition_apart() -> float:
    """Of the transition matrix of `orbit_two_body` over all intervals without Sun and Moon, as a
    part of the largest number of each of its blocks of positions and velocities.

    It is compared with differences of brahe's orbits. The matrix that brahe integrates beside them
    is not their derivative: after 60 s it differs from it in the third digit.
    """
    orbit = OrbitTwoBody(acceleration_density=1e-6, max_step=1.0, degree=20, order=20, clock=CLOCK)
    length_s = INTERVAL * INTERVALS
    _, F, _ = orbit.transition(0.0, np.array([[length_s]]), *np.split(CHASER, 2))
    steps = np.diag([10.0] * 3 + [0.01] * 3)  # m, m/s
    flown = [
        (brahe_flies(CHASER + h, "none") - brahe_flies(CHASER - h, "none")) / (2 * h.sum())
        for h in steps
    ]
    want, halves = np.array(flown).T, (slice(0, 3), slice(3, 6))
    parts = [(F[a, b], want[a, b]) for a in halves for b in halves]
    return max(float(np.abs(f - w).max() / np.abs(w).max()) for f, w in parts)
