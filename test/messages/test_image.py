# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
import re
import struct

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.config.parameters import DemosaicParameters, RawParameters
from imgu_ros.errors import EncodingError
from imgu_ros.image.frame_image import develop
from imgu_ros.messages.encodings import encoding_for, encoding_named, is_image_encoding
from imgu_ros.messages.header import Header
from imgu_ros.messages.image import decode_image, image_message
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout

HEADER = Header(1_700_000_000_123_456_789, "camera")

#: name: (struct code, channels, layout), written down independently of the codec's table.
ENCODINGS = {
    "mono8": ("B", 1, PixelLayout(ColorModel.MONO)),
    "mono16": ("H", 1, PixelLayout(ColorModel.MONO)),
    "rgb8": ("B", 3, PixelLayout(ColorModel.RGB)),
    "bgr8": ("B", 3, PixelLayout(ColorModel.BGR)),
    "rgba8": ("B", 4, PixelLayout(ColorModel.RGBA)),
    "bgra8": ("B", 4, PixelLayout(ColorModel.BGRA)),
    "rgb16": ("H", 3, PixelLayout(ColorModel.RGB)),
    "bgr16": ("H", 3, PixelLayout(ColorModel.BGR)),
    "rgba16": ("H", 4, PixelLayout(ColorModel.RGBA)),
    "bgra16": ("H", 4, PixelLayout(ColorModel.BGRA)),
    "argb8": ("B", 4, PixelLayout(ColorModel.ARGB)),
    "argb16": ("H", 4, PixelLayout(ColorModel.ARGB)),
    "uyvy": ("B", 2, PixelLayout(ColorModel.UYVY)),
    "yuv422": ("B", 2, PixelLayout(ColorModel.UYVY)),
    "yuyv": ("B", 2, PixelLayout(ColorModel.YUYV)),
    "yuv422_yuy2": ("B", 2, PixelLayout(ColorModel.YUYV)),
    **{
        f"bayer_{p}{bits}": (code, 1, PixelLayout(ColorModel.BAYER, BayerPattern(p)))
        for p in ("rggb", "bggr", "grbg", "gbrg")
        for bits, code in ((8, "B"), (16, "H"))
    },
    **{
        f"{depth}C{n}": (code, n, PixelLayout(ColorModel.BANDS))
        for depth, code in {"8U": "B", "8S": "b", "16U": "H", "16S": "h", "32S": "i", "32F": "f", "64F": "d"}.items()
        for n in (1, 2, 3, 4, 7, 31)
    },
    "16U": ("H", 1, PixelLayout(ColorModel.BANDS)),
}


def hand_made(make, encoding: str, width: int, height: int, padding: int, big_endian: bool):
    """A message packed value by value, and those values."""
    code, channels, _ = ENCODINGS[encoding]
    generator = np.random.default_rng(3)
    raw = generator.integers(0, 256, (height, width * channels * struct.calcsize(code)), np.uint8)
    if code in "fd":  # random bytes would hold NaN
        values = generator.normal(size=(height, width * channels)).astype(code)
    else:
        values = raw.view(code)
    order = ">" if big_endian else "<"
    data = b"".join(
        struct.pack(f"{order}{width * channels}{code}", *row) + b"\xee" * padding for row in values.tolist()
    )
    message = make(
        "sensor_msgs/msg/Image",
        header=make("std_msgs/msg/Header", frame_id="camera"),
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=int(big_endian),
        step=len(data) // height,
        data=np.frombuffer(data, np.uint8),
    )
    shape = (height, width) if channels == 1 else (height, width, channels)
    return message, values.reshape(shape)


@pytest.mark.parametrize("big_endian", [False, True], ids=["little", "big"])
@pytest.mark.parametrize("padding", [0, 3, 16])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_encoding_padding_and_byte_order(make, encoding, padding, big_endian):
    message, expected = hand_made(make, encoding, 6, 5, padding, big_endian)
    image = decode_image(message)
    assert image.layout == ENCODINGS[encoding][2]
    assert image.pixels.dtype == expected.dtype
    assert image.pixels.dtype.isnative
    np.testing.assert_array_equal(image.pixels, expected)
    with pytest.raises(ValueError, match="read-only"):
        image.pixels[0, 0] = 1

    # And back: the same bytes, from pixels.
    again = image_message(make, HEADER, expected, encoding, row_padding=padding, big_endian=big_endian)
    assert (again.width, again.height, again.step) == (message.width, message.height, message.step)
    assert (again.encoding, again.is_bigendian) == (encoding, int(big_endian))
    np.testing.assert_array_equal(
        np.frombuffer(again.data, np.uint8).reshape(5, -1)[:, : message.step - padding],
        np.frombuffer(message.data, np.uint8).reshape(5, -1)[:, : message.step - padding],
    )


def _message(make, encoding, width, data):
    header, pixels = make("std_msgs/msg/Header", frame_id="camera"), np.frombuffer(data, np.uint8)
    fields = {"height": 1, "width": width, "encoding": encoding, "is_bigendian": 0, "step": len(data), "data": pixels}
    return make("sensor_msgs/msg/Image", header=header, **fields)


@pytest.mark.parametrize(("order", "encoding"), [("<", "bgra8"), (">", "argb8")])
def test_words_of_32_bits_are_bytes_in_an_order(make, order, encoding):
    # A program that writes 0xAARRGGBB as uint32 leaves B G R A in memory, or A R G B on a big-endian machine.
    words = [0xFF112233, 0x80AABBCC]
    image = decode_image(_message(make, encoding, 2, struct.pack(f"{order}2I", *words)))
    alpha, red, green, blue = (
        image.pixels[0, :, "argb".index(c) if encoding == "argb8" else "bgra".index(c)] for c in "argb"
    )
    assert (alpha.tolist(), red.tolist()) == ([0xFF, 0x80], [0x11, 0xAA])
    assert (green.tolist(), blue.tolist()) == ([0x22, 0xBB], [0x33, 0xCC])


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("order", ["rgb", "bgr", "rgba", "bgra", "argb"])
def test_every_channel_order_ends_in_the_same_colors(make, order, bits):
    # From bytes through the codec and the pipeline's first stage; alpha must not matter.
    dtype = np.dtype(f"u{bits // 8}")
    rgb = np.random.default_rng(2).integers(0, 2**bits, (4, 6, 3)).astype(dtype)
    planes = dict(zip("rgba", (*np.moveaxis(rgb, 2, 0), np.full((4, 6), 77, dtype)), strict=True))
    pixels = np.stack([planes[channel] for channel in order], axis=2)
    for padding, big_endian in ((0, False), (5, True)):
        message = image_message(make, HEADER, pixels, f"{order}{bits}", row_padding=padding, big_endian=big_endian)
        color = develop(decode_image(message), RawParameters(), DemosaicParameters()).color()
        np.testing.assert_array_equal(color, rgb)


@pytest.mark.parametrize(("encoding", "padding"), [("bayer_rggb8", 3), ("bayer_rggb16", 32), ("rgb8", 0), ("rgb16", 2)])
def test_pixels_are_a_view_of_the_message(make, encoding, padding):
    message, _ = hand_made(make, encoding, 6, 5, padding, big_endian=False)
    pixels = decode_image(message).pixels
    assert np.shares_memory(pixels, np.frombuffer(message.data, np.uint8))
    assert pixels.strides[0] == message.step


def test_byte_order_means_nothing_for_8_bit(make):
    message, expected = hand_made(make, "bayer_gbrg8", 6, 5, 0, big_endian=True)
    pixels = decode_image(message).pixels
    np.testing.assert_array_equal(pixels, expected)
    assert np.shares_memory(pixels, np.frombuffer(message.data, np.uint8))


def test_pixels_that_are_not_aligned_are_copied(make):
    message, expected = hand_made(make, "bayer_rggb16", 6, 5, 1, big_endian=False)  # odd step
    pixels = decode_image(message).pixels
    assert pixels.flags.aligned
    assert pixels.flags.c_contiguous
    np.testing.assert_array_equal(pixels, expected)


def test_extra_bytes_after_the_last_row_are_ignored_and_said(make):
    message, expected = hand_made(make, "mono16", 6, 5, 0, big_endian=False)
    assert decode_image(message).remark == ""
    data = np.frombuffer(message.data, np.uint8)
    image = decode_image(with_fields(make, message, data=np.append(data, np.uint8([1, 2, 3]))))
    np.testing.assert_array_equal(image.pixels, expected)
    assert image.remark == "data: 63 bytes, 3 more than step x height = 12 x 5; these are ignored"
    # A driver that does not count the padding of its rows.
    image = decode_image(with_fields(make, message, data=np.append(data, np.zeros(20, np.uint8))))
    assert image.remark.endswith("(a picture that looks slanted has rows of 16 bytes: step is wrong)")


def test_the_last_row_may_lack_its_padding(make):
    message, expected = hand_made(make, "mono16", 6, 5, 4, big_endian=False)
    data = np.frombuffer(message.data, np.uint8)
    image = decode_image(with_fields(make, message, data=data[:-4]))
    np.testing.assert_array_equal(image.pixels, expected)
    assert image.remark == ""
    with pytest.raises(EncodingError, match="data: 75 bytes; need step x height = 16 x 5 = 80"):
        decode_image(with_fields(make, message, data=data[:-5]))


@pytest.mark.parametrize("step", [0, 1, 6, 11, 13, 18, 2**32 - 1])
def test_a_step_that_the_data_contradict(make, step):
    """Drivers leave step at 0, fill in the width, or the bytes of another encoding; the rows are whole all the same."""
    message, expected = hand_made(make, "bayer_rggb16", 6, 5, 0, big_endian=False)
    image = decode_image(with_fields(make, message, step=step))
    np.testing.assert_array_equal(image.pixels, expected)
    assert image.remark == f"step: {step} bytes; read as 12, for the data are 5 rows of 12 bytes"


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("Mono8", "mono8"),
        ("RGB8", "rgb8"),
        ("BAYER_RGGB8", "bayer_rggb8"),
        ("YUYV", "yuyv"),
        ("UYVY", "uyvy"),
        ("YUV422_YUY2", "yuv422_yuy2"),
        ("8uc3", "8UC3"),
        ("16uc1", "16UC1"),
        (" mono16 ", "mono16"),
    ],
)
def test_the_case_of_an_encoding_does_not_matter(make, given, meant):
    assert encoding_named(given) == encoding_named(meant)
    message, expected = hand_made(make, meant, 6, 5, 0, big_endian=False)
    image = decode_image(with_fields(make, message, encoding=given))
    np.testing.assert_array_equal(image.pixels, expected)
    assert image.layout == encoding_named(meant).layout


#: Bytes behind the luma of a picture, for each of luma: chroma of 4:2:0, 4:2:2 and 4:4:4.
CHROMA = {
    "nv12": 0.5,
    "nv21": 0.5,
    "NV12": 0.5,
    "yuv420": 0.5,
    "I420": 0.5,
    "yv12": 0.5,
    "nv16": 1,
    "nv24": 2,
    "NV24": 2,
}


@pytest.mark.parametrize("encoding", CHROMA)
@pytest.mark.parametrize("way", ["camera_ros", "padded", "depthai", "opencv", "twice", "no step"])
def test_luma_of_yuv_in_planes(make, encoding, way):
    """Height and step as drivers fill them; the chroma is white noise."""
    width, height, share = 12, 8, CHROMA[encoding]
    generator = np.random.default_rng(3)
    padding = 20 if way == "padded" else 0
    planes = generator.integers(0, 256, (round(height * (1 + share)), width + padding), np.uint8)
    header = {
        "camera_ros": {"height": height, "step": width},
        "padded": {"height": height, "step": width + padding},
        "depthai": {"height": height, "step": round(width * (1 + share))},
        "opencv": {"height": len(planes), "step": width},
        "twice": {"height": height, "step": 2 * width},
        "no step": {"height": height, "step": 0},
    }[way]
    message = make("sensor_msgs/msg/Image", width=width, encoding=encoding, data=planes.ravel(), **header)
    image = decode_image(message)
    np.testing.assert_array_equal(image.pixels, planes[:height, :width])
    assert image.layout == PixelLayout(ColorModel.LUMA)
    assert np.shares_memory(image.pixels, np.frombuffer(message.data, np.uint8))


def test_luma_is_what_opencv_calls_grey(make):
    rgb = np.random.default_rng(2).integers(0, 256, (16, 24, 3), np.uint8)
    i420 = cv2.cvtColor(rgb, cv2.COLOR_RGB2YUV_I420)
    assert i420.shape == (24, 24)
    message = make("sensor_msgs/msg/Image", width=24, height=16, step=24, encoding="i420", data=i420.ravel())
    np.testing.assert_array_equal(decode_image(message).pixels, cv2.cvtColor(i420, cv2.COLOR_YUV2GRAY_I420))


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"height": 8, "step": 12, "data": np.zeros(12 * 8 - 1, np.uint8)}, "data: 95 bytes, step 12; need 12 rows"),
        ({"height": 7, "step": 12, "data": np.zeros(12 * 7, np.uint8)}, "need 11 rows of at least 12 bytes"),
        ({"height": 8, "step": 5, "data": np.zeros(100, np.uint8)}, "data: 100 bytes, step 5; need 12 rows"),
        ({"height": 0, "step": 12, "data": np.zeros(100, np.uint8)}, "12 x 0 px"),
    ],
)
def test_planes_that_are_not_whole(make, fields, says):
    message = make("sensor_msgs/msg/Image", width=12, encoding="nv12", **fields)
    with pytest.raises(EncodingError, match=says):
        decode_image(message)


def test_planes_are_not_written(make):
    with pytest.raises(EncodingError, match="'nv12' can be read and not be written"):
        image_message(make, HEADER, np.zeros((4, 4), np.uint8), "nv12")


def with_fields(make, message, **changes):
    names = ("header", "height", "width", "encoding", "is_bigendian", "step")
    fields = {name: getattr(message, name) for name in names} | {"data": np.frombuffer(message.data, np.uint8)}
    return make("sensor_msgs/msg/Image", **(fields | changes))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"width": 0}, "image: 0 x 5 px; need positive"),
        ({"height": 0}, "image: 6 x 0 px; need positive"),
        ({"step": 0, "data": np.zeros(61, np.uint8)}, "step: 0 bytes; need at least 12 for 6 px of bayer_rggb16"),
        ({"step": 11, "data": np.zeros(59, np.uint8)}, "step: 11 bytes; need at least 12"),
        ({"data": np.zeros(59, np.uint8)}, "data: 59 bytes; need step x height = 12 x 5 = 60"),
        ({"data": np.zeros(0, np.uint8)}, "data: 0 bytes; need step x height"),
        ({"width": 2**32 - 1}, "step: 12 bytes; need at least 8589934590"),
        ({"height": 2**32 - 1}, "data: 60 bytes; need step x height"),
        ({"step": 2**32 - 1, "width": 2**31 - 1, "height": 2**32 - 1}, "data: 60 bytes; need step x height"),
        ({"encoding": "bayer_rggb12"}, "encoding: 'bayer_rggb12' is unknown; nearest known: 'bayer_rggb"),
        ({"encoding": ""}, "encoding: '' is unknown; need a name such as"),
        ({"encoding": "8UC0"}, "encoding: '8UC0' is unknown; nearest known: '8UC"),
        ({"encoding": "8UC99999999999999"}, "unknown"),
        ({"encoding": "BAYER_RGBG8"}, "encoding: 'BAYER_RGBG8' is unknown; nearest known: 'bayer_rggb8'"),
        ({"encoding": "jpeg"}, "encoding: 'jpeg' is unknown; need a name such as mono8,"),
        ({"encoding": "xyz"}, "encoding: 'xyz' is unknown; need a name such as mono8,"),
        ({"encoding": "rgb8\n" * 1000}, r"encoding: 'rgb8\nrgb8"),
        ({"encoding": "yuyv", "width": 5}, "width: 5 px; need an even width for yuyv"),
    ],
)
def test_hostile_headers(make, changes, says):
    message, _ = hand_made(make, "bayer_rggb16", 6, 5, 0, big_endian=False)
    with pytest.raises(EncodingError, match=re.escape(says)) as caught:
        decode_image(with_fields(make, message, **changes))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize(("field", "value"), [("width", -6), ("height", -1), ("step", -12)])
def test_negative_sizes(make, field, value):
    message, _ = hand_made(make, "bayer_rggb16", 6, 5, 0, big_endian=False)
    object.__setattr__(message, "_" + field if hasattr(message, "_" + field) else field, value)
    with pytest.raises(EncodingError):
        decode_image(message)


@given(
    st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1), st.sampled_from(list(ENCODINGS))
)
def test_any_header_is_read_or_refused(width, height, step, encoding):
    from imgu_ros.bags.messages import make_message

    data = np.zeros(4096, np.uint8)
    message = make_message("sensor_msgs/msg/Image", width=width, height=height, step=step, encoding=encoding, data=data)
    try:
        pixels = decode_image(message).pixels
    except EncodingError:
        return
    assert pixels.shape[:2] == (height, width)
    assert pixels.nbytes <= len(data)


@st.composite
def pictures(draw):
    encoding = draw(st.sampled_from(list(ENCODINGS)))
    code, channels, layout = ENCODINGS[encoding]
    width = draw(st.integers(1, 9)) * (2 if layout.color in (ColorModel.UYVY, ColorModel.YUYV) else 1)
    height = draw(st.integers(1, 9))
    shape = (height, width) if channels == 1 else (height, width, channels)
    size = math.prod(shape) * np.dtype(code).itemsize
    return encoding, np.frombuffer(draw(st.binary(min_size=size, max_size=size)), code).reshape(shape)


@given(pictures(), st.integers(0, 9), st.booleans())
def test_round_trip(make, picture, padding, big_endian):
    encoding, pixels = picture
    message = image_message(make, HEADER, pixels, encoding, row_padding=padding, big_endian=big_endian)
    decoded = decode_image(message).pixels
    assert decoded.dtype == pixels.dtype
    assert decoded.tobytes() == pixels.tobytes()  # as bytes: NaN included


def test_encoder_takes_any_memory_layout(make):
    pixels = np.arange(6 * 8 * 3, dtype=np.uint16).reshape(6, 8, 3)
    for view in (pixels[::-1, ::2], pixels[:, :, ::-1], pixels.astype(">u2"), np.asfortranarray(pixels)):
        np.testing.assert_array_equal(decode_image(image_message(make, HEADER, view, "rgb16")).pixels, view)


@pytest.mark.parametrize(
    ("pixels", "encoding", "says"),
    [
        (np.zeros((4, 4, 3), np.uint8), "mono8", "pixels: shape (4, 4, 3); need (H, W)"),
        (np.zeros((4, 4), np.uint8), "rgb8", "need (H, W, 3)"),
        (np.zeros((0, 4), np.uint8), "mono8", "shape (0, 4)"),
        (np.zeros((4, 4), np.uint16), "mono8", "pixels: data type uint16; need uint8 for mono8"),
        (np.zeros((4, 3, 2), np.uint8), "yuyv", "even width"),
        (np.zeros((4, 4), np.uint8), "mono9", "nearest known: 'mono8'"),
    ],
)
def test_encoder_refuses_what_does_not_fit(make, pixels, encoding, says):
    with pytest.raises(EncodingError, match=re.escape(says)):
        image_message(make, HEADER, pixels, encoding)


def test_names():
    assert encoding_named("16SC12").channels == 12
    assert encoding_named("rgb16").pixel_bytes == 6
    assert is_image_encoding("bayer_grbg16")
    assert is_image_encoding("NV21")
    assert not is_image_encoding("nv99")
    assert encoding_for(np.uint16, 3) == "rgb16"
    with pytest.raises(EncodingError, match="float64"):
        encoding_for(np.float64, 1)


def test_header(make):
    message = image_message(make, Header(-1, "left/optical"), np.zeros((2, 2), np.uint8), "mono8")
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (-1, 999_999_999)
    from imgu_ros.messages.header import decode_header

    assert decode_header(message) == Header(-1, "left/optical")
    with pytest.raises(EncodingError, match="32 bits"):
        image_message(make, Header(2**31 * 10**9, ""), np.zeros((2, 2), np.uint8), "mono8")


@pytest.mark.parametrize("claimed", ["mono8", "8UC1", "8SC1", "bayer_gbrg8", "BayerRG8", "raw8", ""])
def test_an_encoding_overrides_the_messages(make, claimed):
    """A mosaic is read as one, whatever the message calls it: the same view of the same bytes, padding and all."""
    pixels = np.random.default_rng(0).integers(0, 256, (6, 10), np.uint8)
    message = image_message(make, HEADER, pixels, "mono8", row_padding=6)
    message.encoding = claimed
    image = decode_image(message, "bayer_rggb8")
    assert np.array_equal(image.pixels, pixels)
    assert image.layout == PixelLayout(ColorModel.BAYER, BayerPattern.RGGB)
    assert np.shares_memory(image.pixels, np.asarray(message.data))


@pytest.mark.parametrize("big_endian", [False, True])
@pytest.mark.parametrize("claimed", ["mono16", "16UC1", "16SC1", "bayer_rggb16", "yuyv"])
def test_sixteen_bits_by_another_name(make, claimed, big_endian):
    pixels = np.random.default_rng(0).integers(0, 65536, (6, 10), np.uint16)
    message = image_message(make, HEADER, pixels, "mono16", big_endian=big_endian)
    message.encoding = claimed
    image = decode_image(message, "bayer_bggr16")
    assert np.array_equal(image.pixels, pixels)
    assert image.layout.pattern is BayerPattern.BGGR


def test_red_and_blue_by_another_name(make):
    pixels = np.random.default_rng(0).integers(0, 256, (6, 10, 3), np.uint8)
    message = image_message(make, HEADER, pixels, "bgr8")
    assert decode_image(message, "rgb8").layout.color is ColorModel.RGB
    assert np.array_equal(decode_image(message, "rgb8").pixels, pixels)
    assert decode_image(message, "8UC3").layout.color is ColorModel.BANDS


@pytest.mark.parametrize(
    ("claimed", "wanted", "text"),
    [
        (
            "mono8",
            "bayer_rggb16",
            "bayer_rggb16 has 2 bytes a pixel, the message's mono8 1; need .* 1 byte",
        ),
        (
            "mono16",
            "bayer_rggb8",
            "bayer_rggb8 has 1 byte a pixel, the message's mono16 2; need .* 2 bytes",
        ),
        ("rgb8", "bayer_rggb8", "raw.encoding: bayer_rggb8 has 1 byte a pixel, the message's rgb8 3"),
        ("BayerRG12", "bayer_rggb8", "raw.encoding: bayer_rggb8 has 1 byte a pixel, .*'BayerRG12' rows of 160 bytes"),
        ("BayerRG8", "bayer_rggb16", "step"),
    ],
)
def test_an_encoding_that_the_bytes_cannot_be_is_refused(make, claimed, wanted, text):
    stored = "mono16" if claimed == "BayerRG12" else "mono8" if claimed == "BayerRG8" else claimed
    known = encoding_named(stored)
    shape = (60, 80) if known.channels == 1 else (60, 80, known.channels)
    message = image_message(make, HEADER, np.zeros(shape, known.dtype), stored)
    message.encoding = claimed
    with pytest.raises(EncodingError, match=text):
        decode_image(message, wanted)
