"""Row 36, further: scenarios that ask for what no machine has, or hold what no model can mean."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from pathlib import Path

import pytest
from passes import FIX, ZHANG, linear_problem, relnav

from relnav_graph.errors import InputError
from relnav_graph.io.dataset import read_dataset
from relnav_graph.memory import check_room
from relnav_graph.scenario.build import load_scenario, make_scenario
from relnav_graph.scenario.schema import ScenarioError

Capture = pytest.CaptureFixture[str]


def refused(capsys: Capture, *given: object) -> list[str]:
    """What is said of a command that must be refused at once, in lines."""
    begun = time.monotonic()
    code, out, err = relnav(capsys, *given)
    assert (code, out) == (2, ""), err
    assert "Traceback" not in err
    assert time.monotonic() - begun < 10
    assert len(err) < 3000
    return err.splitlines()


# --- memory ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("path", "value", "found"),
    [
        ("time.epochs", "1000000000000", "found 1000000000000 epochs"),
        ("time.epochs", "1" + 30 * "0", "epochs, which take at least"),
        ("inputs.gyro.period", '"1e-9 s"', "found a period of 1e-09 s, 6e+12 samples"),
        ("inputs.gyro.period", "1e-320", "GiB of memory"),
    ],
)
def test_row_36_more_memory_than_the_machine_has(
    capsys: Capture, path: str, value: str, found: str
) -> None:
    """Already `validate` says so; no memory is taken."""
    for command in ("validate", "compare"):
        said = refused(capsys, command, ZHANG, "--set", f"{path}={value}")
        assert any(line.startswith(f"  {path}: ") and found in line for line in said), said


@pytest.mark.parametrize("value", ["1e-9", "1e-300"])
def test_row_36_more_steps_than_the_machine_can_draw(capsys: Capture, value: str) -> None:
    said = refused(capsys, "compare", ZHANG, "--set", f"truth.max_step={value}")
    assert f"truth.max_step: in this pass: found max_step = {value}" in said[-1].replace(
        "-09", "-9"
    )


def test_room_is_what_this_process_may_use() -> None:
    check_room("nothing much", 1000)
    with pytest.raises(InputError, match="found too many, which take at least 8e"):
        check_room("too many", 2.0**30 * 1e30)
    with pytest.raises(InputError):
        check_room("what is no number", float("nan"))


# --- TOML -----------------------------------------------------------------------------------

DEEP = "[" * 100_000 + "]" * 100_000
TABLES = {
    "an integer of 400 digits": ("seed = 1" + 400 * "0", "seed: found an integer of 1329 bits"),
    "one of 5000": ("\n\nseed = 1" + 5000 * "0", "integer of too many digits (at line 3)"),
    "a hexadecimal one": ("seed = 0x1" + 100_000 * "0", "seed: found an integer of 400001 bits"),
    "in a list": ("evaluate = [0.1, 1" + 350 * "0" + "]", "evaluate[1]: found an integer"),
    "arrays in arrays": (f"x = {DEEP}", "nested more than 64 deep"),
    "tables in tables": ("x = " + 200 * "{a=" + "1" + 200 * "}", "nested more than 64 deep"),
    "a dotted key": (100_000 * "a." + "a = 1", "a key of more than 64 parts (at line 1)"),
    "with spaces": (
        "x=1\n" + 100_000 * "a . " + "a = 1",
        "a key of more than 64 parts (at line 2)",
    ),
    "quoted": (100_000 * '"a".' + "a = 1", "a key of more than 64 parts (at line 1)"),
    "a dotted header": ("[" + 100_000 * "a." + "a]", "a key of more than 64 parts (at line 1)"),
    "in a table": ("x = {" + 100_000 * "a." + "a = 1}", "a key of more than 64 parts (at line 1)"),
    "a NUL in a text": ('title = "a\\u0000b"', "title: found 'a\\x00b', expected text without NUL"),
    "in a key": ('"a\\u0000b" = 1', "a key: found 'a\\x00b', expected text without NUL"),
    "in a base": ('base = "a\\u0000b"', "base: found 'a\\x00b', expected text without NUL"),
    "raw": ('title = "a\0b"', "not valid TOML"),
    "a base that is no file": ('base = "."', "is a folder, expected a scenario"),
    "a base that is itself": ('base = "wrong.toml"', "base: found 'wrong.toml', expected another"),
    "a base without end": ('base = "/dev/zero"', "holds more than 16777216 bytes"),
}


@pytest.mark.parametrize("case", TABLES)
def test_row_36_toml_that_no_scenario_is(tmp_path: Path, capsys: Capture, case: str) -> None:
    text, says = TABLES[case]
    path = tmp_path / "wrong.toml"
    path.write_text(text, "utf-8")
    said = refused(capsys, "validate", path)
    assert any(says in line for line in said), said


def test_row_36_bases_in_a_circle_or_without_end(tmp_path: Path, capsys: Capture) -> None:
    for i in range(40):
        (tmp_path / f"{i}.toml").write_text(f'base = "{i + 1}.toml"')
    said = refused(capsys, "validate", tmp_path / "0.toml")
    assert "base: found more than 16 files" in said[-1]
    (tmp_path / "3.toml").write_text('base = "0.toml"')
    said = refused(capsys, "validate", tmp_path / "0.toml")
    assert "base: found '0.toml', expected another file" in said[-1]
    for one, other in (("a", "b"), ("b", "a")):
        (tmp_path / f"{one}.toml").symlink_to(f"{other}.toml")
    (tmp_path / "3.toml").write_text('base = "a.toml"')
    assert "a.toml" in " ".join(refused(capsys, "validate", tmp_path / "0.toml"))


@pytest.mark.parametrize(
    "assignment",
    [
        "seed=1" + 400 * "0",
        "seed=1" + 5000 * "0",
        f"seed={DEEP}",
        1000 * "a." + "a=1",
        "x={" + 100_000 * "a." + "a = 1}",
        'title="a\\u0000b"',
    ],
)
def test_row_36_settings_likewise(capsys: Capture, assignment: str) -> None:
    assert refused(capsys, "validate", ZHANG, "--set", assignment)[0].startswith("error: --set")


def test_row_36_a_byte_order_mark_is_none_of_our_business(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "marked.toml"
    path.write_bytes(b"\xef\xbb\xbf" + ZHANG.read_bytes().replace(b"\n", b"\r\n"))
    assert relnav(capsys, "validate", path)[0] == 0


# --- units ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "unit",
    [
        *("m^1000000", "m**1000000", "km^400", "s^-1000000000", "m^" + 1000 * "9"),
        *(200 * "km*" + "km", "*".join(40 * ["mm^12"]), "m" + 100_000 * "*"),
    ],
)
def test_row_36_units_to_absurd_powers(capsys: Capture, unit: str) -> None:
    said = refused(capsys, "validate", ZHANG, "--set", f'time.step="10 {unit}"')
    assert any(line.startswith("  time.step: unit '") for line in said), said


# --- names ----------------------------------------------------------------------------------

NAMES = ["../out", "a/b", "$x$", "a b", "", ".hidden", "-e", "a\nb", "x" * 49, "ü/", "a\\b", "=1"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("section", ["sensors", "processes"])
def test_row_36_names_are_names(tmp_path: Path, capsys: Capture, section: str, name: str) -> None:
    """They are those of files, too: a sensor "../out" would read and write another folder's."""
    old = {"sensors": "beacons", "processes": "target"}[section]
    text = ZHANG.read_text("utf-8").replace(f"{section}.{old}]", f"{section}.{_key(name)}]")
    path = tmp_path / "named.toml"
    path.write_text(text, "utf-8")
    said = refused(capsys, "validate", path)
    assert any(line.startswith(f"  {section}: found {name[:60]!r} as the name") for line in said)


def _key(name: str) -> str:
    return '"' + name.replace("\\", "\\\\").replace("\n", "\\n") + '"'


@pytest.mark.parametrize("name", ["gyro", "epochs", "truth_target_attitude"])
def test_row_36_a_sensor_named_as_another_table(tmp_path: Path, capsys: Capture, name: str) -> None:
    path = tmp_path / "named.toml"
    path.write_text(ZHANG.read_text("utf-8").replace("sensors.beacons]", f"sensors.{name}]"))
    assert f"  sensors.{name}: the name is that of another table" in "\n".join(
        refused(capsys, "validate", path)
    )


def test_row_36_names_that_letters_of_any_language_make(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "Übung.toml"
    text = ZHANG.read_text("utf-8").replace("sensors.beacons]", 'sensors."Bake_3.größe"]')
    path.write_text(text, "utf-8")
    assert relnav(capsys, "validate", path)[0] == 0


def test_row_36_a_file_name_that_is_not_utf8_fails_before_the_work(
    tmp_path: Path, capsys: Capture
) -> None:
    path = tmp_path / os.fsdecode(b"caf\xe9.toml")
    path.write_bytes(ZHANG.read_bytes())
    said = refused(capsys, "compare", path, "-o", tmp_path / "out")
    assert "caf\\xe9.toml', expected UTF-8" in said[0]
    said = refused(capsys, "compare", ZHANG, "-o", tmp_path / os.fsdecode(b"caf\xe9"))
    assert "caf\\xe9', expected UTF-8" in said[0]
    assert sorted(p.name for p in tmp_path.iterdir()) == [path.name]
    assert load_scenario(path).name == r"caf\xe9"
    with pytest.raises(ScenarioError, match="title: found 'a"):
        make_scenario({**load_scenario(ZHANG).raw, "title": "a\0b"}, "named")


def test_row_36_a_problem_and_a_data_set_have_the_same_rule(tmp_path: Path) -> None:
    for name in ("../out", "$x$"):
        with pytest.raises(InputError, match="as the name of a table"):
            read_dataset(tmp_path, {name: FIX}, {}, {})
        with pytest.raises(InputError, match="as the name of a sensor"):
            replace(linear_problem(0.1), sensors={name: FIX}, epochs=())


# --- folders and help -----------------------------------------------------------------------


@pytest.mark.parametrize("command", ["compare", "explain", "study", "stream", "simulate"])
def test_row_36_a_folder_for_a_scenario(tmp_path: Path, capsys: Capture, command: str) -> None:
    extra = ("-o", tmp_path / "out") if command == "simulate" else ()
    said = refused(capsys, command, tmp_path, *extra)
    assert f"{tmp_path}: is a folder, expected a scenario (a TOML file)" in said[-1]


@pytest.mark.parametrize("command", ["convert", "study"])
def test_help_keeps_its_lines(capsys: Capture, command: str) -> None:
    code, out, _ = relnav(capsys, command, "-h")
    assert code == 0
    assert "\\b" not in out
    line = {"convert": "  results.nc        -> folder", "study": "  relnav study --merge OUT1"}
    assert any(text.startswith(line[command]) for text in out.splitlines())
