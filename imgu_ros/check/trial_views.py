# SPDX-License-Identifier: Apache-2.0
"""Simulated single views of one reference, of a given size and tilt, with their exact truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from imgu_ros.frame import Frame
from imgu_ros.image.frame_image import grey_of
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TargetImage
from imgu_ros.simulate.disturbances import as_mosaic
from imgu_ros.simulate.geometry import image_from_template, rotation_about
from imgu_ros.simulate.render import Renderer
from imgu_ros.simulate.scene import Scene
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.simulate.truth import points_in_image, target_grid
from imgu_ros.types import Image, Matrix3, Points
from imgu_ros.vision.camera.intrinsics import Camera, make_camera
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
from imgu_ros.vision.formation.sensor import Sensor, expose
from imgu_ros.vision.formation.transfer import linear_from_srgb, srgb_from_linear
from imgu_ros.vision.scale_space.pyramid import PixelScaling

#: As `imgu check` says it: a small frame, in which a print is as small as a robot sees it.
DEFAULT_CAMERA = make_camera(np.array([[600.0, 0, 319.5], [0, 600.0, 239.5], [0, 0, 1]]), [], "plumb_bob", 640, 480)
#: Standard deviation of the blur of lens and focus, px.
DEFOCUS_PX = (0.3, 0.8)
#: Signal of white paper as a share of full scale.
_EXPOSURE = 0.6
#: Sensitivity to red, green and blue that white balance leaves.
_TINT = (0.9, 1.0)
#: Ink reflects a little, paper not all.
_BLACK, _WHITE = 0.015, 0.9
_SENSOR = Sensor(bits=10)
#: Distance of the wall behind a target, in its longer sides.
_BEHIND = 0.4
#: The scene behind it is a texture enlarged by this factor: its own detail is as fine as the pixels.
_COARSER = 3
#: Half a view is nowhere nearer to the border than this, px.
_MARGIN_PX = 3.0
#: Pixels are drawn so many times finer where errors of hundredths of one matter.
_FINER = 2
#: Places that are drawn before a size counts as too large for the frame.
_DRAWS = 40
_BAYER, _RGB = PixelLayout(ColorModel.BAYER, BayerPattern.RGGB), PixelLayout(ColorModel.RGB)


@dataclass(frozen=True, slots=True, eq=False)
class TrialView:
    """One frame with one reference in it.

    Attributes
    ----------
    frame : raw Bayer, 10 bits
    H : (3, 3) H_image_template, ideal px
    pose : camera_from_target
    seen_px : longer side of the outline, were it seen straight on
    """

    frame: Frame
    H: Matrix3
    pose: RigidTransform
    seen_px: float


class TrialViews:
    """Draws views of a reference.

    Parameters
    ----------
    reference : with a known width
    image : its picture
    camera : that sees it
    """

    def __init__(self, reference: Reference, image: TargetImage, camera: Camera) -> None:
        self._reference, self._camera = reference, camera
        self._metres = reference.plane.metres_from_template
        sides = np.ptp(reference.outline_template, axis=0)
        self.longer_px = float(sides.max())
        self.longer_m = self.longer_px * float(self._metres[0, 0])
        # The printed paper, with the white about a marker.
        pixels = srgb_from_linear(image.pixels) if image.is_linear else image.pixels
        paper = TargetImage(image.name, pixels, image.pixels.shape[1] * float(self._metres[0, 0]))
        height, width = image.pixels.shape[:2]
        # The origin of a board may be anywhere.
        middle = self._metres @ np.array(((width - 1) / 2, (height - 1) / 2, 1.0))
        still = RigidTransform(np.eye(3), np.array((middle[0], middle[1], 0.0)))
        self._scene = Scene((paper,), (still,), _BEHIND * self.longer_m)

    def distance_m(self, seen_px: float) -> float:
        """Return the distance at which the longer side is seen with so many px, straight on."""
        return float(self._camera.K[0, 0]) * self.longer_m / seen_px

    def anywhere(self, seen_px: float, tilt_rad: float, rng: np.random.Generator) -> TrialView | None:
        """Return a view with any roll, direction of tilt and place in the frame; None: it is too large for the frame.

        Parameters
        ----------
        seen_px : longer side, were it seen straight on
        tilt_rad : between the normal and the line of sight
        rng : draws the rest
        """
        size = self._camera.width, self._camera.height
        for _ in range(_DRAWS):
            at = rng.uniform(_MARGIN_PX, np.array(size) - _MARGIN_PX)
            axis, roll = rng.uniform(0, 2 * math.pi, 2).tolist()
            pose = self._placed(seen_px, tilt_rad, axis, roll, at)
            H = image_from_template(self._camera.K, pose, self._metres)
            if self._is_inside(H, self._camera):
                return self._drawn(pose, self._camera, seen_px, rng, _clutter(*size))
        return None

    def centred(self, seen_px: float, tilt_rad: float, axis_rad: float, roll_rad: float, seed: int) -> TrialView:
        """Return a view in the middle of the frame, of which no more is drawn than shows the reference."""
        middle = np.array((self._camera.width - 1, self._camera.height - 1)) / 2
        pose = self._placed(seen_px, tilt_rad, axis_rad, roll_rad, middle)
        camera = self._window(seen_px, middle)
        return self._drawn(pose, camera, seen_px, np.random.default_rng([seed, 0xACC]), None, _FINER)

    def _window(self, seen_px: float, middle: Points) -> Camera:
        """Return the camera of the part of the frame about its middle that shows the reference."""
        camera = self._camera
        full = np.array((camera.width, camera.height))
        diagonal = seen_px * math.sqrt(2) * 1.25 + 32
        size = np.minimum(np.ceil(diagonal / 2) * 2, full - full % 2).astype(int)
        first = np.round(middle - (size - 1) / 2)
        first -= first % 2
        K = camera.K.copy()
        K[:2, 2] -= first
        return make_camera(K, camera.distortion, camera.model, int(size[0]), int(size[1]))

    def _placed(self, seen_px: float, tilt_rad: float, axis_rad: float, roll_rad: float, at: Points) -> RigidTransform:
        ray = np.linalg.solve(self._camera.K, np.array((*at, 1.0)))
        ray /= np.linalg.norm(ray)
        toward = np.cross((0, 0, 1.0), ray)
        turn = float(np.linalg.norm(toward))
        to_ray = rotation_about(toward, math.atan2(turn, float(ray[2]))) if turn > 1e-12 else np.eye(3)
        tilted = rotation_about(np.array((math.cos(axis_rad), math.sin(axis_rad), 0.0)), tilt_rad)
        rolled = rotation_about(np.array((0, 0, 1.0)), roll_rad)
        R = to_ray @ tilted @ rolled @ np.diag((1.0, -1.0, -1.0))
        return RigidTransform(R, ray * self.distance_m(seen_px))

    def _is_inside(self, H: Matrix3, camera: Camera) -> bool:
        points = target_grid(self._reference.size, 5)
        return bool(points_in_image(H, points, (camera.width, camera.height), camera).all())

    def _drawn(
        self,
        pose: RigidTransform,
        camera: Camera,
        seen_px: float,
        rng: np.random.Generator,
        behind: Image | None,
        finer: int = 1,
    ) -> TrialView:
        if behind is not None:
            behind = np.rot90(behind, 2 * int(rng.integers(2)))[:, :: int(rng.choice((-1, 1)))]
        # Blur mixes the colours of neighbouring sites: all of them are drawn everywhere.
        light = Renderer(self._scene, _enlarged(camera, finer), _RGB, behind).radiance(pose)
        light = _BLACK + (_WHITE - _BLACK) * cv2.GaussianBlur(light, (0, 0), finer * rng.uniform(*DEFOCUS_PX))
        if finer > 1:
            light = cv2.resize(light, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
        light = light * (_EXPOSURE * rng.uniform(0.8, 1.2) * rng.uniform(*_TINT, 3)).astype(np.float32)
        raw = expose(np.ascontiguousarray(as_mosaic(light, BayerPattern.RGGB), np.float32), _SENSOR, rng)
        frame = Frame(RawImage(raw, _BAYER), 1_000_000_000, "camera", camera)
        return TrialView(frame, image_from_template(camera.K, pose, self._metres), pose, seen_px)


def _enlarged(camera: Camera, factor: int) -> Camera:
    """Return a camera with so many times as many pixels along each side."""
    K = PixelScaling(1 / factor).reduced_from_full @ camera.K
    return make_camera(K, camera.distortion, camera.model, factor * camera.width, factor * camera.height)


@lru_cache(maxsize=2)
def _clutter(width: int, height: int) -> Image:
    """Return a scene with about as much detail as photographs of rooms and streets have, (H, W, 3) light."""
    small = procedural_texture(max(width // _COARSER, 16), max(height // _COARSER, 16), seed=77)
    picture = cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC)
    light = linear_from_srgb(picture).astype(np.float32) / np.float32(255)
    light.flags.writeable = False
    return light


def grey_picture(image: TargetImage) -> Image:
    """Return a target's picture in grey, (H, W) uint8."""
    return image.pixels if image.pixels.ndim == 2 else grey_of(image.pixels, (0.299, 0.587, 0.114))
