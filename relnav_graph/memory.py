"""What the machine can hold: asked for before memory is taken."""

from __future__ import annotations

import gc
import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from relnav_graph.errors import InputError

__all__ = ["check_room", "uncollected"]

#: Where Linux says how much memory a container may use.
_CGROUPS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


def _memory() -> float:
    """Bytes of memory that this process may use."""
    limits = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    limits += [] if soft == resource.RLIM_INFINITY else [soft]
    for path in _CGROUPS:
        with suppress(OSError, ValueError):
            limits.append(int(Path(path).read_text("ascii")))
    return float(min(limits))


def check_room(found: str, numbers: float) -> None:
    """Refuse, before any work, what asks for more memory than there is.

    found: what asks, for the message; numbers: how many it takes at least. Raises InputError.
    """
    needed, there = 8.0 * numbers, _memory()
    if not needed <= there:
        raise InputError(
            f"found {found}, which take at least {needed / 2**30:.3g} GiB of memory; this machine"
            f" has {there / 2**30:.3g} GiB"
        )


@contextmanager
def uncollected() -> Iterator[None]:
    """No search for cycles of objects that nobody needs: what makes objects by the hundred
    thousand, all of which it keeps, such as drawing, would set it off all the time."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()
