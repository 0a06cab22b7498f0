# SPDX-License-Identifier: Apache-2.0
"""Which remarks were made before: each is for people once, however many frames make it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

_MOST = 50
_NUMBER = re.compile(r"\d+(\.\d+)?(e[+-]?\d+)?")


class Remarks:
    """Tells which remarks are new; those that differ in their numbers alone count as one."""

    def __init__(self) -> None:
        self._kinds: set[str] = set()

    def news(self, lines: Iterable[str]) -> Iterator[str]:
        """Yield the lines of a kind that was not there before, of the first fifty kinds."""
        for line in lines:
            kind = _NUMBER.sub("0", line)
            if line and kind not in self._kinds and len(self._kinds) < _MOST:
                self._kinds.add(kind)
                yield line
