# SPDX-License-Identifier: Apache-2.0
"""Cells of a target that a frame contradicts: whether they show something that covers the target, or another print.

A contradicting cell has two explanations. Another print of the same design shows there what the target itself shows
near by: its ground, its ink, text of other letters. Anything else (a hand, a thing that lies on it) has any brightness
and any contrast. The logarithm of the ratio of their likelihoods is summed over the cells, except those of an occluder:
pieces of connected cells with an interior, plain or of a tone that the target has not, and the cells along their edge.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from imgu_ros.reference.frame_samples import SeenCells
from imgu_ros.reference.template_cells import CELL
from imgu_ros.types import Floats, Image, Indices, Mask

#: The four cells beside one.
_BESIDE = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], np.uint8)
#: The cells about one.
_ABOUT = np.ones((3, 3), np.uint8)
#: Brighter parts of a frame are saturated: they say nothing.
SATURATED = 248.0
#: Squared correlation from which on a cell, with half a cell about it, has the lines of the target: displaced by so
#: many samples (a rolling shutter, a bent print), or at another contrast (colours that are lighter or darker in grey
#: than its picture says). Measured: benchmarks/thresholds.py, study contradictions.
_SAME_LINES, _DISPLACED = 0.7, 2
#: Cells to each side that show what another print of the design may show. Measured: benchmarks/thresholds.py, study
#: contradictions.
_NEAR = 3
#: Their brightness is met within this share, and so many grey values at least. Measured: benchmarks/thresholds.py,
#: study contradictions.
_SAME_TONE, _SAME_GREY = 0.08, 5.0
#: The logarithm of their variance is met within this, and what is added to a variance, grey values squared. Measured:
#: benchmarks/thresholds.py, study contradictions.
_SAME_CONTRAST, _LEAST_VARIANCE = 0.6, 25.0
#: Anything: the logarithm of its variance, and the deviation of that; its brightness has the variance of the frame's
#: cells and this, grey values squared.
_ANY_CONTRAST, _ANY_CONTRAST_DEVIATION, _ANY_GREY = 5.0, 2.0, 400.0
#: Most that one cell, or one plain piece, can say (log-likelihood ratio). Measured: benchmarks/thresholds.py, study
#: contradictions.
_MOST = 3.0
#: Log-likelihood ratio below which a cell has a tone that the target has not. Measured: benchmarks/thresholds.py, study
#: contradictions.
_ODD = -1.0
#: Variance below which a cell is plain, grey values squared, and the same as a share of the target's there. Measured:
#: benchmarks/thresholds.py, study contradictions.
_PLAIN, _PLAIN_SHARE = 20.0, 0.1
#: What a cell at the rim of the target counts.
_AT_RIM = 0.5
#: Cells that a plain piece has at least if it is the interior of an occluder, and such cells of an occluder. Measured:
#: benchmarks/thresholds.py, study contradictions.
_INTERIOR, _OCCLUDING = 4, 4


def print_log_ratio(cells: SeenCells, against: Mask) -> float:
    """Return the logarithm of the likelihood ratio of another print of the same design over an occluder.

    Parameters
    ----------
    cells : those that are compared
    against : (rows, columns) which of them contradict
    """
    known = cells.known.variance[cells.where]
    against = against & cells.in_view
    ratio = _log_ratios(cells, against)
    is_plain = against & (cells.variance < np.maximum(_PLAIN, _PLAIN_SHARE * cells.gain**2 * known))
    piece = _pieces(cv2.dilate(is_plain.astype(np.uint8), _ABOUT))
    sizes = np.bincount(piece[is_plain], minlength=int(piece.max()) + 1)
    is_solid = (against & (ratio < _ODD)) | (is_plain & (sizes >= _INTERIOR)[piece])
    region = _pieces(against.astype(np.uint8))
    covered = against & (np.bincount(region[is_solid], minlength=int(region.max()) + 1) >= _OCCLUDING)[region]
    beside = cv2.dilate(covered.astype(np.uint8), _ABOUT) > 0
    telling = against & (ratio > 0) & ~beside
    telling[telling] = ~_have_same_lines(cells, *np.nonzero(telling))
    ratio *= _weights(cells)
    total = float(ratio[telling & ~is_plain].sum())
    # A plain piece has one tone: its cells say the same.
    plain = telling & is_plain
    return total + float(np.minimum(np.bincount(piece[plain], weights=ratio[plain]), _MOST).sum())


def _weights(cells: SeenCells) -> Floats:
    """Return what cells count, (rows, columns): less at the rim, where a bent print or a lens displaces lines."""
    rows, columns = cells.known.variance.shape
    weights: Floats = np.ones((rows, columns), np.float32)
    weights[[0, -1]] = weights[:, [0, -1]] = _AT_RIM
    return weights[cells.where]


def _pieces(cells: Image) -> Indices:
    """Return the number of the connected piece that each cell belongs to, (rows, columns); 0 for those that are 0."""
    pieces: Indices = cv2.connectedComponents(cells, connectivity=8)[1].astype(np.intp)
    return pieces


def _log_ratios(cells: SeenCells, wanted: Mask) -> Floats:
    """Return the log-likelihood ratios of some cells, (rows, columns); 0 elsewhere."""
    known, side = cells.known, 2 * _NEAR + 1
    tones = np.pad(cells.gain * known.mean + cells.offset, _NEAR, constant_values=np.nan)
    contrasts = np.pad(np.log(cells.gain**2 * known.variance + _LEAST_VARIANCE), _NEAR)
    rows, columns = np.nonzero(wanted)
    at = rows + cells.where[0].start, columns + cells.where[1].start
    near_tone, near_contrast = (
        np.lib.stride_tricks.sliding_window_view(each, (side, side))[at].reshape(-1, side * side)
        for each in (tones, contrasts)
    )
    mean, contrast = cells.mean[rows, columns], np.log(cells.variance[rows, columns] + _LEAST_VARIANCE)
    tolerance = np.maximum(_SAME_TONE * np.abs(near_tone), _SAME_GREY)
    away = ((mean[:, None] - near_tone) / tolerance) ** 2
    away += ((contrast[:, None] - near_contrast) / _SAME_CONTRAST) ** 2
    likely = np.nanmean(np.exp(-away / 2) / (tolerance * _SAME_CONTRAST), axis=1)
    usual, deviation = (float(each[0, 0]) for each in cv2.meanStdDev(cells.mean))
    spread = math.sqrt(max(deviation, 1.0) ** 2 + _ANY_GREY)
    away = ((mean - usual) / spread) ** 2 + ((contrast - _ANY_CONTRAST) / _ANY_CONTRAST_DEVIATION) ** 2
    anything = -away / 2 - math.log(spread * _ANY_CONTRAST_DEVIATION)
    ratio: Floats = np.zeros(wanted.shape, np.float32)
    ratio[rows, columns] = np.clip(np.log(likely + 1e-12) - anything, -_MOST, _MOST)
    return ratio


def _have_same_lines(cells: SeenCells, rows: Indices, columns: Indices) -> Mask:
    """Return of some cells whether the target has their lines there, or beside it, at any contrast, (N,)."""
    side, half = 2 * CELL, CELL // 2
    seen = np.pad(cells.image, half, mode="edge")
    blocks = np.lib.stride_tricks.sliding_window_view(seen, (side, side))[CELL * rows, CELL * columns]
    known = np.pad(cells.known.image, half + _DISPLACED, mode="edge")
    reach = side + 2 * _DISPLACED
    at = CELL * (rows + cells.where[0].start), CELL * (columns + cells.where[1].start)
    about = np.lib.stride_tricks.sliding_window_view(known, (reach, reach))[at]
    moved = np.lib.stride_tricks.sliding_window_view(about, (side, side), axis=(1, 2))
    blocks = blocks - blocks.mean(axis=(1, 2), keepdims=True)
    power = (blocks * blocks).sum(axis=(1, 2))[:, None, None]
    # The blocks have no mean: that of the target's drops out.
    covariance = np.einsum("nij,nyxij->nyx", blocks, moved)
    count = side * side
    variance = (moved * moved).sum(axis=(3, 4)) - moved.sum(axis=(3, 4)) ** 2 / count
    alike = (covariance > 0) & (covariance * covariance > _SAME_LINES * power * np.maximum(variance, count))
    same: Mask = alike.any(axis=(1, 2))
    return same


def supported_together(supporting: Mask, telling: Mask) -> Mask:
    """Return which supporting cells have as many supporting as other cells beside them: few are so by chance."""
    beside_supporting, beside = (
        cv2.filter2D(cells.astype(np.uint8), -1, _BESIDE, borderType=cv2.BORDER_CONSTANT)
        for cells in (supporting, telling)
    )
    together: Mask = supporting & (2 * beside_supporting >= beside)
    return together


def scatter_of(against: Mask, in_view: Mask) -> float:
    """Return the share of neighbours that differ, over that of cells without order."""
    beside = in_view[1:] & in_view[:-1], in_view[:, 1:] & in_view[:, :-1]
    pairs = np.count_nonzero(beside[0]) + np.count_nonzero(beside[1])
    differ = np.count_nonzero(beside[0] & (against[1:] ^ against[:-1]))
    differ += np.count_nonzero(beside[1] & (against[:, 1:] ^ against[:, :-1]))
    share = int(np.count_nonzero(against & in_view)) / max(int(np.count_nonzero(in_view)), 1)
    by_chance = 2 * share * (1 - share) * pairs
    return float(differ / by_chance) if by_chance > 0 else 0.0
