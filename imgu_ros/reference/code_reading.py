# SPDX-License-Identifier: Apache-2.0
"""What a frame shows in the cells of a marker, and whether that is its code.

A cell of a small marker is a px or two wide: its brightness is mixed with its neighbours'. So each is judged by whether
the frame would be explained better with the other colour there, at the blur that fits best:

    s = a B c + o,    c = 1 (white) or -1 (black),

with the brightness s of the cells, the blur B, gain a and offset o. Another colour of cell k changes the prediction by
2 a B_k, and the sum of squares is smaller with it when the residual has more than half of that.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from imgu_ros.image.frame_image import FrameImage
from imgu_ros.reference.contradictions import scatter_of
from imgu_ros.reference.marker_code import MARGIN, SAMPLED, MarkerCode, blurred_cells
from imgu_ros.types import Floats, Mask, Matrix3, Points
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.scale_space.pyramid import PixelScaling

#: Side of a cell, px of the level that is looked at.
_CELL_PX = 4.0
#: Cells in view without which nothing can be said.
_FEWEST = 12
#: A cell supports or contradicts a code when it is nearer to one colour than to the other by this, 1: as the one.
_CLEARLY = 0.2
#: Nearer to a cell without its colour than this, in cells, something covers what is compared.
_BESIDE = 1.5
#: Correlation of the cells with those of another marker of the family from which on it is that one.
_AS_ANOTHER = 0.95
#: Share of the cells of a marker of a board that have their colour where nothing covers it.
_READ = 0.85
#: Grey values by which the cells of a marker differ at least.
_LEAST_CONTRAST = 4.0
#: Log-likelihood ratio of a cell that looks just as one colour.
_MOST = 6.0


@dataclass(frozen=True, slots=True, eq=False)
class CodeReading:
    """What a frame shows in the cells of a marker.

    Attributes
    ----------
    share : share of the cells in view that have their colour, of all or of the inner ones, whichever is less
    count : number of cells that tell
    wrong : number of inner cells in view that look more like the other colour
    hidden : number of inner cells that are not in view
    is_other : whether the cells are those of another marker of the family
    scatter : how the cells without their colour lie among the others: 0 in one piece, about 1 at random
    log_ratio : (N, N) of each cell, positive where it has its colour; 0 outside the frame
    blur : standard deviation of the blur, cells
    cell_area : of a cell in the frame, raw px
    """

    share: float
    count: int
    wrong: int
    hidden: int
    is_other: bool
    scatter: float
    log_ratio: Floats
    blur: float
    cell_area: float


def read_code(frame: FrameImage, code: MarkerCode, H: Matrix3, camera: Camera | None) -> CodeReading | None:
    """Return what a frame shows in a marker's cells; None where too little of it is in view.

    Parameters
    ----------
    frame : the frame's image
    code : of the marker
    H : H_image_template in ideal px, the marker in front of the camera
    camera : intrinsics when the lens distorts; else None
    """
    side = code.side
    seen = _brightness(frame, code, H, camera)
    if seen is None:
        return None
    values, in_view, cell_area = seen
    if np.count_nonzero(in_view) < _FEWEST:
        return None
    weights = in_view.ravel().astype(np.float64)
    s = values.ravel()
    looks, pairs = code.expected
    s = s - float(weights @ s) / weights.sum()
    centred = looks - ((looks @ weights) / weights.sum())[:, None]
    power = (centred * centred) @ weights
    product = centred @ (weights * s)
    best = int(np.argmax(product / np.sqrt(np.maximum(power, 1e-9))))
    if not power[best] > 1e-6:
        return None
    gain = float(product[best] / power[best])
    inner = np.zeros((side, side), bool)
    inner[1:-1, 1:-1] = True
    hidden = int(np.count_nonzero(inner & ~in_view))
    blur = float(pairs[best].mean())
    if 2 * gain < _LEAST_CONTRAST:
        # Nothing is there, or another one whose colours are mostly the opposite.
        zero, is_other = np.zeros((side, side)), hidden == 0 and code.likeness_of_others(s) > _AS_ANOTHER
        return CodeReading(0.0, int(weights.sum()), side * side, hidden, is_other, 1.0, zero, blur, cell_area)
    residual = ((s - gain * centred[best]) * weights).reshape(side, side)
    columns, rows = (blurred_cells(side, sigma)[:, MARGIN:-MARGIN] for sigma in pairs[best])
    # By cell: how much the residual has of it, and the squares that it makes.
    has = rows.T @ residual @ columns
    squares = (rows * rows).T @ weights.reshape(side, side) @ (columns * columns)
    colour = np.where(code.cells, 1.0, -1.0)
    likeness = 1 + colour * has / np.maximum(gain * squares, 1e-9)
    supports, against = in_view & (likeness > _CLEARLY), in_view & (likeness < -_CLEARLY)
    telling = supports | against
    shares = [_share(supports & part, telling & part) for part in (telling, inner)]
    wrong = inner & in_view & (likeness < 0)
    read = (code.cells ^ wrong)[1:-1, 1:-1]
    count = int(np.count_nonzero(wrong))
    # Another one's cells are read where another one is; what covers a marker has none's.
    is_other = (
        count > code.distance // 2
        and hidden == 0
        and (code.nearest_other(read) <= code.distance // 4 or code.likeness_of_others(s) > _AS_ANOTHER)
    )
    ratio = np.where(in_view, np.clip(likeness, -1, 1) * _MOST, 0.0)
    return CodeReading(
        0.0 if is_other else min(shares),
        int(np.count_nonzero(telling)),
        count,
        hidden,
        is_other,
        scatter_of(against, in_view),
        ratio,
        blur,
        cell_area,
    )


def where_read(
    frame: FrameImage, codes: Sequence[MarkerCode], H: Matrix3, camera: Camera | None, template_xy: Points
) -> Mask:
    """Return which places are at markers whose codes are read, and not at cells without their colour, (N,).

    All where no code is read.

    Parameters
    ----------
    frame, H, camera : as for `read_code`
    codes : of a board
    template_xy : (N, 2) px
    """
    reads = [read_code(frame, code, H, camera) for code in codes]
    read = np.array([each is not None and each.share >= _READ for each in reads])
    if not read.any():
        return np.ones(len(template_xy), bool)
    corners = np.stack([code.corners for code in codes])
    centres, half = corners.mean(axis=1), np.ptp(corners, axis=1)[:, 0] / 2
    nearest = (np.abs(template_xy[:, None] - centres).max(axis=2) / half).argmin(axis=1)
    seen: Mask = read[nearest]
    for index in np.flatnonzero(read).tolist():
        found = reads[index]
        assert found is not None
        row, column = np.nonzero(found.log_ratio < 0)
        own = np.flatnonzero(nearest == index)
        if len(row) and len(own):
            back = np.linalg.inv(codes[index].template_from_cells)
            at = template_xy[own] @ back[:2, :2].T + back[:2, 2]
            away = np.abs(at[:, None] - np.column_stack((column + 0.5, row + 0.5))).max(axis=2).min(axis=1)
            seen[own] = away > _BESIDE
    return seen


def _share(supports: Mask, telling: Mask) -> float:
    return int(np.count_nonzero(supports)) / max(int(np.count_nonzero(telling)), 1)


def _brightness(
    frame: FrameImage, code: MarkerCode, H: Matrix3, camera: Camera | None
) -> tuple[Floats, Mask, float] | None:
    """Return the mean grey of each cell, (N, N), which are in view, and the area of one, raw px."""
    side = code.side
    H = H @ code.template_from_cells
    places = _places(side)
    x, y, w = H @ places
    if not w.min() > 0:
        return None
    centre = H[2] @ places.mean(axis=1)
    area = abs(cv2.determinant(H) / float(centre) ** 3)
    if not 0 < area < math.inf:
        return None
    at: Points = np.column_stack((x / w, y / w))
    if camera is not None:
        at = camera.raw_pixels(at)
    height, width = frame.shape
    inside = ((at >= 0) & (at <= (width - 1, height - 1))).all(axis=1).reshape(side, side, 9).all(axis=2)
    if not inside.any():
        return None
    halvings = min(max(int(math.log2(math.sqrt(area) / _CELL_PX)), 0) if area > 1 else 0, frame.most_halvings)
    picture = frame.halved(halvings)
    reduced = np.clip(PixelScaling(2.0**halvings).from_full_unchecked(at), -30000, 30000).astype(np.float32)
    seen = cv2.remap(
        picture,
        reduced[:, 0].reshape(side * side, 9),
        reduced[:, 1].reshape(side * side, 9),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return seen.mean(axis=1, dtype=np.float64).reshape(side, side), inside, area


@lru_cache(maxsize=64)
def _places(side: int) -> Floats:
    """Return nine samples of each cell, homogeneous, in cells, one a column."""
    steps = np.linspace(-SAMPLED / 2, SAMPLED / 2, 3)
    row, column, dy, dx = np.meshgrid(np.arange(side), np.arange(side), steps, steps, indexing="ij")
    x, y = ((each + 0.5 + step).ravel() for each, step in ((column, dx), (row, dy)))
    places = np.stack((x, y, np.ones(x.size)))
    places.flags.writeable = False
    return places
