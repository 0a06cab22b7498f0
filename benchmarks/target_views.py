# SPDX-License-Identifier: Apache-2.0
"""How small a print may be seen and still be found: views of every size and tilt, judged by exact truth.

Views are those of `print_views.py`: nothing of `imgu_ros.simulate` is used. The longer side is 24 to 384 px, in eight
steps of a factor of sqrt(2), drawn anew for each view within its step; the tilt is in each of four steps of 15 degrees,
the roll and the direction of the tilt are any. Each view is one by itself: tracking is off.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from print_drawing import Print
from print_judging import RECIPES, Recipe, corner_rms, rotation_vector, squared_error
from print_views import HEIGHT, WIDTH, Light, View, background, developed, inside_share, placed, rendered

from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import ImguError
from imgu_ros.localizer import Localizer
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import make_references
from imgu_ros.result import ReferenceResult

Floats = NDArray[np.floating]

#: Longer side of the smallest views, px, number of steps, and the factor between them.
SMALLEST_PX, STEPS, FACTOR = 24.0, 8, math.sqrt(2)
TILTS_DEG = ((0.0, 15.0), (15.0, 30.0), (30.0, 45.0), (45.0, 60.0))
#: Found is a homography whose outer corners are right to this share of the longer side, and at most so many px, rms.
RIGHT_SHARE, RIGHT_PX = 0.15, 10.0
#: After so many steps in which nothing was found the smaller ones count as not found, too.
_HOPELESS = 2


@dataclass(frozen=True)
class ViewOutcome:
    """What became of one view.

    Attributes
    ----------
    step : of the size, the smallest is 0
    seen_px : longer side, were it seen straight on
    tilt_deg : of the view
    found, wrong : with the right homography; with another
    distance_m : of the print's centre
    position_m, rotation_rad, nees : errors of the published pose; None: none
    sift : whether SIFT's recipe finds it
    """

    step: int
    seen_px: float
    tilt_deg: float
    found: bool
    wrong: bool
    distance_m: float
    position_m: float | None = None
    rotation_rad: float | None = None
    nees: float | None = None
    sift: bool | None = None


def sized_view(shown: Print, seed: int, step: int, tilt: int, index: int) -> tuple[View, float]:
    """Return a view, and the longer side of the print in it, px; equal arguments give the same."""
    rng = np.random.default_rng([seed, step, tilt, index, zlib.crc32(shown.kind.encode())])
    while True:
        seen = SMALLEST_PX * FACTOR ** (step + rng.uniform(0, 1))
        angle = math.radians(rng.uniform(*TILTS_DEG[tilt]))
        placement = placed(shown, seen, angle, *rng.uniform(0, 2 * math.pi, 2), rng.uniform((0, 0), (WIDTH, HEIGHT)))
        if inside_share(placement.homography(shown), shown) > 0.999:
            return rendered(shown, placement, background(rng), Light.drawn(rng), rng, 30 * index), seen


def outcomes(
    shown: Print, seed: int, parameters: Parameters, each: int = 1, recipes: bool = False
) -> Iterator[ViewOutcome]:
    """Yield what becomes of the views of a print, the largest first: `each` of every size and tilt."""
    image = TargetImage(shown.name, shown.pixels, shown.width_m)
    parameters = parameters_from({"tracking.enabled": False}, parameters)
    try:
        localizer = Localizer(parameters, make_references([image], parameters))
        localizer.prepare()
    except ImguError:
        localizer = None
    recipe = Recipe.of(RECIPES[0], shown) if recipes else None
    unfound = 0
    for step in reversed(range(STEPS)):
        some = False
        for tilt in range(len(TILTS_DEG)):
            for index in range(each):
                if unfound >= _HOPELESS:
                    mean = SMALLEST_PX * FACTOR ** (step + 0.5)
                    yield ViewOutcome(step, mean, sum(TILTS_DEG[tilt]) / 2, False, False, 0.0, sift=False)
                    continue
                view, seen = sized_view(shown, seed, step, tilt, index)
                result = localizer.process(view.frame).first if localizer else None
                outcome = judged(result, view, shown, step, seen)
                if recipe is not None:
                    H = recipe.homography(cv2.cvtColor(developed(view.frame), cv2.COLOR_RGB2GRAY))
                    outcome = ViewOutcome(
                        **{**_fields(outcome), "sift": H is not None and is_right(H, view, shown, seen)}
                    )
                some |= outcome.found or bool(outcome.sift)
                yield outcome
        unfound = 0 if some else unfound + 1


def is_right(H: Floats, view: View, shown: Print, seen_px: float) -> bool:
    """Return whether a homography puts the outer corners where they are."""
    return corner_rms(H, view.H, shown) <= min(RIGHT_SHARE * seen_px, RIGHT_PX)


def judged(result: ReferenceResult | None, view: View, shown: Print, step: int, seen_px: float) -> ViewOutcome:
    """Return what a view is worth: what the pipeline says, compared with the truth."""
    distance = float(np.linalg.norm(view.t))
    if result is None or result.homography is None:
        return ViewOutcome(step, seen_px, view.tilt_deg, False, False, distance)
    right = is_right(result.homography.H, view, shown, seen_px)
    pose = result.pose
    if not right or pose is None:
        # Of places where it looks the same, none is told to be the right one.
        return ViewOutcome(step, seen_px, view.tilt_deg, right and not result.alike, not right, distance)
    return ViewOutcome(
        step, seen_px, view.tilt_deg, True, False, distance, float(np.linalg.norm(view.t - pose.t)),
        float(np.linalg.norm(rotation_vector(view.R @ pose.R.T))),
        squared_error(pose.R, pose.t, pose.covariance, view.R, view.t),
    )  # fmt: skip


def _fields(outcome: ViewOutcome) -> dict[str, object]:
    return {name: getattr(outcome, name) for name in ViewOutcome.__dataclass_fields__}
