"""Methods of the nouns that higher floors lend them, such as `Track.to_xarray`.

The nouns stand below whatever writes, draws or builds them, and import none of it. So a method of
that kind is a name in the table of the package (`relnav_graph.__init__`), which loads a function
when it is first asked for; the package says here how, and the nouns only ask.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

__all__ = ["Lent", "lend"]


def _nothing(name: str) -> Any:
    raise AttributeError(f"{name}: import relnav_graph first")


_find: Callable[[str], Any] = _nothing


def lend(find: Callable[[str], Any]) -> None:
    """Let methods be what `find` gives for their names."""
    global _find
    _find = find


class Lent:
    """A method that is a function of the package: of an object, which is its first argument, or
    (maker) of the class, which it makes one of. Help and signature are those of the function."""

    def __init__(self, name: str, maker: bool = False) -> None:
        self.name, self.maker = name, maker

    def __get__(self, instance: object, owner: type) -> Callable[..., Any]:
        function: Callable[..., Any] = _find(self.name)
        if self.maker or instance is None:
            return function
        bound: Callable[..., Any] = function.__get__(instance, owner)
        return bound
