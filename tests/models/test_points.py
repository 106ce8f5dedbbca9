"""Points of the target in cameras: known and unknown ones, where they are seen, and which are."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from example_makers import BEACONS, mono, stereo
from examples import EXAMPLES
from relnav_factors.sensors.beacon_los import BeaconLineOfSight
from relnav_factors.sensors.stereo_point import StereoPointCartesian

from relnav_graph.arrays import Array
from relnav_graph.core.conformance.examples import SensorExample
from relnav_graph.core.contracts import Mappable, ReadsNumbered
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.state import Layout
from relnav_graph.errors import GeometryError, InputError
from relnav_graph.maths import so3

KNOWN = {
    f"{kind}-{n}": example
    for kind, examples in EXAMPLES.items()
    for n, example in enumerate(examples)
    if isinstance(example, SensorExample)
    and not isinstance(getattr(example.model, "points", "unknown"), str)
}
#: The camera at the origin of c, which is that of o; its axis is z of o.
AHEAD = (np.eye(3), np.eye(3), np.array([0.0, 0.0, -10.0]))


@pytest.mark.parametrize("name", KNOWN)
def test_unknown_points_are_seen_as_known_ones_are(name: str) -> None:
    """The same residuals and Jacobians bit for bit; that to the point is the one by which the
    whole map is moved against the pose."""
    example: Any = KNOWN[name]
    known, rng = example.model, np.random.default_rng(3)
    unknown: Any = replace(known, points="unknown")
    assert all(isinstance(unknown, contract) for contract in (ReadsNumbered, Mappable))
    assert unknown.reads == known.reads
    assert known.numbered is None
    assert unknown.numbered is not None
    assert unknown.numbered.name == "point"
    for _ in range(5):
        x, ids = example.draw(rng, "moderate"), np.array([3, 0])
        z = known.predict(ids, *x)
        points = known.points[ids]
        np.testing.assert_array_equal(unknown.predict(ids, *x, points), z)
        m = Measurement("s", 0.0, z, ids)
        r, H = known.residual(m, *x)
        s, G = unknown.residual(m, *x, points)
        np.testing.assert_array_equal(s, r)
        for a, b in zip(H, G[:-1], strict=True):
            np.testing.assert_array_equal(a, b)
        at = [b.name for b in known.reads].index("relative_position")
        R_ot = np.eye(3) if known.pose == "target" else x[1]
        np.testing.assert_allclose(G[-1], -H[at] @ R_ot, rtol=0, atol=1e-9 * np.abs(H[at]).max())
        again = unknown.mapped(known.points, None)
        np.testing.assert_array_equal(again.predict(ids, *x), z)


@pytest.mark.parametrize("name", KNOWN)
def test_a_sight_leads_back_to_the_point(name: str) -> None:
    """With an estimated mounting, too: the origin is the camera, and the line ends at the point or
    goes through it."""
    example: Any = KNOWN[name]
    sensor, rng = replace(example.model, points="unknown"), np.random.default_rng(4)
    for _ in range(5):
        x, ids = example.draw(rng, "moderate"), np.array([4, 1, 2])
        points = example.model.points[ids]
        z = sensor.predict(ids, *x, points)
        origins, lines = sensor.sights(ids, z, *x)
        assert origins.shape == lines.shape == (3, 3)
        # The camera is where points have the place zero in its axes.
        here = sensor.points_in_sensor(ids, *x, origins)
        np.testing.assert_allclose(here, 0, atol=1e-9)
        if sensor.sees_depth:
            np.testing.assert_allclose(origins + lines, points, atol=1e-8)
            continue
        np.testing.assert_allclose(np.linalg.norm(lines, axis=1), 1, atol=1e-12)
        off = points - origins
        np.testing.assert_allclose(
            lines * np.linalg.norm(off, axis=1, keepdims=True), off, atol=1e-8
        )


def test_which_sensors_see_depth() -> None:
    models = {kind: examples[0].model for kind, examples in EXAMPLES.items() if "point" in kind}
    del models["three_point_attitude"]  # an attitude: it maps no points
    depth = {kind: model.sees_depth for kind, model in models.items()}
    assert depth == {"stereo_point": True, "stereo_point_cartesian": True, "mono_point": False}
    assert not BeaconLineOfSight(points="unknown", sigma=1e-3).sees_depth


def test_a_stereo_pair_whose_pixels_do_not_differ_tells_nothing() -> None:
    camera, ids = replace(stereo(), points="unknown"), np.arange(3)
    noise = float(np.hypot(camera.pixel_sigma[0], camera.pixel_sigma[2]))
    z = np.array([[320.0, 240.0, 320.0 - d, 240.0] for d in (-1.0, 0.99 * noise, 1.01 * noise)])
    lines = camera.sights(ids, z, *AHEAD)[1]
    assert np.isnan(lines[:2]).all()
    np.testing.assert_allclose(lines[2], [0, 0, 480.0 * 0.24 / (1.01 * noise)])


def test_one_camera_is_the_left_one_of_two() -> None:
    left, pair = mono(), stereo()
    x, ids = AHEAD, np.arange(5)
    np.testing.assert_array_equal(left.predict(ids, *x), pair.predict(ids, *x)[:, :2])
    z = left.predict(ids[:1], *x)[0]
    X, Y, Z = BEACONS[0] + [0, 0, 10.0]
    np.testing.assert_allclose(z, [480 * X / Z + 320, 500 * Y / Z + 240])


@pytest.mark.parametrize("sensor", [mono(), stereo()], ids=["mono", "stereo"])
def test_a_pinhole_never_sees_what_is_behind(sensor: Any) -> None:
    behind = (np.eye(3), np.eye(3), np.array([0.0, 0.0, 10.0]))
    with pytest.raises(GeometryError, match=r"id 2 at depth -10\.4"):
        sensor.predict(np.array([2]), *(*behind[:2], behind[2] + [0, 0, 0.4]))
    m = Measurement("s", 0.0, np.zeros((1, len(sensor.columns))), np.array([0]))
    with pytest.raises(GeometryError, match="the point is behind the camera"):
        sensor.residual(m, *behind)


def view(**options: Any) -> StereoPointCartesian:
    """A camera of points straight ahead and off its axis by 10, 20, 30 deg in x, then in y."""
    angles = np.radians([0, 10, 20, 30])
    x = [[10 * np.tan(a), 0, 0] for a in angles]
    y = [[0, 10 * np.tan(a), 0] for a in angles[1:]]
    return StereoPointCartesian(points=np.array([*x, *y]), sigma=np.full(3, 0.01), **options)


@pytest.mark.parametrize(
    ("options", "seen", "seen_when_turned"),
    [
        ({}, [0, 1, 2, 3, 4, 5, 6], [0, 1, 2, 3, 4, 5, 6]),
        ({"field_of_view": np.radians(41)}, [0, 1, 2, 4, 5], [0, 1, 2, 4, 5]),
        ({"field_of_view": np.radians([19, 61])}, [0, 4, 5, 6], [0, 1, 2, 3]),
        ({"range": [10.1, 11.0]}, [1, 2, 4, 5], [1, 2, 4, 5]),
        ({"range": [0.0, 10.1]}, [0], [0]),
        ({"field_of_view": np.radians([41, 61]), "range": [0.0, 11.0]}, [0, 1, 2, 4, 5], None),
    ],
)
def test_field_of_view_and_range(
    options: Any, seen: list[int], seen_when_turned: list[int] | None
) -> None:
    """Then with the camera turned by a quarter turn about its axis."""
    sensor, ids = view(**options), np.arange(7)
    assert sensor.in_view(ids, *AHEAD).tolist() == seen
    turned = (so3.exp(np.array([0.0, 0.0, 0.5 * np.pi])), *AHEAD[1:])
    assert sensor.in_view(ids, *turned).tolist() == (seen_when_turned or seen)


@pytest.mark.parametrize(
    ("incidence", "seen", "from_behind"),
    [(90, [0, 1, 2], [3, 4]), (85, [0, 1, 2], [3, 4]), (50, [0, 1], [4]), (30, [0], [4])],
)
def test_points_are_seen_from_their_side_only(
    incidence: float, seen: list[int], from_behind: list[int]
) -> None:
    """Normals at 0, 45, 80, 100 and 180 deg from the line to the camera; then the target is turned
    by half a turn about the axis across."""
    angles = np.radians([0, 45, 80, 100, 180])
    normals = np.column_stack([np.sin(angles), 0 * angles, -np.cos(angles)])
    sensor = StereoPointCartesian(
        points=np.zeros((5, 3)),
        sigma=np.full(3, 0.01),
        normals=3 * normals,
        incidence=np.radians(incidence),
    )
    ids = np.arange(5)
    assert sensor.in_view(ids, *AHEAD).tolist() == seen
    assert sensor.in_view(ids[::-1], *AHEAD).tolist() == seen[::-1]
    about = (AHEAD[0], so3.exp(np.array([0.0, np.pi, 0.0])), AHEAD[2])
    assert sensor.in_view(ids, *about).tolist() == from_behind


def test_every_point_of_a_body_is_seen_from_somewhere_and_hidden_from_elsewhere() -> None:
    """Of a cube's corners with outward normals, those in front are seen, whatever the attitude."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    sensor = StereoPointCartesian(points=corners, normals=corners, sigma=np.full(3, 0.01))
    rng = np.random.default_rng(5)
    for _ in range(20):
        R_ot = so3.exp(rng.normal(size=3) * 2)
        r_tc_o = np.array([0.0, 0.0, -1e6])  # so far that all lines are parallel
        seen = sensor.in_view(np.arange(8), np.eye(3), R_ot, r_tc_o)
        np.testing.assert_array_equal(seen, np.flatnonzero((corners @ R_ot.T)[:, 2] < -1e-5))
        assert len(seen) in (3, 4, 5)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"field_of_view": [1.0, 1.0, 1.0]}, "field_of_view: found .* expected one or two full"),
        ({"field_of_view": np.radians(361)}, "field_of_view: found .361.* expected one or two"),
        ({"range": [2.0, 1.0]}, "range: found .2.0, 1.0. m, expected the nearer end first"),
        ({"incidence": 1.6}, "incidence: found 91.67.* deg, expected at most 90 deg"),
        ({"normals": np.ones((4, 3))}, "normals: found 4 for 5 known points, expected one for"),
        ({"normals": np.diag([1.0] * 5)[:, :3]}, r"normals\[3\]: found length zero"),
        ({"points": "unknown", "normals": np.ones((5, 3))}, "normals: found 5 for 0 known points"),
        ({"points": "unknwon"}, "points: found 'unknwon', expected numbers in m or 'unknown'"),
    ],
)
def test_limits_that_cannot_be_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(stereo(), **options)


def test_an_unknown_map_offers_no_starts_and_nothing_to_simulate() -> None:
    sensor = replace(stereo(), points="unknown")
    assert not len(sensor.observables())
    known: dict[str, Array] = {"chaser_attitude": np.eye(3)}
    assert not list(sensor.starts(np.arange(3), np.ones((3, 4)), known))
    assert len(list(stereo().starts(np.arange(3), np.ones((3, 4)), known))) == 24


def test_one_camera_starts_from_known_points_about_where_it_is() -> None:
    """Its distance is told by their spread, within a factor of two from any side."""
    camera, rng, ids = mono(), np.random.default_rng(6), np.arange(5)
    for _ in range(20):
        r = np.array([0.0, 0.0, -rng.uniform(5, 40)])
        x = (np.eye(3), so3.exp(rng.normal(size=3)), r)
        starts = list(camera.starts(ids, camera.predict(ids, *x), {"chaser_attitude": np.eye(3)}))
        assert len(starts) == 24
        ratios = [np.linalg.norm(s["relative_position"]) / np.linalg.norm(r) for s in starts]
        assert 0.4 < np.median(ratios) < 2.5
    assert [b.name for b in Layout(camera.reads)][-1] == "relative_position"
