# SPDX-License-Identifier: Apache-2.0
"""matplotlib with its own defaults and nobody's settings.

Its settings come from a file `matplotlibrc`, of the current folder first. There it may have come with somebody's data,
and it can make drawings fail or start `latex`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl


@contextmanager
def plot_style(settings: Any) -> Iterator[None]:
    """Draw with matplotlib's defaults, but for `settings`; those of the caller are back afterwards."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(settings)
        yield
