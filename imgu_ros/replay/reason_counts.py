# SPDX-License-Identifier: Apache-2.0
"""Counts why things failed, without growing with the number of frames."""

from __future__ import annotations

import re
from collections.abc import Sequence

from imgu_ros.report.summary import Reason

_MOST = 100
_NUMBER = re.compile(r"\d+(\.\d+)?(e[+-]?\d+)?")


class Reasons:
    """Counts reasons by status; reasons that differ only in their numbers count as one."""

    def __init__(self) -> None:
        self._first: dict[tuple[str, str], str] = {}
        self._count: dict[tuple[str, str], int] = {}

    def add(self, status: str, reason: str) -> bool:
        """Count one case; return whether it is the first of its kind."""
        key = (status, _NUMBER.sub("0", reason))
        if key not in self._first and len(self._first) >= _MOST:
            key, reason = (status, ""), "other reasons"
        is_new = key not in self._first
        if is_new:
            self._first[key] = reason
        self._count[key] = self._count.get(key, 0) + 1
        return is_new

    def counted(self) -> Sequence[Reason]:
        """Return all kinds, the most frequent first, each with its first case's words."""
        reasons = [Reason(status, self._first[status, kind], n) for (status, kind), n in self._count.items()]
        return tuple(sorted(reasons, key=lambda reason: (-reason.count, reason.status, reason.reason)))
