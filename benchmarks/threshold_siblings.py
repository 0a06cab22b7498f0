# SPDX-License-Identifier: Apache-2.0
"""Views of drawn prints, with exact truth, on which `thresholds.py` compares values of a constant.

The prints and views are those of `printed_targets.py`, of seeds of their own: labels, cards and pages with another
print of the same design, and prints with patterns finer than the pixels. See `threshold_trials.py`.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from print_drawing import SERIES, Print, prints
from print_judging import FOUND_PX, corner_rms
from print_views import RAW_PARAMETERS, View, views
from threshold_trials import Figures, Run

from imgu_ros.config.components import DevelopmentParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.image.frame_image import FrameImage, develop_frame
from imgu_ros.localizer import Localizer
from imgu_ros.reference import verification
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references

_SEED = 7100
_SIBLINGS = tuple(draw.__name__ for draw in SERIES)
#: Prints without another one of their design: fine patterns, photographs, paper.
_ALONE = ("halftone", "photograph", "terrazzo", "price_label", "business_card", "barcode")


@dataclass(frozen=True, slots=True, eq=False)
class _Case:
    """A target, and a frame that shows it, or a sibling, where `view` says."""

    reference: Reference
    image: FrameImage
    view: View


def _reference(shown: Print, parameters: Parameters) -> Reference:
    return prepare_references([TargetImage(shown.name, shown.pixels, shown.width_m)], parameters)[0]


def _cases(known: Print, shown: Print, count: int, parameters: Parameters) -> list[_Case]:
    reference, made = _reference(known, parameters), []
    for view in views(shown, _SEED, count, "detection"):
        image = develop_frame(view.frame, DevelopmentParameters.of(parameters)).image
        assert image is not None
        made.append(_Case(reference, image, view))
    return made


def contradictions(quick: bool) -> Run:
    """Share of true poses that are confirmed, of prints also behind hands, and of those of siblings in their place."""
    parameters, count = parameters_from(RAW_PARAMETERS), 4 if quick else 24
    own: list[_Case] = []
    other: list[_Case] = []
    for shown in prints(_SEED, _SIBLINGS[:1] if quick else (*_SIBLINGS, *_ALONE)):
        own += _cases(shown, shown, count, parameters)
        other += [case for sibling in shown.siblings for case in _cases(shown, sibling, count, parameters)]
    groups = {
        "own": [case for case in own if not case.view.occluded],
        "own_hidden": [case for case in own if case.view.occluded],
        "sibling": [case for case in other if not case.view.occluded],
        "sibling_hidden": [case for case in other if case.view.occluded],
    }

    def run() -> Figures:
        start = time.thread_time()
        figures = {f"{name}_confirmed": _confirmed(cases) for name, cases in groups.items()}
        return figures | {"cpu_ms": 1e3 * (time.thread_time() - start) / (len(own) + len(other))}

    return run


def _confirmed(cases: Sequence[_Case]) -> float:
    found = [verification.evidence(case.image, case.reference, case.view.H, None) for case in cases]
    return float(np.mean([each is not None and each.is_confirming for each in found]))


def covered(quick: bool) -> Run:
    """Single frames of prints behind hands or partly outside the frame: share found, wrong ones, and corner errors."""
    parameters = parameters_from({**RAW_PARAMETERS, "tracking.enabled": False})
    shown = prints(_SEED, ("price_label", "photograph") if quick else (*_SIBLINGS, *_ALONE))
    made = [
        (each, [v for v in views(each, _SEED, 8 if quick else 24, "detection") if v.visible < 0.9]) for each in shown
    ]
    localizers = [Localizer(parameters, [_reference(each, parameters)]) for each in shown]

    def run() -> Figures:
        errors: list[float] = []
        for (each, seen), localizer in zip(made, localizers, strict=True):
            for view in seen:
                result = localizer.process(view.frame).first
                if result.homography is not None:
                    errors.append(corner_rms(result.homography.H, view.H, each))
        right = [error for error in errors if error <= FOUND_PX]
        return {
            "found": len(right) / sum(len(seen) for _, seen in made),
            "wrong": float(len(errors) - len(right)),
            "corner_px": float(np.median(right)),
            "corner_95_px": float(np.percentile(right, 95)),
        }

    return run
