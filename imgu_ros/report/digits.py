# SPDX-License-Identifier: Apache-2.0
"""Numbers as people read them."""

from __future__ import annotations

from imgu_ros.report.summary import Percentiles


def figures(value: float | Percentiles | None, digits: int = 3) -> str:
    """Return a number with that many significant digits, without an exponent where it reads well; a dash for None."""
    if value is None:
        return "–"
    if isinstance(value, Percentiles):
        return f"{figures(value.p50, digits)} / {figures(value.p95, digits)}"
    if value and not 1e-4 <= abs(value) < 1e7:
        return f"{value:.{digits - 1}e}"
    rounded = float(f"{value:.{digits}g}")
    return f"{rounded:.0f}" if abs(rounded) >= 10 ** (digits - 1) else f"{value:#.{digits}g}".rstrip(".")
