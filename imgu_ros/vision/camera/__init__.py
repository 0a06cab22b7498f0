# SPDX-License-Identifier: Apache-2.0
"""The camera: from rays to pixels and back, and what pictures of known things tell about it (IU 1.1.1-1.1.3, 8).

| you have | you want | take |
|---|---|---|
| K, lens distortion | pixels of points, rays of pixels | `intrinsics.make_camera`, `Camera` |
| an angle of view, or a lens and its sensor | K | `angle_of_view.intrinsic_matrix`, `intrinsic_matrix_of_lens` |
| views of a chessboard | K and distortion, with covariance | `imgu calibrate`; `chessboard`, `calibration` |
| K, R, t | P = K (R, t), centre, depths | `projection` |
| P | K, R, t | `decomposition.decompose_projection` |
| points in space and their pixels | P | `resection.fit_projection`; some wrong: `camera_model.estimate_projection` |
| the same, and a calibrated camera | pose with covariance | `pose_estimate.fit_pose`; some wrong: `estimate_pose` |
| points of a plane and their pixels | both poses that fit | `planar_pose.planar_poses` |
| their homography (`projective.homography`) | the same poses, faster | `homography_pose.poses_of_homography` |
| H of a plane | pose, exact | `plane_view.pose_from_plane_homography` |
| the same, not quite exact | the two poses that fit it at a point | `homography_pose.poses_about_point` |
| two views from one place | R | `rotation_view`; from points, some wrong: `rotation_model.estimate_rotation` |
| a rotation | angles, quaternion, rotation vector | `euler`, `rotation` |

Conventions: pixels x right, y down, centres at integers; the camera looks along +z. `pose` means camera_from_object.
Covariances are of (x y z rx ry rz), with R_true = Exp(r) R. The models of distortion (`distortion`) are ROS's
`plumb_bob`, `rational_polynomial` and `equidistant`, and OpenCV's `thin_prism` and `tilted`. Each has an inverse up to
the radius at which it stops growing (`distortion.fold_radius`): `undistort` marks pixels beyond it, where OpenCV's
functions return a number all the same.

In the pipeline: camera_info reaches it as a `Camera`; `camera.rectified` says that the images are undistorted;
`poses_of_homography` gives the pose of every target whose patches were aligned, `planar_poses` that of one found by
matches alone, and `pose.ambiguity_ratio` decides when both solutions fit. The rest is for the library's users and for
`imgu calibrate`. Calibrate with the model that your lens needs: `plumb_bob` up to about 100 degrees of view,
`rational_polynomial` for wide lenses with many good views, `equidistant` for fisheyes.

Three slips of IU: R_y in 8.1.5 is printed transposed, its last line reads x1 ~ K R^T K^-1 x2 (the inverse of
x2 ~ K R K^-1 x1), and the y axis of 8.1.3 points up, where pictures have it down.
"""

from imgu_ros.vision.camera.angle_of_view import AngleOfView, angle_of_view, intrinsic_matrix, intrinsic_matrix_of_lens
from imgu_ros.vision.camera.bundle import BundleProblem, BundleState
from imgu_ros.vision.camera.calibration import CalibratedView, Calibration, calibrate
from imgu_ros.vision.camera.calibration_evidence import CalibrationEvidence, weigh_calibration
from imgu_ros.vision.camera.calibration_test import CalibrationTest
from imgu_ros.vision.camera.camera_covariance import as_covariance, covariance_factor, factor_of, with_covariance
from imgu_ros.vision.camera.camera_derivatives import ideal_by_camera, raw_by_camera
from imgu_ros.vision.camera.camera_model import ProjectionModel, estimate_projection
from imgu_ros.vision.camera.chessboard import Chessboard, find_chessboard
from imgu_ros.vision.camera.correspondences import as_correspondences
from imgu_ros.vision.camera.decomposition import CameraParts, decompose_projection, rq
from imgu_ros.vision.camera.distortion import DistortedPoints, distort, distort_with_derivatives, fold_radius, undistort
from imgu_ros.vision.camera.distortion_model import DistortionModel, as_coefficients, as_distortion_model
from imgu_ros.vision.camera.dot_grid import find_dots
from imgu_ros.vision.camera.euler import EulerOrder, euler_angles, from_euler
from imgu_ros.vision.camera.homography_pose import poses_about_point, poses_of_homography
from imgu_ros.vision.camera.intrinsics import Camera, make_camera
from imgu_ros.vision.camera.planar_pose import planar_pose_starts, planar_poses
from imgu_ros.vision.camera.plane_view import plane_homography, pose_from_plane_homography
from imgu_ros.vision.camera.pose import PlanarPoses, Pose
from imgu_ros.vision.camera.pose_estimate import PoseEstimate, PoseModel, estimate_pose, fit_pose
from imgu_ros.vision.camera.pose_fusion import FusedPose, fuse_poses, pose_after, pose_seen_from
from imgu_ros.vision.camera.pose_problem import PoseProblem, point_by_pose
from imgu_ros.vision.camera.projection import (
    as_intrinsic_matrix,
    camera_centre,
    camera_to_world,
    depths,
    finite_camera,
    project,
    projection_matrix,
    world_to_camera,
)
from imgu_ros.vision.camera.resection import ProjectionEstimate, design_matrix, fit_projection, projection_dlt
from imgu_ros.vision.camera.rigid import RigidTransform, rigid_transform, rigid_transforms
from imgu_ros.vision.camera.rotation import as_rotation, exp_so3, from_quaternion, log_so3, nearest_rotation, quaternion
from imgu_ros.vision.camera.rotation_model import RotationEstimate, RotationModel, estimate_rotation
from imgu_ros.vision.camera.rotation_view import rotation_from_homography, rotation_homography
from imgu_ros.vision.camera.sensor_tilt import tilt_derivatives, tilt_matrix
from imgu_ros.vision.camera.view_choice import board_turns, choose_views, without_copies

__all__ = [
    "AngleOfView",
    "BundleProblem",
    "BundleState",
    "CalibratedView",
    "Calibration",
    "CalibrationEvidence",
    "CalibrationTest",
    "Camera",
    "CameraParts",
    "Chessboard",
    "DistortedPoints",
    "DistortionModel",
    "EulerOrder",
    "FusedPose",
    "PlanarPoses",
    "Pose",
    "PoseEstimate",
    "PoseModel",
    "PoseProblem",
    "ProjectionEstimate",
    "ProjectionModel",
    "RigidTransform",
    "RotationEstimate",
    "RotationModel",
    "angle_of_view",
    "as_coefficients",
    "as_correspondences",
    "as_covariance",
    "as_distortion_model",
    "as_intrinsic_matrix",
    "as_rotation",
    "board_turns",
    "calibrate",
    "camera_centre",
    "camera_to_world",
    "choose_views",
    "covariance_factor",
    "decompose_projection",
    "depths",
    "design_matrix",
    "distort",
    "distort_with_derivatives",
    "estimate_pose",
    "estimate_projection",
    "estimate_rotation",
    "euler_angles",
    "exp_so3",
    "factor_of",
    "find_chessboard",
    "find_dots",
    "finite_camera",
    "fit_pose",
    "fit_projection",
    "fold_radius",
    "from_euler",
    "from_quaternion",
    "fuse_poses",
    "ideal_by_camera",
    "intrinsic_matrix",
    "intrinsic_matrix_of_lens",
    "log_so3",
    "make_camera",
    "nearest_rotation",
    "planar_pose_starts",
    "planar_poses",
    "plane_homography",
    "point_by_pose",
    "pose_after",
    "pose_from_plane_homography",
    "pose_seen_from",
    "poses_about_point",
    "poses_of_homography",
    "project",
    "projection_dlt",
    "projection_matrix",
    "quaternion",
    "raw_by_camera",
    "rigid_transform",
    "rigid_transforms",
    "rotation_from_homography",
    "rotation_homography",
    "rq",
    "tilt_derivatives",
    "tilt_matrix",
    "undistort",
    "weigh_calibration",
    "with_covariance",
    "without_copies",
    "world_to_camera",
]
