# SPDX-License-Identifier: Apache-2.0
"""What poses refer to. A kind of reference is a subclass of `Reference` in a file of its own."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Container, Iterable, Mapping, Sequence
from typing import ClassVar

import numpy as np

from imgu_ros.frame import Frame
from imgu_ros.pose.calibration_check import CalibrationCheck
from imgu_ros.pose.planar_pose import Located
from imgu_ros.pose.plane import Plane
from imgu_ros.reference.marker_code import MarkerCode
from imgu_ros.reference.self_similarity import Copy, copies_of
from imgu_ros.reference.templates import LightTemplates, TemplateOctave
from imgu_ros.result import ReferenceResult
from imgu_ros.types import Matrix3, Points
from imgu_ros.vision.camera.rigid import RigidTransform


def names_of(references: Iterable[Reference]) -> list[str]:
    """Return the names of what results of references are about, now."""
    return [each.name for reference in references for each in reference.shown]


class Reference(ABC):
    """One thing whose pose is estimated: its name, its templates, and the pose that it gives.

    Parameters
    ----------
    name : in topics, files and coordinate frames; unique among the references of a localizer
    number : its place in `targets.images`, which messages carry
    plane : its outline and metric frame
    templates : its image at every octave, from fine to coarse, with the patches that are aligned with frames, by
        whether their values are linear in the light, as those of raw frames, or sRGB
    light : its colours and its grey in floats, for the refinement on raw samples; None: there is none

    Attributes
    ----------
    kind : key of `imgu_ros.reference_kinds.KINDS`
    size, width_m, outline_template, outline_homogeneous : of the plane

    Notes
    -----
    A track follows the reference by its templates, whatever its kind; `imgu_ros.reference_kinds` says which detector
    finds references of a kind.
    """

    kind: ClassVar[str]
    #: Whether nothing is known of what lies beyond the template's border; else it goes on as there.
    ends_at_border: ClassVar[bool] = False
    #: What tells it from others of its family; empty: its picture alone.
    codes: Sequence[MarkerCode] = ()

    def __init__(
        self,
        name: str,
        number: int,
        plane: Plane,
        templates: Mapping[bool, Sequence[TemplateOctave]],
        light: LightTemplates | None = None,
    ) -> None:
        self.name = name
        self.number = number
        self.plane = plane
        self.templates = templates
        self.light = light
        # Attributes, not properties: the tracker reads them in every frame.
        self.size, self.width_m = plane.size, plane.width_m
        self.outline_template, self.outline_homogeneous = plane.outline, plane.outline_homogeneous
        self._copies: dict[bool, tuple[Copy, ...]] = {}

    @abstractmethod
    def has_template_of(self, other: Reference) -> bool:
        """Return whether a track of the other reference is one of this one: the templates are the same."""

    @abstractmethod
    def pose(
        self,
        found: ReferenceResult,
        located: Located,
        frame: Frame,
        check: CalibrationCheck | None = None,
    ) -> ReferenceResult:
        """Complete a result by homography, outline and, where it can be estimated, pose.

        Parameters
        ----------
        found : what is known so far
        located : where the reference is in the frame
        frame : gives the camera
        check : is asked whether it needs the residuals of the pose; None: they are computed

        Raises
        ------
        EstimationError
            If no view of the reference has this homography.
        """

    @property
    def parts(self) -> tuple[Reference, ...]:
        """What is found and tracked of it: itself, or several planes of a rigid thing."""
        return (self,)

    @property
    def shown(self) -> tuple[Reference, ...]:
        """What its results are about, now: itself, or the members of a family that were seen."""
        return (self,)

    @property
    def names(self) -> tuple[str, ...]:
        """The names that its results may ever have."""
        return (self.name,)

    def sought(self, found: Container[str]) -> tuple[Reference, ...]:
        """Return what is to be looked for where these parts, names, have been found: all, or nothing."""
        return () if any(part.name in found for part in self.parts) else self.parts

    def place_of(self, part: str) -> RigidTransform:
        """Return `reference_from_part`."""
        return RigidTransform(np.eye(3), np.zeros(3))

    def combined(self, found: Mapping[str, ReferenceResult], frame: Frame) -> ReferenceResult:
        """Return the result of the reference by those of its parts, of which those that were not found may be absent.

        Parameters
        ----------
        found : results of a frame, by the names of the parts
        frame : gives the camera
        """
        return found[self.name]

    def results(self, found: Mapping[str, ReferenceResult], frame: Frame) -> tuple[ReferenceResult, ...]:
        """Return its results of a frame; arguments as `combined`."""
        return (self.combined(found, frame),)

    def require_detectable(self, min_inliers: int) -> None:  # noqa: B027 (most kinds can always be detected)
        """Compute what detection compares frames with.

        Raises
        ------
        ShapeError
            If fewer than `min_inliers` features could ever be matched.
        """

    def prepare(self, linear: bool) -> None:
        """Compute what the first frame that shows another octave would have to wait for; see `templates`."""
        for octave in self.templates[linear]:
            _ = octave.corners

    def edge_patches(self, scale: float) -> Points | None:
        """Return centres of patches that hold every edge, template px, best spread first; None: it has no such.

        Parameters
        ----------
        scale : px of the frame in one px of the template
        """
        return None

    def copies(self, linear: bool) -> tuple[Copy, ...]:
        """Return where the reference looks like itself, in template px; see `templates` for `linear`."""
        if linear not in self._copies:
            self._copies[linear] = copies_of(self.templates[linear])
        return self._copies[linear]

    @property
    def symmetries(self) -> tuple[Matrix3, ...]:
        """Motions (3, 3), template px, after which the reference looks exactly the same: no frame tells them apart."""
        linear = next(iter(self.templates), True)
        return tuple(copy.H for copy in self.copies(linear) if copy.is_symmetry)
