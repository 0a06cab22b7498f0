# SPDX-License-Identifier: Apache-2.0
"""What is odd about headers: each kind once, with its numbers, and gone when it is over."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from imgu_ros.messages.header import decode_header
from imgu_ros.messages.header_checks import HeaderChecks, Oddity


def message(stamp_ns: int, frame_id: str = "eye") -> Any:
    stamp = SimpleNamespace(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return SimpleNamespace(header=SimpleNamespace(stamp=stamp, frame_id=frame_id))


def checked(*stamps_ns: int, frame_id: str = "eye", info: str = "eye") -> HeaderChecks:
    checks = HeaderChecks("/cam/image_raw", "/cam/camera_info")
    for stamp_ns in stamps_ns:
        checks.add_image(message(stamp_ns, frame_id))
        checks.add_camera_info(message(stamp_ns, info))
    return checks


def test_two_cameras_in_turn_are_told_and_their_stamps_are_looked_at_apart() -> None:
    checks = HeaderChecks("/cam/image_raw", "/cam/camera_info")
    for stamp_ns in range(10**9, 5 * 10**9, 10**8):
        for name in ("left", "right"):
            checks.add_image(message(stamp_ns, name))
            checks.add_camera_info(message(stamp_ns, name))
    told = checks.told()
    assert list(told) == [Oddity.SHARED]
    assert told[Oddity.SHARED].startswith(
        "/cam/image_raw carries images of several cameras: each frame_id ('left', 'right') is"
    )
    assert checks.cameras == ("left", "right")
    assert list(checks.told("eye")) == [Oddity.SHARED], "frames.camera does not make them one"
    for stamp_ns in range(5 * 10**9, 40 * 10**9, 10**8):
        checks.add_image(message(stamp_ns, "left"))
    assert checks.cameras == ()
    assert checks.told(lately=True) == {}


def test_a_name_that_changes_once_is_one_camera() -> None:
    checks = checked(*range(10**9, 2 * 10**9, 10**8), frame_id="old", info="old")
    for stamp_ns in range(2 * 10**9, 3 * 10**9, 10**8):
        checks.add_image(message(stamp_ns, "new"))
    assert Oddity.SHARED not in checks.told()


def test_usual_headers_are_not_odd() -> None:
    assert checked(*range(10**9, 5 * 10**9, 10**8)).told() == {}
    assert checked(0, 33, 66).told() == {}, "a simulation begins at 0"


@pytest.mark.parametrize(
    ("stamps_ns", "oddity", "said"),
    [
        ((0, 0, 0), Oddity.ZERO, "are 0 in 2 of 3 images"),
        ((7 * 10**9, 0, 8 * 10**9), Oddity.ZERO, "are 0 in 1 of 3 images"),
        ((7 * 10**9, 0, 10**8), Oddity.JUMP, "jump back in 1 of 3 images (first by 6.9 s at 100000000 ns)"),
        ((5, 5, 6, 6), Oddity.REPEATED, "are repeated in 2 of 4 images (first at 5 ns)"),
        ((10**9, 10**9 - 1000), Oddity.FALLING, "fall in 1 of 2 images (first by 1e-06 s at 999999000 ns)"),
        ((9 * 10**9, 10**9), Oddity.JUMP, "jump back in 1 of 2 images (first by 8 s at 1000000000 ns)"),
    ],
)
def test_stamps(stamps_ns: tuple[int, ...], oddity: Oddity, said: str) -> None:
    told = checked(*stamps_ns).told()
    assert list(told) == [oddity]
    assert told[oddity].startswith(f"stamps of /cam/image_raw {said}")


@pytest.mark.parametrize(
    ("frame_id", "info", "oddities"),
    [
        ("/eye", "eye", [Oddity.SLASH]),
        ("/eye", "/eye", [Oddity.SLASH]),
        ("", "", [Oddity.NO_FRAME]),
        ("/", "", [Oddity.SLASH, Oddity.NO_FRAME]),
        ("eye", "base", [Oddity.OTHER_FRAME]),
    ],
)
def test_names_of_frames(frame_id: str, info: str, oddities: list[Oddity]) -> None:
    checks = checked(1, 2, 3, frame_id=frame_id, info=info)
    assert list(checks.told()) == oddities
    assert checks.told("eye") == {}, "frames.camera stands for all of them"
    assert decode_header(message(1, frame_id)).frame_id == frame_id.lstrip("/")


def test_what_is_over_is_not_told_for_ever() -> None:
    checks = checked(5, 5, *range(6, 305))
    assert checks.told(lately=True)
    checks.add_image(message(400))
    assert checks.told(lately=True) == {}
    assert checks.told()
