"""``dataset.toml``: what a data set brings for its scenario, and digests of its tables."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from relnav_graph.constants import VERSION
from relnav_graph.errors import InputError
from relnav_graph.files import file_in, read_file
from relnav_graph.scenario.toml import read_toml

__all__ = ["is_ours", "read_manifest", "write_manifest"]

_FILE = "dataset.toml"
_FORMAT = 1


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def read_manifest(folder: Path) -> dict[str, Any]:
    """``dataset.toml`` of a data set, after a check of all that it lists; {} when there is none.

    Raises InputError on a damaged one, and on tables that are not as it lists them.
    """
    path = folder / _FILE
    if not path.exists():
        return {}
    manifest = read_toml(path, of_data=True)
    if manifest.get("format") != _FORMAT:
        raise InputError(f"{path}: found format {manifest.get('format')!r}, expected {_FORMAT}")
    settings, digests = manifest.get("settings", {}), manifest.get("sha256")
    if not isinstance(digests, dict) or not isinstance(settings, dict):
        raise InputError(f"{path}: expected tables [settings] and [sha256]")
    for key, found in {"truth_source": manifest.get("truth_source", ""), **digests}.items():
        if not isinstance(found, str):
            raise InputError(f"{path}: {key}: found {found!r}, expected text")
    if digests.pop("settings", None) != _digest(tomli_w.dumps(settings).encode()):
        raise InputError(f"{path}: [settings] changed since it was written")
    for name, digest in digests.items():
        file = file_in(folder, name)
        if not file.exists():
            raise InputError(f"{file}: missing, though dataset.toml lists it")
        if _digest(read_file(file)) != digest:
            raise InputError(
                f"{file}: truncated or changed since it was written; if on purpose,"
                " take its line out of dataset.toml"
            )
    return manifest


def is_ours(folder: Path) -> bool:
    """Whether all that a folder holds was written as a data set."""
    path = folder / _FILE
    if not path.is_file():
        return False
    manifest = read_toml(path, of_data=True)
    listed = manifest.get("sha256")
    return (manifest.get("format") == _FORMAT and isinstance(listed, dict)) and all(
        p.name in {_FILE, "scenario.toml", *listed} for p in folder.iterdir()
    )


def write_manifest(folder: Path, settings: Mapping[str, Any], truth_source: str) -> None:
    """Write ``dataset.toml`` into a folder, of all the tables that are there."""
    digests = {"settings": _digest(tomli_w.dumps(settings).encode())}
    digests |= {p.name: _digest(p.read_bytes()) for p in sorted(folder.iterdir())}
    manifest = {
        "format": _FORMAT,
        "writer": f"relnav-graph {VERSION}",
        "truth_source": truth_source,
        "settings": settings,
        "sha256": digests,
    }
    (folder / _FILE).write_text(tomli_w.dumps(manifest), "utf-8")
