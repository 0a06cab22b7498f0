# SPDX-License-Identifier: Apache-2.0
"""metadata.yaml of every version and system, and the ways to name a bag."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from rosbags.rosbag2 import StoragePlugin, Writer

from imgu_ros.bags.messages import typestore
from imgu_ros.bags.reading import open_bag
from imgu_ros.errors import BagError

#: As Jazzy writes it (version 9, QoS profiles in a list).
JAZZY = """rosbag2_bagfile_information:
  version: 9
  storage_identifier: sqlite3
  duration:
    nanoseconds: 2
  starting_time:
    nanoseconds_since_epoch: 0
  message_count: 3
  topics_with_message_count:
    - topic_metadata:
        name: /text
        type: std_msgs/msg/String
        serialization_format: cdr
        offered_qos_profiles:
          - history: keep_last
            depth: 10
            reliability: reliable
            durability: volatile
            deadline:
              sec: 9223372036
              nsec: 854775807
            liveliness: automatic
            avoid_ros_namespace_conventions: false
        type_description_hash: RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18
      message_count: 3
  compression_format: ""
  compression_mode: ""
  relative_file_paths:
    - PATH
  files:
    - path: PATH
      starting_time:
        nanoseconds_since_epoch: 0
      duration:
        nanoseconds: 2
      message_count: 3
  custom_data: CUSTOM
  ros_distro: jazzy
"""
#: As Foxy did (QoS profiles as a text of YAML, no list of files).
FOXY = """rosbag2_bagfile_information:
  version: 4
  storage_identifier: sqlite3
  relative_file_paths:
    - PATH
  duration:
    nanoseconds: 2
  starting_time:
    nanoseconds_since_epoch: 0
  message_count: 3
  topics_with_message_count:
    - topic_metadata:
        name: /text
        type: std_msgs/msg/String
        serialization_format: cdr
        offered_qos_profiles: "- history: 3\\n  depth: 0\\n  reliability: 1\\n  deadline:\\n    sec: 2147483647"
      message_count: 3
  compression_format: ""
  compression_mode: ""
"""
MINIMAL = "rosbag2_bagfile_information:\n  relative_file_paths: [PATH]\n"
FILES_ALONE = "rosbag2_bagfile_information:\n  version: 5\n  message_count:\n  files:\n    - path: PATH\n"


def jazzy(path: str, custom: str = "null") -> str:
    return JAZZY.replace("PATH", path).replace("CUSTOM", custom)


@pytest.fixture
def write_folder(write_sqlite, mcap_parts):
    """A folder with one .db3 of three messages, and its metadata.yaml."""

    def write(folder, metadata: str | bytes, name="x_0.db3"):
        folder.mkdir()
        rows = [(b"/text", b"std_msgs/msg/String", b"cdr", b"", b"")]
        messages = [(1, i, mcap_parts.string_cdr(word)) for i, word in enumerate("abc")]
        write_sqlite(folder / name, 4, rows, None, messages)
        content = metadata.encode() if isinstance(metadata, str) else metadata
        (folder / "metadata.yaml").write_bytes(content)
        return folder

    return write


def read(path):
    with open_bag([path]) as bag:
        return [message.message.data for message in bag.messages(["/text"])], bag.warnings


@pytest.mark.parametrize(
    "custom",
    ["", "null", "[]", "{}", "{key: value}", "{when: 2024-13-45}", "!!python/object:os.system {}", "!mine [1, 2]",
     "!!binary ///", "{0x: 08, 1_0: .nan, y: 0o17}", "{note: 'Straße, größer'}", "|\n    text\n    of lines"],
)  # fmt: skip
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1", "cp1252"])
def test_custom_data_of_any_kind_in_any_encoding(tmp_path, write_folder, custom, encoding):
    folder = write_folder(tmp_path / "x", jazzy("x_0.db3", custom).encode(encoding))
    assert read(folder) == (["a", "b", "c"], ())


@pytest.mark.parametrize("custom", ["{? [1] : 2}", "{a: &x [*x]}", "\0", "- - : ]["])
def test_what_no_reader_of_yaml_takes_costs_the_list_of_files_alone(tmp_path, write_folder, custom):
    data, warnings = read(write_folder(tmp_path / "x", jazzy("x_0.db3", custom)))
    assert data == ["a", "b", "c"]
    assert all("metadata.yaml cannot be read" in line for line in warnings)


@pytest.mark.parametrize("text", [JAZZY, FOXY, MINIMAL, FILES_ALONE])
@pytest.mark.parametrize("version", range(1, 10))
def test_every_version(tmp_path, write_folder, text, version):
    known = text.replace("version: 9", f"version: {version}").replace("version: 4", f"version: {version}")
    folder = write_folder(tmp_path / "x", known.replace("PATH", "x_0.db3").replace("CUSTOM", "null"))
    assert read(folder) == (["a", "b", "c"], ())


@pytest.mark.parametrize("version", [8, 9])
@pytest.mark.parametrize("qos", ["", [], "own"])
def test_as_rosbags_writes_it(tmp_path, image_message, serialized, version, qos):
    with Writer(tmp_path / "x", version=version, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/image", "sensor_msgs/msg/Image", typestore=typestore())
        writer.write(connection, 1, serialized(image_message(1)))
    path = tmp_path / "x" / "metadata.yaml"
    content = yaml.safe_load(path.read_text())
    if qos != "own":
        (topic,) = content["rosbag2_bagfile_information"]["topics_with_message_count"]
        topic["topic_metadata"]["offered_qos_profiles"] = qos
        path.write_text(yaml.safe_dump(content))
    with open_bag([tmp_path / "x"]) as bag:
        assert len(list(bag.messages())) == 1
        assert bag.warnings == ()


@pytest.mark.parametrize(
    "path",
    [
        r"C:\data\run 3\x_0.db3",
        r"..\x_0.db3",
        r"x\x_0.db3",
        "../elsewhere/x_0.db3",
        "/data/recordings/x/x_0.db3",
        "x/x_0.db3",
        "./x_0.db3",
        r"\\server\share\x_0.db3",
    ],
)
def test_paths_of_another_system_or_folder(tmp_path, write_folder, path):
    assert read(write_folder(tmp_path / "x", jazzy(f"'{path}'"))) == (["a", "b", "c"], ())


@pytest.mark.parametrize("named", ["x_0.db3", r"C:\x\y_0.db3", "sub/x.db3", "''", r"'C:\x\'"])
def test_a_renamed_file_is_read_and_that_is_said(tmp_path, write_folder, named):
    folder = write_folder(tmp_path / "x", jazzy(named), "renamed.db3")
    (folder / "other.mcap").write_bytes(b"no bag, and of another storage")
    data, (warning, other) = read(folder)
    assert data == ["a", "b", "c"]
    assert warning.startswith("x: metadata.yaml names ")
    assert warning.endswith(", which is not there; read instead: renamed.db3")
    assert other == "x: not named in metadata.yaml, and not read: other.mcap"


def test_no_storage_named_reads_whatever_is_there(tmp_path, write_folder):
    """`ros2 bag reindex` has left the storage empty."""
    text = jazzy("x_0.mcap").replace("storage_identifier: sqlite3", 'storage_identifier: ""')
    assert read(write_folder(tmp_path / "x", text, "renamed.db3"))[0] == ["a", "b", "c"]


def test_one_of_two_files_renamed_is_missing_and_named(tmp_path, write_folder):
    """It might be a copy of the other: read, its messages would come twice."""
    text = jazzy("x_0.db3").replace("    - x_0.db3\n", "    - x_0.db3\n    - x_1.db3\n")
    folder = write_folder(tmp_path / "x", text)
    (folder / "x_0 (copy).db3").write_bytes((folder / "x_0.db3").read_bytes())
    data, warnings = read(folder)
    assert data == ["a", "b", "c"]
    assert warnings == (
        "x: 1 of 2 files are missing (x_1.db3)",
        "x: not named in metadata.yaml, and not read: x_0 (copy).db3",
    )


def test_a_file_that_the_metadata_does_not_name_is_not_read_and_that_is_said(tmp_path, write_folder):
    folder = write_folder(tmp_path / "x", jazzy("x_0.db3"))
    (folder / "another.mcap").write_bytes((folder / "x_0.db3").read_bytes())
    assert read(folder) == (["a", "b", "c"], ("x: not named in metadata.yaml, and not read: another.mcap",))


@pytest.mark.parametrize("given", ["x", "x/", "x/x_0.db3", "x/metadata.yaml", "./x/../x/"])
def test_ways_to_name_a_bag(tmp_path, write_folder, given, monkeypatch):
    write_folder(tmp_path / "x", jazzy("x_0.db3"))
    monkeypatch.chdir(tmp_path)
    assert read(given) == (["a", "b", "c"], ())


def test_a_url_is_refused_as_such(tmp_path, write_folder):
    write_folder(tmp_path / "x", jazzy("x_0.db3"))
    with pytest.raises(BagError, match="a URL; need a path"):
        read(Path(f"file://{tmp_path}/x"))
