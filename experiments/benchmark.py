"""What the estimators cost, side by side in one run, on one problem and one thread.

Ratios are medians of pairs taken in turn; a row counts only when its solver came to the same
optimum, to 1e-6 of a sigma (FilterPy's and our filter's rows do not claim to).

Run it: ``python experiments/benchmark.py [--quick] [--json] [-o FIGURE]``, with the extra
`benchmark` installed. --quick leaves out the million epochs, `fixed_lag` and the general
solvers.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click
import numpy as np
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).parent))
from benchmarks import batch, border, online, others, start
from benchmarks.passes import first, pass_of, problem_of

LENGTHS = (1_000, 10_000, 100_000)
Rows = tuple[dict[str, Any], dict[int, float]]


def say(text: str) -> None:
    """A line of progress."""
    click.echo(text, err=True)


def measure_batch(problem: Any, lengths: tuple[int, ...], lm: int, quick: bool) -> Rows:
    """The rows of batch, and the time of an iteration per epoch by length."""
    passes = [pass_of(first(problem, length)) for length in lengths]
    floors, took = batch.over_floor(passes)
    floor, each = np.median(floors, axis=0), np.median(took, axis=0)
    longer = np.median(took / took[:, :1], axis=0)
    for length, ratio, time in zip(lengths, floor, each, strict=True):
        say(
            f"batch, {length} epochs: a full iteration {1e6 * time:.0f} us per epoch, {ratio:.2f}"
            " times LAPACK's banded Cholesky"
        )
    over_ekf = batch.over_ekf(passes[0])
    say(f"batch, {lengths[0]} epochs, all covariances: {over_ekf:.1f} times our EKF's pass")
    own_rows = batch.over_own_rows(passes[0])
    say(f"batch, {lengths[0]} epochs: GTSAM eliminates our rows in {own_rows:.1f} times our time")
    del passes
    faster: dict[str, float | None] = dict.fromkeys(
        ("gtsam_lm", "scipy_least_squares", "pyceres", "filterpy_rts")
    )
    p = pass_of(first(problem, lm))
    faster["gtsam_lm"] = batch.faster_than_gtsam(p)
    say(f"batch, {lm} epochs: faster than GTSAM's optimiser by {faster['gtsam_lm']}")
    if not quick:
        p = pass_of(first(problem, min(lm, 300)))
        for name, compare in (
            ("scipy_least_squares", others.faster_than_scipy),
            ("pyceres", others.faster_than_pyceres),
            ("filterpy_rts", others.faster_than_filterpy),
        ):
            faster[name], far = compare(p)
            say(f"{name} ends {far:.2g} sigma from the optimum")
        say(f"batch, {len(p.start)} epochs: faster than others by {faster}")
    rows = {
        "floor_ratio": float(floor[len(lengths) // 2]),
        "flatness": float(longer.max() / longer.min()),
        "over_ekf": over_ekf,
        "gtsam_own_rows": own_rows,
        "faster_than": faster,
        "million_epochs_gib": None if quick else start.million_epochs(),
    }
    return rows, dict(zip(lengths, each.tolist(), strict=True))


def measure_incremental(problem: Any, length: int, at: int) -> tuple[dict[str, Any], Any]:
    """The rows of incremental, and the time of each step."""
    own = first(problem, length)
    took, growth, last = online.run(online.incremental, own)
    rows = {
        "growth": growth,
        "faster_than_naive": online.faster_than_naive(pass_of(first(problem, at + 20)), at),
        "sigma_from_batch": online.sigma_from_batch(pass_of(own), last),
    }
    say(f"incremental, {length} epochs: {1e3 * np.median(took):.2f} ms per step; {rows}")
    return rows, took


def measure_fixed_lag(problem: Any) -> tuple[dict[str, float], Any]:
    """The rows of fixed_lag, and the time of each step."""
    took, growth, _ = online.run(online.fixed_lag, problem)
    rows = {"growth": growth, "p99_over_median": online.tail(took)}
    say(f"fixed_lag, {len(took)} epochs: {1e3 * np.median(took):.2f} ms per step; {rows}")
    return rows, took


def measure_online(problem: Any) -> dict[str, dict[str, float]]:
    """What each online estimator costs, and how far it ends from batch, in one table."""
    found = online.side_by_side(pass_of(problem))
    say(f"online, {len(problem.epochs)} epochs:  first tenth, last tenth, longest, ms; whole, s;")
    say("  sigmas from batch at the last epoch")
    for name, row in found.items():
        say(f"  {name:18}" + "".join(f"{value:11.3g}" for value in row.values()))
    return found


def draw(path: Path, per_epoch: dict[int, float], steps: dict[str, Any]) -> None:
    """Cost against length, both axes logarithmic. steps: times of each step by estimator."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    for name, took in steps.items():
        epochs = np.unique(np.geomspace(10, len(took), 60).astype(int))
        around = [1e6 * online.around(took, k) for k in epochs]
        axes.loglog(epochs, around, label=f"{name}: one step, median of 200")
    times = [1e6 * t for t in per_epoch.values()]
    axes.loglog(list(per_epoch), times, "o-", label="batch: one iteration, per epoch")
    axes.set_ylim(10, None)
    axes.set_xlabel("length of the pass, epochs")
    axes.set_ylabel("time, us")
    axes.grid(which="major", alpha=0.4)
    axes.grid(which="minor", alpha=0.15)
    axes.legend()
    figure.savefig(path, dpi=150)


def main(
    quick: bool = False,
    figure: Path | None = None,
    lengths: tuple[int, ...] = LENGTHS,
    lm: int = 2_000,
    steps: int = 20_000,
    naive: int = 2_000,
    side: int = 1_000,
    cold: bool = True,
    mapped: tuple[int, int, int] = (600, 1_000, 5_000),
    points: tuple[int, ...] = (20, 50, 130),
) -> dict[str, Any]:
    """All rows; the sizes are those of the published figures unless given."""
    with threadpool_limits(1, "blas"):
        say(f"simulating {max(*lengths, steps)} epochs of zhang2015_close ...")
        problem = problem_of(max(*lengths, steps, lm, naive + 20))
        rows, per_epoch = measure_batch(problem, lengths, lm, quick)
        incremental, took = measure_incremental(problem, steps, naive)
        table = measure_online(first(problem, side))
        border_rows = border.measure(say, points, mapped, 0 if quick else 3_000)
        fixed_lag: dict[str, Any] = {"growth": None, "p99_over_median": None}
        each = {"incremental": took}
        if not quick:
            fixed_lag, each["fixed_lag"] = measure_fixed_lag(first(problem, steps))
        say(f"studies: {start.studies_per_second(min(600, lm)):.2f} runs per second and worker")
        first_compile, warm = start.compare_times() if cold else (None, None)
        say(f"relnav compare: compiles for {first_compile} s once; then {warm} s in all")
    if figure is not None:
        draw(figure, per_epoch, each)
    return {
        "batch": rows,
        "incremental": incremental,
        "fixed_lag": fixed_lag,
        "online": table,
        "statics": border_rows,
        "start": {"help_s": start.help_time(), "first_compile_s": first_compile},
    }


@click.command()
@click.option("--quick", is_flag=True, help="Leave out the long and the foreign rows.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@click.option("-o", "figure", type=click.Path(path_type=Path), help="Figure to draw.")
def command(quick: bool, as_json: bool, figure: Path | None) -> None:
    """Measure what the estimators cost."""
    found = main(quick, figure)
    click.echo(json.dumps(found, indent=None if as_json else 2))


if __name__ == "__main__":
    command()
