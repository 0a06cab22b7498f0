"""Finding a target's points in a frame by Lucas-Kanade (Bouguet 2001): in a reduced view, then patch by patch.

Both draw the target as the estimate says that it looks and compare the drawing with the frame. The view bridges errors
of many pixels but sees only the coarse; the patches are drawn at full resolution, and only they: a frame of two
million pixels has some hundred thousand that matter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from imgu_ros.errors import NoConsensus
from imgu_ros.perception.expectation import Expectation, expect
from imgu_ros.perception.targets import Target
from imgu_ros.types import Floats, Image, Indices, Mask, Matrix3, Points
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.projective.transform import transform

_MIN_EIGENVALUE = 1e-4
#: A view larger than this square is reduced.
_VIEW_SIDE_PX = 400
#: Room around the points of a view, for their windows and for the image pyramid.
_VIEW_MARGIN_PX = 32
#: Points that a view is aligned by: the estimate that follows only has to come within reach of the patches.
_VIEW_POINTS = 100
#: Largest window in a view; what is small there is large in the frame.
_VIEW_WINDOW_PX = 11
_VIEW_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.03)
#: Brightness is measured on every third pixel of every third row of a view.
_SAMPLED = 3
#: How far from where it is expected a patch may be found.
_PATCH_REACH_PX = 4
#: Pixels that a window needs around it, for its derivatives and for interpolation.
_PATCH_RIM_PX = 2
_PATCH_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.003)


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """Points found: template px, raw px, ideal px, each (N, 2); `sought` is how many were tried."""

    template_xy: Points
    image_xy: Points
    ideal_xy: Points
    sought: int


def follow_in_view(
    grey: Image, target: Target, H: Matrix3, camera: Camera | None, window_px: int, fewest: int, lk_levels: int
) -> Followed:
    """Find a target's points in the part of the frame about them, halved until it is of moderate size.

    Parameters
    ----------
    grey : (H, W) uint8, the frame
    target : the target
    H : H_image_template in ideal px, right to a few px times 2^lk_levels
    camera : intrinsics when the lens distorts; else None
    window_px : side of a point's window, px of the view, where it is at most 11
    fewest : least number of points to look for
    lk_levels : image pyramid levels, each doubles the error that is bridged

    Raises
    ------
    NoConsensus
        If too few points are in view.
    """
    window_px = min(window_px, _VIEW_WINDOW_PX)
    step = _reduction(target, H, grey.shape)
    margin = step * (window_px // 2 + 1)
    expected = expect(
        target, H, camera, grey.shape, step=step, margin=margin, most=max(_VIEW_POINTS, fewest), fewest=fewest
    )
    view = _cut_out(grey, expected.predicted, step)
    at = view.from_raw(expected.predicted)
    drawn_at = at if camera is None else view.from_raw(transform(expected.H_raw, expected.template_xy))
    found, good = _lucas_kanade(
        _drawn_view(target, expected, view), view.image, drawn_at, at, window_px, lk_levels, _VIEW_CRITERIA
    )
    return _followed(expected, view.to_raw(found), good, camera)


def follow_by_patches(
    grey: Image, target: Target, H: Matrix3, camera: Camera | None, window_px: int, most: int, fewest: int
) -> Followed:
    """Find a target's points at full resolution, each in its own patch of the frame.

    Parameters
    ----------
    grey, target, camera : as for `follow_in_view`
    H : H_image_template in ideal px, right to about two px
    window_px : side of a point's window
    most, fewest : number of points to look for

    Raises
    ------
    NoConsensus
        If too few points are in view, or the frame is smaller than a patch.
    """
    side = window_px + 2 * (_PATCH_REACH_PX + _PATCH_RIM_PX)
    if min(grey.shape) < side:
        raise NoConsensus(f"frame: {grey.shape[1]} x {grey.shape[0]} px; need {side} x {side}")
    reach = window_px // 2 + _PATCH_RIM_PX
    expected = expect(target, H, camera, grey.shape, step=1, margin=reach, most=most, fewest=fewest)
    limit = np.array((grey.shape[1] - side, grey.shape[0] - side))
    origin = np.clip(np.rint(expected.predicted).astype(np.intp) - side // 2, 0, limit)
    sheet = _Sheet(len(origin), side)
    seen = sheet.arranged(np.lib.stride_tricks.sliding_window_view(grey, (side, side))[origin[:, 1], origin[:, 0]])
    drawn = _matched_brightness(_drawn_patches(expected, origin, sheet), seen, None)
    to_sheet = sheet.corners - origin
    start = expected.predicted + to_sheet
    found, good = _lucas_kanade(drawn, seen, start, start, window_px, 0, _PATCH_CRITERIA)
    # A window that left its patch has looked at another one.
    inside = found - sheet.corners
    good &= (np.abs(found - start) <= _PATCH_REACH_PX).all(axis=1)
    good &= ((inside >= window_px // 2) & (inside <= side - 1 - window_px // 2)).all(axis=1)
    return _followed(expected, found - to_sheet, good, camera)


def _followed(expected: Expectation, image_xy: Points, good: Mask, camera: Camera | None) -> Followed:
    template_xy, image_xy, sought = expected.template_xy[good], image_xy[good], len(good)
    if camera is None:
        return Followed(template_xy, image_xy, image_xy, sought)
    ideal, valid = camera.ideal_pixels(image_xy)
    return Followed(template_xy[valid], image_xy[valid], ideal[valid], sought)


def _lucas_kanade(
    drawn: Image,
    seen: Image,
    drawn_at: Points,
    start_at: Points,
    window_px: int,
    levels: int,
    criteria: tuple[int, int, float],
) -> tuple[Points, Mask]:
    """Return where the points of the drawing are seen, (N, 2), and which of them were found."""
    from_at = drawn_at.astype(np.float32)
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        drawn,
        seen,
        from_at,
        start_at.astype(np.float32),
        winSize=(window_px, window_px),
        maxLevel=levels,
        criteria=criteria,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        minEigThreshold=_MIN_EIGENVALUE,
    )
    # Rounding the points to float32 moved them; what was found moves back by as much.
    xy = found.astype(np.float64) + (drawn_at - from_at)
    return xy, (status.ravel() == 1) & np.isfinite(xy).all(axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """A part of the frame, reduced by `step`; `offset` is its top-left raw pixel."""

    image: Image
    offset: Points
    step: int

    def from_raw(self, xy: Points) -> Points:
        return (xy - self.offset + 0.5) / self.step - 0.5

    def to_raw(self, xy: Points) -> Points:
        return (xy + 0.5) * self.step - 0.5 + self.offset


def _reduction(target: Target, H: Matrix3, shape: tuple[int, ...]) -> int:
    """Return by how much to reduce the view so that it is of moderate size: 1, 2 or 4."""
    outline = transform(H, target.outline_template)
    width, height = np.ptp(np.clip(outline, 0, (shape[1], shape[0])), axis=0)
    side = math.sqrt(float(width * height))
    return 1 if side <= _VIEW_SIDE_PX else 2 if side <= 2 * _VIEW_SIDE_PX else 4


def _cut_out(grey: Image, predicted: Points, step: int) -> _View:
    """Return the part of the frame about the predicted points, with room for windows and image pyramid."""
    height, width = grey.shape
    margin = _VIEW_MARGIN_PX * step
    left, top = np.maximum(np.floor(predicted.min(axis=0)).astype(int) - margin, 0)
    right, bottom = np.minimum(np.ceil(predicted.max(axis=0)).astype(int) + 1 + margin, (width, height))
    # Whole cells only: a reduced pixel is the mean of step x step raw ones.
    right, bottom = right - (right - left) % step, bottom - (bottom - top) % step
    image = grey[top:bottom, left:right]
    for _ in range(int(math.log2(step))):  # OpenCV halves far faster than it quarters
        image = cv2.resize(image, (image.shape[1] // 2, image.shape[0] // 2), interpolation=cv2.INTER_AREA)
    return _View(image, np.array([left, top], np.float64), step)


def _drawn_view(target: Target, expected: Expectation, view: _View) -> Image:
    """Draw the target as it should look in the view, brightness and contrast matched to it."""
    s = 1 / view.step
    shift = (0.5 - view.offset) * s - 0.5
    view_from_raw = np.array([[s, 0, shift[0]], [0, s, shift[1]], [0, 0, 1]])
    size = (view.image.shape[1], view.image.shape[0])
    M = view_from_raw @ expected.raw_from_level
    # Its rim is continued outwards: a black surround would pull at the outermost points, which weigh most.
    drawn = cv2.warpPerspective(
        expected.octave.level.image, M, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    covered = np.zeros(view.image.shape, np.uint8)
    outline = view.from_raw(transform(expected.H_raw, target.outline_template))
    cv2.fillConvexPoly(covered, np.clip(np.rint(outline), -30000, 30000).astype(np.int32), 255)
    return _matched_brightness(drawn, view.image, covered)


def _matched_brightness(drawn: Image, seen: Image, covered: Image | None) -> Image:
    """Return the drawing with the brightness and contrast of what is seen, measured where `covered` says."""
    n = _SAMPLED
    samples = [np.ascontiguousarray(picture[::n, ::n]) for picture in (drawn, seen)]
    mask = None if covered is None else np.ascontiguousarray(covered[::n, ::n])
    (mean_drawn, deviation_drawn), (mean_seen, deviation_seen) = (
        (float(value[0, 0]) for value in cv2.meanStdDev(sample, mask=mask)) for sample in samples
    )
    if deviation_drawn < 1.0 or deviation_seen < 1.0:
        return drawn
    gain = deviation_seen / deviation_drawn
    return cv2.addWeighted(drawn, gain, drawn, 0.0, mean_seen - gain * mean_drawn)


class _Sheet:
    """N square patches side by side in rows, as one picture; places that are left over repeat the last patch."""

    def __init__(self, count: int, side: int) -> None:
        self.side = side
        self.columns = math.ceil(math.sqrt(count))
        self.rows = math.ceil(count / self.columns)
        self._source = np.minimum(np.arange(self.rows * self.columns), count - 1)
        row, column = np.divmod(np.arange(count), self.columns)
        #: (N, 2) top-left pixel of each patch in the sheet.
        self.corners = np.column_stack((column, row)) * side

    def arranged(self, patches: Image) -> Image:
        """Return patches (N, side, side) as a sheet."""
        grid = patches[self._source].reshape(self.rows, self.columns, self.side, self.side)
        return grid.transpose(0, 2, 1, 3).reshape(self.rows * self.side, self.columns * self.side)

    def spread_out(self, per_patch: Floats, per_x: float, per_y: float) -> Image:
        """Return per_patch + per_x * x + per_y * y for every pixel (x, y) of every patch, as a sheet."""
        along = np.arange(self.side, dtype=np.float32)
        start = per_patch[self._source].astype(np.float32).reshape(self.rows, 1, self.columns, 1)
        rows = start + (np.float32(per_y) * along).reshape(1, -1, 1, 1)
        sheet: Image = rows + np.float32(per_x) * along
        return sheet.reshape(self.rows * self.side, self.columns * self.side)


def _drawn_patches(expected: Expectation, origin: Indices, sheet: _Sheet) -> Image:
    """Draw the patches of the target that should be seen in those of the frame whose top-left pixels are `origin`."""
    level_from_raw = np.linalg.inv(expected.raw_from_level)
    scale = level_from_raw[2, :2] @ expected.predicted.mean(axis=0) + level_from_raw[2, 2]
    level_from_raw = level_from_raw / scale  # w about 1: single precision is enough below
    level_xy = expected.octave.level.from_full(expected.template_xy)
    mapped = expected.predicted @ level_from_raw[:, :2].T + level_from_raw[:, 2]
    at_origin = origin @ level_from_raw[:, :2].T + level_from_raw[:, 2]
    # (x - x0) w = (a - x0 w) for the patch's own centre x0: small numbers, and no error at the centre by the lens.
    centre = mapped[:, :2] / mapped[:, 2:]
    w = sheet.spread_out(at_origin[:, 2], level_from_raw[2, 0], level_from_raw[2, 1])
    maps = []
    for axis in (0, 1):
        numerator = sheet.spread_out(at_origin[:, axis], level_from_raw[axis, 0], level_from_raw[axis, 1])
        np.divide(numerator, w, out=numerator)
        maps.append(numerator)
    lens = level_xy - centre
    if np.abs(lens).max() > 1e-6:
        for axis in (0, 1):
            maps[axis] += sheet.spread_out(lens[:, axis], 0.0, 0.0)
    return cv2.remap(expected.octave.level.image, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
