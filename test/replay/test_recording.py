# SPDX-License-Identifier: Apache-2.0
"""Simulated bags: what is written is what was simulated, in every format."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from imgu_ros.config.files import read_parameter_file
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import EncodingError, FileError, ParameterError
from imgu_ros.files.target_images import load_target_images
from imgu_ros.reference.templates import TargetImage
from imgu_ros.replay.recording import BagFormat, raw_parameters, record_simulation, simulated_encoding
from imgu_ros.simulate.capture import Capture
from imgu_ros.simulate.sequence import TYPICAL_LENSES, Simulation, default_camera, simulate_sequence
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.simulate.truth import read_truth
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.levels import with_levels
from imgu_ros.vision.formation.sensor import Sensor, expose
from imgu_ros.vision.formation.transfer import TransferFunction

SMALL = Simulation(width=64, height=48, frames=2)
TARGETS = (TargetImage("poster", procedural_texture(80, 60), 0.25),)


def messages(bag: Path, topic: str) -> list:  # type: ignore[type-arg]
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        connections = [c for c in reader.connections if c.topic == topic]
        return [(time, reader.deserialize(data, c.msgtype)) for c, time, data in reader.messages(connections)]


@pytest.mark.parametrize(
    ("bag_format", "bits"),
    [
        (BagFormat("bayer_rggb8"), 8),
        (BagFormat("bayer_bggr16", row_padding=6, big_endian=True), 12),
        (BagFormat("bayer_grbg16", storage="sqlite3"), 10),
        (BagFormat("bayer_gbrg16", compression="zstd"), 16),
        (BagFormat("bayer_rggb16", storage="sqlite3", compression="zstd"), 8),
        (BagFormat("mono8", row_padding=3), 8),
        (BagFormat("mono16"), 14),
        (BagFormat("rgb8", row_padding=1), 8),
        (BagFormat("bgr16", big_endian=True), 16),
    ],
    ids=str,
)
def test_bag_holds_the_simulated_pixels(tmp_path: Path, bag_format: BagFormat, bits: int) -> None:
    out = tmp_path / "bag"
    simulation = replace(SMALL, sensor=Sensor(bits))
    progress: list[int] = []
    truths = record_simulation(
        out, simulation, bag_format, TARGETS, on_progress=lambda done, total: progress.append(done)
    )
    assert progress == [1, 2]
    layout = simulated_encoding(bag_format.encoding).layout
    expected = list(simulate_sequence(replace(simulation, layout=layout), TARGETS))
    images, infos = messages(out, "/camera/image_raw"), messages(out, "/camera/camera_info")
    assert len(images) == len(infos) == 2
    for (time, image), (_, info), simulated in zip(images, infos, expected, strict=True):
        frame = simulated.frame
        assert time == frame.stamp_ns
        for message in (image, info):
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == frame.stamp_ns
            assert message.header.frame_id == frame.frame_id
            assert (message.width, message.height) == (64, 48)
        assert image.encoding == bag_format.encoding
        # The bytes by hand: rows, without their padding, in the byte order that the message names.
        sample = 2 if bag_format.encoding.endswith("16") else 1
        row = 64 * sample * (3 if bag_format.encoding in ("rgb8", "bgr16") else 1)
        assert image.step == row + bag_format.row_padding
        rows = np.frombuffer(image.data, np.uint8).reshape(48, image.step)[:, :row]
        dtype = "u1" if sample == 1 else ">u2" if image.is_bigendian else "<u2"
        pixels = np.frombuffer(rows.tobytes(), dtype).reshape(frame.image.pixels.shape)
        np.testing.assert_array_equal(pixels, frame.image.pixels)
        assert pixels.max() < 2**bits
        assert bool(image.is_bigendian) == bag_format.big_endian
        assert frame.camera is not None
        np.testing.assert_array_equal(info.k.reshape(3, 3), frame.camera.K)
    read = read_truth(out / "truth.csv")
    assert len(read) == len(truths) == 2
    for a, b in zip(read, [t for s in expected for t in s.truths], strict=True):
        np.testing.assert_array_equal(a.H, b.H)
    values = read_parameter_file(out / "params.yaml")
    assert values.get("raw.significant_bits") == (bits if bits > 8 else None)
    (target,) = load_target_images(parameters_from(values).targets)
    assert (target.name, target.width_m) == ("poster", 0.25)
    np.testing.assert_array_equal(target.pixels, TARGETS[0].pixels)


def test_parameters_and_truth_of_a_capture_are_written(tmp_path: Path) -> None:
    capture = Capture(saturated=0.05, sensitivities=(0.5, 1.0, 0.65))
    simulation = replace(SMALL, sensor=Sensor(10, black_level_dn=64), capture=capture)
    out = tmp_path / "b"
    record_simulation(out, simulation, BagFormat("bayer_grbg16"), TARGETS)
    raw = parameters_from(read_parameter_file(out / "params.yaml")).raw
    assert (raw.transfer, raw.black_level, raw.significant_bits) == ("linear", 64.0, 10)
    assert raw.gains == pytest.approx((2.0, 1.0, 1 / 0.65), abs=1e-6)
    with (out / "exposure.csv").open() as file:
        rows = list(csv.DictReader(file))
    layout = simulated_encoding("bayer_grbg16").layout
    for row, simulated in zip(rows, simulate_sequence(replace(simulation, layout=layout), TARGETS), strict=True):
        assert int(row["stamp_ns"]) == simulated.frame.stamp_ns
        assert float(row["exposure"]) == simulated.exposure
        assert float(row["saturated"]) == np.mean(simulated.frame.image.pixels == 1023)
        assert float(row["saturated"]) == pytest.approx(0.05, abs=0.01)
        assert [float(row[f"sensitivity_{c}"]) for c in "rgb"] == [0.5, 1.0, 0.65]
        assert (row["transfer"], float(row["black_level"]), float(row["white_level"])) == ("linear", 64, 1023)


def test_defaults_write_the_parameters_that_they_wrote_before(tmp_path: Path) -> None:
    record_simulation(tmp_path / "b", SMALL, None, TARGETS)
    folder = (tmp_path / "b").resolve()
    assert (folder / "params.yaml").read_text() == (
        f"/**:\n  ros__parameters:\n    targets:\n      images:\n      - {folder}/poster.png\n      widths_m:\n"
        "      - 0.25\n      names:\n      - poster\n    raw:\n      transfer: linear\n"
    )
    assert (folder / "truth.csv").read_text().startswith("stamp_ns,target,h11,h12,h13,h21,h22,h23,h31,h32,h33,tx,")
    assert len((folder / "truth.csv").read_text().splitlines()[1].split(",")) == 18


@pytest.mark.parametrize(
    ("transfer", "parameter", "gain"), [("linear", "linear", 2.0), ("srgb", "srgb", 1.36), ("film", "srgb", 1.216)]
)
def test_gains_balance_the_values_of_white(transfer: str, parameter: str, gain: float) -> None:
    capture = Capture(sensitivities=(0.5, 1.0, 1.0), transfer=TransferFunction(transfer))
    raw = raw_parameters(Sensor(), capture)
    assert raw["transfer"] == parameter
    assert raw["gains"] == pytest.approx([gain, 1.0, 1.0], abs=1e-3)
    white = np.array([[0.5, 1.0], [1.0, 1.0]], np.float32)
    values = expose(white, Sensor(full_well_e=1e12), 0, transfer)
    assert (with_levels(values, BayerPattern.RGGB, 0, 0, raw["gains"]) >= 254).all()  # type: ignore[arg-type]


def test_lens_and_black_level_are_written(tmp_path: Path) -> None:
    camera = default_camera(64, 48, "equidistant", TYPICAL_LENSES[default_camera(64, 48, "equidistant").model])
    record_simulation(tmp_path / "b", replace(SMALL, camera=camera, sensor=Sensor(8, black_level_dn=7)), None, TARGETS)
    _, info = messages(tmp_path / "b", "/camera/camera_info")[0]
    assert info.distortion_model == "equidistant"
    np.testing.assert_array_equal(info.d, camera.distortion)
    assert read_parameter_file(tmp_path / "b" / "params.yaml")["raw.black_level"] == 7.0


def test_overwrite_replaces_a_simulated_bag_and_nothing_else(tmp_path: Path) -> None:
    out = tmp_path / "bag"
    record_simulation(out, SMALL, None, TARGETS)
    with pytest.raises(FileError, match="--overwrite"):
        record_simulation(out, SMALL, None, TARGETS)
    record_simulation(out, replace(SMALL, frames=1), BagFormat(storage="sqlite3"), TARGETS, overwrite=True)
    assert len(messages(out, "/camera/image_raw")) == 1
    assert not list(out.glob("*.mcap"))
    (out / "thesis.txt").write_text("years of work")
    record_simulation(out, SMALL, None, TARGETS, overwrite=True)
    assert (out / "thesis.txt").read_text() == "years of work"
    assert not list(out.glob("*.db3"))
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    (pictures / f"{TARGETS[0].name}.png").write_bytes(b"x")
    with pytest.raises(FileError, match="it is yours, or of an earlier version"):
        record_simulation(pictures, SMALL, None, TARGETS, overwrite=True)
    assert [path.read_bytes() for path in pictures.iterdir()] == [b"x"]
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(FileError, match="not a folder"):
        record_simulation(file, SMALL, None, TARGETS, overwrite=True)


def test_impossible_recordings_leave_no_folder(tmp_path: Path) -> None:
    out = tmp_path / "bag"
    for simulation, bag_format, error in (
        (SMALL, BagFormat("bayer_rgbg8"), EncodingError),
        (SMALL, BagFormat("32FC1"), ParameterError),
        (replace(SMALL, sensor=Sensor(12)), BagFormat("mono8"), ParameterError),
        (SMALL, BagFormat(row_padding=-1), ParameterError),
        (replace(SMALL, frames=0), BagFormat(), ParameterError),
    ):
        with pytest.raises(error):
            record_simulation(out, simulation, bag_format, TARGETS)
        assert not out.exists()
