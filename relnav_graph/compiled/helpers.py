"""The first compilation: said to the user, and shared with helper processes on other cores."""

from __future__ import annotations

import atexit
import logging
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

from relnav_graph.compiled import loops_so_far, prepare
from relnav_graph.compiled.cache import cache_folder, is_empty, why_not_kept
from relnav_graph.compiled.contracts import dynamics_address, sensor_address
from relnav_graph.compiled.symbols import meanwhile

__all__ = ["compile_ahead", "work"]

_LOG = logging.getLogger(__name__)
#: Folders that helpers of this process fill, or have filled: it may make many scenarios.
_BEGUN: set[Path] = set()

#: What a helper runs; its tasks come on standard input.
_PROGRAM = (
    "import gc, sys; gc.disable(); from relnav_graph.compiled.helpers import work;"
    " work(sys.stdin.buffer.read())"
)


def work(tasks: bytes) -> None:
    """Do pickled tasks, one after the other: what a helper process is for."""
    todo: list[Callable[[], object]] = [partial(_do, t) for t in reversed(pickle.loads(tasks))]
    meanwhile(todo)
    while todo:
        todo.pop()()


def _do(task: bytes) -> None:
    pickle.loads(task)()


def compile_ahead(sensors: Iterable[Any], processes: Iterable[Any]) -> None:
    """When the kernels of these models were never compiled, say so, and have other cores help.

    sensors, processes: kernels. Each helper begins elsewhere among loops and kernels; this
    process does some of them too, from the last one on, while it waits for a helper. What has
    not been done when it ends is left.
    """
    kernels = [(k, dynamics_address) for k in processes] + [(k, sensor_address) for k in sensors]
    named = [(k, address) for k, address in kernels if "<locals>" not in _function(k).__qualname__]
    sources = {_function(kernel).__code__.co_filename for kernel, _ in named}
    folders = [folder for folder in map(cache_folder, sorted(sources)) if is_empty(folder)]
    folders = [folder for folder in folders if folder not in _BEGUN]
    if not folders:
        return
    _BEGUN.update(folders)
    why = why_not_kept(folders[0])
    if why:  # nor could helpers hand over what they make
        _LOG.info(
            "compiling the models, for this run only: %s; RELNAV_CACHE_DIR can name a folder"
            " that keeps them",
            why,
        )
        return
    _LOG.info("compiling the models, once; later runs take them from %s", folders[0])
    # This process simulates first, then asks for the kernels, one by one: the helpers begin
    # with the loops, which come last.
    tasks: list[Callable[[], object]] = [partial(prepare, loop) for loop in loops_so_far()]
    tasks += [partial(address, kernel) for kernel, address in reversed(named)]
    meanwhile(tasks)
    helpers = max(0, min(3, (os.cpu_count() or 1) - 1))
    for i in range(helpers):
        start = i * len(tasks) // helpers
        _start([pickle.dumps(task) for task in tasks[start:] + tasks[:start]])


def _function(kernel: Any) -> Any:
    """The Python function of a kernel, which may turn out not to be compiled."""
    return getattr(kernel, "py_func", kernel)


def _start(tasks: list[bytes]) -> None:
    helper = subprocess.Popen(
        [sys.executable, "-c", _PROGRAM],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(p or "." for p in sys.path)},
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    atexit.register(helper.kill)
    assert helper.stdin is not None
    with helper.stdin:
        helper.stdin.write(pickle.dumps(tasks))
