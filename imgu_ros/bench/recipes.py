# SPDX-License-Identifier: Apache-2.0
"""What people write today with OpenCV alone, as a competent user writes it.

Demosaicking straight to grey, 1000 features, brute-force matching with the ratio test, MAGSAC++ with 3 px, and the
planar pose of the inliers. The target's features, K and D are prepared once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from imgu_ros.bench.methods import Answer, Answered, BenchmarkMethod, ChainMethod
from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import ParameterError
from imgu_ros.frame import Frame
from imgu_ros.reference.templates import TargetImage
from imgu_ros.types import Choice, Floats, Image, Matrix3
from imgu_ros.vision.camera.distortion_model import DistortionModel
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, RawImage
from imgu_ros.vision.scale_space.pyramid import PixelScaling

FEATURES = 1000
RATIO = 0.75
THRESHOLD_PX = 3.0
#: Fewer inliers than this are no find: four always agree.
FEWEST_INLIERS = 10

#: ORB's pyramid reaches over a factor of 3.6: a target's picture is reduced to about the size at which it is seen (its
#: longer side, px). SIFT is better off with the whole resolution.
LONGEST_SIDE_PX = {"ORB": 640}

#: OpenCV names a pattern by the second row's second and third site.
_TO_GREY = {
    BayerPattern.RGGB: cv2.COLOR_BayerBG2GRAY,
    BayerPattern.BGGR: cv2.COLOR_BayerRG2GRAY,
    BayerPattern.GRBG: cv2.COLOR_BayerGB2GRAY,
    BayerPattern.GBRG: cv2.COLOR_BayerGR2GRAY,
}


class RecipeFeatures(Choice):
    """The features of a recipe."""

    ORB = "orb"
    SIFT = "sift"


_DETECTORS: dict[RecipeFeatures, Callable[[], Any]] = {
    RecipeFeatures.ORB: lambda: cv2.ORB_create(FEATURES),  # type: ignore[attr-defined, unused-ignore]
    RecipeFeatures.SIFT: lambda: cv2.SIFT_create(FEATURES),  # type: ignore[attr-defined, unused-ignore]
}
_NORMS = {RecipeFeatures.ORB: cv2.NORM_HAMMING, RecipeFeatures.SIFT: cv2.NORM_L2}


@dataclass(frozen=True, slots=True, eq=False)
class _Known:
    """A target: features of its picture, (N, 2) px and metres, and the descriptors."""

    name: str
    xy: Floats
    metres: Floats
    descriptors: Image
    centre: Floats


class Recipe:
    """One recipe for some targets.

    Parameters
    ----------
    features : orb or sift
    targets : the known ones

    Raises
    ------
    ParameterError
        If a target has no features.
    """

    def __init__(self, features: RecipeFeatures | str, targets: Sequence[TargetImage]) -> None:
        features = RecipeFeatures(features)
        self.name = features.value.upper()
        self._detector = _DETECTORS[features]()
        self._matcher = cv2.BFMatcher(_NORMS[features])
        self._known = [self._prepared(target) for target in targets]

    def reset(self) -> None:
        """Do nothing: a recipe remembers no frame."""

    def answer(self, frame: Frame) -> Answered:
        """Work on one frame."""
        grey = _grey(frame.image)
        keypoints, descriptors = self._detector.detectAndCompute(grey, None)
        if descriptors is None or len(keypoints) < 2:
            return Answered(tuple(Answer(known.name, status="lost", reason="no features") for known in self._known))
        xy = np.array(cv2.KeyPoint.convert(keypoints), np.float64).reshape(-1, 2)
        return Answered(tuple(self._found(known, xy, descriptors, frame.camera) for known in self._known))

    def _found(self, known: _Known, image_xy: Floats, descriptors: Image, camera: Camera | None) -> Answer:
        pairs = self._matcher.knnMatch(known.descriptors, descriptors, k=2)
        good = [p[0] for p in pairs if len(p) == 2 and p[0].distance < RATIO * p[1].distance]
        if len(good) < FEWEST_INLIERS:
            return Answer(known.name, status="lost", reason=f"matches: {len(good)}")
        src = np.array([m.queryIdx for m in good])
        template, image = known.xy[src], image_xy[[m.trainIdx for m in good]]
        if camera is not None and camera.is_distorted:
            image = _undistorted(image, camera)
        H, mask = cv2.findHomography(template, image, cv2.USAC_MAGSAC, THRESHOLD_PX)
        inliers = np.zeros(len(good), bool) if mask is None else mask.ravel().astype(bool)
        if H is None or np.count_nonzero(inliers) < FEWEST_INLIERS:
            return Answer(known.name, status="lost", reason=f"inliers: {np.count_nonzero(inliers)}")
        H = H / np.linalg.norm(H)
        H = H if H[2] @ known.centre > 0 else -H
        if camera is None:
            return Answer(known.name, H, status="found")
        pose = _pose(known.metres[src[inliers]], image[inliers], camera.K)
        return Answer(known.name, H, pose, None, "found", "" if pose is not None else "no pose")

    def _prepared(self, target: TargetImage) -> _Known:
        pixels = target.pixels
        grey = pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
        height, width = grey.shape
        scale = min(1.0, LONGEST_SIDE_PX.get(self.name, max(width, height)) / max(width, height))
        if scale < 1:
            grey = cv2.resize(grey, (round(width * scale), round(height * scale)), interpolation=cv2.INTER_AREA)
        keypoints, descriptors = self._detector.detectAndCompute(grey, None)
        if descriptors is None:
            raise ParameterError(f"target {target.name}: no features; need a picture with texture")
        xy = np.array(cv2.KeyPoint.convert(keypoints), np.float64).reshape(-1, 2)
        # Pixel centres are at integers: outer edges are mapped to outer edges.
        xy = PixelScaling((width / grey.shape[1], height / grey.shape[0])).to_full(xy)
        middle = np.array([(width - 1) / 2, (height - 1) / 2])
        metres = (xy - middle) * (target.width_m / width) * (1, -1)
        return _Known(
            target.name, xy, np.column_stack((metres, np.zeros(len(xy)))), descriptors, np.array([*middle, 1.0])
        )


def _grey(image: RawImage) -> Image:
    layout = image.layout
    if layout.color is ColorModel.BAYER and layout.pattern is not None:
        return cv2.demosaicing(image.pixels, _TO_GREY[layout.pattern])
    return image.pixels if image.pixels.ndim == 2 else cv2.cvtColor(image.pixels, cv2.COLOR_RGB2GRAY)


def _undistorted(xy: Floats, camera: Camera) -> Floats:
    """Return ideal pixels; as `solvePnP` with D, but for the homography too."""
    undistort: Any = cv2.fisheye.undistortPoints if camera.model is DistortionModel.EQUIDISTANT else cv2.undistortPoints
    ideal = undistort(xy.reshape(-1, 1, 2), camera.K, camera.distortion, P=camera.K)
    return np.asarray(ideal, np.float64).reshape(-1, 2)


def _pose(metres: Floats, image: Floats, K: Matrix3) -> RigidTransform | None:
    found, rotation, translation = cv2.solvePnP(metres, image, K, None, flags=cv2.SOLVEPNP_IPPE)
    if not found or not (np.isfinite(rotation).all() and np.isfinite(translation).all()):
        return None
    return RigidTransform(
        np.asarray(cv2.Rodrigues(rotation)[0], np.float64), np.asarray(translation, np.float64).ravel()
    )


TRACKING, DETECTION, ORB, SIFT = "tracking", "detection", "ORB", "SIFT"
#: What tables and plots call them.
TITLES = {TRACKING: "ours, tracking", DETECTION: "ours, detecting", ORB: "ORB recipe", SIFT: "SIFT recipe"}

#: Every method: its name, and how it is made of parameters (the pipeline's) and targets.
METHODS: dict[str, Callable[[Parameters, Sequence[TargetImage]], BenchmarkMethod]] = {
    TRACKING: lambda p, t: ChainMethod(TRACKING, parameters_from({"tracking.enabled": True}, p), t),
    DETECTION: lambda p, t: ChainMethod(DETECTION, parameters_from({"tracking.enabled": False}, p), t),
    ORB: lambda p, t: Recipe(RecipeFeatures.ORB, t),
    SIFT: lambda p, t: Recipe(RecipeFeatures.SIFT, t),
}


def make_method(name: str, targets: Sequence[TargetImage], parameters: Parameters | None = None) -> BenchmarkMethod:
    """Return a method, ready for frames.

    Parameters
    ----------
    name : tracking, detection, ORB or SIFT
    targets : the known ones
    parameters : the pipeline's; None: the defaults

    Raises
    ------
    ParameterError
        If there is no such method.
    """
    check_method(name)
    return METHODS[name](parameters or Parameters(), targets)


def check_method(name: str) -> None:
    """Raise ParameterError when there is no method of that name."""
    if name not in METHODS:
        raise ParameterError(f"method: {name!r}; need one of {', '.join(METHODS)}")
