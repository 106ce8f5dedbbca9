"""What a page refers to that is not in it."""

from __future__ import annotations

import re
from html.parser import HTMLParser

SELF_CONTAINED = re.compile(r"#|data:")
#: Attributes whose value is an address.
ADDRESSES = {"src", "href", "srcset", "data", "poster", "action", "formaction", "background",
             "cite", "manifest", "ping", "xlink:href"}  # fmt: skip
FETCHING = {"link", "base", "iframe", "frame", "object", "embed", "applet"}


class Outside(HTMLParser):
    """What a page refers to that is not in it, and its policy."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self.policy: dict[str, list[str]] = {}
        self.inside = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.inside = tag
        if tag in FETCHING or given.get("http-equiv", "").lower() == "refresh":
            self.found.append(f"<{tag}>")
        for name, value in given.items():
            if name in ADDRESSES and not SELF_CONTAINED.match(value):
                self.found.append(f"{name}={value[:60]}")
        self._css(given.get("style", ""))
        if given.get("http-equiv") == "Content-Security-Policy":
            parts = [part.split() for part in given["content"].split(";")]
            self.policy = {name: sources for name, *sources in parts}

    def handle_endtag(self, tag: str) -> None:
        self.inside = ""

    def handle_data(self, data: str) -> None:
        if self.inside == "style":
            self._css(data)

    def _css(self, text: str) -> None:
        self.found += re.findall(r"@import[^;]*", text)
        addresses = re.findall(r"url\(\s*['\"]?([^)'\"]*)", text)
        self.found += [a for a in addresses if not SELF_CONTAINED.match(a)]
