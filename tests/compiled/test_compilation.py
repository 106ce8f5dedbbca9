"""Machine code is generated once, kept on disk, and shared by processes."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from relnav_graph.maths import dense
from relnav_graph.maths.dense import matmul_into

#: Prints what f(9) gives, then the functions that were compiled for it.
PROGRAM = """
from numba.core import event
compiled = []
class Listener(event.Listener):
    def on_start(self, found):
        compiled.append(found.data["dispatcher"].py_func.__name__)
    def on_end(self, found):
        pass
event.register("numba:compile", Listener())
from outsider.upper import f
print(f(9.0), *compiled)
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """f calls g and root, g calls root; root fails below zero."""
    folder = tmp_path / "outsider"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "lower.py").write_text(
        "from relnav_graph.compiled import jit\n"
        "@jit\ndef root(x):\n"
        "    if x < 0.0:\n        raise ValueError('below zero')\n"
        "    return x ** 0.5\n"
        "@jit\ndef g(x):\n    return 2.0 * root(x)\n"
    )
    (folder / "upper.py").write_text(
        "from relnav_graph.compiled import jit\nfrom outsider.lower import g, root\n"
        "@jit\ndef f(x):\n    return g(x) + root(x)\n"
    )
    return tmp_path


def start(package: Path, program: str, cache: str = "cache") -> subprocess.Popen[str]:
    """A process that shares its cache with the others of a package."""
    where = {"RELNAV_CACHE_DIR": str(package / cache), "PYTHONPATH": str(package)}
    return subprocess.Popen(
        [sys.executable, "-c", program],
        env={**os.environ, **where},
        stdout=subprocess.PIPE,
        text=True,
    )


def result(process: subprocess.Popen[str]) -> list[str]:
    """The words that it printed."""
    out, _ = process.communicate(timeout=300)
    assert process.returncode == 0
    return out.split()


def test_the_next_process_compiles_nothing(package: Path) -> None:
    value, *compiled = result(start(package, PROGRAM))
    assert (float(value), sorted(compiled)) == (9.0, ["f", "g", "root"])
    assert result(start(package, PROGRAM)) == ["9.0"]


def test_a_cache_may_be_moved(package: Path) -> None:
    result(start(package, PROGRAM))
    (package / "cache").rename(package / "moved")
    assert result(start(package, PROGRAM, "moved")) == ["9.0"]


def test_a_constant_in_another_file_reaches_the_cache(package: Path) -> None:
    """numba's own cache would go on with the old one."""
    kernels, constants = package / "outsider" / "kernels.py", package / "outsider" / "constants.py"
    kernels.write_text(
        "from relnav_graph.compiled import jit\nfrom outsider.constants import K\n"
        "@jit\ndef f(x):\n    return K * x\n"
    )
    for value in ("2.0", "3.0"):
        constants.write_text(f"K = {value}\n")
        found = result(start(package, "from outsider.kernels import f; print(f(1.0))"))
        assert found == [value]


def test_processes_at_once_compile_each_function_once(package: Path) -> None:
    found = [result(process) for process in [start(package, PROGRAM) for _ in range(3)]]
    assert {value for value, *_ in found} == {"9.0"}
    assert Counter(name for _, *names in found for name in names) == {"f": 1, "g": 1, "root": 1}


def test_who_waits_for_a_lock_and_holds_one_does_nothing_else(package: Path) -> None:
    """It loads a loop, somebody has what the loop calls, and the next task is the same loop."""
    upper = package / "outsider" / "upper.py"
    upper.write_text(
        "from relnav_graph.compiled import jit_loop\n"
        "from relnav_graph.compiled.contracts import VECTOR\nfrom outsider.lower import root\n"
        "@jit_loop(VECTOR)\ndef loop(x):\n    x[0] = root(x[0])\n"
    )
    compile_root = "from outsider.lower import root; from numba import float64\n"
    result(start(package, compile_root + "root.compile((float64,))"))
    locks = [str(path) for path in package.glob("cache/**/*.lock")]
    assert len(locks) == 1
    call = "import numpy as np; x = np.full(1, 9.0); loop(x); print(x[0])"
    assert result(start(package, f"from outsider.upper import loop; {call}")) == ["3.0"]
    program = (
        "import fcntl, threading\nfrom outsider.upper import loop\n"
        "from relnav_graph.compiled.symbols import meanwhile\n"
        f"file = open({locks[0]!r}, 'a')\nfcntl.flock(file, fcntl.LOCK_EX)\n"
        "threading.Timer(0.5, file.close).start()\n"
        "meanwhile([loop.prepare])\n"
    )
    assert result(start(package, program + call)) == ["3.0"]


def test_callers_hold_no_copy_of_what_they_call(package: Path) -> None:
    program = (
        "from outsider.upper import f; from outsider.lower import g, root\n"
        "f(9.0)\n"
        "code = lambda function: next(iter(function.overloads.values()))\n"
        "name = code(root).fndesc.mangled_name\n"
        "print(name in code(root).library.get_llvm_str(), name in code(g).library.get_llvm_str())"
    )
    assert result(start(package, program)) == ["True", "False"]


def test_an_error_comes_through_all_callers(package: Path) -> None:
    program = (
        "from outsider.upper import f\n"
        "try:\n    f(-1.0)\nexcept ValueError as error:\n    print(*error.args)"
    )
    assert result(start(package, program)) == ["below", "zero"]
    assert result(start(package, program)) == ["below", "zero"]  # now from the cache


def test_a_cache_that_cannot_be_written_is_done_without(package: Path) -> None:
    (package / "cache").write_text("a file, no folder")
    value, *_ = result(start(package, PROGRAM))
    assert float(value) == 9.0


def test_python_may_call_what_compiled_code_calls(package: Path) -> None:
    """Before and after compiled code has called it, and with any kind of argument."""
    program = (
        "from outsider.upper import f; from outsider.lower import root\n"
        "print(root(9.0), f(9.0), root(x=9), root(16.0), f(16), root(9))"
    )
    for _ in range(2):  # the second time from the cache
        assert result(start(package, program)) == ["3.0", "9.0", "3.0", "4.0", "12.0", "3.0"]
    one, out = 2 * np.eye(3), np.empty((3, 3))
    for _ in range(2):
        matmul_into(one, one, out)
        np.testing.assert_array_equal(dense.matmul(one, one), out)


def test_another_process_gets_a_function_by_its_name(package: Path) -> None:
    program = (
        "import pickle; from outsider.upper import f\n"
        "print(pickle.loads(pickle.dumps(f)) is f, f(9.0))\n"
        "print(pickle.loads(pickle.dumps(f)) is f)"
    )
    assert result(start(package, program)) == ["True", "9.0", "True"]


def test_garbage_is_collected_again_after_compiling(package: Path) -> None:
    program = (
        "import gc; from outsider.upper import f\n"
        "f(9.0)\nprint(gc.isenabled())\ngc.disable()\nf(9)\nprint(gc.isenabled())"
    )
    assert result(start(package, program)) == ["True", "False"]
