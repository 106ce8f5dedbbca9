"""Numbers in the tables of README and documentation are among what the page's commands printed.

`docs/run_blocks.py` runs the commands at full size and stores what they print. What is compared
here is stored: the pass itself is not run again.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from scripts import loaded

docs = loaded(Path(__file__).parents[2] / "docs" / "run_blocks.py")
#: A number that stands by itself: no part of a name, of an exponent, or of the end of a range.
_NUMBER = re.compile(r"(?<![\w^])(?<!\d\.)[-+]?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?(?![\w^]|\.\d)")


def _value(text: str) -> float:
    return float(text.replace(",", ""))


def _rounding(text: str) -> float:
    """Half a unit of the last place that a number shows; the zeros of 1,074,000 show none."""
    digits, _, exponent = text.replace(",", "").lstrip("+-").partition("e")
    whole, _, decimals = digits.partition(".")
    places = -len(decimals) if decimals else len(whole) - len(whole.rstrip("0") or whole)
    return 0.5 * 10.0 ** (places + int(exponent or 0))


def unprinted(page: str, output: str) -> list[str]:
    """The numbers of a page's tables, the first column apart, that no command has printed."""
    printed = [abs(_value(one)) for one in re.findall(r"\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?", output)]
    found = []
    for line in page.splitlines():
        if line.startswith("|") and set(line) - set("|-: "):
            said = re.sub(r"`[^`]*`", "", " | ".join(line.strip("|").split(" | ")[1:]))
            for one in _NUMBER.findall(said):
                allowed = _rounding(one) * (1 + 1e-6)
                if not any(abs(v - abs(_value(one))) <= allowed for v in printed):
                    found.append(one)
    return found


def _commands(page: Path) -> list[str]:
    return [one for block in docs.to_run(page) for one in docs.full_size(block)]


@pytest.mark.parametrize("page", [p for p in docs.PAGES if _commands(p)], ids=docs.name_of)
def test_commands_of_a_page_have_printed_its_numbers(page: Path) -> None:
    again = f"expected what `python docs/run_blocks.py {docs.name_of(page)}` stores"
    assert docs.stored(page).is_file(), again
    output = docs.stored(page).read_text("utf-8")
    asked = re.findall(r"^\$ (.*)$", output, re.MULTILINE)
    assert asked == _commands(page), again
    assert unprinted(page.read_text("utf-8"), output) == [], again


def test_nothing_is_stored_of_pages_that_are_gone() -> None:
    wanted = {docs.stored(page) for page in docs.PAGES if _commands(page)}
    assert set(docs.OUTPUTS.rglob("*.txt")) == wanted


@pytest.mark.parametrize(
    ("cell", "output", "missing"),
    [
        ("0.3802 (0.352 to 0.411)", "0.38021 0.3517..0.4109", []),
        ("1,074,000", "1.0741e+06", []),
        ("1,074,000", "1.08e+06", ["1,074,000"]),
        ("-9.8 m and `x2` of 3", "9.84", ["3"]),
        ("12.5 %", "12.46%", []),
        ("12.5 %", "12.4%", ["12.5"]),
        ("1e10", "1.048e+10", []),
    ],
)
def test_a_number_is_found_as_it_is_rounded(cell: str, output: str, missing: list[str]) -> None:
    page: Any = f"| name | 7 |\n| --- | --- |\n| a 5 | {cell} |\n"
    assert unprinted(page, f"7 {output}") == missing
