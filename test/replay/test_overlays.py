# SPDX-License-Identifier: Apache-2.0
"""What viewers get from a results bag, read by others' software (mcap's ROS 2 decoder) and compared with frames.csv."""

from __future__ import annotations

import csv
from collections import defaultdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from scipy.spatial.transform import Rotation

from imgu_ros.config.values import parameters_from
from imgu_ros.replay.recording import record_simulation
from imgu_ros.replay.replay import replay
from imgu_ros.simulate.sequence import Simulation, default_camera, default_targets

WIDTH_M = 0.5
# The decoder does not give constants.
POINTS, LINE_LOOP = 1, 2
SPHERE, LINE_STRIP, DELETE_ALL = 2, 4, 3


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A replay of two targets through a lens with distortion."""
    root = tmp_path_factory.mktemp("overlays")
    targets = default_targets(2, seed=4, width_m=WIDTH_M)
    camera = default_camera(640, 480, distortion=(-0.2, 0.05, 0.001, -0.0005, 0.0))
    simulation = Simulation(width=640, height=480, frames=6, seed=4, camera=camera)
    record_simulation(root / "bag", simulation, targets=targets)
    names = [target.name for target in targets]
    parameters = parameters_from(
        {
            "targets.images": [str(root / "bag" / f"{name}.png") for name in names],
            "targets.widths_m": [target.width_m for target in targets],
            "compressed.jpeg_quality": 90,
        }
    )
    replay([root / "bag"], root / "out", parameters, record=["debug_image/compressed", "image_color/compressed"])
    return root


def messages(results: Path) -> dict[str, list[Any]]:
    found = defaultdict(list)
    with open(results / "out" / "results" / "results.mcap", "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            found[channel.topic].append(message)
    return found


def rows(results: Path) -> list[dict[str, str]]:
    with open(results / "out" / "frames.csv", newline="") as file:
        return list(csv.DictReader(file))


def stamp_ns(stamp: Any) -> int:
    return stamp.sec * 10**9 + stamp.nanosec


def numbers(row: dict[str, str], *names: str) -> np.ndarray:
    return np.array([float(row[name]) for name in names])


def corners_px(results: Path, row: dict[str, str], info: Any) -> np.ndarray:
    """The target's corners by the row's homography, through OpenCV's lens model."""
    height, width = cv2.imread(str(results / "bag" / f"{row['target']}.png")).shape[:2]
    low, right, bottom = -0.5, width - 0.5, height - 0.5
    template = np.array([(low, low), (right, low), (right, bottom), (low, bottom)])
    H = numbers(row, *(f"h{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))).reshape(3, 3)
    ideal = cv2.perspectiveTransform(template[None], H)[0]
    K = np.reshape(info.k, (3, 3))
    normalized = np.column_stack((ideal, np.ones(4))) @ np.linalg.inv(K).T
    return cv2.projectPoints(normalized, np.zeros(3), np.zeros(3), K, np.array(info.d))[0].reshape(4, 2)


def test_every_corner_of_the_overlays_is_where_frames_csv_has_it(results):
    read = messages(results)
    found = [row for row in rows(results) if row["status"] in ("tracked", "detected")]
    assert len(found) >= 8
    infos = {stamp_ns(info.header.stamp): info for info in read["/camera_info"]}
    loops = {}
    for message in read["/annotations"]:
        for drawn in message.points:
            if drawn.type == LINE_LOOP:
                xy = np.array([(point.x, point.y) for point in drawn.points])
                loops.setdefault(stamp_ns(drawn.timestamp), []).append(xy)
            else:
                assert len(drawn.points) >= 8
                assert drawn.type == POINTS
    assert sum(map(len, loops.values())) == len(found)
    for row in found:
        time = int(row["stamp_ns"])
        expected = corners_px(results, row, infos[time])
        assert min(np.abs(xy - expected).max() for xy in loops[time]) < 0.1


def test_labels_name_the_target_and_its_distance(results):
    texts = [text for message in messages(results)["/annotations"] for text in message.texts]
    found = [row for row in rows(results) if row["tx"]]
    assert len(texts) >= len(found) > 0
    for row in found:
        distance = np.linalg.norm(numbers(row, "tx", "ty", "tz"))
        assert f"{row['target']} {distance:.3g} m" in {text.text for text in texts}


def test_detections_have_box_pose_and_covariance(results):
    read = messages(results)
    infos = {stamp_ns(info.header.stamp): info for info in read["/camera_info"]}
    found = [row for row in rows(results) if row["tx"]]
    detected = {
        (stamp_ns(array.header.stamp), one.id): one for array in read["/detections"] for one in array.detections
    }
    for row in found:
        one = detected[int(row["stamp_ns"]), row["target"]]
        expected = corners_px(results, row, infos[int(row["stamp_ns"])])
        size = np.array((one.bbox.size_x, one.bbox.size_y))
        center = np.array((one.bbox.center.position.x, one.bbox.center.position.y))
        np.testing.assert_allclose(center - size / 2, expected.min(axis=0), atol=0.1)
        np.testing.assert_allclose(center + size / 2, expected.max(axis=0), atol=0.1)
        (result,) = one.results
        assert result.hypothesis.class_id == row["target"]
        assert result.hypothesis.score == pytest.approx(float(row["confirmed_share"]))
        pose = result.pose.pose
        np.testing.assert_allclose(
            (pose.position.x, pose.position.y, pose.position.z), numbers(row, "tx", "ty", "tz"), rtol=1e-9
        )
        covariance = numbers(row, *(f"c{i}{j}" for i in range(1, 7) for j in range(1, 7)))
        np.testing.assert_allclose(result.pose.covariance, covariance, rtol=1e-9)


def test_tf_has_camera_to_target(results):
    transforms = {
        (stamp_ns(one.header.stamp), one.child_frame_id): one
        for message in messages(results)["/tf"]
        for one in message.transforms
    }
    found = [row for row in rows(results) if row["tx"]]
    assert len(transforms) == len(found)
    for row in found:
        one = transforms[int(row["stamp_ns"]), row["target"]]
        assert one.header.frame_id == row["frame_id"]
        t, q = one.transform.translation, one.transform.rotation
        np.testing.assert_allclose((t.x, t.y, t.z), numbers(row, "tx", "ty", "tz"), rtol=1e-9)
        R = Rotation.from_quat((q.x, q.y, q.z, q.w))
        assert (R * Rotation.from_quat(numbers(row, "qx", "qy", "qz", "qw")).inv()).magnitude() < 1e-9


def test_markers_lie_on_the_target_and_show_its_covariance(results):
    found = {(int(row["stamp_ns"]), row["target"]): row for row in rows(results) if row["tx"]}
    seen = 0
    for array in messages(results)["/markers"]:
        first, *others = array.markers
        assert first.action == DELETE_ALL
        for marker in others:
            row = found[stamp_ns(marker.header.stamp), marker.ns]
            t = numbers(row, "tx", "ty", "tz")
            R = Rotation.from_quat(numbers(row, "qx", "qy", "qz", "qw")).as_matrix()
            if marker.type == LINE_STRIP:
                xyz = (np.array([(p.x, p.y, p.z) for p in marker.points]) - t) @ R
                height, width = cv2.imread(str(results / "bag" / f"{marker.ns}.png")).shape[:2]
                half = 0.5 * WIDTH_M * np.array((1.0, height / width))
                expected = np.array([(-1, 1), (1, 1), (1, -1), (-1, -1), (-1, 1)]) * half
                np.testing.assert_allclose(xyz, np.column_stack((expected, np.zeros(5))), atol=2e-4)
                seen += 1
            elif marker.type == SPHERE:
                q, s = marker.pose.orientation, marker.scale
                axes = Rotation.from_quat((q.x, q.y, q.z, q.w)).as_matrix()
                # 95 % of three degrees of freedom: 7.815.
                shown = axes @ np.diag(np.square((s.x, s.y, s.z)) / 4 / 7.815) @ axes.T
                covariance = numbers(row, *(f"c{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))).reshape(3, 3)
                np.testing.assert_allclose(shown, covariance, rtol=1e-3, atol=1e-3 * np.abs(covariance).max())
    assert seen == len(found)


def test_pictures_are_there_when_asked_for(results):
    read = messages(results)
    for topic in ("/debug_image/compressed", "/image_color/compressed"):
        assert len(read[topic]) == 6
        picture = cv2.imdecode(np.frombuffer(read[topic][0].data, np.uint8), cv2.IMREAD_COLOR)
        assert picture.shape == (480, 640, 3)
