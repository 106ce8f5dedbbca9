"""What a study of yang2016 found of the accelerometer's bias, beside what the paper says.

Its claim: the relative navigation finds the *constant* bias better than the absolute one. Errors
are judged against the constant, and against what there really is, the constant and what drifts
about it; per axis, root mean square over axes and runs, at the end of the scored part. Besides,
the satellites in view over the pass (figure 4 of the paper).

Run it: ``relnav study experiments/yang2016.toml --runs 20 -e ekf_without_drift -e ekf -e rts -o
OUT``, then ``python experiments/yang2016_claims.py OUT [FIGURE.png]``
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from relnav_graph.arrays import Array
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.sim.sensors import measure_all
from relnav_graph.study.collect import RowRuns, collect
from relnav_graph.study.folder import StudyFolder

#: Yang et al. 2016, table 1: the last epoch of one run, m/s^2, of the relative navigation.
PRINTED = (1.091e-5, 1.177e-5, -3.990e-5)
NAVIGATIONS = {"relative": "accelerometer_bias", "absolute": "absolute_accelerometer_bias"}
AXES = 3**0.5


def last(row: RowRuns, state: str, constant: bool) -> tuple[float, float]:
    """Error and own sigma of a bias per axis, m/s^2; constant: as it stands in the table of
    constants."""
    of = row.of_static if constant else row.of
    error = of(state, "rmse" if constant else "rmse_last")
    sigma = of(state, "sigma")
    rms = [float(np.sqrt(np.nanmean(v**2))) / AXES for v in (error, sigma)]
    return rms[0], rms[1]


def biases(folder: StudyFolder) -> dict[str, dict[str, tuple[float, float, float]]]:
    """By estimator and navigation: error against the constant, the estimator's own sigma of it,
    error against constant and drift."""
    found: dict[str, dict[str, tuple[float, float, float]]] = {}
    for name, row in collect(folder.records(folder.runs())).rows.items():
        found[name] = {}
        for navigation, bias in NAVIGATIONS.items():
            error, sigma = last(row, bias, True)
            found[name][navigation] = error, sigma, last(row, f"whole_{bias}", False)[0]
    return found


def in_view(scenario: Scenario) -> tuple[Array, Array]:
    """Times (N,), s, and how many satellites are heard then (N,), without thrust: the orbit is the
    same within 50 km."""
    quiet = {name: s for name, s in scenario.true_sensors.items() if name == "gps"}
    truth = scenario.truth.simulate(scenario.times, np.random.default_rng(0))
    found = measure_all(quiet, scenario.timings, truth, 0)
    return np.array([m.t for m in found]), np.array([len(m.ids) for m in found])


def draw(t: Array, count: Array, path: Path) -> None:
    """Figure 4: satellites in view."""
    with matplotlib.rc_context({"figure.figsize": (7, 3)}):
        figure = Figure(layout="constrained")
        axes = figure.add_subplot()
        axes.step(t, count, where="post")
        axes.set_xlabel("t, s")
        axes.set_ylabel("GPS satellites in view")
        axes.set_ylim(bottom=0)
        figure.savefig(path)


def main(
    out: Path, picture: Path | None = None
) -> dict[str, dict[str, tuple[float, float, float]]]:
    """Print the tables; gives `biases`."""
    folder = StudyFolder.open(out)
    found = biases(folder)
    print(f"Accelerometer bias of {len(list(folder.runs()))} runs, m/s^2 per axis;", end=" ")
    print(f"printed, of one run: {', '.join(f'{abs(p):.2g}' for p in PRINTED)}\n")
    print("| estimator | navigation | error of the constant | its own sigma | error of the whole |")
    print("| --- | --- | --- | --- | --- |")
    for name, row in found.items():
        for navigation, numbers in row.items():
            print(f"| `{name}` | {navigation} | {' | '.join(f'{n:.3g}' for n in numbers)} |")
    for k, against in ((0, "the constant"), (2, "constant and drift")):
        ratios = [
            f"{name} {row['absolute'][k] / row['relative'][k]:.2f}" for name, row in found.items()
        ]
        print(f"\nAgainst {against}, absolute over relative: {', '.join(ratios)}")
    t, count = in_view(
        load_scenario(
            Path(__file__).parent / "yang2016.toml",
            ["time.step='30 s'", "time.epochs=361", "sensors.earth_sensor.period='30 s'"],
        )
    )
    print(f"\nSatellites in view: {count.min()} to {count.max()}, {count.mean():.1f} on average")
    if picture is not None:
        draw(t, count, picture)
        print(f"written: {picture}")
    return found


if __name__ == "__main__":
    main(*(Path(text) for text in sys.argv[1:3]))
