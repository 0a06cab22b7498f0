# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import struct
import subprocess
import sys
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import EncodingError
from imgu_ros.messages.compressed_image import compressed_image_message, decode_compressed_image
from imgu_ros.messages.header import Header
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout

HEADER = Header(5, "camera")


def compressed(make, data: bytes, text: str):
    return make("sensor_msgs/msg/CompressedImage", format=text, data=np.frombuffer(data, np.uint8))


def png_chunk(name: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))


def hand_made_png(pixels: np.ndarray, size: tuple[int, int] | None = None) -> bytes:
    """A PNG written by the specification alone; (H, W), (H, W, 3) RGB or (H, W, 4) RGBA, 8 or 16 bit."""
    height, width = pixels.shape[:2]
    color_type = {2: 0, 3: {3: 2, 4: 6}.get(pixels.shape[-1])}[pixels.ndim]
    big = pixels.astype(pixels.dtype.newbyteorder(">")).reshape(height, -1)
    rows = b"".join(b"\0" + row.tobytes() for row in big)
    width, height = size or (width, height)
    header = struct.pack(">IIBBBBB", width, height, pixels.itemsize * 8, color_type, 0, 0, 0)
    chunks = (b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(png_chunk(*chunk) for chunk in chunks)


def random_pixels(shape, dtype) -> np.ndarray:
    return np.random.default_rng(1).integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize(
    ("text", "shape", "layout"),
    [
        ("png", (5, 7), PixelLayout(ColorModel.MONO)),
        ("mono8; png compressed ", (5, 7), PixelLayout(ColorModel.MONO)),
        ("bayer_rggb8; png compressed", (5, 7), PixelLayout(ColorModel.BAYER, BayerPattern.RGGB)),
        ("bayer_grbg16; png compressed mono16", (5, 7), PixelLayout(ColorModel.BAYER, BayerPattern.GRBG)),
        ("16UC1; png compressed ", (5, 7), PixelLayout(ColorModel.BANDS)),
        ("png", (5, 7, 3), PixelLayout(ColorModel.BGR)),
        ("", (5, 7, 3), PixelLayout(ColorModel.BGR)),
        ("rgb8; png compressed bgr8", (5, 7, 3), PixelLayout(ColorModel.BGR)),
        ("bgr8; png compressed bgr8", (5, 7, 3), PixelLayout(ColorModel.BGR)),
        ("yuv422; png compressed bgr8", (5, 7, 3), PixelLayout(ColorModel.BGR)),
        ("my_own; png compressed", (5, 7, 3), PixelLayout(ColorModel.BGR)),
        ("bayer_rggb8; png compressed bgr8", (5, 7, 3), PixelLayout(ColorModel.BGR)),
        ("rgba8; png compressed bgra8", (5, 7, 4), PixelLayout(ColorModel.BGRA)),
    ],
)
def test_png_and_format_strings(make, dtype, text, shape, layout):
    pixels = random_pixels(shape, dtype)  # RGB order, as PNG stores it
    image = decode_compressed_image(compressed(make, hand_made_png(pixels), text))
    assert image.layout == layout
    assert image.pixels.dtype == dtype
    assert not image.pixels.flags.writeable
    order = {2: slice(None), 3: [2, 1, 0], 4: [2, 1, 0, 3]}[len(shape) if len(shape) == 2 else shape[2]]
    np.testing.assert_array_equal(image.pixels, pixels if len(shape) == 2 else pixels[:, :, order])


def test_a_picture_compressed_with_swapped_channels(make):
    """The transport named "compressed rgb8" gave RGB pixels to a writer that takes BGR."""
    rgb = np.zeros((8, 8, 3), np.uint8)
    rgb[..., 0] = 200
    swapped_file = cv2.imencode(".png", rgb)[1].tobytes()
    image = decode_compressed_image(compressed(make, swapped_file, "rgb8; png compressed rgb8"))
    assert image.layout == PixelLayout(ColorModel.RGB)
    np.testing.assert_array_equal(image.pixels, rgb)


@pytest.mark.parametrize(
    ("text", "color"),
    [
        ("jpeg", ColorModel.MONO),
        ("mono8; jpeg compressed ", ColorModel.MONO),
        ("bayer_rggb8; jpeg compressed mono8", ColorModel.BAYER),
        ("bayer_rggb8; png compressed ", ColorModel.BAYER),  # it is JPEG none the less
    ],
)
def test_grey_jpeg(make, text, color):
    smooth = np.add.outer(np.arange(48), np.arange(64)).astype(np.uint8)
    image = decode_compressed_image(compressed(make, cv2.imencode(".jpg", smooth)[1].tobytes(), text))
    assert image.layout.color is color
    assert image.pixels.shape == smooth.shape
    assert np.abs(image.pixels.astype(int) - smooth).max() <= 3


def test_color_jpeg_keeps_red_red(make):
    rgb = np.zeros((32, 32, 3), np.uint8)
    rgb[..., 0], rgb[..., 1] = 220, 40
    message = compressed_image_message(make, HEADER, rgb, "rgb8")
    assert message.format == "rgb8; jpeg compressed bgr8"
    image = decode_compressed_image(message)
    assert image.layout.color is ColorModel.BGR
    assert np.abs(image.pixels[..., ::-1].astype(int) - rgb).max() <= 6


def exif_jpeg(pixels: np.ndarray, orientation: int) -> bytes:
    tiff = b"II*\0" + struct.pack("<IHHHIHHI", 8, 1, 0x0112, 3, 1, orientation, 0, 0)
    segment = b"Exif\0\0" + tiff
    plain = cv2.imencode(".jpg", pixels)[1].tobytes()
    return plain[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + plain[2:]


def exif_png(pixels: np.ndarray, orientation: int) -> bytes:
    exif = b"MM\0*" + struct.pack(">IHHHIHHI", 8, 1, 0x0112, 3, 1, orientation, 0, 0)
    chunk = struct.pack(">I", len(exif)) + b"eXIf" + exif + struct.pack(">I", zlib.crc32(b"eXIf" + exif))
    plain = cv2.imencode(".png", pixels)[1].tobytes()
    return plain[:33] + chunk + plain[33:]  # behind the signature and IHDR


@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientation_is_not_applied(make, orientation):
    pixels = random_pixels((16, 32), np.uint8)
    stored = decode_compressed_image(compressed(make, cv2.imencode(".jpg", pixels)[1].tobytes(), "jpeg")).pixels
    image = decode_compressed_image(compressed(make, exif_jpeg(pixels, orientation), "jpeg"))
    assert np.array_equal(image.pixels, stored)
    deep = random_pixels((16, 32), np.uint16)
    image = decode_compressed_image(compressed(make, exif_png(deep, orientation), "bayer_rggb16; png compressed "))
    assert np.array_equal(image.pixels, deep)


@pytest.mark.parametrize("options", [[], [cv2.IMWRITE_JPEG_PROGRESSIVE, 1], [cv2.IMWRITE_JPEG_RST_INTERVAL, 2]])
def test_a_jpeg_cut_anywhere_is_refused(make, options):
    pixels = random_pixels((40, 40, 3), np.uint8)
    whole = cv2.imencode(".jpg", pixels, options)[1].tobytes()
    decode_compressed_image(compressed(make, whole, "jpeg"))
    decode_compressed_image(compressed(make, whole + b"\0\0\0", "jpeg"))  # padded by the driver
    for length in [*range(0, len(whole) - 3, 37), len(whole) - 5]:
        with pytest.raises(EncodingError, match="compressed image: "):
            decode_compressed_image(compressed(make, whole[:length], "jpeg"))


#: The end of frames as drivers of MJPEG cameras leave it: nothing, half a marker, zeros up to the transfer's size.
ENDS = {"no end": b"", "half a marker": b"\xff", "zeros": bytes(64), "half a marker and zeros": b"\xff" + bytes(3000)}


@pytest.mark.parametrize("options", [[], [cv2.IMWRITE_JPEG_PROGRESSIVE, 1], [cv2.IMWRITE_JPEG_RST_INTERVAL, 2]])
@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("channels", [(), (3,)])
def test_a_jpeg_without_its_end_marker_is_read_and_said(make, options, end, channels, capfd):
    pixels = cv2.GaussianBlur(random_pixels((75, 101, *channels), np.uint8), (0, 0), 2)
    whole = cv2.imencode(".jpg", pixels, options)[1].tobytes()
    assert whole.endswith(b"\xff\xd9")
    expected = decode_compressed_image(compressed(make, whole, "jpeg"))
    assert expected.remark == ""
    image = decode_compressed_image(compressed(make, whole[:-2] + ENDS[end], "jpeg"))
    np.testing.assert_array_equal(image.pixels, expected.pixels)
    assert image.remark == "JPEG without its end marker (ff d9), read as if it were there"
    for lost in (6, 40, len(whole) // 2):
        with pytest.raises(EncodingError, match=r"compressed image: JPEG cut after \d+ bytes; need the whole file"):
            decode_compressed_image(compressed(make, whole[:-lost] + ENDS[end], "jpeg"))
    assert capfd.readouterr() == ("", "")


def test_what_others_write_to_stderr_meanwhile_is_not_lost(make, capfd, monkeypatch):
    """The decoder's remarks are kept from stderr, nobody else's are."""
    import os

    from imgu_ros.image_files import decoding as picture_decoding

    whole = cv2.imencode(".jpg", random_pixels((40, 40), np.uint8))[1].tobytes()
    decode = picture_decoding.decode_checked

    def decode_beside_another(data, file):
        os.write(2, b"another's line\n")
        return decode(data, file)

    monkeypatch.setattr(picture_decoding, "decode_checked", decode_beside_another)
    decode_compressed_image(compressed(make, whole[:-2], "jpeg"))
    assert capfd.readouterr().err == "another's line\n" * 2


@pytest.mark.parametrize("missing", ["memfd_create", "dup"])
def test_a_missing_end_is_read_where_stderr_cannot_be_held(make, monkeypatch, missing):
    import os

    from imgu_ros.image_files import decoding as picture_decoding

    def refuse(*_):
        raise OSError(missing)

    whole = cv2.imencode(".jpg", random_pixels((40, 40), np.uint8))[1].tobytes()
    monkeypatch.setattr(picture_decoding.os, missing, refuse)
    descriptors = len(os.listdir("/proc/self/fd"))
    image = decode_compressed_image(compressed(make, whole[:-2], "jpeg"))
    np.testing.assert_array_equal(image.pixels, decode_compressed_image(compressed(make, whole, "jpeg")).pixels)
    assert len(os.listdir("/proc/self/fd")) == descriptors


@pytest.mark.parametrize("tail", [b"\0\0\0", bytes(5000), b"\xff\xd9", b"\xff\xd9" + bytes(9), b"\xff" * 5, b"garbage"])
def test_what_follows_the_end_marker_does_not_matter(make, tail):
    whole = cv2.imencode(".jpg", random_pixels((40, 40, 3), np.uint8))[1].tobytes()
    image = decode_compressed_image(compressed(make, whole + tail, "jpeg"))
    np.testing.assert_array_equal(image.pixels, decode_compressed_image(compressed(make, whole, "jpeg")).pixels)
    assert image.remark == ""


def segments(jpeg: bytes) -> list[bytes]:
    """SOI, each segment up to the scan, and the rest."""
    parts, at = [jpeg[:2]], 2
    while jpeg[at + 1] != 0xDA:
        end = at + 2 + int.from_bytes(jpeg[at + 2 : at + 4], "big")
        parts.append(jpeg[at:end])
        at = end
    return [*parts, jpeg[at:]]


def test_the_motion_jpeg_of_a_uvc_camera(make):
    """AVI1 instead of JFIF, no Huffman tables (the standard ones are meant), padding behind the end."""
    pixels = cv2.GaussianBlur(random_pixels((72, 96, 3), np.uint8), (0, 0), 2)
    whole = cv2.imencode(".jpg", pixels)[1].tobytes()
    soi, *rest = segments(whole)
    kept = [segment for segment in rest if segment[1] not in (0xE0, 0xC4)]
    assert len(kept) < len(rest)
    avi1 = b"\xff\xe0\x00\x10AVI1\x00" + bytes(9)
    frame = soi + avi1 + b"".join(kept) + bytes(48)
    expected = decode_compressed_image(compressed(make, whole, "jpeg")).pixels
    np.testing.assert_array_equal(decode_compressed_image(compressed(make, frame, "jpeg")).pixels, expected)


@pytest.mark.parametrize(
    ("text", "color"),
    [
        ("jpeg", ColorModel.BGR),
        ("jpg", ColorModel.BGR),
        ("JPEG", ColorModel.BGR),
        ("", ColorModel.BGR),
        ("bgr8; jpeg compressed ", ColorModel.BGR),
        ("bgr8; jpeg compressed bgr8", ColorModel.BGR),
        ("rgb8; jpeg compressed bgr8", ColorModel.BGR),
        ("RGB8; JPEG compressed BGR8", ColorModel.BGR),
        ("rgb8; jpeg compressed rgb8", ColorModel.RGB),
        ("RGB8; JPEG COMPRESSED RGB8", ColorModel.RGB),
        ("BAYER_RGGB8; jpeg compressed bgr8", ColorModel.BGR),
        ("rgb8;jpeg compressed bgr8", ColorModel.BGR),
    ],
)
def test_ways_to_write_the_format_of_a_color_jpeg(make, text, color):
    rgb = np.full((16, 16, 3), (220, 40, 10), np.uint8)
    data = cv2.imencode(".jpg", rgb[..., ::-1] if color is ColorModel.BGR else rgb)[1].tobytes()
    image = decode_compressed_image(compressed(make, data, text))
    assert image.layout.color is color


def test_a_mosaic_in_capital_letters(make):
    data = hand_made_png(random_pixels((6, 6), np.uint8))
    image = decode_compressed_image(compressed(make, data, "BAYER_GRBG8; PNG compressed "))
    assert image.layout == PixelLayout(ColorModel.BAYER, BayerPattern.GRBG)


#: The head of compressed_depth_image_transport's data: an enum and two floats before the PNG.
DEPTH_HEAD = struct.pack("<iff", 0, 100.0, 1.0)


@pytest.mark.parametrize(
    ("text", "data", "says"),
    [
        (
            "16UC1; compressedDepth",
            DEPTH_HEAD + b"\x89PNG\r\n\x1a\n",
            "is a depth picture of compressed_depth",
        ),
        ("32FC1; compressedDepth png", DEPTH_HEAD + b"\x89PNG\r\n\x1a\n", "is a depth picture"),
        ("16UC1; compressedDepth rvl", DEPTH_HEAD + bytes(20), "is a depth picture"),
        ("h264", b"\0\0\0\1\x67\x42", "format 'h264' is video, whose frames are no pictures by themselves"),
        ("H265", b"\0\0\0\1\x40\x01", "format 'H265' is video"),
        ("bgr8; theora compressed", b"\x80theora", "is video"),
        ("nv12", bytes(96), "format 'nv12' names pixels that are not compressed"),
        ("rgb8", bytes(96), "format 'rgb8' names pixels that are not compressed"),
        ("webp", b"RIFF\x20\0\0\0WEBP", "16 bytes that begin with|12 bytes that begin with"),
        ("jpeg", b"", "0 bytes that begin with nothing"),
    ],
)
def test_what_is_no_picture_is_called_by_its_name(make, text, data, says):
    with pytest.raises(EncodingError, match=rf"compressed image: .*{says}.*need JPEG \(ff d8 ff\) or PNG"):
        decode_compressed_image(compressed(make, data, text))


def test_a_png_cut_anywhere_is_refused(make):
    whole = hand_made_png(random_pixels((20, 20), np.uint16))
    for length in range(0, len(whole), 13):
        with pytest.raises(EncodingError, match="compressed image: "):
            decode_compressed_image(compressed(make, whole[:length], "png"))


def test_a_png_with_one_wrong_bit_is_refused(make):
    whole = bytearray(hand_made_png(random_pixels((20, 20), np.uint8)))
    whole[100] ^= 4
    with pytest.raises(EncodingError, match="checksum in PNG chunk b'IDAT'"):
        decode_compressed_image(compressed(make, bytes(whole), "png"))


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "0 bytes that begin with nothing; need JPEG"),
        (b"II*\0" + bytes(100), "begin with 49 49 2a 00"),
        (bytes(1000), "begin with 00 00 00 00 00 00 00 00; need JPEG"),
        (b"\xff\xd8\xff\xd9", "without a frame header"),
        (b"\xff\xd8\xff" + bytes(500), "need an undamaged|no JPEG marker"),
        (hand_made_png(np.zeros((2, 2), np.uint8), size=(0, 2)), "0 x 2 px"),
        (hand_made_png(np.zeros((2, 2), np.uint8), size=(2**31 - 1, 2**31 - 1)), "2147483647 x 2147483647 px"),
        (hand_made_png(np.zeros((2, 2), np.uint8), size=(2, 500)), "need"),
        (b"\x89PNG\r\n\x1a\n" + png_chunk(b"IDAT", b"12345678"), "begins with chunk b'IDAT'"),
    ],
    ids=["empty", "tiff", "zeros", "jpeg-nothing", "jpeg-zeros", "png-0", "png-huge", "png-few-rows", "png-no-header"],
)
def test_hostile_data(make, data, says):
    with pytest.raises(EncodingError, match=says) as caught:
        decode_compressed_image(compressed(make, data, "png"))
    assert "\n" not in str(caught.value)


@given(st.binary(max_size=300), st.sampled_from([b"", b"\xff\xd8\xff", b"\xff\xd8\xff\xe0", b"\x89PNG\r\n\x1a\n"]))
def test_random_bytes_are_refused(tail, magic):
    from imgu_ros.bags.messages import make_message

    with pytest.raises(EncodingError):
        decode_compressed_image(compressed(make_message, magic + tail, "jpeg"))


def test_an_unknown_mosaic_is_refused(make):
    data = hand_made_png(np.zeros((4, 4), np.uint8))
    with pytest.raises(EncodingError, match="'bayer_rgbw8' is unknown"):
        decode_compressed_image(compressed(make, data, "bayer_rgbw8; png compressed"))


def test_two_channels_are_refused(make):
    gray_alpha = struct.pack(">IIBBBBB", 2, 1, 8, 4, 0, 0, 0)
    chunks = (b"IHDR", gray_alpha), (b"IDAT", zlib.compress(b"\0" + bytes([10, 255, 20, 255]))), (b"IEND", b"")
    data = b"\x89PNG\r\n\x1a\n" + b"".join(png_chunk(*chunk) for chunk in chunks)
    # OpenCV expands grey with alpha to colour with alpha.
    image = decode_compressed_image(compressed(make, data, "png"))
    assert image.layout.color is ColorModel.BGRA


@pytest.mark.parametrize(
    "encoding", ["mono8", "mono16", "bayer_bggr8", "bayer_gbrg16", "rgb8", "bgr8", "rgb16", "bgr16"]
)
def test_png_round_trip_is_exact(make, encoding):
    channels = (3,) if "rgb" in encoding.split("_")[0] or "bgr" in encoding.split("_")[0] else ()
    pixels = random_pixels((9, 11, *channels), np.uint16 if "16" in encoding else np.uint8)
    message = compressed_image_message(make, HEADER, pixels, encoding, file_format="png")
    assert message.format == f"{encoding}; png compressed" + (f" bgr{pixels.itemsize * 8}" if channels else "")
    image = decode_compressed_image(message)
    decoded = image.pixels[..., ::-1] if encoding.startswith("rgb") else image.pixels
    np.testing.assert_array_equal(decoded, pixels)
    assert (image.layout.color is ColorModel.BAYER) == encoding.startswith("bayer")


@pytest.mark.parametrize(
    ("encoding", "file_format", "says"),
    [("mono16", "jpeg", "need 8 bit"), ("8UC1", "png", "need mono, bayer"), ("rgb8", "png", "shape \\(4, 4\\)")],
)
def test_encoder_refuses_what_does_not_fit(make, encoding, file_format, says):
    with pytest.raises(EncodingError, match=says):
        compressed_image_message(make, HEADER, np.zeros((4, 4), np.uint16), encoding, file_format=file_format)


def test_pixels_outside_the_sizes_of_jpeg(make):
    with pytest.raises(EncodingError):
        compressed_image_message(make, HEADER, np.zeros((1, 70_000), np.uint8), "mono8")


def test_nothing_is_printed_about_damaged_data(tmp_path):
    """Decoders write to stderr by themselves; one line an error is what users get."""
    program = (
        "import cv2, numpy as np\n"
        "from imgu_ros.bags.messages import make_message as make\n"
        "from imgu_ros.messages.compressed_image import decode_compressed_image\n"
        "from imgu_ros.errors import EncodingError\n"
        "for ending in ('.jpg', '.png'):\n"
        "    data = cv2.imencode(ending, np.arange(4096, dtype=np.uint8).reshape(64, 64))[1].reshape(-1)\n"
        "    try:\n"
        "        decode_compressed_image(make('sensor_msgs/msg/CompressedImage', format='', data=data[:-40]))\n"
        "    except EncodingError:\n"
        "        continue\n"
        "    raise SystemExit(3)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_unknown_file_format(make):
    with pytest.raises(EncodingError, match="file_format: 'webp'; need jpeg or png"):
        compressed_image_message(make, HEADER, np.zeros((4, 4), np.uint8), "mono8", file_format="webp")


def test_a_picture_made_to_fill_the_memory_is_refused_before_it_is_decoded(make):
    """16000 x 16000 pixels of nothing in a few kilobytes; a small picture of nothing is a lens cap."""

    def said(height: int, width: int) -> bytes:
        return hand_made_png(np.zeros((height, width), np.uint8))

    with pytest.raises(EncodingError, match=r"PNG of 16000 x 16000 px in \d+ bytes; need at least 248077"):
        decode_compressed_image(compressed(make, hand_made_png(np.zeros((9, 9), np.uint8), (16_000, 16_000)), "png"))
    assert decode_compressed_image(compressed(make, said(1500, 2000), "png")).pixels.shape == (1500, 2000)


@pytest.mark.parametrize(
    "text", ["png", "", "mono8; png compressed ", "bayer_bggr8; png compressed ", "8UC1; png compressed "]
)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_an_encoding_overrides_the_formats(make, text, dtype):
    """A mosaic as a grey picture: PNG gives its values back."""
    pixels, wanted = random_pixels((16, 32), dtype), f"bayer_grbg{8 * np.dtype(dtype).itemsize}"
    data = cv2.imencode(".png", pixels)[1].tobytes()
    image = decode_compressed_image(compressed(make, data, text), wanted)
    assert np.array_equal(image.pixels, pixels)
    assert image.layout == PixelLayout(ColorModel.BAYER, BayerPattern.GRBG)


@pytest.mark.parametrize(
    ("text", "wanted", "swapped"),
    [
        ("jpeg", "rgb8", False),
        ("jpeg", "bgr8", True),  # red and blue were exchanged before compression
        ("rgb8; jpeg compressed bgr8", "rgb8", False),
        ("rgb8; jpeg compressed bgr8", "bgr8", True),
        ("bgr8; jpeg compressed bgr8", "bgr8", False),
        ("bgr8; jpeg compressed bgr8", "rgb8", True),
    ],
)
def test_red_and_blue_of_a_compressed_picture(make, text, wanted, swapped):
    rgb = np.zeros((16, 16, 3), np.uint8)
    rgb[..., 0] = 200
    data = cv2.imencode(".png", rgb[..., ::-1])[1].tobytes()
    image = decode_compressed_image(compressed(make, data, text), wanted)
    red = {ColorModel.RGB: 0, ColorModel.BGR: 2}[image.layout.color]
    assert image.pixels[0, 0, 2 - red if swapped else red] == 200


@pytest.mark.parametrize(
    ("shape", "dtype", "wanted", "text"),
    [
        ((8, 8, 3), np.uint8, "bayer_rggb8", "bayer_rggb8 cannot be in a picture file with 3 channels of 8 bits"),
        ((8, 8), np.uint8, "bayer_rggb16", "bayer_rggb16 cannot be in a picture file with 1 channel of 8 bits"),
        ((8, 8), np.uint16, "bayer_rggb8", "1 channel of 16 bits"),
        ((8, 8), np.uint8, "nv12", "nv12 cannot be in a picture file"),
        ((8, 8, 3), np.uint8, "yuyv", "yuyv cannot be in a picture file"),
    ],
)
def test_an_encoding_that_the_picture_cannot_be_is_refused(make, shape, dtype, wanted, text):
    data = cv2.imencode(".png", random_pixels(shape, dtype))[1].tobytes()
    with pytest.raises(EncodingError, match=f"raw.encoding: .*{text}; need|{text}"):
        decode_compressed_image(compressed(make, data, "png"), wanted)
