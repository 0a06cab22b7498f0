# SPDX-License-Identifier: Apache-2.0
"""What a named case is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Entry:
    """A named case.

    Attributes
    ----------
    reader : what reads it
    build : makes it in an empty folder; returns what is to be opened
    deep : the whole command is run on it too
    messages : of a recording, the least that must be read
    is_read : it can be read, at least in part; None: it may be refused
    says : is in what is said of it
    """

    reader: str
    build: Callable[[Path], Path]
    deep: bool = False
    messages: int = 0
    is_read: bool | None = None
    says: str = ""


def file_of(name: str, content: Callable[[], bytes]) -> Callable[[Path], Path]:
    """Return a builder of one file."""

    def build(folder: Path) -> Path:
        path = folder / name
        path.write_bytes(content())
        return path

    return build
