# SPDX-License-Identifier: Apache-2.0
"""Named cases."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Entry:
    """A named case: what reads it, and what builds it in a folder and returns what is to be opened."""

    reader: str
    build: Callable[[Path], Path]


CORPUS: dict[str, Entry] = {}
