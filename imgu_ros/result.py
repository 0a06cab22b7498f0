# SPDX-License-Identifier: Apache-2.0
"""What comes out of the pipeline, with every intermediate."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum

from imgu_ros.frame import Frame
from imgu_ros.image.frame_image import FrameImage
from imgu_ros.image.transfer_fit import TransferKind
from imgu_ros.types import Floats, Image, Mask, Matrix3, Points
from imgu_ros.vision.camera.calibration_test import CalibrationTest
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.keypoints.keypoints import Keypoints
from imgu_ros.vision.matching.matches import Matches
from imgu_ros.vision.projective.homography import HomographyEstimate
from imgu_ros.vision.scale_space.pyramid import Pyramid

#: The transfer curves that users are told of.
_CURVES: dict[TransferKind | None, str] = {
    TransferKind.SRGB: "sRGB",
    TransferKind.FITTED: "a curve that was fitted to the target",
}


class Stage(StrEnum):
    """Stages of the pipeline, in order; the names in `frames.csv` and in `status`."""

    DEVELOP = "develop"
    PYRAMID = "pyramid"
    KEYPOINTS = "keypoints"
    DESCRIBE = "describe"
    MATCH = "match"
    HOMOGRAPHY = "homography"
    REFINE = "refine"
    POSE = "pose"


class StageClock:
    """Sums the time that each stage takes."""

    def __init__(self) -> None:
        self.times_ns: dict[Stage, int] = {}

    @contextmanager
    def measures(self, stage: Stage) -> Iterator[None]:
        """Add the time of the block to the stage's."""
        start = time.perf_counter_ns()
        try:
            yield
        finally:
            self.times_ns[stage] = self.times_ns.get(stage, 0) + time.perf_counter_ns() - start


class Status(StrEnum):
    """What became of one target in one frame."""

    TRACKED = "tracked"
    DETECTED = "detected"
    LOST = "lost"
    DEGENERATE = "degenerate"
    REJECTED = "rejected"

    @property
    def found(self) -> bool:
        """Whether there is a homography."""
        return self in (Status.TRACKED, Status.DETECTED)


class PoseStatus(StrEnum):
    """What became of the pose of a target."""

    NONE = ""
    METRIC = "metric"
    AMBIGUOUS = "ambiguous"
    UNCALIBRATED = "uncalibrated"
    NO_SIZE = "no_size"


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceMatches:
    """Correspondences between a target and the frame, best first.

    Of a detected target they are the tentative matches of keypoints; of a tracked one the patches that were followed
    and agree.

    Attributes
    ----------
    matches : indices into the target's and the frame's keypoints, with the descriptor distance; -1 when they are of
        a thorough search or of a part of the frame, -1 and 0 for patches
    template_xy : (N, 2) px of the full-resolution target image
    image_xy : (N, 2) raw px of the frame
    inliers : (N,) agrees with the homography; all False when there is none
    """

    matches: Matches
    template_xy: Points
    image_xy: Points
    inliers: Mask


@dataclass(frozen=True, slots=True, eq=False)
class SampledPatches:
    """Patches of a reference that were compared with the raw samples of a frame: the next frame begins with them.

    Attributes
    ----------
    template_xy : (N, 2) px, their centres
    kept : (N,) those that agreed
    sought : number of patches when they were chosen
    frames : number of frames in which they were compared
    zoom : by what factor the reference is larger than when they were chosen
    scale : px of the frame in one of the template when they were chosen
    spread : (3,) px^2, variances xx, xy, yy of the image's point spread
    """

    template_xy: Points
    kept: Mask
    sought: int
    frames: int
    zoom: float
    scale: float
    spread: Floats


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceResult:
    """One target in one frame.

    Attributes
    ----------
    name, number : of the reference, and its place in `targets.images`, which messages carry
    status, pose_status : see there
    reason : why there is no homography or no pose, in the user's terms first; empty when nothing is missing
    matches : tentative matches; None when the stage was not reached
    homography : H_image_template with its covariance, in ideal (undistorted) pixels of the camera when the
        camera is calibrated and distorted, else in raw pixels; None when not found
    outline : (4, 2) raw px, the target's outer corners: top left, top right, bottom right, bottom left;
        None when not found
    pose : camera_from_target with its covariance; None unless `pose_status` is metric
    solutions : the refined planar solutions, best first: two, or one when the other cannot be; after them those of
        `alike`, in its order
    ambiguity : best / second-best reprojection error of the solutions, 0 to 1; None without solutions
    calibration : what the picture says of the camera's numbers beside the pose; None without a pose, or when
        nobody asked for it
    alike : motions (3, 3) of the template after which the target looks the same where it is: with each of them there is
        another homography H S, and another pose, that fits as well
    sampled : patches that were compared with the raw samples, for its track; None: none were
    H_seen : where a rolling shutter shows the target, for its track; None: as `homography`
    is_sharp : whether its points were seen at full resolution: what blurred ones say of the calibration is not counted
    confirmed_share : share of the target in view that looks as it should where it was found, or was thought to be, 0 to
        1: of its cells with texture that can tell, those that look alike; None: not compared
    width_m : of the target, by which the pose has its size; 0: there is no pose
    most_inliers : of a target that was looked for and not found, the most matches that agreed on where it could be
    """

    name: str
    number: int
    status: Status
    pose_status: PoseStatus = PoseStatus.NONE
    reason: str = ""
    matches: ReferenceMatches | None = None
    homography: HomographyEstimate | None = None
    outline: Points | None = None
    pose: Pose | None = None
    solutions: tuple[Pose, ...] = ()
    ambiguity: float | None = None
    confirmed_share: float | None = None
    width_m: float = 0.0
    most_inliers: int = 0
    calibration: CalibrationTest | None = None
    is_sharp: bool = True
    H_seen: Matrix3 | None = None
    sampled: SampledPatches | None = None
    alike: tuple[Matrix3, ...] = ()


def by_name(results: Iterable[ReferenceResult]) -> dict[str, ReferenceResult]:
    """Return results keyed by the names of their references, in the given order."""
    return {result.name: result for result in results}


@dataclass(frozen=True, slots=True)
class CalibrationFinding:
    """What the frames so far say about the camera's calibration.

    Attributes
    ----------
    views : different views of targets that were weighed, the newest
    chi_squared : mean of their squared misfits, of 2 degrees of freedom: about 2 when the calibration is right
    focal_percent : by how much the focal length is too long, should it alone be wrong
    focal_sigma_percent : its standard deviation, the calibration's own uncertainty included
    is_focal : whether the focal length explains what does not fit
    warning : what the user should know; empty when the calibration fits
    """

    views: int
    chi_squared: float
    focal_percent: float
    focal_sigma_percent: float
    is_focal: bool
    warning: str


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """One frame's way through the pipeline.

    Attributes
    ----------
    frame : what went in
    references : by name, one entry for each known reference, in their order; also when the frame was rejected
    reason : why the frame was rejected; empty when it was not
    developed : grey picture, and colour on demand; None when the frame was rejected
    pyramid, keypoints, descriptors : intermediates; None when no target had to be looked for
    calibration : what this frame and those before it say of the camera's calibration; None before the first pose
    transfer : how the camera's values follow from the light, once that is settled
    times_ns : time that each stage took, for the stages that ran
    total_ns : time of the whole frame
    """

    frame: Frame
    references: Mapping[str, ReferenceResult]
    reason: str = ""
    developed: FrameImage | None = None
    pyramid: Pyramid | None = None
    keypoints: Keypoints | None = None
    descriptors: Image | None = None
    calibration: CalibrationFinding | None = None
    transfer: TransferKind | None = None
    times_ns: Mapping[Stage, int] | None = None
    total_ns: int = 0

    def __iter__(self) -> Iterator[ReferenceResult]:
        return iter(self.references.values())

    @property
    def first(self) -> ReferenceResult:
        """The result of the first reference, for users of a single one."""
        return next(iter(self))

    @property
    def camera_remarks(self) -> tuple[str, ...]:
        """What people should know of the camera that is used, by what is said of it and by what is seen."""
        remarks = list(self.frame.camera_remarks)
        if self.calibration is not None and self.calibration.warning:
            remarks.append(self.calibration.warning)
        if self.transfer in _CURVES:
            remarks.append(f"image values do not go with the light, but follow {_CURVES[self.transfer]} (raw.transfer)")
        return tuple(remarks)
