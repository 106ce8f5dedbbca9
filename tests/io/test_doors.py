"""Readers and writers of third parties, and recordings that come in parts."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import relnav_graph
from relnav_graph.core.track import Recording
from relnav_graph.errors import InputError, ModelError
from relnav_graph.io.known import Known
from relnav_graph.io.parts import data_problems, read_data
from relnav_graph.io.readers import readers
from relnav_graph.io.writers import by_suffix, writers
from relnav_graph.maths.instants import Instant
from relnav_graph.registry import modules

#: A reader whose recording its options say: name, epoch, stamps of a sensor, truth, an input.
READER = """
import numpy as np
from relnav_graph.core.measurement import InputSeries, Measurement
from relnav_graph.core.track import Recording, Truth
FILES = True

def read(path, known, stamps=(), sensor="", truth=(), name="", epoch=None, setting=None, role=""):
    t, values = np.array(stamps, dtype=float), np.array(truth, dtype=float)
    one = [Measurement(sensor, s, np.ones((1, 1)), np.zeros(1, dtype=int)) for s in t if sensor]
    settings = {} if epoch is None else {"time": {"epoch": epoch}}
    settings |= {} if setting is None else {"sensors": {"camera": {"fu": setting}}}
    true = Truth(t, {name: values[:, None]}, path.name) if len(values) else None
    if role == "target":
        true = Truth(t, {"target_position": np.zeros((len(t), 3)),
                         "target_velocity": np.zeros((len(t), 3))})
    inputs = {name: InputSeries(name, t[:-1], t[1:], np.ones((len(t) - 1, 1)))} if (
        name and true is None) else {}
    if known.target is not None:
        settings["seen"] = len(known.target.times)
    return Recording(t[:0] if inputs else t, tuple(one), inputs, true, settings)
"""
WRITER = """
SUFFIXES = (".said",)

def write(track, path, loud=False):
    path.write_text("LOUD" if loud else "said")
"""
T0 = "2016-12-31T23:59:50 UTC"

Install = Callable[..., None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Installs distributions of third parties, each with a package of readers or writers."""
    monkeypatch.syspath_prepend(str(tmp_path))
    packages = set[str]()

    def made(package: str, group: str, **files: str) -> None:
        packages.add(package)
        info = tmp_path / f"{package}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[relnav_graph.{group}]\nmine = {package}\n")
        (tmp_path / package).mkdir()
        for name, text in files.items():
            (tmp_path / package / f"{name}.py").write_text(text)
        modules.cache_clear()

    yield made
    modules.cache_clear()
    for name in [n for n in sys.modules if n.partition(".")[0] in packages]:
        del sys.modules[name]


def test_readers_and_writers_of_a_third_party_need_no_change_here(
    install: Install, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    install("third_a", "readers", __init__="", told=READER, _helper="1 / 0")
    install("third_b", "writers", __init__="", said=WRITER)
    install("third_c", "readers", __init__="1 / 0")
    assert readers()["told"] == "third_a.told"
    assert "_helper" not in readers()
    assert "'third_c' of third_c cannot be imported, and is left out" in caplog.text
    (tmp_path / "a.txt").touch()
    found = relnav_graph.read_raw("told", tmp_path / "a.txt", {"stamps": [1.0], "sensor": "s"})
    assert [m.sensor for m in found.measurements] == ["s"]
    with pytest.raises(InputError, match=r"'told': unknown option 'known'; known are .'stamps'"):
        relnav_graph.read_raw("told", tmp_path, {"known": None})
    out = tmp_path / "x.said"
    assert by_suffix(out) == "said"
    track: Any = None  # this writer does not look at it
    relnav_graph.write_track("said", track, out, loud=True)
    assert out.read_text() == "LOUD"
    with pytest.raises(InputError, match=r"'said': unknown option 'soft'; known are .'loud'"):
        relnav_graph.write_track("said", track, out, soft=True)
    with pytest.raises(InputError, match=r"unknown writer 'sad'; known are .*said"):
        relnav_graph.write_track("sad", track, out)
    assert "said" in writers()


def test_a_name_that_is_taken_twice_is_an_error_that_names_both(install: Install) -> None:
    install("third_d", "readers", __init__="", grace_fo=READER)
    with pytest.raises(ModelError, match=r"'grace_fo' is there twice: relnav_graph\.io.*third_d"):
        readers()


def data(**parts: dict[str, Any]) -> dict[str, Any]:
    return {"parts": {name: {"reader": "told", "options": o} for name, o in parts.items()}}


def union(folder: Path, known: Known | None = None, epoch: str = "", **parts: Any) -> Recording:
    when = Instant.parse(epoch) if epoch else None
    return read_data(data(**parts), folder, known or Known(), when)


def test_parts_become_one_in_the_clock_of_the_pass(install: Install, tmp_path: Path) -> None:
    install("third_a", "readers", __init__="", told=READER)
    # About a leap second.
    a = {"stamps": [0.1, 10.1], "sensor": "a", "epoch": T0, "setting": 2}
    b = {"stamps": np.arange(8.0).tolist(), "truth": np.arange(8.0) * 2, "name": "x"}
    b |= {"epoch": "2016-12-31T23:59:58 UTC", "setting": 2}
    c = {"stamps": [100.0, 110.1], "name": "gyro"}
    known = Known(origin=100.0)
    found = union(tmp_path, known, a=a, b=b, c=c)
    assert found.times.tolist() == [0.1, 10.1]
    assert found.inputs["gyro"].t_end.tolist() == [10.1]
    assert found.truth is not None
    np.testing.assert_allclose(found.truth.values["x"][:, 0], [np.nan, 2 * 2.1], rtol=1e-14)
    assert found.settings["sensors"] == {"camera": {"fu": 2}}
    assert Instant.parse(found.settings["time"]["epoch"]) == Instant.parse(T0).after(-100.0)
    later = union(tmp_path, known, "2017-01-01T00:00:00 UTC", a=a, b=b, c=c)
    assert later.times.tolist() == [-10.9, -0.9]  # 11 s later: one of them leaps
    assert later.inputs["gyro"].t_start[0] == 0.0
    seen = union(tmp_path, a=a, t={"stamps": [1.0, 2.0], "role": "target"})
    assert seen.settings["seen"] == 2
    simulated = {**data(a=a, b=b), "simulate": ["s"]}
    assert len(read_data(simulated, tmp_path, Known()).times) == 10


def test_what_two_parts_say_both_is_refused_with_both_named(
    install: Install, tmp_path: Path
) -> None:
    install("third_a", "readers", __init__="", told=READER)
    one, true = {"stamps": [0.0, 1.0]}, {"truth": [1.0, 2.0], "name": "x"}
    for a, b, says in (
        ({"sensor": "s"}, {"sensor": "s"}, r"sensor 's' at t = 0.0 s: found in data.parts.a and"),
        ({"name": "gyro"}, {"name": "gyro"}, r"input 'gyro': found in data.parts.a and in data.p"),
        (true, true, r"truth 'x': found in data.parts.a and in data.parts.b"),
        ({"setting": 1}, {"setting": 2}, r"camera.fu: data.parts.a says 1, and data.parts.b 2"),
        ({"role": "target"}, {"role": "target"}, "found two targets, expected one"),
    ):
        with pytest.raises(InputError, match=says):
            union(tmp_path, a={**one, **a}, b={**one, **b})
    with pytest.raises(InputError, match=r"data\.parts\.a: found the target alone"):
        union(tmp_path, a={**one, "role": "target"})
    wrong = data_problems(data(a={"stamp": 1}) | {"simulate": []})
    assert wrong[0][0] == "data.parts.a"
    assert "unknown option 'stamp'" in wrong[0][1]


def test_stamps_of_other_clocks_are_declared(tmp_path: Path) -> None:
    """GPS and Unix seconds of tables; the latter not across a leap second."""
    known = Known(inputs={"gyro": ("x_rad_s",)})
    for clock, begin, first in (
        ("gps", 1467331200.0, "2026-07-06T00:00:00 GPS"),
        ("unix", 1600000000.0, "2020-09-13T12:26:40 UTC"),
    ):
        (tmp_path / "gyro.csv").write_text(f"t_s,x_rad_s\n{begin},0\n{begin + 0.5},1\n")
        found = read_data({"reader": "tables", "options": {"clock": clock}}, tmp_path, known)
        assert found.epoch is not None
        t = found.inputs["gyro"].t_start[0]
        assert found.epoch.after(t) == Instant.parse(first)
        placed = read_data(
            {"reader": "tables", "options": {"clock": clock}},
            *(tmp_path, known, Instant.parse(first)),
        )
        np.testing.assert_array_equal(placed.inputs["gyro"].t_end, [0.5])
    (tmp_path / "gyro.csv").write_text("t_s,x_rad_s\n1483228799,0\n1483228800,1\n")
    for options, says in (
        ({"clock": "unix"}, "across a leap second, which they do not tell"),
        ({"clock": "mine"}, "found 'mine', expected one of none, unix, gps"),
        ({"clock": "gps", "epoch": T0}, "expected one of them"),
        ({"only": ["camera"]}, "only: found 'camera', expected some of gyro"),
    ):
        with pytest.raises(InputError, match=says):
            read_data({"reader": "tables", "options": options}, tmp_path, known)
    with pytest.raises(InputError, match="found no table of wheel"):
        read_data({"reader": "tables"}, tmp_path, Known(inputs={"wheel": ("x",)}))
