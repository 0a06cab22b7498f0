# SPDX-License-Identifier: Apache-2.0
"""Views of boards and cubes of fiducial markers by the renderer of `print_views.py`, with their exact truth.

Frames of 640x480, focal length 680 px, no lens distortion, before a photograph with clutter. Nothing of
`imgu_ros.simulate` is used; the markers are drawn by OpenCV.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from marker_views import CAMERA, DICTIONARIES, K, _placed
from numpy.typing import NDArray
from print_canvas import Pixels
from print_views import HEIGHT, WIDTH, Light, background, exposed, mapped, put_print

from imgu_ros.frame import Frame

Floats = NDArray[np.floating]

#: Grey values of ink and paper.
INK, PAPER = 38, 245


@dataclass(frozen=True, eq=False)
class Sheet:
    """A print on a plane.

    Attributes
    ----------
    pixels : RGB
    plane_from_px : (3, 3) metres, x right, y up
    """

    pixels: Pixels
    plane_from_px: Floats

    def corners(self) -> Floats:
        """The corners of the paper, (4, 2) px."""
        height, width = self.pixels.shape[:2]
        return np.array([[-0.5, -0.5], [width - 0.5, -0.5], [width - 0.5, height - 0.5], [-0.5, height - 0.5]])

    def homography(self, R: Floats, t: Floats) -> Floats:
        """Return H_image_px of the sheet at camera_from_plane."""
        return K @ np.column_stack((R[:, 0], R[:, 1], t)) @ self.plane_from_px


@dataclass(frozen=True)
class Tag:
    """A marker on a plane: id, side of the black square and centre, m, x right, y up."""

    number: int
    size: float
    x: float = 0.0
    y: float = 0.0


def sheet_of(tags: Sequence[Tag], family: str = "tag36h11", cell_px: int = 24, margin_cells: float = 1.0) -> Sheet:
    """Return the print of upright markers of one size, with a margin of white."""
    name, turns = DICTIONARIES[family]
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    cells = dictionary.markerSize + 2
    size = tags[0].size
    px = cells * cell_px / size
    margin = margin_cells * size / cells
    left, right = (f(tag.x + s * size / 2 for tag in tags) + s * margin for f, s in ((min, -1), (max, 1)))
    low, top = (f(tag.y + s * size / 2 for tag in tags) + s * margin for f, s in ((min, -1), (max, 1)))
    paper = np.full((round((top - low) * px), round((right - left) * px)), PAPER, np.uint8)
    draw = getattr(cv2.aruco, "generateImageMarker", None) or cv2.aruco.drawMarker
    for tag in tags:
        square = np.rot90(draw(dictionary, tag.number, cells * cell_px), turns)
        x, y = round((tag.x - size / 2 - left) * px), round((top - tag.y - size / 2) * px)
        paper[y : y + len(square), x : x + len(square)] = np.where(square > 0, PAPER, INK)
    to_plane = np.array([[1 / px, 0, left + 0.5 / px], [0, -1 / px, top - 0.5 / px], [0, 0, 1]])
    return Sheet(np.dstack([paper] * 3), to_plane)


def grid_of(numbers: Sequence[int], columns: int, size: float, gap: float) -> list[Tag]:
    """Return markers in rows about the origin."""
    rows, step = -(-len(numbers) // columns), size + gap
    return [
        Tag(number, size, step * (i % columns - (columns - 1) / 2), step * ((rows - 1) / 2 - i // columns))
        for i, number in enumerate(numbers)
    ]


def pose_in_view(
    rng: np.random.Generator, sheet: Sheet, distance: tuple[float, float], most_tilt_deg: float
) -> tuple[Floats, Floats]:
    """Return camera_from_plane by which all of a sheet is in view."""
    while True:
        tilt = math.radians(rng.uniform(0, most_tilt_deg))
        R, t = _placed(
            rng.uniform(*distance), tilt, *rng.uniform(0, 2 * math.pi, 2), rng.uniform((0, 0), (WIDTH, HEIGHT))
        )
        seen = mapped(sheet.homography(R, t), sheet.corners())
        if ((seen > 2) & (seen < (WIDTH - 3, HEIGHT - 3))).all():
            return R, t


def frame_of(scene: Floats, rng: np.random.Generator, index: int = 0) -> Frame:
    """Return the raw frame of a scene, with its camera."""
    return replace(exposed(scene, Light.drawn(rng), rng, index), camera=CAMERA)


def cover(scene: Floats, corners: Floats, rng: np.random.Generator) -> None:
    """Cover a part of the frame, corners (N, 2) px, with something dark and something bright."""
    factor = scene.shape[1] / WIDTH
    mask = np.zeros(scene.shape[:2], np.uint8)
    at = (corners + 0.5) * factor - 0.5
    cv2.fillConvexPoly(mask, np.rint(at * 256).astype(np.int32), 1, cv2.LINE_8, 8)
    texture = cv2.resize(rng.uniform(0.02, 0.5, (24, 32, 3)), scene.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    scene[mask > 0] = texture[mask > 0]


def board_frame(
    sheet: Sheet, R: Floats, t: Floats, rng: np.random.Generator, covered: float = 0.0, index: int = 0
) -> Frame:
    """Return a frame of a sheet, a share of which is covered from one side."""
    scene = background(rng)
    H = sheet.homography(R, t)
    put_print(scene, sheet.pixels, H)
    if covered:
        corners = sheet.corners()
        if rng.random() < 0.5:
            corners = np.roll(corners, 1, axis=0)
        a, b, c, d = corners
        part = np.array([a, a + covered * (b - a), d + covered * (c - d), d])
        cover(scene, mapped(H, part), rng)
    return frame_of(scene, rng, index)


def cube_places(side: float) -> list[tuple[Floats, Floats]]:
    """Return thing_from_face, R and t, of five faces of a cube: four upright ones and the top; origin in its middle."""
    places = []
    for angle in (0, 90, 180, 270):
        a = math.radians(angle)
        # Upright: the face's y is up, z outwards.
        outwards, up = np.array((math.sin(a), 0.0, math.cos(a))), np.array((0.0, 1.0, 0.0))
        places.append((np.column_stack((np.cross(up, outwards), up, outwards)), side / 2 * outwards))
    top = np.array((0.0, 1.0, 0.0))
    places.append((np.column_stack(((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), top)), side / 2 * top))
    return places


def cube_frame(
    rng: np.random.Generator, numbers: Sequence[int], side: float, size: float, R: Floats, t: Floats, index: int = 0
) -> Frame:
    """Return a frame of a cube with a marker on each of five faces, at camera_from_thing."""
    scene = background(rng)
    for number, (R_face, t_face) in zip(numbers, cube_places(side), strict=True):
        R_seen, t_seen = R @ R_face, R @ t_face + t
        if R_seen[:, 2] @ t_seen < 0:
            sheet = sheet_of([Tag(number, size)], margin_cells=8 * (side / size - 1) / 2)
            put_print(scene, sheet.pixels, sheet.homography(R_seen, t_seen))
    return frame_of(scene, rng, index)


def cube_pose(
    rng: np.random.Generator, side: float, distance: tuple[float, float], from_below_deg: float = 0.0
) -> tuple[Floats, Floats]:
    """Return camera_from_thing from any side but from below, the whole cube in view."""
    corners = side / 2 * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    while True:
        # Uniform over all rotations (Shoemake 1992): a quaternion of normal numbers.
        w, x, y, z = (q := rng.standard_normal(4)) / np.linalg.norm(q)
        R = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ])  # fmt: skip
        ray = np.linalg.solve(K, np.array((*rng.uniform((0, 0), (WIDTH, HEIGHT)), 1.0)))
        t = ray / np.linalg.norm(ray) * rng.uniform(*distance)
        # The direction to the camera, in the thing.
        up = -(R.T @ t)[1] / np.linalg.norm(t)
        seen = mapped(K, ((corners @ R.T + t) / (corners @ R.T + t)[:, 2:])[:, :2])
        if up > -math.sin(math.radians(from_below_deg)) and ((seen > 2) & (seen < (WIDTH - 3, HEIGHT - 3))).all():
            return R, t
