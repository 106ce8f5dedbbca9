"""Rows 53 and 54: damaged and impossible compile caches, machines without a home."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

#: Prints f(9), then the functions that were compiled for it.
PROGRAM = """
from numba.core import event
compiled = []
class Listener(event.Listener):
    def on_start(self, found):
        compiled.append(found.data["dispatcher"].py_func.__name__)
    def on_end(self, found):
        pass
event.register("numba:compile", Listener())
from outsider import f
print(f(9.0), *sorted(compiled))
"""
NO_ROOM = (
    "import resource, signal\nsignal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
    "resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))\n"
)
NOBODY = "import pwd\ndef gone(uid):\n    raise KeyError(uid)\npwd.getpwuid = gone\n"
#: Says what a first compilation says.
AHEAD = """
import logging, sys
logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
from relnav_graph.compiled.helpers import compile_ahead
from outsider import f
compile_ahead([f], [])
print(f(9.0))
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """f calls root."""
    (tmp_path / "outsider.py").write_text(
        "from relnav_graph.compiled import jit\n"
        "@jit\ndef root(x):\n    return x ** 0.5\n"
        "@jit\ndef f(x):\n    return 3.0 * root(x)\n"
    )
    return tmp_path


def told(package: Path, program: str = PROGRAM, **changed: str | None) -> tuple[list[str], str]:
    """The words that a program printed, and what it said on standard error."""
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(package), *filter(None, sys.path)])}
    env |= {"RELNAV_CACHE_DIR": str(package / "cache")}
    for name, value in changed.items():
        env.pop(name, None)
        env |= {} if value is None else {name: value}
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=package,
        env=env,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split(), done.stderr


def _flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 8
    path.write_bytes(content)


def _folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


DAMAGES: dict[str, Callable[[Path], object]] = {
    "emptied": lambda path: path.write_bytes(b""),
    "cut": lambda path: path.write_bytes(path.read_bytes()[:-7]),
    "flipped": _flip,
    "replaced": lambda path: path.write_bytes(b"\x80\x04X\x01\x00\x00\x00a." + bytes(100)),
}


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_row_53_damaged_files_are_compiled_again_and_replaced(package: Path, ending: str) -> None:
    assert told(package) == (["9.0", "f", "root"], "")
    assert told(package) == (["9.0"], "")
    for name, damage in DAMAGES.items():
        for path in package.glob(f"cache/**/*.{ending}"):
            damage(path)
        words, said = told(package)
        assert words == ["9.0", "f", "root"], name
        assert said.count("damaged files of compiled code") == 1
        assert str(package / "cache") in said
    assert told(package) == (["9.0"], "")


def test_the_same_sources_elsewhere_need_no_compilation(package: Path, tmp_path: Path) -> None:
    told(package)
    other = tmp_path / "elsewhere"
    other.mkdir()
    shutil.copyfile(package / "outsider.py", other / "outsider.py")  # of another date, too
    where = {"RELNAV_CACHE_DIR": str(package / "cache")}
    assert told(other, **where)[0] == ["9.0"]
    (other / "outsider.py").write_text(
        (package / "outsider.py").read_text("utf-8").replace("0.5", "1.5"), "utf-8"
    )
    assert told(other, **where)[0] == ["81.0", "f", "root"]


def test_row_53_one_damaged_file_costs_one_function(package: Path) -> None:
    told(package)
    for path in package.glob("cache/**/outsider.root-*.nbc"):
        _flip(path)
    assert told(package)[0] == ["9.0", "root"]


def test_row_53_a_folder_in_the_place_of_a_file_is_named(package: Path) -> None:
    told(package)
    for path in package.glob("cache/**/*.nbi"):
        _folder(path)
    words, said = told(package)
    assert words == ["9.0", "f", "root"]
    assert f"{package / 'cache'}" in said
    assert "cannot be read: Is a directory" in said


def test_row_53_a_full_disk_under_the_cache(package: Path) -> None:
    """What was compiled serves this run; what is half-written, no other."""
    words, said = told(package, NO_ROOM + PROGRAM)
    assert words == ["9.0", "f", "root"]
    assert said.count("compiled code cannot be kept: File too large") == 1
    assert told(package) == (["9.0", "f", "root"], "")


def test_row_53_a_cache_that_takes_no_files_is_not_promised(package: Path) -> None:
    words, said = told(package, AHEAD, RELNAV_CACHE_DIR="/proc/nowhere")
    assert words == ["9.0"]
    assert "for this run only: /proc/nowhere/" in said
    assert "later runs" not in said
    assert not list(package.rglob("*.nb?"))  # nor beside the source
    words, said = told(package, AHEAD)
    assert "later runs take them from" in said


def test_row_54_no_home_and_no_passwd_entry(package: Path) -> None:
    gone: dict[str, str | None] = {"HOME": None, "RELNAV_CACHE_DIR": None, "XDG_CACHE_HOME": None}
    words, said = told(package, NOBODY + AHEAD, **gone)
    assert words == ["9.0"]
    assert "for this run only: there is no home folder; RELNAV_CACHE_DIR can name" in said
    shutil.rmtree(package / "__pycache__", ignore_errors=True)
    assert [path.name for path in package.iterdir()] == ["outsider.py"]


def test_row_54_numba_told_to_compile_nothing(package: Path) -> None:
    program = (
        "from relnav_graph.cli.main import main\nimport sys\n"
        "try:\n    main(['list'])\nexcept SystemExit as stop:\n    print(stop.code)\n"
    )
    words, said = told(package, program, NUMBA_DISABLE_JIT="1")
    assert words == ["2"]
    assert said.startswith("error: NUMBA_DISABLE_JIT is set")
    assert "Traceback" not in said


def test_only_what_a_person_interrupted_is_interrupted(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """An end of file within the program is no Ctrl-D."""
    from relnav_graph.cli import listing
    from relnav_graph.cli.main import main

    def ends(*_: object, **__: object) -> None:
        raise EOFError("Ran out of input")

    monkeypatch.setattr(listing.command, "callback", ends)
    with pytest.raises(EOFError, match="Ran out of input"):
        main(["list"])

    def stops(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(listing.command, "callback", stops)
    with pytest.raises(SystemExit) as stop:
        main(["list"])
    assert stop.value.code == 130
    assert capsys.readouterr().err.strip() == "interrupted"
