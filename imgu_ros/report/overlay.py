# SPDX-License-Identifier: Apache-2.0
"""A frame with what the pipeline found in it drawn over: as a raster picture, or as vectors over one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from imgu_ros.errors import FileError, ImguError
from imgu_ros.image_files.images import RASTER_SUFFIXES, write_image
from imgu_ros.messages.annotations import INLIER_COLOR, STATUS_COLORS
from imgu_ros.reasons import unusable_frame
from imgu_ros.result import PoseStatus, ReferenceResult, Result, Status
from imgu_ros.types import Floats, Image, Points
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.pose import Pose

#: Those of `files/vector_figure.py`, which loads Matplotlib.
VECTOR_SUFFIXES = (".svg", ".pdf", ".eps", ".ps")

_AXES = ((230, 40, 40), (40, 200, 40), (60, 110, 255))  # x red, y green, z blue, as in RViz
_SHIFT = 4  # drawing coordinates carry 4 bits of fraction
_EDGE_POINTS = 17
_NO_PICTURE = (180, 960)  # height, width of what stands for a frame that could not be decoded
_DARK = 0.35
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def draw_result(result: Result) -> Image:
    """Draw outlines, pose axes, inliers and a line of status for each target over the frame.

    Parameters
    ----------
    result : as the pipeline returned it; a rejected frame gives a grey picture with the reason

    Returns
    -------
    (H, W, 3) uint8 RGB, a new array
    """
    canvas = _background(result)
    _draw_over(_RasterPen(canvas), result)
    return canvas


def write_overlay(path: Path | str, result: Result) -> None:
    """Write what `draw_result` draws to a file; into .svg, .pdf, .eps and .ps as vectors over the embedded frame.

    Raises
    ------
    FileError
        If the suffix is unknown, or the file cannot be written.
    """
    check_overlay_suffix(path)
    if Path(path).suffix.lower() in RASTER_SUFFIXES:
        write_image(path, draw_result(result))
        return
    # Matplotlib takes half a second to load: not for a node that draws its debug image.
    from imgu_ros.files.vector_figure import VectorFigure

    figure = VectorFigure(_background(result))
    _draw_over(figure, result)
    figure.save(path)


def check_overlay_suffix(path: Path | str) -> None:
    """Raise FileError when `write_overlay` knows no such suffix."""
    known = (*RASTER_SUFFIXES, *VECTOR_SUFFIXES)
    if Path(path).suffix.lower() not in known:
        raise FileError(f"{path}: suffix {Path(path).suffix!r}; need one of {', '.join(known)}")


class _Pen(Protocol):
    """What draws over a picture, at sub-pixel positions in its pixel coordinates."""

    @property
    def width(self) -> float: ...

    def line(self, points: Points, color: tuple[int, int, int], *, closed: bool = False) -> None: ...

    def dots(self, points: Points, color: tuple[int, int, int], radius: float) -> None: ...

    def text(self, lines: list[tuple[str, tuple[int, int, int]]]) -> None: ...


def _draw_over(pen: _Pen, result: Result) -> None:
    for target in result:
        _draw_inliers(pen, target)
    for target in result:
        _draw_outline(pen, target, result.frame.camera)
        _draw_axes(pen, target, result.frame.camera)
    if result.reason or not result.references:
        text = unusable_frame(result.reason) if result.reason else "no targets"
        pen.text([(text, STATUS_COLORS[Status.REJECTED])])
    else:
        pen.text([(_status_text(target), STATUS_COLORS[target.status]) for target in result])


@dataclass(frozen=True, slots=True, eq=False)
class _RasterPen:
    """Draws into a canvas, with lines as thick as the picture needs."""

    canvas: Image

    @property
    def width(self) -> int:
        height, width = self.canvas.shape[:2]
        return 1 + int(max(height, width) / 640)

    def line(self, points: Points, color: tuple[int, int, int], *, closed: bool = False) -> None:
        """Draw a polyline, dark-edged so that it stands out on any picture."""
        if np.abs(points).max() > 1e6:  # far outside: beyond what the drawing routine can clip
            return
        fixed = [np.rint(points * 2**_SHIFT).astype(np.int32)]
        for ink, width in (((0, 0, 0), self.width + 2), (color, self.width)):
            cv2.polylines(self.canvas, fixed, closed, ink, width, cv2.LINE_AA, _SHIFT)

    def dots(self, points: Points, color: tuple[int, int, int], radius: float) -> None:
        height, width = self.canvas.shape[:2]
        inside = ((points >= 0) & (points <= (width - 1, height - 1))).all(axis=1)
        for x, y in np.rint(points[inside] * 2**_SHIFT).astype(int).tolist():
            cv2.circle(self.canvas, (x, y), round(radius * 2**_SHIFT), color, -1, cv2.LINE_AA, _SHIFT)

    def text(self, lines: list[tuple[str, tuple[int, int, int]]]) -> None:
        _draw_lines(self.canvas, lines)


def _background(result: Result) -> Image:
    if result.developed is None:
        height, width = result.frame.image.pixels.shape[:2] if result.frame.image.pixels.size else _NO_PICTURE
        return np.full((height, width, 3), 64, np.uint8)
    return result.developed.for_screen()


def _draw_inliers(pen: _Pen, target: ReferenceResult) -> None:
    if target.matches is not None and target.status.found:
        xy = target.matches.image_xy[target.matches.inliers]
        pen.dots(xy, (0, 0, 0), 0.8 * pen.width + 1.3)
        pen.dots(xy, INLIER_COLOR, 0.8 * pen.width + 0.5)


def _draw_outline(pen: _Pen, target: ReferenceResult, camera: Camera | None) -> None:
    if target.outline is None:
        return
    color = STATUS_COLORS[target.status]
    pen.line(_bent_outline(target.outline, camera), color, closed=True)
    # The dot marks the target's top left corner, so that a turned or swapped outline can be seen.
    pen.dots(target.outline[:1], (0, 0, 0), 3.0 * pen.width + 1)
    pen.dots(target.outline[:1], color, 3.0 * pen.width)


def _bent_outline(outline: Points, camera: Camera | None) -> Points:
    """Return the outline as a closed polyline that follows the lens distortion, (4 * 16, 2)."""
    if camera is None or not camera.is_distorted:
        return outline
    ideal, valid = camera.ideal_pixels(outline)
    if not valid.all():
        return outline
    share = np.linspace(0.0, 1.0, _EDGE_POINTS)[:-1, None]
    edges = [a + share * (b - a) for a, b in zip(ideal, np.roll(ideal, -1, axis=0), strict=True)]
    return camera.raw_pixels(np.concatenate(edges))


def _draw_axes(pen: _Pen, target: ReferenceResult, camera: Camera | None) -> None:
    if target.pose is None or target.outline is None or camera is None:
        return
    length = _axis_length_m(target.pose, target.outline, camera)
    if length is None:
        return
    origin = target.pose.t
    # z last: it comes out of the printed face, towards the viewer.
    for axis, color in enumerate(_AXES):
        ends = np.array([origin, origin + length * target.pose.R[:, axis]])
        try:
            points = camera.project(ends)
        except ImguError:  # the tip is behind the camera
            continue
        pen.line(points, color)


def _axis_length_m(pose: Pose, outline: Points, camera: Camera) -> float | None:
    """Return a third of the target's shorter side, in metres, from where the outline's rays meet its plane."""
    normalized, valid = camera.undistort(outline)
    rays = np.column_stack((normalized, np.ones(4)))
    normal = pose.R[:, 2]
    slant = rays @ normal
    if not valid.all() or np.abs(slant).min() < 1e-9:
        return None
    corners: Floats = rays * (normal @ pose.t / slant)[:, None]
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).min() / 3)


def _status_text(target: ReferenceResult) -> str:
    parts = [target.name, target.status.value]
    if target.matches is not None and target.status.found:
        # Those that are drawn; the final fit may rest on others.
        parts.append(f"{np.count_nonzero(target.matches.inliers)} points agree")
    if target.homography is not None:
        parts.append(f"fit {target.homography.rms_px:.2f} px rms")
    if target.pose is not None:
        sigma_mm = 1e3 * float(np.sqrt(np.trace(target.pose.covariance[:3, :3])))
        parts.append(f"{np.linalg.norm(target.pose.t):.3f} m +- {sigma_mm:.2g} mm")
    elif target.pose_status is not PoseStatus.NONE:
        parts.append(target.pose_status.value.replace("_", " "))
    if target.reason:
        parts.append(target.reason)
    return "  ".join(parts)


def _draw_lines(canvas: Image, lines: list[tuple[str, tuple[int, int, int]]]) -> None:
    """Write lines of text, top left, on a darkened strip; as large as fits the width."""
    height, width = canvas.shape[:2]
    scale = max(0.3, max(height, width) / 1500)
    thickness = max(1, round(scale * 1.6))
    texts = [(_fitting(text, scale, thickness, width - 8), color) for text, color in lines]
    line_height = round(30 * scale) + 4
    strip: Any = canvas[: min(height, line_height * len(texts) + 4)]
    strip[:] = (strip * _DARK).astype(np.uint8)
    for row, (text, color) in enumerate(texts):
        baseline = (4, round(line_height * (row + 0.75)) + 2)
        cv2.putText(canvas, text, baseline, _FONT, scale, color, thickness, cv2.LINE_AA)


def _fitting(text: str, scale: float, thickness: int, width: int) -> str:
    """Return as much of `text` as fits into `width` pixels."""
    plain = text.encode("ascii", "replace").decode("ascii")
    for length in range(len(plain), 0, -1):
        shown = plain if length == len(plain) else plain[: max(length - 2, 1)] + ".."
        if cv2.getTextSize(shown, _FONT, scale, thickness)[0][0] <= width:
            return shown
    return ""
