# SPDX-License-Identifier: Apache-2.0
"""BagWriter, read back by rosbags."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from rosbags.rosbag2 import Reader

from imgu_ros.bags.messages import make_message, typestore
from imgu_ros.bags.writing import BagWriter
from imgu_ros.errors import BagError


def image(value: int):
    data = np.full(12, value, np.uint8)
    return make_message("sensor_msgs/msg/Image", height=3, width=4, step=4, encoding="mono8", data=data)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_rosbags_reads_what_was_written(tmp_path, storage, compression):
    (tmp_path / "bag").mkdir()  # an empty folder is welcome
    with BagWriter(tmp_path / "bag", storage, compression) as writer:
        for i in range(5):
            writer.write("/image", image(i), 1000 + i)
        writer.write("/info", make_message("sensor_msgs/msg/CameraInfo", width=4), 1002)
    with Reader(tmp_path / "bag") as reader:
        got = [(c.topic, t, typestore().deserialize_cdr(raw, c.msgtype)) for c, t, raw in reader.messages()]
        assert {c.topic: c.msgcount for c in reader.connections} == {"/image": 5, "/info": 1}
    images = [(t, int(m.data[0])) for topic, t, m in got if topic == "/image"]
    assert images == [(1000 + i, i) for i in range(5)]
    metadata = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert metadata["storage_identifier"] == storage and metadata["message_count"] == 6
    # ros2 bag and Foxglove read chunk-compressed MCAP by themselves; SQLite has compression by message only
    assert metadata["compression_mode"] == ("message" if (storage, compression) == ("sqlite3", "zstd") else "")


def test_an_interrupted_bag_is_complete(tmp_path):
    with pytest.raises(KeyboardInterrupt), BagWriter(tmp_path / "bag") as writer:
        writer.write("/image", image(1), 1)
        raise KeyboardInterrupt
    with Reader(tmp_path / "bag") as reader:
        assert reader.message_count == 1


def test_output_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").touch()
    for path, text in [
        (tmp_path / "full", "not empty"),
        (tmp_path / "full" / "file", "exists already"),
        (tmp_path / "full" / "file" / "bag", "need a folder that can be written"),
    ]:
        with pytest.raises(BagError, match=text) as caught:
            BagWriter(path)
        assert "\n" not in str(caught.value)


def test_unknown_storage_and_bad_messages_are_refused(tmp_path):
    with pytest.raises(BagError, match="need mcap or sqlite3"):
        BagWriter(tmp_path / "x", "rosbag")
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/image", image(1), 1)
        with pytest.raises(BagError, match="need sensor_msgs/msg/Image"):
            writer.write("/image", make_message("std_msgs/msg/Empty"), 2)
        with pytest.raises(BagError, match="cannot be serialised|cannot write"):
            writer.write("/text", make_message("std_msgs/msg/String", data=7), 2)
        with pytest.raises(BagError, match="need a message made by make_message"):
            writer.write("/image", object(), 2)
        with pytest.raises(BagError, match="time -1 ns"):
            writer.write("/image", image(1), -1)
        writer.write("/image", image(2), 3)
    with Reader(tmp_path / "bag") as reader:
        assert reader.message_count == 2
