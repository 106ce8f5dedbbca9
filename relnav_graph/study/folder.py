"""The folder of a study: a manifest, and one record for each run that is done.

A record appears complete or not at all, so a study that was killed goes on where it was.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from relnav_graph.errors import InputError
from relnav_graph.io.atomic import atomic
from relnav_graph.scoring.metrics import versions
from relnav_graph.study.record import RunRecord
from relnav_graph.study.runs import StudySpec

__all__ = ["StudyFolder"]

_FORMAT, _VERSION = "relnav-graph study", 1


def _difference(path: str, found: Any, expected: Any) -> str | None:
    """The first place where two trees differ, in words."""
    if isinstance(found, Mapping) and isinstance(expected, Mapping):
        for key in sorted({*found, *expected}):
            inner = f"{path}.{key}" if path else key
            text = _difference(inner, found.get(key), expected.get(key))
            if text:
                return text
        return None
    return None if found == expected else f"{path}: found {found!r}, expected {expected!r}"


class StudyFolder:
    """The records of a study on disk.

    rerun: the command that makes one run alone, without its ``--run`` number; a folder that
    exists keeps the one it has. Raises InputError on a folder of another study.
    """

    def __init__(self, path: Path, spec: StudySpec, rerun: str = "") -> None:
        self.path, self.spec, self.rerun = path, spec, rerun
        manifest = {
            "format": _FORMAT,
            "format_version": _VERSION,
            "versions": versions(),
            **json.loads(spec.to_json()),
        }
        if (path / "study.json").is_file():
            found = _read_manifest(path)
            self.rerun = str(found.pop("rerun", rerun))
            if json.dumps(found) != json.dumps(manifest):
                text = _difference("", found, manifest) or "the tables are in another order"
                raise InputError(f"{path}: holds another study: {text}; give another folder")
            return
        if path.is_dir() and any(path.iterdir()):
            raise InputError(f"{path}: is not empty, and holds no study; give another folder")
        with atomic(path / "study.json") as staged:
            staged.write_text(json.dumps({**manifest, "rerun": rerun}, indent=2) + "\n", "utf-8")

    @staticmethod
    def open(path: Path) -> StudyFolder:
        """The study that a folder holds. Raises InputError when it holds none, or one that
        another version made."""
        found = _read_manifest(path)
        try:
            spec = StudySpec(found["name"], found["raw"], found["seed"], tuple(found["estimators"]))
        except (KeyError, TypeError) as error:
            raise InputError(f"{path / 'study.json'}: damaged: no {error}") from error
        return StudyFolder(path, spec)

    def _file(self, run: int) -> Path:
        return self.path / "runs" / f"{run:06d}.npz"

    def runs(self) -> list[int]:
        """Numbers of the runs that are done, in order."""
        return sorted(int(f.stem) for f in (self.path / "runs").glob("[0-9]*.npz"))

    def write(self, run: int, content: bytes) -> None:
        """Keep the record of a run. Raises InputError when the disk does not take it."""
        with atomic(self._file(run)) as staged:
            staged.write_bytes(content)

    def read_bytes(self, run: int) -> bytes:
        """The record of a run as it was written."""
        return self._file(run).read_bytes()

    def records(self, runs: list[int]) -> Iterator[RunRecord]:
        """Records one after the other. Raises InputError on a damaged one."""
        for run in runs:
            record = RunRecord.from_bytes(self.read_bytes(run), str(self._file(run)))
            if record.scalars.get("run") != run:
                found = record.scalars.get("run")
                raise InputError(f"{self._file(run)}: found run {found}, expected {run}")
            yield record


def _read_manifest(path: Path) -> dict[str, Any]:
    file = path / "study.json"
    try:
        found = json.loads(file.read_text("utf-8"))
    except FileNotFoundError as error:
        raise InputError(f"{path}: no study.json in it, so it is no folder of a study") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot be read: {error}") from error
    if not isinstance(found, dict) or found.get("format") != _FORMAT:
        raise InputError(f"{file}: not a manifest of a study")
    if found.get("format_version") != _VERSION:
        version = found.get("format_version")
        raise InputError(f"{file}: found format version {version}, expected {_VERSION}")
    return found
