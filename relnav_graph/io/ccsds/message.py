"""The text of a message as its parts, each with its line: KVN, or XML."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.parsers import expat

from relnav_graph.errors import InputError
from relnav_graph.files import read_file

__all__ = ["Covariance", "Entry", "Message", "Row", "Segment", "read_message", "scaled", "unscaled"]

#: Line and text.
Entry = tuple[int, str]
#: Line and words.
Row = tuple[int, list[str]]
_KEY = re.compile(r"([A-Z][A-Z0-9_]*)\s*=\s*(.*)", re.ASCII)
#: Elements of XML that hold the entries of one thing, and the leaves of a covariance in order.
_HOLDERS = ("header", "metadata", "stateVector", "covarianceMatrix", "attitudeState")
_AXES = ("X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT")
_TRIANGLE = tuple(f"C{a}_{b}" for i, a in enumerate(_AXES) for b in _AXES[: i + 1])


@dataclass
class Covariance:
    """A covariance (6, 6) of a state, as its lower triangle, row by row, of 21 words."""

    line: int
    epoch: str
    frame: Entry | None
    words: list[str]


@dataclass
class Segment:
    """Metadata by keyword, rows of data, covariances."""

    meta: dict[str, Entry] = field(default_factory=dict)
    rows: list[Row] = field(default_factory=list)
    covariances: list[Covariance] = field(default_factory=list)


@dataclass
class Message:
    """A file: its version, the segments."""

    path: Path
    version: str
    segments: list[Segment]

    def at(self, line: int) -> str:
        """The place of a line, for errors."""
        return f"{self.path}, line {line}"

    def entry(self, segment: Segment, key: str) -> Entry:
        """An entry of the metadata. Raises InputError where there is none."""
        if key not in segment.meta:
            line = min((line for line, _ in segment.meta.values()), default=1)
            raise InputError(f"{self.at(line)}: found no {key} in this metadata, expected one")
        return segment.meta[key]

    def one_of(self, segment: Segment, key: str, accepted: Mapping[str, Any], why: str = "") -> Any:
        """What an entry stands for, of those accepted. Raises InputError on another one."""
        line, value = self.entry(segment, key)
        if value.upper() not in accepted:
            names = ", ".join(accepted)
            raise InputError(f"{self.at(line)}: found {key} {value!r}, expected {names}{why}")
        return accepted[value.upper()]


def scaled(word: str, power: int) -> str:
    """The text of a number times 10^power, exactly: so that km and m lose no bit."""
    mantissa, mark, exponent = word.lower().partition("e")
    return f"{mantissa}e{int(exponent) + power}" if mark else f"{word}e{power}"


def number(word: str, power: int = 0) -> float:
    """A number times 10^power. Raises ValueError on what is none, or not finite."""
    try:
        found = float(scaled(word, power))
    except ValueError:
        found = math.nan
    if not math.isfinite(found):
        fortran = " (its exponent follows an E, not a D)" if "d" in word.lower() else ""
        raise ValueError(f"found {word!r}, expected a finite number, as 6.778137E+03{fortran}")
    return found


def unscaled(x: float, power: int) -> str:
    """The text of x / 10^power: `scaled` and `float` make the same x of it."""
    mantissa, _, exponent = repr(x).partition("e")
    at = int(exponent or 0) - power
    whole, _, part = mantissa.partition(".")
    sign, digits = ("-", whole[1:]) if whole[0] == "-" else ("", whole)
    part = "" if part == "0" else part
    if not exponent and at < 0 and len(digits) + len(part) < 22:
        digits = digits.rjust(1 - at, "0")
        return f"{sign}{digits[:at]}.{digits[at:]}{part}"
    return f"{sign}{digits}.{part or '0'}" + (f"e{at}" if at else "")


def read_message(path: Path, kind: str) -> Message:
    """A message of a kind, "OEM" or "AEM", in KVN or XML.

    Raises InputError, with file and line, on another text, and on what has no such structure.
    """
    try:
        text = read_file(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a readable text: {error}") from error
    parse = _xml if text.lstrip()[:1] == "<" else _kvn
    message = parse(path, text, kind)
    if not message.segments:
        raise InputError(f"{path}: found no segment with metadata and data in it, expected one")
    return message


def _entry(where: str, line: str) -> tuple[str, str]:
    match = _KEY.fullmatch(line)
    if match is None:
        raise InputError(f"{where}: found {line[:60]!r}, expected KEYWORD = value")
    return match[1], match[2].strip()


def _version(where: str, key: str, value: str, kind: str) -> str:
    """The version of a message. Raises InputError on another kind, and on a version unknown."""
    if key != f"CCSDS_{kind}_VERS":
        raise InputError(f"{where}: found {key!r} first, expected CCSDS_{kind}_VERS")
    if value not in ("1.0", "2.0", "3.0"):
        raise InputError(f"{where}: found version {value!r}, expected 1.0, 2.0 or 3.0")
    return value


class _Lines:
    """The lines of a KVN message that are no comments, with their numbers."""

    def __init__(self, path: Path, text: str) -> None:
        lines = enumerate(map(str.strip, text.splitlines()), 1)
        self.path, self.last = path, 0
        self._lines: Iterator[Entry] = (
            (n, line) for n, line in lines if line and not line.startswith("COMMENT")
        )

    def __iter__(self) -> Iterator[Entry]:
        for n, line in self._lines:
            self.last = n
            yield n, line

    def until(self, end: str) -> Iterator[Entry]:
        """Lines up to one that says `end`. Raises InputError where there is none."""
        for n, line in self:
            if line == end:
                return
            yield n, line
        raise InputError(f"{self.path}, line {self.last}: found the end of the file before {end}")


def _kvn(path: Path, text: str, kind: str) -> Message:
    lines = _Lines(path, text)
    first, line = next(iter(lines), (1, ""))
    where = f"{path}, line {first}"
    message = Message(path, _version(where, *_entry(where, line), kind), [])
    for n, line in lines:
        where = f"{path}, line {n}"
        if line == "META_START":
            message.segments.append(Segment())
            for k, entry in lines.until("META_STOP"):
                _put(path, message.segments[-1].meta, k, *_entry(f"{path}, line {k}", entry))
        elif not message.segments:
            _entry(where, line)  # of the header, which says nothing of the states
        elif line == "COVARIANCE_START":
            message.segments[-1].covariances += _covariances(path, lines)
        elif line not in ("DATA_START", "DATA_STOP"):
            message.segments[-1].rows.append((n, line.split()))
    return message


def _put(path: Path, entries: dict[str, Entry], line: int, key: str, value: str) -> None:
    if key in entries:
        raise InputError(f"{path}, line {line}: found {key} again, expected it once")
    entries[key] = line, value


def _covariances(path: Path, lines: _Lines) -> list[Covariance]:
    """Those of a block. A frame that one names holds for those after it, too."""
    found: list[Covariance] = []
    for n, line in lines.until("COVARIANCE_STOP"):
        if "=" in line:
            key, value = _entry(f"{path}, line {n}", line)
            if key == "EPOCH":
                found.append(Covariance(n, value, found[-1].frame if found else None, []))
            elif key == "COV_REF_FRAME" and found and not found[-1].words:
                found[-1].frame = n, value
            else:
                raise InputError(f"{path}, line {n}: found {key}, expected EPOCH, then a frame")
        elif not found:
            raise InputError(f"{path}, line {n}: found numbers, expected EPOCH = ...")
        else:
            found[-1].words += line.split()
    for one in found:
        if len(one.words) != 21:
            raise InputError(
                f"{path}, line {one.line}: found {len(one.words)} numbers in this covariance,"
                " expected 21: a lower triangle of 6 x 6"
            )
    return found


def _xml(path: Path, text: str, kind: str) -> Message:
    parser = expat.ParserCreate()
    message = Message(path, "", [])
    holder: list[tuple[str, dict[str, Entry]]] = []
    leaf: list[str] = []

    def begin(name: str, attributes: dict[str, str]) -> None:
        where = message.at(parser.CurrentLineNumber)
        if not message.version and name != "ndm":
            key, value = attributes.get("id", name), attributes.get("version", "")
            message.version = _version(where, key, value, kind)
        if name == "segment":
            message.segments.append(Segment())
        if name in _HOLDERS:
            holder.append((name, {}))
        leaf.clear()

    def end(name: str) -> None:
        if holder and name == holder[-1][0]:
            if name != "header":
                _xml_part(message, parser.CurrentLineNumber, *holder.pop())
        elif holder and name.isupper() and name != "COMMENT":
            _put(path, holder[-1][1], parser.CurrentLineNumber, name, "".join(leaf).strip())
        leaf.clear()

    def no_entity(*_: Any) -> None:
        raise InputError(f"{message.at(parser.CurrentLineNumber)}: found a DTD, expected none")

    parser.StartElementHandler, parser.EndElementHandler = begin, end
    parser.CharacterDataHandler = leaf.append
    parser.StartDoctypeDeclHandler = no_entity
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise InputError(f"{path}: not readable as XML: {error}") from error
    return message


def _xml_part(message: Message, line: int, name: str, entries: dict[str, Entry]) -> None:
    """Put what one element of XML held to where KVN has it."""
    if not message.segments:
        raise InputError(f"{message.at(line)}: found {name} outside a segment")
    segment = message.segments[-1]
    get: Callable[[str], str] = lambda key: entries[key][1]  # noqa: E731
    try:
        if name == "metadata":
            segment.meta = entries
        elif name == "covarianceMatrix":
            words = [get(key) for key in _TRIANGLE]
            one = Covariance(line, get("EPOCH"), entries.get("COV_REF_FRAME"), words)
            segment.covariances.append(one)
        else:
            own = _AXES if name == "stateVector" else ("Q1", "Q2", "Q3", "QC")
            segment.rows.append((line, [get("EPOCH"), *(get(key) for key in own)]))
    except KeyError as error:
        raise InputError(f"{message.at(line)}: found no {error.args[0]} in {name}") from error
