# SPDX-License-Identifier: Apache-2.0
"""`imgu simulate` as people call it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from imgu_ros.cli.main import main
from imgu_ros.config.files import read_parameter_file
from imgu_ros.files.frames_csv import read_rows
from imgu_ros.image_files.images import write_image
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.simulate.truth import read_truth

SMALL = ("simulate", "--size", "64x48", "--frames", "2")


def test_default_bag_says_how_to_replay_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "bag"
    assert main([*SMALL, "--out", str(out), "--seed", "3"]) == 0
    printed = capsys.readouterr().out
    assert "2 frames of 64x48, bayer_rggb8; 1 target, 2 true poses" in printed
    assert f"imgu replay {out} --params-file {out / 'params.yaml'} --truth {out / 'truth.csv'}" in printed
    assert {p.name for p in out.iterdir()} >= {"metadata.yaml", "poster.png", "truth.csv", "params.yaml"}


def test_same_seed_gives_the_same_files(tmp_path: Path) -> None:
    for name in "ab":
        assert main([*SMALL, "--out", str(tmp_path / name / "bag"), "--bits", "12", "--pattern", "grbg"]) == 0
    for name in ("bag.mcap", "truth.csv", "poster.png"):
        assert (tmp_path / "a/bag" / name).read_bytes() == (tmp_path / "b/bag" / name).read_bytes()


def test_shutter_lens_and_exposure_change_the_frames_and_not_the_truth(tmp_path: Path) -> None:
    options = {
        "plain": [],
        "blurred": ["--exposure-ms", "0.2"],
        "rolling": ["--row-time-us", "100"],
        "soft": ["--defocus-px", "2"],
        "lens": ["--f-number", "0.8", "--focus-m", "0.4", "--pixel-pitch-um", "50"],
        "dark": ["--ev=-2,-1"],
    }
    bags, truths = set(), set()
    for name, words in options.items():
        assert main([*SMALL, "--out", str(tmp_path / name), "--encoding", "mono16", "--bits", "14", *words]) == 0
        bags.add((tmp_path / name / f"{name}.mcap").read_bytes())
        truths.add((tmp_path / name / "truth.csv").read_bytes())
    assert len(bags) == len(options)
    assert len(truths) == 1


def test_sensitivities_transfer_and_saturation_change_the_frames_and_not_the_truth(tmp_path: Path) -> None:
    options = {
        "plain": [],
        "linear": ["--sensitivities", "1,1,1", "--transfer", "linear"],
        "uneven": ["--sensitivities", "0.5,1,0.65"],
        "srgb": ["--transfer", "srgb"],
        "film": ["--transfer", "film"],
        "bright": ["--saturated", "0.1"],
        "all": ["--sensitivities", "0.5,1,0.65", "--transfer", "film", "--saturated", "0.1", "--black-level", "16"],
    }
    frames, truths = {}, set()
    for name, words in options.items():
        out = tmp_path / name
        assert main([*SMALL, "--out", str(out), *words]) == 0
        with AnyReader([out], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            images = [c for c in reader.connections if c.topic == "/camera/image_raw"]
            data = [reader.deserialize(raw, c.msgtype).data for c, _, raw in reader.messages(images)]  # type: ignore[attr-defined]
        frames[name] = np.concatenate(data)
        truths.add((out / "truth.csv").read_bytes())
    assert len({frame.tobytes() for frame in frames.values()}) == len(options) - 1
    np.testing.assert_array_equal(frames["plain"], frames["linear"])
    assert len(truths) == 1
    for name in ("bright", "all"):
        assert np.mean(frames[name] == 255) == pytest.approx(0.1, abs=0.02)
    values = read_parameter_file(tmp_path / "all" / "params.yaml")
    assert values["raw.black_level"] == 16.0 and len(values["raw.gains"]) == 3  # type: ignore[arg-type]


def test_angle_of_view_sets_the_focal_length(tmp_path: Path) -> None:
    out = tmp_path / "bag"
    assert main([*SMALL, "--out", str(out), "--view-deg", "90"]) == 0
    with AnyReader([out], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        infos = [c for c in reader.connections if c.topic == "/camera/camera_info"]
        info = next(reader.deserialize(data, c.msgtype) for c, _, data in reader.messages(infos))
    # At 90 degrees the focal length is half the width.
    np.testing.assert_allclose(info.k[[0, 4]], 32)  # type: ignore[attr-defined]


def test_several_templates(tmp_path: Path) -> None:
    paths = [tmp_path / "Left Wall.png", tmp_path / "grey.png"]
    write_image(paths[0], procedural_texture(60, 80, 1))
    write_image(paths[1], np.ascontiguousarray(procedural_texture(80, 60, 2)[:, :, 0]))
    out = tmp_path / "bag"
    templates = [word for path in paths for word in ("--template", str(path))]
    assert main([*SMALL, "--out", str(out), *templates, "--width-m", "0.3", "--distortion", "plumb_bob"]) == 0
    assert {t.target for t in read_truth(out / "truth.csv")} == {"Left_Wall", "grey"}
    assert main([*SMALL, "--out", str(out), "--targets", "2", "--overwrite"]) == 0
    assert {t.target for t in read_truth(out / "truth.csv")} == {"poster", "poster_2"}
    assert not (out / "grey.png").exists()


@pytest.mark.skipif(not hasattr(cv2, "aruco"), reason="this OpenCV has no aruco module")
def test_a_marker_is_as_wide_as_asked(tmp_path: Path) -> None:
    """The width is that of the black square: by the exact homography its corners are where they should be."""
    out = tmp_path / "bag"
    options = ["--size", "640x480", "--frames", "2", "--tilt", "40"]
    assert main(["simulate", *options, "--out", str(out), "--template", "tag36h11:7", "--width-m", "0.2"]) == 0
    values = read_parameter_file(out / "params.yaml")
    assert (values["targets.images"], values["targets.widths_m"]) == (("tag36h11:7",), (0.2,))
    results = tmp_path / "results"
    assert main(["replay", str(out), "--params-file", str(out / "params.yaml"), "--out", str(results)]) == 0

    first, _ = read_rows(results / "frames.csv")
    true = read_truth(out / "truth.csv")[0]
    assert first["pose_status"] == "metric"
    t = np.array([float(first[name]) for name in ("tx", "ty", "tz")])
    assert np.linalg.norm(t - true.pose.t) < 2e-3 * np.linalg.norm(true.pose.t)


def test_all_ids_are_no_template(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("cv2.aruco")
    assert main([*SMALL, "--out", str(tmp_path / "bag"), "--template", "tag36h11:*"]) == 1
    assert "all ids of a family; need one, tag36h11:7" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--size", "63x48"], "size: 63x48; need even numbers for a Bayer pattern"),
        (["--size", "4x4"], "size: 4x4; need 32x32"),
        (["--pattern", "rgbw"], "pattern: 'rgbw'; need one of rggb, bggr, grbg, gbrg"),
        (["--bits", "9"], "bits: 9; need one of 8, 10, 12, 14, 16"),
        (["--bits", "12", "--encoding", "mono8"], "bits: 12; need 8 or fewer for mono8"),
        (["--encoding", "bayer_rgbg8"], "nearest known: 'bayer_rggb8'"),
        (["--encoding", "mono8", "--pattern", "rggb"], "need one of them"),
        (["--frames", "0"], "frames: 0; need 1 to 1000000"),
        (["--rate", "0"], "rate: 0 Hz"),
        (["--rate", "nan"], "rate: nan Hz"),
        (["--tilt", "95"], "motion"),
        (["--width-m", "0"], "width: 0 m; need more than 0"),
        (["--targets", "0"], "targets: 0; need 1 to 64"),
        (["--row-padding", "-4"], "row padding: -4 bytes"),
        (["--seed", "-1"], "seed: -1; need 0 or more"),
        (["--template", "/nowhere/a.png"], "/nowhere/a.png"),
        (["--full-well", "-5"], "full_well_e: -5"),
        (["--exposure-ms", "70"], "exposure: 70 ms; need 0 to the frame period, 66.6667"),
        (["--row-time-us", "2000"], "row time: 2000 us x 47 rows"),
        (["--defocus-px", "-1"], "defocus: -1 px"),
        (["--f-number", "0"], "f-number: 0; need more than 0"),
        (["--focus-m", "1"], "focus: 1 m without an f-number"),
        (["--f-number", "2", "--pixel-pitch-um", "0"], "pixel pitch: 0 um"),
        (["--view-deg", "180"], "view: 180 deg; need 1 to 150"),
        (["--ev", "11"], "ev: [11.0]; need numbers from -10 to 10"),
        (["--saturated", "1.5"], "saturated: 1.5; need more than 0, up to 0.99"),
        (["--saturated", "0.1", "--ev", "1"], "saturated: 0.1 with ev [1.0]; need one or the other"),
        (["--saturated", "0.001", "--full-well", "10", "--read-noise", "90"], "saturated: 0.001; need more than"),
        (["--sensitivities", "0.5,1"], "sensitivities: 0.5, 1; need 3 numbers"),
        (["--sensitivities", "0.5,1,2"], "from 0.01 to 1"),
        (["--sensitivities", "0.5,1,1", "--encoding", "rgb8"], "sensitivities: 0.5, 1, 1 of rgb pixels; need a Bayer"),
    ],
)
def test_bad_values_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    assert main([*SMALL, "--out", str(tmp_path / "bag"), *options]) == 1
    error = capsys.readouterr().err
    assert error.startswith("imgu: error: ")
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "bag").exists()


@pytest.mark.parametrize(
    "options",
    [
        ["--size", "big"],
        ["--storage", "tape"],
        ["--frames", "x"],
        ["--ev", "0,x"],
        ["--transfer", "log"],
        ["--nonsense"],
    ],
)
def test_wrong_usage_is_exit_2(tmp_path: Path, options: list[str]) -> None:
    assert main([*SMALL, "--out", str(tmp_path / "bag"), *options]) == 2


def test_folder_that_is_not_empty_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    assert main([*SMALL, "--out", str(tmp_path)]) == 1
    assert "need a new or an empty one, or --overwrite" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]


def test_place_that_cannot_be_written_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert main([*SMALL, "--out", str(tmp_path / "file" / "bag")]) == 1
    error = capsys.readouterr().err
    assert error.startswith("imgu: error: ")
    assert error.count("\n") == 1
