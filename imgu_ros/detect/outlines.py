# SPDX-License-Identifier: Apache-2.0
"""Where references may be by their outlines: of plain, small, symmetric and repeating prints keypoints tell little."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from imgu_ros.detect.frame_context import FrameContext
from imgu_ros.pose.planar_pose import distorting_camera
from imgu_ros.reference.reference import Reference
from imgu_ros.types import Floats, Image, Matrix3, Points
from imgu_ros.vision.processing.quadrilaterals import find_quadrilaterals

#: Sides of the images that are compared, px: of all outlines, and of so many that then look most like a reference.
_COARSE_PX, _FINE_PX, _COMPARED = 20, 64, 60
#: Of many references only those are compared finely that something looks most like: bounds time.
_MOST_REFERENCES = 3
#: Longer side of the image in which outlines are sought, px: halved at least once.
_LONGEST_PX = 640
#: Correlation with the reference from which on an outline may be its own, and how many are tried of each reference, of
#: those that are apart by this share of their size. Measured: benchmarks/printed_targets.py.
_MIN_SIMILARITY, _MOST_TRIED, _APART = 0.35, 4, 0.04
#: Contrast below which an image shows nothing, grey values.
_PLAIN = 2.0
#: Grey values, as shares of all, that the image is stretched to: edges in the shade are seen then.
_DARK, _BRIGHT = 0.02, 0.98
#: Weights of red, green and blue in the brightness (ITU-R BT.601).
_WEIGHTS = np.array([[0.299, 0.587, 0.114]], np.float32)
#: Of the pixels of an image one of so many is looked at for that.
_STRIDE = 2


class OutlineSearch:
    """Finds where references may be by the quadrilaterals of a frame.

    Parameters
    ----------
    references : any
    """

    def __init__(self, references: Sequence[Reference]) -> None:
        self._references = {reference.name: reference for reference in references}
        self._known: dict[tuple[str, bool, int], Floats] = {}

    def places(self, context: FrameContext, wanted: Sequence[Reference]) -> Mapping[str, list[Matrix3]]:
        """Return where references may be, by name: H_image_template in ideal px, the likeliest first.

        Parameters
        ----------
        context : the frame
        wanted : of the references
        """
        image = context.image
        halvings = 1
        while max(image.shape) >> halvings > _LONGEST_PX:
            halvings += 1
        if halvings > image.most_halvings:
            return {}
        found = find_quadrilaterals(_channels(context.image.color(), halvings))
        if not len(found):
            return {}
        corners = (found + 0.5) * 2**halvings - 0.5
        linear, lens = image.is_linear, distorting_camera(context.frame.camera)
        seen = _seen(context, corners, _COARSE_PX)
        coarse = {each.name: (seen @ self._turned(each, linear, _COARSE_PX).T).max(axis=1) for each in wanted}
        places: dict[str, list[Matrix3]] = {}
        for reference in sorted(wanted, key=lambda each: -coarse[each.name].max())[:_MOST_REFERENCES]:
            likely = corners[np.argsort(-coarse[reference.name], kind="stable")[:_COMPARED]]
            similarity = _seen(context, likely, _FINE_PX) @ self._turned(reference, linear, _FINE_PX).T
            chosen = _best(similarity, likely)
            if lens is not None:
                ideal = [lens.ideal_pixels(each) for each in chosen]
                chosen = [xy for xy, valid in ideal if valid.all()]
            # Of a board the paper, with the white that its template has.
            width, height = reference.size
            right, bottom = width - 0.5, height - 0.5
            outline = np.array([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]], np.float32)
            places[reference.name] = [
                np.asarray(cv2.getPerspectiveTransform(outline, each.astype(np.float32)), np.float64) for each in chosen
            ]
        return places

    def _turned(self, reference: Reference, linear: bool, side: int) -> Floats:
        """Return how a reference looks from each of its corners on, (4, side^2)."""
        key = reference.name, linear, side
        if key not in self._known:
            octaves = reference.templates[linear]
            octave = min(octaves, key=lambda each: abs(math.log(min(each.level.image.shape) / (2 * side))))
            small = cv2.resize(octave.level.image, (side, side), interpolation=cv2.INTER_AREA)
            turned = np.stack([np.rot90(small, -k).ravel() for k in range(4)]).astype(np.float64)
            self._known[key] = _normalised(turned)
        return self._known[key]


def _seen(context: FrameContext, corners: Floats, side: int) -> Floats:
    """Return what a frame shows in quadrilaterals, (N, side^2), of mean 0 and norm 1; 0 where it is plain."""
    image = context.image
    grid = (np.arange(side) + 0.5) / side
    u, v = np.meshgrid(grid, grid)
    unit = np.stack((u.ravel(), v.ravel(), np.ones(u.size)))
    at = _from_unit_square(corners) @ unit
    at = at[:, :2] / at[:, 2:]
    sides = np.hypot(*np.moveaxis(np.roll(corners, -1, axis=1) - corners, -1, 0))
    steps = np.log2(np.maximum(np.sqrt(sides.max(axis=1) * sides.mean(axis=1)) / side, 1.0))
    levels = np.minimum(np.rint(steps).astype(int), image.most_halvings)
    seen = np.zeros((len(corners), side**2))
    for level in np.unique(levels):
        chosen = levels == level
        x, y = np.moveaxis(((at[chosen] + 0.5) / 2.0**level - 0.5).astype(np.float32), 1, 0)
        border = cv2.BORDER_REPLICATE
        seen[chosen] = cv2.remap(image.halved(int(level)), x, y, cv2.INTER_LINEAR, borderMode=border)
    return _normalised(seen)


def _best(similarity: Floats, corners: Floats) -> list[Points]:
    """Return the quadrilaterals that look most like a reference, (4, 2) px, from its top left corner on.

    Parameters
    ----------
    similarity : (N, 4) of each, by the corner that is its top left one
    corners : (N, 4, 2) px
    """
    chosen: list[Points] = []
    for place in np.argsort(-similarity, axis=None, kind="stable"):
        index, first = divmod(int(place), 4)
        if len(chosen) == _MOST_TRIED or similarity[index, first] < _MIN_SIMILARITY:
            break
        at = np.roll(corners[index], -first, axis=0)
        size = np.ptp(at, axis=0).max()
        if all(np.abs(at - other).max() > _APART * size for other in chosen):
            chosen.append(at)
    return chosen


def _normalised(rows: Floats) -> Floats:
    """Return images as rows of mean 0 and norm 1; 0 where they are plain."""
    centred = rows - rows.mean(axis=1, keepdims=True)
    norm = np.sqrt((centred * centred).sum(axis=1, keepdims=True))
    scaled: Floats = np.where(norm > _PLAIN * math.sqrt(rows.shape[1]), centred / np.maximum(norm, 1e-6), 0)
    return scaled


def _from_unit_square(corners: Floats) -> Floats:
    """Return the homographies of the unit square to quadrilaterals, (N, 3, 3) (Heckbert 1989, 2.2.3)."""
    a, b, c, d = np.moveaxis(corners, 1, 0)
    twist = a - b + c - d
    first, second = b - c, d - c
    determinant = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    g = (twist[:, 0] * second[:, 1] - twist[:, 1] * second[:, 0]) / determinant
    h = (first[:, 0] * twist[:, 1] - first[:, 1] * twist[:, 0]) / determinant
    H = np.empty((len(corners), 3, 3))
    H[:, :2, 0] = b - a + g[:, None] * b
    H[:, :2, 1] = d - a + h[:, None] * d
    H[:, :2, 2] = a
    H[:, 2] = np.stack((g, h, np.ones(len(corners))), axis=1)
    return H


def _channels(color: Image, halvings: int) -> list[Image]:
    """Return a colour image, halved, as brightness and, where there are colours, red and blue against green."""
    size = color.shape[1] >> halvings, color.shape[0] >> halvings
    whole = color[: size[1] << halvings, : size[0] << halvings]
    small = cv2.resize(whole, size, interpolation=cv2.INTER_AREA)
    red, green, blue = (_stretched(channel) for channel in cv2.split(small))
    brightness = np.asarray(cv2.transform(cv2.merge((red, green, blue)), _WEIGHTS))
    if np.array_equal(red, green) and np.array_equal(green, blue):
        return [brightness]
    opposed = [cv2.addWeighted(channel, 1.0, green, -1.0, 128.0) for channel in (red, blue)]
    return [brightness, *(np.asarray(each) for each in opposed)]


def _stretched(channel: Image) -> Image:
    """Return a channel with the whole range of values, brighter where it is dark."""
    low, high = np.quantile(channel[::_STRIDE, ::_STRIDE], (_DARK, _BRIGHT))
    scaled = np.clip((channel - np.float32(low)) / np.float32(max(high - low, 1.0)), 0, 1)
    return np.asarray(np.sqrt(scaled) * 255).astype(np.uint8)
