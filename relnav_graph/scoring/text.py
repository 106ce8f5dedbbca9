"""The summary of a comparison as plain text for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from relnav_graph.scoring.columns import aligned_columns, with_unit
from relnav_graph.scoring.told import estimate_lines, told_lines

__all__ = [
    "ALIGNMENT",
    "aligned_columns",
    "caution_lines",
    "consistency_lines",
    "explain_table",
    "study_table",
    "table",
]


def _text(value: float | None, form: str = ".4g") -> str:
    if value is None:
        return "-"
    return format(value, form if abs(value) < 1e5 else ".2e")


def _overview(name: str, row: Mapping[str, Any]) -> list[str]:
    low, high = row["anees_band"] or (None, None)
    return [
        name,
        row["kind"],
        row["status"],
        _text(row["runtime_s"], ".3g"),
        _text(row.get("step_ms", {}).get("median"), ".3g"),
        _text(row["anees"], ".2f"),
        "-" if low is None else f"{low:.2f}..{high:.2f}",
        _text(row["distance"], ".2g"),
        ", ".join(f"{sensor} {n}" for sensor, n in row["rejected"].items() if n) or "-",
    ]


def _state(name: str, width: int, kind: str, state: Mapping[str, Any]) -> list[str]:
    return [
        name.ljust(width),
        kind,
        *(_text(state.get(key)) for key in ("rmse", "rmse_last", "sigma")),
        _text(state.get("anees"), ".2f"),
        _text(state.get("inside_3sigma"), ".1%"),
    ]


def _caution(caution: Mapping[str, Any]) -> str:
    return f"{caution['estimator'] or 'the pass'}: {caution['name']}: {caution['text']}"


def caution_lines(summary: Mapping[str, Any]) -> list[str]:
    """The cautions of a pass, a line each. What is said of several estimators, or of one and of
    others that it stands for ("of batch: ..."), is said once, behind their names."""
    rows, found = summary["estimators"], dict[tuple[str, str], list[str]]()
    for c in summary["cautions"]:
        whose, _, what = c["text"].removeprefix("of ").partition(": ")
        text = what if c["text"].startswith("of ") and whose in rows else c["text"]
        found.setdefault((c["name"], text), []).append(c["estimator"] or "the pass")
    return [f"{', '.join(names)}: {name}: {text}" for (name, text), names in found.items()]


def _unscored(rows: Mapping[str, Any]) -> list[str]:
    """A line on what the truth lacks, where it knows nothing of what is estimated itself, so that
    there is no ANEES; [] else."""
    for row in rows.values():
        states = row["states"]
        scored = [n for n, s in states.items() if s.get("anees") is not None]
        lacking = [n for n, s in states.items() if "rmse" not in s]
        if row["anees"] is None and scored and lacking:
            return [
                f"ANEES is of the estimated states, and the truth says only {', '.join(scored)},"
                f" derived of them: it lacks {', '.join(lacking)}"
            ]
    return []


def consistency_lines(summary: Mapping[str, Any]) -> list[str]:
    """What ANEES counts beside the estimate's covariance, and leaves out, or why there is none, a
    line each."""
    rows, said = summary["estimators"], summary.get("score", {})
    lines = _unscored(rows)
    exact = {n: r for n, r in rows.items() if r.get("anees_without_truth_noise") is not None}
    if exact:
        values = (f"{n} {_text(r['anees_without_truth_noise'], '.2f')}" for n, r in exact.items())
        lines.append(
            "ANEES counts the covariance of the truth; were the truth exact, it would be: "
            + ", ".join(values)
        )
    if "axes" in said:
        axes = ", ".join(f"{name} in {frame}" for name, frame in said["axes"].items())
        lines.append(f"compared in other axes than its own: {axes}")
    if "without" in said:
        values = (_with_band(n, r, "anees_without") for n, r in rows.items())
        lines.append(f"ANEES without {', '.join(said['without'])}: {', '.join(values)}")
    return lines


def _with_band(name: str, row: Mapping[str, Any], key: str) -> str:
    band = row.get(f"{key}_band")
    text = f"{name} {_text(row.get(key), '.2f')}"
    return text if not band else f"{text} ({band[0]:.2f}..{band[1]:.2f})"


def table(summary: Mapping[str, Any]) -> str:
    """The object of :func:`relnav_graph.scoring.metrics.summary` as text, 100 columns wide.

    First a row per estimator (status, run time in s, median step in ms, joint ANEES and
    its 95 % band, how many sigmas apart it is from batch or rts, rejected observations), with
    messages and cautions, then a block per state in its unit, then the constants.
    """
    rows = summary["estimators"]
    title = f"{summary['scenario']}: {summary['epochs']} epochs"
    title += "" if summary["seed"] is None else f", seed {summary['seed']}"
    overview = [_overview(name, row) for name, row in rows.items()]
    header = "estimator |kind |status |run time s|step ms|ANEES|95 % band|apart|rejected "
    lines = [title, "", *aligned_columns(header, overview)]
    lines += [f"{name}: {row['message']}" for name, row in rows.items() if row["message"]]
    lines += consistency_lines(summary)
    lines += [f"caution: {line}" for line in caution_lines(summary)]
    lines += told_lines(summary)
    width = max(map(len, ["estimator", *rows]))  # the same columns in every block
    for state, unit in _moving(rows).items():
        if estimated := estimate_lines(rows, "states", state, unit):
            lines += estimated
            continue
        block = [
            _state(name, width, row["kind"], row["states"][state])
            for name, row in rows.items()
            if state in row["states"]
        ]
        header = "estimator |kind     |     rmse|rmse last|  1-sigma|   ANEES|inside 3-sigma"
        lines += ["", with_unit(state, unit), *aligned_columns(header, block)]
    for constant, unit in _estimated_constants(rows).items():
        lines += estimate_lines(rows, "statics", constant, f"{unit}, a constant")
    lines += _constants(rows, "constants, as at the last epoch", ("error", "1-sigma"))
    lines += _aligned_maps(rows)
    return "\n".join(lines) + "\n"


def _estimated_constants(rows: Mapping[str, Any]) -> dict[str, str]:
    """Units of the constants that truth does not know, by name."""
    return {
        name: one["unit"]
        for row in rows.values()
        for name, one in row.get("statics", {}).items()
        if "estimate" in one
    }


def _moving(rows: Mapping[str, Any]) -> dict[str, str]:
    """Units by state, constants left out: they have a table of their own."""
    return {
        state: s["unit"]
        for row in rows.values()
        for state, s in row["states"].items()
        if state not in row.get("statics", {})
    }


#: Columns of the table of constants: where the number stands, and its form.
_CONSTANT = {
    "error": ("rmse", ".4g"),
    "rmse": ("rmse", ".4g"),
    "1-sigma": ("sigma", ".4g"),
    "bound": ("bound", ".4g"),
    "rmse/bound": ("efficiency", ".3f"),
}


def _constant(columns: Sequence[str], values: Mapping[str, Any]) -> list[str]:
    low, high = values["anees_band"] if values.get("anees_band") else (None, None)
    return [
        *(_text(values.get(key), form) for key, form in (_CONSTANT[c] for c in columns)),
        _text(values.get("anees"), ".2f"),
        "-" if low is None else f"{low:.2f}..{high:.2f}",
    ]


def _constants(rows: Mapping[str, Any], title: str, columns: Sequence[str]) -> list[str]:
    """Lines of the table of static blocks, a row per block and estimator; [] without any.

    columns: of `_CONSTANT`, before ANEES and its band.
    """
    having = {name: row for name, row in rows.items() if "statics" in row}
    units = {n: one["unit"] for row in having.values() for n, one in row["statics"].items()}
    counts = {n: one.get("count") for row in having.values() for n, one in row["statics"].items()}
    parts = [
        (
            with_unit(n if counts[n] is None else f"{n}, {counts[n]:g} of them", unit),
            {r: row["statics"][n] for r, row in having.items() if n in row["statics"]},
        )
        for n, unit in units.items()
    ]
    if len(parts) > 1:
        jointly = {
            r: {"anees": row["statics_anees"], "anees_band": row["statics_anees_band"]}
            for r, row in having.items()
        }
        parts.append(("all of them, jointly", jointly))
    table = [
        ["" if k else first, r, rows[r]["kind"], *_constant(columns, one)]
        for first, values in parts
        for k, (r, one) in enumerate(values.items())
    ]
    numbers = "|".join(f"{c:>9}" for c in (*columns, "ANEES"))
    header = f"constant |estimator |kind     |{numbers}|95 % band"
    return ["", title, *aligned_columns(header, table)] if table else []


#: Numbers of an alignment, and how the table calls them.
ALIGNMENT = {
    "rotation_deg": "turn of the map [deg]",
    "shift_m": "shift of the map [m]",
    "map_rmse_m": "map, rmse [m]",
    "map_max_m": "map, largest error [m]",
    "scale": "scale of the map",
    "scale_error": "error of the scale, rms",
}


def _aligned_maps(rows: Mapping[str, Any]) -> list[str]:
    """Lines of errors after the alignment of each estimator's map; [] without any."""
    having = {name: row["aligned"] for name, row in rows.items() if "aligned" in row}
    if not having:
        return []
    table = [
        [title, *(_text(one.get(key), ".6g") for one in having.values())]
        for key, title in ALIGNMENT.items()
        if any(key in one for one in having.values())
    ]
    units = {n: s["unit"] for one in having.values() for n, s in one["states"].items()}
    for state, unit in units.items():
        found = (one["states"].get(state, {}).get("rmse") for one in having.values())
        table.append([f"{with_unit(state, unit)}, rmse", *map(_text, found)])
    title = "after one rigid alignment of each map, as at the last epoch, to the true one"
    return ["", title, *aligned_columns("error |" + "|".join(f"{n:>9}" for n in having), table)]


def _study_overview(name: str, row: Mapping[str, Any]) -> list[str]:
    low, high = row["anees_band"] or (None, None)
    return [
        name,
        row["kind"],
        row["status"],
        str(row["runs"]),
        _text(row["runtime_s"], ".3g"),
        _text(row["anees"], ".3f"),
        "-" if low is None else f"{low:.3f}..{high:.3f}",
    ]


def _study_state(name: str, width: int, kind: str, state: Mapping[str, Any]) -> list[str]:
    low, high = state.get("rmse_ci") or (None, None)
    return [
        name.ljust(width),
        kind,
        _text(state.get("rmse")),
        "-" if low is None else f"{_text(low)}..{_text(high)}",
        *(_text(state.get(key)) for key in ("sigma", "bound")),
        _text(state.get("efficiency"), ".3f"),
        _text(state.get("anees"), ".2f"),
        _text(state.get("inside_3sigma"), ".1%"),
    ]


_STUDY_STATE = (
    "estimator |kind     |     rmse|95 % interval|  1-sigma|    bound|rmse/bound|ANEES|in 3-sigma"
)


def study_table(summary: Mapping[str, Any]) -> str:
    """The object of ``relnav study --json`` as text: a row per estimator, a block per
    state in its unit, the verdict, and the runs that failed."""
    rows, seed = summary["estimators"], summary["seed"]
    title = f"{summary['scenario']}: {summary['runs']} runs of {summary['epochs']} epochs"
    header = "estimator |kind |status |runs|run time s|ANEES|95 % band"
    lines = [f"{title}, seed {seed}", ""]
    lines += aligned_columns(header, [_study_overview(name, row) for name, row in rows.items()])
    lines += consistency_lines(summary)
    lines += [f"caution: {_caution(c)}" for c in summary["cautions"]]
    width = max(map(len, ["estimator", *rows]))
    for state, unit in _moving(rows).items():
        block = [
            _study_state(name, width, row["kind"], row["states"][state])
            for name, row in rows.items()
            if state in row["states"]
        ]
        lines += ["", with_unit(state, unit), *aligned_columns(_STUDY_STATE, block)]
    columns = ("rmse", "1-sigma", "bound", "rmse/bound")
    lines += _constants(rows, "constants, as at the last epoch", columns)
    lines += _aligned_maps(rows)
    lines += ["", "Verdict", *(f"  {text}" for text in summary["verdict"]["text"])]
    for title, key in (("Failed runs", "failed"), ("Degraded runs", "degraded")):
        if summary[key]:
            lines += ["", title]
            lines += [f"  {r['message']}\n    {r['command']}" for r in summary[key]]
    return "\n".join(lines) + "\n"


def _numbers(values: Sequence[float]) -> str:
    """One number where all are the same, else all of them."""
    texts = list(dict.fromkeys(f"{v:.4g}" for v in values))
    return texts[0] if len(texts) == 1 else "(" + ", ".join(f"{v:.4g}" for v in values) + ")"


def _sensor_lines(s: Mapping[str, Any]) -> list[str]:
    lines = [f"  {s['name']} ({s['kind']}): {s['meaning']}"]
    seen = f"{s['observations']} observations in {s['epochs']} epochs"
    noise = f"; sigma {_numbers(s['sigma'])} (SI) per residual row" if "sigma" in s else ""
    return [*lines, f"      reads {', '.join(s['reads'])}; {seen}{noise}"]


def _process_lines(p: Mapping[str, Any]) -> list[str]:
    driven = f", driven by {', '.join(p['inputs'])}" if p["inputs"] else ""
    lines = [f"  {p['name']} ({p['kind']}{driven}): {p['meaning']}"]
    for n in p["noise"]:
        noise = f"{_numbers(n['sigma'])} {n['unit'] if n['unit'] != '1' else ''}".rstrip()
        lines.append(f"      {n['block']}: sigma {noise} over {p['interval_s']:g} s")
    return lines


def _predicted(states: Mapping[str, Any]) -> list[list[str]]:
    return [
        [f"{name} [{s['unit']}]", *(_text(s[k]) for k in ("prior", "filter", "smoother"))]
        for name, s in states.items()
    ]


def explain_table(found: Mapping[str, Any]) -> str:
    """The object of ``relnav explain --json`` as text."""
    lines = [f"{found['scenario']}: {found['epochs']} epochs", "", "Sensors"]
    for s in found["sensors"]:
        lines += _sensor_lines(s)
    lines += ["", "Processes: noise after discretisation, 1-sigma per axis"]
    for p in found["processes"]:
        lines += _process_lines(p)
    moving = {n: s for n, s in found["states"].items() if n not in found.get("statics", {})}
    states = _predicted(moving)
    lines += ["", "Predicted 1-sigma (norm over the axes, root mean square over the pass)"]
    lines += aligned_columns("state |    prior|   filter| smoother", states)
    if "statics" in found:
        lines += ["", "Predicted 1-sigma of constants (norm over the axes), as at the last epoch"]
        lines += aligned_columns(
            "constant |    prior|   filter| smoother", _predicted(found["statics"])
        )
    directions = [
        [
            f"{d['direction']} [{d['unit']}]",
            *(_text(d.get(k)) for k in ("prior", "filter_last", "smoother_middle")),
        ]
        for d in found["directions"]
    ]
    if directions:
        lines += ["", "Predicted 1-sigma along directions that the models name"]
        lines += aligned_columns("direction |    prior|filter, last|smoother, middle", directions)
    if "target" in found:
        lines += ["", "What the data tell of the target, 1-sigma of a smoother"]
        lines += [f"  {text}" for text in found["target"]]
    lines += ["", "Weak directions of the first epoch (smoothed sigma in parts of the prior's)"]
    weak = [[w["direction"], w["verdict"], f"{w['kept']:.2f}"] for w in found["weak"]]
    lines += aligned_columns("direction |verdict |kept", weak) if weak else ["  none"]
    return "\n".join(lines) + "\n"
