"""Published claims beside the bound, the filter and the smoother: xiong2013 and hu2019.

Monte Carlo over seeded runs. RMSE are norms over the axes, over the pass and all runs; a
claim of the papers is read as one per axis and stated times sqrt(3). The bound is that of
the information recursion at the true states, for the filter and for the smoother.

Run it: ``python experiments/published_claims.py [RUNS] [EPOCHS]``
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from relnav_graph.scenario.build import load_scenario
from relnav_graph.study.conduct import do_runs, study_summary
from relnav_graph.study.folder import StudyFolder
from relnav_graph.study.runs import StudySpec

HERE = Path(__file__).parent
#: Per axis, in table units: Xiong et al. 2013, section 3 and figures 3 to 6.
XIONG = {
    "relative_position": 0.05,
    "relative_attitude": 0.5,
    "chaser_position": 2.5,
    "chaser_attitude": 0.05,
}
#: The published predictions of Hu et al. 2019, and a proper integrator.
HU = {
    "one Euler step": ('processes.target.integrator="euler"', 'processes.target.max_step="1 s"'),
    "five Euler steps": (
        'processes.target.integrator="euler"',
        'processes.target.max_step="0.2 s"',
    ),
    "Runge-Kutta": (),
}


def study(name: str, runs: int, kinds: Sequence[str], settings: Sequence[str]) -> dict[str, Any]:
    """The summary of a study; its estimators by name."""
    scenario = load_scenario(HERE / f"{name}.toml", settings)
    spec = StudySpec.of(scenario, None, tuple(kinds))
    with tempfile.TemporaryDirectory(prefix="relnav-claims-") as place:
        folder = StudyFolder(Path(place), spec)
        lost = do_runs(folder, range(runs))
        rows: dict[str, Any] = study_summary(folder, range(runs), lost)[0]["estimators"]
    return rows


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table in Markdown."""
    for cells in (header, ["---"] * len(header), *rows):
        print(f"| {' | '.join(cells)} |")


def xiong(name: str, runs: int, settings: Sequence[str]) -> dict[str, Any]:
    """Print the table of one variant; gives the estimators of its study."""
    found = study(name, runs, ("ekf", "batch"), settings)
    rows = []
    for state, claim in XIONG.items():
        ekf, batch = (found[kind]["states"][state] for kind in ("ekf", "batch"))
        numbers = claim * 3**0.5, ekf["bound"], ekf["rmse"], batch["bound"], batch["rmse"]
        label = f"{state.replace('_', ' ')}, {ekf['unit']}"
        rows.append([label, *(f"{number:.3g}" for number in numbers)])
    print(f"\n{name}, {runs} runs; ANEES: ", end="")
    print(", ".join(f"{kind} {found[kind]['anees']:.2f}" for kind in ("ekf", "batch")) + "\n")
    table(["", "claim", "bound, filter", "`ekf`", "bound, smoother", "`batch`"], rows)
    return found


def hu(runs: int, settings: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Print the table of the integrators; gives each one's rows."""
    states = "target_attitude", "target_rate", "inertia_ratios"
    found, rows = {}, []
    for label, integrator in HU.items():
        found[label] = study("hu2019", runs, ("ekf", "batch"), [*integrator, *settings])
        for kind in ("ekf", "batch"):
            row = found[label][kind]
            last = [f"{row['states'][state]['rmse_last']:.3g}" for state in states]
            rows.append([label, f"`{kind}`", *last, f"{row['anees']:.2f}"])
    print(f"\nhu2019, {runs} runs, at the last epoch\n")
    headings = "attitude, deg", "rate, deg/s", "five ratios", "ANEES, whole pass"
    table(["prediction", "", *headings], rows)
    return found


def main(runs: int = 30, epochs: int | None = None) -> dict[str, dict[str, Any]]:
    """Print all tables; gives the estimators of every study by its name."""
    settings = [] if epochs is None else [f"time.epochs={epochs}"]
    found = {name: xiong(name, runs, settings) for name in ("xiong2013", "xiong2013_0p1m")}
    return found | hu(runs, settings)


if __name__ == "__main__":
    main(*(int(text) for text in sys.argv[1:3]))
