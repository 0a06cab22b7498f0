# SPDX-License-Identifier: Apache-2.0
"""Progress of long work on stderr: a bar on a terminal, else a plain line now and then, with rate and time left."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Any, Self

from imgu_ros.cli.terminal import tell
from imgu_ros.shown_text import shown

_LINE_EVERY_S = 5.0


class Progress:
    """Counts units of work; a context manager.

    Parameters
    ----------
    label : what is counted, such as `replay`
    unit : plural of the unit, such as `frames`
    """

    def __init__(self, label: str, unit: str = "frames") -> None:
        self._label = label
        self._unit = unit
        self._bar: Any = None
        self._on_terminal = sys.stderr.isatty()
        self._done = 0
        self._total: int | None = None
        self._started_s = time.monotonic()
        self._next_line_s = self._started_s + _LINE_EVERY_S

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.close()
        elif kind is None and self._done:
            self._line(is_end=True)

    def __call__(self, done: int, total: int | None) -> None:
        """Say that `done` of `total` units (None: how many is not known) are done."""
        self._done, self._total = done, total
        if self._on_terminal:
            self._advance_bar()
        elif time.monotonic() >= self._next_line_s:
            self._line()
            self._next_line_s = time.monotonic() + _LINE_EVERY_S

    def say(self, text: str) -> None:
        """Print a line on stderr without tearing the bar."""
        if self._bar is None:
            tell(text)
        else:
            self._bar.write(shown(text), file=sys.stderr)

    def _advance_bar(self) -> None:
        if self._bar is None:
            from tqdm import tqdm

            self._bar = tqdm(desc=self._label, unit=f" {self._unit}", total=self._total, dynamic_ncols=True)
        self._bar.total = self._total
        self._bar.update(self._done - self._bar.n)
        if self._done == self._total:  # what follows is no part of the rate that the bar shows
            self._bar.close()

    def _line(self, is_end: bool = False) -> None:
        of_total = f" of {self._total}" if self._total else ""
        took_s = time.monotonic() - self._started_s
        rate = self._done / took_s if took_s > 0 else 0.0
        left = f", {(self._total - self._done) / rate:.0f} s left" if self._total and rate and not is_end else ""
        tell(f"{self._label}: {self._done}{of_total} {self._unit}, {rate:.3g} a second{left}")
