"""The scenarios that come with the package, by name."""

from __future__ import annotations

import difflib
from pathlib import Path

__all__ = ["by_name", "near", "shipped"]

_PACKAGE = Path(__file__).parents[1]


def _folder() -> Path | None:
    """Where they lie: in the package as installed, or in the repository of an editable one."""
    repository = _PACKAGE.parent
    there = (repository / "pyproject.toml").is_file() and (repository / "factors").is_dir()
    known = [_PACKAGE / "scenarios", *([repository / "experiments"] if there else [])]
    return next((folder for folder in known if folder.is_dir()), None)


def shipped() -> dict[str, Path]:
    """The file of each, by name."""
    folder = _folder()
    return {} if folder is None else {path.stem: path for path in sorted(folder.glob("*.toml"))}


def by_name(path: Path) -> Path:
    """The file that a path, or else the name of a scenario, means: a path beats a name."""
    if path.exists() or path.suffix or len(path.parts) != 1:
        return path
    return shipped().get(path.name, path)


def near(path: Path) -> str:
    """What to add to the message that there is no such file; "" where nothing is like it."""
    found = difflib.get_close_matches(path.stem, shipped(), 1)
    return f"; did you mean {found[0]}, which comes with the package?" if found else ""
