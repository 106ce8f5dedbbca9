"""Scenarios that come with the package are found by name, wherever one works."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from passes import EXPERIMENTS, relnav

from relnav_graph.errors import InputError
from relnav_graph.scenario.build import load_scenario
from relnav_graph.scenario.shipped import by_name, shipped

Capture = pytest.CaptureFixture[str]


def test_every_scenario_goes_into_the_wheel_under_its_name() -> None:
    """Bases beside them, too: see [tool.hatch.build.targets.wheel.force-include]."""
    settings = tomllib.loads((EXPERIMENTS.parent / "pyproject.toml").read_text())
    included = settings["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    files = {p.relative_to(EXPERIMENTS).as_posix() for p in EXPERIMENTS.rglob("*.toml")}
    files.add("scenario.schema.json")
    expected = {f"experiments/{name}": f"relnav_graph/scenarios/{name}" for name in files}
    assert included == expected


def test_names_are_found_anywhere_and_a_path_beats_a_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    scenario = load_scenario("zhang2015_close")
    assert scenario.raw == load_scenario(EXPERIMENTS / "zhang2015_close.toml").raw
    assert scenario.name == "zhang2015_close"
    code, out, _ = relnav(capsys, "validate", "zhang2015")
    assert code == 0
    code, out, _ = relnav(capsys, "list")
    assert code == 0
    assert "  zhang2015_stress " in out
    (tmp_path / "zhang2015").write_text('title = "mine"\n')
    assert by_name(Path("zhang2015")) == Path("zhang2015")
    with pytest.raises(InputError, match=r"zhang2015: .*\n.*processes: missing"):
        load_scenario("zhang2015")


def test_a_name_that_is_none_is_told_what_is_near(capsys: Capture) -> None:
    for given in ("zhang2105", "elsewhere/zhang2015.toml"):
        code, _, err = relnav(capsys, "compare", given)
        assert code == 2
        assert "No such file" in err
        assert "did you mean zhang2015, which comes with the package?" in err
    assert "zhang2015" in shipped()
    assert by_name(Path("zhang2015.toml")) == Path("zhang2015.toml")
