"""Parts of a history, each linked to the one before: states that grow share them."""

from __future__ import annotations

from typing import Protocol, TypeVar

__all__ = ["in_order"]


class _Linked(Protocol):
    @property
    def before(self) -> _Linked | None: ...


T = TypeVar("T", bound=_Linked)


def in_order(last: T | None, count: int | None = None) -> list[T]:
    """The newest parts, up to `last`, by default all, in order of time."""
    out = list[T]()
    while last is not None and len(out) != count:
        out.append(last)
        last = last.before  # type: ignore[assignment]
    return out[::-1]
