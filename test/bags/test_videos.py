# SPDX-License-Identifier: Apache-2.0
"""Video files as recordings: times, pixels, rotation, damage."""

from __future__ import annotations

import sys
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from imgu_ros.bags.decoding import message_from_cdr
from imgu_ros.bags.reading import open_bag
from imgu_ros.errors import BagError
from imgu_ros.messages.frame import decode_frame
from imgu_ros.messages.image import decode_image

TICKS = 90_000
#: Frames of a camera whose rate varies between 12 and 50 Hz.
TIMES_S = np.cumsum(np.r_[0.5, np.random.default_rng(0).uniform(0.02, 0.08, 39)])


def picture(index: int, width: int = 96, height: int = 64) -> np.ndarray:
    coarse = np.random.default_rng(5).integers(0, 256, (height // 8, width // 8, 3), np.uint8)
    return np.roll(coarse.repeat(8, 0).repeat(8, 1), (index, 3 * index), (0, 1))


def write_video(path: Path, codec: str = "libx264", pixels: str = "yuv420p", times_s=TIMES_S, **options: str) -> Path:
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30, options=options)
        height, width = picture(0).shape[:2]
        stream.width, stream.height, stream.pix_fmt = width, height, pixels
        stream.codec_context.time_base = Fraction(1, TICKS)
        for index, time in enumerate(times_s):
            frame = av.VideoFrame.from_ndarray(picture(index), format="rgb24")
            frame.pts, frame.time_base = round(time * TICKS), Fraction(1, TICKS)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def frames_of(*paths: Path, warnings: list[str] | None = None):
    with open_bag(paths) as bag:
        read = [(m.time_ns, decode_frame(m.message, None, rectified=False)) for m in bag.messages()]
        if warnings is not None:
            warnings += bag.warnings
    return read


@pytest.mark.parametrize(
    ("name", "codec", "tick_s"),
    [("a.mp4", "libx264", 1 / TICKS), ("a.mov", "libx264", 1 / TICKS), ("a.mkv", "libx264", 1e-3)],
)
def test_frames_keep_their_own_times(tmp_path, name, codec, tick_s):
    path = write_video(tmp_path / name, codec)
    frames = frames_of(path)
    times_ns = [time_ns for time_ns, _ in frames]
    assert times_ns[0] == 0
    assert [frame.stamp_ns for _, frame in frames] == times_ns
    np.testing.assert_allclose(np.array(times_ns) * 1e-9, TIMES_S - TIMES_S[0], atol=tick_s)
    with open_bag([path]) as bag:
        assert [(topic.name, topic.type_name, topic.count) for topic in bag.topics] == [
            ("/image_raw", "sensor_msgs/msg/Image", len(TIMES_S))
        ]
        assert abs(bag.end_ns - times_ns[-1]) < 1e8


def test_pixels_of_a_lossless_video_are_exact(tmp_path):
    for index, (_, frame) in enumerate(frames_of(write_video(tmp_path / "a.mov", "png", "rgb24"))):
        np.testing.assert_array_equal(frame.image.pixels[:, :, ::-1], picture(index))


@pytest.mark.parametrize(
    ("pixels", "dtype", "encoding"), [("gray", np.uint8, "mono8"), ("gray16le", np.uint16, "mono16")]
)
def test_grey_keeps_its_depth(tmp_path, pixels, dtype, encoding):
    """As cameras of machines record, and what `raw.encoding` makes a mosaic of."""
    written = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, (48, 64)).astype(dtype)
    with av.open(str(tmp_path / "a.mkv"), "w") as container:
        stream = container.add_stream("ffv1", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, pixels
        container.mux(stream.encode(av.VideoFrame.from_ndarray(written, format=pixels)))
        container.mux(stream.encode())
    with open_bag([tmp_path / "a.mkv"]) as bag:
        (message,) = (one.message for one in bag.messages())
    assert message.encoding == encoding
    np.testing.assert_array_equal(decode_image(message).pixels, written)
    np.testing.assert_array_equal(decode_image(message, f"bayer_rggb{8 * written.itemsize}").pixels, written)


def test_several_videos_follow_one_another_in_natural_order(tmp_path):
    even = np.arange(5) / 25
    for number in (2, 10, 1):
        write_video(tmp_path / f"part{number}.mp4", times_s=even[: 2 + number % 3])
    times_ns = [time_ns for time_ns, _ in frames_of(tmp_path)]
    assert len(times_ns) == 3 + 4 + 3
    steps = np.diff(times_ns) * 1e-9
    np.testing.assert_allclose(steps, 1 / 25, atol=0.01)
    assert [t for t, _ in frames_of(*(tmp_path / f"part{n}.mp4" for n in (1, 2, 10)))] == times_ns


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_frames_are_upright_as_players_show_them(tmp_path, turns):
    path = write_video(tmp_path / "phone.mp4", crf="10")
    # The display matrix of the track header (ISO 14496-12, 8.3.2): (x, y) is shown at (a x + c y, b x + d y).
    one, w = (0x10000).to_bytes(4, "big"), (0x40000000).to_bytes(4, "big")
    minus, zero = (0xFFFF0000).to_bytes(4, "big"), bytes(4)
    identity = one + 3 * zero + one + 3 * zero + w
    a, b = {1: (zero, one), 2: (minus, zero), 3: (zero, minus)}[turns]
    c, d = {1: (minus, zero), 2: (zero, minus), 3: (one, zero)}[turns]
    content = path.read_bytes()
    at = content.index(identity, content.index(b"tkhd"))
    path.write_bytes(content[:at] + a + b + zero + c + d + 3 * zero + w + content[at + len(identity) :])
    expected = np.rot90(picture(0), -turns)
    got = frames_of(path)[0][1].image.pixels[:, :, ::-1]
    assert got.shape == expected.shape
    # The chroma has half the resolution.
    assert np.abs(got.astype(int) - expected).mean() < 8
    assert np.abs(got[::-1, ::-1].astype(int) - expected).mean() > 30


def test_a_cut_file_gives_its_beginning_and_says_so(tmp_path):
    path = write_video(tmp_path / "a.mkv", times_s=np.arange(90) / 25, g="10")
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 6 // 10])
    warnings: list[str] = []
    assert 20 < len(frames_of(path, warnings=warnings)) < 80
    assert len(warnings) == 1
    assert "cut" in warnings[0]


def test_damage_is_said_and_the_other_frames_are_there(tmp_path):
    path = write_video(tmp_path / "a.mp4", g="5")
    content = bytearray(path.read_bytes())
    middle = content.index(b"mdat") + 2000
    content[middle : middle + 300] = bytes(300)
    path.write_bytes(content)
    warnings: list[str] = []
    assert len(frames_of(path, warnings=warnings)) >= len(TIMES_S) - 5
    assert any("damaged" in text or "can be read" in text for text in warnings)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("text.mp4", b"hello", "Invalid data found when processing input; need a video file that FFmpeg reads"),
        ("empty.mkv", b"", "need a video file that FFmpeg reads"),
        ("gone.mov", None, "No such file or directory"),
        ("cut.mp4", b"\0\0\0\x20ftypisom" + bytes(500), "cut or damaged .*; need the whole file: copy it again"),
    ],
)
def test_what_is_no_video_is_one_line(tmp_path, name, content, said):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(BagError, match=said) as error:
        open_bag([tmp_path / name])
    assert str(tmp_path / name) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_file_with_sound_alone(tmp_path):
    path = tmp_path / "sound.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000)
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
        sound.sample_rate = 8000
        container.mux(stream.encode(sound))
        container.mux(stream.encode())
    with pytest.raises(BagError, match="no video in it"):
        open_bag([path])


def test_without_pyav_the_message_says_what_to_install(tmp_path, monkeypatch):
    path = write_video(tmp_path / "a.mp4")
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(BagError, match="pip install av"):
        open_bag([path])


def test_a_frame_can_be_published_as_it_is(tmp_path):
    """`imgu play` sends what the pipeline reads."""
    path = write_video(tmp_path / "a.mov", "png", "rgb24")
    with open_bag([path]) as bag:
        sent = [message_from_cdr(raw.channel.type_name, raw.data) for raw in bag.cdr_messages()]
        read = [message.message for message in bag.messages()]
    assert len(sent) == len(read) == len(TIMES_S)
    for one, other in zip(sent, read, strict=True):
        assert (one.width, one.height, one.encoding, one.header.frame_id) == (96, 64, "bgr8", "camera")
        assert one.header.stamp == other.header.stamp
        np.testing.assert_array_equal(one.data, other.data)


def test_bags_videos_and_pictures_do_not_mix(tmp_path):
    video = write_video(tmp_path / "a.mp4")
    cv2.imwrite(str(tmp_path / "a.png"), picture(0))
    for paths in ([video, tmp_path / "a.png"], [video, tmp_path / "bag.mcap"], [tmp_path]):
        with pytest.raises(BagError, match=r"several kinds|videos and pictures in one folder"):
            open_bag(paths)


def test_a_rate_is_for_pictures(tmp_path):
    with pytest.raises(BagError, match="has times"):
        open_bag([write_video(tmp_path / "a.mp4")], rate_hz=10)
