# SPDX-License-Identifier: Apache-2.0
"""What was looked for in vain."""

from __future__ import annotations

from collections.abc import Mapping

from imgu_ros.result import Result


class SearchFailures:
    """What was looked for in vain: how near it came to being found."""

    def __init__(self) -> None:
        self._found_s: float | None = None
        self._most: dict[str, int] = {}

    @property
    def found_s(self) -> float | None:
        """When a target was seen last (monotonic); None: never yet."""
        return self._found_s

    @property
    def most_inliers(self) -> Mapping[str, int]:
        """The most inliers of each target since it was seen last."""
        return self._most

    def add(self, result: Result, now_s: float) -> None:
        """Take what became of the targets in one more frame."""
        most = dict(self._most)
        for target in result:
            if target.status.found:
                self._found_s = now_s
                most.pop(target.name, None)
            else:
                most[target.name] = max(most.get(target.name, 0), target.most_inliers)
        self._most = most

    def clear(self) -> None:
        """Begin anew."""
        self._found_s, self._most = None, {}
