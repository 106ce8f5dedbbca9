"""The report: one file that needs nothing else, and says what the folder holds."""

from __future__ import annotations

import base64
import io
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from outside import Outside
from passes import ZHANG
from PIL import Image

from relnav_graph.cli.main import main
from relnav_graph.errors import InputError
from relnav_graph.report import cells
from relnav_graph.report import page as pages
from relnav_graph.report import scene as scenes
from relnav_graph.report.contents import PassContents, StudyContents, read_contents
from relnav_graph.report.page import MAX_BYTES, render
from relnav_graph.study.record import RunRecord

SHORT = ("--set", "time.epochs=12", "-e", "iekf", "-e", "batch")


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stopped:
        main([str(a) for a in arguments])
    assert isinstance(stopped.value.code, int)
    return stopped.value.code


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a study of three runs, with its report."""
    out = tmp_path_factory.mktemp("report") / "study"
    assert run("study", ZHANG, *SHORT, "--runs", 3, "-j", 1, "-o", out) == 0
    assert run("report", out) == 0
    return out


@pytest.fixture(scope="module")
def one_pass(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a comparison, with its report."""
    out = tmp_path_factory.mktemp("report") / "pass"
    with pytest.MonkeyPatch.context() as patch:  # its files are tested elsewhere
        patch.setattr("relnav_graph.figures.save_pass", lambda *_: [])
        assert run("compare", ZHANG, *SHORT, "--seed", 4, "-o", out) == 0
    assert run("report", out) == 0
    return out


def page_of(folder: Path) -> str:
    return (folder / "report.html").read_text("utf-8")


@pytest.fixture(params=["study", "one_pass"])
def page(request: pytest.FixtureRequest) -> str:
    return page_of(request.getfixturevalue(request.param))


def test_refers_to_nothing_outside_itself(page: str) -> None:
    outside = Outside(page)
    assert outside.found == []
    # What scripts may ask for, the browser refuses.
    assert outside.policy["default-src"] == ["'none'"]
    assert outside.policy["img-src"] == ["data:", "blob:"]
    allowed = {"'none'", "'unsafe-inline'", "data:", "blob:"}
    assert {s for sources in outside.policy.values() for s in sources} <= allowed
    policy = page.index("Content-Security-Policy")
    assert policy < page.index("<style") < page.index("<script")
    assert len(page.encode()) < MAX_BYTES


@pytest.mark.parametrize(
    "text",
    [
        '<img src="https://x/y.png">',
        '<script src="plotly.js"></script>',
        '<link rel="icon" href="data:,">',
        "<style>@import 'x.css';</style>",
        '<style>a { background: url("//x/y") }</style>',
        '<p style="background:url(y.png)">',
        '<a href="other.html">',
    ],
)
def test_the_test_of_references_finds_each_kind(text: str) -> None:
    assert Outside(text).found


def test_every_link_of_the_contents_leads_to_a_chapter(page: str) -> None:
    links = re.findall(r'href="#([^"]+)"', page)
    assert len(links) >= 4
    for name in links:
        assert page.count(f'id="{name}"') == 1, name


def test_images_are_whole_and_every_zoomable_figure_has_its_data(page: str) -> None:
    images = re.findall(r'src="data:image/png;base64,([^"]*)"', page)
    assert len(images) > 10
    for text in images:
        with Image.open(io.BytesIO(base64.b64decode(text))) as picture:
            picture.verify()
    keys = re.findall(r'data-figure="([^"]+)"', page)
    assert len(keys) > 10
    assert sorted(keys) == sorted(re.findall(r'type="application/json" id="([^"]+)"', page))


def text_of(page: str) -> str:
    """What a reader sees, without tags, styles and scripts."""
    text = re.sub(r"<(script|style)\b.*?</\1>", " ", page, flags=re.S)
    text = re.sub(r"<[^>]*>", " ", text)
    return " ".join(text.replace("&#34;", '"').replace("&#39;", "'").split())


def test_a_study_is_told_in_full(study: Path) -> None:
    found = json.loads((study / "summary.json").read_text())
    text = text_of(page_of(study))
    for sentence in found["verdict"]["text"]:
        assert " ".join(sentence.split()) in text
    for row in found["estimators"].values():
        for state in row["states"].values():
            for key in ("rmse", "bound", "sigma"):
                assert cells.number(state[key]) in text
    (pair,) = found["paired"]
    gain = pair["states"]["relative_position"]["improvement"]
    assert f"{100 * gain:.1f} %".replace("-", "−") in text
    assert "iekf (filtered) to batch (smoothed)" in text
    for noise in found["verdict"]["noises"]:
        assert noise["noise"] in text
    assert "relnav study" in text
    assert "--runs 3 -e iekf -e batch" in text
    for name, version in found["versions"].items():
        assert f"{name} {version}" in text
    for heading in ("Filtered", "Smoothed", "Verdict", "Paired differences", "Worst runs",
                    "Filter against smoother", "Provenance"):  # fmt: skip
        assert re.search(rf"<h[23]>{heading}</h[23]>", page_of(study)), heading
    assert "[processes.relative_orbit]" in text
    assert "None of 3 runs." in text


def test_filtered_and_smoothed_rows_share_no_table(study: Path) -> None:
    found = cells.results(read_contents(study).summary)
    names = {kind: {row[0].text for row in t.rows if len(row) > 1} for kind, t in found.items()}
    assert names == {"filtered": {"iekf"}, "smoothed": {"batch"}}


def test_the_worst_run_is_the_one_of_the_largest_anees(study: Path) -> None:
    content = read_contents(study)
    assert isinstance(content, StudyContents)
    assert content.judged == "batch"
    anees = content.found.rows["batch"].own["anees"]
    assert content.worst[0].run == int(np.argmax(anees))
    assert [w.anees for w in content.worst] == sorted(anees, reverse=True)
    assert content.worst[0].command.endswith(f"--run {content.worst[0].run}")


def test_a_run_made_again_has_the_numbers_of_the_study(study: Path) -> None:
    content = read_contents(study)
    assert isinstance(content, StudyContents)
    again = content.remake(1)
    assert again is not None
    state = again.summary["estimators"]["batch"]["states"]["relative_position"]
    assert state["rmse"] == pytest.approx(
        content.found.rows["batch"].of("relative_position", "rmse")[1], rel=1e-9
    )


def test_a_run_that_was_lost_is_named_with_its_command(study: Path, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(study, folder)
    summary = json.loads((folder / "summary.json").read_text())
    lost = {"run": 3, "estimator": None, "status": "failed", "message": "its worker died"}
    summary["failed"].append({**lost, "command": ""})
    (folder / "summary.json").write_text(json.dumps(summary))
    content = read_contents(folder)
    assert isinstance(content, StudyContents)
    (one,) = content.summary["failed"]
    assert (one["run"], one["message"]) == (3, "its worker died")
    table = cells.bad_runs(content.summary["failed"])
    assert table.rows[0][-1].text.endswith("--run 3")
    assert "--runs 4" in content.command


def test_rows_that_diverged_leave_a_report(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One in a run, another in all: both are named, and no figure breaks."""
    folder = tmp_path / "copy"
    shutil.copytree(study, folder)
    bad = {"kind": "smoothed", "status": "diverged", "message": "it grew <without> bounds"}
    for file in sorted((folder / "runs").iterdir()):
        record = RunRecord.from_bytes(file.read_bytes(), "")
        scalars = json.loads(json.dumps(record.scalars))
        scalars["rows"]["batch"] |= bad
        del scalars["noise"]["batch"]
        scalars["mcreynolds"] = {}
        if scalars["run"] == 1:
            scalars["rows"]["iekf"] |= {**bad, "kind": "filtered"}
        file.write_bytes(RunRecord(scalars, record.series).to_bytes())
    content = read_contents(folder)
    assert isinstance(content, StudyContents)
    assert content.judged == "iekf"
    assert sorted(w.run for w in content.worst) == [0, 2]
    monkeypatch.setattr(pages, "image", lambda figure: "data:,")
    monkeypatch.setattr(StudyContents, "remake", lambda *_: None)
    text = pages.render(content, "plotly")
    assert text.count("it grew &lt;without&gt; bounds") == 4
    assert text.count("--run 1 -e iekf") == 1
    assert "could not be made again" in text
    assert Outside(text).found == []


def test_a_pass_is_told_in_full(one_pass: Path) -> None:
    found = json.loads((one_pass / "summary.json").read_text())
    text = text_of(page_of(one_pass))
    for row in found["estimators"].values():
        assert cells.number(row["states"]["relative_position"]["rmse"]) in text
    assert "relnav compare" in text
    assert "--seed 4" in text
    assert "Verdict" not in text
    assert "What is simulated" in text
    content = read_contents(one_pass)
    assert isinstance(content, PassContents)
    recorded = replace(content, simulated=False)  # though it could have been
    assert "What is simulated" not in render(recorded, plotly="")


def test_without_plotly_there_are_images_and_a_word_on_the_extra(
    one_pass: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "plotly", None)
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    monkeypatch.setattr(pages, "image", lambda figure: "data:,")
    text = pages.render(read_contents(one_pass))
    assert "<script" not in text
    assert "relnav-graph[report]" in text
    assert len(text) < 2_000_000
    assert Outside(text).found == []


def test_plotly_takes_every_figure(page: str) -> None:
    """Its Python side knows every property, and refuses what it does not know."""
    plotly = pytest.importorskip("plotly.graph_objects", reason="needs the extra report")
    texts = re.findall(r'<script type="application/json" id="[^"]+">(.*?)</script>', page, re.S)
    for text in texts:
        plotly.Figure(json.loads(text))


def test_the_scene_shows_the_true_pass(one_pass: Path) -> None:
    content = read_contents(one_pass)
    assert isinstance(content, PassContents)
    assert content.truth is not None
    scene = scenes.make_scene(content)
    assert scene is not None
    assert (scene.frame, scene.turning, scene.true) == ("o", True, True)
    assert list(scene.rows) == ["iekf", "batch"]
    frames = scene.figure["frames"]
    assert len(frames) == 12
    chaser = [[f["data"][-1][a][0] for a in "xyz"] for f in frames]
    np.testing.assert_allclose(chaser, content.truth.values["relative_position"])
    # Below: the mark in the strip of NEES, and the ellipsoid of batch about its enlarged error.
    assert scene.strip
    assert [f["data"][-2]["x"][0] for f in frames] == content.truth.t.tolist()
    batch = next(track for track in content.tracks if track.name == "batch")
    error = batch.value("relative_position") - content.truth.values["relative_position"]
    for k, frame in enumerate(frames):
        centre = np.array(chaser[k]) + scene.error_scale * error[k]
        d = np.column_stack([frame["data"][7][a] for a in "xyz"]) - centre
        inside = np.linalg.solve(batch.covariance("relative_position")[k], d.T).T
        np.testing.assert_allclose((d * inside).sum(axis=1), 9 * scene.error_scale**2, rtol=1e-6)
    # The blue axis is the third column of R_ot.
    axis = np.array([[f["data"][4][a][1] for a in "xyz"] for f in frames])
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    np.testing.assert_allclose(axis, content.truth.values["target_attitude"][:, :, 2], atol=1e-12)
    points = np.column_stack([frames[0]["data"][1][a] for a in "xyz"]) / scene.target_scale
    R = content.truth.values["target_attitude"][0]
    expected = content.scenario.sensors["beacons"].points  # type: ignore[attr-defined]
    np.testing.assert_allclose(points @ R, expected, atol=1e-12)


def _break_record(folder: Path) -> None:
    path = folder / "runs" / "000001.npz"
    path.write_bytes(path.read_bytes()[:-200])


DAMAGE: list[tuple[str, Callable[[Path], Any], str]] = [
    ("study", _break_record, "not a readable record"),
    ("study", lambda f: (f / "study.json").write_text("{"), "cannot be read"),
    ("study", lambda f: (f / "study.json").unlink(), "expected the folder that"),
    ("study", lambda f: (f / "summary.json").write_text("{}"), "damaged"),
    ("study", lambda f: shutil.rmtree(f / "runs"), "no run of the study is done"),
    ("one_pass", lambda f: (f / "pass.json").write_text("[]"), "not a manifest of a pass"),
    ("one_pass", lambda f: (f / "results.nc").unlink(), "results.nc"),
    ("one_pass", lambda f: (f / "results.nc").write_bytes(b"CDF"), "results.nc"),
]


@pytest.mark.parametrize(("kind", "damage", "message"), DAMAGE)
def test_damaged_folders_are_refused(
    kind: str,
    damage: Callable[[Path], Any],
    message: str,
    request: pytest.FixtureRequest,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(request.getfixturevalue(kind), folder)
    (folder / "report.html").unlink()
    damage(folder)
    assert run("report", folder) == 2
    assert message in capsys.readouterr().err
    assert not (folder / "report.html").exists()


def test_a_manifest_of_another_version_is_refused(one_pass: Path, tmp_path: Path) -> None:
    found = json.loads((one_pass / "pass.json").read_text())
    (tmp_path / "pass.json").write_text(json.dumps({**found, "format_version": 2}))
    with pytest.raises(InputError, match="found format version 2, expected 1"):
        read_contents(tmp_path)
    del found["seed"]
    (tmp_path / "pass.json").write_text(json.dumps(found))
    with pytest.raises(InputError, match="damaged: seed: missing"):
        read_contents(tmp_path)


def test_what_is_no_folder_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("report", tmp_path / "nothing") == 2
    assert "no such folder" in capsys.readouterr().err
    assert run("report", tmp_path) == 2
    assert "expected the folder that relnav study, compare or smooth wrote" in (
        capsys.readouterr().err
    )


def _chromium() -> str | None:
    names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
    return next((path for path in map(shutil.which, names) if path), None)


#: In place of the browser's: everything is in view. A page without a window has no view.
ALL_IN_VIEW = """<body><script>
window.IntersectionObserver = class {
  constructor(call) { this.call = call; }
  observe(target) { this.call([{ isIntersecting: true, target }]); }
  unobserve() {}
};
</script>"""


def _open(page: str, folder: Path) -> tuple[str, list[str]]:
    """The page as a browser has it after its scripts, and what its console says."""
    file = folder / "page.html"
    file.write_text(page, "utf-8")
    options = ["--headless", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader",
               "--enable-unsafe-swiftshader", f"--user-data-dir={folder / 'profile'}",
               "--enable-logging=stderr", "--v=0", "--virtual-time-budget=10000",
               "--dump-dom"]  # fmt: skip
    done = subprocess.run(
        [str(_chromium()), *options, file.as_uri()],
        capture_output=True,
        text=True,
        timeout=180,
        check=True,
    )
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    hint = "willReadFrequently"  # of a canvas, on speed
    return done.stdout, [line for line in console if hint not in line]


@pytest.mark.skipif(_chromium() is None, reason="no Chromium or Chrome is installed")
def test_a_browser_opens_it_without_an_error(study: Path, tmp_path: Path) -> None:
    page = page_of(study).replace("<body>", ALL_IN_VIEW)
    drawn, console = _open(page, tmp_path)
    assert console == []
    places = re.findall(r'<div class="figure[^"]*js-plotly-plot[^"]*" data-figure', drawn)
    assert len(places) == page.count("data-figure=")
    assert drawn.count("gl-container") >= len(places)
    assert "WebGL is not supported" not in text_of(drawn)


@pytest.mark.skipif(_chromium() is None, reason="no Chromium or Chrome is installed")
def test_a_browser_refuses_to_fetch_and_says_so(tmp_path: Path, study: Path) -> None:
    """What the test above looks at does show errors, and the policy holds."""
    head, _, rest = page_of(study).partition("<script>")
    rest = rest[rest.rindex("</body>") :]
    script = "<script>fetch('https://example.org/'); new Image().src = 'https://example.org/x';"
    _, console = _open(head + script + "</script>" + rest, tmp_path)
    assert sum("Content Security Policy" in line for line in console) >= 2
