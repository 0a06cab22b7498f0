# SPDX-License-Identifier: Apache-2.0
"""The worked example "a kind of reference" of CONTRIBUTING.md: a square marker with a code, found without keypoints."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import cv2
import numpy as np
import pytest

from imgu_ros.build_cache import BuildCache
from imgu_ros.config.components import ComponentParameters
from imgu_ros.config.parameters import (
    HomographyParameters,
    Parameters,
    PoseParameters,
    PyramidParameters,
    RefinementParameters,
)
from imgu_ros.config.values import parameters_from
from imgu_ros.detect.frame_context import FrameContext
from imgu_ros.errors import EstimationError
from imgu_ros.frame import Frame
from imgu_ros.localizer import Localizer
from imgu_ros.pose.calibration_check import CalibrationCheck
from imgu_ros.pose.planar_pose import Located, distorting_camera, planar_pose
from imgu_ros.pose.plane import Plane
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TargetImage, TemplatePyramids, Templates
from imgu_ros.reference_kinds import KINDS, ReferenceKind, make_references, prepare_references
from imgu_ros.result import ReferenceResult, Status
from imgu_ros.simulate.sequence import Simulation, default_targets, simulate_sequence
from imgu_ros.simulate.truth import corner_error
from imgu_ros.track.patch_alignment import align_patches
from imgu_ros.types import Image, Matrix3, Points

CELLS, BORDER, CELL_PX = 8, 1, 30


@dataclass(frozen=True, slots=True)
class SquareMarkerParameters(ComponentParameters):
    """The groups that the kind takes: a change of another parameter makes nothing anew."""

    pyramid: PyramidParameters
    homography: HomographyParameters
    refinement: RefinementParameters
    pose: PoseParameters


class SquareMarker(Reference):
    """A black square on white with 4 x 4 cells of black and white in it."""

    kind = "square_marker"

    def __init__(self, image: TargetImage, number: int, parameters: SquareMarkerParameters, cache: BuildCache) -> None:
        height, width = image.pixels.shape
        pyramids = cache.make(TemplatePyramids, image, (), parameters.pyramid.kernel)
        templates = cache.make(Templates, pyramids, parameters.refinement.max_points)
        super().__init__(image.name, number, Plane(width, height, image.width_m), templates)
        self._pose_parameters = parameters.pose
        self.image = image
        self.code = cells_of(image.pixels)[2:-2, 2:-2]
        near, far = BORDER * CELL_PX - 0.5, (CELLS - BORDER) * CELL_PX - 0.5
        self.square = np.array([[near, near], [far, near], [far, far], [near, far]])

    def has_template_of(self, other: Reference) -> bool:
        return isinstance(other, SquareMarker) and self.image.shows_the_same(other.image)

    def pose(
        self,
        found: ReferenceResult,
        located: Located,
        frame: Frame,
        check: CalibrationCheck | None = None,
    ) -> ReferenceResult:
        return planar_pose(found, self.plane, located, frame, self._pose_parameters, check)


class SquareMarkerDetector:
    """Finds squares by their contours, names them by their code, and aligns their patches."""

    def __init__(self, markers: Sequence[SquareMarker], parameters: SquareMarkerParameters, cache: BuildCache) -> None:
        self._parameters = parameters

    def prepare(self) -> None:
        """Nothing needs time."""

    def detect(
        self, context: FrameContext, missing: Sequence[SquareMarker], covered: Sequence[Points], thorough: bool
    ) -> Iterator[ReferenceResult]:
        squares = squares_in(context.image.grey)
        for marker in missing:
            result = ReferenceResult(marker.name, marker.number, Status.LOST, reason="no square has its code")
            for square in squares:
                try:
                    yield self._detected(marker, square, context)
                    break
                except EstimationError as error:
                    result = ReferenceResult(marker.name, marker.number, Status.LOST, reason=str(error))
            else:
                yield result

    def _detected(self, marker: SquareMarker, square: Points, context: FrameContext) -> ReferenceResult:
        turn = turn_of(marker.code, context.image.grey, square)
        if turn is None:
            raise EstimationError("no square has its code")
        lens, p = distorting_camera(context.frame.camera), self._parameters
        corners = (
            np.roll(square, -turn, axis=0) if lens is None else lens.ideal_pixels(np.roll(square, -turn, axis=0))[0]
        )
        H = cv2.getPerspectiveTransform(marker.square.astype(np.float32), corners.astype(np.float32))
        alignment = align_patches(context.image, marker, H, lens, p.refinement, p.homography.min_inliers, reach_px=4.0)
        found = ReferenceResult(marker.name, marker.number, Status.DETECTED)
        return marker.pose(found, alignment, context.frame)


def squares_in(grey: Image) -> list[Points]:
    """Return the dark quadrilaterals of an image, each (4, 2) px, clockwise."""
    _, dark = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY_INV | cv2.THRESH_OTSU)
    contours, _ = cv2.findContours(dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    polygons = [cv2.approxPolyDP(contour, 0.03 * cv2.arcLength(contour, True), True)[:, 0] for contour in contours]
    squares = [p for p in polygons if len(p) == 4 and cv2.isContourConvex(p) and cv2.contourArea(p) > 400]
    return [(p if cv2.contourArea(p, oriented=True) > 0 else p[::-1]).astype(np.float64) for p in squares]


def turn_of(code: Image, grey: Image, square: Points) -> int | None:
    """Return by how many corners a square in an image is turned against a code; None when its cells differ."""
    side = (CELLS - 2 * BORDER) * CELL_PX
    straight = np.array([[0, 0], [side, 0], [side, side], [0, side]], np.float32)
    H: Matrix3 = cv2.getPerspectiveTransform(square.astype(np.float32), straight)
    cells = cells_of(cv2.warpPerspective(grey, H, (side, side)))[1:-1, 1:-1]
    return next((turn for turn in range(4) if np.array_equal(np.rot90(cells, turn), code)), None)


def cells_of(image: Image) -> Image:
    """Return for each cell of an image whether it is white."""
    rows, columns = (length // CELL_PX for length in image.shape)
    means = image.reshape(rows, CELL_PX, columns, CELL_PX).mean(axis=(1, 3))
    return np.asarray(means > (means.min() + means.max()) / 2)


def marker_image(code: int, width_m: float = 0.3) -> TargetImage:
    cells = np.ones((CELLS, CELLS), bool)
    cells[BORDER:-BORDER, BORDER:-BORDER] = False
    cells[2:-2, 2:-2] = np.array([code >> bit & 1 for bit in range(16)], bool).reshape(4, 4)
    pixels = np.kron(cells, np.ones((CELL_PX, CELL_PX), bool)).astype(np.uint8) * 255
    return TargetImage(f"marker_{code:04x}", pixels, width_m)


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(
        KINDS, SquareMarker.kind, ReferenceKind(SquareMarkerParameters, SquareMarker, SquareMarkerDetector)
    )


def test_a_marker_is_detected_and_tracked() -> None:
    parameters, cache = Parameters(), BuildCache()
    images = [marker_image(0x2D47), marker_image(0x93A5)]
    own = SquareMarkerParameters.of(parameters)
    markers = [SquareMarker(image, number, own, cache) for number, image in enumerate(images)]
    localizer = Localizer(parameters, markers, cache)
    frames = islice(simulate_sequence(Simulation(width=640, height=480, frames=60, seed=3), images[:1]), 5)
    statuses = []
    for simulated in frames:
        seen, other = localizer.process(simulated.frame)
        statuses.append(seen.status)
        assert seen.homography is not None and seen.pose is not None, seen.reason
        truth = simulated.truths[0]
        size = simulated.frame.image.pixels.shape[1::-1]
        assert corner_error(seen.homography.H, truth.H, markers[0].size, size) < 0.3
        assert np.linalg.norm(seen.pose.t - truth.pose.t) < 0.01 * np.linalg.norm(truth.pose.t)
        assert other.status is Status.LOST
    assert statuses == [Status.DETECTED, *[Status.TRACKED] * 4]


def test_kinds_are_detected_side_by_side() -> None:
    """A marker and a picture in one frame, one localizer; references come and go while others stay tracked."""
    parameters, cache = parameters_from({"tracking.search_every": 1}), BuildCache()
    picture, marker = default_targets(1, seed=5)[0], marker_image(0x2D47, 0.5)
    planar = prepare_references([picture], parameters, cache)[0]
    square = SquareMarker(marker, 1, SquareMarkerParameters.of(parameters), cache)
    localizer = Localizer(parameters, [planar, square], cache)
    frames = [s.frame for s in islice(simulate_sequence(Simulation(640, 480, 60, seed=3), [picture, marker]), 5)]
    assert [result.status for result in localizer.process(frames[0])] == [Status.DETECTED] * 2
    localizer.remove(planar.name)
    assert [result.status for result in localizer.process(frames[1])] == [Status.TRACKED]
    localizer.add(planar)
    localizer.process(frames[2])
    results = localizer.process(frames[3]).references
    assert results[square.name].status is results[planar.name].status is Status.TRACKED


def test_it_is_chosen_by_the_parameter() -> None:
    """The third file: `square_marker` among the choices of `reference` in config/parameters.py."""
    chosen = Parameters(reference=SquareMarker.kind)
    assert isinstance(make_references([marker_image(1)], chosen)[0], SquareMarker)
