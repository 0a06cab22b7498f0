# SPDX-License-Identifier: Apache-2.0
"""How good a target is: a score, the reasons in a user's words, and what would make it better."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from imgu_ros.build_cache import BuildCache
from imgu_ros.check.accuracy import ExpectedError, expected_errors
from imgu_ros.check.finding import SIZES_PX, FindingCurve, finding_curve
from imgu_ros.check.traits import Traits, traits_of
from imgu_ros.check.trial_views import DEFAULT_CAMERA, TrialViews
from imgu_ros.config.components import DetectionParameters
from imgu_ros.config.parameters import Parameters, RawParameters
from imgu_ros.detect.rivals import Rivals
from imgu_ros.errors import ImguError
from imgu_ros.reference.bundle import BundleImage
from imgu_ros.reference.family import FamilyImage
from imgu_ros.reference.marker import MarkerImage
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import make_references
from imgu_ros.types import Choice
from imgu_ros.vision.camera.intrinsics import Camera

#: The score is the share of views in which a target is found whose longer side has so many px, each factor counting
#: alike: from a sixteenth of a usual frame's width to all but all of it.
SCORE_PX = (32.0, 512.0)
#: A target with a higher score is found in four of five views that show it a quarter of the frame wide.
DEPENDABLE = 50
#: Bits of the simulated frames.
_BITS = 10
#: Limits from which on a trait is a reason. They are those that tell the poor ones among printed targets from others:
#: benchmarks/target_scores.py.
_FEW_CORNERS, _CORNERS_FROM_PX = 60, 100.0
#: Nothing tells a target from a copy of which so small a share differs.
_SAME = 0.02
#: With fewer corners a picture is like itself anywhere, and that it has so few is the reason.
_HARDLY_ANY = 20
_LOW_CONTRAST, _FLAT, _LOST, _CROWDED, _ELONGATED, _FEW_PX = 25.0, 0.65, 0.38, 0.35, 2.5, 300
#: A share of ambiguous poses at the smallest size that people should know of.
_AMBIGUOUS = 0.5


class ReasonKind(Choice):
    """What is to be said of a target."""

    NOT_USABLE = "not_usable"
    SYMMETRIC = "symmetric"
    REPEATS = "repeats"
    FEW_CORNERS = "few_corners"
    LOW_CONTRAST = "low_contrast"
    SMALL_PRINT = "small_print"
    ELONGATED = "elongated"
    CROWDED = "crowded"
    FLAT = "flat"
    FEW_PIXELS = "few_pixels"
    TRANSPARENT = "transparent"
    ALIKE = "alike"
    AMBIGUOUS = "ambiguous"


#: What makes a target undependable by itself, and shows without any simulation.
LOAD_REASONS = (ReasonKind.SYMMETRIC, ReasonKind.REPEATS, ReasonKind.FEW_CORNERS)


@dataclass(frozen=True, slots=True)
class TargetReason:
    """Something that makes a target worse: which, in words, and what to change."""

    kind: ReasonKind
    text: str
    advice: str


@dataclass(frozen=True, slots=True, eq=False)
class TargetCheck:
    """What is known of one target.

    Attributes
    ----------
    name, entry : of it, and the entry of `targets.images`
    image : its picture
    score : 0 to 100
    reasons : the gravest first
    traits : of its picture; None: it cannot be used
    curve : share of views in which it is found; None: as above
    errors : expected ones, by size
    width_m : printed; 0: unknown, lengths are then in widths
    alike : names of others that are checked with it and share a part of its design
    """

    name: str
    entry: str
    image: TargetImage
    score: int
    reasons: tuple[TargetReason, ...]
    traits: Traits | None
    curve: FindingCurve | None
    errors: tuple[ExpectedError, ...]
    width_m: float
    alike: tuple[str, ...] = ()

    @property
    def is_dependable(self) -> bool:
        """Whether its score is high enough."""
        return self.score >= DEPENDABLE

    @property
    def smallest_width_px(self) -> float | None:
        """Width, px, seen straight on, from which on it is found in four of five views; None: it never is."""
        if self.curve is None or self.traits is None:
            return None
        longer = self.curve.smallest_px()
        return None if longer is None else longer * self.width_of_longer

    @property
    def width_of_longer(self) -> float:
        """Width over longer side."""
        t = self.traits
        return 1.0 if t is None else t.width_px / max(t.width_px, t.height_px)


def check_targets(
    images: Sequence[TargetImage],
    entries: Sequence[str],
    parameters: Parameters,
    camera: Camera,
    notes: Sequence[Sequence[str]] = (),
) -> tuple[TargetCheck, ...]:
    """Return what is known of each target.

    Parameters
    ----------
    images : as `load_target_images` returns them; of a bundle of markers each is checked by itself, of a
        family its first
    entries : of `targets.images`
    parameters : of the pipeline; `raw` and `camera` describe the user's frames, not those that are simulated
    camera : that shall see them
    notes : what loading said of each
    """
    parameters = _for_trials(parameters)
    targets = [
        (part, entry, notes[index] if index < len(notes) else ())
        for index, (image, entry) in enumerate(zip(images, entries, strict=True))
        for part in _parts_of(image)
    ]
    known = [replace(image, width_m=image.width_m or 1.0) for image, _, _ in targets]
    references = make_references(known, parameters, BuildCache())
    rivals = Rivals(references, DetectionParameters.of(parameters))
    return tuple(
        _checked(image, entry, reference, parameters, camera, said, tuple(rivals.of_one_design(reference.name)))
        for (image, entry, said), reference in zip(targets, references, strict=True)
    )


def _parts_of(image: TargetImage) -> Sequence[TargetImage]:
    """Return what is checked by itself: the markers of a bundle; of a family one stands for all."""
    if isinstance(image, BundleImage):
        return image.parts
    return (image.first,) if isinstance(image, FamilyImage) else (image,)


def target_scores(images: Sequence[TargetImage], parameters: Parameters) -> dict[str, int]:
    """Return the score of each target by name, without all else that a check says; some seconds for each.

    Parameters
    ----------
    images : as `load_target_images` returns them; things with markers on several planes are left out
    parameters : of the pipeline
    """
    parameters = _for_trials(parameters)
    planar = [part for image in images if not isinstance(image, BundleImage) for part in _parts_of(image)]
    known = [replace(image, width_m=image.width_m or 1.0) for image in planar]
    scores = {}
    for image, reference in zip(known, make_references(known, parameters, BuildCache()), strict=True):
        try:
            reference.require_detectable(parameters.homography.min_inliers)
            views = TrialViews(reference, replace(image, width_m=reference.width_m), DEFAULT_CAMERA)
            scores[image.name] = score_of(finding_curve(reference, views, parameters))
        except ImguError:  # it cannot be used
            scores[image.name] = 0
    return scores


def _for_trials(parameters: Parameters) -> Parameters:
    """Return the parameters for simulated frames, which are not those of the user's camera."""
    raw = RawParameters(significant_bits=_BITS, grey_weights=parameters.raw.grey_weights)
    return replace(parameters, raw=raw)


def _checked(
    image: TargetImage,
    entry: str,
    reference: Reference,
    parameters: Parameters,
    camera: Camera,
    notes: Sequence[str],
    alike: tuple[str, ...],
) -> TargetCheck:
    try:
        reference.require_detectable(parameters.homography.min_inliers)
        traits = traits_of(reference)
        views = TrialViews(reference, replace(image, width_m=reference.width_m), camera)
        curve = finding_curve(reference, views, parameters)
    except ImguError as error:
        reason = TargetReason(ReasonKind.NOT_USABLE, str(error), "take a picture with texture")
        return TargetCheck(image.name, entry, image, 0, (reason,), None, None, (), image.width_m, alike)
    smallest = curve.smallest_px() or curve.middle_px
    sizes = _sizes(smallest, min(camera.width, camera.height))
    errors = expected_errors(reference, views, parameters, sizes)
    reasons = (*reasons_of(traits, has_code=bool(reference.codes)), *_of_views(curve, errors))
    if isinstance(image, MarkerImage):
        # It is drawn at any size: no file has its pixels.
        reasons = tuple(reason for reason in reasons if reason.kind is not ReasonKind.FEW_PIXELS)
    reasons += (*_transparent(notes), *_alike(alike))
    return TargetCheck(image.name, entry, image, score_of(curve), reasons, traits, curve, errors, image.width_m, alike)


def score_of(curve: FindingCurve) -> int:
    """Return the share of views of `SCORE_PX` in which a target is found, percent; that of one that is dependable at no
    size is below `DEPENDABLE`.
    """
    low, high = (math.log(size) for size in SCORE_PX)
    middle = min(max(math.log(curve.middle_px), low), high)
    score = round(100 * curve.ceiling * (high - middle) / (high - low))
    return score if curve.smallest_px() is not None else min(score, DEPENDABLE - 1)


def reasons_of(traits: Traits, has_code: bool = False) -> Iterator[TargetReason]:
    """Yield what a target's picture makes worse, the gravest first.

    Parameters
    ----------
    traits : of it
    has_code : it is told from others, and how it is turned, by a code: neither corners nor detail matter
    """
    t = traits
    if has_code:
        return
    is_same = t.telling_share < _SAME
    same = "the same" if is_same else "much the same"
    telling = "" if is_same else f": {t.telling_share:.0%} of its detail tells it"
    if t.turns_deg and t.corners >= _HARDLY_ANY:
        yield TargetReason(
            ReasonKind.SYMMETRIC,
            f"looks {same} turned by {' or '.join(map(str, t.turns_deg))} degrees{telling}",
            "add something large on one side alone, that has no counterpart opposite",
        )
    if t.repeats and t.corners >= _HARDLY_ANY:
        yield TargetReason(
            ReasonKind.REPEATS,
            f"repeats itself: shifted by a period it looks {same}{telling}",
            "let every part look different: vary the pattern, or lay large things of several sorts over it",
        )
    if t.corners < _FEW_CORNERS or t.corners_from_px > _CORNERS_FROM_PX:
        yield TargetReason(
            ReasonKind.FEW_CORNERS,
            f"few corners: {t.corners} where it is seen 160 px long",
            "add shapes with corners and hard edges, large enough to be seen from afar",
        )
    if t.contrast < _LOW_CONTRAST:
        yield TargetReason(
            ReasonKind.LOW_CONTRAST,
            f"low contrast: grey values vary by {100 * t.contrast / 255:.0f} % of the range (light, not sRGB)",
            "make dark parts darker and light ones lighter; colours that differ in hue alone are one grey",
        )
    if t.lost_share > _LOST:
        yield TargetReason(
            ReasonKind.SMALL_PRINT,
            f"small print is lost at a distance: seen 64 px long, {t.lost_share:.0%} of the contrast is gone",
            "add things a tenth of the width and larger",
        )
    if t.elongation > _ELONGATED:
        yield TargetReason(
            ReasonKind.ELONGATED,
            f"elongated: {t.elongation:.1f} times as long as wide",
            "make it as wide as there is room for: the shorter side decides from how far it is found and how exactly "
            "it tells a rotation",
        )
    if t.crowded_share <= _CROWDED:
        yield TargetReason(
            ReasonKind.CROWDED,
            f"nine tenths of its detail lie in {t.crowded_share:.0%} of its area",
            "spread the detail to all sides and into the corners: a hand before it then hides less",
        )
    if t.flat_share > _FLAT:
        yield TargetReason(
            ReasonKind.FLAT,
            f"flat areas: {t.flat_share:.0%} of it has no detail",
            "fill empty areas, or crop them away and give the width of what is left",
        )
    if max(t.width_px, t.height_px) < _FEW_PX:
        yield TargetReason(
            ReasonKind.FEW_PIXELS,
            f"the file has few pixels: {t.width_px:.0f} x {t.height_px:.0f}",
            "take a larger file of the same picture: a camera that is near sees more than it holds",
        )


def _of_views(curve: FindingCurve, errors: Sequence[ExpectedError]) -> Iterator[TargetReason]:
    if errors and errors[-1].ambiguous_share >= _AMBIGUOUS and curve.smallest_px() is not None:
        yield TargetReason(
            ReasonKind.AMBIGUOUS,
            f"where it is seen {errors[-1].seen_px:.0f} px long, its pose often has two solutions, of which none is "
            "published",
            "print it larger, or tilt it towards the camera",
        )


def _transparent(notes: Sequence[str]) -> Iterator[TargetReason]:
    for note in notes:
        yield TargetReason(ReasonKind.TRANSPARENT, note, "save it as it is printed, without transparency")


def _alike(names: Sequence[str]) -> Iterator[TargetReason]:
    if names:
        yield TargetReason(
            ReasonKind.ALIKE,
            f"shares a part of its design with {', '.join(names)}",
            "let what differs be large: it alone tells them apart",
        )


def _sizes(smallest_px: float, frame_px: int) -> tuple[float, ...]:
    """Return the sizes at which errors are told, px: those that are simulated, and the smallest."""
    low, high = max(smallest_px, SIZES_PX[-1]), 0.75 * frame_px
    if low >= high:
        return (high,)
    count = max(3, 1 + math.ceil(2 * math.log2(high / low)))
    return tuple(high * (low / high) ** (index / (count - 1)) for index in range(count))
