"""JSON files that this package wrote, read back: every field checked, by name."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import AfterValidator, Field, StringConstraints, TypeAdapter, ValidationError
from pydantic_core import from_json

from relnav_graph.errors import InputError
from relnav_graph.files import printable, read_file
from relnav_graph.scenario.schema import from_pydantic

__all__ = ["Count", "Label", "check_json", "read_json"]

T = TypeVar("T")
#: Bytes that such a file may have: a scenario with all its points takes far less.
_MOST = 64_000_000


def _label(text: str) -> str:
    if "/" in text or text in (".", "..") or printable(text) != text:
        raise ValueError(f"found {text!r}, expected a name, not a path")
    return text


#: What a scenario is called: a file without its folder.
Label = Annotated[str, StringConstraints(max_length=255), AfterValidator(_label)]
Count = Annotated[int, Field(ge=0, le=2**53)]


def check_json(where: str, content: bytes, shape: type[T]) -> T:
    """A JSON text as a dataclass, with nothing converted that is of another type.

    Raises InputError with `where` and the fields that do not fit, by their path.
    """
    try:
        return TypeAdapter(shape).validate_json(content, strict=True)
    except ValidationError as error:
        said = [
            f"{path or 'the whole'}: {text if len(text) < 300 else text[:300] + ' ...'}"
            for path, text in from_pydantic("", error)
        ]
        more = f"; and {len(said) - 3} more" if len(said) > 3 else ""
        raise InputError(f"{where}: damaged: {'; '.join(said[:3])}{more}") from error


def read_json(path: Path, shape: type[T], what: str, file_format: str, version: int) -> T:
    """A file with a stamp of format and version, as :func:`check_json`.

    what: the file is, for messages. Raises InputError on one that is missing, damaged, too
    large, of another program or of another version.
    """
    content = read_file(path, _MOST)
    try:
        found = from_json(content)
    except ValueError as error:
        raise InputError(f"{path}: cannot be read: not valid JSON: {error}") from error
    if not isinstance(found, dict) or found.get("format") != file_format:
        raise InputError(f"{path}: not {what}")
    if found.get("format_version") != version:
        raise InputError(
            f"{path}: found format version {found.get('format_version')!r}, expected {version}"
        )
    return check_json(str(path), content, shape)
