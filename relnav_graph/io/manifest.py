"""What a folder of results was made from: the manifest beside the results of one pass."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from relnav_graph.io.atomic import atomic
from relnav_graph.io.stored import Count, Label, read_json

__all__ = ["PASS_FILE", "PassManifest"]

PASS_FILE = "pass.json"
_FORMAT, _VERSION = "relnav-graph pass", 1


@dataclass(frozen=True)
class PassManifest:
    """What results of one pass were made from.

    name, raw: the scenario and its TOML tables, settings of the data included; seed, run: of
    the draw; simulated: whether the recording was drawn too; versions: of the packages;
    command: the command line, empty where there was none.
    """

    name: Label
    raw: Mapping[str, Any]
    seed: Count
    run: Count
    simulated: bool
    versions: Mapping[str, str]
    command: str = ""

    def write(self, folder: Path) -> None:
        """Write the manifest into a folder of results. Raises InputError."""
        tree = {"format": _FORMAT, "format_version": _VERSION, **asdict(self)}
        text = json.dumps(tree, indent=2, default=np.ndarray.tolist)
        with atomic(folder / PASS_FILE) as staged:
            staged.write_text(text + "\n", "utf-8")

    @staticmethod
    def read(folder: Path) -> PassManifest:
        """The manifest in a folder. Raises InputError on one that is missing, damaged or
        of another version."""
        file = folder / PASS_FILE
        return read_json(file, PassManifest, "a manifest of a pass", _FORMAT, _VERSION)
