"""Start-up, the first compilation, studies, and the memory of a million epochs: each in a
process of its own."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from relnav_graph.core.models import derived_quantities
from relnav_graph.estimators import run_estimator
from relnav_graph.scoring.metrics import score

from .passes import scenario_of, seconds

FOLDER = Path(__file__).parents[1]


def _processor_time(arguments: list[str]) -> float:
    """Of a process and its children, s: what it takes on a quiet machine."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(arguments, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _relnav(*arguments: str) -> list[str]:
    program = "import sys; from relnav_graph.cli.main import main; main(sys.argv[1:])"
    return [sys.executable, "-c", program, *arguments]


def help_time() -> float:
    """``relnav --help``, s of processor time."""
    return float(np.median([_processor_time(_relnav("--help")) for _ in range(5)]))


def compare_times() -> tuple[float, float]:
    """The first ``relnav compare`` ever, less a later one, and that one, s on the clock: the
    cores share the first one's work."""
    command = _relnav("compare", str(FOLDER / "zhang2015.toml"), "--set", "time.epochs=5")
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "RELNAV_CACHE_DIR": cache}

        def run() -> None:
            subprocess.run(command, env=environment, check=True, capture_output=True)

        cold, warm = seconds(run), min(seconds(run) for _ in range(3))
    return cold - warm, warm


def studies_per_second(epochs: int = 600) -> float:
    """Runs of a study per second and worker: simulate, filter, smooth, score."""
    scenario = scenario_of(epochs)
    derived = derived_quantities(scenario.layout)

    def run() -> None:
        recording = scenario.simulate(0)
        problem = scenario.problem(recording, 0)
        for kind in ("iekf", "rts", "batch"):
            score(run_estimator(kind, problem), recording.truth, derived)

    return 1 / min(seconds(run) for _ in range(3))


def million_epochs(epochs: int = 1_000_000) -> float:
    """Peak memory of smoothing so many, GiB; all covariances computed, none kept."""
    program = (
        "import resource, sys; sys.path.insert(0, sys.argv[1])\n"
        "from benchmarks.passes import lazy_pass\n"
        "from relnav_graph.estimators.long_pass import smooth_long_pass\n"
        "epochs = int(sys.argv[2])\n"
        "seen = sum(len(t.t) for t in smooth_long_pass(*lazy_pass(epochs)))\n"
        "assert seen == epochs, seen\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
    )
    arguments = [sys.executable, "-c", program, str(FOLDER), str(epochs)]
    done = subprocess.run(arguments, check=True, capture_output=True, text=True)
    unit = 1 if sys.platform == "darwin" else 1024
    return int(done.stdout) * unit / 2**30
