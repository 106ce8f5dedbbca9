"""What there is, in words, for `relnav list` and for the documentation: formats of files with their
options, and states with the models that advance and read them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from inspect import Parameter
from typing import Any, get_args, get_type_hints

from relnav_graph.core import catalogue
from relnav_graph.core.state import Block
from relnav_graph.io import readers, writers
from relnav_graph.registry import documented

__all__ = ["FORMATS", "MUST", "Format", "states_of"]

#: What is said of an option that has no default.
MUST = "must be given"


@dataclass(frozen=True)
class Format:
    """What reads, or what writes: modules by name, the function of each, and its options."""

    names: Callable[[], Mapping[str, str]]
    function: str
    options: Callable[[str], Mapping[str, Parameter]]

    def described(self, name: str) -> tuple[dict[str, str], dict[str, str]]:
        """Texts of one, see `relnav_graph.registry.documented`, and of its options the defaults, ""
        where one must be given."""
        options = self.options(name).items()
        defaults = {n: "" if p.default is Parameter.empty else repr(p.default) for n, p in options}
        return documented(self.names(), name, self.function), defaults


FORMATS = {
    "Reader": Format(readers.readers, "read", readers.options_of),
    "Writer": Format(writers.writers, "write", writers.options_of),
}


def _blocks_of(cls: type, what: str) -> set[Block]:
    """The blocks that a kind of model `what` ("advances" or "reads"), with its parameters as by
    default or, of one of them, another of its words; none of what cannot tell without others."""
    default: dict[str, Any] = {}
    for field in dataclasses.fields(cls) if dataclasses.is_dataclass(cls) else ():
        default[field.name] = None if field.default is dataclasses.MISSING else field.default
        if field.default_factory is not dataclasses.MISSING:
            default[field.name] = field.default_factory()
    hints = get_type_hints(cls) if default else {}
    words = [{n: w} for n in default for w in get_args(hints[n]) if isinstance(w, str)]
    found = set[Block]()
    for other in ({}, *words):
        one: Any = object.__new__(cls)
        for name, value in (default | other).items():
            object.__setattr__(one, name, value)
        try:
            found |= {*getattr(one, what, ())}
        except Exception:  # it has not all that it needs, and may be a stranger's code
            continue
    return found


def states_of(found: Mapping[str, type]) -> dict[str, dict[Block, dict[str, list[str]]]]:
    """States by name: the blocks of that name, in one frame or another, each with the kinds of
    models, of those found, that advance and read it."""
    states: dict[str, dict[Block, dict[str, list[str]]]] = {}
    for block in vars(catalogue).values():
        for one in block if isinstance(block, tuple) else (block,):
            if isinstance(one, Block):
                states.setdefault(one.name, {})[one] = {"advances": [], "reads": []}
    for kind, cls in found.items():
        for what in ("advances", "reads"):
            for block in sorted(_blocks_of(cls, what), key=str):
                known = states.setdefault(block.name, {})
                known.setdefault(block, {"advances": [], "reads": []})[what].append(kind)
    return states
