"""Checksums of MCAP files (https://mcap.dev/spec): what is damaged is named with its place.

rosbags looks at those of the chunks alone that it reads, in its newer versions, and says no place.
"""

from __future__ import annotations

from binascii import crc32
from importlib import import_module
from pathlib import Path
from struct import unpack_from

import numpy as np

from relnav_graph.errors import InputError

__all__ = ["check_mcap"]

_FOOTER, _CHUNK, _DATA_END = 0x02, 0x06, 0x0F
_MAGIC = b"\x89MCAP0\r\n"


def check_mcap(path: Path) -> None:
    """Raise InputError where a checksum that a file states is not that of its bytes, naming the
    byte where what is damaged begins: a chunk, the data or the summary. One of zero is none."""
    data = np.memmap(path, np.uint8, "r").data
    # Older versions of rosbags have none: compressed chunks are then left to it.
    known = getattr(import_module("rosbags.rosbag2.storage_mcap"), "DECOMPRESSORS", {})
    known = {**known, "": lambda stored, _: stored}
    at = after_header = len(_MAGIC)
    while at + 9 <= len(data):
        op, size = unpack_from("<BQ", data, at)
        body, end = at + 9, at + 9 + size
        if end > len(data):
            raise InputError(f"{path}: byte {at}: found the end of the file in a record")
        if op == _CHUNK:
            *_, length, crc, name = unpack_from("<QQQII", data, body)
            begin = body + 32 + name
            decompress = known.get(bytes(data[begin - name : begin]).decode())
            try:
                same = not (crc and decompress) or crc == crc32(
                    decompress(bytes(data[begin + 8 : end]), length)
                )
            except Exception:  # of bytes that are no stream of a stranger's compression any more
                same = False
            _refuse(path, same, f"the chunk at byte {at}")
        elif op == _DATA_END:
            (crc,) = unpack_from("<I", data, body)
            # Writers count from the first byte, or from behind the magic or the header.
            starts = (0, len(_MAGIC), after_header)
            same = not crc or any(crc == crc32(data[start:at]) for start in starts)
            _refuse(path, same, f"the data up to byte {at}")
        elif op == _FOOTER:
            summary, _, crc = unpack_from("<QQI", data, body)
            same = not (crc and summary) or crc == crc32(data[summary : body + 16])
            _refuse(path, same, f"the summary at byte {summary}")
            return
        after_header = end if at == len(_MAGIC) else after_header
        at = end


def _refuse(path: Path, same: bool, what: str) -> None:
    if not same:
        raise InputError(f"{path}: damaged: found {what} with another checksum than it states")
