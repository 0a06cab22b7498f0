# SPDX-License-Identifier: Apache-2.0
"""Alignment of a reference's patches with a frame, from coarse to full resolution."""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from imgu_ros.config.parameters import RefinementParameters
from imgu_ros.errors import DegenerateConfiguration, EstimationError, NoConsensus
from imgu_ros.image.frame_image import FrameImage
from imgu_ros.pose.planar_pose import seen_outline
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TemplateOctave
from imgu_ros.track.edge_patches import edge_patches, edge_patches_near
from imgu_ros.track.patch_squares import atlas_about
from imgu_ros.track.sample_refinement import (
    NO_HINTS,
    AlignedPatches,
    FrameHints,
    PatchAlignment,
    has_samples,
    mapped,
    refined_on_samples,
)
from imgu_ros.types import Image, Indices, Matrix3, Points
from imgu_ros.vision.camera.distortion import distort
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.matching.patch_atlas import PatchAtlas
from imgu_ros.vision.matching.patch_bank import LocalDistortion, PatchBank
from imgu_ros.vision.projective.homography import homography_normal_equations_unchecked
from imgu_ros.vision.projective.plane_motion import BlurGain, Motion
from imgu_ros.vision.scale_space.pyramid import PixelScaling

#: Largest error that patches bridge, px of the level in which they are aligned. Measured: benchmarks/thresholds.py,
#: study reach.
_REACH_PX = 3.0
#: Smallest side of the reference in the coarsest level. Measured: benchmarks/thresholds.py, study reach.
_COARSEST_SIDE_PX = 60
#: Number of halvings from one level to the next. Measured: benchmarks/thresholds.py, study reach.
_STRIDE = 2
#: Levels halved more often give a start, not a result. Measured: benchmarks/thresholds.py, study blur.
_COARSEST_RESULT = 2
#: Share of the patches that must agree in a reduced level. Measured: benchmarks/thresholds.py, study tracking.
_COARSE_SHARE = 0.5
#: Below this blur gain, patches of a reduced level are more accurate than those of full resolution. Measured:
#: benchmarks/thresholds.py, study blur.
_BLURRED = 0.6
#: Number of patches in a level that gives a start. Measured: benchmarks/thresholds.py, study reach.
_COARSE_PATCHES = 80
#: Number of patches that give the start of the refinement on raw samples, and are refined.
_START_PATCHES = 64
#: Share of them that must agree; else all are aligned.
_MOST_AGREE = 0.7
#: Raw samples alone bridge such an error where their patches hold every edge, raw px.
_DIRECT_PX = 2.0
#: Levels halved more often show a blur too wide for the samples' point spread.
_MOST_BLURRED = 1
#: Most iterations in a level that gives a start. Measured: benchmarks/thresholds.py, study reach.
_COARSE_STEPS = 8
#: Motion below which iterations stop in such a level, px of the level. Measured: benchmarks/thresholds.py, study reach.
_COARSE_ENOUGH_PX = 0.2
#: Most iterations in the level that gives the result. Measured: benchmarks/thresholds.py, study tracking.
_FINE_STEPS = 10
#: Motion below which they stop there, px of the level. Measured: benchmarks/thresholds.py, study tracking.
_FINE_ENOUGH_PX = 0.15
#: Smallest correlation of a patch that is used. Measured: benchmarks/thresholds.py, study tracking.
_MIN_SIMILARITY = 0.5
#: Largest displacement of a patch, as a share of its side. Measured: benchmarks/thresholds.py, study tracking.
_FARTHEST_SHARE = 0.5
#: Fewest usable patches in each iteration; H needs four. Measured: benchmarks/thresholds.py, study tracking.
_FEWEST_AT_FIRST = 6
#: Number of patches in the first iterations; the others join when these move little. Measured:
#: benchmarks/thresholds.py, study tracking.
_SCOUTS = 60
#: The others join when these move less, px of the level. Measured: benchmarks/thresholds.py, study tracking.
_SCOUTED_PX = 0.3
#: Largest motion in the last iteration that still counts as converged, px of the level. Measured:
#: benchmarks/thresholds.py, study tracking.
_SETTLED_PX = 0.5
#: A median correlation below this means that the image is blurred: iterations then fall short of the displacement.
#: Measured: benchmarks/thresholds.py, study blur.
_SHARP_SIMILARITY = 0.9
#: Factor on the motion at which iterations stop, where the image is blurred. Measured: benchmarks/thresholds.py, study
#: blur.
_BLURRED_SHARE = 0.2
#: With fewer patches an affine motion is fitted. Measured: benchmarks/thresholds.py, study tracking.
_ENOUGH_FOR_PROJECTIVE = 40
#: Factor by which lens distortion may enlarge patches. Measured: benchmarks/thresholds.py, study tracking.
_MOST_STRETCHED = 1.3
#: Scaling of a frame halved so many times; no frame can be halved more often.
_HALVED = tuple(PixelScaling(2.0**times) for times in range(16))


@dataclass(frozen=True, slots=True)
class AlignmentOptions:
    """Limits of an alignment with one level of the frame.

    Attributes
    ----------
    window_px : side of a patch, px of the level
    most, fewest : number of patches
    steps : most iterations
    enough_px : an iteration that moves no patch farther is the last one, px of the level; less where it is blurred
    """

    window_px: int
    most: int
    fewest: int
    steps: int
    enough_px: float


def align_patches(
    frame: FrameImage,
    reference: Reference,
    H: Matrix3,
    camera: Camera | None,
    parameters: RefinementParameters,
    min_points: int,
    reach_px: float,
    hints: FrameHints = NO_HINTS,
) -> PatchAlignment:
    """Align a reference with a frame, starting from a homography that is nearly right.

    Where full resolution shows no patches (blur), the result is that of a reduced level. Where the frame has raw
    samples that agree, they give the result, and few patches its start.

    Parameters
    ----------
    frame : the frame's image
    reference : whose templates are aligned
    H : H_image_template in ideal px (raw px without a distorted camera)
    camera : intrinsics when the lens distorts; else None
    parameters : number and size of the patches
    min_points : fewest patches that must agree
    reach_px : largest error of H, raw px
    hints : what earlier frames tell

    Raises
    ------
    NoConsensus, TooFewPoints, DegenerateConfiguration
        If the patches do not agree on a homography.
    """
    if has_samples(frame, reference):
        edges = edge_patches(reference, H, camera, frame.shape)
        if edges is not None and reach_px <= _DIRECT_PX:
            with contextlib.suppress(EstimationError):
                return refined_on_samples(frame, reference, edges, camera, min_points, hints)
        few = replace(parameters, max_points=min(parameters.max_points, _START_PATCHES))
        with contextlib.suppress(EstimationError):
            start = _aligned(frame, reference, H, camera, few, min_points, reach_px)
            if edges is not None:
                edges = edge_patches_near(reference, edges, start.outcome, few.window_px)
                return refined_on_samples(frame, reference, edges, camera, min_points, hints)
            if start.halvings > 0 or start.agreeing < _MOST_AGREE * start.sought:
                # Where a part is hidden, few of few are left; in blur, few do not tell enough.
                start = _aligned(frame, reference, H, camera, parameters, min_points, reach_px)
            if start.halvings > _MOST_BLURRED:
                return start.result(min_points)
            return refined_on_samples(frame, reference, start.outcome, camera, min_points, hints)
        if edges is not None and reach_px <= _DIRECT_PX:
            # Of a small marker too few patches are in view for anything else.
            with contextlib.suppress(EstimationError):
                return _aligned(frame, reference, H, camera, parameters, min_points, reach_px).result(min_points)
            return refined_on_samples(frame, reference, edges, camera, min_points, hints, must_settle=False)
    return _aligned(frame, reference, H, camera, parameters, min_points, reach_px).result(min_points)


def _aligned(
    frame: FrameImage,
    reference: Reference,
    H: Matrix3,
    camera: Camera | None,
    parameters: RefinementParameters,
    min_points: int,
    reach_px: float,
) -> LevelAlignment:
    """Return the alignment with the finest level that gives a result; parameters and errors: see `align_patches`."""
    found: LevelAlignment | None = None
    failure: EstimationError | None = None
    for halvings in [*range(_first_halvings(frame, reference, H, reach_px), 0, -_STRIDE), 0]:
        try:
            options = _options(parameters, min_points, for_result=halvings == 0)
            found = LevelAlignment(frame, halvings, reference, found.H if found else H, camera, options)
        except EstimationError as error:
            # Its traceback holds this function's variables, which hold the error: the frame would stay in memory.
            failure = error.with_traceback(None)
            # A result of a reduced level stands; without one, a finer level may have one.
            if found is not None:
                break
    if found is not None and found.halvings == 0 and found.gain < _BLURRED:
        found = _reduced_instead(frame, reference, found, camera, _options(parameters, min_points, for_result=True))
    if found is None or (found.halvings > 0 and not _stands_alone(found)):
        try:
            raise failure or NoConsensus("patches: not found")
        finally:
            del failure
    if not found.converged:
        raise NoConsensus(f"patches: they still move by {found.largest_px:.2f} px; need a better start")
    return found


class LevelAlignment:
    """The alignment of a reference's patches with one level of the frame's pyramid.

    Parameters
    ----------
    frame, halvings : the frame's image, halved so many times
    reference : whose templates are aligned
    H : H_image_template in ideal px, right to some px of the level
    camera : intrinsics when the lens distorts; else None
    options : limits

    Attributes
    ----------
    H : H_image_template in ideal px, the motion that most patches agree with
    sought, agreeing : number of patches aligned, and of those that agree
    halvings : as given
    largest_px : motion of the patches in the last iteration, px of the reference's level
    converged : whether that is small
    gain : of displacements in the frame's most blurred direction, 1 where it is as sharp as the reference

    Raises
    ------
    NoConsensus
        If too few patches are in view, are found or agree.
    """

    def __init__(
        self,
        frame: FrameImage,
        halvings: int,
        reference: Reference,
        H: Matrix3,
        camera: Camera | None,
        options: AlignmentOptions,
    ) -> None:
        self.halvings, self._camera, self._scaling = halvings, camera, _HALVED[halvings]
        self._level = _nearest_level(reference, frame.is_linear, H, 0.5**halvings)
        bank = self._level.patches[options.window_px]
        self._template_xy = bank.template_xy
        height, width = frame.shape
        shape = (height >> halvings, width >> halvings)
        image_from_bank = self._scaling.reduced_from_full @ H @ self._level.scaling.full_from_reduced
        chosen, xy = self._in_view(bank, image_from_bank, shape, options)
        self.sought = len(chosen)
        if self.sought < options.fewest:
            raise NoConsensus(f"patches: {self.sought} in view; need {options.fewest}")
        self._patches = bank.select_unchecked(chosen)
        atlas = None
        if halvings == 0:
            window_px = options.window_px * (1.0 if camera is None else _MOST_STRETCHED)
            atlas = atlas_about(xy, self._patches.bounds, image_from_bank, shape, window_px)
        image = frame.halved(halvings) if atlas is None else frame.cut(atlas)
        self._align(image, atlas, image_from_bank, options)

    def _in_view(
        self, bank: PatchBank, image_from_bank: Matrix3, shape: tuple[int, int], options: AlignmentOptions
    ) -> tuple[Indices, Points]:
        """Return the best spread of the patches that should lie in the image: (N,) indices, (N, 2) px of the image."""
        height, width = shape
        x, y, w = image_from_bank @ bank.homogeneous
        inside = w > 0
        w = np.where(inside, w, 1.0)
        x, y = x / w, y / w
        if self._camera is not None:
            # The lens model is valid near the image only.
            inside &= (np.abs(x) < 2 * max(shape)) & (np.abs(y) < 2 * max(shape))
            near = np.flatnonzero(inside)
            if len(near):
                x[near], y[near] = self._distortion(self._camera, np.column_stack((x[near], y[near]))).distorted.T
        margin = options.window_px // 2 + 2
        inside &= (x >= margin) & (x < width - margin) & (y >= margin) & (y < height - margin)
        # The centres are ordered, best spread first: so are those in view.
        chosen = np.flatnonzero(inside)[: options.most]
        return chosen, np.column_stack((x[chosen], y[chosen]))

    def _align(
        self, image: Image, atlas: PatchAtlas | None, image_from_bank: Matrix3, options: AlignmentOptions
    ) -> None:
        patches, centres = self._patches, self._patches.centres
        motions = patches.motions(affine=self.sought < _ENOUGH_FOR_PROJECTIVE)
        farthest = _FARTHEST_SHARE * options.window_px
        motion: Motion | None = None
        gain = BlurGain()
        measured = displacements = np.zeros((0, 2))
        usable = np.zeros(0, bool)
        before = image_from_bank
        # Some patches first: their motion brings the others near.
        count = _SCOUTS if self.sought > 2 * _SCOUTS else self.sought
        for _ in range(options.steps):
            lens = None
            if self._camera is not None:
                lens = self._distortion(self._camera, mapped(image_from_bank, centres[:count]))
            seen = patches.displacements_unchecked(
                patches.sampled_unchecked(image, image_from_bank, lens, atlas, count)
            )
            usable = (seen.similarity > _MIN_SIMILARITY) & (np.abs(seen.xy).max(axis=1) < farthest)
            if motion is not None:
                both = usable[: len(motion.agreeing)] & motion.agreeing
                applied = motions.displacements(motion, len(both))[both]
                gain.learn_unchecked(applied, (measured - seen.xy[: len(both)])[both])
            measured = seen.xy
            displacements = gain.corrected_unchecked(measured)
            # From a poor start few are found, near the centre; their motion brings the others near.
            found = int(np.count_nonzero(usable))
            if found < _FEWEST_AT_FIRST:
                raise NoConsensus(f"patches: {found} of {count} look alike; need {_FEWEST_AT_FIRST}")
            motion = motions.fit_unchecked(displacements, usable, before=motion)
            # The image at W(c - d) shows c: W is followed by the inverse of the motion by d.
            before = image_from_bank
            image_from_bank = before @ motions.inverse_unchecked(motion.parameters)
            if count < self.sought:
                if motion.largest_px < _SCOUTED_PX:
                    count = self.sought
                continue
            # np.median takes ten times as long.
            is_sharp = float(np.partition(seen.similarity, count // 2)[count // 2]) > _SHARP_SIMILARITY
            if motion.largest_px < options.enough_px * (1.0 if is_sharp else _BLURRED_SHARE):
                break
        if motion is None or len(motion.agreeing) < self.sought:
            raise NoConsensus(f"patches: they still move after {options.steps} steps; need a better start")
        self.agreeing = int(np.count_nonzero(motion.agreeing))
        if self.agreeing < options.fewest:
            raise NoConsensus(f"patches: {self.agreeing} of {self.sought} agree; need {options.fewest}")
        full, bank_from_template = self._scaling.full_from_reduced, self._level.scaling.reduced_from_full
        self.H: Matrix3 = full @ image_from_bank @ bank_from_template
        self.largest_px = motion.largest_px
        self.converged = motion.largest_px < max(_SETTLED_PX, options.enough_px)
        self.gain = gain.weakest
        self._motion, self._displacements, self._usable, self._H_before = motion, displacements, usable, full @ before

    @property
    def outcome(self) -> AlignedPatches:
        """What a refinement begins with."""
        agreeing = self._motion.agreeing & self._usable
        template_xy = self._template_xy[self._patches.chosen[agreeing]]
        return AlignedPatches(self.H, template_xy, self.halvings, self.sought)

    def result(self, min_points: int) -> PatchAlignment:
        """Return the correspondences of the patches and their homography, by least squares without outliers.

        EstimationError if fewer than `min_points` agree, or they do not determine a homography.
        """
        patches = self._patches
        normal_equations = homography_normal_equations_unchecked(
            patches.motions(affine=False),
            self._displacements,
            self._motion,
            self._H_before,
            self._level.scaling.reduced_from_full,
            patches.overlap,
            max(min_points, 5),
            self._usable,
        )
        homography = normal_equations.estimate
        kept = homography.inliers
        template_xy = self._template_xy[patches.chosen[kept]]
        image_xy = mapped(self._H_before, patches.centres[kept] - self._displacements[kept])
        if self._camera is not None:
            image_xy = self._camera.raw_pixels(image_xy)
        share = len(template_xy) / self.sought
        return PatchAlignment(
            template_xy,
            image_xy,
            homography,
            normal_equations,
            self.halvings,
            sought=self.sought,
            agreeing_share=share,
        )

    def _distortion(self, camera: Camera, straight: Points) -> LocalDistortion:
        """Return the lens distortion of the level about ideal points, (N, 2) px of the level."""
        K = camera.K
        square = K[:2, :2]
        inverse = np.linalg.inv(square)
        normalised = (self._scaling.to_full_unchecked(straight) - K[:2, 2]) @ inverse.T
        xy, by_xy = distort(camera.model, camera.distortion, normalised)
        distorted = self._scaling.from_full_unchecked(xy @ square.T + K[:2, 2])
        return LocalDistortion(straight, distorted, square @ by_xy @ inverse)


def _options(parameters: RefinementParameters, min_points: int, for_result: bool) -> AlignmentOptions:
    if for_result:
        return AlignmentOptions(parameters.window_px, parameters.max_points, min_points, _FINE_STEPS, _FINE_ENOUGH_PX)
    most = min(_COARSE_PATCHES, parameters.max_points)
    return AlignmentOptions(parameters.window_px, most, min_points, _COARSE_STEPS, _COARSE_ENOUGH_PX)


def _first_halvings(frame: FrameImage, reference: Reference, H: Matrix3, reach_px: float) -> int:
    """Return how often to halve the frame so that patches bridge `reach_px`, and the reference is not too small."""
    wanted = math.ceil(math.log2(max(reach_px / _REACH_PX, 1.0)))
    if wanted == 0:
        return 0
    height, width = frame.shape
    try:
        extent = np.ptp(np.clip(seen_outline(reference.plane, H), 0, (width, height)), axis=0)
    except DegenerateConfiguration:
        extent = np.array((width, height))
    side = math.sqrt(float(extent[0] * extent[1]))
    possible = math.floor(math.log2(max(side / _COARSEST_SIDE_PX, 1.0)))
    return min(wanted, possible, frame.most_halvings)


def _reduced_instead(
    frame: FrameImage, reference: Reference, found: LevelAlignment, camera: Camera | None, options: AlignmentOptions
) -> LevelAlignment:
    """Return the alignment with the finest level that is as sharp as the reference there."""
    for halvings in range(1, min(_COARSEST_RESULT, frame.most_halvings) + 1):
        try:
            reduced = LevelAlignment(frame, halvings, reference, found.H, camera, options)
        except EstimationError:
            break
        if not _stands_alone(reduced):
            break
        found = reduced
        if found.gain >= _BLURRED:
            break
    return found


def _stands_alone(found: LevelAlignment) -> bool:
    """Whether the alignment with a reduced level can be a result: few patches agree by chance sooner there."""
    return found.halvings <= _COARSEST_RESULT and found.converged and found.agreeing >= _COARSE_SHARE * found.sought


def _nearest_level(reference: Reference, linear: bool, H: Matrix3, scale: float) -> TemplateOctave:
    """Return the reference's level with patches whose pixels are nearest in size to those of the frame's level.

    EstimationError if no level has a patch, or H maps the reference's centre to infinity.
    """
    width, height = reference.size
    g, h, i = H[2].tolist()
    w = g * ((width - 1) / 2) + h * ((height - 1) / 2) + i
    if not 0 < abs(w) < math.inf:
        raise DegenerateConfiguration("H: it maps the reference's centre to infinity")
    # The determinant of the local Jacobian there is the scale of areas.
    pixels = max(math.sqrt(abs(cv2.determinant(H) / (w * w * w))) * scale, 1e-9)
    levels = reference.templates[linear]
    distances = [abs(math.log(level.scale * pixels)) for level in levels]
    for index in sorted(range(len(levels)), key=distances.__getitem__):
        if len(levels[index].corners):
            return levels[index]
    raise NoConsensus("patches: the target has none; need texture")
