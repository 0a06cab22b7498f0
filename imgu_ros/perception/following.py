"""Finding a target's patches in a frame, at one resolution: align, fit the motion that most agree on, and again."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imgu_ros.errors import NoConsensus
from imgu_ros.perception.pictures import Pictures
from imgu_ros.perception.targets import Target
from imgu_ros.types import Floats, Indices, Mask, Matrix3, Points
from imgu_ros.vision.camera.distortion import bend
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.matching.alignment import LocalBend, Patches
from imgu_ros.vision.matching.patch_bank import PatchBank
from imgu_ros.vision.matching.response import Response
from imgu_ros.vision.matching.sheet import TALLEST_PX, Sheet
from imgu_ros.vision.projective.condensed import CondensedHomography, condensed_homography
from imgu_ros.vision.projective.increments import Motion
from imgu_ros.vision.projective.transform import area_factor

#: A patch that looks less alike, or lies farther away than a share of its side, is not the one that is sought.
_MIN_SIMILARITY = 0.5
_FARTHEST_SHARE = 0.5
_FEWEST_AT_FIRST = 6
#: Patches of the first rounds, and by how little they move when the others join, px of the picture.
_SCOUTS = 60
_SCOUTED_PX = 0.3
#: A last round that moves a patch farther has not arrived anywhere, px of the picture.
_SETTLED_PX = 0.5
#: Room around the patches on a sheet, px: for their motion, for interpolation, and for the mosaic's.
_SHEET_ROOM_PX = 4
#: A sheet larger than this share of the frame saves nothing.
_SHEET_SHARE = 0.4
#: A square's side, px, that is too large for any sheet.
_NO_SIDE = 1_000_000
#: By how much a lens may enlarge patches.
_MOST_STRETCHED = 1.3
#: Fewer patches are told an affine motion: two numbers less to be wrong.
_ENOUGH_FOR_PROJECTIVE = 40


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """Patches that were found.

    Attributes
    ----------
    H : H_image_template in ideal px, the motion that most agree on
    sought : how many were tried
    agreeing : how many agree
    bank : of the target's patches
    patches : those that were tried
    displacements : (N, 2) px of the bank, at `H_before`
    usable : (N,) those that look alike and near enough
    motion : what they make
    H_before : (3, 3) ideal px from the bank's px, without the motion
    settled : whether the last round hardly moved a patch
    response : how far displacements go in the picture's most blurred direction, 1 where it is as sharp as the target
    """

    H: Matrix3
    sought: int
    agreeing: int
    bank: Bank
    patches: Patches
    displacements: Points
    usable: Mask
    motion: Motion
    H_before: Matrix3
    settled: bool
    response: float

    def condensed(self, min_points: int) -> CondensedHomography:
        """Return H_image_template with its covariance, in ideal px, of the patches that are not improbably far off.

        Raises
        ------
        NoConsensus, DegenerateConfiguration
            If there are too few, or they do not determine it.
        """
        return condensed_homography(
            self.patches.motions(affine=False),
            self.displacements,
            self.motion,
            self.H_before,
            self.bank.bank_from_template,
            self.patches.overlap,
            max(min_points, 5),
            self.usable,
        )

    def template_xy(self, chosen: Mask) -> Points:
        """Return some of the patches' centres, template px."""
        return self.bank.template_xy(self.patches.centres[chosen])

    def ideal_xy(self, chosen: Mask) -> Points:
        """Return where some of the patches are seen, ideal px."""
        return _mapped(self.H_before, self.patches.centres[chosen] - self.displacements[chosen])


@dataclass(frozen=True, slots=True)
class Effort:
    """How hard to look.

    Attributes
    ----------
    window_px : side of a patch, px of the picture
    most, fewest : number of patches
    steps : most rounds of alignment
    enough_px : a round that moves no patch farther is the last one, px of the picture
    """

    window_px: int
    most: int
    fewest: int
    steps: int
    enough_px: float


def follow_patches(
    pictures: Pictures, halvings: int, target: Target, H: Matrix3, camera: Camera | None, effort: Effort
) -> Followed:
    """Find a target's patches in a frame's picture.

    Parameters
    ----------
    pictures, halvings : the frame's picture, halved so many times
    target : the target
    H : H_image_template in ideal px, right to some px of that picture
    camera : intrinsics when the lens distorts; else None
    effort : how hard to look

    Raises
    ------
    NoConsensus
        If too few patches are in view, are found or agree.
    """
    reduced = _Reduction(0.5**halvings)
    bank = _fitting_bank(target, H, reduced.scale, effort.window_px)
    picture_from_bank = reduced.matrix @ H @ bank.template_from_bank
    shape = (pictures.shape[0] >> halvings, pictures.shape[1] >> halvings)
    seen_at = _in_view(bank.patches, picture_from_bank, shape, reduced, camera, effort)
    chosen = seen_at.chosen
    patches = bank.patches.select(chosen)
    centres = patches.centres
    motions = patches.motions(affine=len(chosen) < _ENOUGH_FOR_PROJECTIVE)
    sheet = None
    if halvings == 0:
        stretched = 1.0 if camera is None else _MOST_STRETCHED
        side = _square_side(picture_from_bank, patches.bounds, effort.window_px * stretched)
        sheet = _sheet(seen_at.xy, side, shape)
    picture = pictures.halved(halvings) if sheet is None else pictures.cut(sheet)
    farthest = _FARTHEST_SHARE * effort.window_px
    motion: Motion | None = None
    response = Response()
    measured = np.zeros((0, 2))
    # The first rounds are a scout's: some patches tell where the others are.
    count = _SCOUTS if len(chosen) > 2 * _SCOUTS else len(chosen)
    for _ in range(effort.steps):
        lens = None if camera is None else reduced.bend(camera, picture_from_bank, centres[:count])
        seen = patches.displacements(patches.sampled(picture, picture_from_bank, lens, sheet, count))
        usable = (seen.similarity > _MIN_SIMILARITY) & (np.abs(seen.xy).max(axis=1) < farthest)
        if motion is not None:
            both = usable[: len(motion.agreeing)] & motion.agreeing
            applied = motions.displacements(motion, len(both))[both]
            response.learn(applied, (measured - seen.xy[: len(both)])[both])
        measured = seen.xy
        displacements = response.corrected(measured)
        # From a poor start few look alike, near the middle; they bring the others near.
        if np.count_nonzero(usable) < _FEWEST_AT_FIRST:
            raise NoConsensus(f"patches: {np.count_nonzero(usable)} of {count} look alike; need {_FEWEST_AT_FIRST}")
        motion = motions.fit(displacements, usable, before=motion)
        # The picture at W(c - d) shows c: W is followed by the inverse of the motion by d.
        before = picture_from_bank
        picture_from_bank = before @ motions.inverse(motion.parameters)
        if count < len(chosen):
            if motion.largest_px < _SCOUTED_PX:
                count = len(chosen)
        elif motion.largest_px < effort.enough_px:
            break
    if motion is None or len(motion.agreeing) < len(chosen):
        raise NoConsensus(f"patches: they still move after {effort.steps} steps; need a better start")
    agreeing = int(np.count_nonzero(motion.agreeing))
    if agreeing < effort.fewest:
        raise NoConsensus(f"patches: {agreeing} of {len(chosen)} agree; need {effort.fewest}")
    H = reduced.inverse @ picture_from_bank @ bank.bank_from_template
    settled = motion.largest_px < max(_SETTLED_PX, effort.enough_px)
    return Followed(
        H,
        len(chosen),
        agreeing,
        bank,
        patches,
        displacements,
        usable,
        motion,
        reduced.inverse @ before,
        settled,
        response.weakest,
    )


class Bank:
    """A target's patches at one of its octaves, and the way to and from them; `step`: template px in one of its."""

    def __init__(self, patches: PatchBank, step: Floats) -> None:
        self.patches = patches
        sx, sy = step
        self.template_from_bank = np.array([[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1]])
        self.bank_from_template = np.array([[1 / sx, 0, 0.5 / sx - 0.5], [0, 1 / sy, 0.5 / sy - 0.5], [0, 0, 1]])
        self._step = step

    def template_xy(self, xy: Points) -> Points:
        """Map the bank's px to the template's."""
        return np.asarray((xy + 0.5) * self._step - 0.5)


class _Reduction:
    """Full-resolution px to px of a picture reduced by `scale`, 1 or less; pixel areas are aligned."""

    def __init__(self, scale: float) -> None:
        self.scale = scale
        shift = (scale - 1) / 2
        self.matrix = np.array([[scale, 0, shift], [0, scale, shift], [0, 0, 1]])
        self.inverse = np.array([[1 / scale, 0, -shift / scale], [0, 1 / scale, -shift / scale], [0, 0, 1]])

    def to_full(self, xy: Points) -> Points:
        return np.asarray((xy + 0.5) / self.scale - 0.5)

    def to_picture(self, xy: Points) -> Points:
        return np.asarray((xy + 0.5) * self.scale - 0.5)

    def bend(self, camera: Camera, picture_from_bank: Matrix3, centres: Points) -> LocalBend:
        straight = _mapped(picture_from_bank, centres)
        return LocalBend(straight, *self._bent(camera, straight))

    def bent(self, camera: Camera, straight: Points) -> Points:
        return self._bent(camera, straight)[0]

    def _bent(self, camera: Camera, straight: Points) -> tuple[Points, Floats]:
        K = camera.K
        square = K[:2, :2]
        inverse = np.linalg.inv(square)
        normalised = (self.to_full(straight) - K[:2, 2]) @ inverse.T
        xy, by_xy = bend(camera.model, camera.distortion, normalised)
        return self.to_picture(xy @ square.T + K[:2, 2]), square @ by_xy @ inverse


def _fitting_bank(target: Target, H: Matrix3, scale: float, window_px: int) -> Bank:
    """Return the patches of the octave whose pixels come out nearest in size to the picture's."""
    width, height = target.size
    pixels = math.sqrt(area_factor(H, ((width - 1) / 2, (height - 1) / 2))) * scale
    octaves = [a for a in target.alignment if len(a.corners)]
    if not octaves:
        raise NoConsensus("patches: the target has none; need texture")
    best = min(octaves, key=lambda octave: abs(math.log(octave.level.scale * max(pixels, 1e-9))))
    return Bank(best.patches(window_px), best.level.step)


@dataclass(frozen=True, slots=True, eq=False)
class _InView:
    """Which patches lie in the picture, (N,), and where, (N, 2) px."""

    chosen: Indices
    xy: Points


def _in_view(
    patches: PatchBank,
    picture_from_bank: Matrix3,
    shape: tuple[int, int],
    reduced: _Reduction,
    camera: Camera | None,
    effort: Effort,
) -> _InView:
    """Return the best spread of the patches that should lie in the picture."""
    height, width = shape
    x, y, w = picture_from_bank @ patches.homogeneous
    inside = w > 0
    w = np.where(inside, w, 1.0)
    x /= w
    y /= w
    if camera is not None:
        # Far outside, the lens model may be anything: near it is what counts.
        inside &= (np.abs(x) < 2 * max(shape)) & (np.abs(y) < 2 * max(shape))
        near = np.flatnonzero(inside)
        if len(near):
            x[near], y[near] = reduced.bent(camera, np.column_stack((x[near], y[near]))).T
    margin = effort.window_px // 2 + 2
    inside &= (x >= margin) & (x < width - margin) & (y >= margin) & (y < height - margin)
    # The centres come best spread first: so do those in view.
    chosen = np.flatnonzero(inside)[: effort.most]
    if len(chosen) < effort.fewest:
        raise NoConsensus(f"patches: {len(chosen)} in view; need {effort.fewest}")
    return _InView(chosen, np.column_stack((x[chosen], y[chosen])))


def _square_side(picture_from_bank: Matrix3, bounds: Sequence[float], window_px: float) -> int:
    """Return the side, px of the picture, of a square about a patch that holds it, wherever within `bounds` it is.

    A homography enlarges most at a corner of what holds all centres: left, top, right, bottom.
    """
    (a, b, c), (d, e, f), (g, h, i) = picture_from_bank.tolist()
    left, top, right, bottom = bounds
    by_centre = 0.0
    for x, y in ((left, top), (right, top), (right, bottom), (left, bottom)):
        w = g * x + h * y + i
        if not w > 0:
            return _NO_SIDE
        u, v = (a * x + b * y + c) / w, (d * x + e * y + f) / w
        by_centre = max(by_centre, (abs(a - u * g) + abs(b - u * h)) / w, (abs(d - v * g) + abs(e - v * h)) / w)
    return 2 * math.ceil(min(by_centre * (window_px // 2) + _SHEET_ROOM_PX, _NO_SIDE))


def _sheet(xy: Points, side: int, shape: tuple[int, int]) -> Sheet | None:
    """Return the squares of the picture that hold the patches at `xy`; None when that saves little."""
    height, width = shape
    too_large = len(xy) * side**2 > _SHEET_SHARE * height * width or len(xy) * side > TALLEST_PX
    if too_large or side > min(shape) - 2:
        return None
    # Even pixels: there a quad of the mosaic begins.
    origins = (np.rint(xy).astype(np.intp) - side // 2) & -2
    np.minimum(origins, ((width - side) & -2, (height - side) & -2), out=origins)
    return Sheet(np.maximum(origins, 0, out=origins), side)


def _mapped(H: Matrix3, points: Points) -> Points:
    at = points @ H[:, :2].T + H[:, 2]
    return np.asarray(at[:, :2] / at[:, 2:])
