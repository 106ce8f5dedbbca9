"""``relnav calibrate``: mountings and lags from a recorded pass."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
import numpy as np
import tomli_w

from relnav_graph.cli.shared import check_fragment, command_line, show_events, show_progress
from relnav_graph.io.atomic import atomic
from relnav_graph.maths import so3
from relnav_graph.runs.calibration import Calibration, MountFound, calibrate, tables_of
from relnav_graph.runs.passes import open_pass
from relnav_graph.units import unit_scale

#: How a file of what was found begins: no other is written over.
MARK = "# Found by: "


def _off(m: MountFound) -> np.ndarray[Any, np.dtype[np.float64]]:
    """How far a mounting is off, (3,), SI; an attitude as a rotation vector."""
    return so3.log(m.value) if m.block.manifold == "SO3" else m.value


def as_object(found: Calibration) -> dict[str, Any]:
    """What `--json` prints; SI and rad, covariances (3, 3)."""
    return {
        "schema": 1,
        "scenario": found.scenario,
        "truth": found.truth,
        "mountings": {
            m.block.name: {
                "unit": m.block.unit,
                "value": _off(m).tolist(),
                "sigma": np.sqrt(np.diag(m.P)).tolist(),
                "covariance": m.P.tolist(),
                "told": m.told.tolist(),
                "held": m.held,
            }
            for m in found.mounts
        },
        "parameters": {
            p.parameter.name: {
                "unit": p.parameter.unit,
                "value": p.value,
                "sigma": p.sigma if np.isfinite(p.sigma) else None,
                "told": p.told,
            }
            for p in found.parameters
        },
        "residuals": {"before": found.before, "after": found.after},
    }


def as_text(found: Calibration) -> str:
    """What is printed: a line for each mounting and lag, in the units that people read."""
    lines = []
    for m in found.mounts:
        unit = m.block.table_unit
        scale = 1.0 / unit_scale(unit, m.block.unit)
        value, sigma = scale * _off(m), scale * np.sqrt(np.diag(m.P))
        numbers = "  ".join(f"{v:9.4f} +- {s:.4f}" for v, s in zip(value, sigma, strict=True))
        axes = "".join(axis for axis, told in zip("xyz", m.told, strict=True) if not told)
        why = "held, not estimated" if m.held else f"not told: {axes}" if axes else "told"
        lines.append(f"{m.block.name:<28} {numbers} {unit:<4} {why}")
    for p in found.parameters:
        told = "told" if p.told else "not told"
        name, unit = p.parameter.name, p.parameter.unit
        lines.append(f"{name:<28} {p.value:9.6g} +- {p.sigma:.3g} {unit:<4} {told}")
    lines.append(f"mean square of the residuals, in sigmas: {found.before:.4g}, {found.after:.4g}")
    return "\n".join(lines)


def as_toml(found: Calibration, command: str) -> str:
    """The fragment of a scenario: values, and sigmas of the mountings; covariances as comments."""
    head = [
        f"{MARK}{command}",
        "# A scenario takes this as the last of its bases: base = [..., this file].",
        '# It then holds the mountings. With mounting = "estimated" in their sensors, they are',
        "# considered: counted with these sigmas, and not estimated.",
    ]
    for m in found.mounts:
        if not m.held:
            head.append(f"# covariance of {m.block.name}, {m.block.unit}^2: {m.P.tolist()}")
    return "\n".join(head) + "\n\n" + tomli_w.dumps(tables_of(found))


@click.command("calibrate")
@click.argument("scenario", type=click.Path(path_type=Path))
@click.option("--data", type=click.Path(path_type=Path), help="Recorded pass; else one is drawn.")
@click.option("--sensor", "sensors", multiple=True, help="Mounting to find; default: all.")
@click.option("--lag", "inputs", multiple=True, help="Input whose lag to find; default: all.")
@click.option("--setting", "settings", multiple=True, help="Other number to find, by its path.")
@click.option("--no-lags", is_flag=True, help="Leave the lags as the scenario has them.")
@click.option("--without-truth", is_flag=True, help="Use the measurements alone.")
@click.option("--lever-arms", is_flag=True, help="With --without-truth: lever arms, too.")
@click.option("--seed", type=click.IntRange(0), help="Root of the random numbers.")
@click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="Change a setting.")
@click.option("-o", "--out", type=click.Path(path_type=Path), help="TOML file to write.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(
    scenario: Path,
    data: Path | None,
    sensors: tuple[str, ...],
    inputs: tuple[str, ...],
    settings: tuple[str, ...],
    no_lags: bool,
    without_truth: bool,
    lever_arms: bool,
    seed: int | None,
    assignments: tuple[str, ...],
    out: Path | None,
    as_json: bool,
) -> None:
    """Find from a pass of SCENARIO how its sensors are mounted, and how late its inputs are.

    The truth counts as measurements of the pose, with the noise that [truth_noise] says. What is
    found goes into a TOML file (-o), which another pass takes by `base` and holds.
    """
    show_events()
    check_fragment(out, MARK)
    opened = open_pass(scenario, seed, data, assignments)
    found = calibrate(
        opened,
        sensors or None,
        () if no_lags else inputs or None,
        settings,
        arms=True if lever_arms else None,
        truth=not without_truth,
    )
    if out is not None:
        with atomic(out) as staged:
            staged.write_text(as_toml(found, command_line()), "utf-8")
        show_progress(f"{out}: what was found")
    click.echo(json.dumps(as_object(found), allow_nan=False) if as_json else as_text(found))
