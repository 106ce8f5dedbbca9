"""Time, frames, gravity and orbits by brahe, which shares no line with this package or with ERFA.

It is asked for nothing that needs a network: UT1 = UTC and no polar motion, its packaged EGM2008,
its series of Sun and Moon.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from independent import PLACES, pull, sphere
from relnav_factors.dynamics.orbit_two_body import OrbitTwoBody
from relnav_factors.shared.earth import earth_numbers, earth_pull

from relnav_graph.arrays import Array
from relnav_graph.core.absolute_time import AbsoluteTime
from relnav_graph.core.track import Track
from relnav_graph.maths.earth import gcrf_from_itrf
from relnav_graph.maths.instants import Instant

#: Whether it is installed: on some platforms there is no wheel.
FOUND = find_spec("brahe") is not None
#: Of the day of GPS that the real pair of spacecraft has, in orbits that test all of it.
EPOCH = "2021-07-17T00:00:00"
CLOCK = AbsoluteTime(f"{EPOCH} TT")
SCALES = ("UTC", "TAI", "GPS", "TT")
#: A low, nearly polar orbit: m, m/s, in GCRF.
LOW = np.array([1.2e6, 3e5, 6.75e6, 7.4e3, 2e2, -1.2e3])


def _brahe() -> Any:
    import brahe

    brahe.set_global_eop_provider_from_static_provider(brahe.StaticEOPProvider.from_zero())
    return brahe


def _epoch(text: str) -> Any:
    """An instant, as "2021-07-17T00:00:00 TT"."""
    when, scale = text.split()
    return _brahe().Epoch.from_string(f"{when.replace('T', ' ')}.000 {scale}")


def time_apart() -> float:
    """Seconds between instants of four scales, on both sides of three leap seconds, s."""
    days = ("2008-12-31", "2015-06-30", "2016-12-31", "2021-07-17")
    texts = [f"{day}T{h} {s}" for day in days for h in ("11:59:58", "23:59:59") for s in SCALES]
    ours, its = [Instant.parse(text) for text in texts], [_epoch(text) for text in texts]
    pairs = zip(ours, its, strict=True)
    return float(max(abs(one.since(ours[0]) - (other - its[0])) for one, other in pairs))


def frames_apart() -> tuple[float, float]:
    """Of a state 7000 km away, ITRF to GCRF, m and m/s. brahe has the time of the Earth's turn as
    a day in double precision, 0.6 us, in which the Earth turns by 0.3 mm there."""
    brahe, y = _brahe(), np.array([7e6, 1e5, -2e6, 1e3, 7e3, 5e2])
    found = []
    for k in range(12):
        text = f"2021-{k + 1:02d}-17T0{k % 10}:00:00 TT"
        begin = Instant.parse(text)
        r, v = gcrf_from_itrf(begin, np.zeros(1), y[None, :3], y[None, 3:], None)
        its = brahe.state_itrf_to_gcrf(_epoch(text), y)
        found.append([np.abs(r[0] - its[:3]).max(), np.abs(v[0] - its[3:]).max()])
    position, velocity = np.max(found, axis=0).tolist()
    return position, velocity


def gravity_apart() -> float:
    """The Earth's pull to degree and order 20 and 60, m/s^2; brahe sums after Clenshaw."""
    brahe = _brahe()
    model = brahe.GravityModel.from_model_type(brahe.GravityModelType.EGM2008_120)
    found = [
        np.abs(sphere(r) + pull(r, n, n)[0] - model.compute_spherical_harmonics(r, n, n)).max()
        for r in PLACES[:5]  # brahe divides by nothing at the last one, the pole
        for n in (20, 60)
    ]
    return float(max(found))


def third_bodies_apart() -> float:
    """The pull of Sun and Moon on a low orbit over a month, m/s^2. Both have analytic series; those
    of brahe are the shorter ones."""
    brahe, found = _brahe(), []
    for day in range(0, 32, 2):
        t = 86400.0 * day
        when = _epoch(f"{EPOCH} TT") + t
        theirs = {"sun": brahe.accel_third_body_sun, "moon": brahe.accel_third_body_moon}
        for name, its in theirs.items():
            with_it, without = (
                earth_pull(earth_numbers(2, 0, bodies, CLOCK), t, LOW[:3])[0]
                for bodies in ((name,), ())
            )
            found.append(np.abs(with_it - without - its(when, LOW[:3])).max())
    return float(max(found))


def orbit_apart(seconds: float = 5800.0) -> tuple[float, float]:
    """After a revolution in a field of 20 x 20 that turns: positions, m, and the transition matrix,
    as a part of the largest number of its blocks.

    The matrix is that of differences of brahe's orbits. The one that brahe integrates beside them
    is not their derivative: after 60 s both differ in the third digit.
    """
    brahe = _brahe()
    field = brahe.GravityConfiguration.spherical_harmonic(
        20, 20, brahe.GravityModelType.EGM2008_120
    )
    config = brahe.NumericalPropagationConfig.high_precision().with_abs_tol(1e-9)
    config, forces = config.with_rel_tol(1e-13), brahe.ForceModelConfig(gravity=field)

    def flown(y: Array) -> Array:
        one = brahe.NumericalOrbitPropagator(_epoch(f"{EPOCH} TT"), y, config, forces)
        one.propagate_to(_epoch(f"{EPOCH} TT") + seconds)
        return np.asarray(one.current_state())

    model = OrbitTwoBody(acceleration_density=1e-6, degree=20, order=20, clock=CLOCK, max_step=1.0)
    (r, _), F, _ = model.transition(0.0, np.array([[seconds]]), LOW[:3], LOW[3:])
    steps = np.diag([10.0] * 3 + [0.01] * 3)
    its = np.array([(flown(LOW + h) - flown(LOW - h)) / (2 * h.sum()) for h in steps]).T
    halves = (slice(0, 3), slice(3, 6))
    parts = [(F[a, b], its[a, b]) for a in halves for b in halves]
    apart = max(float(np.abs(x - y).max() / np.abs(y).max()) for x, y in parts)
    return float(np.abs(r - flown(LOW)[:3]).max()), apart


def messages_apart(one: Track, epoch: str, folder: Path) -> tuple[float, float]:
    """What another reader finds in an OEM and an AEM of ours: states, m and m/s, and quaternions,
    with times in s, to the millisecond that it counts in; infinite where axes are others."""
    import brahe.ccsds as messages

    from relnav_graph import write_track
    from relnav_graph.io.ccsds.aem import read_attitudes
    from relnav_graph.io.ccsds.oem import read_ephemeris

    day = "2016-12-31T00:00:00"
    begin, since = _epoch(f"{day} UTC"), Instant.parse(f"{day} UTC")
    oem, aem = folder / "a.oem", folder / "a.aem"
    write_track("oem", one, oem, epoch=epoch)
    write_track("aem", one, aem, epoch=epoch)
    orbit, turns = read_ephemeris(oem), read_attitudes(aem)
    (states,) = messages.OEM.from_file(str(oem)).segments
    (attitudes,) = messages.AEM.from_file(str(aem)).segments
    found: list[tuple[Any, ...]] = [
        (states.ref_frame, states.states, orbit, orbit.state, [s.state for s in states.states]),
        (
            attitudes.ref_frame_a,
            attitudes.states,
            turns,
            turns.q_wxyz,
            [s.quaternion.to_vector(True) for s in attitudes.states],
        ),
    ]
    apart = []
    for axes, rows, ours, values, its in found:
        times = np.array([row.epoch - begin for row in rows])
        late = np.abs(times - ours.epoch.since(since) - ours.t).max()
        far = float(max(late, np.abs(np.array(its) - values).max()))
        apart.append(far if axes == "ICRF" else np.inf)
    return apart[0], apart[1]
