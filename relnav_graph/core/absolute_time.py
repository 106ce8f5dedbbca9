"""The absolute time of t = 0, and the Earth's orientation, as models and truths get them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

from relnav_graph.errors import InputError
from relnav_graph.files import read_file
from relnav_graph.maths.earth import EarthTable, read_finals
from relnav_graph.maths.instants import Instant

__all__ = ["AbsoluteTime"]


@lru_cache(maxsize=4)
def _table(path: str) -> EarthTable:
    try:
        return read_finals(read_file(path, 2**26).decode("ascii"), path)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a readable text of the IERS: {error}") from error


@dataclass(frozen=True)
class AbsoluteTime:
    """Of a pass. epoch: the absolute time of t = 0, as "2021-07-17T00:00:00 TT"; orientation: path
    of a finals2000A file of the IERS, none: UT1 = UTC and no polar motion.

    Raises InputError on what is no time, or no such file.
    """

    epoch: str
    orientation: str = ""

    def __post_init__(self) -> None:
        assert self.begin is not None
        assert self.orientation == "" or self.table is not None

    @cached_property
    def begin(self) -> Instant:
        """The instant of t = 0."""
        return Instant.parse(self.epoch)

    @property
    def table(self) -> EarthTable | None:
        """The Earth's orientation as measured; None: UT1 = UTC and no polar motion."""
        return _table(self.orientation) if self.orientation else None
