# SPDX-License-Identifier: Apache-2.0
"""Every parameter, changed while a target is tracked: what is made anew, what of the track stays, what comes out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from imgu_ros.config.parameters import Declaration, declaration, declarations
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import ParameterError
from imgu_ros.frame import Frame
from imgu_ros.localizer import Localizer, PreparedLocalizer, prepare_localizer
from imgu_ros.reference import features as target_features
from imgu_ros.reference import templates as targets
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.result import Result, Status
from imgu_ros.simulate.sequence import Simulation, default_targets, simulate_sequence

BASE = parameters_from(
    {"pyramid.max_side_px": 400, "keypoints.max_count": 300, "search.max_side_px": 640, "search.max_count": 500}
)
#: Values of parameters that are not free to be anything, or that the default's neighbour would not try.
VALUES: dict[str, Any] = {
    "raw.gains": (1.1, 1.0, 1.2), "raw.grey_weights": (1.0, 1.0, 1.0), "raw.transfer": "srgb",
    "raw.black_level": 2.0, "raw.white_level": 250.0, "raw.band_weights": (1.0,), "raw.reference_spectrum": (1.0, 2.0),
    "raw.band_mode": "principal_component", "preprocess.smoothing_px": 0.7, "preprocess.gamma": 0.8,
    "preprocess.brightness": 10.0, "keypoints.detector": "harris", "descriptor.kind": "sift",
    "matching.metric": "hamming", "preprocess.threshold": "otsu", "refinement.window_px": 13,
    "homography.threshold_px": 2.5,
}  # fmt: skip
FRONT, CLOSE, THOROUGH, CORNERS, PYRAMIDS, PATCHES = "front", "close", "thorough", "corners", "pyramids", "patches"
DESCRIBED = {FRONT, CLOSE, THOROUGH}
#: What depends on a parameter; of every other, and of those that are still to come, nothing that is made of a target.
DEPENDS: dict[str, set[str]] = {
    **dict.fromkeys(
        ("preprocess.smoothing_px", "preprocess.contrast", "preprocess.brightness", "preprocess.gamma",
         "preprocess.equalisation", "preprocess.edges", "preprocess.threshold", "pyramid.scales_per_octave",
         "keypoints.detector", "descriptor.kind"),
        DESCRIBED,
    ),
    "pyramid.kernel": DESCRIBED | {PYRAMIDS, CORNERS, PATCHES},
    "raw.grey_weights": DESCRIBED | {PYRAMIDS, CORNERS, PATCHES},
    # A thorough search has more pixels and keypoints than these.
    "pyramid.max_side_px": {FRONT, CLOSE},
    "keypoints.max_count": {FRONT, CLOSE},
    "search.max_side_px": {THOROUGH},
    "search.max_count": {THOROUGH},
    # The octaves of the other transfer function, which were not needed before.
    "raw.transfer": {PYRAMIDS, CORNERS, PATCHES},
    "refinement.max_points": {CORNERS, PATCHES},
    "refinement.window_px": {PATCHES},
}  # fmt: skip


def live() -> list[str]:
    """Return the parameters that take effect while frames flow."""
    return [known.name for known in declarations() if not known.read_only and not known.name.startswith("targets.")]


def other_value(known: Declaration) -> Any:
    """Return a valid value that is not the one in force."""
    if known.name in VALUES:
        return VALUES[known.name]
    group, _, name = known.name.rpartition(".")
    now = getattr(getattr(BASE, group) if group else BASE, name)
    if known.choices:
        return next(choice for choice in known.choices if choice != now)
    if known.type_name == "bool":
        return not now
    if known.type_name == "string":
        return f"{now}x"
    if known.type_name in ("integer", "double"):
        step = max(1, now // 8) if known.type_name == "integer" else max(abs(now) / 8, 0.05)
        return now + step if known.bounds is None or now + step <= known.bounds[1] else now - step
    one = {"string": "x", "double": 1.0, "integer": 0}[known.type_name.removesuffix("_array")]
    for count in range(1, 101):
        try:
            parameters_from({known.name: [one] * count}, BASE)
        except ParameterError:
            continue
        return (one,) * count
    raise AssertionError(f"{known.name}: no list of {one} is taken; give VALUES one that is")


@pytest.fixture(scope="module")
def images() -> tuple[TargetImage, ...]:
    picture = default_targets(1, seed=3, width_m=0.5)[0]
    small = cv2.resize(picture.pixels, None, fx=0.4, fy=0.4, interpolation=cv2.INTER_AREA)
    return (TargetImage("poster", small, 0.5),)


@pytest.fixture(scope="module")
def frames(images: tuple[TargetImage, ...]) -> tuple[Frame, ...]:
    simulation = Simulation(width=480, height=360, frames=120, seed=3)
    return tuple(s.frame for s, _ in zip(simulate_sequence(simulation, images), range(8), strict=False))


@pytest.fixture(scope="module")
def prepared(images: tuple[TargetImage, ...]) -> PreparedLocalizer:
    return prepare_localizer(images, BASE)


@pytest.fixture
def tracking(prepared: PreparedLocalizer, frames: tuple[Frame, ...]) -> PreparedLocalizer:
    """A chain that has seen four frames, and all of whose parts are made."""
    prepared.localizer.reset()
    statuses = [prepared.localizer.process(frame).first.status for frame in frames[:4]]
    assert statuses == [Status.DETECTED, *[Status.TRACKED] * 3]
    return prepared


@pytest.fixture
def made(tracking: PreparedLocalizer, monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Counts what is made of targets from now on."""
    counts: Counter[str] = Counter()

    def counted(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            counts[name] += 1
            return function(*arguments, **named)

        return call

    monkeypatch.setattr(target_features, "_described", counted("descriptions", target_features._described))
    monkeypatch.setattr(targets, "build_pyramid", counted(PYRAMIDS, targets.build_pyramid))
    monkeypatch.setattr(targets, "_corners", counted(CORNERS, targets._corners))
    monkeypatch.setattr(targets, "TemplatePatches", counted(PATCHES, targets.TemplatePatches))
    return counts


def corners(result: Result, width: int, height: int) -> np.ndarray:
    """Return where the target's outer corners are, raw px."""
    homography = result.first.homography
    assert homography is not None, result.first.reason
    x, y, w = homography.H @ np.array([[0, width, width, 0], [0, 0, height, height], [1, 1, 1, 1]], float)
    return np.column_stack((x / w, y / w))


@pytest.mark.parametrize("name", live())
def test_a_change_makes_anew_what_depends_on_it_and_keeps_the_track(
    name: str,
    tracking: PreparedLocalizer,
    frames: tuple[Frame, ...],
    images: tuple[TargetImage, ...],
    made: Counter[str],
) -> None:
    parameters = parameters_from({name: other_value(declaration(name))}, BASE)
    assert parameters != BASE
    changed = prepare_localizer(images, parameters, tracking)
    changed.localizer.continue_from(tracking.localizer)
    went_on = [changed.localizer.process(frame) for frame in frames[4:6]]
    depends = DEPENDS.get(name, set())
    assert made["descriptions"] == sum({FRONT: 1, CLOSE: 1, THOROUGH: 5}.get(part, 0) for part in depends)
    assert {part for part in (PYRAMIDS, CORNERS, PATCHES) if made[part]} == depends - DESCRIBED
    first = went_on[0].first.status
    assert first is (Status.DETECTED if name == "tracking.enabled" else Status.TRACKED)

    fresh = Localizer(parameters, prepare_references(images, parameters))
    truth = [fresh.process(frame) for frame in frames[4:6]]
    size = changed.references[0].size
    for mine, other in zip(went_on, truth, strict=True):
        # Alignment ends within a tenth of a pixel of wherever it begins; without it keypoints alone tell of the first.
        alone = name == "refinement.enabled"
        assert_allclose(corners(mine, *size), corners(other, *size), atol=5.0 if alone else 0.1)
    # From the next detection on there is no difference at all.
    changed.localizer.reset()
    fresh.reset()
    for frame in frames[6:]:
        mine, other = (chain.process(frame).first for chain in (changed.localizer, fresh))
        assert mine.status is other.status
        assert mine.homography is not None and other.homography is not None
        assert_array_equal(mine.homography.H, other.homography.H)
        assert_array_equal(mine.homography.covariance, other.homography.covariance)


def test_targets_come_and_go_and_the_others_stay_tracked(
    tracking: PreparedLocalizer, frames: tuple[Frame, ...], images: tuple[TargetImage, ...], made: Counter[str]
) -> None:
    other = TargetImage("other", default_targets(1, seed=9)[0].pixels[:240, :320].copy(), 0.2)
    both = prepare_localizer((other, images[0]), BASE, tracking)
    both.localizer.continue_from(tracking.localizer)
    assert made["descriptions"] == 7
    result = both.localizer.process(frames[4])
    assert [target.status for target in result] == [Status.LOST, Status.TRACKED]
    alone = prepare_localizer(images, BASE, both)
    alone.localizer.continue_from(both.localizer)
    assert made["descriptions"] == 7
    assert alone.localizer.process(frames[5]).first.status is Status.TRACKED
    # As `~/reload` does: read again, described again, and the same picture.
    again = TargetImage("poster", images[0].pixels.copy(), 0.7)
    read_again = prepare_localizer([again], BASE, alone)
    read_again.localizer.continue_from(alone.localizer)
    assert made["descriptions"] == 14
    assert read_again.localizer.process(frames[6]).first.status is Status.TRACKED
    # Another picture under the same name is another target.
    turned = replace(images[0], pixels=np.ascontiguousarray(images[0].pixels[::-1, ::-1]))
    another = prepare_localizer([turned], BASE, read_again)
    another.localizer.continue_from(read_again.localizer)
    assert another.localizer.process(frames[7]).first.status is Status.DETECTED


def test_tracks_do_not_outlive_tracking(tracking: PreparedLocalizer, frames: tuple[Frame, ...], images: Any) -> None:
    off = prepare_localizer(images, parameters_from({"tracking.enabled": False}, BASE), tracking)
    off.localizer.continue_from(tracking.localizer)
    on = prepare_localizer(images, BASE, off)
    on.localizer.continue_from(off.localizer)
    assert on.localizer.process(frames[4]).first.status is Status.DETECTED
