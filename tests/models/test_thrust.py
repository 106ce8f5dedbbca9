"""Thrust as an input of the orbit processes: against orbits integrated by SciPy, with two craft in
an inertial frame and the thrust turning with the axes that it is given in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from passes import EXPERIMENTS
from relnav_factors.dynamics.eccentric_relative_motion import EccentricRelativeMotion
from relnav_factors.dynamics.orbit_two_body import OrbitTwoBody
from relnav_factors.dynamics.relative_two_body import RelativeTwoBody
from scipy.integrate import solve_ivp

from relnav_graph.arrays import Array
from relnav_graph.constants import MU_EARTH
from relnav_graph.core.epochs import process_inputs
from relnav_graph.core.manoeuvres import thrust_series
from relnav_graph.core.packing import held
from relnav_graph.errors import InputError
from relnav_graph.io.dataset import read_dataset, write_dataset
from relnav_graph.maths.orbit import KeplerOrbit, chief_motion, orbit_array
from relnav_graph.runs.comparison import compare
from relnav_graph.runs.passes import open_pass
from relnav_graph.scenario.build import load_scenario

ORBIT = KeplerOrbit(7.2e6, 0.05, 0.3)
START, END = 10.0, 55.0  # two burns, of which one goes on at the end
BURNS = np.array([20.0, 45.0]), np.array([35.0, 65.0])
DELTA_V = np.array([[0.3, -0.2, 0.1], [-0.4, 0.1, 0.6]])
MISSED = np.array([[4e-4, 1e-4, 0], [1e-4, 9e-4, -1e-4], [0, -1e-4, 2e-4]])
SERIES = thrust_series("thrust", *BURNS, DELTA_V, np.array([MISSED, 2 * MISSED]), 0.0, 100.0)
CHASER = np.array([7.0e6, -1.2e5, 3e5, 200.0, 7.1e3, 2.4e3])
RELATIVE = np.array([120.0, -340.0, 80.0, 0.02, -0.4, 0.1])


def thrust_at(t: float) -> Array:
    out = np.zeros(3)
    for begin, end, dv in zip(*BURNS, DELTA_V, strict=True):
        if begin <= t < end:
            out += dv / (end - begin)
    return out


def integrated(slope: Any, y: Array) -> Array:
    """By parts, so that no step runs over the edge of a burn."""
    for t0, t1 in ((10.0, 20.0), (20.0, 35.0), (35.0, 45.0), (45.0, 55.0)):
        a = thrust_at(0.5 * (t0 + t1))
        own = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-10}
        done: Any = solve_ivp(slope, (t0, t1), y, args=(a,), **own)  # type: ignore[call-overload]
        y = done.y[:, -1]
    return y


def pull(r: Array) -> Array:
    out: Array = -MU_EARTH * r / np.linalg.norm(r) ** 3
    return out


def inputs_of(process: Any) -> Array:
    return process_inputs(process, {"thrust": SERIES}, START, END)


def test_the_chasers_own_orbit() -> None:
    process = OrbitTwoBody(acceleration_density=1e-6, thrust=True, max_step=2.0)

    def slope(t: float, y: Array, a: Array) -> Array:
        return np.concatenate([y[3:], pull(y[:3]) + a])

    found = process.propagate(START, inputs_of(process), CHASER[:3], CHASER[3:])
    difference = np.concatenate(found) - integrated(slope, CHASER)
    assert np.abs(difference[:3]).max() < 1e-5
    assert np.abs(difference[3:]).max() < 1e-6


def test_relative_motion_in_inertial_axes() -> None:
    process = RelativeTwoBody(acceleration_density=1e-6, thrust=True)
    target = CHASER - RELATIVE

    def slope(t: float, y: Array, a: Array) -> Array:
        own = np.concatenate([y[3:6], pull(y[:3]) + a])
        return np.concatenate([own, y[9:], pull(y[6:9])])

    end = integrated(slope, np.concatenate([CHASER, target]))
    found = process.propagate(
        START, inputs_of(process), RELATIVE[:3], RELATIVE[3:], CHASER[:3], CHASER[3:]
    )
    difference = np.concatenate(found) - (end[:6] - end[6:])
    assert np.abs(difference).max() < 1e-6


@pytest.mark.parametrize(("gravity", "limit"), [("exact", 1e-6), ("linear", 1e-4)])
def test_relative_motion_in_axes_that_turn(gravity: Any, limit: float) -> None:
    """The thrust is constant in o: in inertial axes it turns with the orbit."""
    process = EccentricRelativeMotion(
        acceleration_density=1e-6, orbit=ORBIT, gravity=gravity, thrust=True
    )

    def axes(t: float) -> tuple[Array, Array, float]:
        radius, radial, anomaly, rate, _ = chief_motion(orbit_array(ORBIT), t)
        c, s = np.cos(anomaly), np.sin(anomaly)
        R_io = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        place = np.array([radius, 0.0, 0.0])
        return R_io, np.concatenate([R_io @ place, R_io @ [radial, radius * rate, 0.0]]), rate

    def slope(t: float, y: Array, a: Array) -> Array:
        return np.concatenate([y[3:], pull(y[:3]) + axes(t)[0] @ a])

    def inertial(t: float, x: Array) -> Array:
        R_io, target, rate = axes(t)
        turned = x[3:] + np.cross([0.0, 0.0, rate], x[:3])
        out: Array = target + np.concatenate([R_io @ x[:3], R_io @ turned])
        return out

    x = RELATIVE
    end = integrated(slope, inertial(START, x))
    found = process.propagate(START, inputs_of(process), x[:3], x[3:])
    difference = inertial(END, np.concatenate(found)) - end
    assert np.abs(difference).max() < limit


@pytest.mark.parametrize(
    "process",
    [
        OrbitTwoBody(acceleration_density=1e-9, thrust=True),
        RelativeTwoBody(acceleration_density=1e-9, thrust=True),
        EccentricRelativeMotion(acceleration_density=1e-9, orbit=ORBIT, thrust=True),
        EccentricRelativeMotion(
            acceleration_density=1e-9, orbit=ORBIT, gravity="linear", thrust=True
        ),
    ],
    ids=lambda p: f"{p.kind}-{getattr(p, 'gravity', '')}",
)
def test_jacobian_and_noise(process: Any) -> None:
    x = CHASER if isinstance(process, OrbitTwoBody) else RELATIVE
    x = np.concatenate([x, CHASER]) if isinstance(process, RelativeTwoBody) else x
    u = inputs_of(process)

    def after(x: Array) -> Array:
        out: Array = np.concatenate(process.propagate(START, u, *x.reshape(-1, 3)))
        return out

    _, F, Q = process.transition(START, u, *x.reshape(-1, 3))
    for j in range(len(x)):
        step = 1e-2 if j % 6 < 3 else 1e-3
        e = step * np.eye(len(x))[j]
        column = (after(x + e) - after(x - e)) / (2 * step)
        assert np.abs(F[:, j] - column).max() < 1e-5 * (1 + np.abs(column).max())
    # The whole first burn, and half of the second, whose covariance is twice the first one's.
    # In axes that turn, what it has missed has turned, too: by 0.04 rad.
    turned = 4e-5 if isinstance(process, EccentricRelativeMotion) else 2e-7
    assert Q[3:, 3:] == pytest.approx(2 * MISSED, rel=2e-3, abs=turned)
    assert np.linalg.eigvalsh(Q / np.sqrt(np.outer(np.diag(Q), np.diag(Q)))).min() > 0


def test_two_halves_are_a_whole() -> None:
    process = EccentricRelativeMotion(acceleration_density=1e-9, orbit=ORBIT, thrust=True)
    r, v = RELATIVE[:3], RELATIVE[3:]
    whole, F, Q = process.transition(START, inputs_of(process), r, v)
    u = [process_inputs(process, {"thrust": SERIES}, *part) for part in ((10, 27), (27, 55))]
    half, F_1, Q_1 = process.transition(START, u[0], r, v)
    end, F_2, Q_2 = process.transition(27.0, u[1], *half)
    assert np.concatenate(end) == pytest.approx(np.concatenate(whole), abs=1e-7)
    assert pytest.approx(F, rel=1e-6, abs=1e-9) == F_2 @ F_1
    assert pytest.approx(Q, rel=2e-2, abs=1e-6) == F_2 @ Q_1 @ F_2.T + Q_2


def test_a_prediction_holds_no_thrust() -> None:
    process = EccentricRelativeMotion(acceleration_density=1e-9, orbit=ORBIT, thrust=True)
    last = inputs_of(process)
    assert last[-1, 1:].any()  # a burn goes on
    assert held({"p": last}, {"p": process}, 30.0)["p"].tolist() == [[30.0, *[0.0] * 9]]


def table(folder: Path, text: str) -> Any:
    (folder / "thrust.csv").write_text(text, encoding="utf-8")
    (folder / "epochs.csv").write_text("t_s\n0\n10\n", encoding="utf-8")
    return read_dataset(folder, {}, {"thrust": columns()}, {}).inputs["thrust"]


def columns() -> tuple[str, ...]:
    process = EccentricRelativeMotion(acceleration_density=1e-9, orbit=ORBIT, thrust=True)
    return tuple(process.inputs["thrust"])


def test_tables_of_manoeuvres(tmp_path: Path) -> None:
    head = "dvx_m_s,dvy_m_s,dvz_m_s,"
    sigma = "sigma_x_m_s,sigma_y_m_s,sigma_z_m_s"
    P = "pxx_m2_s2,pxy_m2_s2,pxz_m2_s2,pyy_m2_s2,pyz_m2_s2,pzz_m2_s2"
    steps = table(tmp_path, f"t_s,{head}{sigma}\n3,1,2,3,0.1,0.2,0.3\n5,0,0,1,0,0,0\n")
    edges, values = steps.over(0.0, 10.0)
    gained = np.diff(edges)[:, None] * values
    assert gained.sum(axis=0) == pytest.approx([1, 2, 4, 0.01, 0, 0, 0.04, 0, 0.09], abs=1e-9)
    burns = table(
        tmp_path,
        f"t_start_s,t_end_s,{head}{P}\n2,4,1,2,3,0.04,0.01,0,0.09,0,0.01\n",
    )
    edges, values = burns.over(0.0, 3.0)
    gained = np.diff(edges)[:, None] * values
    assert gained.sum(axis=0) == pytest.approx([0.5, 1, 1.5, 0.02, 0.005, 0, 0.045, 0, 0.005])
    for text, words in (
        (f"t_s,{head}{sigma}\n3,1,2,3,0.1,-0.2,0.3\n", "line 2, column sigma_y_m_s"),
        (f"t_s,{head}\n3,1,2,3,\n", "column"),
        (f"t_start_s,t_end_s,{head}{P}\n4,2,1,2,3,1,0,0,1,0,1\n", "line 2: .*expected a later end"),
        (f"t_start_s,t_end_s,{head}{P}\n2,4,1,2,3,1,2,0,1,0,1\n", "line 2: .*no error has"),
        (
            f"t_start_s,t_end_s,{head}{P}\n2,4,1,2,3,1,0,0,1,0,1\n3,5,1,2,3,1,0,0,1,0,1\n",
            "line 3: .*to be over",
        ),
    ):
        with pytest.raises(InputError, match=words):
            table(tmp_path, text)


RENDEZVOUS = EXPERIMENTS / "rendezvous.toml"
SHORT = ["time.epochs=200"]


def test_burns_that_are_known_and_burns_that_are_not() -> None:
    kinds = ("iekf", "batch", "incremental")
    told = compare(load_scenario(RENDEZVOUS, SHORT), kinds)
    untold = compare(
        load_scenario(RENDEZVOUS, [*SHORT, "processes.relative_orbit.thrust=false"]), kinds
    )
    for name in kinds:
        assert told.track(name).status == "ok"
        assert told.summary["estimators"][name]["anees"] < 2.5
        assert untold.track(name).status == "degraded"
        assert "squared residuals" in untold.track(name).message


def test_a_recorded_pass_with_a_table_of_manoeuvres(tmp_path: Path) -> None:
    """Written as an input, and by hand as the table that a flight plan is."""
    scenario = load_scenario(RENDEZVOUS, [*SHORT, "estimators=['batch']"])
    opened = open_pass(scenario)
    models = scenario.sensors, scenario.input_columns, {b.name: b for b in scenario.layout}
    write_dataset(tmp_path / "pass", scenario.raw, opened.recording, *models)
    as_input = compare(scenario, data=tmp_path / "pass").track("batch")
    plan = scenario.inputs["thrust"]
    rows = [
        ",".join(repr(float(v)) for v in (t, *dv, *plan.sigma))
        for t, dv in zip(plan.times, plan.delta_v, strict=True)
    ]
    head = "t_s,dvx_m_s,dvy_m_s,dvz_m_s,sigma_x_m_s,sigma_y_m_s,sigma_z_m_s"
    (tmp_path / "pass" / "thrust.csv").write_text("\n".join([head, *rows, ""]), encoding="utf-8")
    (tmp_path / "pass" / "dataset.toml").unlink()
    by_table = compare(scenario, data=tmp_path / "pass").track("batch")
    assert by_table.x == pytest.approx(as_input.x, abs=1e-6)
    assert by_table.status == "ok"


def test_a_truth_that_flies_none_says_so() -> None:
    scenario = load_scenario(
        EXPERIMENTS / "xiong2013.toml",
        [
            "time.epochs=5",
            'inputs.thrust={kind="manoeuvres", times=[2.0], delta_v=[[1.0,0.0,0.0]], sigma=0.1}',
        ],
    )
    with pytest.raises(InputError, match=r"inputs.thrust: found manoeuvres.*inertial_pair"):
        scenario.simulate(0)
