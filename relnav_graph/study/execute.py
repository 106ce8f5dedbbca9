"""Spreading runs over workers, of any `concurrent.futures` executor.

A worker may die (out of memory, a machine taken away): the runs it had are given out
again. Which of them killed it is not known, so they are then tried one at a time; a run
that loses its worker when alone, or is lost three times, is given up.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from concurrent.futures.process import ProcessPoolExecutor

from relnav_graph.errors import EstimationError

__all__ = ["execute", "local_processes"]

Task = Callable[[int], bytes]
ATTEMPTS = 3


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _start_worker() -> None:
    """Leave Ctrl-C to the parent, and never outlive it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def local_processes(jobs: int) -> ProcessPoolExecutor:
    """A pool of fresh processes: forked ones would inherit the locks of BLAS's threads."""
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(jobs, mp_context=context, initializer=_start_worker)


def _fill(
    executor: Executor,
    task: Task,
    queue: deque[int],
    pending: dict[Future[bytes], int],
    lost: Counter[int],
    in_flight: int,
) -> None:
    """Hand out runs; one that was lost before goes alone."""
    while queue and len(pending) < (1 if lost[queue[0]] else in_flight):
        pending[executor.submit(task, queue[0])] = queue[0]
        if lost[queue.popleft()]:
            return


def execute(
    task: Task, runs: Iterable[int], jobs: int, executor: Executor | None = None
) -> Iterator[tuple[int, bytes | str]]:
    """Yield each run with its result, in the order of completion; for a run that was given up,
    a text that says why takes the place of the result.

    jobs: number of workers; twice as many runs are handed out at a time, which bounds the
    memory; executor: by default a pool of local processes, replaced when it breaks. Raises
    EstimationError when an executor that was given breaks.
    """
    queue, lost, pending = deque(runs), Counter[int](), dict[Future[bytes], int]()
    pool = local_processes(jobs) if executor is None else executor
    try:
        while queue or pending:
            broken = alone = False
            done = set[Future[bytes]]()
            try:
                _fill(pool, task, queue, pending, lost, 2 * jobs)
                alone = len(pending) == 1
                done, _ = wait(pending, return_when=FIRST_COMPLETED)
            except BrokenExecutor:
                broken = True
            for future in done:
                run, error = pending.pop(future), future.exception()
                if error is None:
                    yield run, future.result()
                    continue
                broken |= isinstance(error, BrokenExecutor)
                lost[run] += 1
                if lost[run] >= ATTEMPTS or (alone and lost[run] > 1):
                    yield run, f"its worker was lost: {type(error).__name__}: {error}"
                else:
                    queue.appendleft(run)
            if broken:
                if executor is not None:
                    raise EstimationError("the executor broke; what is done is kept: run again")
                lost.update(pending.values())
                queue.extendleft(pending.values())
                pending.clear()
                pool.shutdown(wait=False, cancel_futures=True)
                pool = local_processes(jobs)
    finally:
        if executor is None:
            pool.shutdown(wait=False, cancel_futures=True)
