# SPDX-License-Identifier: Apache-2.0
"""Fiducial markers: references whose picture follows from a family and an id."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from typing import ClassVar

import numpy as np

from imgu_ros.build_cache import BuildCache
from imgu_ros.config.components import ReferenceParameters
from imgu_ros.config.parameters import PoseParameters
from imgu_ros.frame import Frame
from imgu_ros.image.frame_image import LightKind
from imgu_ros.image.raw_samples import DrawnLevel, Singles
from imgu_ros.pose.calibration_check import CalibrationCheck
from imgu_ros.pose.planar_pose import Located, planar_pose
from imgu_ros.pose.plane import Plane
from imgu_ros.reference.marker_code import MARGIN, MarkerCode
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.self_similarity import Copy
from imgu_ros.reference.templates import LightTemplates, TargetImage, TemplatePyramids, Templates
from imgu_ros.result import ReferenceResult
from imgu_ros.types import Image, Mask, Points
from imgu_ros.vision.markers.dictionaries import marker_cells

#: Side of a cell in the template, px.
CELL_PX = 24
#: The same of the levels in linear light: the finest has four px in one of the frame where a marker fills 200 px.
_LIGHT_CELL_PX = (96, 48, 24, 12, 6, 3)
#: Distance of two patches in the frame, px, and the most patches. Measured: benchmarks/markers.py.
_APART_PX, _MOST_PATCHES = 4.5, 120
#: With fewer at the corners of cells, others at the middles of edges are taken, too: along an edge these tell nothing,
#: and what little they seem to tell is no noise. Measured: benchmarks/markers.py.
_ENOUGH_PATCHES = 13


@dataclass(frozen=True, slots=True, eq=False)
class MarkerImage(TargetImage):
    """The picture of a marker, with a margin of one cell of white.

    Attributes
    ----------
    width_m : of the black square, outer edge to outer edge; 0: unknown
    family, number : which marker
    """

    kind: ClassVar[str] = "marker"

    family: str = ""
    number: int = 0


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
    return MarkerImage(name, _drawn(marker_cells(family, number), CELL_PX), width_m, family=family, number=number)


class MarkerReference(Reference):
    """A fiducial marker.

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
        height, width = image.pixels.shape
        super().__init__(image.name, number, Plane(width, height, image.width_m, MARGIN * CELL_PX), templates, light)
        self.image = image
        self.marker_code = MarkerCode(image.family, image.number, CELL_PX)
        self._pose_parameters = pose_parameters

    def has_template_of(self, other: Reference) -> bool:
        """See `Reference.has_template_of`: the width does not matter."""
        return isinstance(other, MarkerReference) and (
            (self.image.family, self.image.number) == (other.image.family, other.image.number)
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

    def prepare(self, linear: bool) -> None:
        """Nothing: of hundreds of markers few are seen, and what these need takes a millisecond."""

    def copies(self, linear: bool) -> tuple[Copy, ...]:
        """See `Reference.copies`: the code tells how a marker is turned."""
        return ()

    def edge_patches(self, scale: float) -> Points:
        """See `Reference.edge_patches`."""
        chosen = _far_apart(*self._corners, scale)
        return chosen if len(chosen) >= _ENOUGH_PATCHES else _far_apart(*self._edges, scale)

    @cached_property
    def _corners(self) -> tuple[Points, Points]:
        """Corners of the cells, best spread first, (N, 2) template px, and how far each is from those before."""
        assert self.marker_code is not None
        return _spread(_corners_of(self.marker_code.cells))

    @cached_property
    def _edges(self) -> tuple[Points, Points]:
        """The same, then the middles of the edges."""
        assert self.marker_code is not None
        return _spread(np.vstack((_corners_of(self.marker_code.cells), _middles_of(self.marker_code.cells))))


class DrawnLight(LightTemplates):
    """The picture of a marker at every octave, drawn exactly.

    Parameters
    ----------
    image : of the marker
    """

    def __init__(self, image: MarkerImage) -> None:
        super().__init__(image, ())
        self._cells = marker_cells(image.family, image.number)

    def __missing__(self, kind: LightKind) -> tuple[DrawnLevel, ...]:
        channels = 3 if kind is LightKind.COLOR else 1
        self[kind] = levels = tuple(
            DrawnLevel(partial(_light, self._cells, px), np.full(2, CELL_PX / px), channels) for px in _LIGHT_CELL_PX
        )
        return levels

    __hash__ = object.__hash__  # a key of the build cache, by identity


def marker_reference(
    image: MarkerImage, number: int, parameters: ReferenceParameters, cache: BuildCache
) -> MarkerReference:
    """Return the reference of a marker; what takes time is computed when it is first needed.

    Parameters
    ----------
    image, number : of the reference
    parameters : those of references
    cache : keeps what is computed; what was computed before of the same image and equal values is used again
    """
    p = parameters
    pyramids = cache.make(TemplatePyramids, image, (), p.pyramid.kernel)
    templates = cache.make(Templates, pyramids, p.refinement.max_points)
    return cache.make(MarkerReference, number, image, templates, cache.make(DrawnLight, image), p.pose)


def _drawn(cells: Mask, cell_px: int) -> Image:
    white = np.pad(cells, MARGIN, constant_values=True)
    return np.kron(white, np.ones((cell_px, cell_px), np.uint8)) * np.uint8(255)


def _light(cells: Mask, cell_px: int) -> Singles:
    return (_drawn(cells, cell_px) / np.float32(255)).astype(np.float32)


def _corners_of(cells: Mask) -> Points:
    """Return where edges between black and white turn or cross, (N, 2) template px."""
    white = np.pad(cells, MARGIN, constant_values=True)
    across, down = white[:, 1:] ^ white[:, :-1], white[1:] ^ white[:-1]
    # About each corner of four cells: the edges above and below it, left and right of it.
    turns = (across[:-1] | across[1:]) & (down[:, :-1] | down[:, 1:])
    row, column = np.nonzero(turns)
    return np.column_stack((column + 1.0, row + 1.0)) * CELL_PX - 0.5


def _middles_of(cells: Mask) -> Points:
    """Return the middles of the edges between black and white cells, (N, 2) template px."""
    white = np.pad(cells, MARGIN, constant_values=True)
    row, column = np.nonzero(white[:, 1:] ^ white[:, :-1])
    upright = np.column_stack((column + 1.0, row + 0.5))
    row, column = np.nonzero(white[1:] ^ white[:-1])
    return np.vstack((upright, np.column_stack((column + 0.5, row + 1.0)))) * CELL_PX - 0.5


def _far_apart(xy: Points, apart: Points, scale: float) -> Points:
    """Return the first of points (N, 2), best spread first, that are far enough apart in the frame; at least one."""
    count = int(np.count_nonzero(apart * scale >= _APART_PX))
    return xy[: min(max(count, 1), _MOST_PATCHES)]


def _spread(xy: Points) -> tuple[Points, Points]:
    """Return points in the order in which each is farthest from those before it, and that distance."""
    order, apart = [0], [np.inf]
    distance = np.hypot(*(xy - xy[0]).T)
    while len(order) < len(xy):
        farthest = int(np.argmax(distance))
        order.append(farthest)
        apart.append(float(distance[farthest]))
        distance = np.minimum(distance, np.hypot(*(xy - xy[farthest]).T))
    return xy[order], np.array(apart)
