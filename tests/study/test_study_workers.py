"""Worker processes of studies: they may die, and end with their parent."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import pytest

from relnav_graph.errors import EstimationError
from relnav_graph.study.execute import execute


def test_workers_end_with_their_parent(tmp_path: Path) -> None:
    script = (
        "import os\n"
        "from relnav_graph.study.execute import local_processes\n"
        "if __name__ == '__main__':\n"
        "    pool = local_processes(1)\n"
        "    print(pool.submit(os.getpid).result(), flush=True)\n"
        "    os.kill(os.getpid(), 9)\n"
    )
    (tmp_path / "parent.py").write_text(script)
    program = [sys.executable, str(tmp_path / "parent.py")]
    child = int(subprocess.run(program, capture_output=True, text=True, timeout=60).stdout)
    deadline = time.monotonic() + 20
    while _alive(child) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not _alive(child)


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    stat = Path(f"/proc/{pid}/stat")
    return not (stat.is_file() and stat.read_text().rpartition(")")[2].split()[0] == "Z")


def _deadly(folder: str, fatal: tuple[int, ...], times: int, run: int) -> bytes:
    """Ends its worker the first `times` times that it is called for a fatal run."""
    calls = len(list(Path(folder).glob(f"{run}.*")))
    (Path(folder) / f"{run}.{calls}").touch()
    if run in fatal and calls < times:
        os._exit(1)
    return str(run).encode()


def test_a_lost_worker_loses_nothing(tmp_path: Path) -> None:
    task = partial(_deadly, str(tmp_path), (2,), 1)
    assert dict(execute(task, range(6), 2)) == {run: str(run).encode() for run in range(6)}


def test_a_run_that_kills_every_worker_is_given_up(tmp_path: Path) -> None:
    results = dict(execute(partial(_deadly, str(tmp_path), (1, 4), 99), range(6), 2))
    assert sorted(results) == list(range(6))
    lost = {run for run, result in results.items() if isinstance(result, str)}
    assert lost == {1, 4}
    assert "worker was lost" in str(results[1])


def test_a_broken_executor_of_the_caller_is_reported(tmp_path: Path) -> None:
    with ProcessPoolExecutor(1) as executor, pytest.raises(EstimationError, match="run again"):
        list(execute(partial(_deadly, str(tmp_path), (0,), 99), range(2), 1, executor))
