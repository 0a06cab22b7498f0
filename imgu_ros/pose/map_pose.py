# SPDX-License-Identifier: Apache-2.0
"""Where the camera is in the map, told by all targets whose places are known; and what that tells of other targets."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from imgu_ros.errors import EstimationError
from imgu_ros.pose.planar_pose import distorting_camera, seen_outline
from imgu_ros.pose.plane import Plane
from imgu_ros.result import PoseStatus, ReferenceResult
from imgu_ros.types import Floats, Matrix3
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.pose_fusion import FusedPose, fuse_poses, pose_seen_from
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.rotation import log_so3
from imgu_ros.vision.projective.homography import HomographyEstimate
from imgu_ros.vision.projective.transform import inverse3

#: Of several poses of a target, that whose rotation differs by at most this, rad, from what others tell is right, when
#: the next one differs by so many times as much.
_NEAR_RAD, _CLEARLY = math.radians(10), 4.0


def map_places(names: Iterable[str], poses: Sequence[RigidTransform]) -> dict[str, RigidTransform]:
    """Return the places of references in the map, `map_from_reference`, by their names; of those that have a pose."""
    return dict(zip(names, poses, strict=False))


def camera_in_map(results: Iterable[ReferenceResult], places: Mapping[str, RigidTransform]) -> FusedPose | None:
    """Return `map_from_camera`, fused over the references by their covariances; None when none has a pose.

    The error of each reference's pose is its own (other pixels, other noise). Their places are taken as exact as long
    as that explains the poses. When references contradict each other, all are taken to be misplaced, their corners by
    the same standard deviation, as large as explains it; or, where a width is not known, the covariance grows instead.

    Parameters
    ----------
    results : of a frame
    places : of the references, `map_from_reference`, by name

    Raises
    ------
    EstimationError
        If the poses contradict each other so much that no pose lies between them.
    """
    seen = [
        (found, found.pose, places[found.name]) for found in results if found.pose is not None and found.name in places
    ]
    poses = [pose_seen_from(place, pose.inverse()) for _, pose, place in seen]
    if len(poses) < 2 or not all(found.width_m for found, _, _ in seen):
        return fuse_poses(poses) if poses else None
    slack = [
        _misplacement(place.t - pose.t, found.width_m) for (found, _, place), pose in zip(seen, poses, strict=True)
    ]
    return fuse_poses(poses, slack)


def told_apart(
    results: Mapping[str, ReferenceResult],
    planes: Mapping[str, Plane],
    places: Mapping[str, RigidTransform],
    camera: Camera | None,
) -> tuple[dict[str, ReferenceResult], set[str]]:
    """Return results of which ambiguous poses are settled by targets that are not, and the names of those turned.

    A target that looks the same when it is turned, or whose two planar solutions fit alike, has the pose that agrees
    with where the other targets say that the camera is.

    Parameters
    ----------
    results : of a frame, by name
    planes : of the references, by name
    places : of those whose places in the map are known
    camera : of the frame
    """
    settled, turned = dict(results), set[str]()
    ambiguous = [each for each in results.values() if each.pose_status is PoseStatus.AMBIGUOUS and each.name in places]
    if not ambiguous:
        return settled, turned
    try:
        fused = camera_in_map(results.values(), places)
    except EstimationError:
        fused = None
    if fused is None:
        return settled, turned
    for found in ambiguous:
        expected = fused.pose.transform.inverse().after(places[found.name])
        away = [float(np.linalg.norm(log_so3(pose.R @ expected.R.T))) for pose in found.solutions]
        order = np.argsort(away)
        best = int(order[0])
        if away[best] > _NEAR_RAD or (len(order) > 1 and away[best] * _CLEARLY > away[order[1]]):
            continue
        # First the planar solutions, then those of each motion.
        motion = best // (len(found.solutions) // (1 + len(found.alike)))
        if motion:
            found = _turned(found, found.alike[motion - 1], planes[found.name], camera)
            turned.add(found.name)
        settled[found.name] = replace(
            found, pose_status=PoseStatus.METRIC, reason="", pose=found.solutions[best], alike=()
        )
    return settled, turned


def _turned(found: ReferenceResult, S: Matrix3, plane: Plane, camera: Camera | None) -> ReferenceResult:
    """Return a result whose homography H has become H S, and what goes with it."""
    assert found.homography is not None
    estimate = found.homography
    H = estimate.H @ S
    size = float(np.linalg.norm(H))
    h = (H / size).ravel()
    J = (np.eye(9) - np.outer(h, h)) @ np.kron(np.eye(3), S.T) / size
    turned = HomographyEstimate(
        H / size, J @ estimate.covariance @ J.T, estimate.inliers, estimate.rms_px, estimate.iterations
    )
    outline, lens = seen_outline(plane, H), distorting_camera(camera)
    matches = found.matches
    if matches is not None:
        x, y, w = inverse3(S) @ np.vstack((matches.template_xy.T, np.ones(len(matches.template_xy))))
        matches = replace(matches, template_xy=np.column_stack((x / w, y / w)))
    return replace(
        found,
        homography=turned,
        outline=outline if lens is None else lens.raw_pixels(outline),
        matches=matches,
        H_seen=None if found.H_seen is None else found.H_seen @ S,
        sampled=None,
    )


def _misplacement(from_camera: Floats, width_m: float) -> Floats:
    """Return the covariance (6, 6) of the camera's pose when a target's corners are misplaced by one metre.

    Four corners half a width from the centre give the centre's place to 1/2 m and its turn to 1 / `width_m` rad.

    Parameters
    ----------
    from_camera : (3,) m, the target's place less the camera's, in the map
    """
    x, y, z = from_camera
    # The target's turn carries the camera around the target: by turn x (camera - target).
    J = np.eye(6)
    J[:3, 3:] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    return np.asarray(J @ np.diag([0.25] * 3 + [width_m**-2] * 3) @ J.T, np.float64)
