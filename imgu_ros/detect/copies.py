# SPDX-License-Identifier: Apache-2.0
"""Of the places where a target looks like itself, the one that a frame shows."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from imgu_ros.config.parameters import RefinementParameters
from imgu_ros.errors import EstimationError, LooksAlike
from imgu_ros.image.frame_image import FrameImage
from imgu_ros.pose.planar_pose import Located, require_plausible
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.self_similarity import Copy
from imgu_ros.reference.verification import Evidence, better_of, evidence
from imgu_ros.track.patch_alignment import align_patches
from imgu_ros.types import Matrix3
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.projective.transform import inverse3

#: Corners that move less are at the same place, raw px.
_SAME_PX = 6.0
#: Copies of copies that are looked at: so many periods.
_MOST_MOVES = 6
#: Where a copy differs by at most this share of the cells with texture, few cells tell where the target is: this share
#: of what is in view must look as it should, lest those that tell are the covered ones.
_NEARLY_SAME, _CLEARLY = 0.12, 0.97
#: Share of what is in view that looks as it should from which on a tracked reference's copies are not compared.
PERFECT = 0.985
#: Error of a copy that alignment must bridge, raw px: copies are known to a px or two of a small image.
_REACH_PX = 16.0


def best_copy(
    frame: FrameImage,
    reference: Reference,
    located: Located,
    found: Evidence,
    camera: Camera | None,
    parameters: RefinementParameters,
    min_inliers: int,
) -> tuple[Located, Evidence]:
    """Return where a reference is, of the places where it looks like itself, and what the frame says of it.

    When it looks the same turned, `Located.alike` says by which motions.

    Parameters
    ----------
    frame : the frame's image
    reference : the reference
    located, found : where it seems to be, and what the frame says of that, be it confirming or not
    camera : intrinsics when the lens distorts; else None
    parameters, min_inliers : those of the alignment

    Raises
    ------
    LooksAlike
        If the frame does not tell two of them apart.
    """
    copies = reference.copies(frame.is_linear)
    if not copies:
        return located, found
    own = evidence(frame, reference, located.homography.H, camera, is_close=True)
    best = _CopyPlace(located, located.homography.H, own or found)
    motions = _motions(copies)
    rivals: list[_CopyPlace] = []
    for _ in range(_MOST_MOVES):
        rivals = [
            candidate
            for H, copy in motions
            if (candidate := _candidate(frame, reference, best.H @ H, camera, parameters, min_inliers, copy))
        ]
        better = max(rivals, key=lambda each: each.evidence.weight, default=None)
        if better is None or better_of(best.evidence, better.evidence) != 1:
            break
        # A copy of a copy may be better still: of a pattern, several periods away.
        best = better
    else:
        raise LooksAlike("the target looks the same shifted by a period, again and again", best.evidence.share)
    if best.located is None:
        raise LooksAlike("the place that fits best cannot be aligned", best.evidence.share)
    alike = [copy for copy in copies if copy.is_symmetry]
    for rival in rivals:
        if rival.copy is None or _apart_px(reference, rival.H, best.H) < _SAME_PX:
            continue
        if better_of(best.evidence, rival.evidence) != 0:
            if not rival.copy.turn_deg:
                raise LooksAlike("the target looks the same shifted by a period", best.evidence.share)
            alike.append(rival.copy)
    has_near_copy = any(copy.differing_share <= _NEARLY_SAME for copy in copies if copy not in alike)
    if has_near_copy and best.evidence.is_confirming and best.evidence.share < _CLEARLY:
        share = best.evidence.share
        raise LooksAlike(f"{share:.0%} of what is in view looks as it should, {_CLEARLY:.0%} needed", share)
    return replace(best.located, alike=tuple(copy.H for copy in alike)), best.evidence


def still_alike(
    frame: FrameImage, reference: Reference, located: Located, camera: Camera | None
) -> tuple[Matrix3, ...]:
    """Return the motions of `located.alike` after which a tracked reference still looks the same.

    Parameters
    ----------
    frame, reference, camera : see `best_copy`
    located : where the track led
    """
    # `best_copy` puts them first.
    certain = sum(copy.is_symmetry for copy in reference.copies(frame.is_linear))
    alike, doubtful = located.alike[:certain], located.alike[certain:]
    if doubtful:
        H = located.homography.H if located.H_seen is None else located.H_seen
        own = evidence(frame, reference, H, camera, is_close=True)
        others = ((S, evidence(frame, reference, H @ S, camera, is_close=True)) for S in doubtful)
        alike += tuple(S for S, there in others if better_of(own, there) != 0)
    return alike


def require_no_better_copy(frame: FrameImage, reference: Reference, located: Located, camera: Camera | None) -> None:
    """Raise `LooksAlike` when the frame shows a tracked reference at another place where it looks much like itself.

    A track that is off by a period of a pattern is confirmed by most of the pattern.

    Parameters
    ----------
    frame, reference, camera : see `best_copy`
    located : where the track led
    """
    motions = _motions(reference.copies(frame.is_linear))
    if not motions:
        return
    H = located.homography.H if located.H_seen is None else located.H_seen
    own = evidence(frame, reference, H, camera, is_close=True)
    for motion, _ in motions:
        there = evidence(frame, reference, H @ motion, camera, is_close=True)
        if there is not None and there.is_confirming and better_of(own, there) == 1:
            raise LooksAlike("the target looks the same at another place, which fits better")


def _motions(copies: Iterable[Copy]) -> list[tuple[Matrix3, Copy]]:
    """Return the motions to where a target looks like itself and a frame may tell them apart, and back by a period."""
    copies = [copy for copy in copies if not copy.is_symmetry]
    back = [(inverse3(copy.H), copy) for copy in copies if not copy.turn_deg]
    return [(copy.H, copy) for copy in copies] + back


@dataclass(frozen=True, slots=True, eq=False)
class _CopyPlace:
    """A place where a reference may be: as located, None where patches do not agree; `copy`: what led there."""

    located: Located | None
    H: Matrix3
    evidence: Evidence
    copy: Copy | None = None


def _candidate(
    frame: FrameImage,
    reference: Reference,
    H: Matrix3,
    camera: Camera | None,
    parameters: RefinementParameters,
    min_inliers: int,
    copy: Copy,
) -> _CopyPlace | None:
    """Return what the frame says of a copy's place, aligned where patches agree; None where it does not confirm it."""
    located: Located | None
    try:
        located = align_patches(frame, reference, H, camera, parameters, min_inliers, _REACH_PX)
        require_plausible(reference.plane, located.homography)
        H = located.homography.H
    except EstimationError:
        located = None
    try:
        seen = evidence(frame, reference, H, camera, is_close=True)
    except EstimationError:
        return None
    return _CopyPlace(located, H, seen, copy) if seen is not None and seen.is_confirming else None


def _apart_px(reference: Reference, first: Matrix3, second: Matrix3) -> float:
    """Return how far apart two homographies put the corners of a reference, rms, ideal px."""
    mapped = np.stack((first, second)) @ reference.outline_homogeneous
    xy = mapped[:, :2] / mapped[:, 2:]
    return float(np.sqrt(((xy[0] - xy[1]) ** 2).sum(axis=0).mean()))
