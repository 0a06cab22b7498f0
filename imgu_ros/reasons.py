# SPDX-License-Identifier: Apache-2.0
"""Why a target has no homography or no pose: in the user's terms first, then in numbers. All such words are here."""

from __future__ import annotations

import re
from collections.abc import Sequence

from imgu_ros.errors import (
    DegenerateConfiguration,
    EstimationError,
    LooksAlike,
    NoConsensus,
    NotConfirmed,
    TooFewPoints,
    Undetermined,
)

NOT_IN_VIEW = "not in view, too small, blurred or covered"
NOT_DUE = "not looked for in this frame, while others are in view (tracking.search_every)"
UNLIKELY = f"{NOT_IN_VIEW} (fewer of its keypoints than of other targets)"
NO_CAMERA_INFO = "no calibration: there is no camera_info"
NO_SIZE = "its printed width is not known, need targets.widths_m (0 for this target)"

_A_NUMBER = re.compile(r"\d+(\.\d+)?(e[+-]?\d+)?")


def reason_kind(reason: str) -> str:
    """Return what reasons that differ only in their numbers have in common."""
    return _A_NUMBER.sub("0", reason)


def why_not_found(error: EstimationError, matches: int, agreeing: int, needed: int) -> str:
    """Return why a target that was looked for was not found.

    Parameters
    ----------
    error : what the search ended with
    matches : tentative ones
    agreeing : the most of them that agreed on where the target could be
    needed : fewest that must agree
    """
    if isinstance(error, NotConfirmed):
        return f"something like it is in view, or it is mostly covered ({error})"
    if isinstance(error, LooksAlike):
        return f"in view, but it cannot be told how it is turned or where in it ({error})"
    if isinstance(error, Undetermined):
        return f"too little of it is in view or uncovered to tell its pose ({error})"
    if isinstance(error, DegenerateConfiguration):
        return f"seen too steeply, too small or mirrored ({error})"
    if isinstance(error, TooFewPoints | NoConsensus) and matches < needed:
        return f"{NOT_IN_VIEW} ({matches} matches, {needed} needed)"
    if isinstance(error, NoConsensus) and agreeing < needed:
        return f"{NOT_IN_VIEW} ({agreeing} of {matches} matches agree, {needed} needed)"
    return f"{NOT_IN_VIEW} ({error})"


def another_fits_better(name: str) -> str:
    """Return why a target is not found where another one that shares a part with it is."""
    return f"{name} is there, which looks much like it and fits better"


def not_told_from(name: str) -> str:
    """Return why neither of two targets is found that share a part."""
    return f"it or {name} is in view: what they differ in is covered, too small or blurred"


def seen_twice(count: int) -> str:
    """Return why a marker is not found of which several are in view."""
    return f"{count} markers with its id are in view: which one is meant cannot be told; need ids that occur once"


def no_matches() -> str:
    """Return why a target is not found of which a stage got no matches."""
    return f"{NOT_IN_VIEW} (no matches)"


def no_homography() -> str:
    """Return why a target has no pose of which a stage got no homography."""
    return f"{NOT_IN_VIEW} (no homography)"


def unusable_frame(why: str) -> str:
    """Return why no target is found in a frame that cannot be read or developed."""
    return f"the frame cannot be used ({why})"


def why_ambiguous(ratio: float, limit: float) -> str:
    """Return why there is no pose where both planar solutions fit: `ratio` of their errors, `limit` for a pose."""
    return (
        "two poses fit alike, need a view from nearer or more from the side "
        f"(ratio of their errors {ratio:.2f}, at most {limit:g} for a pose)"
    )


def looks_the_same(turns_deg: Sequence[float]) -> str:
    """Return why there is no pose of a target that looks the same when turned by these angles, degrees."""
    turns = " or ".join(f"{turn:.0f}" for turn in sorted(turns_deg))
    return f"it looks the same turned by {turns} degrees: which way it is turned cannot be told"


def no_pose(error: EstimationError) -> str:
    """Return why there is no pose where none can be computed."""
    return f"no camera sees the target so ({error})"
