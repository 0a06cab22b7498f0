# SPDX-License-Identifier: Apache-2.0
"""Boards and bundles over DDS: what the node publishes of them is what the pipeline computes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

from imgu_ros.config.values import parameters_from
from imgu_ros.files.target_images import load_target_images
from imgu_ros.frame import Frame
from imgu_ros.localizer import Localizer
from imgu_ros.messages.geometry import pose_message
from imgu_ros.messages.results import result_header
from imgu_ros.reference.bundle import BundleImage
from imgu_ros.reference.marker import BoardImage, MarkerImage, marker_image
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.result import Result, Status
from imgu_ros.ros.messages import make_message
from imgu_ros.types import Floats
from imgu_ros.vision.camera.euler import from_euler
from imgu_ros.vision.camera.intrinsics import make_camera as camera_of
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

pytestmark = pytest.mark.skipif(not hasattr(cv2, "aruco"), reason="this OpenCV has no aruco module")

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
BOARD = "grid: {family: tag36h11, rows: 2, columns: 2, size: 0.08, gap: 0.02}\n"
CORNER = """
family: aruco_4x4_50
size: 0.08
markers:
- {id: 1, z: 0.0}
- {id: 2, x: 0.055, z: -0.055, pitch_deg: 90}
"""
WIDTH, HEIGHT = 480, 360
K = np.array([[500.0, 0, 239.5], [0, 500, 179.5], [0, 0, 1]])


def drawn(scene: Floats, image: MarkerImage, R: Floats, t: Floats) -> None:
    """Draw a marker or a board into a scene, twice as fine as the frame, at camera_from_target."""
    drawing = image.template
    left, _, right, _ = drawing.outline
    scale = image.width_m / (right - left)
    x, y = drawing.origin
    metres = np.array([[scale, 0, -scale * x], [0, -scale, scale * y], [0, 0, 1]])
    H = np.array([[2, 0, 0.5], [0, 2, 0.5], [0, 0, 1]]) @ K @ np.column_stack((R[:, :2], t)) @ metres
    size = scene.shape[1::-1]
    inside = cv2.warpPerspective(np.ones(drawing.size[::-1], np.float32), H, size)
    seen = cv2.warpPerspective(0.06 + 0.7 * drawing.drawn(1.0), H, size, flags=cv2.INTER_AREA)
    scene[inside > 0.99] = seen[inside > 0.99]


def seen_by_camera(images: tuple[TargetImage, ...]) -> list[Frame]:
    """Return four frames of a board and of a thing with two faces, which move."""
    board, thing = images
    assert isinstance(board, BoardImage) and isinstance(thing, BundleImage)
    camera, frames = camera_of(K, [], "plumb_bob", WIDTH, HEIGHT), []
    for index in range(4):
        scene = np.full((2 * HEIGHT, 2 * WIDTH), 0.3, np.float32)
        drawn(scene, board, from_euler((np.pi - 0.4, 0.3, 0.1), "zyx"), np.array((-0.12, 0.01 * index, 0.6)))
        R, t = from_euler((np.pi + 0.1, 0.8, 0.0), "zyx"), np.array((0.12, 0.01 * index, 0.7))
        for part, each in zip(thing.parts, thing.markers, strict=True):
            drawn(scene, part, R @ each.place.R, R @ each.place.t + t)
        values = cv2.resize(cv2.GaussianBlur(scene, (0, 0), 1.0), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
        noise = np.random.default_rng(index).normal(0, 0.004, values.shape)
        raw = np.clip(np.rint(255 * (values + noise)), 0, 255).astype(np.uint8)
        layout = PixelLayout(ColorModel.BAYER, BayerPattern.RGGB)
        frames.append(Frame(RawImage(raw, layout), 1_000_000_000 + 33_000_000 * index, "cam", camera))
    return frames


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Path], list[Frame], list[Result]]:
    folder = tmp_path_factory.mktemp("boards")
    paths = [folder / "wall.yaml", folder / "dock.yaml"]
    for path, text in zip(paths, (BOARD, CORNER), strict=True):
        path.write_text(text, encoding="utf-8")
    parameters = parameters_from({"targets.images": [str(path) for path in paths]})
    images = load_target_images(parameters.targets)
    frames = seen_by_camera(images)
    chain = Localizer(parameters, prepare_references(images, parameters))
    results = [chain.process(frame) for frame in frames]
    for result in results:
        assert all(found.pose is not None for found in result), [(found.status, found.reason) for found in result]
    assert [found.status for found in results[-1]] == [Status.TRACKED] * 2
    return paths, frames, results


@pytest.fixture
def node(imgu: Any, recorded: Any) -> Iterator[Any]:
    paths = ", ".join(str(path) for path in recorded[0])
    started = imgu("node", "perception", "-p", f"targets.images:=[{paths}]", "-r", "image_raw:=/cam/image_raw")
    started.wait_for_line("targets: wall, dock")
    yield started
    if started.process.poll() is None:
        started.stop()
        assert started.process.returncode == 0, started.text
    assert "Traceback" not in started.text


def test_live_equals_offline_bit_for_bit(node: Any, recorded: Any, peer: Any, make_camera: Any) -> None:
    _, frames, results = recorded
    topics = {name: f"/targets/{name}/pose" for name in ("wall", "dock")}
    for topic in topics.values():
        peer.hear(topic, POSE)
    camera = make_camera(peer)
    camera.wait_for_node()
    for count, frame in enumerate(frames, 1):
        camera.send(frame)
        peer.wait(lambda n=count: all(len(peer.heard[topic]) == n for topic in topics.values()), f"poses {count}")
    for index, result in enumerate(results):
        for name, topic in topics.items():
            found = next(each for each in result if each.name == name)
            assert peer.heard[topic][index] == pose_message(make_message, result_header(result), found.pose)


def test_a_board_file_that_cannot_be_used_is_said(imgu: Any, tmp_path: Path) -> None:
    path = tmp_path / "wall.yaml"
    path.write_text(BOARD.replace("gap", "gab"), encoding="utf-8")
    started = imgu("node", "perception", "-p", f"targets.images:=[{path}]", "-r", "image_raw:=/cam/image_raw")
    assert started.wait() == 1
    assert "grid: 'gab': no key of a board; did you mean gap?" in started.text


def test_ids_of_a_family_have_topics_when_they_are_seen_or_listened_to(imgu: Any, peer: Any, make_camera: Any) -> None:
    """One id is listened to before it is seen; another one's topics appear with it; a third is never seen."""
    images = [marker_image(f"aruco_4x4_50_{number}", "aruco_4x4_50", number, 0.08) for number in (1, 2)]
    camera, frames, results = camera_of(K, [], "plumb_bob", WIDTH, HEIGHT), [], []
    parameters = parameters_from({"targets.images": ["aruco_4x4_50:*"], "targets.widths_m": [0.08]})
    own = Localizer(parameters, prepare_references(load_target_images(parameters.targets), parameters))
    for index in range(12):
        scene = np.full((2 * HEIGHT, 2 * WIDTH), 0.3, np.float32)
        for image, x in zip(images, (-0.1, 0.1), strict=True):
            drawn(scene, image, from_euler((np.pi - 0.4, 0.3, 0.1), "zyx"), np.array((x, 0.002 * index, 0.6)))
        values = cv2.resize(cv2.GaussianBlur(scene, (0, 0), 1.0), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
        raw = np.clip(np.rint(255 * values), 0, 255).astype(np.uint8)
        layout = PixelLayout(ColorModel.BAYER, BayerPattern.RGGB)
        frames.append(Frame(RawImage(raw, layout), 1_000_000_000 + 33_000_000 * index, "cam", camera))
        results.append(own.process(frames[-1]))
    assert [*results[0].references] == ["aruco_4x4_50_1", "aruco_4x4_50_2"]
    options = ("-p", 'targets.images:=["aruco_4x4_50:*"]', "-p", "targets.widths_m:=[0.08]")
    started = imgu("node", "perception", *options, "-r", "image_raw:=/cam/image_raw")
    started.wait_for_line("targets: aruco_4x4_50")
    topics = {number: f"/targets/aruco_4x4_50_{number}/pose" for number in (1, 2, 3)}
    peer.hear(topics[1], POSE)
    sender = make_camera(peer)
    sender.wait_for_node()
    for count, frame in enumerate(frames[:4], 1):
        sender.send(frame)
        peer.wait(lambda n=count: len(peer.heard[topics[1]]) == n, f"pose {count} of the one that is listened to")
    made = {topic for topic, _ in peer.node.get_topic_names_and_types()}
    peer.wait(lambda: topics[2] in {topic for topic, _ in peer.node.get_topic_names_and_types()}, "topics of the other")
    peer.hear(topics[2], POSE)
    peer.wait(lambda: peer.node.count_publishers(topics[2]) == 1, "its publisher")
    for count, frame in enumerate(frames[4:], 5):
        sender.send(frame)
        peer.wait(
            lambda n=count: all(len(peer.heard[topics[i]]) == n - s for i, s in ((1, 0), (2, 4))), f"poses {count}"
        )
    for index, result in enumerate(results):
        found = result.references["aruco_4x4_50_1"]
        assert peer.heard[topics[1]][index] == pose_message(make_message, result_header(result), found.pose)
    last = results[-1]
    assert peer.heard[topics[2]][-1] == pose_message(
        make_message, result_header(last), last.references["aruco_4x4_50_2"].pose
    )
    assert topics[3] not in made
    started.stop()
    assert started.process.returncode == 0 and "Traceback" not in started.text
