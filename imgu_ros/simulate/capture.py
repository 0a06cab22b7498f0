# SPDX-License-Identifier: Apache-2.0
"""How a camera takes a picture: for how long, row by row or at once, through which aperture and colour filters, how
bright, and with which transfer function.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from imgu_ros.errors import ParameterError
from imgu_ros.simulate.scene import Scene, radius_of
from imgu_ros.types import Floats, Matrix3, Points
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.formation.optics import ThinLens
from imgu_ros.vision.formation.shutter import row_times
from imgu_ros.vision.formation.transfer import TransferFunction

#: Distance of the sharp pictures that make a blurred one: below a pixel's width their mean shows no copies.
_MOTION_STEP_PX = 0.5
_DISC_STEP_PX = 1.0
_MOST_VIEWS = 256
_LARGEST_DEFOCUS_PX = 40.0
_LARGEST_EV = 10.0
#: Its inverse is the largest white-balance gain that `raw.gains` takes.
_LEAST_SENSITIVITY = 0.01
_MOST_SATURATED = 0.99


@dataclass(frozen=True, slots=True)
class Capture:
    """Shutter, aperture, colour filters, exposure and transfer function of the simulated camera.

    By default an instant, a pinhole, alike in all colours, no compensation, linear.

    The stamp of a frame, and its truth, are of the middle of the exposure of the middle of the picture. The camera's
    matrix K stays as it is: with a lens, its focal length in pixels times the pitch is the image distance.

    Attributes
    ----------
    exposure_s : time for which each row is exposed; the camera moves on meanwhile
    row_time_s : from one row's exposure to the next row's; 0: global shutter; negative: from the bottom up
    defocus_px : diameter of the disc that every point becomes
    f_number : of a thin lens, whose blur depends on the depth; 0: a pinhole
    focus_m : depth that the lens is focused at; None: the scene's origin, in every frame anew
    pitch_m : distance of pixels on the sensor; with the f-number it sets the aperture
    ev : exposure compensation, in stops, of successive equal parts of the sequence; at 0 a white surface gives 0.9 of
        full scale, whatever exposure time and f-number: the light is chosen so
    saturated : share of the pixel values of every frame at the white level; sets the exposure instead of `ev`
    sensitivities : of the red, green and blue pixels of a mosaic without white balance, 0.01 to 1; what `ev` says holds
        for 1
    transfer : from the signal above black to the values that are quantised
    """

    exposure_s: float = 0.0
    row_time_s: float = 0.0
    defocus_px: float = 0.0
    f_number: float = 0.0
    focus_m: float | None = None
    pitch_m: float = 3.45e-6
    ev: tuple[float, ...] = (0.0,)
    saturated: float | None = None
    sensitivities: tuple[float, float, float] = (1.0, 1.0, 1.0)
    transfer: TransferFunction = TransferFunction.LINEAR

    @property
    def is_ideal(self) -> bool:
        """Whether every pixel sees one instant through one point."""
        return not (self.exposure_s or self.row_time_s or self.defocus_px or self.f_number)

    def brightness(self, index: int, frames: int) -> float:
        """Return what the light of frame `index` is multiplied by: 2^ev."""
        return math.exp2(self.ev[index * len(self.ev) // frames])


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One of the sharp pictures whose mean is a frame.

    Attributes
    ----------
    K : (3, 3), shifted and sheared to the point of the aperture
    camera_from_scene : R (3, 3) and t (3,); of a rolling shutter, one for each row: (height, 3, 3) and (height, 3)
    """

    K: Matrix3
    camera_from_scene: RigidTransform


def check_capture(capture: Capture, height: int, rate_hz: float) -> None:
    """Raise ParameterError when a value is out of range, or a frame would take longer than the frame period."""
    period = 1 / rate_hz
    readout = abs(capture.row_time_s) * (height - 1)
    if not 0 <= capture.exposure_s <= period:
        raise ParameterError(f"exposure: {capture.exposure_s * 1e3:g} ms; need 0 to the frame period, {period * 1e3:g}")
    if not readout <= period:
        got = f"{capture.row_time_s * 1e6:g} us x {height - 1} rows"
        raise ParameterError(f"row time: {got}; need at most the frame period, {period * 1e6:g} us")
    if not 0 <= capture.defocus_px <= _LARGEST_DEFOCUS_PX:
        raise ParameterError(f"defocus: {capture.defocus_px:g} px; need 0 to {_LARGEST_DEFOCUS_PX:g}")
    if capture.f_number and not 0.5 <= capture.f_number <= 1000:
        raise ParameterError(f"f-number: {capture.f_number:g}; need 0.5 to 1000")
    if capture.focus_m is not None and not capture.focus_m > 0:
        raise ParameterError(f"focus: {capture.focus_m:g} m; need more than 0")
    if capture.focus_m is not None and not capture.f_number:
        raise ParameterError(f"focus: {capture.focus_m:g} m without an f-number; need both (a pinhole has no focus)")
    if not 1e-7 <= capture.pitch_m <= 1e-3:
        raise ParameterError(f"pixel pitch: {capture.pitch_m * 1e6:g} um; need 0.1 to 1000")
    if not capture.ev or not all(-_LARGEST_EV <= ev <= _LARGEST_EV for ev in capture.ev):
        raise ParameterError(f"ev: {list(capture.ev)}; need numbers from {-_LARGEST_EV:g} to {_LARGEST_EV:g}")
    if capture.saturated is not None and not 0 < capture.saturated <= _MOST_SATURATED:
        raise ParameterError(f"saturated: {capture.saturated:g}; need more than 0, up to {_MOST_SATURATED:g}")
    if capture.saturated is not None and any(capture.ev):
        raise ParameterError(f"saturated: {capture.saturated:g} with ev {list(capture.ev)}; need one or the other")
    if len(capture.sensitivities) != 3 or not all(_LEAST_SENSITIVITY <= s <= 1 for s in capture.sensitivities):
        got = ", ".join(f"{value:g}" for value in capture.sensitivities)
        raise ParameterError(
            f"sensitivities: {got}; need 3 numbers (red, green, blue) from {_LEAST_SENSITIVITY:g} to 1"
        )


def thin_lens(capture: Capture, camera: Camera, focus_m: float) -> ThinLens:
    """Return the lens that makes K's focal length the image distance when focused at `focus_m`."""
    image_distance = float(camera.K[0, 0]) * capture.pitch_m
    return ThinLens(1 / (1 / image_distance + 1 / focus_m), capture.f_number, focus_m)


def views_of(
    capture: Capture, pose_at: Callable[[float], RigidTransform], smooth_s: float, camera: Camera, scene: Scene
) -> list[View]:
    """Return the views whose mean is the picture.

    Parameters
    ----------
    capture : shutter and aperture
    pose_at : camera_from_scene a number of seconds after the stamp
    smooth_s : a time over which the path is well described by one cubic
    camera, scene : what takes the picture, and of what
    """
    middle = pose_at(0.0)
    focus = capture.focus_m if capture.focus_m is not None else float(middle.t[2])
    aperture = thin_lens(capture, camera, focus).aperture_m if capture.f_number else 0.0
    points = _extreme_points(scene)
    half = capture.exposure_s / 2
    travel = 0.0
    if half:
        seen = [_projected(camera.K, pose_at(t), points) for t in (-half, 0.0, half)]
        travel = float(max(np.hypot(*(a - b).T).max() for a, b in zip(seen[1:], seen[:-1], strict=True))) * 2
    depths = np.maximum((points @ middle.R.T + middle.t)[:, 2], 1e-3 * focus)
    disc = capture.defocus_px + aperture * float(camera.K[0, 0]) * float(np.abs(1 / focus - 1 / depths).max())
    count = max(math.ceil(travel / _MOTION_STEP_PX), math.ceil(math.pi / 4 * (disc / _DISC_STEP_PX) ** 2), 1)
    count = min(max(count, 7) if disc > 0.05 else count, _MOST_VIEWS)
    shares = _even_points(count)
    times = shares * capture.exposure_s
    lens_points = _disc_points(shares) if disc > 0.05 else np.zeros((count, 2))
    rows = row_times(camera.height, capture.row_time_s)
    out = []
    for time, (x, y) in zip(times.tolist(), lens_points.tolist(), strict=True):
        pose = _pose_of_rows(pose_at, rows + time, smooth_s) if capture.row_time_s else pose_at(time)
        ax, ay = x * aperture, y * aperture
        # The point of the aperture moves the camera; the shear keeps what is in focus where it is.
        K = camera.K @ np.array([[1.0, 0.0, ax / focus], [0.0, 1.0, ay / focus], [0.0, 0.0, 1.0]])
        K[:2, 2] += x * capture.defocus_px, y * capture.defocus_px
        out.append(View(K, RigidTransform(pose.R, pose.t - (ax, ay, 0.0))))
    return out


def _pose_of_rows(pose_at: Callable[[float], RigidTransform], times: Floats, smooth_s: float) -> RigidTransform:
    """Return R (rows, 3, 3) and t (rows, 3) at evenly spaced times, by a cubic spline through exact poses."""
    count = min(len(times), 9 + math.ceil(4 * abs(times[-1] - times[0]) / smooth_s))
    nodes = np.linspace(times[0], times[-1], count)
    poses = [pose_at(t) for t in nodes.tolist()]
    # Over so short a time the entries of R run so smoothly that it stays a rotation to 1e-8.
    order = slice(None) if times[-1] > times[0] else slice(None, None, -1)
    R = CubicSpline(nodes[order], np.stack([p.R for p in poses])[order])
    t = CubicSpline(nodes[order], np.stack([p.t for p in poses])[order])
    return RigidTransform(np.asarray(R(times)), np.asarray(t(times)))


def _even_points(count: int) -> Floats:
    """Return points of (-1/2, 1/2), (count,), evenly spaced, with mean and variance of the whole interval."""
    points = (np.arange(count) + 0.5) / count - 0.5
    return np.asarray(points * (count / math.sqrt(count**2 - 1) if count > 1 else 1.0), np.float64)


def _disc_points(shares: Floats) -> Points:
    """Return points that fill a disc of diameter 1 evenly, (count, 2), with mean and covariance of the whole disc.

    Vogel's spiral, in an order in which points that follow one another in time (`shares`) are far apart on the disc;
    what is left of a relation to time, by which motion and defocus would mix, is taken out.
    """
    count = len(shares)
    ranks = np.argsort(np.arange(count) * 0.7548776662466927 % 1)  # the plastic number's: unrelated to the golden angle
    radius = np.sqrt((ranks + 0.5) / count) / 2
    angle = ranks * math.pi * (3 - math.sqrt(5))
    points = np.column_stack((radius * np.cos(angle), radius * np.sin(angle)))
    points -= points.mean(axis=0)
    points -= np.outer(shares, shares @ points / (shares @ shares))
    spread = np.linalg.cholesky(points.T @ points / count)
    return np.asarray(np.linalg.solve(spread, points.T).T / 4, np.float64)


def _extreme_points(scene: Scene) -> Points:
    """Return points, (N, 3) m in the scene, beyond which no target reaches."""
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / math.sqrt(2)
    corners = [
        np.column_stack((square * radius_of(target), np.zeros(4))) @ pose.R.T + pose.t
        for target, pose in zip(scene.targets, scene.poses, strict=True)
    ]
    return np.concatenate(corners)


def _projected(K: Matrix3, pose: RigidTransform, points: Points) -> Points:
    ideal = (points @ pose.R.T + pose.t) @ K.T
    depth = np.maximum(ideal[:, 2:], 1e-3 * abs(pose.t[2]))
    return np.asarray(ideal[:, :2] / depth, np.float64)
