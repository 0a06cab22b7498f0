# SPDX-License-Identifier: Apache-2.0
"""Planar images: references that are known flat prints, detected by keypoints."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from typing import Any

import numpy as np

from imgu_ros.build_cache import BuildCache
from imgu_ros.config.components import ReferenceParameters
from imgu_ros.config.parameters import PoseParameters
from imgu_ros.errors import ShapeError
from imgu_ros.frame import Frame
from imgu_ros.pose.calibration_check import CalibrationCheck
from imgu_ros.pose.planar_pose import Located, planar_pose
from imgu_ros.pose.plane import Plane
from imgu_ros.reference.features import (
    DescriptionOptions,
    FeaturesOnDemand,
    TargetFeatures,
    chosen_features,
    close_features,
    description_options,
    target_features,
    thorough_features,
    thorough_parameters,
)
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.self_similarity import copies_of
from imgu_ros.reference.templates import (
    LightTemplates,
    TargetImage,
    TemplateOctave,
    TemplatePyramids,
    Templates,
    grey_template,
)
from imgu_ros.result import ReferenceResult
from imgu_ros.types import Image
from imgu_ros.vision.descriptors.extractor import make_extractor


class PlanarReference(Reference):
    """A known flat image.

    Parameters
    ----------
    name, number, image : see `Reference` and `TargetImage`
    templates, light : for alignment
    front : keypoints and descriptors at every scale
    close, thorough : those for the search of a reference that is near, and for a thorough search
    pose_parameters : for the pose
    """

    kind = "target"

    def __init__(
        self,
        number: int,
        image: TargetImage,
        templates: Templates,
        light: LightTemplates,
        front: FeaturesOnDemand,
        close: FeaturesOnDemand,
        thorough: FeaturesOnDemand,
        pose_parameters: PoseParameters,
    ) -> None:
        height, width = image.pixels.shape[:2]
        super().__init__(image.name, number, Plane(width, height, image.width_m), templates, light)
        self.image = image
        self.front = front
        self.close = close
        self.thorough = thorough
        self._pose_parameters = pose_parameters

    @property
    def features(self) -> TargetFeatures:
        """Keypoints and descriptors at every scale, of a first look."""
        return self.front.features()

    def has_template_of(self, other: Reference) -> bool:
        """See `Reference.has_template_of`: the width does not matter."""
        return isinstance(other, PlanarReference) and self.image.shows_the_same(other.image)

    def require_detectable(self, min_inliers: int) -> None:
        """See `Reference.require_detectable`."""
        count = len(self.features.described.keypoints)
        if count < min_inliers:
            raise ShapeError(
                f"target {self.name}: {count} keypoints; need at least {min_inliers}: an image with texture, and not "
                "too small"
            )

    def pose(
        self,
        found: ReferenceResult,
        located: Located,
        frame: Frame,
        check: CalibrationCheck | None = None,
    ) -> ReferenceResult:
        """See `Reference.pose`."""
        return planar_pose(found, self.plane, located, frame, self._pose_parameters, check)


def planar_reference(
    image: TargetImage, number: int, parameters: ReferenceParameters, cache: BuildCache
) -> PlanarReference:
    """Return the reference of an image; what takes time is computed when it is first needed.

    Parameters
    ----------
    image, number : of the reference
    parameters : those of references
    cache : keeps what is computed; what was computed before of the same image and equal values is used again

    Raises
    ------
    ShapeError
        If the image is not (H, W) or (H, W, 3) uint8.
    """
    pixels, p = image.pixels, parameters
    if pixels.dtype != np.uint8 or pixels.ndim not in (2, 3) or (pixels.ndim == 3 and pixels.shape[2] != 3):
        raise ShapeError(f"target {image.name}: shape {pixels.shape} {pixels.dtype}; need (H, W) or (H, W, 3) uint8")
    weights = p.raw.grey_weights if pixels.ndim == 3 else ()
    grey = cache.make(grey_template, pixels, weights)
    first, thorough = description_options(p), description_options(thorough_parameters(p))
    extractor = cache.make(make_extractor, first.extractor)
    pyramids = cache.make(TemplatePyramids, image, weights, p.pyramid.kernel)
    templates = cache.make(Templates, pyramids, p.refinement.max_points)
    symmetry = cache.make(_Symmetry, pyramids)
    return cache.make(
        PlanarReference,
        number,
        image,
        templates,
        cache.make(LightTemplates, image, weights),
        cache.make(_on_demand, symmetry, target_features, grey, first, extractor),
        cache.make(_on_demand, symmetry, close_features, grey, first, extractor),
        cache.make(_on_demand, symmetry, thorough_features, grey, thorough, extractor),
        p.pose,
    )


class _Symmetry:
    """How often a target looks the same while it is turned once; computed when it is first asked for."""

    def __init__(self, pyramids: TemplatePyramids) -> None:
        self._pyramids = pyramids

    @cached_property
    def order(self) -> int:
        levels = next(iter(self._pyramids.values()), None) or self._pyramids[True]
        octaves = [TemplateOctave(level, 0) for level in levels]
        return 1 + sum(copy.is_symmetry for copy in copies_of(octaves))


def _on_demand(symmetry: _Symmetry, make: Callable[..., TargetFeatures], *arguments: Any) -> FeaturesOnDemand:
    return FeaturesOnDemand(partial(_distinct, symmetry, make, *arguments))


def _distinct(
    symmetry: _Symmetry, make: Callable[..., TargetFeatures], grey: Image, options: DescriptionOptions, *rest: Any
) -> TargetFeatures:
    """Return the features of a target: of one sector where it looks the same when it is turned, lest twins compete."""
    features = make(grey, options, *rest)
    if symmetry.order == 1:
        return features
    k = features.described.keypoints
    x, y = (k.xy - (np.array(grey.shape[::-1]) - 1) / 2).T
    sector = 2 * np.pi / symmetry.order
    return chosen_features(features, np.flatnonzero(np.arctan2(y, x) % (2 * np.pi) < sector), options)
