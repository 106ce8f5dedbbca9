"""Integration steps in an interval: how many are more than anybody can mean."""

from __future__ import annotations

from relnav_graph.errors import InputError

__all__ = ["MOST_STEPS", "check_steps"]

#: Steps in one interval. They take a second or so; a day in steps of a second is fewer.
MOST_STEPS = 100_000


def check_steps(where: str, length: float, longest: float) -> None:
    """Raise InputError when steps of at most `longest` s in `length` s are more than `MOST_STEPS`.

    Compiled loops count steps in integers and cannot be given up: nothing else may reach them.
    """
    if not length <= MOST_STEPS * longest:
        raise InputError(
            f"{where}: found max_step = {longest:g} s for an interval of {length:g} s, expected at"
            f" most {MOST_STEPS} steps (is max_step, or are the times, in another unit?)"
        )
