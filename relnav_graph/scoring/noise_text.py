"""Noises found by `relnav tune` as text for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from relnav_graph.scoring.columns import aligned_columns

__all__ = ["tune_table"]


def _value(row: Mapping[str, Any], key: str) -> str:
    found = row[key]
    values = found if isinstance(found, list) else [found]
    texts = list(dict.fromkeys(f"{v:.4g}" for v in values))
    text = texts[0] if len(texts) == 1 else f"({', '.join(f'{v:.4g}' for v in values)})"
    return text if row["unit"] == "1" else f"{text} {row['unit']}"


def tune_table(found: Mapping[str, Any]) -> str:
    """The object of ``relnav tune --json`` as text: a row for each noise, then the likelihood of
    the innovations with the noises declared and found."""
    rows = []
    for name, row in found["noises"].items():
        line = [name, _value(row, "declared")]
        if row["told"]:
            low, high = row["factor_ci"]
            line += [_value(row, "value"), f"{row['factor']:.3f}", f"{low:.3f}..{high:.3f}", ""]
        else:
            line += ["as declared", "-", "-", f"cannot be told: {row['why']}"]
        rows.append(line)
    header = "noise |declared |found |times|95 % interval|note "
    title = f"{found['scenario']}: {found['epochs']} epochs"
    title += "" if found["seed"] is None else f", seed {found['seed']}"
    before, after = (found["log_likelihood"][key] for key in ("declared", "tuned"))
    return "\n".join(
        [
            title,
            "",
            *aligned_columns(header, rows),
            "",
            f"log-likelihood of the innovations: {before:.2f} as declared, {after:.2f} as found"
            f" ({after - before:+.2f})",
            f"A noise is told where its 95 % interval ends within {found['telling']:g} times it.",
            "",
        ]
    )
