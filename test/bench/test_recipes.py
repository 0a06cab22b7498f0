# SPDX-License-Identifier: Apache-2.0
"""The recipes do what a user would expect of them: no handicap."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imgu_ros.bench.measuring import MeasurementPlan, measure
from imgu_ros.bench.recipes import DETECTION, ORB, SIFT, TRACKING, Recipe, make_method
from imgu_ros.errors import ParameterError, ShapeError
from imgu_ros.reference.templates import TargetImage
from imgu_ros.simulate.conditions import PLAIN, condition_named
from imgu_ros.simulate.sequence import Simulation, simulate_sequence
from imgu_ros.simulate.trials import Trial, known_targets, trial_batches, trial_frames
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage


@pytest.mark.parametrize(("name", "most_px"), [(TRACKING, 0.05), (DETECTION, 0.05), (ORB, 2.0), (SIFT, 0.8)])
@pytest.mark.parametrize("condition", ["plain", "plumb-bob", "equidistant"])
def test_methods_find_the_target(name: str, most_px: float, condition: str) -> None:
    trial = Trial(condition_named(condition), 640, 480, frames=2)
    targets = known_targets(trial)
    measured = measure(MeasurementPlan([make_method(name, targets)], trial_batches(trial), targets))
    for sample in measured.samples:
        assert sample.corner_px is not None and sample.corner_px < most_px
        assert sample.rotation_deg is not None and sample.rotation_deg < 1.6
        assert sample.translation_percent is not None and sample.translation_percent < 0.4


@pytest.mark.parametrize("pattern", BayerPattern)
def test_colours_of_every_pattern_are_read_rightly(pattern: BayerPattern) -> None:
    # A frame whose pattern is misread has other greys, and a pattern of its own all over.
    simulation = Simulation(640, 480, frames=1, layout=PixelLayout(ColorModel.BAYER, pattern))
    trial = Trial(PLAIN, 640, 480, 1)
    (simulated,) = simulate_sequence(simulation, known_targets(trial))
    (answer,) = Recipe("sift", known_targets(trial)).answer(simulated.frame).answers
    assert answer.H is not None


def test_recipe_without_calibration_and_with_grey_frames() -> None:
    trial = Trial(PLAIN, 640, 480, 1)
    (simulated,) = trial_frames(trial)
    recipe = Recipe("orb", known_targets(trial))
    (answer,) = recipe.answer(replace(simulated.frame, camera=None)).answers
    assert answer.H is not None and answer.pose is None
    mono = RawImage(np.ascontiguousarray(simulated.frame.image.pixels), PixelLayout(ColorModel.MONO))
    assert recipe.answer(replace(simulated.frame, image=mono)).answers[0].target == "poster"


def test_blank_frame_is_lost() -> None:
    trial = Trial(PLAIN, 320, 180, 1)
    (simulated,) = trial_frames(trial)
    blank = RawImage(np.zeros((180, 320), np.uint8), simulated.frame.image.layout)
    for name in ("orb", "sift"):
        (answer,) = Recipe(name, known_targets(trial)).answer(replace(simulated.frame, image=blank)).answers
        assert answer.H is None and answer.reason == "no features"


def test_bad_input_is_refused() -> None:
    with pytest.raises(ParameterError, match="no features"):
        Recipe("orb", [TargetImage("grey", np.full((200, 200), 90, np.uint8), 0.5)])
    with pytest.raises(ShapeError, match="RecipeFeatures"):
        Recipe("surf", [])
    with pytest.raises(ParameterError, match="need one of tracking, detection, ORB, SIFT"):
        make_method("surf", [])
