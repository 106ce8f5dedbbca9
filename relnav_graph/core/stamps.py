"""Stamps of arrays as seconds: floats as they are, whole nanoseconds and dates by whole numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.errors import InputError

__all__ = ["first_stamp", "seconds"]

#: All stamps of a pass within that, ns: they are no nanoseconds.
_SHORTEST = 1_000_000


def _stamps(where: str, t: Any) -> Any:
    """Stamps as an array of float64, or of int64 nanoseconds."""
    array = np.asarray(t)
    if array.dtype.kind == "M":
        fine = array.astype("datetime64[ns]")
        if np.isnat(array).any() or (fine.astype(array.dtype) != array).any():
            raise InputError(
                f"{where}: found a time that is none, or beyond the years 1678 to 2262"
            )
        return fine.astype(np.int64)
    if array.dtype.kind in "iu":
        if array.dtype.kind == "u" and array.size and array.max() > np.iinfo(np.int64).max:
            raise InputError(f"{where}: found {array.max()}, expected nanoseconds below 2^63")
        return array.astype(np.int64)
    if array.dtype.kind != "f":
        raise InputError(
            f"{where}: found stamps of type {array.dtype}, expected seconds as floats, whole"
            " nanoseconds, or datetime64"
        )
    return array.astype(np.float64)


def first_stamp(all_stamps: Sequence[tuple[str, Any]]) -> int | float:
    """What is to be taken off stamps: zero of seconds, the earliest of nanoseconds and dates.

    all_stamps: arrays of stamps, each with its name for messages. Raises InputError where some are
    seconds and others not, or where whole numbers can be no nanoseconds.
    """
    arrays = [(where, _stamps(where, t)) for where, t in all_stamps]
    own = {array.dtype.kind == "i": where for where, array in arrays if array.size}
    if True not in own:
        return 0.0
    whole = [array for _, array in arrays if array.size and array.dtype.kind == "i"]
    low, high = min(int(a.min()) for a in whole), max(int(a.max()) for a in whole)
    if low < high < low + _SHORTEST:
        raise InputError(
            f"{own[True]}: found whole numbers from {low} to {high}: whole numbers are nanoseconds;"
            " seconds are floats"
        )
    if len(own) > 1:
        raise InputError(
            f"{own[True]}: found stamps in whole nanoseconds or datetime64, and {own[False]} in"
            " seconds, expected one kind for all"
        )
    return low


def seconds(where: str, t: Any, origin: Any = 0.0) -> Array:
    """Stamps (N,), or one of them, as seconds (N,) since `origin`, which is of the same kind.

    Of whole nanoseconds and datetime64 the origin is subtracted in whole numbers, so that nothing
    is lost but below the last digit of the difference. Raises InputError on stamps of another kind.
    """
    array, start = _stamps(where, t), _stamps("origin", origin)
    if array.dtype.kind == "i" and start.dtype.kind == "f" and start != 0.0:
        raise InputError(f"origin: found {origin!r}, expected one of the kind of {where}")
    if array.dtype.kind == "i":
        return np.asarray(np.atleast_1d(array - start.astype(np.int64)) / 1e9)
    if start.dtype.kind == "i" and start != 0:
        raise InputError(f"{where}: found seconds, expected stamps of the kind of the origin")
    return np.atleast_1d(array - start)
