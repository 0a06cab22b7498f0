# SPDX-License-Identifier: Apache-2.0
"""Intrinsics and lens distortion from views of a plane with known points (IU 1.1.3; Zhang 2000).

Every view's pose, K and the distortion are refined together by the reprojection error (Levenberg-Marquardt); the
covariance is that of the normal equations, with the noise taken from the residuals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_flag, as_integer, as_sequence
from imgu_ros.errors import DegenerateConfiguration, EstimationError, NotConverged, ShapeError, TooFewPoints
from imgu_ros.types import Floats, Points, as_plane_points, as_points
from imgu_ros.vision.camera.bundle import BundleProblem, BundleState
from imgu_ros.vision.camera.distortion_model import COEFFICIENTS, DistortionModel, as_distortion_model
from imgu_ros.vision.camera.intrinsics import Camera, make_camera
from imgu_ros.vision.camera.planar_pose import planar_pose_starts
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.view_choice import without_copies
from imgu_ros.vision.estimation.nonlinear import Minimum, minimise
from imgu_ros.vision.projective.fit import require_spread

#: Three views determine the five numbers of K (Zhang 2000, section 3.1).
FEWEST_VIEWS = 3
#: Focal lengths that are tried, as shares of the picture's longer side: 127 to 13 degrees of view.
_FOCAL_SHARES = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 4.5)
#: Number of views from which the initial focal length is chosen: the choice is coarse, and time grows with it.
_TRIED_VIEWS = 6
#: A view is an outlier when its residual is this many times that of the median view. Measured:
#: benchmarks/thresholds.py, study boards.
_OUTLIER_RATIO = 3.0
#: No view with a smaller residual, px, is an outlier. Measured: benchmarks/thresholds.py, study boards.
_OUTLIER_PX = 0.1
#: Largest standard deviation of the focal length of a calibration that is returned, as a share of it.
_LARGEST_SIGMA = 0.1
#: A rational model over a moderate field of view has coefficients that nearly cancel: a long, narrow valley.
_MAX_STEPS = 1000
#: The share of its standard deviation to which every parameter is found, and of the cost by which it is to fall.
_TOLERANCE = 1e-6
#: Smallest diagonal element of the triangular factor of J with columns of unit length.
_RANK_TOLERANCE = 1e-11
#: Larger numbers are no coordinates of a picture or a board, px or m.
_LARGEST = 1e9


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedView:
    """One view in a calibration.

    Attributes
    ----------
    index : of the view in the input
    pose : camera_from_board
    rms_px : root mean square reprojection error, px (per coordinate)
    residuals : (N, 2) px, projected - measured
    """

    index: int
    pose: RigidTransform
    rms_px: float
    residuals: Points


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """A calibrated camera and what is known about it.

    Attributes
    ----------
    camera : intrinsics
    covariance : (4 + C, 4 + C) of fx, fy, cx, cy and the C distortion coefficients
    rms_px : root mean square residual of the views that were used, px (per coordinate)
    views : those that were used, in the input's order
    outliers : those that were refused because they do not agree with the others, as they were then
    copies : indices of views that show nothing new, for they repeat an earlier one
    iterations : linear systems solved
    """

    camera: Camera
    covariance: Floats
    rms_px: float
    views: tuple[CalibratedView, ...]
    outliers: tuple[CalibratedView, ...]
    copies: tuple[int, ...]
    iterations: int

    @property
    def sigma(self) -> Floats:
        """Standard deviations of fx, fy, cx, cy and the distortion coefficients, (4 + C,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)), np.float64)

    @property
    def rms_corner_px(self) -> float:
        """Root mean square distance of corners, as OpenCV's calibrateCamera reports it: sqrt 2 times `rms_px`."""
        return math.sqrt(2) * self.rms_px


def calibrate(
    board_xy: ArrayLike,
    views: Sequence[ArrayLike],
    width: int,
    height: int,
    model: DistortionModel | str = DistortionModel.PLUMB_BOB,
    *,
    refuse_outliers: bool = True,
) -> Calibration:
    """Calibrate a camera from views of one plane.

    Takes time and memory as views^2 x points; fifty views of a 9x6 board take about a second.

    Parameters
    ----------
    board_xy : (N, 2) m, points of the plane z = 0, N >= 4; (N, 3) with z = 0 as well
    views : each (N, 2) px, where the points were seen; at least three different ones, from different directions.
        Several of a camera and a board that stand still count as one (`view_choice.without_copies`)
    width, height : px, of the pictures
    model : of the lens
    refuse_outliers : leave out views whose residual is more than three times the median view's

    Raises
    ------
    ShapeError
        If an array has another shape or is not finite.
    TooFewPoints
        If there are fewer than three different views, or too few that agree.
    DegenerateConfiguration
        If the views do not determine the focal length to 10 % (all parallel, or all alike), or not every coefficient.
    NotConverged
        If the refinement finds no minimum.

    Examples
    --------
    >>> from imgu_ros.vision.camera import exp_so3
    >>> truth = make_camera([[500, 0, 320], [0, 500, 240], [0, 0, 1]], [-0.2, 0.05], "plumb_bob", 640, 480)
    >>> board = np.column_stack([g.ravel() for g in np.meshgrid(np.arange(9) * 0.03, np.arange(6) * 0.03)])
    >>> turns = [(0.4, 0, 0), (0, 0.5, 0.2), (-0.4, 0.3, 0), (0.1, -0.5, 1.0)]
    >>> flat = np.column_stack((board, np.zeros(54)))
    >>> views = [truth.project(flat @ exp_so3(turn).T + [-0.12, -0.08, 0.5]) for turn in turns]
    >>> found = calibrate(board, views, 640, 480)
    >>> found.camera.K.round(4).tolist()
    [[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]]
    """
    views = as_sequence(views, "views")
    refuse_outliers = as_flag(refuse_outliers, "refuse_outliers")
    width = as_integer(width, "width")
    height = as_integer(height, "height")
    board_xy, pixels = _checked(board_xy, views, width, height)
    model = as_distortion_model(model)
    indices = list(without_copies(board_xy, pixels, width, height))
    if len(indices) < FEWEST_VIEWS:
        are = f"{len(indices)} different one{'s' * (len(indices) > 1)}"
        raise TooFewPoints(
            f"views: {len(pixels)} show {are}; need at least {FEWEST_VIEWS}, tilted in different directions"
        )
    copies = tuple(sorted(set(range(len(pixels))).difference(indices)))
    state = _start(board_xy, [pixels[i] for i in indices], (width, height), model)
    outliers: list[CalibratedView] = []
    iterations = 0
    while True:
        problem = BundleProblem(board_xy, [pixels[i] for i in indices], model)
        minimum = _minimum(problem, state)
        state = problem.unpack(minimum.estimate)
        iterations += minimum.iterations
        seen = _views(minimum, state, indices)
        rms = np.array([view.rms_px for view in seen])
        worst = int(np.argmax(rms))
        if not (refuse_outliers and rms[worst] > max(_OUTLIER_RATIO * float(np.median(rms)), _OUTLIER_PX)):
            break
        # One at a time: the worst view bends the others.
        outliers.append(seen[worst])
        del indices[worst]
        state = BundleState(state.intrinsics, tuple(pose for i, pose in enumerate(state.poses) if i != worst))
        if len(indices) < FEWEST_VIEWS:
            tried = len(outliers) + len(indices)
            raise TooFewPoints(
                f"views: {len(outliers)} of {tried} do not agree with the others; need {FEWEST_VIEWS} that do"
            )
    if not minimum.converged:
        raise NotConverged(
            f"views: no minimum after {minimum.iterations} steps; need more tilted views, or a model with fewer "
            "coefficients"
        )
    covariance = _covariance(minimum, state.intrinsics)
    return Calibration(
        camera=_camera(state.intrinsics, width, height, model),
        covariance=covariance,
        rms_px=math.sqrt(float((minimum.linearisation.residuals**2).mean())),
        views=tuple(seen),
        outliers=tuple(sorted(outliers, key=lambda view: view.index)),
        copies=copies,
        iterations=iterations,
    )


def _checked(board_xy: ArrayLike, views: Sequence[ArrayLike], width: int, height: int) -> tuple[Points, list[Points]]:
    board_xy = as_plane_points(board_xy, "board_xy", 4)
    require_spread(board_xy, "board_xy")
    if len(views) < FEWEST_VIEWS:
        raise TooFewPoints(f"views: {len(views)}; need at least {FEWEST_VIEWS}, from different directions")
    if not (0 < width < math.inf and 0 < height < math.inf):
        raise ShapeError(f"size: {width} x {height}; need positive width and height")
    pixels = [as_points(view, f"views[{index}]") for index, view in enumerate(views)]
    for index, view in enumerate(pixels):
        if len(view) != len(board_xy):
            raise ShapeError(f"views[{index}]: {len(view)} points; need {len(board_xy)}, one for each of board_xy")
        require_spread(view, f"views[{index}]")
        if np.abs(view).max() > _LARGEST:
            raise ShapeError(f"views[{index}]: up to {np.abs(view).max():g}; need px of a picture")
    if not 1 / _LARGEST < np.abs(board_xy).max() < _LARGEST:
        raise ShapeError(f"board_xy: up to {np.abs(board_xy).max():g} m; need the size of a board")
    return board_xy, pixels


def _start(board_xy: Points, pixels: list[Points], size: tuple[int, int], model: DistortionModel) -> BundleState:
    """Return the focal length, among some, that explains a few views best without distortion, and all poses with it.

    Zhang's closed form fails when the views are few, frontal or strongly distorted; this does not.
    """
    tried = pixels[:: max(1, len(pixels) // _TRIED_VIEWS)][:_TRIED_VIEWS]
    best, best_cost = None, math.inf
    for share in _FOCAL_SHARES:
        intrinsics = np.zeros(4 + COEFFICIENTS[model])
        intrinsics[:2] = share * max(size)
        intrinsics[2:4] = (size[0] - 1) / 2, (size[1] - 1) / 2
        camera = _camera(intrinsics, *size, model)
        cost = sum(_best_pose(board_xy, view, camera)[1] for view in tried)
        if cost < best_cost:
            best, best_cost = intrinsics, cost
    if best is None:
        raise DegenerateConfiguration("views: no focal length makes them views of a plane; need views of one board")
    camera = _camera(best, *size, model)
    poses = []
    for index, view in enumerate(pixels):
        pose, _ = _best_pose(board_xy, view, camera)
        if pose is None:
            raise DegenerateConfiguration(
                f"views[{index}]: no pose in front of the camera explains it; need a view of the board"
            )
        poses.append(pose)
    return BundleState(best, tuple(poses))


def _best_pose(board_xy: Points, view: Points, camera: Camera) -> tuple[RigidTransform | None, float]:
    """Return the pose with the smallest RMS error, and that error; None when no pose is in front of the camera."""
    normalized, valid = camera.undistort(view)
    if not valid.all():
        return None, math.inf
    best, best_error = None, math.inf
    try:
        starts = planar_pose_starts(board_xy, normalized)
    except EstimationError:
        return None, math.inf
    for start in starts:
        points = board_xy @ start.R[:, :2].T + start.t
        if points[:, 2].min() > 0:
            error = math.sqrt(float(((camera.project(points) - view) ** 2).mean()))
            if error < best_error:
                best, best_error = start, error
    return best, best_error


def _minimum(problem: BundleProblem, state: BundleState) -> Minimum:
    try:
        return minimise(problem, problem.pack(state), max_iterations=_MAX_STEPS, tolerance=_TOLERANCE)
    except EstimationError as error:
        raise DegenerateConfiguration(f"views: {error}") from None


def _views(minimum: Minimum, state: BundleState, indices: list[int]) -> list[CalibratedView]:
    residuals = minimum.linearisation.residuals.reshape(len(indices), -1, 2)
    return [
        CalibratedView(index, pose, math.sqrt(float((of_view**2).mean())), of_view)
        for index, pose, of_view in zip(indices, state.poses, residuals, strict=True)
    ]


def _covariance(minimum: Minimum, intrinsics: Floats) -> Floats:
    size = len(intrinsics)
    covariance = _leading_covariance(minimum, size)
    shares = np.sqrt(np.diag(covariance)[:2]) / intrinsics[:2]
    if not shares.max() < _LARGEST_SIGMA:
        raise DegenerateConfiguration(
            f"views: they leave the focal length open to {100 * shares.max():.2g} %; need the board tilted by 20 to 50 "
            "degrees, in different directions"
        )
    return covariance


def _leading_covariance(minimum: Minimum, size: int) -> Floats:
    """Return sigma^2 (J^T J)^-1 of the first parameters, from the triangular factor of J.

    Rational coefficients nearly cancel each other: J^T J, whose condition is that of J squared, would be singular.
    """
    residuals, jacobian = minimum.linearisation.residuals, minimum.linearisation.jacobian
    flat = jacobian.reshape(-1, jacobian.shape[2])
    scale = np.linalg.norm(flat, axis=0)
    if not scale.all():
        raise DegenerateConfiguration("views: a parameter has no effect on them; need whole, tilted views of the board")
    # The last parameters first: the triangle of the leading ones is then the last of R, free of all others.
    R = np.linalg.qr(flat[:, ::-1] / scale[::-1], mode="r")[-size:, -size:]
    if not np.abs(np.diag(R)).min() > _RANK_TOLERANCE:
        raise DegenerateConfiguration(
            "views: they do not determine every parameter; need more tilted views, or a model with fewer coefficients"
        )
    inverse = np.linalg.inv(R)[::-1, ::-1] / scale[:size, None]
    freedom = max(flat.shape[0] - flat.shape[1], 1)
    covariance = inverse @ inverse.T * (float((residuals**2).sum()) / freedom)
    return np.asarray((covariance + covariance.T) / 2, np.float64)


def _camera(intrinsics: Floats, width: int, height: int, model: DistortionModel) -> Camera:
    fx, fy, cx, cy = intrinsics[:4]
    return make_camera([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], intrinsics[4:], model, width, height)
