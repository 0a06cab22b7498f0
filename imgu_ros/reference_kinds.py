# SPDX-License-Identifier: Apache-2.0
"""The kinds of references: how each is made of an image, and which detector finds it in frames.

A new kind is a subclass of `Reference` in a file of `reference/`, and a row of `KINDS`, whose key is a value of the
parameter `reference`, or the kind that the entries of `targets.images` have which are no pictures (`TargetImage.kind`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from imgu_ros.build_cache import BuildCache
from imgu_ros.config.checks import method_conflict
from imgu_ros.config.components import ComponentParameters, ReferenceParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.detect.detector import Detector, ReferenceDetector
from imgu_ros.detect.markers import MarkerDetector
from imgu_ros.detect.patterns import PatternDetector
from imgu_ros.errors import ParameterError
from imgu_ros.reference.bundle import BundleImage, bundle_reference
from imgu_ros.reference.family import FamilyImage, family_reference
from imgu_ros.reference.marker import BoardImage, MarkerImage, marker_reference
from imgu_ros.reference.pattern import PatternImage, pattern_reference
from imgu_ros.reference.planar import PlanarReference, planar_reference
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TargetImage


@dataclass(frozen=True, slots=True)
class ReferenceKind:
    """A kind of reference.

    Attributes
    ----------
    parameters : class of the parameters that both take
    make : returns the reference of an image, its number, its parameters, and the cache of what is computed
    detector : returns the detector of references of this kind, for the same parameters, with the same cache
    """

    parameters: type[ComponentParameters]
    make: Callable[[Any, int, Any, BuildCache], Reference]
    detector: Callable[[Sequence[Any], Any, BuildCache], Detector]


KINDS: dict[str, ReferenceKind] = {
    PlanarReference.kind: ReferenceKind(ReferenceParameters, planar_reference, ReferenceDetector),
    MarkerImage.kind: ReferenceKind(ReferenceParameters, marker_reference, MarkerDetector),
    BoardImage.kind: ReferenceKind(ReferenceParameters, marker_reference, MarkerDetector),
    FamilyImage.kind: ReferenceKind(ReferenceParameters, family_reference, MarkerDetector),
    PatternImage.kind: ReferenceKind(ReferenceParameters, pattern_reference, PatternDetector),
    BundleImage.kind: ReferenceKind(ReferenceParameters, bundle_reference, MarkerDetector),
}


def make_references(
    images: Iterable[TargetImage], parameters: Parameters, cache: BuildCache | None = None
) -> tuple[Reference, ...]:
    """Return the references of images; what takes time is computed when it is first needed.

    Parameters
    ----------
    images : of the references, with unique names
    parameters : all parameters
    cache : keeps what is computed; what was computed before of the same image and equal values is used again

    Raises
    ------
    ParameterError
        If the chosen methods do not work together.
    ShapeError
        If an image is not (H, W) or (H, W, 3) uint8.
    """
    reason = method_conflict(parameters)
    if reason:
        raise ParameterError(reason)
    cache = BuildCache() if cache is None else cache
    references = []
    for number, image in enumerate(images):
        kind = KINDS[image.kind or parameters.reference]
        references.append(kind.make(image, number, kind.parameters.of(parameters), cache))
    return tuple(references)


def prepare_references(
    images: Iterable[TargetImage], parameters: Parameters, cache: BuildCache | None = None
) -> tuple[Reference, ...]:
    """Return the references of images, as `make_references`, with everything that the first search needs.

    Raises
    ------
    ParameterError, ShapeError
        As `make_references`; also if an image has too few features to be detected.
    """
    references = make_references(images, parameters, cache)
    for reference in references:
        reference.require_detectable(parameters.homography.min_inliers)
    return references


def make_detectors(
    references: Sequence[Reference], parameters: Parameters, cache: BuildCache | None = None
) -> dict[str, Detector]:
    """Return a detector for each kind among the references, by kind."""
    cache = BuildCache() if cache is None else cache
    by_kind: dict[str, list[Reference]] = {}
    for reference in references:
        by_kind.setdefault(reference.kind, []).append(reference)
    return {
        name: KINDS[name].detector(members, KINDS[name].parameters.of(parameters), cache)
        for name, members in by_kind.items()
    }
