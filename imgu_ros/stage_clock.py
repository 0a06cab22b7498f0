# SPDX-License-Identifier: Apache-2.0
"""How long each stage of the chain takes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from imgu_ros.result import Stage


class StageClock:
    """Sums the time that each stage takes."""

    def __init__(self) -> None:
        self.times_ns: dict[Stage, int] = {}

    @contextmanager
    def measures(self, stage: Stage) -> Iterator[None]:
        """Add the time of the block to the stage's."""
        start = time.perf_counter_ns()
        try:
            yield
        finally:
            self.times_ns[stage] = self.times_ns.get(stage, 0) + time.perf_counter_ns() - start
