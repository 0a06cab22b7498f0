"""The camera: from rays to pixels and back, and what pictures of known things tell about it (notes 1.1.1-1.1.3, 8).

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
| their homography (`projective.condensed`) | the same poses, faster | `homography_pose.poses_of_homography` |
| H of a plane | pose, exact | `plane_view.pose_from_plane_homography` |
| the same, not quite exact | the two poses that fit it at a point | `ippe.poses_about_point` |
| two views from one place | R | `rotation_view`; from points, some wrong: `rotation_model.estimate_rotation` |
| a rotation | angles, quaternion, rotation vector | `euler`, `rotation` |

Conventions: pixels x right, y down, centres at integers; the camera looks along +z. `pose` means camera_from_object.
Covariances are of (x y z rx ry rz), with R_true = Exp(r) R. The models of distortion (`distortion`) are ROS's
`plumb_bob`, `rational_polynomial` and `equidistant`. Each has an inverse up to the radius at which it stops growing
(`distortion.fold_radius`): `undistort` marks pixels beyond it, where OpenCV's functions return a number all the same.

In the chain: camera_info reaches it as a `Camera`; `camera.rectified` says that the images have no distortion any more;
`poses_of_homography` gives the pose of every target whose patches were aligned, `planar_poses` that of one found by
matches alone, and `pose.ambiguity_ratio` decides when both solutions fit. The rest is for the library's users and for
`imgu calibrate`. Calibrate with the model that your lens needs: `plumb_bob` up to about 100 degrees of view,
`rational_polynomial` for wide lenses with many good views, `equidistant` for fisheyes.

Three slips of the notes: R_y in 8.1.5 is printed transposed, its last line reads x1 ~ K R^T K^-1 x2 (the inverse of
x2 ~ K R K^-1 x1), and the y axis of 8.1.3 points up, where pictures have it down.
"""
