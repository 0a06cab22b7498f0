# SPDX-License-Identifier: Apache-2.0
"""Pictures as recordings: where their times come from, order, depth, damage; and the same results as from a bag."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from imgu_ros.bags.reading import open_bag
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import BagError
from imgu_ros.files.camera_info_file import write_camera_info
from imgu_ros.files.frames_csv import read_rows
from imgu_ros.image_files.images import write_image
from imgu_ros.messages.camera_info import decode_camera_info
from imgu_ros.messages.frame import decode_frame
from imgu_ros.replay.recording import record_simulation
from imgu_ros.replay.replay import replay
from imgu_ros.simulate.sequence import Simulation
from imgu_ros.vision.camera.intrinsics import Camera

GREY = np.random.default_rng(3).integers(0, 256, (12, 16), np.uint8)


def times_of(*paths: Path, rate_hz: float = 0.0) -> list[int]:
    with open_bag(paths, rate_hz=rate_hz) as bag:
        return [message.time_ns for message in bag.messages()]


@pytest.mark.parametrize(
    ("names", "times_ns"),
    [
        (("1403636579763555584", "1403636579813555456"), (1403636579763555584, 1403636579813555456)),  # EuRoC
        (("1305031102.175304", "1305031102.211214"), (1305031102175304000, 1305031102211214000)),  # TUM RGB-D
        (("frame_1305031102175", "frame_1305031102275"), (1305031102175000000, 1305031102275000000)),
        (("left1305031102175304", "left1305031102175305"), (1305031102175304000, 1305031102175305000)),
        (("IMG_20240131_120000", "IMG_20240131_120001"), (1706702400 * 10**9, 1706702401 * 10**9)),
        (("PXL_20240131_120000123", "PXL_20240131_120000456"), (1706702400123000000, 1706702400456000000)),
    ],
)
def test_names_tell_when_pictures_were_taken(tmp_path, names, times_ns):
    for name in names:
        write_image(tmp_path / f"{name}.png", GREY)
    assert times_of(tmp_path) == list(times_ns)


def test_exif_tells_when_names_do_not(tmp_path):
    for index in range(3):
        exif = Image.Exif()
        exif.get_ifd(0x8769).update({0x9003: "2024:01:31 13:00:00", 0x9291: f"{index}5", 0x9011: "+01:00"})
        Image.fromarray(GREY).save(tmp_path / f"DSC{index}.jpg", exif=exif)
    start = int(datetime(2024, 1, 31, 12, tzinfo=UTC).timestamp())
    assert times_of(tmp_path) == [start * 10**9 + index * 10**8 + 5 * 10**7 for index in range(3)]


@pytest.mark.parametrize("tags", [{}, {0x9003: "2024:99:31 13:00:00"}, {0x9003: "\0"}, {0x9003: "2024:01:31 13:00:00"}])
def test_missing_damaged_and_equal_times_of_exif_do_not_count(tmp_path, tags):
    for index in range(3):
        exif = Image.Exif()
        exif.get_ifd(0x8769).update(tags)
        Image.fromarray(GREY).save(tmp_path / f"DSC{index}.jpg", exif=exif)
    with open_bag([tmp_path]) as bag:
        assert [message.time_ns for message in bag.messages()] == [0, 33333333, 66666667]
        assert ["--rate" in text for text in bag.warnings] == [True]


def test_a_rate_counts_more_than_names_and_natural_order_is_kept(tmp_path):
    for number in (1, 2, 10, 1403636579763555584):
        write_image(tmp_path / f"{number}.pgm", np.full((4, 4), min(number, 255), np.uint8))
    with open_bag([tmp_path], rate_hz=8) as bag:
        read = [(m.time_ns, int(m.message.data[0])) for m in bag.messages()]
        assert bag.warnings == ()
    assert read == [(0, 1), (125_000_000, 2), (250_000_000, 10), (375_000_000, 255)]


def test_a_shells_order_is_made_natural_and_a_users_own_is_kept(tmp_path):
    paths = [tmp_path / f"f{number}.pgm" for number in (1, 2, 10)]
    for value, path in enumerate(paths):
        write_image(path, np.full((4, 4), value, np.uint8))

    def values(given):
        with open_bag(given, rate_hz=1) as bag:
            return [int(message.message.data[0]) for message in bag.messages()]

    assert values(sorted(paths)) == [0, 1, 2]
    assert values([paths[2], paths[0], paths[1]]) == [2, 0, 1]


def test_a_pattern_names_some_pictures_of_a_folder(tmp_path):
    for name in ("a_1", "a_2", "b_1"):
        write_image(tmp_path / f"{name}.png", GREY)
    assert len(times_of(tmp_path / "a_*.png", rate_hz=1)) == 2
    with pytest.raises(BagError, match="no file fits this pattern"):
        open_bag([tmp_path / "c_*.png"])


def test_depth_colour_and_order_of_channels_are_those_of_the_file(tmp_path):
    deep = (GREY.astype(np.uint16) << 4) + 3
    colour = np.dstack((GREY, GREY // 2, 255 - GREY))
    for name, pixels in (("1.png", GREY), ("2.tif", deep), ("3.png", colour)):
        write_image(tmp_path / name, pixels)
    with open_bag([tmp_path], rate_hz=1) as bag:
        frames = [decode_frame(m.message, None, rectified=False).image for m in bag.messages()]
    for frame, pixels in zip(frames, (GREY, deep, colour), strict=True):
        np.testing.assert_array_equal(frame.pixels, pixels)
    assert [str(frame.layout.color) for frame in frames] == ["mono", "mono", "rgb"]


def test_a_picture_that_cannot_be_read_keeps_its_row(tmp_path):
    """The frame is rejected with the file's name and what is wrong with it; the others are there."""
    simulated, pictures = tmp_path / "simulated", tmp_path / "pictures"
    record_simulation(simulated, Simulation(width=320, height=240, frames=4, seed=2))
    pictures.mkdir()
    for index, image in enumerate(images_of(simulated)):
        write_image(pictures / f"{index}.png", image)
    (pictures / "1.png").write_bytes((pictures / "1.png").read_bytes()[:500])
    parameters = parameters_from({"targets.images": [str(simulated / "poster.png")], "raw.encoding": "bayer_rggb8"})
    said: list[str] = []
    replay([pictures], tmp_path / "out", parameters, rate_hz=30, on_warning=said.append)
    rows = list(read_rows(tmp_path / "out" / "frames.csv"))
    assert [row["status"] == "rejected" for row in rows] == [False, True, False, False]
    assert "1.png" in rows[1]["reason"]
    assert any("1.png" in text for text in said)


def test_mosaics_in_files_give_what_the_same_bag_gives(tmp_path):
    simulated, pictures = tmp_path / "simulated", tmp_path / "pictures"
    record_simulation(simulated, Simulation(width=320, height=240, frames=5, seed=1))
    pictures.mkdir()
    # Random numbers depend on a frame's stamp.
    with open_bag([simulated]) as bag:
        stamps = [m.time_ns for m in bag.messages() if hasattr(m.message, "encoding")]
    for stamp, image in zip(stamps, images_of(simulated), strict=True):
        write_image(pictures / f"{stamp}.pgm", image)
    write_camera_info(tmp_path / "camera.yaml", camera_of(simulated))
    given = {
        "targets.images": [str(simulated / "poster.png")],
        "raw.encoding": "bayer_rggb8",
        "targets.widths_m": [0.5],
        "camera.info_file": str(tmp_path / "camera.yaml"),
    }
    rows = []
    for name, path in (("bag", simulated), ("pictures", pictures)):
        out = tmp_path / f"results_{name}"
        replay([path], out, parameters_from(given))
        rows.append(list(read_rows(out / "frames.csv")))
    columns = [
        "status",
        "pose_status",
        "tx",
        "qx",
        "c11",
        "n_inliers",
        "rms_px",
        *(f"h{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)),
    ]
    assert [[row[c] for c in columns] for row in rows[0]] == [[row[c] for c in columns] for row in rows[1]]
    assert {row["status"] for row in rows[0]} <= {"tracked", "detected"}


def images_of(bag: Path) -> list[np.ndarray]:
    with open_bag([bag]) as opened:
        messages = [m.message for m in opened.messages() if hasattr(m.message, "encoding")]
    return [np.asarray(message.data).reshape(message.height, message.width) for message in messages]


def camera_of(bag: Path) -> Camera:
    with open_bag([bag]) as opened:
        info = next(m.message for m in opened.messages() if not hasattr(m.message, "encoding"))
    camera = decode_camera_info(info, rectified=False, image_size=(info.width, info.height)).camera
    assert camera is not None
    return camera


def test_opencv_reads_the_same_pixels(tmp_path):
    write_image(tmp_path / "a.png", np.dstack((GREY, GREY // 2, 255 - GREY)))
    with open_bag([tmp_path / "a.png"]) as bag:
        (message,) = (m.message for m in bag.messages())
    read = cv2.imread(str(tmp_path / "a.png"))[:, :, ::-1]
    np.testing.assert_array_equal(np.asarray(message.data).reshape(read.shape), read)
