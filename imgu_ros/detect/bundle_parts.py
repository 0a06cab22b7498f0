# SPDX-License-Identifier: Apache-2.0
"""Markers of a rigid thing that are in view beside those that were found: its pose says where they should be."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import cv2
import numpy as np

from imgu_ros.config.parameters import Parameters
from imgu_ros.detect.frame_context import FrameContext
from imgu_ros.errors import EstimationError, NotConfirmed
from imgu_ros.pose.planar_pose import distorting_camera, require_determined, require_plausible, seen_outline
from imgu_ros.reference.bundle import BundleReference
from imgu_ros.reference.code_reading import read_code
from imgu_ros.reference.marker import MarkerReference
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.verification import require_confirmed
from imgu_ros.result import ReferenceResult
from imgu_ros.track.patch_alignment import align_patches
from imgu_ros.track.tracker import Followed, followed_result
from imgu_ros.types import Matrix3
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.rigid import RigidTransform

#: Error of a place by the thing's pose, raw px.
_REACH_PX = 2.0
#: A marker that is seen more from the side than by this cosine tells little.
_STEEPEST = 0.2
#: Smallest side of a marker in the frame, px.
_SMALLEST_PX = 12.0


def parts_beside(
    context: FrameContext, reference: Reference, results: Mapping[str, ReferenceResult], parameters: Parameters
) -> Iterator[ReferenceResult]:
    """Yield the results of parts of a bundle that were not found and are where its pose has them.

    Where the parts that were found allow two poses, both are tried: which of them other parts confirm tells which is
    right.

    Parameters
    ----------
    context : the frame
    reference : a bundle
    results : of its parts, by name
    parameters : all parameters
    """
    camera = context.frame.camera
    found = {part.name for part in reference.parts if part.name in results and results[part.name].status.found}
    if camera is None or not found or not isinstance(reference, BundleReference):
        return
    thing = reference.combined(results, context.frame)
    for part in reference.parts:
        if part.name in found:
            continue
        for solution in thing.solutions:
            place = solution.transform.after(reference.place_of(part.name))
            try:
                H = _view(part, camera, place)
                followed = _confirmed(context, part, H, parameters)
                yield part.pose(followed_result(part, followed, thing.status), followed.alignment, context.frame)
                break
            except EstimationError:
                continue


def _view(part: MarkerReference, camera: Camera, place: RigidTransform) -> Matrix3:
    """Return H_image_template of a marker; raise where it is not seen from its front, too small or out of view."""
    steepness = -float(place.R[:, 2] @ place.t) / max(float(np.linalg.norm(place.t)), 1e-9)
    if not (place.t[2] > 0 and steepness > _STEEPEST):
        raise NotConfirmed("it shows its back")
    H: Matrix3 = camera.K @ np.column_stack((place.R[:, :2], place.t)) @ part.plane.metres_from_template
    H /= math.sqrt(float(np.vdot(H, H)))
    outline = seen_outline(part.plane, H)
    if abs(cv2.contourArea(outline.astype(np.float32))) < steepness * _SMALLEST_PX**2:
        raise NotConfirmed("too small")
    middle = outline.mean(axis=0, keepdims=True)
    # The lens model is valid near the image only.
    if camera.is_distorted and np.abs(middle).max() < 2 * max(camera.width, camera.height):
        middle = camera.raw_pixels(middle)
    if not ((middle >= 0) & (middle <= (camera.width - 1, camera.height - 1))).all():
        raise NotConfirmed("not in view")
    return H


def _confirmed(context: FrameContext, part: MarkerReference, H: Matrix3, parameters: Parameters) -> Followed:
    """Return where a marker is near H; raise where the frame does not show it."""
    image, lens, p = context.image, distorting_camera(context.frame.camera), parameters
    aligned = align_patches(image, part, H, lens, p.refinement, p.homography.min_inliers, _REACH_PX)
    require_plausible(part.plane, aligned.homography)
    seen = aligned.homography.H if aligned.H_seen is None else aligned.H_seen
    evidence = require_confirmed(image, part, seen, lens)
    require_determined(part.plane, aligned, evidence.is_covered)
    (code,) = part.codes
    read = read_code(image, code, seen, lens)
    if evidence.is_covered or read is None or read.wrong > code.tolerated:
        raise NotConfirmed("cells of its code differ")
    return Followed(aligned, evidence.share)
