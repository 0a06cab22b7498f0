# SPDX-License-Identifier: Apache-2.0
"""What an image message says of its pixels, in a word."""

from __future__ import annotations

from typing import Any

_LONGEST = 40


def described_encoding(message: Any) -> str:
    """Return the encoding of a sensor_msgs/Image, or the format of a CompressedImage, at most 40 characters of it."""
    text = str(getattr(message, "encoding", getattr(message, "format", "")))
    return " ".join(text.split())[:_LONGEST]
