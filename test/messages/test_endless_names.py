# SPDX-License-Identifier: Apache-2.0
"""Names in messages of any length: they cost no time, and what goes on of them is short and tells them apart."""

from __future__ import annotations

import time
import zlib
from types import SimpleNamespace as Message

import numpy as np
import pytest

from imgu_ros.errors import EncodingError, ImguError
from imgu_ros.messages.compressed_image import decode_compressed_image
from imgu_ros.messages.distortion_names import named_lens
from imgu_ros.messages.encodings import encoding_named, is_image_encoding
from imgu_ros.messages.header import LONGEST_FRAME_ID, decode_header
from imgu_ros.messages.header_checks import HeaderChecks

ENDLESS = "/\x1b[2J" + "camera_" * 3_000_000 + "end"


def message(frame_id: str, seconds: int = 1, nanoseconds: int = 0) -> Message:
    return Message(header=Message(stamp=Message(sec=seconds, nanosec=nanoseconds), frame_id=frame_id))


def test_a_frame_id_as_it_is_up_to_the_bound_and_beyond_it_short_and_told_apart() -> None:
    at_most = "é" * LONGEST_FRAME_ID
    assert decode_header(message(at_most)).frame_id == at_most
    short = decode_header(message(ENDLESS)).frame_id
    assert len(short) < 300 and short.startswith("\x1b[2Jcamera_") and short.endswith("camera_end")
    assert f"({len(ENDLESS)} characters, CRC-32 {zlib.crc32(ENDLESS.encode()):08x})" in short
    other = ENDLESS[: len(ENDLESS) // 2] + "X" + ENDLESS[len(ENDLESS) // 2 + 1 :]
    assert decode_header(message(other)).frame_id != short


@pytest.mark.parametrize("seconds", [-(2**31), 2**31 - 1, -(2**63), 2**63])
def test_stamps_at_the_ends(seconds: int) -> None:
    assert decode_header(message("camera", seconds, 2**32 - 1)).stamp_ns == seconds * 10**9 + 999_999_999


def test_what_is_said_of_headers_is_short_and_does_not_act() -> None:
    checks = HeaderChecks("/image", "/camera_info")
    checks.add_image(message(ENDLESS))
    checks.add_camera_info(message("other" + ENDLESS))
    lines = checks.told().values()
    assert len(lines) >= 2
    for line in lines:
        assert len(line) < 2000 and "\x1b" not in line


def test_names_of_encodings_formats_and_models_cost_no_time() -> None:
    started = time.perf_counter()
    for _ in range(20):
        assert not is_image_encoding(ENDLESS)
        with pytest.raises(EncodingError, match="is unknown"):
            encoding_named(ENDLESS)
        with pytest.raises(EncodingError, match="is unknown"):
            named_lens(ENDLESS, (0.1, 0.0))
        with pytest.raises(ImguError) as raised:
            decode_compressed_image(Message(format=ENDLESS, data=np.zeros(10, np.uint8)))
        assert len(str(raised.value)) < 2000 and "\x1b" not in str(raised.value)
    assert time.perf_counter() - started < 2
