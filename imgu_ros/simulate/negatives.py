# SPDX-License-Identifier: Apache-2.0
"""Frames that do not show a target: photographs, seen from anywhere, and pictures that look like the target."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from imgu_ros.errors import ShapeError
from imgu_ros.frame import Frame
from imgu_ros.simulate.exposure import WHITE
from imgu_ros.simulate.pictures import look_alike
from imgu_ros.simulate.sequence import SimulatedFrame, default_camera
from imgu_ros.types import Image, Matrix3, as_image
from imgu_ros.vision.formation.cfa import BayerPattern, mosaic
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
from imgu_ros.vision.formation.sensor import Sensor, expose

_START_NS = 1_700_000_000_000_000_000
_PERIOD_NS = 33_333_333
#: Every so many frames one shows a look-alike before the photograph.
_ALIKE_EVERY = 3
_ALIKES = 8


def absent_frames(
    photographs: Sequence[Image], target: Image, size: tuple[int, int], count: int, seed: int = 0
) -> Iterator[SimulatedFrame]:
    """Yield frames without the target: natural photographs under random homographies, with noise, as Bayer mosaics.

    In every third frame a picture with the target's header (see `look_alike`) stands before the photograph.

    Parameters
    ----------
    photographs : (H, W, 3) uint8 RGB each; at least one
    target : (H, W, 3) uint8, what is not to be found
    size : width, height of the frames, px, even
    count : how many
    seed : of all that is random

    Raises
    ------
    ShapeError
        If there is no photograph, or one is no such image.
    """
    if not photographs:
        raise ShapeError("photographs: none; need at least one")
    photographs = [as_image(p, "photograph", channels=(3,), dtypes=(np.uint8,)) for p in photographs]
    alikes = [look_alike(target, seed + 700 + i) for i in range(min(_ALIKES, count))]
    camera = default_camera(*size)
    for index in range(count):
        rng = np.random.default_rng([seed, index, 0xAB5E])
        photograph = photographs[int(rng.integers(len(photographs)))]
        picture = _warped(photograph, _covering(photograph, size, rng), size)
        if index % _ALIKE_EVERY == _ALIKE_EVERY - 1:
            alike = alikes[int(rng.integers(len(alikes)))]
            H = _within(alike, size, rng)
            mask = cv2.warpPerspective(np.full(alike.shape[:2], 255, np.uint8), H, size, flags=cv2.INTER_LINEAR)
            picture = np.where(mask[:, :, None] > 127, _warped(alike, H, size), picture)
        exposure = WHITE * rng.uniform(0.4, 1.2)
        light = (picture.astype(np.float32) / 255) ** np.float32(2.2) * np.float32(exposure)
        pixels = expose(mosaic(light, BayerPattern.RGGB), Sensor(), rng)
        raw = RawImage(pixels, PixelLayout(ColorModel.BAYER, BayerPattern.RGGB))
        frame = Frame(raw, _START_NS + index * _PERIOD_NS, "camera_optical_frame", camera)
        yield SimulatedFrame(frame, (), exposure)


def _covering(photograph: Image, size: tuple[int, int], rng: np.random.Generator) -> Matrix3:
    """Return a homography under which the photograph covers the frame."""
    height, width = photograph.shape[:2]
    # Which quadrangle of the photograph the frame shows: a rotated rectangle, its corners moved.
    scale = rng.uniform(0.35, 0.68) * min(width / size[0], height / size[1])
    turn = rng.uniform(0, 2 * np.pi)
    c, s = np.cos(turn), np.sin(turn)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array(size) / 2 * scale
    corners = corners * rng.uniform(0.75, 1.0, (4, 2)) @ np.array([[c, s], [-s, c]])
    room = np.maximum(np.array([width, height]) / 2 - np.abs(corners).max(axis=0) - 1, 0)
    corners += np.array([width, height]) / 2 + rng.uniform(-1, 1, 2) * room
    return _between(corners, size)


def _within(alike: Image, size: tuple[int, int], rng: np.random.Generator) -> Matrix3:
    """Return a homography that puts the whole of a picture somewhere into the frame."""
    height, width = alike.shape[:2]
    turn = rng.uniform(0, 2 * np.pi)
    c, s = np.cos(turn), np.sin(turn)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array([width, height]) / 2
    corners = corners * rng.uniform(0.75, 1.0, (4, 2)) @ np.array([[c, s], [-s, c]])
    # The whole of it is in view: of a header alone nobody could say which picture it belongs to.
    reach = np.array(size) / 2 / np.abs(corners).max(axis=0)
    corners *= rng.uniform(0.3, 0.98) * reach.min()
    corners += np.array(size) / 2 + rng.uniform(-1, 1, 2) * (np.array(size) / 2 - np.abs(corners).max(axis=0))
    ends = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    return np.asarray(cv2.getPerspectiveTransform(ends, corners.astype(np.float32)), np.float64)


def _between(corners: Image, size: tuple[int, int]) -> Matrix3:
    ends = np.array([[0, 0], [size[0], 0], [size[0], size[1]], [0, size[1]]], np.float32)
    return np.asarray(cv2.getPerspectiveTransform(corners.astype(np.float32), ends), np.float64)


def _warped(picture: Image, H: Matrix3, size: tuple[int, int]) -> Image:
    # Where it is reduced, an average of what a pixel covers.
    reduction = float(np.linalg.norm(np.linalg.inv(H)[:2, :2], axis=0).max() / abs(np.linalg.inv(H)[2, 2]))
    if reduction > 1.5:
        picture = cv2.GaussianBlur(picture, (0, 0), 0.4 * reduction)
    return cv2.warpPerspective(picture, H, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
