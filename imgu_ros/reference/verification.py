# SPDX-License-Identifier: Apache-2.0
"""Whether a frame shows a target where an estimate says it is: every pose is verified so before it goes out.

Keypoints or patches that agree say that some part of a target is there; a part may also belong to another picture
that shares it (a logo, a header), to another place of a target that repeats itself, or agree by chance. So the whole
visible face is compared with the frame, cell by cell. For each cell there are two explanations: the target, at the
contrast and brightness that most cells agree on, with errors of registration where it has gradients; or something
else, with the variance that the frame has there. The logarithm of the ratio of their likelihoods says whether the cell
supports the pose, contradicts it, or says nothing: a flat cell of the target supports none, and contradicts a pose
where the frame has texture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from imgu_ros.errors import NotConfirmed
from imgu_ros.image.frame_image import FrameImage
from imgu_ros.reference.code_reading import read_code
from imgu_ros.reference.contradictions import (
    SATURATED,
    print_log_ratio,
    scatter_of,
    supported_together,
)
from imgu_ros.reference.frame_samples import FrameSamples, PartInView, SeenCells, frame_samples, octave_of, part_in_view
from imgu_ros.reference.marker_code import MarkerCode
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.template_cells import CELL, CellMoments, cell_means
from imgu_ros.reference.templates import TemplateOctave
from imgu_ros.types import Floats, Matrix3
from imgu_ros.vision.camera.intrinsics import Camera

#: Share of the textured cells in view that must support a pose. Between the shares of targets that are 60 % hidden and
#: those of an image that has the upper 30 % of the target and nothing else of it. Measured: benchmarks/thresholds.py,
#: study confirmation.
NEEDED = 0.305
#: Share of the cells with texture that must support it: flat cells agree with flat ones at wrong places, too. Measured:
#: benchmarks/thresholds.py, study confirmation.
_NEEDED_OF_TEXTURE = 0.19
#: Share from which on a pose is confirmed wherever its contradicting cells are. Measured: benchmarks/thresholds.py,
#: study confirmation.
_SURE = 0.8
#: The same for the next coarser octave, where a frame is blurred. Measured: benchmarks/thresholds.py, study
#: confirmation.
_SURE_WHEN_BLURRED = 0.9
#: Share from which on nothing else is looked at, when at most so many cells contradict: others are looked at closely.
#: Measured: benchmarks/thresholds.py, study contradictions.
_CLEAR, _FEW_AGAINST = 0.95, 1
#: Standard deviations of the blurs with which a template is compared, samples: a sharp frame, and blurred ones.
#: Measured: benchmarks/thresholds.py, study confirmation.
_BLURS = (0.0, 0.8, 1.6, 3.2)
#: The same in a closer look, whose samples are smoothed. Measured: benchmarks/thresholds.py, study contradictions.
_CLOSE_BLURS = (0.4, 0.8, 1.6, 3.2)
#: Blur from which on a frame is blurred, samples.
_BLURRED = 1.6
#: Largest scatter of contradicting cells below that: an occluder covers connected cells (0), those of a wrong pose lie
#: everywhere (1). Measured: benchmarks/thresholds.py, study confirmation.
_SCATTERED = 0.5
#: The same where less than a share looks as it should: of another label of like layout two fifths do, here and there.
#: Measured: benchmarks/negatives.py.
_SCATTERED_MOSTLY, _MOSTLY = 0.4, 0.6
#: Log-likelihood ratio of another print of the same design over an occluder from which on no pose goes out: that of
#: two cells. Measured: benchmarks/thresholds.py, study contradictions.
_ANOTHER_PRINT = 6.0
#: Share of what is in view that looks as it should from which on it is no other print: a camera's curve that is not
#: known yet changes the brightness of a few cells.
_WHOLE = 0.985
#: Textured cells in view without which nothing can be said.
_FEWEST = 12
#: Noise of a sample, grey values. Measured: benchmarks/thresholds.py, study confirmation.
_NOISE = 3.0
#: Error of registration, samples. Measured: benchmarks/thresholds.py, study confirmation.
_MISPLACED = 0.35
#: Independent samples in a cell: neighbours are alike. Measured: benchmarks/thresholds.py, study confirmation.
_INDEPENDENT = 5.0
#: A cell's contrast may differ by this factor from that of most (shading, highlights). Measured:
#: benchmarks/thresholds.py, study confirmation.
_CONTRAST = 1.5
#: Its brightness may differ by this share. Measured: benchmarks/thresholds.py, study confirmation.
_SHADING = 0.12
#: Weight of the evidence of a cell's brightness: that of its neighbours is hardly another.
_BRIGHTNESS_WEIGHT = 0.2
#: Most that one cell can say (log-likelihood ratio). Measured: benchmarks/thresholds.py, study confirmation.
_MOST = 6.0
#: Most that one cell says for a blur, in a closer look. Measured: benchmarks/thresholds.py, study contradictions.
_MOST_FOR_BLUR = 2.0
#: The least that counts as support or contradiction. Measured: benchmarks/thresholds.py, study confirmation.
_LEAST = 1.5
#: Correlation of a textured cell from which on its contrast counts. Measured: benchmarks/thresholds.py, study
#: confirmation.
_ALIKE = 0.6
#: Cells of such a correlation that the contrast is taken from, at least.
_FEWEST_ALIKE = 3
#: Variance of the brightness of anything, grey values squared, beside that of the frame's cells.
_ANYTHING = 400.0
#: Difference of two log-likelihood ratios from which on one is better: that of two cells.
_DECIDED = 12.0
#: The same, as a share of the larger: errors of two alignments differ.
_DECIDED_SHARE = 0.03


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What a frame says of a pose.

    Attributes
    ----------
    share : share of what is in view that looks as it should, 0 to 1: of the cells that support or contradict the pose,
        or of the area about such cells, whichever is larger
    textured_share : the same of the cells with texture alone
    telling : number of the cells that support or contradict
    scatter : how the contradicting cells lie among the others: 0 in one piece, about 1 at random
    log_ratio : (rows, columns) of each cell of the octave, the logarithm of the likelihood ratio; 0 outside the frame
    blur : standard deviation of the blur at which the template fits best, samples
    cell_area : of a cell in the frame, raw px
    print_log_ratio : how much likelier the contradicting cells show another print of the same design than something
        that covers the target, the logarithm of the ratio
    is_clear : nothing contradicts
    """

    share: float
    textured_share: float
    telling: int
    scatter: float
    log_ratio: Floats
    blur: float
    cell_area: float
    print_log_ratio: float = 0.0
    is_clear: bool = False

    @property
    def weight(self) -> float:
        """What all cells say together, of the area in the frame: comparable between targets."""
        return float(self.log_ratio.sum()) * self.cell_area

    @property
    def is_confirming(self) -> bool:
        """Whether the pose may go out."""
        if self.is_another_print:
            return False
        if not self.is_covered:
            return True
        scattered = _SCATTERED if self.share >= _MOSTLY else _SCATTERED_MOSTLY
        return self.share >= NEEDED and self.textured_share >= _NEEDED_OF_TEXTURE and self.scatter <= scattered

    @property
    def is_another_print(self) -> bool:
        """Whether what does not look as it should is print, as of another one of the same design."""
        return self.print_log_ratio >= _ANOTHER_PRINT

    @property
    def is_covered(self) -> bool:
        """Whether much of what is in view does not look as it should."""
        return self.share < _SURE


def better_of(first: Evidence | None, second: Evidence | None) -> int | None:
    """Return 0 or 1, the one of two explanations of a frame that fits better; None where neither does clearly.

    Both are of close looks.
    """
    if first is None or second is None:
        return None if first is second else int(first is None)
    cell = max(first.cell_area, second.cell_area)
    most = max(abs(first.weight), abs(second.weight))
    difference = second.weight - first.weight
    if abs(difference) < max(_DECIDED * cell, _DECIDED_SHARE * most):
        return None
    return int(difference > 0)


def require_confirmed(frame: FrameImage, target: Reference, H: Matrix3, camera: Camera | None) -> Evidence:
    """Return what a frame says of a pose.

    Parameters
    ----------
    frame : the frame's image
    target : the target
    H : H_image_template in ideal px, the target in front of the camera
    camera : intrinsics when the lens distorts; else None

    Raises
    ------
    NotConfirmed
        If the frame does not show the target there.
    """
    return require_confirming(evidence(frame, target, H, camera))


def require_confirming(found: Evidence | None) -> Evidence:
    """Return what a frame says of a pose; raise `NotConfirmed` when it does not show the target there."""
    if found is None:
        raise NotConfirmed("too little of it is in view to compare", 0.0)
    if not found.is_confirming:
        if found.share < NEEDED:
            raise NotConfirmed(
                f"{found.share:.0%} of what is in view looks as it should, {NEEDED:.1%} needed", found.share
            )
        rest = "is another print" if found.is_another_print else "differs here and there"
        raise NotConfirmed(f"{found.share:.0%} of what is in view looks as it should, the rest {rest}", found.share)
    return found


def confirmed_share(frame: FrameImage, target: Reference, H: Matrix3, camera: Camera | None) -> float:
    """Return the share of a target in view that looks as it should, 0 to 1; 0 where too little is in view.

    Parameters
    ----------
    frame, target, H, camera : as for `require_confirmed`
    """
    found = evidence(frame, target, H, camera)
    return 0.0 if found is None else found.share


def evidence(
    frame: FrameImage, target: Reference, H: Matrix3, camera: Camera | None, is_close: bool = False
) -> Evidence | None:
    """Return what a frame says of a pose; None where too little of the target is in view.

    Parameters
    ----------
    frame, target, H, camera : as for `require_confirmed`
    is_close : look closely in any case, as what is compared with another explanation needs; else where a first look
        finds contradictions
    """
    if target.codes:
        return _evidence_of_codes(frame, target.codes, H, camera)
    part = part_in_view(frame, target, H, camera)
    if part is None:
        return None
    look = _Look(frame, target.templates[frame.is_linear], H, camera, part)
    if not is_close:
        found = _compared(look, octave_of(look.octaves, target.size, part, is_close=False), is_close=False)
        if found is not None and found.is_clear:
            return found
    index = octave_of(look.octaves, target.size, part, is_close=True)
    found = _compared(look, index, is_close=True)
    is_blurred = found is not None and found.blur >= _BLURRED and NEEDED <= found.share < _SURE
    if is_blurred and index + 1 < len(look.octaves):
        # Blur in one direction leaves more to compare in a coarser octave.
        coarser = _compared(look, index + 1, is_close=True)
        if coarser is not None and coarser.share >= _SURE_WHEN_BLURRED:
            return coarser
    return found


def _evidence_of_codes(
    frame: FrameImage, codes: Sequence[MarkerCode], H: Matrix3, camera: Camera | None
) -> Evidence | None:
    """Return what a frame says by the codes in view, of which some may be covered; None where too little is in view."""
    reads = [read for code in codes if (read := read_code(frame, code, H, camera)) is not None]
    if not reads:
        return None
    count = sum(read.count for read in reads)
    share = sum(read.share * read.count for read in reads) / max(count, 1)
    if any(read.is_other for read in reads):
        share = 0.0
    # One code that is read tells that what contradicts lies before others.
    scatter = min(read.scatter for read in reads)
    ratios = np.concatenate([read.log_ratio.ravel() for read in reads])
    area = sum(read.cell_area for read in reads) / len(reads)
    return Evidence(share, share, count, scatter, ratios, min(read.blur for read in reads), area)


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """What is compared with what: see `evidence`."""

    frame: FrameImage
    octaves: Sequence[TemplateOctave]
    H: Matrix3
    camera: Camera | None
    part: PartInView


def _compared(look: _Look, index: int, is_close: bool) -> Evidence | None:
    """Return what a frame says of a pose, by an octave; None where too little is in view."""
    samples = frame_samples(look.frame, look.octaves[index], look.H, look.camera, look.part, is_close)
    if samples is None or np.count_nonzero(samples.in_view) < _FEWEST:
        return None
    seen, cells, (rows, columns) = samples.image, samples.cells, samples.where
    block = np.s_[CELL * rows.start : CELL * rows.stop, CELL * columns.start : CELL * columns.stop]
    mean = cell_means(seen)
    variance = np.maximum(cell_means(seen * seen) - mean * mean, 0)
    found: Evidence | None = None
    chosen: SeenCells | None = None
    best = -math.inf
    for tried, blur in enumerate(_CLOSE_BLURS if is_close else _BLURS):
        known = cells.blurred(blur)
        covariance = cell_means(seen * known.image[block]) - mean * known.mean[samples.where]
        light = _light(known, samples, mean, variance, covariance)
        if light is None:
            continue
        compared = SeenCells(seen, mean, variance, covariance, samples.in_view, known, samples.where, *light)
        judged = _judged(compared)
        # Few cells that fit very well do not outweigh those that contradict.
        total = float((np.minimum(judged, _MOST_FOR_BLUR) if is_close else judged).sum())
        if total > best:
            best = total
            found, chosen = _summed(judged, samples, known, blur), compared
        if found is not None and found.share >= _SURE and (tried or not is_close):
            break
    if found is None or chosen is None:
        telling = int(np.count_nonzero(cells.blurred(0.0).is_textured[samples.where] & samples.in_view))
        if telling < _FEWEST:
            return None
        nothing = np.zeros((cells.rows, cells.columns), np.float32)
        return Evidence(0.0, 0.0, telling, 1.0, nothing, 0.0, samples.cell_area)
    if found.telling < _FEWEST:
        return None
    if is_close and NEEDED <= found.share < _WHOLE and not found.is_clear:
        against = found.log_ratio[samples.where] < -_LEAST
        return replace(found, print_log_ratio=print_log_ratio(chosen, against))
    return found


def _light(
    known: CellMoments, samples: FrameSamples, mean: Floats, variance: Floats, covariance: Floats
) -> tuple[float, float] | None:
    """Return gain and offset of a frame's grey values over those of the template; None where few cells are alike."""
    power = known.variance[samples.where]
    alike = known.is_textured[samples.where] & samples.in_view & (covariance > 0)
    alike &= covariance * covariance > _ALIKE**2 * power * (variance + _NOISE**2)
    if np.count_nonzero(alike) < _FEWEST_ALIKE:
        return None
    gain = _median(covariance[alike] / power[alike])
    return gain, _median(mean[alike] - gain * known.mean[samples.where][alike])


def _judged(cells: SeenCells) -> Floats:
    """Return the logarithms of the cells' likelihood ratios."""
    known, where, mean, variance, covariance = cells.known, cells.where, cells.mean, cells.variance, cells.covariance
    expected, power, gradient = known.mean[where], known.variance[where], known.gradient[where]
    noise, gain = _NOISE**2, cells.gain
    # Structure: the residual at the cell's own contrast, near that of most.
    contrast = np.minimum(np.maximum(covariance / np.maximum(power, 1e-3), gain / _CONTRAST), gain * _CONTRAST)
    residual = variance - contrast * (2 * covariance - contrast * power)
    misplaced = (_MISPLACED * gain) ** 2 * gradient
    explained, other = misplaced + noise, variance + noise
    ratio = (_INDEPENDENT / 2) * (np.log(other / explained) + variance / other - residual / explained)
    np.minimum(np.maximum(ratio, -_MOST, out=ratio), _MOST, out=ratio)
    # Brightness.
    predicted = gain * expected + cells.offset
    usual, deviation = (float(each[0, 0]) for each in cv2.meanStdDev(mean))
    spread = deviation * deviation + _ANYTHING
    tolerance = (_SHADING * np.maximum(predicted, 0)) ** 2 + 4 * noise + misplaced / 4
    away = mean - predicted
    elsewhere = mean - usual
    bright = (np.log(spread / tolerance) + elsewhere * elsewhere / spread - away * away / tolerance) / 2
    # Most of what is right: little for it, much against it.
    ratio += np.minimum(np.maximum(bright, -_MOST), np.minimum(_BRIGHTNESS_WEIGHT * np.maximum(bright, 0), _MOST))
    ratio[~cells.in_view | (mean > SATURATED)] = 0
    judged: Floats = ratio
    return judged


def _summed(ratio: Floats, samples: FrameSamples, known: CellMoments, blur: float) -> Evidence:
    log_ratio = np.zeros((samples.cells.rows, samples.cells.columns), np.float32)
    log_ratio[samples.where] = ratio
    is_textured = known.is_textured[samples.where]
    against = ratio < -_LEAST
    supports = (ratio > _LEAST) & is_textured
    telling = supports | against
    count, textured = int(np.count_nonzero(telling)), int(np.count_nonzero(telling & is_textured))
    supporting = int(np.count_nonzero(supports))
    if supporting >= _CLEAR * count:
        is_clear = int(np.count_nonzero(against)) <= _FEW_AGAINST
        share = supporting / max(count, 1)
        return Evidence(share, 1.0, count, 0.0, log_ratio, blur, samples.cell_area, is_clear=is_clear)
    supporting = int(np.count_nonzero(supported_together(supports, telling)))
    # Of a print with flat parts few cells have texture: then the area about them counts.
    votes = cv2.boxFilter(ratio, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    decided = (np.abs(votes) > 2 * _LEAST) & (ratio != 0)
    area = int(np.count_nonzero(decided & (votes > 0))) / max(int(np.count_nonzero(decided)), 1)
    share = max(supporting / max(count, 1), area)
    scatter = scatter_of(against, samples.in_view)
    return Evidence(share, supporting / max(textured, 1), count, scatter, log_ratio, blur, samples.cell_area)


def _median(values: Floats) -> float:
    # np.median takes ten times as long.
    return float(np.partition(values, len(values) // 2)[len(values) // 2])
