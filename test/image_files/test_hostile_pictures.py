# SPDX-License-Identifier: Apache-2.0
"""JPEG and PNG files made to take memory or time: refused by their structure, before a decoder sees them."""

from __future__ import annotations

import struct
import subprocess
import sys
import time
import tracemalloc
import zlib
from dataclasses import replace

import cv2
import numpy as np
import pytest

from imgu_ros.config.components import ReadingParameters
from imgu_ros.config.parameters import DEFAULT_LIMITS, Parameters
from imgu_ros.errors import EncodingError
from imgu_ros.files.frame_reading import check_change, frame_reading
from imgu_ros.image_files.checks import check_picture_file
from imgu_ros.image_files.decoding import decode_picture_file
from imgu_ros.messages.compressed_image import decode_compressed_image
from imgu_ros.messages.frame import decode_frame

GREY, YCC, YCC420 = ((1, 0x11),), ((1, 0x11), (2, 0x11), (3, 0x11)), ((1, 0x22), (2, 0x11), (3, 0x11))
BASELINE, PROGRESSIVE = 0xC0, 0xC2


def segment(marker: int, content: bytes) -> bytes:
    return bytes((0xFF, marker)) + struct.pack(">H", len(content) + 2) + content


def frame(marker: int, width: int, height: int, components=GREY, bits: int = 8) -> bytes:
    listed = b"".join(bytes((name, sampling, 0)) for name, sampling in components)
    return segment(marker, struct.pack(">BHHB", bits, height, width, len(components)) + listed)


def scan(names, first: int = 0, last: int = 63, bits: int = 0, data: bytes = b"") -> bytes:
    listed = b"".join(bytes((name, 0)) for name in names)
    return segment(0xDA, bytes((len(names),)) + listed + bytes((first, last, bits))) + data


#: Quantisation by 1; a DC difference of 0, and the end of a block, of a bit each.
TABLES = (
    segment(0xDB, b"\0" + bytes([1] * 64))
    + segment(0xC4, b"\0" + bytes([1] + [0] * 15) + b"\0")
    + segment(0xC4, b"\x10" + bytes([1] + [0] * 15) + b"\0")
)


def jpeg(*parts: bytes) -> bytes:
    return b"\xff\xd8" + TABLES + b"".join(parts) + b"\xff\xd9"


def grey_blocks(width: int, height: int) -> bytes:
    """Baseline data of a grey picture: two bits a block."""
    return bytes(-(-(width // 8) * (height // 8) // 4))


def chunk(name: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))


def png(size, *chunks: bytes, depth: int = 8, color: int = 0, interlaced: int = 0, data: bytes | None = None) -> bytes:
    width, height = size
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, interlaced))
    if data is None:
        values = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[color]
        data = zlib.compress(bytes(height * (1 + -(-width * values * depth // 8))), 1)
    return b"\x89PNG\r\n\x1a\n" + header + b"".join(chunks) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def as_array(data: bytes) -> np.ndarray:
    return np.frombuffer(data, np.uint8)


ONE = scan([1], data=b"\0")
REFUSED = {
    "two-frames": (
        jpeg(frame(BASELINE, 40000, 50000), frame(BASELINE, 8, 8), ONE),
        "a second JPEG frame header at byte .*; need one",
    ),
    "frame-behind-scan": (jpeg(frame(BASELINE, 8, 8), ONE, frame(BASELINE, 40000, 50000)), "a second JPEG frame"),
    "scan-without-frame": (jpeg(ONE, frame(BASELINE, 8, 8)), "a JPEG scan before the frame header"),
    "no-scan": (jpeg(frame(BASELINE, 8, 8)), "a JPEG without a scan"),
    "height-at-end": (
        jpeg(frame(BASELINE, 8, 8), segment(0xDC, b"\x40\0"), ONE),
        "says its height at its end; need it in the frame header",
    ),
    "no-height": (jpeg(frame(BASELINE, 8, 0), ONE, segment(0xDC, b"\x40\0")), "8 x 0 px; need at least 1 x 1"),
    "no-width": (jpeg(frame(BASELINE, 0, 8), ONE), "0 x 8 px; need"),
    "arithmetic": (jpeg(frame(0xC9, 8, 8), ONE), r"JPEG with arithmetic coding \(marker ff c9\); need baseline"),
    "lossless": (jpeg(frame(0xC3, 8, 8), ONE), "JPEG with lossless or hierarchical coding"),
    "hierarchical": (jpeg(frame(0xC5, 8, 8), ONE), "JPEG with lossless or hierarchical coding"),
    "12-bit": (jpeg(frame(0xC1, 8, 8, bits=12), ONE), "JPEG of 12 bits; need 8"),
    "two-components": (jpeg(frame(BASELINE, 8, 8, YCC[:2]), ONE), "need one of 1, 3 or 4 components"),
    "sampling-0": (jpeg(frame(BASELINE, 8, 8, ((1, 0x01),)), ONE), "sampling factors 01; need 1 to 4"),
    "sampling-5": (jpeg(frame(BASELINE, 8, 8, ((1, 0x15),)), ONE), "sampling factors 15; need 1 to 4"),
    "one-name": (jpeg(frame(BASELINE, 8, 8, ((1, 0x11),) * 3), ONE), "of different components"),
    "unknown-component": (jpeg(frame(BASELINE, 8, 8), scan([7], data=b"\0")), "components that the frame header does"),
    "hidden-frame": (
        jpeg(b"\xff\x01" + frame(BASELINE, 40000, 50000), frame(BASELINE, 8, 8), ONE),
        "no JPEG marker at byte",
    ),
    "second-start": (jpeg(b"\xff\xd8", frame(BASELINE, 8, 8), ONE), "no JPEG marker at byte"),
    "claim": (jpeg(frame(BASELINE, 20000, 20000), ONE), r"JPEG of 20000 x 20000 px in \d+ bytes; need at least 781250"),
    "coefficients": (
        jpeg(frame(PROGRESSIVE, 11000, 11000, YCC), scan([1, 2, 3], 0, 0, data=bytes(3 * 1375**2 // 8 + 1))),
        r"JPEG of 11000 x 11000 px: needs 1093 MB; need at most 1000 \(limits.picture_mb\)",
    ),
    "scans-of many parts": (
        jpeg(frame(PROGRESSIVE, 8, 8), scan([1], 0, 0, data=b"\0"), *[scan([1], 1, 63, 0x10, b"\0")] * 3000),
        r"JPEG of \d+ scans: 101 megapixels with all its passes; need at most 100 \(limits.picture_megapixels\)",
    ),
    "large-scans": (
        jpeg(
            frame(PROGRESSIVE, 8000, 8000),
            scan([1], 0, 0, data=bytes(125_000)),
            *[scan([1], 1, 63, 0x10, b"\0")] * 40,
        ),
        "JPEG of .* scans: .* megapixels with all its passes",
    ),
    "baseline-scans": (
        jpeg(frame(BASELINE, 8000, 8000, YCC), *[scan([1], data=bytes(250_000))] * 40),
        "JPEG of .* scans: .* megapixels with all its passes",
    ),
    "two-headers": (png((8, 8), chunk(b"IHDR", bytes(13))), "PNG has a second IHDR"),
    "short-header": (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", bytes(12)) + chunk(b"IEND", b""), "header of 12 bytes"),
    "colour-type": (png((8, 8), color=2, depth=4), "colour type 2, 4 bits"),
    "no-data": (png((8, 8), data=b""), "need|decode"),
    "png-claim": (png((16000, 16000), data=b"12345678"), "PNG of 16000 x 16000 px in 8 bytes; need at least 248077"),
    "png-memory": (
        png((24_000, 24_000), data=bytes(600_000)),
        r"PNG of 24000 x 24000 px: needs 1153 MB; need at most 1000 \(limits.picture_mb\)",
    ),
    "deep": (png((9000, 9000), depth=16, color=6, data=bytes(700_000)), "9000 x 9000 px: needs 1297 MB"),
    "interlaced": (
        png((18_000, 18_000), interlaced=1, data=bytes(400_000)),
        "PNG of 18000 x 18000 px: 2269 megapixels with all its passes",
    ),
    "chunks-of many parts": (
        png((8, 8), chunk(b"tIME", b"") * 20_000),
        r"PNG of 10001 chunks: 101 megapixels .* \(limits.picture_megapixels\)",
    ),
    "critical": (png((8, 8), chunk(b"BOMB", b"")), "PNG chunk b'BOMB' at byte"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_before_memory_is_taken(name, monkeypatch):
    data, says = REFUSED[name]
    limits = replace(DEFAULT_LIMITS, picture_megapixels=100) if "of many parts" in name else DEFAULT_LIMITS
    if name != "no-data":
        monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("a decoder saw it"))
    tracemalloc.start()
    started = time.process_time()
    try:
        with pytest.raises(EncodingError, match=says) as caught:
            decode_picture_file(as_array(data), limits)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert "\n" not in str(caught.value)
    assert peak < 5_000_000 + 2 * len(data)
    assert time.process_time() - started < 8


def test_data_that_go_on_behind_the_picture_are_unpacked_no_further():
    """libpng unpacks all of it: 3 MB may be 3 GB."""
    surplus = zlib.compress(np.random.default_rng(0).bytes(3 * 2**20), 0)
    with pytest.raises(EncodingError, match=r"PNG of 8 x 8 px whose data unpack to more than 1\d{6} bytes; need 72"):
        decode_picture_file(as_array(png((8, 8), data=surplus)))


def test_large_data_are_unpacked_for_trial_and_read():
    pixels = np.random.default_rng(0).integers(0, 256, (1700, 1500), np.uint8)
    data = cv2.imencode(".png", pixels)[1].tobytes()
    assert len(data) > 2**21
    np.testing.assert_array_equal(decode_picture_file(as_array(data)).pixels, pixels)
    at = data.index(b"IDAT")
    length = struct.unpack(">I", data[at - 4 : at])[0]
    for broken in (data[at + 4 : at + 4 + length - 100_000], bytes(2**21 + 1)):
        with pytest.raises(EncodingError, match="whose data unpack to|do not unpack"):
            decode_picture_file(as_array(png((1500, 1700), data=broken)))


READ = {
    "baseline": (jpeg(frame(BASELINE, 64, 48), scan([1], data=grey_blocks(64, 48))), (48, 64)),
    "extended": (jpeg(frame(0xC1, 64, 48), scan([1], data=grey_blocks(64, 48))), (48, 64)),
    "4x4": (jpeg(frame(BASELINE, 9, 9, ((1, 0x44),)), scan([1], data=bytes(8))), (9, 9)),
    "fill": (jpeg(b"\xff" * 1000, frame(BASELINE, 8, 8), ONE), (8, 8)),
    "comments": (jpeg(segment(0xFE, b"note") * 500, frame(BASELINE, 8, 8), ONE), (8, 8)),
    "progressive": (
        jpeg(frame(PROGRESSIVE, 64, 48), scan([1], 0, 0, data=bytes(6)), scan([1], 1, 63, data=bytes(6))),
        (48, 64),
    ),
    "many-scans": (
        jpeg(frame(PROGRESSIVE, 64, 48), scan([1], 0, 0, data=bytes(6)), *[scan([1], 1, 63, data=bytes(6))] * 500),
        (48, 64),
    ),
    "one-colour": (png((3000, 2000)), (2000, 3000)),
    "bits": (png((5000, 4000), depth=1), (4000, 5000)),
    "16-bit": (png((50, 40), depth=16, color=2), (40, 50, 3)),
    "interlaced": (png((1, 1), interlaced=1), (1, 1)),
    "surplus": (png((8, 8), data=zlib.compress(bytes(100))), (8, 8)),
}


@pytest.mark.parametrize("name", READ)
def test_legitimate_files_are_read(name):
    data, shape = READ[name]
    pixels = decode_picture_file(as_array(data)).pixels
    assert pixels.shape == shape
    assert len(np.unique(pixels)) == 1


def test_png_chunks_beside_the_picture_never_reach_a_decoder(monkeypatch):
    """Profiles and texts that unpack to gigabytes, frames of animations of any size."""
    bomb = zlib.compress(bytes(10**7), 9)
    beside = (
        chunk(b"iCCP", b"a\0\0" + bomb),
        chunk(b"zTXt", b"a\0\0" + bomb),
        chunk(b"iTXt", b"a\0\1\0\0\0" + bomb),
        chunk(b"acTL", struct.pack(">II", 2**31 - 1, 0)),
        chunk(b"fcTL", struct.pack(">IIIIIHHBB", 0, 40000, 40000, 0, 0, 1, 1, 0, 0)),
    )
    expected = decode_picture_file(as_array(png((8, 8)))).pixels
    seen: list[bytes] = []
    decode = cv2.imdecode
    monkeypatch.setattr(cv2, "imdecode", lambda data, flags: seen.append(data.tobytes()) or decode(data, flags))
    np.testing.assert_array_equal(decode_picture_file(as_array(png((8, 8), *beside))).pixels, expected)
    assert seen == [png((8, 8))]


def test_a_picture_of_another_size_than_its_header_is_refused(monkeypatch):
    monkeypatch.setattr(cv2, "imdecode", lambda *_: np.zeros((9, 8), np.uint8))
    with pytest.raises(EncodingError, match="PNG of 8 x 8 px decodes to 8 x 9 px of 8 bits"):
        decode_picture_file(as_array(png((8, 8))))


@pytest.mark.parametrize(
    ("limits", "says"),
    [
        (replace(DEFAULT_LIMITS, picture_mb=12), r"needs 13 MB; need at most 12 \(limits.picture_mb\)"),
        (replace(DEFAULT_LIMITS, picture_megapixels=6), r"7 megapixels .* at most 6 \(limits.picture_megapixels\)"),
    ],
)
def test_limits_bound_what_is_decoded(make, limits, says):
    data = as_array(png((3000, 2000)))
    message = make("sensor_msgs/msg/CompressedImage", format="png", data=data)
    with pytest.raises(EncodingError, match=says):
        decode_compressed_image(message, limits=limits)
    with pytest.raises(EncodingError, match=says):
        decode_frame(message, None, rectified=False, limits=limits)
    assert decode_compressed_image(message, limits=DEFAULT_LIMITS).pixels.shape == (2000, 3000)


def test_a_change_of_the_limits_takes_effect_with_the_next_frame(make):
    message = make("sensor_msgs/msg/CompressedImage", format="png", data=as_array(png((3000, 2000))))
    before = Parameters()
    reading = frame_reading(ReadingParameters.of(before))
    assert reading.frame(message, None).image.pixels.shape == (2000, 3000)
    after = replace(before, limits=replace(before.limits, picture_mb=1))
    check_change(ReadingParameters.of(after), ReadingParameters.of(before))
    changed = frame_reading(ReadingParameters.of(after), reading)
    with pytest.raises(EncodingError, match=r"\(limits.picture_mb\)"):
        changed.frame(message, None)
    assert frame_reading(ReadingParameters.of(before), changed).frame(message, None).image.pixels.shape == (2000, 3000)


@pytest.mark.parametrize("size", [(10**9, 1), (1, 10**9), (2**32 - 1, 2**32 - 1), (10**5, 10**4)])
@pytest.mark.parametrize("encoding", ["mono8", "bayer_rggb16", "rgb8", "nv12", "yuv444p", "yuyv", "64FC9999"])
def test_raw_images_of_claims_alone(make, size, encoding):
    width, height = size
    for step in (0, 1, width, 2**32 - 1):
        message = make(
            "sensor_msgs/msg/Image", width=width, height=height, step=step, encoding=encoding, is_bigendian=1,
            data=np.zeros(100, np.uint8),
        )  # fmt: skip
        tracemalloc.start()
        try:
            with pytest.raises(EncodingError):
                decode_frame(message, None, rectified=False)
            assert tracemalloc.get_traced_memory()[1] < 100_000
        finally:
            tracemalloc.stop()


def test_a_strip_is_no_frame(make):
    """A picture of 2 rows costs the pipeline as much as a large one: what reduces frames keeps their rows."""
    message = make(
        "sensor_msgs/msg/Image", width=65536, height=2, step=65536, encoding="bayer_rggb8", is_bigendian=0,
        data=np.zeros(2 * 65536, np.uint8),
    )  # fmt: skip
    with pytest.raises(EncodingError, match="image: 65536 x 2 px; need sides of at most 65535"):
        decode_frame(message, None, rectified=False)


def test_checking_takes_a_small_part_of_decoding():
    pixels = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 256, (1080, 1920, 3), np.uint8), (3, 3), 0)
    data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].reshape(-1)

    def fastest(action) -> float:
        times = []
        for _ in range(7):
            started = time.process_time()
            action()
            times.append(time.process_time() - started)
        return min(times)

    assert fastest(lambda: check_picture_file(data)) < 0.15 * fastest(lambda: cv2.imdecode(data, -1))


def test_the_largest_that_is_read_stays_within_the_limit(tmp_path):
    """The estimate, compared with what the system measures: at a fifth of the limits."""
    program = (
        "import resource, sys\n"
        "resource.setrlimit(resource.RLIMIT_AS, (3 * 2**30,) * 2)\n"
        "from dataclasses import replace\n"
        "import numpy as np\n"
        "from imgu_ros.image_files.decoding import decode_picture_file\n"
        "from imgu_ros.config.parameters import DEFAULT_LIMITS\n"
        "data = np.fromfile(sys.argv[1], np.uint8)\n"
        "def peak():\n"  # ru_maxrss would be that of the process that started this one
        "    return int(open('/proc/self/status').read().split('VmHWM:')[1].split()[0])\n"
        "before = peak()\n"
        "pixels = decode_picture_file(data, replace(DEFAULT_LIMITS, picture_mb=200)).pixels\n"
        "print(pixels.nbytes, 1024 * (peak() - before))\n"
    )
    first, rest = scan([1, 2, 3], 0, 0, data=bytes(125_000)), scan([1], 1, 63, data=bytes(42_000))
    (tmp_path / "progressive").write_bytes(jpeg(frame(PROGRESSIVE, 4600, 4600, YCC), first, rest))
    (tmp_path / "grey").write_bytes(png((9900, 9900)))
    (tmp_path / "deep").write_bytes(png((4000, 4000), depth=16, color=2))
    for path in tmp_path.iterdir():
        done = subprocess.run(
            [sys.executable, "-c", program, str(path)], capture_output=True, text=True, timeout=100, check=False
        )
        assert done.returncode == 0, done.stderr
        size, used = map(int, done.stdout.split())
        assert 1.8 * size < used < 205e6
