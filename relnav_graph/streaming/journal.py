"""A journal of a stream: all lines received, so that a killed run resumes with the same result.

A folder of segments ``00000000.journal``, ``00000001.journal``, ...; only the last one is
written to, and only at its end. A segment is the line ``relnav-journal 3``, then records::

    type (1 byte)  length (4, little-endian)  CRC-32 of type and content (4)
    CRC-32 of these nine bytes (4)  content

of types M (what the journal belongs to, JSON), S (snapshot of the state), L (a line in, as
it came), F (a pause in the stream, at which all that waits is estimated, or its end) and O
(a line out: its number and digest). A segment begins with M and S; its other records, replayed
from that snapshot, give the same state and the same lines out. A new segment is written under
another name, flushed to the disk and renamed, so that it is there whole or not at all, and
the segments before it stay.

A last record that stops short was cut off by a kill and is removed. Whatever else does not
agree with its digest is damage, and an error.

What survives: with any policy all of it when the process is killed, since each record is
handed to the system before it is acted upon. When the machine goes down: with ``always``
all of it, with ``interval`` all but the last second, with ``never`` what the system had
written by then.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import shutil
import struct
import time
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from relnav_graph.errors import InputError
from relnav_graph.io.atomic import atomic

__all__ = ["Journal", "JournalError", "JournalRecord", "Policy", "read_segment"]

Policy = Literal["always", "interval", "never"]
#: Type and content.
JournalRecord = tuple[bytes, bytes]
_MAGIC, _VERSION = b"relnav-journal ", 3
#: What to do about journals of earlier versions.
_OLDER = {
    b"2": ": it is of relnav-graph 0.2 or older, whose isam2 is called incremental now; resume it"
    " with that version, or begin a new journal"
}
_HEAD = struct.Struct("<cII")
_CHECK = struct.Struct("<I")
_SEGMENT = re.compile(r"\d{8}\.journal")
_LEFTOVER = re.compile(r"\.\d{8}\.journal\.\w+")
_OWN = re.compile(f"lock|{_SEGMENT.pattern}|{_LEFTOVER.pattern}")
_TYPES = (b"M", b"S", b"L", b"F", b"O")


class JournalError(InputError):
    """A journal that is damaged, of another version, of another run, or in use."""


def _encode(kind: bytes, content: bytes) -> bytes:
    head = _HEAD.pack(kind, len(content), zlib.crc32(content, zlib.crc32(kind)))
    return head + _CHECK.pack(zlib.crc32(head)) + content


def _first_line(path: Path, data: bytes) -> int:
    """Length of the first line. Raises JournalError unless it says this version."""
    end = data.find(b"\n", 0, 64)
    if not data.startswith(_MAGIC) or end < 0:
        raise JournalError(f"{path}: offset 0: not a journal; found {data[:20]!r}")
    found = data[len(_MAGIC) : end]
    if found != str(_VERSION).encode():
        raise JournalError(
            f"{path}: offset {len(_MAGIC)}: found a journal of version"
            f" {found.decode('ascii', 'replace')}, expected {_VERSION}{_OLDER.get(found, '')}"
        )
    return end + 1


def read_segment(path: Path, last: bool) -> tuple[list[JournalRecord], int]:
    """Records of a segment, and the offset where they end.

    last: whether it is the last segment, which may end within a record, then left out. Raises
    JournalError, naming file and offset, on anything else that is not as it was written.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise JournalError(f"{path}: cannot be read: {error.strerror}") from error
    at, records = _first_line(path, data), list[JournalRecord]()
    fixed = _HEAD.size + _CHECK.size
    while at < len(data):
        head = data[at : at + _HEAD.size]
        whole = len(data) - at >= fixed
        if whole:
            kind, length, digest = _HEAD.unpack(head)
            if _CHECK.unpack_from(data, at + _HEAD.size) != (zlib.crc32(head),):
                raise JournalError(f"{path}: offset {at}: damaged: the head of a record")
            content = data[at + fixed : at + fixed + length]
            whole = len(content) == length
        if not whole or not any(memoryview(data)[at:]):  # zeros: where a machine went down
            if last:
                break
            raise JournalError(f"{path}: offset {at}: damaged: the file stops within a record")
        if kind not in _TYPES or zlib.crc32(content, zlib.crc32(kind)) != digest:
            raise JournalError(f"{path}: offset {at}: damaged: the content of a record ({kind!r})")
        records.append((kind, content))
        at += fixed + length
    if [kind for kind, _ in records[:2]] != [b"M", b"S"]:
        raise JournalError(f"{path}: offset {at}: stops before its first snapshot")
    return records, at


class Journal:
    """The journal in a folder, opened for one process.

    snapshot, records: the state to resume from, and the records after it; snapshot is b"" for
    a new journal, which begins with :meth:`rotate`. identity: the run that it belongs to, as
    keys and values. cut: bytes of a torn record, removed by the first record written. policy:
    when to sync. Raises JournalError when it is damaged, of another version, or in use, or when
    the folder holds something else. No byte of what is there changes before something is written.
    """

    def __init__(self, folder: Path, policy: Policy) -> None:
        self.folder, self.policy = folder, policy
        self.identity: dict[str, Any] = {}
        self.cut = 0
        self._file, self._mended = -1, False
        self._lock = self._take()
        try:
            self.snapshot, self.records = self._open()
        except BaseException:
            self.close()
            raise
        self._synced = time.monotonic()

    def _take(self) -> int:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            names = sorted(p.name for p in self.folder.iterdir())
            others = [name for name in names if not _OWN.fullmatch(name)]
            if others and not self.segments():
                raise JournalError(
                    f"--journal {self.folder}: found {others[0]!r} and no journal, expected a new"
                    " or empty folder"
                )
            lock = os.open(self.folder / "lock", os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as error:
            raise JournalError(f"--journal {self.folder}: {error.strerror}") from error
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(lock)
            raise JournalError(f"--journal {self.folder}: another process writes it") from error
        return lock

    def segments(self) -> list[Path]:
        """Its segments, oldest first."""
        return sorted(p for p in self.folder.iterdir() if _SEGMENT.fullmatch(p.name))

    def _open(self) -> tuple[bytes, list[JournalRecord]]:
        segments = self.segments()
        if not segments:
            return b"", []
        path = segments[-1]
        records, end = read_segment(path, last=True)
        try:
            self.identity = dict(json.loads(records[0][1]))
        except (TypeError, ValueError) as error:
            raise JournalError(f"{path}: damaged: what it belongs to: {error}") from error
        self.cut = path.stat().st_size - end
        self._file = os.open(path, os.O_RDWR)
        os.lseek(self._file, end, os.SEEK_SET)
        return records[1][1], records[2:]

    def belongs_to(self, identity: Mapping[str, Any]) -> None:
        """Raise JournalError unless it is new or belongs to this."""
        for key, value in identity.items() if self.snapshot else ():
            if self.identity.get(key) != value:
                raise JournalError(
                    f"{self.folder}: the journal belongs to another run: found {key} ="
                    f" {self.identity.get(key)!r}, expected {value!r}"
                )
        self.identity = dict(identity)

    def _mend(self) -> None:
        """Remove what a kill has left behind: a torn record, segments that were never renamed."""
        if self._file >= 0 and self.cut:
            os.ftruncate(self._file, os.lseek(self._file, 0, os.SEEK_CUR))
        for leftover in self.folder.iterdir():
            if _LEFTOVER.fullmatch(leftover.name):
                shutil.rmtree(leftover)
        self._mended = True

    def append(self, kind: bytes, content: bytes = b"") -> None:
        """Add a record. Raises JournalError, with no part of it written, when that fails."""
        if not self._mended:
            self._mend()
        data = _encode(kind, content)
        start = os.lseek(self._file, 0, os.SEEK_CUR)
        try:
            while data:  # a full disk takes a part at first, and raises at the next call
                data = data[os.write(self._file, data) :]
            if self.policy == "always":
                os.fdatasync(self._file)
        except OSError as error:
            os.ftruncate(self._file, start)
            os.lseek(self._file, start, os.SEEK_SET)
            raise JournalError(
                f"{self.segments()[-1]}: offset {start}: cannot be written: {error.strerror}"
            ) from error
        if self.policy == "interval" and time.monotonic() - self._synced > 1.0:
            self.sync()

    def sync(self) -> None:
        """Flush what was written to the disk."""
        os.fdatasync(self._file)
        self._synced = time.monotonic()

    def rotate(self, snapshot: bytes) -> None:
        """Begin a new segment with a snapshot. Raises InputError when it cannot be written;
        the one before then stays the last."""
        if not self._mended:
            self._mend()
        segments = self.segments()
        number = int(segments[-1].stem) + 1 if segments else 0
        path = self.folder / f"{number:08d}.journal"
        with atomic(path) as staged:
            first = _MAGIC + str(_VERSION).encode() + b"\n"
            meta = json.dumps(self.identity, sort_keys=True).encode()
            staged.write_bytes(first + _encode(b"M", meta) + _encode(b"S", snapshot))
        if self._file >= 0:
            os.close(self._file)
        self._file = os.open(path, os.O_RDWR)
        os.lseek(self._file, 0, os.SEEK_END)
        folder = os.open(self.folder, os.O_RDONLY)
        os.fsync(folder)
        os.close(folder)

    def close(self) -> None:
        """Flush it to the disk, unless by policy "never", and release the folder."""
        if self._file >= 0:
            if self.policy != "never":
                os.fdatasync(self._file)
            os.close(self._file)
            self._file = -1
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
