# SPDX-License-Identifier: Apache-2.0
"""Two cameras that were recorded on one topic: each image is read with its own camera_info."""

from __future__ import annotations

import random

import numpy as np

from imgu_ros.bags.messages import make_message
from imgu_ros.bags.reading import open_bag
from imgu_ros.bags.writing import BagWriter
from imgu_ros.config.components import RecordedFramesParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.messages.camera_info import camera_info_message
from imgu_ros.messages.header import Header
from imgu_ros.messages.image import image_message
from imgu_ros.replay.frame_source import FrameSource
from imgu_ros.vision.camera.intrinsics import make_camera

FOCAL_PX = {"left": 300.0, "right": 500.0}


def test_each_image_is_read_with_the_camera_info_of_its_own_frame(tmp_path) -> None:
    rng = random.Random(1)
    pixels = np.zeros((48, 64), np.uint8)
    with BagWriter(tmp_path / "bag") as writer:
        for number in range(30):
            stamp_ns = 10**9 + number * 33_000_000
            messages = []
            for name, f in FOCAL_PX.items():
                header = Header(stamp_ns, name)
                camera = make_camera([[f, 0, 31.5], [0, f, 23.5], [0, 0, 1]], (), "plumb_bob", 64, 48)
                messages.append(("/cam/image_raw", image_message(make_message, header, pixels, "mono8")))
                if number % 7:  # now and then it got lost
                    messages.append(("/cam/camera_info", camera_info_message(make_message, header, camera)))
            rng.shuffle(messages)
            for topic, message in messages:
                writer.write(topic, message, stamp_ns)
    with open_bag([tmp_path / "bag"]) as bag:
        source = FrameSource(bag, RecordedFramesParameters.of(Parameters()))
        frames = [recorded.frame for recorded in source.frames()]
    assert len(frames) == 60
    for name, f in FOCAL_PX.items():
        own = [frame for frame in frames if frame.frame_id == name]
        assert len(own) == 30
        assert {None if frame.camera is None else float(frame.camera.K[0, 0]) for frame in own} == {f}
    said = [line for line in source.warnings if "carries images of several cameras" in line]
    assert len(said) == 1 and "('left', 'right')" in said[0]
