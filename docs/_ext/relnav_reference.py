"""Pages that are made from the package itself: models, estimators, the scenario file.

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
    out = [".. list-table::", "   :header-rows: 1", f"   :widths: {widths}", ""]
    for row in [header, *rows]:
        cells = [cell.replace("\n", " ") or " " for cell in row]
        out += [f"   {'* -' if k == 0 else '  -'} {cell}" for k, cell in enumerate(cells)]
    return [*out, ""]


def _shape(quantity: Quantity) -> str:
    if not quantity.shape:
        return "one number"
    size = " x ".join("n" if n is None else str(n) for n in quantity.shape)
    return f"{size} numbers" + (", or one for all" if quantity.fill else "")


def _type(hint: Any) -> str:
    if get_origin(hint) is not None and "Literal" in str(get_origin(hint)):
        return " or ".join(f'``"{choice}"``' for choice in get_args(hint))
    if hasattr(hint, "__metadata__"):
        return _type(hint.__origin__)
    name = getattr(hint, "__name__", "") if get_origin(hint) is None else str(hint)
    return "``" + re.sub(r"\b(\w+\.)+", "", name or str(hint)) + "``"


def _what(cls: type, name: str) -> str:
    known = quantities(cls).get(name)
    if known is None:
        return _type(get_type_hints(cls, include_extras=True)[name])
    sign = "positive " if known.positive else "not negative, " if known.nonnegative else ""
    words = "".join(f', or ``"{word}"``' for word in known.words)
    unit = "" if known.unit == "1" else f", {_escaped(known.unit)}"
    return sign + _shape(known) + unit + words


def _default(field: dataclasses.Field[Any]) -> str:
    if field.default is not dataclasses.MISSING:
        return "none" if field.default is None else f"``{field.default!r}``"
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


def _rows(properties: dict[str, Any], defs: dict[str, Any]) -> list[list[str]]:
    rows = []
    for name, schema in properties.items():
        about = " ".join(prose(schema.get("description", "")))
        default = schema.get("default")
        plain = isinstance(default, (int, float, str)) and default != ""
        rows.append(
            [f"``{name}``", _said(schema, defs), f"``{default!r}``" if plain else "", about]
        )
    return rows


def _scenario_file() -> list[str]:
    from relnav_graph.scenario.json_schema import json_schema

    schema = json_schema()
    defs = schema["$defs"]
    header = ["key", "type", "default", "what"]
    out = [*_section("Tables of a scenario file", "="), *prose(schema["description"])]
    out += [*_section("Top level", "-"), *_table(header, _rows(schema["properties"], defs))]
    for name, one in defs.items():
        if "properties" in one:
            out += [*_section(name, "-"), *prose(one.get("description", ""))]
            out += _table(header, _rows(one["properties"], defs))
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


def setup(app: Any) -> dict[str, bool]:
    """Take part in a build."""
    app.connect("builder-inited", write_pages)
    app.connect("autodoc-process-docstring", as_prose)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
