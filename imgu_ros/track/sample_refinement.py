# SPDX-License-Identifier: Apache-2.0
"""The last step of an alignment: the homography by the raw samples, which are neither demosaicked nor made grey."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from imgu_ros.errors import NoConsensus
from imgu_ros.image.frame_image import FrameImage
from imgu_ros.image.raw_samples import Lens, RowScan
from imgu_ros.image.transfer_fit import CurveSamples
from imgu_ros.pose.planar_pose import Located
from imgu_ros.reference.code_reading import where_read
from imgu_ros.reference.reference import Reference
from imgu_ros.result import SampledPatches
from imgu_ros.track.patch_equations import SitesFit
from imgu_ros.track.site_alignment import SiteAlignment
from imgu_ros.types import Floats, Matrix3, Points
from imgu_ros.vision.camera.distortion import distort
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.projective.fit import fit_homography
from imgu_ros.vision.projective.homography import (
    HomographyEstimate,
    HomographyNormalEquations,
    normalised_unchecked,
    tangent_basis_unchecked,
    unscaled_unchecked,
)

#: Standard deviation of the speed during a frame: as a share of it, and as a share of its change from frame to frame;
#: where only two frames tell it, as a share of it.
_DOUBT_OF_SPEED, _DOUBT_OF_CHANGE, _UNKNOWN_CHANGE = 0.05, 0.5, 0.3
#: Standard deviation of a speed of which nothing is known, of a camera in a hand or on a robot, along x and along y, px
#: a nanosecond.
_UNKNOWN_SPEED = 300e-9
#: The derivatives of the motion D by its parameters.
_BY_PARAMETER = np.eye(9)[:8].reshape(8, 3, 3)
#: A larger correction of a patch, px, is not a refinement. Measured: benchmarks/thresholds.py, study samples.
_FARTHEST_PX = 3.0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PatchAlignment(Located):
    """Where the alignment of its patches found a reference; the correspondences are those of the patches that agree.

    Attributes
    ----------
    sought : number of patches that were aligned
    agreeing_share : share of them that agree, 0 to 1
    sampled : the patches as compared with the raw samples; None: not aligned by samples
    samples : of the frame and the reference, to learn the transfer curve of; None: not aligned by samples
    """

    sought: int
    agreeing_share: float
    sampled: SampledPatches | None = None
    samples: Callable[[], CurveSamples] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class AlignedPatches:
    """Patches that agree on a homography.

    Attributes
    ----------
    H : H_image_template in ideal px, right to a fraction of a px
    template_xy : (N, 2) px, those that agree
    halvings : of the frame's level in which they do
    sought : number of patches that were aligned
    before : the same patches in the frame before; None: they are chosen anew
    """

    H: Matrix3
    template_xy: Points
    halvings: int
    sought: int
    before: SampledPatches | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """Where a reference was seen: H_image_template in ideal px, and when."""

    H: Matrix3
    stamp_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class FrameHints:
    """What earlier frames tell of this one.

    Attributes
    ----------
    spread : (3,) px^2, see `SampledPatches`; None: unknown
    stamp_ns : time of the frame: that of its middle row
    earlier : observations in earlier frames, the latest first
    """

    spread: Floats | None = None
    stamp_ns: int = 0
    earlier: Sequence[Observation] = ()

    def scan(self, H: Matrix3, template_xy: Points, middle: float, row_time_ns: float) -> RowScan:
        """Return how points of the template move in a frame, seen by H_image_template, from row to row.

        Along the parabola through where they were seen in the last three frames, each when its row was exposed; of
        two, at a steady speed; with none before, nobody knows. `middle` is the row at whose time the frame's stamp is.
        """
        times, places = [], []
        for observation in (Observation(H, self.stamp_ns), *self.earlier[:2]):
            xy = mapped(observation.H, template_xy)
            places.append(xy)
            times.append(observation.stamp_ns - self.stamp_ns + (xy[:, 1:] - middle) * row_time_ns)
        if len(places) == 1:
            still = np.zeros_like(places[0])
            unknown = np.broadcast_to(np.eye(2)[:, None] * (_UNKNOWN_SPEED * row_time_ns), (2, *still.shape))
            return RowScan(still, unknown, middle)
        latest = (places[0] - places[1]) / (times[0] - times[1])
        if len(places) == 2:
            by_row = latest * row_time_ns
            return RowScan(by_row, by_row[None] * _UNKNOWN_CHANGE, middle)
        before = (places[1] - places[2]) / (times[1] - times[2])
        change = (latest - before) * ((times[0] - times[1]) / (times[0] - times[2]) * row_time_ns)
        by_row = latest * row_time_ns + change
        return RowScan(by_row, np.stack((by_row * _DOUBT_OF_SPEED, change * _DOUBT_OF_CHANGE)), middle)


#: Of a frame before which there was none.
NO_HINTS = FrameHints()


def has_samples(frame: FrameImage, reference: Reference) -> bool:
    """Whether the frame has samples with which the reference's colours can be compared."""
    return reference.light is not None and frame.mosaic is not None


def refined_on_samples(
    frame: FrameImage,
    reference: Reference,
    start: AlignedPatches,
    camera: Camera | None,
    min_points: int,
    hints: FrameHints,
    must_settle: bool = True,
) -> PatchAlignment:
    """Return the alignment by the raw samples.

    Parameters
    ----------
    frame, reference : a pair that has samples
    start : the patches to refine
    camera : intrinsics when the lens distorts; else None
    min_points : patches that must agree
    hints : what earlier frames tell
    must_settle : see `SiteAlignment.fit`

    Raises
    ------
    EstimationError
        If the samples do not agree.
    """
    mosaic = frame.mosaic
    if mosaic is None or reference.light is None:
        raise NoConsensus("sites: no raw samples")
    lens = None if camera is None else _lens(camera)
    if len(reference.codes) > 1:
        start = _uncovered(frame, reference, start, camera)
    levels = reference.light[frame.light_kind]
    scan, centres = None, start.template_xy
    if frame.row_time_ns > 0:
        H, scan = _at_middle_row(hints, start.H, centres, (frame.shape[0] - 1) / 2, frame.row_time_ns)
        start = replace(start, H=H)
    size = reference.size if reference.ends_at_border else None
    alignment = SiteAlignment(mosaic, levels, start.H, centres, lens, scan, hints.spread, max(min_points, 6), size)
    before = start.before
    fit = alignment.fit(None if before is None else before.kept, must_settle)
    found = _located(fit, start, camera, min_points)
    H_seen = None if scan is None else fit_homography(centres, scan.seen(mapped(fit.H, centres))).H
    scale = alignment.scale if before is None else before.scale
    sampled = SampledPatches(
        start.template_xy[fit.chosen],
        fit.kept,
        start.sought,
        1 if before is None else before.frames + 1,
        alignment.scale / scale,
        scale,
        fit.spread,
    )
    return replace(found, H_seen=H_seen, sampled=sampled, samples=partial(alignment.samples, fit.kept))


def _uncovered(frame: FrameImage, reference: Reference, start: AlignedPatches, camera: Camera | None) -> AlignedPatches:
    """Return the patches of a board without those at markers that are not read: something covers them."""
    seen = where_read(frame, reference.codes, start.H, camera, start.template_xy)
    if seen.all():
        return start
    before = start.before
    if before is not None:
        before = replace(before, kept=before.kept[seen])
    return replace(start, template_xy=start.template_xy[seen], before=before)


def _at_middle_row(
    hints: FrameHints, H: Matrix3, centres: Points, middle: float, row_time_ns: float
) -> tuple[Matrix3, RowScan]:
    """Return H_image_template at the time of the middle row, and the motion from row to row."""
    seen, scan = mapped(H, centres), hints.scan(H, centres, middle, row_time_ns)
    return fit_homography(centres, seen - scan.by_row * (seen[:, 1:] - middle)).H, scan


def _lens(camera: Camera) -> Lens:
    K = camera.K[:2, :2]
    back = np.linalg.inv(K)

    def raw_of_ideal(ideal: Points) -> tuple[Points, Floats]:
        xy, by = distort(camera.model, camera.distortion, (ideal - camera.K[:2, 2]) @ back.T)
        return xy @ K.T + camera.K[:2, 2], K @ by @ back

    return raw_of_ideal


def _located(fit: SitesFit, start: AlignedPatches, camera: Camera | None, min_points: int) -> PatchAlignment:
    kept = fit.kept
    if np.count_nonzero(kept) < max(min_points, len(kept) // 2):
        raise NoConsensus(f"sites: {np.count_nonzero(kept)} of {len(kept)} patches agree")
    centres = start.template_xy[fit.chosen]
    at = mapped(fit.H, centres)
    farthest = float(np.abs(at - mapped(start.H, centres)).max())
    if farthest > _FARTHEST_PX:
        raise NoConsensus(f"sites: they move patches by {farthest:.2f} px; need a better start")
    centres, at = centres[kept], at[kept] - fit.displacements[kept]
    unit = float(fit.T[0, 0])
    noise = unit * math.sqrt(float((fit.displacements[kept] ** 2).mean()))
    T_src = _unit_similarity(centres)
    scaled = normalised_unchecked(fit.T @ fit.H @ np.linalg.inv(T_src))
    basis = tangent_basis_unchecked(scaled)
    # The motion I - D of the normalised image: scaled - D scaled.
    by_motion = -(basis.T @ (_BY_PARAMETER @ scaled).reshape(8, 9).T)
    by_tangent = np.linalg.inv(by_motion)
    normal = by_tangent.T @ fit.information @ by_tangent * noise**2
    normal = (normal + normal.T) / 2
    by_tangent_covariance = by_motion @ (fit.covariance + fit.doubted) @ by_motion.T
    middle = normal @ by_tangent_covariance @ normal / noise**2
    H, by_scaled = unscaled_unchecked(scaled, T_src, fit.T)
    spread_out = by_scaled @ basis
    covariance = spread_out @ by_tangent_covariance @ spread_out.T
    told = None
    if fit.doubted.any():
        by_patches = spread_out @ by_motion
        told = by_patches @ fit.covariance @ by_patches.T
    squares = noise**2 * max(2 * len(centres) - 8, 1)
    estimate = HomographyEstimate(H, (covariance + covariance.T) / 2, kept, noise / unit, 0)
    equations = HomographyNormalEquations(estimate, T_src, fit.T, scaled, basis, normal, middle, squares, noise)
    raw = at if camera is None else camera.raw_pixels(at)
    share = np.count_nonzero(kept) / start.sought
    return PatchAlignment(
        centres,
        raw,
        estimate,
        equations,
        start.halvings,
        told_covariance=told,
        sought=start.sought,
        agreeing_share=share,
    )


def _unit_similarity(points: Points) -> Floats:
    x, y = centre = points.mean(axis=0)
    factor = 1 / math.sqrt(float(((points - centre) ** 2).mean()))
    return np.array([[factor, 0, -factor * x], [0, factor, -factor * y], [0, 0, 1]])


def mapped(H: Floats, points: Points) -> Points:
    """Return where a homography maps points (N, 2)."""
    mapped = points @ H[:, :2].T + H[:, 2]
    return np.asarray(mapped[:, :2] / mapped[:, 2:])
