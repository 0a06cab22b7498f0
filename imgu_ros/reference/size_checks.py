# SPDX-License-Identifier: Apache-2.0
"""Whether the printed width that somebody gave a target can be: a wrong unit puts it absurdly far or near."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from imgu_ros.reference.reference import Reference
from imgu_ros.result import Result

#: A print this wide, seen from as far as `_FAR_M`, has its width in centimetres or millimetres far more often than it
#: is a facade. A landing pad 5 m wide may be seen from 80 m, and a floor 12 m wide from 3 m.
_WIDE_M = 10.0
#: See `_WIDE_M`.
_FAR_M = 10.0
#: No lens but a microscope's is nearer than this.
_NEAR_M = 0.01
#: Widths that prints have.
_USUAL_M = (0.03, 2.0)


def size_warning(name: str, width_m: float, distance_m: float) -> str:
    """Return what is implausible about a target's width, and what was likely meant; empty when nothing is.

    A homography tells the quotient of distance and width alone: no pose can be wrong by itself. What is judged is
    whether both are lengths that prints and cameras have.

    Parameters
    ----------
    name : of the target
    width_m : as `targets.widths_m` says
    distance_m : from the camera to the target's centre, of its pose

    Examples
    --------
    >>> size_warning("poster", 0.594, 0.8)
    ''
    >>> size_warning("pad", 5.0, 80.0)
    ''
    >>> size_warning("a", 594.0, 800.0)
    'targets.widths_m 594: a would be 594 m wide and 800 m away; widths are in metres: did you mean 0.594 (594 mm)?'
    """
    if width_m >= _WIDE_M and distance_m >= _FAR_M:
        likely = _usual({width_m / 100: f" ({width_m:g} cm)", width_m / 1000: f" ({width_m:g} mm)"})
    elif 0 < distance_m < _NEAR_M:
        likely = _usual({width_m * 1000: "", width_m * 100: ""})
    else:
        return ""
    hint = f": did you mean {likely}?" if likely else ""
    said = f"{name} would be {_length(width_m)} wide and {_length(distance_m)} away"
    return f"targets.widths_m {width_m:g}: {said}; widths are in metres{hint}"


class SizeChecks:
    """Says once of each target that its width is implausible, as soon as a pose shows it.

    Parameters
    ----------
    references : the known ones
    """

    def __init__(self, references: Iterable[Reference] = ()) -> None:
        self._widths_m = {name: each.width_m for each in references for name in each.names}
        self.warnings: dict[str, str] = {}

    def add(self, result: Result) -> list[str]:
        """Look at a frame's poses; return what is new."""
        new = []
        for found in result:
            if found.pose is None or found.name in self.warnings or found.name not in self._widths_m:
                continue
            warning = size_warning(found.name, self._widths_m[found.name], float(np.linalg.norm(found.pose.t)))
            if warning:
                self.warnings[found.name] = warning
                new.append(warning)
        return new


def _usual(widths_m: Mapping[float, str]) -> str:
    return " or ".join(f"{m:.4g}{unit}" for m, unit in widths_m.items() if _USUAL_M[0] <= m <= _USUAL_M[1])


def _length(metres: float) -> str:
    return f"{metres:.4g} m" if metres >= 0.01 else f"{1e3 * metres:.2g} mm"
