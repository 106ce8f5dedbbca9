"""The same quantities by this package and by independent software: the table of the documentation.

Each row is computed twice, by the code that the tests have (`tests/support/independent.py`), and
says how far both are apart, what the tests allow, and which version of what was compared with.

Run it in the sources, with the extra `dev`: ``python experiments/validation.py [--no-file]`` prints
the table and writes docs/explanation/validation_table.md. It ends with 1 where a tolerance is
missed.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "docs" / "explanation" / "validation_table.md"
for folder in ("experiments", "tests/support", "tests/manual"):
    sys.path.insert(0, str(ROOT / folder))

import by_brahe  # noqa: E402
import ccsds  # noqa: E402
import independent  # noqa: E402
import plain_physics  # noqa: E402
from benchmarks.others import scipy_solver  # noqa: E402
from benchmarks.passes import pass_of, problem_of  # noqa: E402

from relnav_graph import __version__  # noqa: E402
from relnav_graph.estimators import run_estimator  # noqa: E402
from relnav_graph.runs.graph import to_gtsam, to_track  # noqa: E402


@dataclass(frozen=True)
class Row:
    """What, against what, how far apart, what is allowed, and the unit of both."""

    what: str
    software: str
    found: float
    allowed: float
    unit: str

    @property
    def good(self) -> bool:
        """Whether the tolerance is kept; false of what is no number."""
        return self.found <= self.allowed

    def cells(self) -> list[str]:
        """Of the table."""
        unit = f" {self.unit}" if self.unit else ""
        found = "0" if self.found == 0 else f"{self.found:.1e}"
        return [self.what, self.software, f"{found}{unit}", f"{self.allowed:.0e}{unit}"]


def _by(distribution: str, name: str) -> str:
    return f"{name} {version(distribution)}"


def physics() -> Iterator[Row]:
    """Time, frames, gravity, propagation, attitude."""
    erfa, scipy = _by("pyerfa", "pyerfa"), _by("scipy", "SciPy")
    yield Row("TDB less TT", f"{erfa}, `dtdb`", independent.erfa_tdb_apart(), 1e-8, "s")
    apart = independent.erfa_frames_apart()
    yield Row("ITRF to GCRF, 7000 km from the centre", f"{erfa}, `c2t06a`", apart, 1e-7, "m")
    apart = independent.scipy_two_body_apart()
    what = "two-body motion over 5000 s, circular to hyperbolic, relative"
    yield Row(what, f"{scipy}, DOP853", apart, 2e-11, "")
    truth = plain_physics.scipy_truth_apart()
    for name, allowed, unit in (
        ("relative_position", 1e-6, "m"),
        ("relative_velocity", 1e-9, "m/s"),
        ("target_rate", 1e-11, "rad/s"),
        ("target_attitude", 1e-9, "rad"),
    ):
        what = f"simulated truth over 6000 s, {name.replace('_', ' ')}"
        yield Row(what, f"{scipy}, DOP853", truth[name], allowed, unit)
    apart = independent.scipy_attitude_apart()
    yield Row("Exp and Log, 1e-9 rad to near pi", f"{scipy}, `Rotation`", apart, 1e-12, "rad")


def orbits() -> Iterator[Row]:
    """Time, frames, gravity and orbits by a library for astrodynamics."""
    software = _by("brahe", "brahe")
    what = "UTC, TAI, GPS and TT across three leap seconds"
    yield Row(what, software, by_brahe.time_apart(), 1e-9, "s")
    position, velocity = by_brahe.frames_apart()
    what = "ITRF to GCRF, 7000 km from the centre; it has the time to 0.6 us"
    yield Row(what, software, position, 3e-4, "m")
    yield Row("the same, velocity", software, velocity, 3e-7, "m/s")
    apart = by_brahe.gravity_apart()
    yield Row("EGM2008 to degree and order 20 and 60", software, apart, 5e-14, "m/s^2")
    apart = by_brahe.third_bodies_apart()
    what = "pull of Sun and Moon over a month, low orbit; its series are shorter"
    yield Row(what, software, apart, 2e-9, "m/s^2")
    position, matrix = by_brahe.orbit_apart()
    what = "`orbit_two_body`, 20 x 20, a revolution in steps of 1 s"
    yield Row(what, software, position, 1e-5, "m")
    what = "its transition matrix, relative"
    yield Row(what, f"{software}, differences", matrix, 1e-8, "")


def filters() -> Iterator[Row]:
    """Kalman filter, smoother, unscented filter."""
    software = _by("filterpy", "FilterPy")
    forward, backward = independent.filterpy_kalman_apart()
    yield Row("`ekf` on a linear pass", f"{software}, `KalmanFilter`", forward, 1e-7, "sigma")
    yield Row("`rts` on a linear pass", f"{software}, `rts_smoother`", backward, 1e-7, "sigma")
    apart = max(independent.filterpy_ukf_apart())
    yield Row("`ukf` on a nonlinear pass", f"{software}, Merwe's points", apart, 1e-6, "sigma")


def optima(epochs: int) -> Iterator[Row]:
    """The optimum of zhang2015_close, from the smoothed filter or the prior."""
    problem = problem_of(epochs)
    one, batch, graph = pass_of(problem), run_estimator("batch", problem), to_gtsam(problem)
    there = to_track(problem, graph, independent.levenberg_marquardt(graph))
    software, apart = _by("gtsam", "GTSAM"), independent.far(there, batch)
    what = f"`batch` over {epochs} epochs, 20 states each"
    yield Row(what, f"{software}, Levenberg-Marquardt, QR", apart, 1e-6, "sigma")
    apart = independent.covariances_apart(there, batch)
    yield Row("its covariances, as of correlations", f"{software}, marginals", apart, 1e-6, "")
    ends = run_estimator("incremental", problem).smoothed
    assert ends is not None
    apart = independent.far(there, ends)
    method = f"{software}, Levenberg-Marquardt, QR"
    yield Row("what `incremental` ends with", method, apart, 1e-5, "sigma")
    software, apart = _by("scipy", "SciPy"), one.distance(scipy_solver(one)())
    yield Row(what, f"{software}, `least_squares`", apart, 1e-6, "sigma")


def files() -> Iterator[Row]:
    """What another reader of CCSDS messages finds in ours."""
    software = _by("ccsds-ndm-py", "ccsds-ndm-py")
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.oem"
        apart = independent.ccsds_oem_apart(ccsds.track(), ccsds.EPOCH, path)
        states, turns = by_brahe.messages_apart(ccsds.track(), ccsds.EPOCH, Path(folder))
    what = "OEM of ours across a leap second: epochs, axes and states"
    yield Row(what, software, apart, 2e-9, "m, m/s")
    software = _by("brahe", "brahe")
    yield Row(what, software, states, 2e-9, "m, m/s, s")
    what = "AEM of ours across it: epochs, axes and quaternions"
    yield Row(what, software, turns, 1e-15, "s")


def table(rows: list[Row]) -> str:
    """In Markdown."""
    header = ["what", "compared with", "apart", "allowed"]
    lines = [header, ["---"] * 4, *(row.cells() for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def main(epochs: int = 100, file: Path | None = TABLE) -> list[Row]:
    """Compute all rows, print them, and write them to a file. epochs: of the optima."""
    parts: list[Callable[[], Iterator[Row]]] = [physics, orbits, filters]
    parts += [lambda: optima(epochs), files]
    rows = [row for part in parts for row in part()]
    text = table(rows)
    print(text, end="")
    if file is not None:
        own = f"relnav-graph {__version__}, Python {sys.version.split()[0]}."
        file.write_text(f"{text}\n{own}\n", "utf-8")
    return rows


if __name__ == "__main__":
    sys.exit(not all(row.good for row in main(file=None if "--no-file" in sys.argv else TABLE)))
