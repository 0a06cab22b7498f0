# SPDX-License-Identifier: Apache-2.0
"""Following a reference from frame to frame: predict, align, and decide whether the track holds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import EstimationError, NoConsensus
from imgu_ros.image.frame_image import FrameImage
from imgu_ros.pose.planar_pose import Located, bending, require_plausible
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.verification import require_confirmed
from imgu_ros.track.patch_alignment import PatchAlignment, align_patches
from imgu_ros.track.prediction import Track
from imgu_ros.track.shift_search import shifted_homography
from imgu_ros.types import Matrix3
from imgu_ros.vision.camera.intrinsics import Camera

#: Share of the patches that must agree for a track to hold. Measured: benchmarks/thresholds.py, study tracking.
_HELD_SHARE = 0.25
#: Largest RMS residual of a track that holds, px of the level. Measured: benchmarks/thresholds.py, study tracking.
_HELD_RMS_PX = 0.5
#: The next prediction may be wrong by this factor times the last prediction error. Measured: benchmarks/thresholds.py,
#: study reach.
_SURPRISE = 1.5
#: Smallest prediction error allowed for, raw px. Measured: benchmarks/thresholds.py, study reach.
_LEAST_REACH_PX = 2.0
#: Prediction error allowed for when no motion is known, raw px. Measured: benchmarks/thresholds.py, study reach.
_UNKNOWN_REACH_PX = 24.0
#: Longest shift that is searched, as a share of the frame's width. Measured: benchmarks/thresholds.py, study reach.
_LONGEST_SHIFT = 0.1


def follow(
    target: Reference, track: Track, pictures: FrameImage, stamp_ns: int, camera: Camera | None, parameters: Parameters
) -> PatchAlignment:
    """Find a reference where its track leads.

    Parameters
    ----------
    target, track : the reference, and its last observations
    pictures, stamp_ns : the frame's
    camera : intrinsics, or None
    parameters : all parameters

    Raises
    ------
    EstimationError
        If the track does not hold.
    """
    reason = "track: lost"
    lens = bending(camera)
    for start in _starts(track, target, stamp_ns, pictures.shape[1]):
        try:
            H = shifted_homography(pictures, target, start.H, lens, start.shift_px) if start.shift_px else start.H
            alignment = align_patches(
                pictures,
                target,
                H,
                lens,
                parameters.refinement,
                parameters.homography.min_inliers,
                start.reach_px,
            )
            rms_px = alignment.homography.rms_px / 2**alignment.halvings
            if alignment.agreeing_share < _HELD_SHARE or rms_px > _HELD_RMS_PX:
                raise NoConsensus(
                    f"track: {len(alignment.template_xy)} of {alignment.sought} patches agree, rms {rms_px:.2f} px; "
                    f"need {_HELD_SHARE:.0%} and {_HELD_RMS_PX:g} px"
                )
            require_plausible(target.plane, alignment.homography)
            if alignment.halvings:
                # Coarse patches agree by chance sooner: the whole reference is compared, too.
                require_confirmed(pictures, target, alignment.homography.H, lens)
        except EstimationError as error:
            reason = str(error)
        else:
            return alignment
    raise NoConsensus(reason)


def located(alignment: PatchAlignment) -> Located:
    """Return where an alignment found the reference."""
    a = alignment
    return Located(a.template_xy, a.image_xy, a.homography, a.normal_equations, a.halvings)


@dataclass(frozen=True, slots=True, eq=False)
class _Start:
    """Start of an alignment: H with an error up to `reach_px`, after a search for shifts up to `shift_px`; raw px."""

    H: Matrix3
    reach_px: float
    shift_px: float = 0.0


def _starts(track: Track, target: Reference, stamp_ns: int, width: int) -> Iterator[_Start]:
    """Yield starts: the prediction, the same with larger errors, then the last observation, each also with a shift."""
    expected, last = track.expected(target, stamp_ns), track.last.H
    reach = _UNKNOWN_REACH_PX
    if expected.error_px is not None:
        reach = min(max(_SURPRISE * expected.error_px, _LEAST_REACH_PX), reach)
    yield _Start(expected.H, reach)
    if reach < _UNKNOWN_REACH_PX:
        yield _Start(expected.H, _UNKNOWN_REACH_PX)
    # A motion that ends or reverses leaves the reference near its last position.
    if expected.H is not last:
        yield _Start(last, _UNKNOWN_REACH_PX)
    shift = max(_LONGEST_SHIFT * width, _UNKNOWN_REACH_PX)
    yield _Start(expected.H, _UNKNOWN_REACH_PX, shift)
    if expected.H is not last:
        yield _Start(last, _UNKNOWN_REACH_PX, shift)
