"""Pages that are made from the package itself: models, estimators, the scenario file.

They are written below reference/generated/ when a build begins. Docstrings of the package are prose
with formulas in plain letters; `prose` makes of them what reStructuredText reads as that.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

from relnav_graph.registry import classes
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
    if not any(row[2] for row in rows):  # nothing is said of any
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
    return "must be given"


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


def _said(schema: dict[str, Any], defs: dict[str, Any]) -> str:
    """The type that a piece of the schema allows, in words."""
    if "$ref" in schema:
        return f"table, see `{schema['$ref'].rsplit('/', 1)[1]}`_"
    if "enum" in schema:
        return " or ".join(f"``{value!r}``" for value in schema["enum"])
    if "const" in schema:
        return f"``{schema['const']!r}``"
    if "anyOf" in schema:
        parts = [_said(one, defs) for one in schema["anyOf"]]
        both = {"number", "text"} <= set(parts)
        parts = [p for p in parts if p != "nothing" and not (both and p in ("number", "text"))]
        return " or ".join(dict.fromkeys([*(["number, or text with its unit"] * both), *parts]))
    kind = schema.get("type")
    if kind == "array":
        return f"list of {_said(schema['items'], defs)}" if "items" in schema else "list"
    names = {"string": "text", "object": "table", "null": "nothing", "boolean": "true or false"}
    return names.get(str(kind), str(kind) if kind else "anything")


#: What stands at the top of a scenario file; the schema says of it what it may be.
TOP = {
    "title": "a line, with the name of the scenario before a colon",
    "description": "what it is, and where its numbers are from",
    "base": "the scenario, or scenarios, that this one changes; later ones win",
    "seed": "root of all random numbers",
    "estimators": "those that ``relnav compare`` runs, where none is named",
    "evaluate": "the part of the pass that is scored, as fractions or times",
    "time": "step, epochs, absolute time",
    "data": "recorded data, and how they are read",
    "online": "the window of what runs online",
    "orbit": "of the target; the chaser's own where it is estimated",
    "truth": "what is true in a simulated pass, ``statics`` and ``map`` of recorded ones, too",
    "truth_noise": "one sigma of a truth that was measured",
    "score": "axes in which vectors are compared, blocks that are left out",
    "control": "the controller of a loop",
    "inputs": "instruments, such as a gyro, by name: how they are simulated",
    "gaps": "how gaps of an input are bridged, by its name",
    "stamps": "lag and jitter of clocks, by name of an input or a sensor",
    "processes": "how states go on, by name: any of the processes",
    "sensors": "what is measured, by name: any of the sensors, with gate, loss, period",
    "prior": "what is known beforehand, by the name of a state",
}


def _rows(
    properties: dict[str, Any], defs: dict[str, Any], about: Mapping[str, str]
) -> list[list[str]]:
    rows = []
    for name, schema in properties.items():
        what = about.get(name) or " ".join(prose(schema.get("description", "")))
        default = schema.get("default")
        plain = isinstance(default, (int, float, str)) and default != ""
        rows.append([f"``{name}``", _said(schema, defs), what, f"``{default!r}``" if plain else ""])
    return rows


def _scenario_file() -> list[str]:
    from relnav_graph.scenario.json_schema import json_schema

    schema = json_schema()
    defs = schema["$defs"]
    header = ["key", "type", "what", "default"]
    out = [*_section("Tables of a scenario file", "="), *prose(schema["description"])]
    if missing := set(schema["properties"]) - set(TOP):
        raise KeyError(f"{missing}: no word on these keys in TOP")
    out += [*_section("Top level", "-"), *_table(header, _rows(schema["properties"], defs, TOP))]
    for name, one in defs.items():
        if "properties" in one:
            out += [*_section(name, "-"), *prose(one.get("description", ""))]
            out += _table(header, _rows(one["properties"], defs, {}))
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
