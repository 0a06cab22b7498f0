# SPDX-License-Identifier: Apache-2.0
"""Fiducial markers, one or a board of them on a plane: references whose picture follows from families and ids."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import ClassVar, TypeVar

import numpy as np

from imgu_ros.build_cache import BuildCache
from imgu_ros.config.components import ReferenceParameters
from imgu_ros.config.parameters import PoseParameters
from imgu_ros.frame import Frame
from imgu_ros.image.frame_image import LightKind
from imgu_ros.image.raw_samples import DrawnLevel
from imgu_ros.pose.calibration_check import CalibrationCheck
from imgu_ros.pose.planar_pose import Located, planar_pose
from imgu_ros.pose.plane import Plane
from imgu_ros.reference.dot_layout import DotLayout, DotTemplate
from imgu_ros.reference.marker_layout import LayoutTemplate, MarkerLayout, PlacedMarker, PlaneTemplate, spread_out
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.self_similarity import Copy
from imgu_ros.reference.templates import LightTemplates, TargetImage, TemplatePyramids, Templates
from imgu_ros.result import ReferenceResult
from imgu_ros.types import Floats, Points

#: Distance of two patches in the frame, px. Measured: benchmarks/markers.py.
_APART_PX = 4.5
#: Most patches of which some are in view; of a board that fills the frame many times still tens.
_MOST_PATCHES = 600
#: With fewer at the corners of cells, others at the middles of edges are taken, too: along an edge these tell nothing,
#: and what little they seem to tell is no noise. Measured: benchmarks/markers.py.
_ENOUGH_PATCHES = 13


@dataclass(frozen=True, slots=True, eq=False)
class MarkerImage(TargetImage):
    """The picture of a marker with a margin of one cell of white, or of a board of markers.

    Attributes
    ----------
    width_m : outer edge to outer edge of what is black; 0: unknown
    layout : which markers, or dots, and where
    template : what is drawn of it
    """

    kind: ClassVar[str] = "marker"

    layout: MarkerLayout | DotLayout = field(kw_only=True)
    template: PlaneTemplate = field(kw_only=True)

    @property
    def sheet_width_m(self) -> float:
        """See `TargetImage.sheet_width_m`."""
        left, _, right, _ = self.template.outline
        return self.width_m * self.template.size[0] / (right - left)

    @property
    def entry(self) -> str:
        """See `TargetImage.entry`: family and id."""
        return str(self.layout.markers[0])


class BoardImage(MarkerImage):
    """The picture of a board of markers."""

    __slots__ = ()
    kind: ClassVar[str] = "board"

    @property
    def entry(self) -> str:
        """See `TargetImage.entry`: a board has a file."""
        return ""


_Kind = TypeVar("_Kind", bound=MarkerImage)


def marker_image(name: str, family: str, number: int, width_m: float) -> MarkerImage:
    """Return the picture of a marker.

    Parameters
    ----------
    name : in topics, files and frames
    family, number : a family of `imgu_ros.vision.markers` and an id
    width_m : of the black square, outer edge to outer edge; 0: unknown

    Raises
    ------
    ShapeError
        If there is no such marker, or OpenCV has no aruco module.
    """
    return drawn_image(MarkerImage, name, MarkerLayout((PlacedMarker(family, number, 1.0),)), width_m)


def board_image(name: str, layout: MarkerLayout, width_m: float = 0.0) -> BoardImage:
    """Return the picture of a board.

    Parameters
    ----------
    name : in topics, files and frames
    layout : of the markers, m
    width_m : outer edge to outer edge of what is black, to which the board is scaled; 0: as the layout has it

    Raises
    ------
    ShapeError
        If there is no such marker, or OpenCV has no aruco module.
    """
    return drawn_image(BoardImage, name, layout, width_m or layout.width)


def drawn_image(kind: type[_Kind], name: str, layout: MarkerLayout | DotLayout, width_m: float) -> _Kind:
    """Return the picture of a layout.

    Parameters
    ----------
    kind : class of the picture
    name, layout, width_m : see `MarkerImage`
    """
    template = DotTemplate(layout) if isinstance(layout, DotLayout) else LayoutTemplate(layout)
    pixels = np.rint(255 * template.drawn(1.0)).astype(np.uint8)
    return kind(name, pixels, width_m, is_linear=True, layout=layout, template=template)


class MarkerReference(Reference):
    """A fiducial marker, or a board of them.

    Parameters
    ----------
    number, image : see `Reference` and `MarkerImage`
    templates, light : for alignment
    pose_parameters : for the pose
    """

    kind = "marker"
    ends_at_border = True

    def __init__(
        self,
        number: int,
        image: MarkerImage,
        templates: Templates,
        light: LightTemplates,
        pose_parameters: PoseParameters,
    ) -> None:
        drawn = image.template
        plane = Plane(*drawn.size, image.width_m, drawn.outline, drawn.origin)
        super().__init__(image.name, number, plane, templates, light)
        self.image = image
        self.codes = drawn.codes
        self._pose_parameters = pose_parameters

    def has_template_of(self, other: Reference) -> bool:
        """See `Reference.has_template_of`: the width does not matter."""
        return isinstance(other, MarkerReference) and self.image.layout == other.image.layout

    def pose(
        self,
        found: ReferenceResult,
        located: Located,
        frame: Frame,
        check: CalibrationCheck | None = None,
    ) -> ReferenceResult:
        """See `Reference.pose`."""
        return planar_pose(found, self.plane, located, frame, self._pose_parameters, check)

    def prepare(self, linear: bool) -> None:
        """Nothing: of hundreds of markers few are seen, and what these need takes a millisecond."""

    def copies(self, linear: bool) -> tuple[Copy, ...]:
        """See `Reference.copies`: the codes tell how a marker is turned."""
        return ()

    def edge_patches(self, scale: float) -> Points:
        """See `Reference.edge_patches`."""
        chosen = _far_apart(*self._corners, scale)
        return chosen if len(chosen) >= _ENOUGH_PATCHES else _far_apart(*self._edges, scale)

    @cached_property
    def _corners(self) -> tuple[Points, Floats]:
        """Corners of the cells, best spread first, (N, 2) template px, and how far each is from those before."""
        return spread_out(self.image.template.corners, _MOST_PATCHES)

    @cached_property
    def _edges(self) -> tuple[Points, Floats]:
        """The same, then the middles of the edges."""
        template = self.image.template
        return spread_out(np.vstack((template.corners, template.middles)), _MOST_PATCHES)


_Reference = TypeVar("_Reference", bound=MarkerReference)


class DrawnLight(LightTemplates):
    """The picture of a marker at every octave, drawn exactly.

    Parameters
    ----------
    image : of the marker
    """

    def __init__(self, image: MarkerImage) -> None:
        super().__init__(image, ())
        self._template = image.template

    def __missing__(self, kind: LightKind) -> tuple[DrawnLevel, ...]:
        channels = 3 if kind is LightKind.COLOR else 1
        self[kind] = levels = tuple(
            DrawnLevel(partial(self._template.drawn, scale), np.full(2, 1 / scale), channels)
            for scale in self._template.light_scales
        )
        return levels

    __hash__ = object.__hash__  # a key of the build cache, by identity


def marker_reference(
    image: MarkerImage, number: int, parameters: ReferenceParameters, cache: BuildCache
) -> MarkerReference:
    """Return the reference of a marker or a board; what takes time is computed when it is first needed.

    Parameters
    ----------
    image, number : of the reference
    parameters : those of references
    cache : keeps what is computed; what was computed before of the same image and equal values is used again
    """
    return made_reference(MarkerReference, image, number, parameters, cache)


def made_reference(
    kind: type[_Reference], image: MarkerImage, number: int, parameters: ReferenceParameters, cache: BuildCache
) -> _Reference:
    """Return the reference of an image of a layout, of a class; see `marker_reference`."""
    p = parameters
    pyramids = cache.make(TemplatePyramids, image, (), p.pyramid.kernel)
    templates = cache.make(Templates, pyramids, p.refinement.max_points)
    return cache.make(kind, number, image, templates, cache.make(DrawnLight, image), p.pose)


def _far_apart(xy: Points, apart: Floats, scale: float) -> Points:
    """Return the first of points (N, 2), best spread first, that are far enough apart in the frame; at least one."""
    count = int(np.count_nonzero(apart * scale >= _APART_PX))
    return xy[: max(count, 1)]
