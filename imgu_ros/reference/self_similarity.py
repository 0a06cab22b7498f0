# SPDX-License-Identifier: Apache-2.0
"""Where a target looks like itself: turned, or shifted by a period. There it can be found at a wrong place."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from imgu_ros.reference.template_cells import CELL, cell_means
from imgu_ros.reference.templates import TemplateOctave
from imgu_ros.types import Image, Matrix3

#: Longer side of the image that is compared with itself, px: every turn and shift is tried.
_SIDE_PX = 48
#: Angle between two turns that are tried, degrees: less than two px of that image at its rim.
_STEP_DEG = 4.0
#: Smallest turn that counts as another place, degrees.
_LEAST_TURN_DEG = 16.0
#: Smallest shift that counts as another place, as a share of the longer side.
_LEAST_SHIFT = 0.06
#: Smallest correlation of a copy with the target: below it hardly a third of the target's cells are alike.
_MIN_SIMILARITY = 0.4
#: Most copies that are kept, most that are looked at, and most shifts among them.
_MOST, _MOST_LOOKED_AT, _MOST_SHIFTS = 8, 16, 8
#: Share of the textured cells that differ from which on no frame confirms a copy.
_MOST_DIFFERING = 0.6
#: Longer side of the image in which a copy's motion is refined, px, the steps of it, and how far its corners may go, as
#: a share of that side: two px of the image before.
_REFINED_SIDE_PX, _STEPS, _MOST_REFINED = 192, 30, 0.06
#: A turn about the target's centre: a part of a whole one within this angle, degrees, its centre within this share of
#: the longer side. Such a copy, of at least this similarity, may be a symmetry of the drawing.
_SNAP_DEG, _SNAP_SHARE, _SYMMETRIC = 0.5, 0.01, 0.7
#: Largest difference of a cell of the target from that of a symmetry, as a share of the target's contrast, when both
#: are smoothed by so many px of the finer image: edges that are drawn half a px elsewhere differ by less, a mark that
#: breaks the symmetry by more.
_SYMMETRY_RESIDUAL, _SMOOTHED_PX = 0.35, 1.2
#: The contrast of a part is that of so many px of the first image about it (standard deviation of a Gaussian); this
#: share of the whole one's variance counts as none.
_SURROUNDINGS_PX, _FAINT = 6.0, 0.05
#: Of fine patterns: the correlation with itself a period away, by how much it is less between, and how many periods.
_MIN_PERIODIC, _VALLEY, _MOST_FINE = 0.5, 0.3, 4
#: Variance of a cell with enough contrast to tell.
_TEXTURED = 36.0
#: Correlation of cells that are alike.
_ALIKE = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class Copy:
    """A motion of a target in its plane under which it looks much like itself.

    Attributes
    ----------
    H : (3, 3) template px: the target looks at x much as it does at H x
    turn_deg : angle of the turn, 0 to 360
    shift_px : motion of the target's centre, template px
    similarity : correlation of the target with its copy, up to 1
    differing_share : share of the target's cells with texture that differ, 0 to 1
    is_symmetry : nothing differs: no frame can tell which it shows
    """

    H: Matrix3
    turn_deg: float
    shift_px: float
    similarity: float
    differing_share: float
    is_symmetry: bool = False


def copies_of(octaves: Sequence[TemplateOctave]) -> tuple[Copy, ...]:
    """Return where a target looks like itself, the most alike first.

    Parameters
    ----------
    octaves : of its template, from fine to coarse
    """
    octave = min(octaves, key=lambda each: abs(math.log(max(each.level.image.shape) / _SIDE_PX)))
    image = octave.level.image.astype(np.float32)
    height, width = image.shape
    side = max(height, width)
    # A plain ground about it has room for shifts by half the longer side.
    even, room = _even(image), side // 2
    ground = float(np.median(even))
    canvas = cv2.copyMakeBorder(even, room, room, room, room, cv2.BORDER_CONSTANT, value=ground)
    found: list[tuple[float, float, Matrix3]] = []
    reach = max(2, round(_LEAST_SHIFT * side))
    for turn in np.arange(0.0, 360.0, _STEP_DEG).tolist():
        if 0 < min(turn, 360 - turn) < _LEAST_TURN_DEG:
            continue
        M = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), turn, 1.0)
        turned = cv2.warpAffine(even, M, (width, height), borderMode=cv2.BORDER_CONSTANT, borderValue=ground)
        similarity = cv2.matchTemplate(canvas, turned, cv2.TM_CCOEFF_NORMED)
        if turn == 0:
            _clear(similarity, room, room, reach)
        for _ in range(1 if turn else _MOST_SHIFTS):
            _, best, _, (column, row) = cv2.minMaxLoc(similarity)
            if not _MIN_SIMILARITY <= best <= 1.001:
                break
            _clear(similarity, column, row, reach)
            shift = np.array([[1, 0, column - room], [0, 1, row - room], [0, 0, 1.0]])
            found.append((best, turn, shift @ np.vstack((M, (0.0, 0.0, 1.0)))))
    found.sort(key=lambda each: -each[0])
    kept: list[tuple[float, float, Matrix3]] = []
    for each in found:
        # Neighbouring turns are one copy.
        if len(kept) < _MOST_LOOKED_AT and all(_apart(each, other) for other in kept):
            kept.append(each)
    copies = [_copy(octave, image, *each) for each in kept] + _fine_periods(_fine(octaves))
    copies = [_refined(octaves, each) for each in copies if each.differing_share <= _MOST_DIFFERING]
    size = octaves[0].level.image.shape[1] * octaves[0].scale, octaves[0].level.image.shape[0] * octaves[0].scale
    copies = [_symmetry(octaves, each, *size) for each in copies]
    return tuple(sorted(copies, key=lambda each: each.differing_share)[:_MOST])


def _fine_periods(octave: TemplateOctave) -> list[Copy]:
    """Return the shifts that are too small for the first image: those of screens, weaves and fine patterns."""
    image = octave.level.image.astype(np.float32)
    even, reach = _even(image), math.ceil(_LEAST_SHIFT * max(image.shape)) + 1
    ground = float(np.median(even))
    canvas = cv2.copyMakeBorder(even, reach, reach, reach, reach, cv2.BORDER_CONSTANT, value=ground)
    similarity = cv2.matchTemplate(canvas, even, cv2.TM_CCOEFF_NORMED)
    is_peak = similarity == cv2.dilate(similarity, np.ones((3, 3), np.uint8))
    # Each shift is one back as well.
    is_peak[reach:, : reach + 1] = is_peak[:reach, :reach] = False
    found = []
    for row, column in np.argwhere(is_peak & (similarity >= _MIN_PERIODIC)).tolist():
        steps = np.linspace(0, 1, 2 * reach)
        between = similarity[
            np.rint(reach + steps * (row - reach)).astype(int), np.rint(reach + steps * (column - reach)).astype(int)
        ]
        if similarity[row, column] - between.min() >= _VALLEY:
            found.append((float(similarity[row, column]), row - reach, column - reach))
    # The shortest: others are these, several times.
    found.sort(key=lambda each: each[1] ** 2 + each[2] ** 2)
    return [
        _copy(octave, image, best, 0.0, np.array([[1, 0, x], [0, 1, y], [0, 0, 1.0]]))
        for best, y, x in found[:_MOST_FINE]
    ]


def _even(image: Image) -> Image:
    """Return an image whose every part has about the same contrast: a mark must not outweigh all else."""
    mean = cv2.GaussianBlur(image, (0, 0), _SURROUNDINGS_PX)
    variance = cv2.GaussianBlur(image * image, (0, 0), _SURROUNDINGS_PX) - mean * mean
    even: Image = (image - mean) / np.sqrt(np.maximum(variance, 0) + _FAINT * image.var() + 1e-6)
    return even


def _refined(octaves: Sequence[TemplateOctave], copy: Copy) -> Copy:
    """Return a copy whose motion is aligned in a finer image, so that a frame need not be aligned with it."""
    octave = _fine(octaves)
    image = octave.level.image
    S = octave.scaling.reduced_from_full @ copy.H @ octave.scaling.full_from_reduced
    # The target looks at x as at S x.
    start = np.ascontiguousarray(S[:2], np.float32)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, _STEPS, 1e-4)
    try:
        similarity, found = cv2.findTransformECC(image, image, start, cv2.MOTION_EUCLIDEAN, criteria)
    except cv2.error:
        return copy
    found = np.vstack((found, (0.0, 0.0, 1.0))).astype(np.float64)
    corners = np.array([[0, image.shape[1], 0], [0, 0, image.shape[0]], [1, 1, 1.0]])
    away = np.abs(((found - S) @ corners)[:2]).max() / max(image.shape)
    if similarity < copy.similarity or not away <= _MOST_REFINED:
        return copy
    return replace(copy, H=octave.scaling.full_from_reduced @ found @ octave.scaling.reduced_from_full)


def _symmetry(octaves: Sequence[TemplateOctave], copy: Copy, width: float, height: float) -> Copy:
    """Return a copy by a turn about the centre as exactly that, where it is a symmetry of a target of that size, px."""
    if copy.similarity < _SYMMETRIC or not copy.turn_deg:
        return copy
    turn = math.degrees(math.atan2(copy.H[0, 1], copy.H[0, 0])) % 360
    orders = [round(k * 360 / turn) for k in range(1, 12) if abs(round(k * 360 / turn) * turn - k * 360) < _SNAP_DEG]
    centre = np.array(((width - 1) / 2, (height - 1) / 2, 1.0))
    away = np.hypot(*(copy.H @ centre - centre)[:2])
    if not orders or away > _SNAP_SHARE * max(width, height):
        return copy
    order = orders[0]
    exact = round(turn * order / 360) * 360 / order
    M = cv2.getRotationMatrix2D(tuple(centre[:2]), exact, 1.0)
    H = np.vstack((M, (0.0, 0.0, 1.0)))
    octave = _fine(octaves)
    image = np.asarray(cv2.GaussianBlur(octave.level.image.astype(np.float32), (0, 0), _SMOOTHED_PX))
    S = octave.scaling.reduced_from_full @ H @ octave.scaling.full_from_reduced
    size = image.shape[1], image.shape[0]
    # Beyond its border it goes on as most of the border does.
    ground = float(np.median(np.concatenate((image[0], image[-1], image[:, 0], image[:, -1]))))
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    moved = cv2.warpPerspective(image, S, size, flags=flags, borderMode=cv2.BORDER_CONSTANT, borderValue=ground)
    rows, columns = (side // CELL * CELL for side in image.shape)
    away = cell_means((moved - image)[:rows, :columns] ** 2)
    if math.sqrt(float(away.max())) > _SYMMETRY_RESIDUAL * float(image.std()):
        return copy
    return Copy(H, exact, 0.0, copy.similarity, 0.0, is_symmetry=True)


def _fine(octaves: Sequence[TemplateOctave]) -> TemplateOctave:
    """Return the octave in which motions are known to a part of a pixel."""
    return min(octaves, key=lambda each: abs(math.log(max(each.level.image.shape) / _REFINED_SIDE_PX)))


def _apart(one: tuple[float, float, Matrix3], other: tuple[float, float, Matrix3]) -> bool:
    turn = abs(one[1] - other[1])
    return min(turn, 360 - turn) >= _LEAST_TURN_DEG or one[1] == other[1]


def _clear(similarity: Image, column: int, row: int, reach: int) -> None:
    similarity[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1] = -1


def _copy(octave: TemplateOctave, image: Image, similarity: float, turn: float, S: Matrix3) -> Copy:
    height, width = (side // CELL * CELL for side in image.shape)
    moved = cv2.warpPerspective(
        image, S, (image.shape[1], image.shape[0]), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderValue=0
    )
    a, b = (np.ascontiguousarray(each[:height, :width]) for each in (image, np.asarray(moved, np.float32)))
    mean_a, mean_b = cell_means(a), cell_means(b)
    power_a, power_b = cell_means(a * a) - mean_a * mean_a, cell_means(b * b) - mean_b * mean_b
    covariance = cell_means(a * b) - mean_a * mean_b
    textured = power_a >= _TEXTURED
    alike = textured & (covariance > 0) & (covariance * covariance >= _ALIKE**2 * power_a * power_b)
    differing = 1 - int(np.count_nonzero(alike)) / max(int(np.count_nonzero(textured)), 1)
    H = octave.scaling.full_from_reduced @ S @ octave.scaling.reduced_from_full
    centre = np.array(((image.shape[1] - 1) / 2, (image.shape[0] - 1) / 2, 1.0))
    shift = float(np.hypot(*(S @ centre - centre)[:2])) * octave.scale
    return Copy(H, turn, shift, similarity, differing)
