# SPDX-License-Identifier: Apache-2.0
"""Following a target from frame to frame: predict, align, and say whether it holds."""

from __future__ import annotations

from dataclasses import dataclass

from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import EstimationError, NoConsensus
from imgu_ros.image.frame_image import FrameImage
from imgu_ros.pose.planar_pose import Located, bending, require_plausible
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.verification import require_confirmed
from imgu_ros.track.prediction import Track
from imgu_ros.track.refinement import Alignment, refine_by_alignment
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
) -> Alignment:
    """Find a target where its track leads.

    Parameters
    ----------
    target, track : what is followed, and from where
    pictures : the frame's
    stamp_ns : the frame's
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
            alignment = refine_by_alignment(
                pictures,
                target,
                H,
                lens,
                parameters.refinement,
                parameters.homography.min_inliers,
                start.reach_px,
            )
            _require_held(alignment)
            require_plausible(target.plane, alignment.homography)
            if alignment.halvings:
                # Coarse patches agree by chance sooner: the whole target must look as it should.
                require_confirmed(pictures, target, alignment.homography.H, lens)
        except EstimationError as error:
            reason = str(error)
        else:
            return alignment
    raise NoConsensus(reason)


def located(alignment: Alignment) -> Located:
    """Return the place that an alignment tells."""
    return Located(
        alignment.template_xy, alignment.image_xy, alignment.homography, alignment.condensed, alignment.halvings
    )


def _require_held(alignment: Alignment) -> None:
    held, rms_px = len(alignment.template_xy), alignment.homography.rms_px / 2**alignment.halvings
    if held < _HELD_SHARE * alignment.sought or rms_px > _HELD_RMS_PX:
        raise NoConsensus(
            f"track: {held} of {alignment.sought} patches agree, rms {rms_px:.2f} px; "
            f"need {_HELD_SHARE:.0%} and {_HELD_RMS_PX:g} px"
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Start:
    """Where to look: from H, by alignment that bridges `reach_px`, after any shift up to `shift_px`; raw px."""

    H: Matrix3
    reach_px: float
    shift_px: float = 0.0


def _starts(track: Track, target: Reference, stamp_ns: int, width: int) -> list[_Start]:
    """Return where to look: near where the motion leads, then farther around, then where the target was last."""
    expected = track.expected(target, stamp_ns)
    shift = max(_LONGEST_SHIFT * width, _UNKNOWN_REACH_PX)
    reach = _UNKNOWN_REACH_PX
    if expected.wrong_px is not None:
        reach = min(max(_SURPRISE * expected.wrong_px, _LEAST_REACH_PX), reach)
    starts = [_Start(expected.H, reach)]
    if reach < _UNKNOWN_REACH_PX:
        starts.append(_Start(expected.H, _UNKNOWN_REACH_PX))
    if expected.H is not track.last.H:
        # A motion that ends or turns back leaves the target near where it was.
        starts.append(_Start(track.last.H, _UNKNOWN_REACH_PX))
    starts.append(_Start(expected.H, _UNKNOWN_REACH_PX, shift))
    if expected.H is not track.last.H:
        starts.append(_Start(track.last.H, _UNKNOWN_REACH_PX, shift))
    return starts
