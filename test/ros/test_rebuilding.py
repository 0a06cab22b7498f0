# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import threading
import time
from dataclasses import replace

import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import ShapeError
from imgu_ros.localizer import PreparedLocalizer, prepare_localizer
from imgu_ros.reference.templates import TargetImage
from imgu_ros.ros import rebuilding
from imgu_ros.ros.rebuilding import Rebuilder
from imgu_ros.simulate.texture import procedural_texture

CHEAP = parameters_from({"search.thorough": False, "keypoints.max_count": 100})


@pytest.fixture(scope="module")
def built() -> PreparedLocalizer:
    return prepare_localizer([TargetImage("poster", procedural_texture(160, 120), 0.5)], CHEAP)


def taken(rebuilder: Rebuilder) -> PreparedLocalizer:
    end = time.monotonic() + 20
    while (done := rebuilder.take()) is None:
        assert time.monotonic() < end
        time.sleep(0.005)
    return done


def test_targets_are_used_again_where_parameters_make_no_difference_to_them(built):
    later = prepare_localizer(built.images, replace(CHEAP, seed=7), built)
    assert later.references == built.references
    assert later.localizer is not built.localizer
    fewer = prepare_localizer(built.images, parameters_from({"keypoints.max_count": 50}, CHEAP), built)
    assert fewer.references != built.references
    assert len(fewer.references[0].features.described.keypoints) < len(built.references[0].features.described.keypoints)


def test_the_newest_is_made_and_only_once(built):
    failed: list[str] = []
    rebuilder = Rebuilder(failed.append)
    asked = [replace(CHEAP, seed=seed) for seed in range(1, 20)]
    for parameters in asked:
        rebuilder.ask(built, parameters)
    while (done := taken(rebuilder)).parameters is not asked[-1]:
        pass
    assert done.images is built.images
    rebuilder.ask(built, asked[-1])
    assert rebuilder.close(5.0)
    assert rebuilder.take() is None
    assert not failed


def test_what_cannot_be_made_is_said_once_and_the_next_is_made(built):
    failed: list[str] = []
    rebuilder = Rebuilder(failed.append)
    poor = parameters_from({"homography.min_inliers": 90, "keypoints.max_count": 90}, CHEAP)
    plain = replace(built, images=(TargetImage("poster", procedural_texture(40, 40), 0.5),))
    rebuilder.ask(plain, poor)
    end = time.monotonic() + 20
    while not failed and time.monotonic() < end:
        rebuilder.ask(plain, poor)
        time.sleep(0.005)
    assert len(failed) == 1
    assert failed[0].startswith("parameters: target poster: ")
    assert failed[0].endswith("; the old parameters stay in use")
    rebuilder.ask(built, replace(CHEAP, seed=3))
    assert taken(rebuilder).parameters.seed == 3
    assert rebuilder.close(5.0)


def test_what_is_forgotten_is_not_taken(built, monkeypatch):
    may_go_on = threading.Event()
    made = rebuilding.prepare_localizer

    def slow(*arguments: object) -> PreparedLocalizer:
        assert may_go_on.wait(20)
        return made(*arguments)

    monkeypatch.setattr(rebuilding, "prepare_localizer", slow)
    rebuilder = Rebuilder(lambda _: None)
    rebuilder.ask(built, replace(CHEAP, seed=5))
    time.sleep(0.05)
    rebuilder.forget()
    may_go_on.set()
    assert rebuilder.close(20.0)
    assert rebuilder.take() is None


def test_an_image_that_cannot_serve_is_an_error():
    with pytest.raises(ShapeError, match="target poster"):
        prepare_localizer([TargetImage("poster", procedural_texture(160, 120).astype(float), 0.5)], Parameters())
