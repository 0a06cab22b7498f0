# SPDX-License-Identifier: Apache-2.0
"""metadata.yaml with anything in it: never a traceback, and where the files differ from it, that is named."""

from __future__ import annotations

import os
import time

import pytest
import yaml

from imgu_ros.bags.messages import make_message
from imgu_ros.bags.reading import open_bag
from imgu_ros.bags.writing import BagWriter
from imgu_ros.config.parameters import LimitsParameters
from imgu_ros.errors import BagError


@pytest.fixture
def bag(tmp_path):
    """A bag of three texts on /a and one on /b."""
    with BagWriter(tmp_path / "bag") as writer:
        for i in range(3):
            writer.write("/a", make_message("std_msgs/msg/String", data=str(i)), i + 1)
        writer.write("/b", make_message("std_msgs/msg/String", data="b"), 9)
    return tmp_path / "bag"


def read(path, **limits):
    began = time.monotonic()
    with open_bag([path], limits=LimitsParameters(**limits)) as bag:
        found = [message.message.data for message in bag.messages()]
        assert time.monotonic() - began < 8
        assert all("\n" not in line and len(line) < 3000 for line in bag.warnings)
        return found, bag.warnings


def changed(bag, **information):
    path = bag / "metadata.yaml"
    content = yaml.safe_load(path.read_text())
    content["rosbag2_bagfile_information"].update(information)
    path.write_text(yaml.safe_dump(content))


WHOLE = ["0", "1", "2", "b"]


def test_what_our_own_bags_say_is_what_they_have(bag):
    assert read(bag) == (WHOLE, ())


def test_topics_with_other_counts_are_named(bag):
    topics = [
        {"topic_metadata": {"name": name, "type": "std_msgs/msg/String"}, "message_count": count}
        for name, count in (("/a", 5), ("/b", 1), ("/gone", 7))
    ]
    changed(bag, topics_with_message_count=topics)
    found, warnings = read(bag)
    assert found == WHOLE
    assert warnings == (
        "bag: metadata.yaml announces other numbers of messages: /a 3 (announced: 5), /gone 0 (announced: 7)",
    )


def test_more_messages_than_announced_are_named(bag):
    files = [{"path": "bag.mcap", "message_count": 3}]
    changed(bag, files=files, message_count=3)
    content = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    (name,) = content["relative_file_paths"]
    changed(bag, files=[{"path": name, "message_count": 3, "starting_time": {}, "duration": {}}])
    found, warnings = read(bag)
    assert found == WHOLE
    assert any("4 messages, metadata.yaml announces 3" in line for line in warnings)


STRANGE = [
    ".inf",
    ".nan",
    "-5",
    "1e30",
    str(10**30),
    "9" * 400,
    "9" * 5000,
    "null",
    "''",
    "[]",
    "{a: b}",
    "0x10",
    "2026-11-30",
    "*x",
]


@pytest.mark.parametrize("value", STRANGE)
def test_numbers_of_any_kind(bag, value):
    (bag / "metadata.yaml").write_text(
        f"""rosbag2_bagfile_information:
  x: &x {{y: z}}
  relative_file_paths: [bag.mcap, gone.mcap]
  message_count: {value}
  duration: {{nanoseconds: {value}}}
  starting_time: {{nanoseconds_since_epoch: {value}}}
  storage_identifier: {value}
  topics_with_message_count:
  - {{topic_metadata: {{name: {value}}}, message_count: {value}}}
  files:
  - {{path: bag.mcap, message_count: {value}, starting_time: {value}, duration: {value}}}
  - path: gone.mcap
    starting_time: {{nanoseconds_since_epoch: {value}}}
    duration: {{nanoseconds: {value}}}
    message_count: {value}
  - {value}
"""
    )
    found, warnings = read(bag)
    assert found == WHOLE
    assert any("1 of 2 files are missing (gone.mcap)" in line for line in warnings)


@pytest.mark.parametrize("value", STRANGE)
def test_a_list_of_files_that_is_anything(bag, value):
    (bag / "metadata.yaml").write_text(
        f"rosbag2_bagfile_information:\n  x: &x y\n  relative_file_paths: {value}\n  files: {value}\n"
    )
    assert read(bag)[0] == WHOLE
    (bag / "metadata.yaml").write_text(f"rosbag2_bagfile_information: {value}\n")
    assert read(bag)[0] == WHOLE


@pytest.mark.parametrize(
    "names",
    [
        ["/etc/passwd", "../../bag.mcap", "bag.mcap"],
        ["bag.mcap"] * 3,
        ["bag.mcap", "bag.mcap.zstd"],
        ["", ".", "..", "/", "\\", "bag.mcap"],
        ["a\0b", "x" * 5000, "loop.mcap", "bag.mcap"],
        [{"a": "b"}, ["bag.mcap"], None, 5, "bag.mcap"],
        [f"bag_{i}.mcap" for i in range(100_000)] + ["bag.mcap"],
        ["b\x1b[2J\r\n.mcap" + "y" * 100_000, "bag.mcap"],
    ],
)
def test_paths_of_any_kind(bag, names):
    (bag / "loop.mcap").symlink_to("loop.mcap")
    text = yaml.dump({"rosbag2_bagfile_information": {"relative_file_paths": names}}, Dumper=yaml.CSafeDumper)
    (bag / "metadata.yaml").write_text(text)
    found, warnings = read(bag)
    assert found == WHOLE
    assert len(warnings) <= 1


def test_a_name_that_is_not_utf8(bag):
    odd = os.fsencode(bag) + b"/b\xe4g.mcap"
    os.rename(bag / "bag.mcap", odd)
    text = (bag / "metadata.yaml").read_bytes().replace(b"bag.mcap", b"b\xe4g.mcap")
    (bag / "metadata.yaml").write_bytes(text)
    assert read(bag)[0] == WHOLE


@pytest.mark.parametrize(
    "text",
    [
        "[" * 3_000_000,
        "a: &a [" + "x," * 1000 + "]\n" + "b: &b [" + "*a," * 5000 + "]\n",
        "x" * 4_000_001,
        "rosbag2_bagfile_information: {relative_file_paths: &a [&b [*b]]}",
        "\0",
        "--- a\n" * 100_000,
    ],
)
def test_yaml_bombs_cost_the_metadata_alone(bag, text):
    (bag / "metadata.yaml").write_text(text)
    found, warnings = read(bag)
    assert found == WHOLE
    assert "metadata.yaml cannot be read" in warnings[0]


@pytest.mark.parametrize("kind", ["folder", "pipe", "device", "loop", "dangling", "growing"])
def test_metadata_that_is_no_file(bag, kind):
    path = bag / "metadata.yaml"
    path.unlink()
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        target = {"device": "/dev/zero", "loop": "metadata.yaml", "dangling": "none", "growing": "/proc/self/maps"}
        path.symlink_to(target[kind])
    found, warnings = read(bag)
    assert found == WHOLE
    assert "metadata.yaml" in warnings[0]


def test_the_size_of_metadata_is_bounded_by_a_parameter(bag):
    with (bag / "metadata.yaml").open("a") as file:
        file.write("#" * 1_000_000)
    assert read(bag) == (WHOLE, ())
    assert "(limits.text_mb)" in read(bag, text_mb=1)[1][0]


def test_a_folder_that_leads_to_itself(tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(BagError) as error:
        open_bag([tmp_path / "loop"])
    assert "loop" in str(error.value)
