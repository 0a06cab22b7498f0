# SPDX-License-Identifier: Apache-2.0
"""What of a target is said when it is loaded: a line where it will hardly be found, and why."""

from __future__ import annotations

from collections.abc import Iterable

from imgu_ros.check.traits import traits_of
from imgu_ros.check.verdict import LOAD_REASONS, ReasonKind, reasons_of
from imgu_ros.reference.reference import Reference

#: Of printed targets those that are found nevertheless differ in more from their closest copy, nearly always. Measured:
#: benchmarks/target_scores.py.
_TOLD = 0.1


def load_remarks(references: Iterable[Reference], linear: bool = True) -> dict[str, str]:
    """Return a line for each reference that is a poor target, by name; of the others nothing.

    A reference takes some hundredths of a second, for what its first detection would need anyhow.

    Parameters
    ----------
    references : loaded
    linear : see `Reference.templates`: what frames are compared with
    """
    said = {}
    for reference in references:
        if reference.codes:
            continue  # by the hundred, and each has a code of its own
        traits = traits_of(reference, linear)
        reasons = [reason for reason in reasons_of(traits) if reason.kind in LOAD_REASONS]
        if reasons and reasons[0].kind is not ReasonKind.FEW_CORNERS and traits.telling_share > _TOLD:
            continue
        if reasons:
            said[reference.name] = f"target {reference.name}: {reasons[0].text}; `imgu check` says more"
    return said
