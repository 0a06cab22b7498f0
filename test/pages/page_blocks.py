# SPDX-License-Identifier: Apache-2.0
"""The commands on the pages: fenced blocks, and the comment before one that says why it is not run."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(str(path.relative_to(ROOT)) for path in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
_BLOCK = re.compile(
    r"^(?P<mark> *<!-- not run: (?P<reason>[^>]*) -->\n)?^(?P<indent> *)(?:\d+\. )?```(?P<language>\w+)\n"
    r"(?P<text>.*?)^ *```$",
    re.MULTILINE | re.DOTALL,
)


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, its text, and why it is not run (empty: it is)."""

    page: str
    language: str
    text: str
    reason: str


def blocks(page: str) -> list[Block]:
    """Return the blocks of a page, in their order."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return [
        Block(page, found["language"], re.sub(r"^ +(?=\S)", "", found["text"], flags=re.MULTILINE)
              if found["indent"] else found["text"], found["reason"] or "")
        for found in _BLOCK.finditer(text)
    ]  # fmt: skip


def commands(page: str) -> list[Block]:
    """Return the blocks of a page that a shell runs."""
    return [block for block in blocks(page) if block.language in ("sh", "bash")]
