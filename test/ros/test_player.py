# SPDX-License-Identifier: Apache-2.0
"""`imgu play`: what is heard is what was recorded, when it was recorded."""

from __future__ import annotations

import contextlib
import os
import sqlite3
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

import cv2

from imgu_ros.bags.messages import make_message
from imgu_ros.bags.writing import BagWriter
from imgu_ros.cli.main import main
from imgu_ros.config.parameters import LimitsParameters
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import BagError
from imgu_ros.localizer import Localizer
from imgu_ros.messages.camera_info import camera_info_message
from imgu_ros.messages.geometry import pose_message
from imgu_ros.messages.header import Header, decode_header, header_message
from imgu_ros.messages.image import image_message
from imgu_ros.messages.results import result_header
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.ros import middleware, player
from imgu_ros.ros.messages import make_message as make_ros_message
from imgu_ros.ros.messages import message_class
from imgu_ros.ros.qos import image_qos
from imgu_ros.ros.stopping import StopSignal
from imgu_ros.simulate.sequence import Simulation, default_targets, simulate_sequence

IMAGE = "sensor_msgs/msg/Image"
START_NS = 1_600_000_000_000_000_000
PERIOD_NS = 50_000_000


def write_bag(path: Path, count: int = 20, *, storage: str = "mcap", compression: str = "none") -> list[np.ndarray]:
    rng = np.random.default_rng(1)
    pictures = [rng.integers(0, 255, (48, 64), np.uint8) for _ in range(count)]
    with BagWriter(path, storage, compression) as bag:
        for index, pixels in enumerate(pictures):
            time_ns = START_NS + index * PERIOD_NS
            # A header that is not the time of recording: the player must not touch it.
            header = Header(time_ns - 7_000_000, "camera")
            bag.write("/cam/image_raw", image_message(make_message, header, pixels, "mono8"), time_ns)
            if index == 0:
                transform = make_message(
                    "geometry_msgs/msg/TransformStamped", header=header_message(make_message, header)
                )
                tf = make_message("tf2_msgs/msg/TFMessage", transforms=[transform])
                bag.write("/tf", tf, time_ns)
    return pictures


def test_large_images_come_without_loss(imgu, peer, tmp_path):
    """Three megabytes each, best effort as sensor data is: the player sets the DDS profile by itself."""
    if any(os.environ.get(name) for name in ("FASTDDS_BUILTIN_TRANSPORTS", "RMW_IMPLEMENTATION")):
        pytest.skip("transports are chosen by the environment")
    if "--shm-size" in middleware.profile_line():
        pytest.skip(middleware.profile_line())
    count = 40
    with BagWriter(tmp_path / "bag") as bag:
        for index in range(count):
            time_ns = START_NS + index * PERIOD_NS
            pixels = np.full((720, 1280, 3), index, np.uint8)
            bag.write("/cam/image_raw", image_message(make_message, Header(time_ns, "cam"), pixels, "rgb8"), time_ns)
    heard: list[bytes] = []
    peer.node.create_subscription(message_class(IMAGE), "/cam/image_raw", heard.append, image_qos(), raw=True)
    play = imgu("play", str(tmp_path / "bag"), "--wait-for", "1", "--ros-args", "--log-level", "player:=debug")
    peer.wait(lambda: len(heard) == count or play.process.poll() is not None, "all images")
    peer.spin(0.3)
    assert [message[-1] for message in heard] == list(range(count))
    assert "DDS profile: fastdds_large_images" in play.text


def test_too_little_shared_memory_is_said_once(ros_domain, tmp_path, monkeypatch):
    write_bag(tmp_path / "bag", 5)
    sizes: list[int] = []
    monkeypatch.setattr(player, "large_message_warnings", lambda size: sizes.append(size) or ["too large"])
    said: list[str] = []
    with StopSignal() as stop:
        player.play([tmp_path / "bag"], player.PlayOptions(rate=10.0), [], stop, said.append)
    assert [line for line in said if "too large" in line] == ["imgu: warning: /cam/image_raw: too large"]
    assert len(sizes) == 1
    assert 48 * 64 < sizes[0] < 48 * 64 + 200


@pytest.mark.parametrize(("storage", "compression"), [("mcap", "zstd"), ("sqlite3", "zstd")])
def test_messages_come_whole_in_order_and_in_time(imgu, peer, tmp_path, storage, compression):
    pictures = write_bag(tmp_path / "bag", storage=storage, compression=compression)
    times: list[float] = []
    peer.hear("/cam/image_raw", IMAGE)
    peer.hear("/clock", "rosgraph_msgs/msg/Clock")
    heard = peer.heard["/cam/image_raw"]
    play = imgu("play", str(tmp_path / "bag"), "--wait-for", "1")

    def arrived() -> bool:
        if len(heard) > len(times):
            times.append(time.monotonic())
        return len(heard) == len(pictures)

    peer.wait(arrived, "all images")
    assert play.wait() == 0, play.text
    for index, (message, pixels) in enumerate(zip(heard, pictures, strict=True)):
        assert decode_header(message) == Header(START_NS + index * PERIOD_NS - 7_000_000, "camera")
        assert np.array_equal(np.frombuffer(message.data, np.uint8).reshape(48, 64), pixels)
    # Not faster than recorded; how much slower depends on what else the machine does.
    assert -0.2 < times[-1] - times[0] - (len(pictures) - 1) * PERIOD_NS * 1e-9 < 5
    peer.spin(0.2)  # the last /clock may come after the last image
    clocks = [c.clock.sec * 10**9 + c.clock.nanosec for c in peer.heard["/clock"]]
    assert clocks == sorted(clocks)
    assert clocks[0] >= START_NS
    assert clocks[-1] == START_NS + (len(pictures) - 1) * PERIOD_NS
    assert "/cam/image_raw 20" in play.text
    if "tf2_msgs" in play.text:
        assert "skipping /tf: tf2_msgs/msg/TFMessage is not installed" in play.text


def test_part_of_a_bag_faster_remapped_and_again(imgu, peer, tmp_path, prompt_s):
    write_bag(tmp_path / "bag")
    peer.hear("/eye", IMAGE)
    play = imgu(
        "play", str(tmp_path / "bag"), "--wait-for", "1", "--rate", "4", "--start", "0.5", "--duration", "0.2",
        "--loop", "--ros-args", "-r", "/cam/image_raw:=/eye",
    )  # fmt: skip
    peer.wait(lambda: len(peer.heard["/eye"]) >= 12, "three rounds")
    stamps = [decode_header(message).stamp_ns for message in peer.heard["/eye"]]
    expected = [START_NS + index * PERIOD_NS - 7_000_000 for index in range(10, 15)]
    assert stamps[:10] == expected + expected
    assert play.stop() < prompt_s
    assert play.process.returncode == 0
    assert "Traceback" not in play.text


def test_topics_that_ros_does_not_know_stop_nothing(imgu, peer, tmp_path):
    """Names and types as other recorders write them (Foxglove's JSON channels, Latin-1); the images are played."""
    with BagWriter(tmp_path / "bag", "sqlite3") as bag:
        for index in range(5):
            pixels = np.full((48, 64), index, np.uint8)
            header = Header(START_NS + index * PERIOD_NS, "camera")
            bag.write("/cam/image_raw", image_message(make_message, header, pixels, "mono8"), header.stamp_ns)
    (path,) = (tmp_path / "bag").glob("*.db3")
    odd = [
        ("/json", "", "json"),
        ("/proto", "foxglove.CompressedImage", "protobuf"),
        ("/gr\xf6\xdfe", "std_msgs/msg/String", "cdr"),
        ("/a b", "std_msgs/msg/String", "cdr"),
        ("/1a", "std_msgs/msg/String", "cdr"),
        ("no slash//", "std_msgs/msg/String", "cdr"),
        ("/up", "../msg/X", "cdr"),
    ]
    with contextlib.closing(sqlite3.connect(path)) as database:
        (columns,) = database.execute("SELECT COUNT(*) FROM pragma_table_info('topics')").fetchone()
        for identity, (name, kind, encoding) in enumerate(odd, 100):
            row = (identity, name.encode("latin-1"), kind, encoding, *[""] * (columns - 4))
            database.execute(f"INSERT INTO topics VALUES({', '.join('?' * columns)})", row)
            database.execute("INSERT INTO messages VALUES(NULL, ?, ?, ?)", (identity, START_NS, b"{}\0\0\0\0\0\0"))
        database.commit()
    peer.hear("/cam/image_raw", IMAGE)
    play = imgu("play", str(path), "--wait-for", "1")
    peer.wait(lambda: len(peer.heard["/cam/image_raw"]) == 5 or play.process.poll() is not None, "all images")
    assert play.wait() == 0, play.text
    assert "Traceback" not in play.text
    assert "skipping /json: its type is not known" in play.text
    assert "skipping /gr\xf6\xdfe: " in play.text
    assert play.text.count("skipping ") == len(odd)


def test_waiting_for_subscribers_is_bounded_and_can_be_stopped(imgu, peer, tmp_path, prompt_s):
    write_bag(tmp_path / "bag")
    bounded = imgu("play", str(tmp_path / "bag"), "--wait-for", "1", "--timeout", "0.3")
    unbounded = imgu("play", str(tmp_path / "bag"), "--wait-for", "1")
    unbounded.wait_for_line("waiting for subscribers")
    assert bounded.wait() == 1
    assert "/cam/image_raw: 0 after 0.3 s; need 1" in bounded.text
    domain = f"(ROS domain {peer.context.get_domain_id()}"
    assert domain in bounded.text
    assert f"waiting for subscribers on /cam/image_raw: 0 of 1 {domain}" in unbounded.text
    assert "Traceback" not in bounded.text
    assert unbounded.process.poll() is None
    assert unbounded.stop() < prompt_s
    assert unbounded.process.returncode == 0, unbounded.text


def test_a_played_bag_gives_the_offline_poses(imgu, peer, tmp_path, prompt_s):
    target = default_targets(1, seed=5, width_m=0.5)[0]
    cv2.imwrite(str(tmp_path / "poster.png"), target.pixels[:, :, ::-1])
    simulation = Simulation(width=480, height=360, frames=3, rate_hz=1.0, seed=5)
    frames = [simulated.frame for simulated in simulate_sequence(simulation, [target])]
    with BagWriter(tmp_path / "bag") as bag:
        for frame in frames:
            header = Header(frame.stamp_ns, frame.frame_id)
            image = image_message(make_message, header, frame.image.pixels, "bayer_rggb8")
            bag.write("/cam/image_raw", image, frame.stamp_ns)
            bag.write("/cam/camera_info", camera_info_message(make_message, header, frame.camera), frame.stamp_ns)
    parameters = parameters_from({"targets.images": ["poster.png"], "targets.widths_m": [0.5]})
    chain = Localizer(parameters, prepare_references([TargetImage("poster", target.pixels, 0.5)], parameters))
    results = [chain.process(frame) for frame in frames]

    node = imgu(
        "node", "perception", "-p", f"targets.images:=[{tmp_path / 'poster.png'}]", "-p", "targets.widths_m:=[0.5]",
        "-r", "image_raw:=/cam/image_raw",
    )  # fmt: skip
    peer.hear("/pose", "geometry_msgs/msg/PoseWithCovarianceStamped")
    play = imgu("play", str(tmp_path / "bag"), "--wait-for", "1")
    peer.wait(lambda: len(peer.heard["/pose"]) == len(frames), "all poses")
    expected = [pose_message(make_ros_message, result_header(r), r.first.pose) for r in results]
    assert peer.heard["/pose"] == expected
    assert play.wait() == 0
    assert node.stop() < prompt_s
    assert node.process.returncode == 0


def test_the_limits_of_reading_are_parameters(tmp_path, monkeypatch, capsys):
    given = []

    def play(paths, options, ros_arguments, stop, say):
        given.append((options.limits, ros_arguments))
        raise BagError("enough")

    monkeypatch.setattr(player, "play", play)
    monkeypatch.setattr("imgu_ros.ros.middleware.set_profile", lambda: None)
    limits = ["-p", "limits.message_mb:=1000", "-p", "limits.expansion:=7"]
    assert main(["play", "bag", *limits, "--ros-args", "-p", "use_sim_time:=true"]) == 1
    assert given == [(LimitsParameters(message_mb=1000, expansion=7), ["--ros-args", "-p", "use_sim_time:=true"])]
    assert main(["play", "bag", "-p", "limits.picture_mb:=5"]) == 1
    assert "limits.picture_mb: not used by this command" in capsys.readouterr().err


def test_the_limits_reach_the_bag(ros_domain, monkeypatch):
    def opened(paths, *, limits):
        raise BagError(f"opened with {limits.message_mb} MB")

    monkeypatch.setattr(player, "open_bag", opened)
    options = player.PlayOptions(limits=LimitsParameters(message_mb=1000))
    with pytest.raises(BagError, match="opened with 1000 MB"), StopSignal() as stop:
        player.play([Path("bag")], options, [], stop, lambda line: None)
