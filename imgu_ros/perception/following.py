"""Finding a target's patches in a frame, at one resolution: align, fit the motion that most agree on, and again."""

from __future__ import annotations

import math
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
from imgu_ros.vision.projective.transform import local_jacobian

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
    chosen = _in_view(bank.patches, picture_from_bank, shape, reduced, camera, effort)
    patches = bank.patches.select(chosen)
    centres = patches.centres
    motions = patches.motions(affine=len(chosen) < _ENOUGH_FOR_PROJECTIVE)
    sheet = None
    if halvings == 0:
        sheet = _sheet(picture_from_bank, centres, shape, reduced, camera, effort.window_px)
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
        picture_from_bank = before @ np.linalg.inv(motion.matrix)
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
    centre = np.array([[(width - 1) / 2, (height - 1) / 2]])
    pixels = math.sqrt(abs(float(np.linalg.det(local_jacobian(H, centre)[0])))) * scale
    octaves = [a for a in target.alignment if len(a.corners)]
    if not octaves:
        raise NoConsensus("patches: the target has none; need texture")
    best = min(octaves, key=lambda octave: abs(math.log(octave.level.scale * max(pixels, 1e-9))))
    return Bank(best.patches(window_px), best.level.step)


def _sheet(
    picture_from_bank: Matrix3,
    centres: Points,
    shape: tuple[int, int],
    reduced: _Reduction,
    camera: Camera | None,
    window_px: int,
) -> Sheet | None:
    """Return the squares of the picture that hold the patches; None when that saves little."""
    height, width = shape
    # A homography enlarges most at a corner of what holds all centres.
    (left, top), (right, bottom) = centres.min(axis=0), centres.max(axis=0)
    corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
    by_centre = np.abs(local_jacobian(picture_from_bank, corners)).sum(axis=2).max()
    stretch = 1.0 if camera is None else _MOST_STRETCHED
    side = 2 * math.ceil(float(by_centre) * stretch * (window_px // 2) + _SHEET_ROOM_PX)
    too_large = len(centres) * side**2 > _SHEET_SHARE * height * width or len(centres) * side > TALLEST_PX
    if too_large or side > min(shape) - 2:
        return None
    at = _mapped(picture_from_bank, centres)
    if camera is not None:
        at = reduced.bent(camera, at)
    # Even pixels: there a quad of the mosaic begins.
    origin = (np.rint(at).astype(np.intp) - side // 2) // 2 * 2
    return Sheet(np.clip(origin, 0, [(width - side) // 2 * 2, (height - side) // 2 * 2]), side)


def _in_view(
    patches: PatchBank,
    picture_from_bank: Matrix3,
    shape: tuple[int, int],
    reduced: _Reduction,
    camera: Camera | None,
    effort: Effort,
) -> Indices:
    """Return which patches should lie in the picture: the best spread of them."""
    mapped = patches.centres @ picture_from_bank[:, :2].T + picture_from_bank[:, 2]
    ahead = np.flatnonzero(mapped[:, 2] > 0)
    xy = mapped[ahead, :2] / mapped[ahead, 2:]
    if camera is not None and len(xy):
        # Far outside, the lens model may be anything: near it is what counts.
        near = (np.abs(xy) < 2 * max(shape)).all(axis=1)
        ahead, xy = ahead[near], xy[near]
        if len(xy):
            xy = reduced.bent(camera, xy)
    margin = effort.window_px // 2 + 2
    inside = (xy >= margin).all(axis=1) & (xy < np.array((shape[1], shape[0])) - margin).all(axis=1)
    # The centres come best spread first: so do those in view.
    chosen = ahead[inside][: effort.most]
    if len(chosen) < effort.fewest:
        raise NoConsensus(f"patches: {len(chosen)} in view; need {effort.fewest}")
    return chosen


def _mapped(H: Matrix3, points: Points) -> Points:
    at = points @ H[:, :2].T + H[:, 2]
    return np.asarray(at[:, :2] / at[:, 2:])
