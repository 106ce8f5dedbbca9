"""Pages that are made from the package itself: models, estimators, formats, the scenario file.

They are written below reference/generated/ when a build begins. Docstrings of the package are prose
with formulas in plain letters; `prose` makes of them what reStructuredText reads as that.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

from relnav_graph.registry import classes
from relnav_graph.runs.described import FORMATS, MUST
from relnav_graph.scenario.keys import tables
from relnav_graph.units import Quantity, quantities

#: What stays as it is (literals, *words*), code, and letters that would mark something up.
_MARKED = re.compile(r"(``[^`]+``|(?<!\w)\*\w+\*(?!\w))|(:\w+:)?`([^`]+)`|([*|\\]|_(?!\w))")
_MODELS = {
    "sensors": ("Sensors", "What a sensor measures, and what the filter and the graph are told."),
    "dynamics": ("Processes", "How a state goes on from one epoch to the next."),
    "derived": ("Derived quantities", "What follows from states, and is scored and written too."),
}


def _escaped(text: str) -> str:
    def one(found: re.Match[str]) -> str:
        literal, role, code, mark = found.groups()
        if literal:
            return literal
        if code is not None:
            return found[0] if role else f"``{code}``"
        return "\\" + mark

    return _MARKED.sub(one, text)


def _paragraphs(lines: Iterable[str]) -> Iterator[list[str]]:
    part: list[str] = []
    for line in [*lines, ""]:
        if line.strip():
            part.append(line.rstrip())
        elif part:
            yield part
            part = []


def _underlined(part: list[str]) -> bool:
    return len(part) > 1 and set(part[1].strip()) in ({"-"}, {"="})


def prose(text: str) -> list[str]:
    """Lines of reStructuredText of a docstring: indented paragraphs as they stand, lists as lists,
    all else as prose."""
    out: list[str] = []
    for part in _paragraphs(inspect.cleandoc(text).splitlines()):
        if _underlined(part):
            out += [f"**{part[0]}**", ""]
            part = part[2:]
            if not part:
                continue
        if part[-1].endswith("::"):  # what follows is indented, and is taken as it stands anyway
            part[-1] = part[-1][:-1]
            if part == [":"]:
                continue
        if part[0].startswith("  "):
            out += ["::", "", *("    " + line for line in part), ""]
        elif part[0].startswith(("- ", "* ")):
            out += [line[:2] + _escaped(line[2:]) for line in part] + [""]
        else:
            out += [_escaped(line.strip()) for line in part] + [""]
    return out


def _section(title: str, mark: str) -> list[str]:
    return [title, mark * len(title), ""]


def _table(header: list[str], rows: list[list[str]], widths: str = "auto") -> list[str]:
    if not rows:
        return []
    if len(header) > 2 and not any(row[2] for row in rows):  # nothing is said of any
        header, rows = [header[0], header[1], *header[3:]], [[*r[:2], *r[3:]] for r in rows]
    out = [".. list-table::", "   :header-rows: 1", f"   :widths: {widths}", ""]
    for row in [header, *rows]:
        cells = [cell.replace("\n", " ") or " " for cell in row]
        out += [f"   {'* -' if k == 0 else '  -'} {cell}" for k, cell in enumerate(cells)]
    return [*out, ""]


def _numbers(quantity: Quantity) -> str:
    sign = "positive " if quantity.positive else ""
    many = " x ".join("n" if n is None else str(n) for n in quantity.shape)
    said = f"{many} {sign}numbers" if many else f"one {sign}number"
    said += " that are not negative" if quantity.nonnegative and many else ""
    said += ", not negative" if quantity.nonnegative and not many else ""
    return said + (", or one for all" if quantity.fill and many else "")


_PLAIN = {"str": "text", "bool": "true or false", "int": "whole number", "float": "number"}


def _type(hint: Any) -> str:
    if get_origin(hint) is not None and "Literal" in str(get_origin(hint)):
        return " or ".join(f'``"{choice}"``' for choice in get_args(hint))
    if hasattr(hint, "__metadata__"):
        return _type(hint.__origin__)
    name = getattr(hint, "__name__", "") if get_origin(hint) is None else str(hint)
    short = re.sub(r"\b([A-Za-z_]\w*\.)+", "", name or str(hint))
    return _PLAIN.get(short, f"``{short}``")


def _what(cls: type, name: str) -> str:
    known = quantities(cls).get(name)
    if known is None:
        return _type(get_type_hints(cls, include_extras=True)[name])
    words = "".join(f', or ``"{word}"``' for word in known.words)
    unit = "" if known.unit == "1" else f", {_escaped(known.unit)}"
    return _numbers(known) + unit + words


def _literal(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else repr(value)


def _default(field: dataclasses.Field[Any]) -> str:
    if field.default is not dataclasses.MISSING:
        return "none" if field.default is None else f"``{_literal(field.default)}``"
    if field.default_factory is not dataclasses.MISSING:
        made = field.default_factory()
        return f"``{getattr(made, 'tolist', lambda: made)()!r}``"
    return MUST


def fields_of(cls: type) -> list[str]:
    """A table of the fields of a dataclass, with units and defaults."""
    if not dataclasses.is_dataclass(cls):
        return []
    rows = [
        [f"``{field.name}``", _what(cls, field.name), _default(field)]
        for field in dataclasses.fields(cls)
        if field.init and not field.name.startswith("_")
    ]
    return _table(["parameter", "what it is", "default"], rows)


def _kernel(cls: type) -> list[str]:
    """What the docstring of the compiled formula says, to be opened."""
    kernel = inspect.getattr_static(cls, "kernel", None)
    text = getattr(getattr(kernel, "__func__", kernel), "__doc__", None)
    if not text:
        return []
    body = ["   " + line if line else "" for line in prose(text)]
    return [".. dropdown:: The compiled formula", "", *body, ""]


def _model(cls: type) -> list[str]:
    columns = getattr(cls, "columns", ())
    inputs = getattr(cls, "inputs", {})
    out = [f".. _model-{cls.kind}:", "", *_section(f"``{cls.kind}``", "-")]  # type: ignore[attr-defined]
    out += prose(cls.__doc__ or "")
    if isinstance(columns, tuple) and columns:
        out += [f"Columns of its table: {', '.join(f'``{name}``' for name in columns)}.", ""]
    if isinstance(inputs, dict) and inputs:
        said = (f"``{n}`` ({', '.join(f'``{c}``' for c in cs)})" for n, cs in inputs.items())
        out += [f"Inputs: {'; '.join(said)}.", ""]
    return out + fields_of(cls) + _kernel(cls)


def _models(room: str) -> list[str]:
    title, about = _MODELS[room]
    out = [*_section(title, "="), about, ""]
    found = classes("relnav_graph.models").values()
    for cls in found:
        if f".{room}." in cls.__module__:
            out += _model(cls)
    return out


def _estimators() -> list[str]:
    out = _section("Every estimator, by name", "=")
    for kind, cls in classes("relnav_graph.estimators").items():
        out += [*_section(f"``{kind}``", "-"), *prose(cls.__doc__ or ""), *fields_of(cls)]
    return out


def _others() -> list[str]:
    out = _section("Truths, instruments, controllers", "=")
    for kind, cls in classes("relnav_graph.truths").items():
        out += [*_section(f"``{kind}``", "-"), *prose(cls.__doc__ or ""), *fields_of(cls)]
    return out


def _formats() -> list[str]:
    """Readers and writers with their options, and then what their docstrings point at."""
    out, pointed = _section("Readers and writers, by name", "="), dict[str, str]()
    out += ["What ``relnav list NAME`` prints of each.", ""]
    for title, one in FORMATS.items():
        for name in one.names():
            texts, options = one.described(name)
            out += [*_section(f"{title} ``{name}``", "-"), *prose(texts.pop(""))]
            rows = [[f"``{n}``", f"``{d}``" if d else MUST] for n, d in options.items()]
            out += _table(["option", "default"], rows)
            pointed |= texts
    for name, text in sorted(pointed.items()):
        out += [f".. _pointed-{name}:", "", *_section(name, "-"), *prose(text)]
    links = {f"``{name}``": f":ref:`{name} <pointed-{name}>`" for name in pointed}
    return [re.sub("|".join(map(re.escape, links)), lambda m: links[m[0]], line) for line in out]


def _scenario_file() -> list[str]:
    header = ["key", "type", "what", "default"]
    out = _section("Tables of a scenario file", "=")
    for table in tables():
        out += [*_section(table.name, "-"), *prose(table.text)]
        rows = []
        for key in table.keys:
            said = re.sub(r"\bsee (\w+)$", r"see `\1`_", key.type)
            said = re.sub(r"'\w*'", r"``\g<0>``", said)
            what = " ".join(prose(key.text))
            rows.append([f"``{key.name}``", said, what, key.default and f"``{key.default}``"])
        out += _table(header, rows)
    return out


def _write(path: Path, lines: list[str]) -> None:
    """Only where something changed, so that a second build is quick."""
    text = "\n".join(lines).rstrip() + "\n"
    if not path.is_file() or path.read_text("utf-8") != text:
        path.write_text(text, "utf-8")


def write_pages(app: Any) -> None:
    """Write what the reference is made of."""
    folder = Path(app.srcdir) / "reference" / "generated"
    folder.mkdir(parents=True, exist_ok=True)
    for room in _MODELS:
        _write(folder / f"{room}.rst", _models(room))
    _write(folder / "estimators.rst", _estimators())
    _write(folder / "truths.rst", _others())
    _write(folder / "formats.rst", _formats())
    _write(folder / "scenario_file.rst", _scenario_file())


def as_prose(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Docstrings of the API, in the same way."""
    lines[:] = prose("\n".join(lines))


def short_types(
    app: Any,
    what: str,
    name: str,
    obj: Any,
    options: Any,
    signature: str | None,
    returned: str | None,
) -> tuple[str | None, str | None]:
    """Signatures without the modules of types."""

    def short(text: str | None) -> str | None:
        return text and re.sub(r"~?\b(?:[A-Za-z_]\w*\.)+", "", text.replace("<factory>", "..."))

    return (short(signature) or "").replace("~", "") or signature, short(returned)


def setup(app: Any) -> dict[str, bool]:
    """Take part in a build."""
    app.connect("builder-inited", write_pages)
    app.connect("autodoc-process-docstring", as_prose)
    app.connect("autodoc-process-signature", short_types)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
