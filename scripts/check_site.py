# SPDX-License-Identifier: Apache-2.0
"""Check the links of a built site, without a network: python scripts/check_site.py SITE.

Every link to a file of the site leads to one, and its anchor to an element there. Nothing that a page loads (scripts,
styles, pictures, fonts) comes from elsewhere. Links to other hosts are listed and not followed.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

#: Attributes that name what a page loads when it is opened.
LOADED = {("script", "src"), ("img", "src"), ("source", "src"), ("video", "src"), ("iframe", "src"), ("link", "href")}
#: Relations of <link> that load nothing.
UNLOADED = {"canonical", "prev", "next", "alternate", "author", "license"}
_STYLE = re.compile(r"(?:url\(\s*['\"]?|@import\s+['\"])((?:https?:)?//[^'\")\s]+)")


@dataclass
class Page:
    """What a page names and what can be named in it."""

    links: list[str] = field(default_factory=list)
    loaded: list[str] = field(default_factory=list)
    anchors: set[str] = field(default_factory=set)


class _Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.page = Page()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value for name, value in attrs if value is not None}
        self.page.anchors.update(values[name] for name in ("id", "name") if name in values)
        for name, value in values.items():
            if (tag, name) in LOADED and not set(values.get("rel", "").split()) & UNLOADED:
                self.page.loaded.append(value)
            elif name in ("href", "src"):
                self.page.links.append(value)


def read(path: Path) -> Page:
    """Return what a page of HTML names."""
    reader = _Reader()
    reader.feed(path.read_text(encoding="utf-8"))
    return reader.page


def check(site: Path) -> tuple[list[str], set[str]]:
    """Return what is wrong with a site, a line each, and the addresses elsewhere that it links to."""
    pages = {path: read(path) for path in sorted(site.rglob("*.html"))}
    problems, elsewhere = [], set()
    if not pages:
        return [f"{site}: no page of HTML"], set()
    for path, page in pages.items():
        shown = path.relative_to(site)
        for link in [*page.links, *page.loaded]:
            parts = urlsplit(link)
            if parts.scheme in ("data", "mailto", "javascript"):
                continue
            if parts.scheme or parts.netloc:
                elsewhere.add(link)
                if link in page.loaded:
                    problems.append(f"{shown}: loads {link}")
                continue
            # The page for what is not found names files from the root, wherever it is shown.
            base = site if parts.path.startswith("/") else path.parent
            target = (base / unquote(parts.path).lstrip("/")).resolve() if parts.path else path.resolve()
            target = target / "index.html" if target.is_dir() else target
            if not target.is_file():
                problems.append(f"{shown}: {link}: no such file")
            elif parts.fragment and target.suffix == ".html":
                known = pages.get(target) or next(p for q, p in pages.items() if q.resolve() == target)
                if unquote(parts.fragment) not in known.anchors:
                    problems.append(f"{shown}: {link}: no such anchor")
    for path in sorted(site.rglob("*.css")):
        for address in _STYLE.findall(path.read_text(encoding="utf-8")):
            problems.append(f"{path.relative_to(site)}: loads {address}")
    return problems, elsewhere


def main(site: Path) -> int:
    """Print what is wrong and what is elsewhere; return 1 if anything is wrong."""
    problems, elsewhere = check(site)
    print(*problems, sep="\n", end="\n" if problems else "")
    print(*(f"elsewhere, not followed: {link}" for link in sorted(elsewhere)), sep="\n")
    print(f"{site}: {len(problems)} wrong links")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
