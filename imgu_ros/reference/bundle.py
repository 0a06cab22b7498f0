# SPDX-License-Identifier: Apache-2.0
"""Bundles: markers on several planes of one rigid thing, a cube or a docking station, with one pose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from imgu_ros.build_cache import BuildCache
from imgu_ros.config.components import ReferenceParameters
from imgu_ros.config.parameters import PoseParameters
from imgu_ros.frame import Frame
from imgu_ros.pose.calibration_check import CalibrationCheck
from imgu_ros.pose.planar_pose import Located
from imgu_ros.pose.rigid_pose import SeenPlane, rigid_pose
from imgu_ros.reference.marker import MarkerImage, MarkerReference, marker_image, marker_reference
from imgu_ros.reference.marker_layout import PlacedMarker
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.self_similarity import Copy
from imgu_ros.reference.templates import TargetImage
from imgu_ros.result import ReferenceResult, Status
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.rigid import RigidTransform


@dataclass(frozen=True, slots=True, eq=False)
class BundleMarker:
    """A marker on a rigid thing.

    Attributes
    ----------
    marker : which, and its size, m
    place : `thing_from_marker`, the marker's origin at its centre, x right, y up, z out of the print; its covariance is
        that of (x y z rx ry rz) in the thing's axes, 0 where it is exact
    """

    marker: PlacedMarker
    place: Pose

    def is_like(self, other: BundleMarker) -> bool:
        """Whether both are the same marker at the same place."""
        return self.marker == other.marker and np.array_equal(self.place.transform.matrix, other.place.transform.matrix)


@dataclass(frozen=True, slots=True, eq=False)
class BundleImage(TargetImage):
    """What is known of a bundle; the picture is that of its first marker.

    Attributes
    ----------
    width_m : size of the first marker
    markers : on the thing
    parts : the pictures of all
    """

    kind: ClassVar[str] = "bundle"

    markers: tuple[BundleMarker, ...] = field(kw_only=True)
    parts: tuple[MarkerImage, ...] = field(kw_only=True)


def bundle_image(name: str, markers: tuple[BundleMarker, ...]) -> BundleImage:
    """Return what is known of a bundle.

    Parameters
    ----------
    name : in topics, files and frames
    markers : on the thing, at least one
    """
    parts = tuple(
        marker_image(f"{name}/{each.marker}", each.marker.family, each.marker.number, each.marker.size)
        for each in markers
    )
    return BundleImage(name, parts[0].pixels, parts[0].width_m, is_linear=True, markers=markers, parts=parts)


class BundleReference(Reference):
    """Markers on several planes of one rigid thing.

    Parameters
    ----------
    number, image : see `Reference` and `BundleImage`
    parts : the markers, each a reference of its own
    pose_parameters : when a pose is ambiguous

    Attributes
    ----------
    places : of the markers, `thing_from_marker`, by the names of the parts
    """

    kind = "bundle"

    def __init__(
        self, number: int, image: BundleImage, parts: tuple[MarkerReference, ...], pose_parameters: PoseParameters
    ) -> None:
        first = parts[0]
        super().__init__(image.name, number, first.plane, first.templates, first.light)
        self.image = image
        self._parts = parts
        self.places = {part.name: each.place for part, each in zip(parts, image.markers, strict=True)}
        self._limit = pose_parameters.ambiguity_ratio

    @property
    def parts(self) -> tuple[MarkerReference, ...]:
        """See `Reference.parts`."""
        return self._parts

    def prepare(self, linear: bool) -> None:
        """Nothing: see `MarkerReference.prepare`."""

    def copies(self, linear: bool) -> tuple[Copy, ...]:
        """See `Reference.copies`: the codes tell how a marker is turned."""
        return ()

    def has_template_of(self, other: Reference) -> bool:
        """See `Reference.has_template_of`."""
        if not isinstance(other, BundleReference) or len(self.image.markers) != len(other.image.markers):
            return False
        return all(a.is_like(b) for a, b in zip(self.image.markers, other.image.markers, strict=True))

    def pose(
        self,
        found: ReferenceResult,
        located: Located,
        frame: Frame,
        check: CalibrationCheck | None = None,
    ) -> ReferenceResult:
        """See `Reference.pose`: that of its first marker as a plane; `combined` gives the thing's."""
        return self.parts[0].pose(found, located, frame, check)

    def combined(self, found: Mapping[str, ReferenceResult], frame: Frame) -> ReferenceResult:
        """See `Reference.combined`: the pose that fits all markers that were found.

        Homography, outline and matches are those of the marker that most patches agree on.
        """
        seen = [found[part.name] for part in self.parts if part.name in found]
        located = [result for result in seen if result.homography is not None]
        if not located:
            reasons = [result.reason for result in seen if result.confirmed_share is not None] or [
                result.reason for result in seen
            ]
            return ReferenceResult(self.name, self.number, Status.LOST, reason=reasons[0] if reasons else "")
        best = max(located, key=lambda result: 0 if result.matches is None else len(result.matches.template_xy))
        is_tracked = any(result.status is Status.TRACKED for result in located)
        result = replace(
            best,
            name=self.name,
            number=self.number,
            status=Status.TRACKED if is_tracked else Status.DETECTED,
            sampled=None,
        )
        if frame.camera is None:
            return result
        planes = {part.name: part.plane for part in self.parts}
        faces = [SeenPlane(each, planes[each.name], self.places[each.name]) for each in located]
        return rigid_pose(result, faces, frame.camera, self._limit)

    def place_of(self, part: str) -> RigidTransform:
        """See `Reference.place_of`."""
        return self.places[part].transform


def bundle_reference(
    image: BundleImage, number: int, parameters: ReferenceParameters, cache: BuildCache
) -> BundleReference:
    """Return the reference of a bundle; what takes time is computed when it is first needed.

    Parameters
    ----------
    image, number : of the reference
    parameters : those of references
    cache : keeps what is computed; what was computed before of the same image and equal values is used again
    """
    parts = tuple(marker_reference(part, number, parameters, cache) for part in image.parts)
    return cache.make(BundleReference, number, image, parts, parameters.pose)
