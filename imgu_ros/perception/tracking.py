"""Following a target from frame to frame: predict, align, and say whether it holds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imgu_ros.errors import DegenerateConfiguration, EstimationError, NoConsensus
from imgu_ros.params import Parameters
from imgu_ros.perception.posing import Located, bending, require_plausible
from imgu_ros.perception.refinement import Alignment, refine_by_alignment
from imgu_ros.perception.targets import Target
from imgu_ros.types import Image, Matrix3
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.projective.transform import faces_camera, normalised_homography

#: Image pyramid levels that bridge the error of a prediction.
_PREDICTION_LEVELS = 3
#: Of the patches sought, the share that must agree for a track to hold.
_HELD_SHARE = 0.4
_HELD_RMS_PX = 1.0
#: Between these quotients of two intervals the motion goes on as it was; else the target is looked for where it was.
_STEADY = (0.5, 2.0)


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """Where a target was seen: H_image_template in ideal px, and when."""

    H: Matrix3
    stamp_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """The last sighting of a target, and the one before it in the frame before, if there was one."""

    last: Sighting
    before: Sighting | None = None

    def continued(self, H: Matrix3, stamp_ns: int) -> Track:
        """Return the track with one more sighting."""
        return Track(Sighting(H, stamp_ns), self.last)

    def predicted(self, target: Target, stamp_ns: int) -> Matrix3:
        """Return where the target is expected: moved on by the last motion of the image, H1 H0^-1 H1."""
        last, before = self.last, self.before
        if before is None or last.stamp_ns <= before.stamp_ns:
            return last.H
        quotient = (stamp_ns - last.stamp_ns) / (last.stamp_ns - before.stamp_ns)
        if not _STEADY[0] <= quotient <= _STEADY[1]:
            return last.H
        moved = normalised_homography(last.H @ np.linalg.solve(before.H, last.H))
        return moved if faces_camera(moved, target.outline_template) else last.H


def follow(
    target: Target,
    track: Track,
    grey: Image,
    stamp_ns: int,
    camera: Camera | None,
    parameters: Parameters,
    rng: np.random.Generator,
) -> Alignment:
    """Find a target where its track leads.

    Parameters
    ----------
    target, track : what is followed, and from where
    grey : (H, W) uint8, the frame
    stamp_ns : the frame's
    camera : intrinsics, or None
    parameters : all parameters
    rng : source of the draws of the robust fit

    Raises
    ------
    EstimationError
        If the track does not hold.
    """
    alignment: Alignment | None = None
    reason = "track: lost"
    for H in _starts(track, target, stamp_ns):
        try:
            alignment = refine_by_alignment(
                grey,
                target,
                H,
                bending(camera),
                parameters.refinement,
                parameters.homography.min_inliers,
                rng,
                _PREDICTION_LEVELS,
            )
            break
        except EstimationError as error:
            reason = str(error)
    if alignment is None:
        raise NoConsensus(reason)
    held = len(alignment.template_xy)
    if held < _HELD_SHARE * alignment.sought or alignment.homography.rms_px > _HELD_RMS_PX:
        raise NoConsensus(
            f"track: {held} of {alignment.sought} patches agree, rms {alignment.homography.rms_px:.2f} px; "
            f"need {_HELD_SHARE:.0%} and {_HELD_RMS_PX:g} px"
        )
    require_plausible(target, alignment.homography)
    return alignment


def located(alignment: Alignment) -> Located:
    """Return the place that an alignment tells."""
    return Located(alignment.template_xy, alignment.image_xy, alignment.homography, alignment.correlation)


def _starts(track: Track, target: Target, stamp_ns: int) -> tuple[Matrix3, ...]:
    """Return where to look: where the motion leads, then where the target was last."""
    try:
        predicted = track.predicted(target, stamp_ns)
    except (DegenerateConfiguration, np.linalg.LinAlgError):
        return (track.last.H,)
    return (predicted,) if predicted is track.last.H else (predicted, track.last.H)
