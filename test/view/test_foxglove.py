# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import io
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from imgu_ros.bags.reading import open_bag
from imgu_ros.cli.main import main
from imgu_ros.config.files import read_parameter_file
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import FileError
from imgu_ros.image_files.images import write_image
from imgu_ros.replay.replay import replay
from imgu_ros.view.view import view_with_foxglove

Content = dict[str, list[tuple[int, bytes]]]


def content(*paths: Path) -> Content:
    """Read recordings: topic -> time and bytes of each message."""
    found: Content = {}
    with open_bag(paths) as bag:
        for raw in bag.raw_messages():
            found.setdefault(raw.channel.topic, []).append((raw.time_ns, bytes(raw.data)))
        assert bag.warnings == ()
    return found


@pytest.fixture(scope="module")
def written(replayed: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("foxglove") / "all.mcap"
    assert view_with_foxglove(replayed[1], path) == path
    assert [each.name for each in path.parent.iterdir()] == ["all.mcap"]
    return path


def test_recording_and_results_are_copied_unchanged(replayed: tuple[Path, Path], written: Path) -> None:
    recording, results = content(replayed[0]), content(replayed[1] / "results")
    found = content(written)
    pictures = found.pop("/image_color/compressed")
    assert recording.keys() == {"/camera/image_raw", "/camera/camera_info"}
    assert found == recording | results
    assert len(found["/targets/poster_2/outline"]) == len(pictures) == 8
    assert [time for time, _ in pictures] == [time for time, _ in found["/camera/image_raw"]]


def test_an_independent_reader_reads_it(written: Path) -> None:
    reader = pytest.importorskip("mcap.reader")
    decoder = pytest.importorskip("mcap_ros2.decoder")
    last, sizes = 0, set()
    with written.open("rb") as file:
        opened = reader.make_reader(file, decoder_factories=[decoder.DecoderFactory()])
        for schema, channel, message, decoded in opened.iter_decoded_messages():
            assert message.log_time >= last
            last = message.log_time
            if channel.topic == "/image_color/compressed":
                assert schema.name == "sensor_msgs/msg/CompressedImage"
                sizes.add(Image.open(io.BytesIO(bytes(decoded.data))).size)
            if channel.topic == "/camera/image_raw":
                assert decoded.encoding == "bayer_rggb8"
    assert sizes == {(480, 360)}


def test_folder_of_pictures_and_a_recording_that_is_gone(
    replayed: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Frames of pictures are no messages in a file: they are there as JPEG."""
    (tmp_path / "frames").mkdir()
    with open_bag([replayed[0]]) as bag:
        for number, message in enumerate(bag.messages(["/camera/image_raw"])):
            pixels = np.asarray(message.message.data).reshape(360, 480)
            write_image(tmp_path / "frames" / f"{number:03}.png", pixels)
    parameters = parameters_from(read_parameter_file(replayed[0] / "params.yaml") | {"raw.encoding": "bayer_rggb8"})
    results = tmp_path / "results"
    replay([tmp_path / "frames"], results, parameters, rate_hz=10.0)
    assert main(["view", str(results), "--foxglove"]) == 0
    assert capsys.readouterr().out.splitlines()[0] == str(results / "view.mcap")
    found = content(results / "view.mcap")
    assert len(found["/image_color/compressed"]) == len(found["/status"]) == 8
    assert "/image_raw" not in found
    shutil.rmtree(tmp_path / "frames")
    assert main(["view", str(results), "--foxglove"]) == 0
    assert "there are no pictures" in capsys.readouterr().err
    assert content(results / "view.mcap").keys() == content(results / "results").keys()


def test_place_that_cannot_be_written(replayed: tuple[Path, Path], tmp_path: Path) -> None:
    with pytest.raises(FileError, match="can be written"):
        view_with_foxglove(replayed[1], tmp_path / "no" / "view.mcap")
    (tmp_path / "folder.mcap").mkdir()
    with pytest.raises(FileError, match="can be written"):
        view_with_foxglove(replayed[1], tmp_path / "folder.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["folder.mcap"]
