# SPDX-License-Identifier: Apache-2.0
"""The nearest known name in error messages."""

from __future__ import annotations

import pytest

from imgu_ros.config.parameters import declaration
from imgu_ros.errors import EncodingError, ParameterError, nearest_name
from imgu_ros.messages.encodings import encoding_named

KNOWN = ("mono8", "bayer_rggb8", "8UC1", "PLUMB_BOB")


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("BAYER_RGBG8", "bayer_rggb8"),
        ("Mono9", "mono8"),
        ("8uc9", "8UC1"),
        ("plumbob", "PLUMB_BOB"),
        ("h264", ""),
        ("", ""),
        ("theora", ""),
        ("mono8" * 10_000, ""),
    ],
)
def test_case_does_not_matter_and_nothing_near_is_not_named(name, near):
    assert nearest_name(name, KNOWN) == near


def test_without_known_names():
    assert nearest_name("mono8", ()) == ""


def test_errors_are_silent_when_nothing_is_near():
    with pytest.raises(EncodingError) as caught:
        encoding_named("rainbow")
    assert "nearest" not in str(caught.value)
    with pytest.raises(ParameterError) as caught:
        declaration("xyzzy")
    assert str(caught.value) == "xyzzy: unknown parameter; `imgu params --all` lists the parameters"
    with pytest.raises(ParameterError, match=r"Homography.Treshold_px: .*nearest known: homography.threshold_px"):
        declaration("Homography.Treshold_px")
