"""The same quantities by this package and by independent software: the table of the documentation.

Each row is computed twice, by the code that the tests have (`tests/support/independent.py`,
`against_brahe.py`, `plain_physics.py`), and says how far both are apart, what the tests allow, and
which version of what was compared with.

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

import against_brahe  # noqa: E402
import ccsds  # noqa: E402
import independent  # noqa: E402
import plain_physics  # noqa: E402
from benchmarks.others import scipy_solver  # noqa: E402
from benchmarks.passes import pass_of, problem_of  # noqa: E402
from passes import toy_measurements, toy_problem  # noqa: E402

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
        allowed = "0" if self.allowed == 0 else f"{self.allowed:.0e}"
        return [self.what, self.software, f"{found}{unit}", f"{allowed}{unit}"]


def _by(distribution: str, name: str) -> str:
    return f"{name} {version(distribution)}"


def time_and_frames() -> Iterator[Row]:
    """Time scales, axes, and where Sun and Moon are."""
    erfa, brahe = _by("pyerfa", "pyerfa"), _by("brahe", "brahe")
    what = "UTC, TAI, GPS, TT, each from each, about all leap seconds since 1973"
    yield Row(what, f"{brahe}, `Epoch`", against_brahe.time_apart(), 1e-9, "s")
    yield Row("TDB", f"{brahe}, series of two terms", against_brahe.tdb_apart(), 5e-5, "s")
    yield Row("TDB less TT", f"{erfa}, `dtdb`", independent.erfa_tdb_apart(), 1e-8, "s")
    apart = independent.erfa_frames_apart()
    yield Row("ITRF to GCRF, 7000 km from the centre", f"{erfa}, `c2t06a`", apart, 1e-7, "m")
    position, velocity = against_brahe.frames_apart()
    what = "ITRF to GCRF and back, with and without UT1 and pole"
    yield Row(f"{what}: position", brahe, position, 1e-7, "m")
    yield Row(f"{what}: velocity", brahe, velocity, 1e-10, "m/s")
    what = "EME2000 to GCRF, 7000 km from the centre"
    yield Row(what, f"{brahe}, bias of second order", against_brahe.eme2000_apart(), 2e-5, "m")
    for name, apart in against_brahe.bodies_apart().items():
        what = f"where the {name.title()} is over two years, of its distance"
        yield Row(what, f"{brahe}, short series, to arcminutes", apart, 2e-3, "")


def gravity() -> Iterator[Row]:
    """The field, and what pulls besides."""
    brahe = _by("brahe", "brahe")
    what = "EGM2008: coefficients to degree 60, GM, radius"
    yield Row(what, f"{brahe}, its file", against_brahe.coefficients_apart(), 0.0, "")
    for degree in (20, 60):
        what = f"EGM2008 to degree and order {degree}, poles and equator, 6500 to 37000 km"
        yield Row(what, f"{brahe}, Clenshaw", against_brahe.gravity_apart(degree), 5e-14, "m/s^2")
    what = "pull of Sun and Moon, from the same places of them"
    yield Row(what, brahe, against_brahe.tides_apart(), 2e-11, "m/s^2")


def motion() -> Iterator[Row]:
    """Orbits, tumbling, attitude."""
    scipy, brahe = _by("scipy", "SciPy"), _by("brahe", "brahe")
    apart = independent.scipy_two_body_apart()
    what = "two-body motion over 5000 s, circular to hyperbolic, relative"
    yield Row(what, f"{scipy}, DOP853", apart, 2e-11, "")
    orbits = against_brahe.orbits_apart()
    software, field = f"{brahe}, RKN12(10)", "6000 s, 20x20, Sun and Moon"
    for what, name, allowed, unit in (
        ("`orbit_two_body`", "position", 1e-4, "m"),
        ("`orbit_two_body`", "velocity", 1e-7, "m/s"),
        ("`relative_two_body`", "relative position", 1e-5, "m"),
        ("`relative_two_body`", "relative velocity", 1e-8, "m/s"),
        ("simulated truth", "true position", 1e-4, "m"),
    ):
        what = f"{what} over {field}: {name.removeprefix('true ')}"
        yield Row(what, software, orbits[name], allowed, unit)
    other, what = against_brahe.orbits_apart("own"), f"`orbit_two_body` over {field}: position"
    yield Row(what, f"{brahe}, its own Sun and Moon", other["position"], 2e-2, "m")
    apart = against_brahe.transition_apart()
    what = "its transition matrix over 6000 s, 20x20, relative"
    yield Row(what, f"{brahe}, differences of orbits", apart, 1e-8, "")
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


def filters() -> Iterator[Row]:
    """Kalman filter, smoother, unscented filter."""
    software = _by("filterpy", "FilterPy")
    forward, backward = independent.filterpy_kalman_apart()
    yield Row("`ekf` on a linear pass", f"{software}, `KalmanFilter`", forward, 1e-7, "sigma")
    yield Row("`rts` on a linear pass", f"{software}, `rts_smoother`", backward, 1e-7, "sigma")
    apart = max(independent.filterpy_ukf_apart())
    yield Row("`ukf` on a nonlinear pass", f"{software}, Merwe's points", apart, 1e-6, "sigma")


def optima(epochs: int) -> Iterator[Row]:
    """The optimum of zhang2015_close, from the smoothed filter or the prior; covariances."""
    problem = problem_of(epochs)
    one, batch, graph = pass_of(problem), run_estimator("batch", problem), to_gtsam(problem)
    values = independent.levenberg_marquardt(graph)
    there, online = to_track(problem, graph, values), run_estimator("incremental", problem)
    gtsam, apart = _by("gtsam", "GTSAM"), independent.far(there, batch)
    what = f"`batch` over {epochs} epochs, 20 states each"
    yield Row(what, f"{gtsam}, Levenberg-Marquardt, QR", apart, 1e-6, "sigma")
    software, apart = _by("scipy", "SciPy"), one.distance(scipy_solver(one)())
    yield Row(what, f"{software}, `least_squares`", apart, 1e-6, "sigma")
    software, apart = f"{gtsam}, Levenberg-Marquardt, QR", independent.at_the_end(online, there)
    yield Row(f"`incremental` at the last of {epochs} epochs", software, apart, 5e-2, "sigma")
    apart = independent.dense_covariances_apart(graph, values, batch)
    software = f"{gtsam}, Jacobian; {_by('numpy', 'NumPy')}, dense QR"
    yield Row(f"covariances of `batch` at {epochs} epochs", software, apart, 1e-6, "sigma^2")
    apart = independent.marginals_apart(toy_problem(toy_measurements()))
    what = "covariances of `batch` at 30 epochs, 7 states each"
    yield Row(what, f"{gtsam}, `Marginals`", apart, 1e-9, "sigma^2")


def files() -> Iterator[Row]:
    """What another reader of CCSDS messages finds in ours."""
    software = _by("ccsds-ndm-py", "ccsds-ndm-py")
    with TemporaryDirectory() as folder:
        given = ccsds.track(), ccsds.EPOCH
        oem = independent.ccsds_oem_apart(*given, Path(folder) / "a.oem")
        aem = independent.ccsds_aem_apart(*given, Path(folder) / "a.aem")
    what = "OEM of ours across a leap second: epochs, axes and states"
    yield Row(what, software, oem, 2e-9, "m, m/s")
    what = "AEM of ours across a leap second: epochs, axes and attitudes"
    yield Row(what, software, aem, 1e-14, "rad")


def table(rows: list[Row]) -> str:
    """In Markdown."""
    header = ["what", "compared with", "apart", "allowed"]
    lines = [header, ["---"] * 4, *(row.cells() for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def main(epochs: int = 100, file: Path | None = TABLE) -> list[Row]:
    """Compute all rows, print them, and write them to a file. epochs: of the optima."""
    groups: list[Callable[[], Iterator[Row]]] = [
        *(time_and_frames, gravity, motion, filters),
        *(lambda: optima(epochs), files),
    ]
    rows = [row for group in groups for row in group()]
    text = table(rows)
    print(text, end="")
    if file is not None:
        own = f"relnav-graph {__version__}, Python {sys.version.split()[0]}."
        file.write_text(f"{text}\n{own}\n", "utf-8")
    return rows


if __name__ == "__main__":
    sys.exit(not all(row.good for row in main(file=None if "--no-file" in sys.argv else TABLE)))
