"""The folder of a study: a manifest, and one record for each run that is done.

A record appears complete or not at all, so a study that was killed goes on where it was.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from relnav_graph.errors import InputError, ModelError
from relnav_graph.estimators import GROUP
from relnav_graph.files import read_file
from relnav_graph.io.atomic import atomic
from relnav_graph.io.stored import Count, Label, read_json
from relnav_graph.registry import find_class
from relnav_graph.scenario.toml import refuse_modules
from relnav_graph.scoring.metrics import versions
from relnav_graph.study.record import RunRecord
from relnav_graph.study.recorded import StudyData
from relnav_graph.study.runs import StudySpec

__all__ = ["StudyFolder"]

_FORMAT, _VERSION = "relnav-graph study", 1
#: Bytes that a record may have: it comes to some hundred kilobytes.
_MOST = 64_000_000


@dataclass(frozen=True)
class _Manifest:
    """``study.json``; rerun: the command that makes one run alone, but for its number."""

    format: str
    format_version: int
    versions: dict[str, str]
    name: Label
    raw: dict[str, Any]
    seed: Count
    estimators: list[str]
    data: StudyData | None = None
    rerun: str = ""


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
            found = asdict(_read_manifest(path))
            self.rerun = found.pop("rerun") or rerun
            if found["data"] is None:
                del found["data"]
            elif spec.data is not None:  # which they are counts, and not where
                found["data"]["folder"] = spec.data.folder
            if json.dumps(found) != json.dumps(manifest):
                text = _difference("", found, manifest) or "the tables are in another order"
                raise InputError(
                    f"{path / 'study.json'}: holds another study: {text}; give another folder"
                )
            return
        if path.is_dir() and any(path.iterdir()):
            raise InputError(f"{path}: is not empty, and holds no study; give another folder")
        with atomic(path / "study.json") as staged:
            staged.write_text(json.dumps({**manifest, "rerun": rerun}, indent=2) + "\n", "utf-8")

    @staticmethod
    def open(path: Path, trust: bool = False) -> StudyFolder:
        """The study that a folder holds.

        trust: its scenario may name modules, which are code. Raises InputError when the folder
        holds no study, or one that another version made, or that needs what is not there.
        """
        found, file = _read_manifest(path), path / "study.json"
        if not trust:
            refuse_modules(str(file), {"estimators": found.estimators, "raw": found.raw})
        for i, kind in enumerate(found.estimators):
            try:
                find_class(GROUP, kind)
            except ModelError as error:
                raise InputError(f"{file}: estimators[{i}]: {error}") from error
        spec = StudySpec(found.name, found.raw, found.seed, tuple(found.estimators), found.data)
        return StudyFolder(path, spec)

    def _file(self, run: int) -> Path:
        return self.path / "runs" / f"{run:06d}.npz"

    def runs(self) -> list[int]:
        """Numbers of the runs that are done, in order. Raises InputError on a file beside their
        records that looks like one, as a copy does."""
        found = []
        for file in (self.path / "runs").glob("[!.]*.npz"):
            number = int(file.stem) if file.stem.isdecimal() and len(file.stem) < 19 else -1
            if file != self._file(number):
                raise InputError(
                    f"{file}: found a name that no record of a run has, expected one such as"
                    f" {self._file(1).name}; take it out of the folder"
                )
            found.append(number)
        return sorted(found)

    def write(self, run: int, content: bytes) -> None:
        """Keep the record of a run. Raises InputError when the disk does not take it."""
        with atomic(self._file(run)) as staged:
            staged.write_bytes(content)

    def read_bytes(self, run: int) -> bytes:
        """The record of a run as it was written. Raises InputError when it cannot be read."""
        return read_file(self._file(run), _MOST)

    def records(self, runs: list[int]) -> Iterator[RunRecord]:
        """Records one after the other. Raises InputError on a damaged one."""
        for run in runs:
            record = RunRecord.from_bytes(self.read_bytes(run), str(self._file(run)))
            if record.scalars.get("run") != run:
                found = record.scalars.get("run")
                raise InputError(f"{self._file(run)}: found run {found}, expected {run}")
            yield record


def _read_manifest(path: Path) -> _Manifest:
    file = path / "study.json"
    if not file.exists():
        raise InputError(f"{path}: no study.json in it, so it is no folder of a study")
    found = read_json(file, _Manifest, "a manifest of a study", _FORMAT, _VERSION)
    made = found.versions.get("relnav-graph", "")
    if "isam2" in found.estimators and re.match(r"0\.[0-2]\b", made):
        raise InputError(
            f"{file}: estimators: isam2 of relnav-graph {made} is called incremental now, and isam2"
            " is another estimator; make the study anew in another folder, with incremental, or"
            " read it with that version"
        )
    return found
