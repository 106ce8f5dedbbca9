"""`relnav stream` as a command: exit codes, options, and where lines come from."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from passes import relnav
from streams import RELNAV, assert_close, toy

Capture = pytest.CaptureFixture[str]


def test_refusals_end_with_3_unless_allowed(tmp_path: Path, capsys: Capture) -> None:
    scenario, lines = toy(tmp_path)
    path, data, out = tmp_path / "toy.toml", tmp_path / "lines", tmp_path / "out"
    data.write_text("\n".join([*lines, "nonsense"]) + "\n", "utf-8")
    code, _, err = relnav(capsys, "stream", path, "--from", data, "-o", out)
    assert code == 3
    assert "(unnamed): not used: 1 not a line of JSON" in err
    assert relnav(capsys, "stream", path, "--from", data, "-o", out, "--allow-rejects")[0] == 0
    data.write_text("\n".join(lines) + "\n", "utf-8")
    assert relnav(capsys, "stream", path, "--from", data, "-o", out)[0] == 0
    assert len(out.read_text().splitlines()) == scenario.file.time.epochs


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--from", "{here}", "-e", "batch"], "cannot be driven online"),
        (["-e", "kalman"], "found kind 'kalman'"),
        (["--from", "nowhere"], "--from nowhere: No such file"),
        (["--from", "tcp:0"], "expected tcp:PORT"),
        (
            ["--from", "{here}", "-o", "/proc/nowhere/out"],
            "-o /proc/nowhere/out: cannot be written",
        ),
        (["--from", "{here}", "--journal", "/proc/nowhere"], "--journal /proc/nowhere: "),
    ],
)
def test_wrong_options_end_with_2(
    tmp_path: Path, capsys: Capture, arguments: list[str], says: str
) -> None:
    _, lines = toy(tmp_path)
    data = tmp_path / "lines"
    data.write_text(lines[0] + "\n", "utf-8")
    arguments = [str(data) if a == "{here}" else a for a in arguments]
    code, _, err = relnav(capsys, "stream", tmp_path / "toy.toml", *arguments)
    assert code == 2
    assert says in err


def test_a_growing_file_is_followed(tmp_path: Path, capsys: Capture) -> None:
    """Also while a line is half written; each line out comes without waiting for the next in."""
    _, lines = toy(tmp_path)
    data, out = tmp_path / "lines", tmp_path / "out"
    data.write_text(lines[0], "utf-8")

    def grow() -> None:
        with data.open("a", encoding="utf-8") as file:
            for line in lines[1:21]:
                file.write("\n" + line[:30])
                file.flush()
                time.sleep(0.002)
                file.write(line[30:])
            file.write("\n")

    writer = threading.Thread(target=grow)
    writer.start()
    options = "--from", data, "--follow", "--for", "1", "-o", out
    assert relnav(capsys, "stream", tmp_path / "toy.toml", *options)[0] == 0
    writer.join()
    data.write_text("\n".join(lines[:21]) + "\n", "utf-8")
    whole = tmp_path / "whole"
    assert relnav(capsys, "stream", tmp_path / "toy.toml", "--from", data, "-o", whole)[0] == 0
    last = [json.loads(p.read_text().splitlines()[-1]) for p in (out, whole)]
    assert_close(last[:1], last[1:])


def test_a_socket_on_loopback(tmp_path: Path, capsys: Capture) -> None:
    _, lines = toy(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]

    def send() -> None:
        while True:
            try:
                with socket.create_connection(("127.0.0.1", port)) as connection:
                    connection.sendall("\n".join(lines).encode())  # the last one has no end
                    return
            except ConnectionRefusedError:
                time.sleep(0.01)

    sender = threading.Thread(target=send)
    sender.start()
    out = tmp_path / "out"
    assert (
        relnav(capsys, "stream", tmp_path / "toy.toml", "--from", f"tcp:{port}", "-o", out)[0] == 0
    )
    sender.join()
    assert len(out.read_text().splitlines()) == 40


def test_a_reader_that_leaves_ends_it(tmp_path: Path) -> None:
    _, lines = toy(tmp_path)
    data = tmp_path / "lines"
    data.write_text("\n".join(lines) + "\n", "utf-8")
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "wb") as pipe:
        done = subprocess.run(
            [*RELNAV, "stream", "toy.toml", "--from", "lines"],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": os.pathsep.join([*sys.path])},
            stdout=pipe,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            timeout=120,
        )
    assert done.returncode == 3
    assert done.stderr == "the reader of the output has left\n"
