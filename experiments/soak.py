"""Many steps of an estimator online: latencies, status and memory, at the start and later.

    python experiments/soak.py --steps 1000000

By default the fixed-lag smoother on zhang2015_close, 1 Hz, with a window of 30 s. What is
true goes on for ever here: the scenario's own models, from the prior's mean, without process
noise; only the cost of the steps is of interest. Each line is of the newest 1000 steps. The
processor's time of this thread stands beside the time on the clock, which other programs
stretch.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from relnav_graph.core.epochs import Epoch
from relnav_graph.core.measurement import Measurement
from relnav_graph.core.problem import Problem
from relnav_graph.errors import GeometryError
from relnav_graph.estimators.online.driver import online
from relnav_graph.linear.assembly import Assembly
from relnav_graph.scenario.build import load_scenario

SCENARIO = Path(__file__).parent / "zhang2015_close.toml"


def resident() -> float:
    """Memory of this process, MB (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def endless(problem: Problem, seed: int = 0) -> Iterator[Epoch]:
    """Epochs at the spacing and with the inputs of the problem's second one."""
    layout, x, rng = problem.layout, problem.prior.x, np.random.default_rng(seed)
    models = Assembly(layout, problem.processes, problem.sensors, [])
    t, spacing = problem.epochs[0].t, problem.epochs[1].t - problem.epochs[0].t
    inputs = dict[str, np.ndarray]()
    while True:
        measurements = []
        for name, sensor in problem.sensors.items():
            ids = sensor.observables()
            try:
                z = sensor.predict(ids, *(layout.value(x, b.name) for b in sensor.reads))
            except GeometryError:  # not seen
                continue
            R = sensor.noise(Measurement(name, t, z, ids))
            e = np.einsum("kij,kj->ki", np.linalg.cholesky(R), rng.standard_normal(R.shape[:2]))
            measurements.append(Measurement(name, t, sensor.perturb(z, e), ids))
        yield Epoch(t, tuple(measurements), inputs)
        inputs = dict(problem.epochs[1].inputs)
        ahead = Epoch(t + spacing, (), inputs)
        x = models.again(ahead, t).transition(x[None])[0][0]
        t += spacing


def main() -> None:
    """Run, and print a line at each power of ten and at the end."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--scenario", type=Path, default=SCENARIO)
    parser.add_argument("--estimator", default="fixed_lag")
    parser.add_argument("--window", default="30 s")
    options = parser.parse_args()
    settings = ["time.epochs=2", f'online.window="{options.window}"']
    scenario = load_scenario(options.scenario, settings)
    problem = scenario.problem(scenario.simulate(0), 0)
    one = online(options.estimator, replace(problem, epochs=()))
    recent, marks = np.zeros((2, 1000)), {10**k for k in range(3, 9)} | {200_000, options.steps}
    columns = "median     p99     max"
    print(f"     step   CPU, ms: {columns}   clock, ms: {columns}   resident MB  status")
    with threadpool_limits(1, "blas"):
        for k, epoch in zip(range(1, options.steps + 1), endless(problem), strict=False):
            begun = time.thread_time(), time.perf_counter()
            found = one.step(epoch)
            ended = time.thread_time(), time.perf_counter()
            recent[:, k % 1000] = 1e3 * np.subtract(ended, begun)
            if k in marks:
                last = recent[:, 1:k] if k < 1000 else recent
                cpu, clock = (
                    f"{np.median(v):17.3f} {np.percentile(v, 99):7.3f} {v.max():7.3f}" for v in last
                )
                print(f"{k:9d} {cpu}  {clock} {resident():13.1f}  {found.status}", flush=True)
    print(one.totals)


if __name__ == "__main__":
    main()
