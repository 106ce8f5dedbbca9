"""Numbers of a summary as tables of text, with units, to three or four digits."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from relnav_graph.report.contents import WorstRun
from relnav_graph.report.figures import KINDS, plain
from relnav_graph.scoring.noise_verdict import noise_said
from relnav_graph.scoring.text import ALIGNMENT
from relnav_graph.scoring.told import value_text

__all__ = ["Cell", "Table", "number"]


@dataclass(frozen=True)
class Cell:
    """Text, and a word on what it says: good, bad, strong, code, or nothing."""

    text: str
    mark: str = ""


@dataclass(frozen=True)
class Table:
    """head and rows; the first `words` columns are text, the others numbers. A row of one
    cell is the heading of those below it."""

    head: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    words: int = 1


def number(value: float | None, digits: int = 4) -> str:
    """A number with so many significant digits, a dash where there is none."""
    if value is None:
        return "–"
    text = f"{value:.{digits}g}"
    if "e" in text:
        mantissa, _, exponent = text.partition("e")
        text = f"{mantissa}·10" + str(int(exponent)).translate(_RAISED)
    return text.replace("-", "−")


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def _interval(band: Sequence[float] | None, digits: int = 3) -> str:
    return "–" if band is None else f"{number(band[0], digits)} to {number(band[1], digits)}"


def _percent(value: float | None, digits: int = 1) -> str:
    return "–" if value is None else f"{100 * value:.{digits}f} %".replace("-", "−")


def _percents(band: Sequence[float] | None) -> str:
    return "–" if band is None else f"{_percent(band[0])} to {_percent(band[1])}"


def _unit(state: str, unit: str) -> str:
    return plain(state) + ("" if unit == "1" else f" [{unit}]")


def _cells(texts: Iterable[Any]) -> list[Cell]:
    return [t if isinstance(t, Cell) else Cell(str(t)) for t in texts]


def _inside(value: float | None, band: Sequence[float] | None, digits: int = 3) -> Cell:
    """A mean normalised square, marked good inside its band and bad outside."""
    if value is None or band is None:
        return Cell(number(value, digits))
    return Cell(number(value, digits), "good" if band[0] <= value <= band[1] else "bad")


def overview(summary: Mapping[str, Any]) -> Table:
    """A row per estimator: kind, status, cost, joint ANEES."""
    head = ["row", "kind", "status", "runs", "run time [s]", "step, median [ms]",
            "ANEES", "95 % band", "apart [sigma]", "rejected"]  # fmt: skip
    rows = []
    for name, row in summary["estimators"].items():
        status = Cell(row["status"], "good" if row["status"] == "ok" else "bad")
        rejected = ", ".join(f"{s} {n}" for s, n in row["rejected"].items() if n) or "–"
        rows.append(
            _cells(
                [
                    Cell(name, "strong"),
                    row["kind"],
                    status,
                    row.get("runs", 1),
                    number(row["runtime_s"], 3),
                    number(row.get("step_ms", {}).get("median"), 3),
                    _inside(row["anees"], row["anees_band"], 4),
                    _interval(row["anees_band"], 4),
                    number(row.get("distance"), 2),
                    rejected,
                ]
            )
        )
    return Table(head, rows, 3)


def cautions(summary: Mapping[str, Any]) -> Table | None:
    """A row per caution, None without any."""
    rows = [
        _cells([c["estimator"] or "the pass", Cell(c["name"], "bad"), c["text"]])
        for c in summary.get("cautions", ())
    ]
    return Table(["of", "caution", "what was found"], rows, 3) if rows else None


def _result(
    name: str, state: Mapping[str, Any], study: bool, judged: Mapping[str, Any] | None
) -> list[Cell]:
    cells: list[Any] = [name, number(state.get("rmse"))]
    if study:
        cells.append(_interval(state.get("rmse_ci")))
    cells += [number(state.get("rmse_last")), number(state["sigma"])]
    if study:
        cells += [number(state.get("bound")), number(state.get("efficiency"), 3)]
    anees = _inside(state.get("anees"), state.get("anees_band"))
    if judged is not None:  # which also lets small deviations of large studies pass
        anees = Cell(anees.text, _judged(judged).mark)
    cells += [anees, _percent(state.get("inside_3sigma"))]
    if study:
        settled, share = state.get("convergence_s"), state.get("converged")
        late = "" if share is None or share == 1 else f" (in {_percent(share, 0)})"
        cells.append(number(settled) + late)
    return _cells(cells)


def results(summary: Mapping[str, Any]) -> dict[str, Table]:
    """A table for each kind of estimate. Kinds are not comparable: filtered rows use the past,
    fixed-lag ones a little of the future too, smoothed ones the whole pass."""
    study, verdict = "runs" in summary, summary.get("verdict", {}).get("states", {})
    head = ["row", "RMSE", *(["95 % interval"] if study else []), "last epoch", "1-sigma",
            *(["bound", "RMSE / bound"] if study else []), "ANEES", "within 3 sigma",
            *(["converged [s]"] if study else [])]  # fmt: skip
    out: dict[str, Table] = {}
    for kind in KINDS:
        rows = {n: r for n, r in summary["estimators"].items() if r["kind"] == kind}
        units = {
            s: v["unit"]
            for row in rows.values()
            for s, v in row["states"].items()
            if s not in row.get("statics", {}) and "estimate" not in v
        }
        body = []
        for state, unit in units.items():
            body.append([Cell(_unit(state, unit), "strong")])
            for name, row in rows.items():
                if state in row["states"]:
                    judged = verdict.get(name, {}).get(state)
                    body.append(_result(name, row["states"][state], study, judged))
        if body:
            out[kind] = Table(head, body)
    return out


def _constant(name: str, row: Mapping[str, Any], one: Mapping[str, Any], study: bool) -> list[Cell]:
    bound = [number(one.get("bound")), number(one.get("efficiency"), 3)]
    return _cells(
        [
            name,
            row["kind"],
            number(one.get("rmse")),
            *([_interval(one.get("rmse_ci"))] if study else []),
            number(one.get("sigma")),
            *(bound if study else []),
            _inside(one.get("anees"), one.get("anees_band")),
            _interval(one.get("anees_band")),
        ]
    )


def constants(summary: Mapping[str, Any]) -> Table | None:
    """Static blocks as at the last epoch, a row per estimator; None without any."""
    study = "runs" in summary
    rows = {n: r for n, r in summary["estimators"].items() if "statics" in r}
    units = {s: v["unit"] for row in rows.values() for s, v in row["statics"].items()}
    counts = {s: v.get("count") for row in rows.values() for s, v in row["statics"].items()}
    head = ["row", "kind", *(["RMSE", "95 % interval"] if study else ["error"]), "1-sigma",
            *(["bound", "RMSE / bound"] if study else []), "ANEES", "95 % band"]  # fmt: skip
    body = []
    for block, unit in units.items():
        name = block if counts[block] is None else f"{block}, {counts[block]:g} of them"
        body.append([Cell(_unit(name, unit), "strong")])
        body += [
            _constant(name, row, row["statics"][block], study)
            for name, row in rows.items()
            if block in row["statics"]
        ]
    if len(units) > 1:
        body.append([Cell("all of them, jointly", "strong")])
        for name, row in rows.items():
            both = {key: row[f"statics_{key}"] for key in ("anees", "anees_band")}
            body.append(_constant(name, row, both, study))
    return Table(head, body, 2) if body else None


def aligned(summary: Mapping[str, Any]) -> Table | None:
    """What the alignment of each map leaves, a column per estimator; None without any."""
    rows = {n: r["aligned"] for n, r in summary["estimators"].items() if "aligned" in r}
    if not rows:
        return None
    body = [
        [Cell(title, "strong"), *(Cell(number(one.get(key), 6)) for one in rows.values())]
        for key, title in ALIGNMENT.items()
        if any(key in one for one in rows.values())
    ]
    units = {n: s["unit"] for one in rows.values() for n, s in one["states"].items()}
    for state, unit in units.items():
        found = [one["states"].get(state, {}).get("rmse") for one in rows.values()]
        body.append([Cell(_unit(state, unit), "strong"), *(Cell(number(v)) for v in found)])
    return Table(["error", *rows], body)


def estimated(summary: Mapping[str, Any]) -> Table | None:
    """The last estimates, with sigmas, of states that truth does not know; None without any."""
    found: dict[str, list[list[Cell]]] = {}
    for name, row in summary["estimators"].items():
        for state, one in (row["states"] | row.get("statics", {})).items():
            if "estimate" not in one:
                continue
            e = one["estimate"]
            pairs = zip(e["components"], e["value"], strict=True)
            if len(e["value"]) == len(e["sigma"]):
                both = zip(e["components"], e["value"], e["sigma"], strict=True)
                said = ", ".join(f"{c} {value_text(v, s)}" for c, v, s in both)
            else:
                said = ", ".join(f"q_{c} {v:.6f}" for c, v in pairs)
                said += "; ± " + ", ".join(f"{s:.2g}" for s in e["sigma"]) + f" {one['unit']}"
            said = said.replace("-", "−")
            line = _cells([name, row["kind"], said, number(one["sigma"])])
            found.setdefault(_unit(state, one["unit"]), []).append(line)
    body = [part for s, rows in found.items() for part in ([Cell(s, "strong")], *rows)]
    head = ["row", "kind", "estimate at the last epoch, ± 1-sigma", "1-sigma, pass"]
    return Table(head, body, 3) if body else None


def residuals(summary: Mapping[str, Any]) -> Table | None:
    """Residuals of a pass by row and sensor; None without any, and of a study."""
    body = []
    for name, row in summary["estimators"].items():
        for sensor, one in () if "runs" in summary else row.get("sensors", {}).items():
            nis = _inside(one["nis"], one.get("nis_band"))
            lag = number(one.get("lag_correlation"), 2)
            kind = "innovations" if row["kind"] == "filtered" else "residuals, standardised"
            ends = [_interval(one.get("nis_band")), lag, _interval(one.get("lag_band"), 2)]
            body.append(_cells([name, sensor, kind, one["rows"], nis, *ends]))
    head = ["row", "sensor", "of what", "rows", "mean square", "95 % band", "lag correlation",
            "95 % band"]  # fmt: skip
    return Table(head, body, 3) if body else None


def declared(summary: Mapping[str, Any]) -> Table | None:
    """The verdict on the declared noises of one pass; None where there is none."""
    found = summary.get("noise", {})
    return noises({"verdict": found}) if found.get("noises") else None


def judgements(summary: Mapping[str, Any]) -> Table:
    """The verdict by state and row: consistent, or by what factor sigma is wrong."""
    names = [n for kind in KINDS for n, r in summary["estimators"].items() if r["kind"] == kind]
    states = summary["verdict"]["states"]
    kinds = {n: summary["estimators"][n]["kind"] for n in names}
    body = []
    for state in dict.fromkeys(s for n in names for s in states[n]):
        body.append([Cell(plain(state), "strong"), *(_judged(states[n].get(state)) for n in names)])
    return Table(["state", *(f"{n} ({kinds[n]})" for n in names)], body, len(names) + 1)


def sensor_judgements(summary: Mapping[str, Any]) -> Table | None:
    """The verdict by sensor and filter, with NIS and whiteness."""
    body = []
    for name, row in summary["estimators"].items():
        for sensor, judged in summary["verdict"]["sensors"].get(name, {}).items():
            values = row["sensors"][sensor]
            mark = "bad" if judged["coloured"] else "good"
            lag = Cell(number(values["lag_correlation"], 2), mark)
            nis = Cell(number(values["nis"], 3), _judged(judged).mark)
            body.append([*_cells([name, sensor]), _judged(judged), nis,
                         Cell(_interval(values["nis_band"])), lag,
                         Cell(_interval(values["lag_band"], 2))])  # fmt: skip
    head = ["row", "sensor", "verdict", "NIS", "95 % band", "lag correlation", "95 % band"]
    return Table(head, body, 3) if body else None


def _judged(verdict: Mapping[str, Any] | None) -> Cell:
    if verdict is None:
        return Cell("–")
    if verdict["verdict"] == "consistent":
        return Cell("consistent", "good")
    return Cell(f"{verdict['verdict']}, {number(verdict['factor'], 3)}×", "bad")


def noises(summary: Mapping[str, Any]) -> Table | None:
    """True over declared sigma of each noise, estimated from the best smoother's residuals."""
    body = []
    for one in summary["verdict"]["noises"]:
        words = noise_said(one) if one["tested"] else "not testable here"
        said = Cell(words, {"likely cause": "bad", "as declared": "good"}.get(words, ""))
        factor = number(one["factor"], 3)
        body.append([Cell(one["noise"], "code"), said,
                     *_cells([factor, _interval(one["factor_ci"])])])  # fmt: skip
    head = ["declared noise", "verdict", "true sigma / declared", "95 % interval"]
    return Table(head, body, 2) if body else None


def paired(summary: Mapping[str, Any]) -> list[tuple[str, Table]]:
    """For each pair of rows a, b, the improvement 1 - RMSE_b / RMSE_a; pairs of one kind first."""
    pairs = sorted(summary["paired"], key=lambda p: p["kinds"][0] != p["kinds"][1])
    out = []
    head = ["state", "RMSE removed", "95 % interval", "better in", "runs"]
    for pair in pairs:
        body = []
        for state, one in pair["states"].items():
            band = one["improvement_ci"]
            mark = "" if band is None or band[0] <= 0 <= band[1] else "good"
            mark = "bad" if mark and band[1] < 0 else mark
            removed = Cell(_percent(one["improvement"]), mark)
            rest = _cells([_percents(band), _percent(one["better_in"], 0), one["runs"]])
            body.append([Cell(plain(state), "strong"), removed, *rest])
        (a, b), (first, second) = (pair["a"], pair["b"]), pair["kinds"]
        out.append((f"{a} ({first}) to {b} ({second})", Table(head, body)))
    return out


def mcreynolds(summary: Mapping[str, Any]) -> Table | None:
    """Filter against smoother: mean square of their difference over its expected variance."""
    body = []
    for pair in summary["mcreynolds"]:
        if pair["states"]:
            body.append([Cell(f"{pair['filtered']} against {pair['smoothed']}", "strong")])
        for state, one in pair["states"].items():
            square, inside = number(one["mean_square"], 3), _percent(one["inside_3sigma"])
            body.append(_cells([plain(state), square, inside]))
    return Table(["state", "mean square ratio", "within 3"], body) if body else None


def bad_runs(runs: Sequence[Mapping[str, Any]]) -> Table:
    """Runs that failed or are not to be trusted, with their commands."""
    body = [
        [Cell(str(r["run"])), Cell(r["estimator"] or "all"), Cell(r["status"], "bad"),
         Cell(r["message"]), Cell(r["command"], "code")]
        for r in runs
    ]  # fmt: skip
    return Table(["run", "row", "status", "what happened", "command"], body, 5)


def worst_runs(runs: Sequence[WorstRun]) -> Table:
    """The worst runs with their commands."""
    body = [
        [Cell(str(r.run)), Cell(number(r.anees, 3) if r.anees == r.anees else "–"),
         Cell(f"{plain(r.state)}: {number(r.ratio, 3)}×"), Cell(r.command, "code")]
        for r in runs
    ]  # fmt: skip
    return Table(["run", "joint ANEES", "worst state, RMSE / that of all runs", "command"], body, 4)
