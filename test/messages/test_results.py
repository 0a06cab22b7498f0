# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest

from imgu_ros.config.components import OutputParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import EncodingError, ImguError
from imgu_ros.messages.compressed_image import decode_compressed_image
from imgu_ros.messages.features import (
    decode_homographies,
    decode_keypoints,
    decode_matches,
    keypoints_message,
)
from imgu_ros.messages.header import Header, decode_header
from imgu_ros.messages.image import decode_image
from imgu_ros.messages.point_cloud import point_cloud_message
from imgu_ros.messages.result_converter import ResultConverter
from imgu_ros.messages.results import OUTPUTS, compressed_picture_message, needs_keypoints, target_transforms
from imgu_ros.result import PoseStatus, ReferenceResult, Result, Status, by_name
from imgu_ros.vision.formation.layout import ColorModel

HEADER = Header(10_250_000_000, "camera")


def rejected(result: Result) -> Result:
    targets = tuple(ReferenceResult(t.name, t.number, Status.REJECTED, reason="too dark") for t in result)
    return Result(result.frame, by_name(targets), reason="too dark")


def is_there(make):
    """Tells of a topic whether its message can be made: ROS may be without the packages of optional ones."""
    optional = {row.name: row.type_name for row in OUTPUTS if row.is_optional}

    def is_wanted(topic):
        try:
            return topic not in optional or make(optional[topic]) is not None
        except ImguError:
            return False

    return is_wanted


def converted(make, result, parameters=None, wanted=None):
    """Return every message of a result, by topic."""
    names = [target.name for target in result]
    converter = ResultConverter(
        make, lambda _: np.zeros((2, 3, 3), np.uint8), names, OutputParameters.of(parameters or Parameters())
    )
    made = list(converter.messages(converter.frame(result), wanted or is_there(make)))
    assert len({topic for one in made for topic in one.topics}) == sum(len(one.topics) for one in made)
    return {topic: one.message for one in made for topic in one.topics}


def test_every_output_carries_the_header_and_its_type(make, result):
    converter = ResultConverter(
        make, lambda _: np.zeros((2, 3, 3), np.uint8), ["poster", "box", "floor"], OutputParameters.of(Parameters())
    )
    messages = converted(make, result)
    assert messages.keys() <= converter.topics().keys()
    assert {row.name for topic, row in converter.topics().items() if topic in messages} == {
        row.name
        for row in OUTPUTS
        if not row.name.startswith("map/") and is_there(make)(row.name)
        if row.name != "camera_info" or result.frame.camera is not None
    }
    for topic, message in messages.items():
        assert type(message) is type(make(converter.topics()[topic].type_name)), topic
        if topic in ("annotations", "markers"):
            continue  # arrays, without a header of their own
        of_camera = not topic.endswith(("odom", "path"))
        assert decode_header(message) == (HEADER if of_camera else Header(HEADER.stamp_ns, "poster")), topic
    for name in ("outline", "pose", "odom", "path"):
        assert messages[name] is messages[f"targets/poster/{name}"]
        assert f"targets/box/{name}" not in messages, "a lost target has no geometry"


def test_a_rejected_frame_has_a_status_alone(make, result):
    wanted = [row.name for row in OUTPUTS if not row.name.startswith("debug_image")]
    assert converted(make, rejected(result), wanted=wanted.__contains__).keys() == {"status"}


def test_only_what_is_wanted_is_made(make, result):
    asked = []

    def is_wanted(topic):
        asked.append(topic)
        return topic in {"pose", "pyramid/level_1"}

    assert converted(make, result, wanted=is_wanted).keys() == {"pose", "pyramid/level_1"}
    assert len(asked) == len(set(asked)) > 20


def test_the_cameras_frame_may_have_another_name(make, result):
    messages = converted(make, result, parameters_from({"frames.camera": "lens", "frames.target_prefix": "seen/"}))
    assert {decode_header(messages[topic]).frame_id for topic in ("status", "pose", "image_mono")} == {"lens"}
    assert (messages["odom"].header.frame_id, messages["odom"].child_frame_id) == ("seen/poster", "lens")


def test_pictures(make, result):
    messages = converted(make, result)
    color = decode_image(messages["image_color"])
    assert color.layout.color is ColorModel.RGB
    np.testing.assert_array_equal(color.pixels, result.developed.color())
    assert color.pixels.dtype == np.uint16
    mono = decode_image(messages["image_mono"])
    np.testing.assert_array_equal(mono.pixels, result.developed.grey)
    for level in (0, 1):
        message = messages[f"pyramid/level_{level}"]
        assert message.encoding == ("32FC1", "mono8")[level]
        np.testing.assert_array_equal(decode_image(message).pixels, result.pyramid.levels[level].image)
    assert "pyramid/level_2" not in messages
    assert decode_image(messages["debug_image"]).pixels.shape == (2, 3, 3)
    assert messages["debug_image/compressed"].format == "rgb8; jpeg compressed bgr8"


def test_compressed_pictures(make, result):
    color = result.developed.color()
    deep = compressed_picture_message(make, result, color, "jpeg", 95, 3)
    assert deep.format == "rgb16; png compressed bgr16", "JPEG has no 16 bits"
    np.testing.assert_array_equal(decode_compressed_image(deep).pixels[:, :, ::-1], color)
    grey = result.developed.grey
    sizes = []
    for quality in (20, 95):
        message = compressed_picture_message(make, result, grey, "jpeg", quality, 3)
        assert message.format == "mono8; jpeg compressed"
        assert decode_header(message) == HEADER
        sizes.append(len(message.data))
    assert sizes[0] < sizes[1]
    png = compressed_picture_message(make, result, grey, "png", 95, 9)
    np.testing.assert_array_equal(decode_compressed_image(png).pixels, grey)


@pytest.mark.parametrize(
    ("dtype", "length", "datatype"), [(np.uint8, 32, 2), (np.float32, 128, 7), (np.float32, 81, 7)]
)
def test_keypoints(make, result, dtype, length, datatype):
    keypoints = result.keypoints
    descriptors = np.random.default_rng(1).integers(0, 256, (6, length)).astype(dtype)
    message = keypoints_message(make, HEADER, keypoints, descriptors)
    names = ["x", "y", "scale", "angle", "response", "octave", "descriptor"]
    assert [(f.name, f.offset, f.datatype, f.count) for f in message.fields] == [
        *((name, 4 * i, 7 if name != "octave" else 5, 1) for i, name in enumerate(names[:6])),
        ("descriptor", 24, datatype, length),
    ]
    step = 24 + length * np.dtype(dtype).itemsize
    assert message.point_step == step
    one = (*keypoints.xy[1], keypoints.scale[1], keypoints.angle[1], keypoints.response[1])
    assert bytes(message.data)[step : 2 * step] == struct.pack("<5fi", *one, 1) + descriptors[1].tobytes()
    again, again_descriptors = decode_keypoints(message)
    np.testing.assert_array_equal(again.xy, keypoints.xy.astype(np.float32))
    np.testing.assert_array_equal(again.octave, keypoints.octave)
    np.testing.assert_array_equal(again_descriptors, descriptors)
    assert again_descriptors.dtype == dtype


def test_keypoints_without_descriptors_or_points(make, result):
    again, descriptors = decode_keypoints(keypoints_message(make, HEADER, result.keypoints, None))
    assert len(again) == 6
    assert descriptors is None
    none = type(again)(again.xy[:0], again.scale[:0], again.angle[:0], again.response[:0], again.octave[:0])
    again, descriptors = decode_keypoints(keypoints_message(make, HEADER, none, np.zeros((0, 32), np.uint8)))
    assert len(again) == 0
    assert descriptors.shape == (0, 32)
    with pytest.raises(EncodingError, match=r"descriptors: shape \(5, 32\); need \(6, D >= 1\)"):
        keypoints_message(make, HEADER, result.keypoints, np.zeros((5, 32), np.uint8))


def test_matches_of_all_targets(make, result):
    message = converted(make, result)["matches"]
    assert [f.name for f in message.fields] == [
        "target", "template_x", "template_y", "image_x", "image_y", "distance", "inlier",
    ]  # fmt: skip
    first = result.first.matches
    row = struct.pack("<i5fB3x", 0, *first.template_xy[1], *first.image_xy[1], 0.125, 0)
    assert bytes(message.data)[28:56] == row
    table = decode_matches(message)
    assert table["target"].tolist() == [0] * 5 + [1] * 3 + [2] * 4
    assert table["inlier"].tolist() == [1, 0, 1, 0, 1, 1, 0, 1, 1, 0, 1, 0]


def test_homographies_of_targets_that_were_seen(make, result):
    message = converted(make, result)["homography"]
    fields = [(f.name, f.offset, f.datatype, f.count) for f in message.fields]
    assert fields == [
        ("target", 0, 5, 1), ("h", 8, 8, 9), ("covariance", 80, 8, 81), ("n_inliers", 728, 5, 1), ("rms_px", 732, 7, 1),
        ("calibrated", 736, 2, 1), ("sharp", 737, 2, 1),
    ]  # fmt: skip
    first = result.first.homography
    row = struct.pack("<i4x90dif", 0, *first.H.ravel(), *first.covariance.ravel(), 3, 0.375)
    assert bytes(message.data)[:736] == row
    table = decode_homographies(message)
    assert table["target"].tolist() == [0, 2]
    assert table["n_inliers"].tolist() == [3, 2]
    assert table["calibrated"].tolist() == [0, 0]
    np.testing.assert_array_equal(table["h"][1].reshape(3, 3), list(result)[2].homography.H)
    nothing = replace(result, references=by_name((list(result)[1],)))
    assert len(decode_homographies(converted(make, nothing)["homography"])) == 0


def test_a_missing_column_is_named(make):
    message = point_cloud_message(make, HEADER, np.zeros(1, [("x", "f4"), ("target", "i4")]))
    for decode, missing in ((decode_keypoints, "y"), (decode_matches, "template_x"), (decode_homographies, "h")):
        with pytest.raises(EncodingError, match=f"need {missing},"):
            decode(message)


def test_status(make, result):
    message = converted(make, result)["status"]
    poster, box, floor = message.status
    levels = [s.level if isinstance(s.level, int) else s.level[0] for s in message.status]
    assert levels == [0, 1, 0]
    assert (poster.name, poster.message, poster.hardware_id) == ("poster", "tracked, metric", "camera")
    assert box.message == "lost: no consensus among 3 matches"
    assert floor.message == "detected, no_size"
    assert {pair.key: pair.value for pair in poster.values} == {
        "status": "tracked",
        "pose_status": "metric",
        "n_keypoints": "6",
        "n_matches": "5",
        "n_inliers": "3",
        "rms_px": "0.375",
        "ambiguity": "0.25",
        "t_total_ms": "2.0",
        "t_develop_ms": "1.5",
        "t_match_ms": "0.25",
    }
    assert "rms_px" not in {pair.key for pair in box.values}


@pytest.mark.parametrize(
    ("status", "pose_status", "level"),
    [
        (Status.DETECTED, PoseStatus.UNCALIBRATED, 1),
        (Status.DETECTED, PoseStatus.AMBIGUOUS, 1),
        (Status.DEGENERATE, PoseStatus.NONE, 1),
        (Status.REJECTED, PoseStatus.NONE, 2),
    ],
)
def test_status_levels(make, result, status, pose_status, level):
    changed = replace(result, references=by_name((ReferenceResult("poster", 0, status, pose_status),)))
    (entry,) = converted(make, changed)["status"].status
    assert (entry.level if isinstance(entry.level, int) else entry.level[0]) == level


def test_tf_of_targets(result):
    (sent,) = target_transforms(result, "target/")
    assert (sent.stamp_ns, sent.parent, sent.child) == (HEADER.stamp_ns, "camera", "target/poster")
    np.testing.assert_array_equal(sent.parent_from_child.matrix, result.first.pose.transform.matrix)
    assert target_transforms(rejected(result), "") == []


def test_odometry_has_the_inverse_pose(make, result):
    message = converted(make, result)["odom"]
    position = message.pose.pose.position
    np.testing.assert_allclose([position.x, position.y, position.z], result.first.pose.inverse().t)


def test_only_keypoints_and_pyramid_need_detection_in_every_frame() -> None:
    assert needs_keypoints(["pose", "keypoints"])
    assert needs_keypoints(["pyramid/level_3"])
    assert not needs_keypoints(["pose", "matches", "homography", "image_mono"])
    assert not needs_keypoints([])
