# SPDX-License-Identifier: Apache-2.0
"""Views of printed fiducial markers by the renderer of `print_views.py`, with their exact truth.

Frames of 640x480, focal length 680 px, no lens distortion. A marker is printed with a margin of one cell of white, and
lies before a photograph with clutter. Nothing of `imgu_ros.simulate` is used; the markers' cells are drawn by OpenCV.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from print_canvas import Pixels
from print_drawing import Print
from print_views import BITS, BLACK_LEVEL, GAINS, HEIGHT, WIDTH, Light, _about, _between, background, exposed, mapped
from print_views import put_print as put_print

from imgu_ros.frame import Frame
from imgu_ros.vision.camera.intrinsics import make_camera
from imgu_ros.vision.formation.layout import RawImage

Floats = NDArray[np.floating]

FOCAL_PX = 680.0
K = np.array([[FOCAL_PX, 0, (WIDTH - 1) / 2], [0, FOCAL_PX, (HEIGHT - 1) / 2], [0, 0, 1]])
CAMERA = make_camera(K, [], "plumb_bob", WIDTH, HEIGHT)
#: Pixels of the print in a cell: edges are exact to a small part of a px of the frame.
CELL_PX = 40
#: OpenCV draws AprilTag's markers half a turn from how the AprilTag library has them.
DICTIONARIES = {"tag36h11": ("DICT_APRILTAG_36h11", 2), "aruco_5x5_100": ("DICT_5X5_100", 0)}


@dataclass(frozen=True, eq=False)
class MarkerView:
    """A frame and its truth.

    Attributes
    ----------
    frame : raw pixels and camera
    number : the marker's id; None: no marker is in view
    R, t : camera_from_marker, the marker's origin at its centre, x right, y up, z towards the viewer; m
    width_m : outer edge to outer edge of the black square
    corners : (4, 2) px of the black square: top left, top right, bottom right, bottom left
    tilt_deg : between the marker's normal and the line of sight
    """

    frame: Frame
    number: int | None
    R: Floats | None
    t: Floats | None
    width_m: float
    corners: Floats | None
    tilt_deg: float


def marker_print(family: str, number: int, width_m: float, margin: float = 1.0) -> Print:
    """Return the print of a marker with a margin of white, in cells, about the black square."""
    name, turns = DICTIONARIES[family]
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    side = dictionary.markerSize + 2
    cells = np.rot90(cv2.aruco.generateImageMarker(dictionary, number, side), turns)
    square = np.kron(cells, np.ones((CELL_PX, CELL_PX), np.uint8))
    # Ink is not black, paper not white.
    paper = np.pad(np.where(square > 0, 245, 38).astype(np.uint8), round(margin * CELL_PX), constant_values=245)
    return Print(f"{family}_{number}", family, "marker", np.dstack([paper] * 3), width_m * len(paper) / len(square))


def marker_views(
    family: str,
    width_m: float,
    seed: int,
    n: int,
    gamma: bool = False,
    distances_m: tuple[float, float] = (0.5, 1.5),
    most_tilt_deg: float = 60.0,
) -> Iterator[MarkerView]:
    """Yield n views of markers, one in each; the same seed gives the same views.

    Parameters
    ----------
    family, width_m : of the markers
    seed : of ids, places, backgrounds, light and noise
    n : number of views
    gamma : the camera balances white and applies sRGB's curve, 8 bits; else 10 bits that go with the light
    distances_m : of the marker's centre from the camera
    most_tilt_deg : largest angle between normal and line of sight
    """
    rng = np.random.default_rng([seed, zlib.crc32(f"{family} {width_m}".encode())])
    count = len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARIES[family][0])).bytesList)
    for index in range(n):
        number = int(rng.integers(count))
        shown = marker_print(family, number, width_m)
        while True:
            distance, tilt = rng.uniform(*distances_m), math.radians(rng.uniform(0, most_tilt_deg))
            axis, roll = rng.uniform(0, 2 * math.pi, 2)
            at = rng.uniform((0, 0), (WIDTH, HEIGHT))
            R, t = _placed(distance, tilt, axis, roll, at)
            H = _homography(shown, R, t)
            side = len(shown.pixels)
            sheet = mapped(H, _corners(side, 0))
            if ((sheet > 2) & (sheet < (WIDTH - 3, HEIGHT - 3))).all():
                break
        scene = background(rng)
        put_print(scene, shown.pixels, H)
        frame = exposed(scene, Light.drawn(rng), rng, 30 * index)
        frame = replace(encoded(frame) if gamma else frame, camera=CAMERA)
        margin = (side - side * width_m / shown.width_m) / 2
        yield MarkerView(frame, number, R, t, width_m, mapped(H, _corners(side, margin)), math.degrees(tilt))


def encoded(frame: Frame) -> Frame:
    """Return the frame of a camera that balances white and applies the curve of sRGB, 8 bits."""
    raw = frame.image.pixels.astype(np.float64) - BLACK_LEVEL
    for row, column, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        raw[row::2, column::2] /= GAINS[channel]
    v = np.clip(raw / (2**BITS - 1 - BLACK_LEVEL), 0, 1)
    values = np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055)
    return replace(frame, image=RawImage(np.rint(255 * values).astype(np.uint8), frame.image.layout))


def grey_of(frame: Frame) -> Pixels:
    """Return a frame as programs for markers get it: white balance, demosaicking, grey, 8 bits; the curve stays."""
    if frame.image.pixels.dtype == np.uint8:
        return cv2.cvtColor(frame.image.pixels, cv2.COLOR_BayerBG2GRAY)
    raw = frame.image.pixels.astype(np.float32) - BLACK_LEVEL
    for row, column, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        raw[row::2, column::2] /= GAINS[channel]
    scaled = np.clip(raw / (2**BITS - 1 - BLACK_LEVEL), 0, 1)
    grey = cv2.cvtColor(np.rint(scaled * 65535).astype(np.uint16), cv2.COLOR_BayerBG2GRAY)
    return np.rint(grey / 257).astype(np.uint8)


def _corners(side: int, margin: float) -> Floats:
    low, high = margin - 0.5, side - margin - 0.5
    return np.array([[low, low], [high, low], [high, high], [low, high]])


def _placed(distance: float, tilt: float, axis: float, roll: float, at: Floats) -> tuple[Floats, Floats]:
    ray = np.linalg.solve(K, np.array((*at, 1.0)))
    ray /= np.linalg.norm(ray)
    R = (
        _between(np.array((0, 0, 1.0)), ray)
        @ _about(np.array((math.cos(axis), math.sin(axis), 0.0)), tilt)
        @ _about(np.array((0, 0, 1.0)), roll)
        @ np.diag((1.0, -1.0, -1.0))
    )
    return R, ray * distance


def _homography(shown: Print, R: Floats, t: Floats) -> Floats:
    height, width = shown.pixels.shape[:2]
    scale = shown.width_m / width
    metres = np.array([[scale, 0, -scale * (width - 1) / 2], [0, -scale, scale * (height - 1) / 2], [0, 0, 1]])
    return K @ np.column_stack((R[:, 0], R[:, 1], t)) @ metres
