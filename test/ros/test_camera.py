# SPDX-License-Identifier: Apache-2.0
"""`imgu camera`: what a driver would publish, of files and of a webcam, and poses from it without a ROS driver."""

from __future__ import annotations

import signal
import time

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

from imgu_ros.cli.main import main
from imgu_ros.errors import BagError
from imgu_ros.files.camera_info_file import write_camera_info
from imgu_ros.image_files.images import write_image
from imgu_ros.messages.header import decode_header
from imgu_ros.messages.image import decode_image
from imgu_ros.ros import webcam
from imgu_ros.vision.camera.rotation import log_so3

IMAGE, INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"


@pytest.fixture
def pictures(world, tmp_path):
    """The frames as files, and the camera's calibration."""
    for index, frame in enumerate(world.frames):
        write_image(tmp_path / f"{index}.pgm", frame.image.pixels)
    write_camera_info(tmp_path / "camera.yaml", world.frames[0].camera)
    return tmp_path


def test_pictures_go_out_as_a_driver_would_send_them(imgu, peer, world, pictures):
    peer.hear("/image_raw", IMAGE)
    peer.hear("/camera_info", INFO)
    camera = imgu(
        "camera", str(pictures), "--rate", "20", "--camera-info", str(pictures / "camera.yaml"), "--wait-for", "1",
        "--frame-id", "eye",
    )  # fmt: skip
    images, infos = peer.heard["/image_raw"], peer.heard["/camera_info"]
    peer.wait(lambda: len(images) == 4 and len(infos) == 4, "four frames")
    assert camera.wait() == 0
    assert "4 frames published" in camera.text
    stamps = [decode_header(message).stamp_ns for message in images]
    assert stamps == [decode_header(message).stamp_ns for message in infos]
    # Where the machine was held up, a frame counts as taken later.
    assert np.diff(stamps).min() >= 49_999_000
    assert np.median(np.diff(stamps)) == pytest.approx(50e6, abs=1e3)
    assert abs(stamps[0] * 1e-9 - time.time()) < 60
    for image, info, frame in zip(images, infos, world.frames, strict=True):
        assert (image.header.frame_id, image.encoding) == ("eye", "mono8")
        np.testing.assert_array_equal(decode_image(image).pixels, frame.image.pixels)
        np.testing.assert_array_equal(np.reshape(info.k, (3, 3)), frame.camera.K)
        assert (info.width, info.height) == (frame.camera.width, frame.camera.height)


def test_poses_need_no_other_driver(imgu, peer, world, pictures):
    peer.hear("/pose", POSE)
    node = imgu("node", "perception", *world.arguments, "-p", "raw.encoding:=bayer_rggb8")
    node.wait_for_line("targets: poster")
    camera = imgu(
        "camera",
        str(pictures),
        "--rate",
        "5",
        "--camera-info",
        str(pictures / "camera.yaml"),
        "--wait-for",
        "1",
        "--loop",
    )
    poses = peer.heard["/pose"]
    peer.wait(lambda: len(poses) >= 6, "poses of more than one round")
    assert camera.stop() < 5
    assert camera.process.returncode == 0
    expected = [result.first.pose for result in world.results]
    for message in poses:
        position, q = message.pose.pose.position, message.pose.pose.orientation
        t = np.array((position.x, position.y, position.z))
        near = min(expected, key=lambda pose: float(np.linalg.norm(pose.t - t)))
        # Random numbers differ with the stamps: below a tenth of what a frame's noise moves a pose by.
        np.testing.assert_allclose(t, near.t, atol=1e-4)
        x, y, z, w = q.x, q.y, q.z, q.w
        R = np.array(
            (
                (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
                (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
                (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
            )
        )
        assert np.linalg.norm(log_so3(R @ near.R.T)) < 1e-3


def test_a_damaged_picture_is_said_and_left_out(imgu, peer, pictures):
    (pictures / "1.pgm").write_bytes(b"P5 480 360 255 ")
    peer.hear("/image_raw", IMAGE)
    camera = imgu("camera", str(pictures), "--rate", "20", "--wait-for", "1")
    peer.wait(lambda: len(peer.heard["/image_raw"]) == 3, "three frames")
    assert camera.wait() == 0
    assert len(peer.heard["/image_raw"]) == 3
    assert "imgu: warning: 1.pgm" in camera.text
    assert "no --camera-info" in camera.text


def test_a_calibration_of_another_size_is_said(imgu, peer, pictures):
    write_image(pictures / "other.png", np.zeros((48, 64), np.uint8))
    camera = imgu("camera", str(pictures / "other.png"), "--camera-info", str(pictures / "camera.yaml"))
    assert camera.wait() == 0
    assert "of images of 480 x 360 px, not of 64 x 48; need a calibration of these" in camera.text


def test_one_picture_again_and_again_comes_at_the_usual_rate(imgu, peer, pictures):
    peer.hear("/image_raw", IMAGE)
    camera = imgu("camera", str(pictures / "0.pgm"), "--loop", "--wait-for", "1")
    peer.wait(lambda: len(peer.heard["/image_raw"]) >= 10, "ten frames")
    camera.stop()
    stamps = [decode_header(message).stamp_ns for message in peer.heard["/image_raw"]]
    assert np.diff(stamps).min() >= 33_000_000


def test_pictures_taken_days_apart_do_not_come_days_apart(imgu, peer, world, tmp_path):
    for day in (1, 2, 3):
        write_image(tmp_path / f"IMG_2024010{day}_120000.png", world.frames[0].image.pixels)
    peer.hear("/image_raw", IMAGE)
    camera = imgu("camera", str(tmp_path), "--wait-for", "1")
    peer.wait(lambda: len(peer.heard["/image_raw"]) == 3, "three frames")
    assert camera.wait() == 0
    stamps = [decode_header(message).stamp_ns for message in peer.heard["/image_raw"]]
    assert np.diff(stamps).max() < 1.5e9


def test_ctrl_c_ends_a_wait(imgu, pictures):
    camera = imgu("camera", str(pictures), "--wait-for", "3")
    camera.wait_for_line("publishing")
    camera.wait_for_handler(signal.SIGINT)
    assert camera.stop() < 5
    assert camera.process.returncode == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["/dev/video77"], "camera /dev/video77: cannot be opened"),
        (["0", "--loop"], "--loop: for a webcam, which has no end"),
        (["gone.mp4", "--size", "640x480"], "--size: for files, which have their own"),
        (["gone.mp4"], "gone.mp4: No such file or directory"),
        (["gone"], "gone: No such file or directory; need a webcam"),
        ([__file__], "no video and no picture; need one, or `imgu play` for a bag"),
    ],
)
def test_what_cannot_be_published_is_one_line(capsys, arguments, said):
    assert main(["camera", *arguments]) == 1
    error = capsys.readouterr().err
    assert said in error
    assert error.count("imgu: error") == 1


@pytest.mark.parametrize("arguments", [["--size", "640"], ["--size", "0x480"], ["--rate", "0"], ["--wait-for", "-1"]])
def test_options_are_checked(capsys, arguments):
    assert main(["camera", *arguments]) == 2
    assert "need" in capsys.readouterr().err


class FakeCapture:
    """What OpenCV's capture does: frames, failures, and the driver's time on the monotonic clock."""

    def __init__(self, reads, captured_ms):
        self.reads, self.captured_ms, self.settings, self.is_released = list(reads), captured_ms, {}, False

    def isOpened(self):
        return True

    def set(self, name, value):
        self.settings[name] = value

    def get(self, name):
        return self.captured_ms()

    def read(self):
        pixels = self.reads.pop(0)
        return pixels is not None, pixels

    def release(self):
        self.is_released = True


PIXELS = np.zeros((4, 6, 3), np.uint8)


@pytest.mark.parametrize(
    ("captured_ms", "age_s"),
    [(lambda: 1e3 * (time.monotonic() - 0.04), 0.04), (lambda: 0.0, 0.0), (lambda: 1e3 * (time.monotonic() + 5), 0.0)],
)
def test_a_webcam_frame_has_its_time_of_capture_where_the_driver_tells_it(monkeypatch, captured_ms, age_s):
    fake = FakeCapture([PIXELS], captured_ms)
    monkeypatch.setattr(webcam.cv2, "VideoCapture", lambda source, backend: fake)
    camera = webcam.Webcam("0", (640, 480), 30.0)
    stamp_ns, pixels = camera.read()
    assert time.time_ns() - stamp_ns == pytest.approx(age_s * 1e9, abs=3e7)
    assert pixels.shape == PIXELS.shape
    assert {640, 480, 30.0} <= set(fake.settings.values())
    camera.close()
    assert fake.is_released


def test_one_failed_read_is_no_end_and_many_are(monkeypatch):
    fake = FakeCapture([None, None, PIXELS, None, None, None], lambda: 0.0)
    monkeypatch.setattr(webcam.cv2, "VideoCapture", lambda source, backend: fake)
    camera = webcam.Webcam("0")
    camera.read()
    with pytest.raises(BagError, match="gives no frame any more"):
        camera.read()
