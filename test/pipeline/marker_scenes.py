# SPDX-License-Identifier: Apache-2.0
"""Scenes with fiducial markers, drawn exactly, and their raw frames: what the tests of markers and boards share."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from imgu_ros.frame import Frame
from imgu_ros.reference.marker_layout import PlacedMarker
from imgu_ros.result import ReferenceResult
from imgu_ros.types import Floats, Image
from imgu_ros.vision.camera.intrinsics import make_camera
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
from imgu_ros.vision.markers import marker_cells

WIDTH, HEIGHT, FINE = 640, 480, 6
K = np.array([[680.0, 0, 319.5], [0, 680, 239.5], [0, 0, 1]])
CAMERA = make_camera(K, [], "plumb_bob", WIDTH, HEIGHT)
LAYOUT = PixelLayout(ColorModel.BAYER, BayerPattern.RGGB)
FAMILY = "tag36h11"


def placed(x_m: float, y_m: float, z_m: float, tilt_deg: float, roll_deg: float = 20.0) -> tuple[Floats, Floats]:
    """Return rotation and translation camera_from_target."""
    R = (
        cv2.Rodrigues(np.array((0.0, np.radians(tilt_deg), 0)))[0]
        @ cv2.Rodrigues(np.array((0, 0, np.radians(roll_deg))))[0]
    )
    return R @ np.diag((1.0, -1.0, -1.0)), np.array((x_m, y_m, z_m))


def scene() -> Image:
    """Return grey, in linear light, `FINE` px a px."""
    ramp = np.linspace(0.25, 0.4, WIDTH * FINE, dtype=np.float32)
    return np.repeat(ramp[None], HEIGHT * FINE, axis=0)


def put(light: Image, cells: np.ndarray, width_m: float, R: Floats, t: Floats, margin: int = 1) -> None:
    """Draw cells, with a margin of white, into a scene; `width_m` is that of the cells without it."""
    white = np.pad(np.asarray(cells, np.float32), margin, constant_values=1)
    fine = cv2.resize(0.06 + 0.74 * white, None, fx=32, fy=32, interpolation=cv2.INTER_NEAREST)
    side, scale = len(fine), width_m / (32 * len(cells))
    metres = np.array([[scale, 0, -scale * (side - 1) / 2], [0, -scale, scale * (side - 1) / 2], [0, 0, 1]])
    S = np.array([[FINE, 0, (FINE - 1) / 2], [0, FINE, (FINE - 1) / 2], [0, 0, 1]])
    H = S @ K @ np.column_stack((R[:, 0], R[:, 1], t)) @ metres
    size = (light.shape[1], light.shape[0])
    drawn = cv2.warpPerspective(fine, H, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    corners = (
        np.array([[-0.5, -0.5, 1], [side - 0.5, -0.5, 1], [side - 0.5, side - 0.5, 1], [-0.5, side - 0.5, 1]]) @ H.T
    )
    mask = np.zeros(light.shape, np.uint8)
    cv2.fillConvexPoly(mask, np.rint(corners[:, :2] / corners[:, 2:]).astype(np.int32), 1)
    light[mask > 0] = drawn[mask > 0]


def exposed(light: Image, seed: int = 0, blur_px: float = 0.5, index: int = 0) -> Frame:
    """Return the raw frame of a scene: point spread, sites, noise, 8 bits."""
    seen = cv2.resize(cv2.GaussianBlur(light, (0, 0), blur_px * FINE), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    noise = np.random.default_rng(seed).standard_normal(seen.shape).astype(np.float32)
    raw = np.rint(255 * (seen + 0.006 * np.sqrt(seen) * noise))
    image = RawImage(np.clip(raw, 0, 255).astype(np.uint8), LAYOUT)
    return Frame(image, 1_000_000_000 + 33_000_000 * index, "camera", CAMERA)


def error_m(found: ReferenceResult, t: Floats) -> float:
    assert found.pose is not None, (found.status, found.reason)
    return float(np.linalg.norm(found.pose.t - t))


def sheet(markers: Sequence[PlacedMarker], margin_m: float = 0.01, px_m: float = 4000.0) -> tuple[Image, Floats]:
    """Return the print of markers, white 1 and black 0, and metres on the plane of its px; drawn cell by cell."""
    left, right = (f(m.x + s * m.size / 2 for m in markers) + s * margin_m for f, s in ((min, -1), (max, 1)))
    low, top = (f(m.y + s * m.size / 2 for m in markers) + s * margin_m for f, s in ((min, -1), (max, 1)))
    x = left + (np.arange(round((right - left) * px_m)) + 0.5) / px_m
    y = top - (np.arange(round((top - low) * px_m)) + 0.5) / px_m
    paper = np.ones((len(y), len(x)), np.float32)
    for m in markers:
        cells = np.rot90(marker_cells(m.family, m.number), m.quarter_turns)
        column = np.floor((x - m.x + m.size / 2) / m.size * len(cells)).astype(int)
        row = np.floor((m.y + m.size / 2 - y) / m.size * len(cells)).astype(int)
        inside_x, inside_y = (column >= 0) & (column < len(cells)), (row >= 0) & (row < len(cells))
        paper[np.ix_(inside_y, inside_x)] = cells[np.ix_(row[inside_y], column[inside_x])]
    return paper, np.array([[1 / px_m, 0, x[0]], [0, -1 / px_m, y[0]], [0, 0, 1]])


def put_sheet(light: Image, paper: Image, plane_from_px: Floats, R: Floats, t: Floats) -> None:
    """Draw a print into a scene at camera_from_plane."""
    S = np.array([[FINE, 0, (FINE - 1) / 2], [0, FINE, (FINE - 1) / 2], [0, 0, 1]])
    H = S @ K @ np.column_stack((R[:, 0], R[:, 1], t)) @ plane_from_px
    size = (light.shape[1], light.shape[0])
    drawn = cv2.warpPerspective(0.06 + 0.74 * paper, H, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    height, width = paper.shape
    corners = np.array([[0, 0, 1], [width, 0, 1], [width, height, 1], [0, height, 1]]) - (0.5, 0.5, 0)
    at = corners @ H.T
    mask = np.zeros(light.shape, np.uint8)
    cv2.fillConvexPoly(mask, np.rint(at[:, :2] / at[:, 2:]).astype(np.int32), 1)
    light[mask > 0] = drawn[mask > 0]


def nees(found: ReferenceResult, R: Floats, t: Floats) -> float:
    assert found.pose is not None, (found.status, found.reason)
    error = np.concatenate((t - found.pose.t, cv2.Rodrigues(R @ found.pose.R.T)[0].ravel()))
    return float(error @ np.linalg.solve(found.pose.covariance, error))
