# SPDX-License-Identifier: Apache-2.0
"""The main job on real input: a Nikon sensor's raw frames, and bags that other people recorded."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from imgu_ros.bags.messages import make_message
from imgu_ros.bags.reading import open_bag
from imgu_ros.bags.writing import BagWriter
from imgu_ros.cli.main import main
from imgu_ros.config.parameters import DemosaicParameters, RawParameters
from imgu_ros.image.frame_image import develop
from imgu_ros.image_files.images import read_raw_image, write_image
from imgu_ros.messages.frame import decode_frame
from imgu_ros.messages.header import Header
from imgu_ros.messages.image import decode_image, image_message
from imgu_ros.types import Image
from imgu_ros.vision.formation.cfa import BayerPattern, mosaic
from imgu_ros.vision.formation.demosaic import DemosaicMethod, demosaic
from imgu_ros.vision.projective.homography import normalised_homography
from imgu_ros.vision.projective.transform import transform

WIDTH, HEIGHT = 768, 512
BLACK, WHITE = 600, 15520
GAINS = (1.949, 1.0, 1.344)
RAW = [
    "-p", f"raw.black_level:={BLACK}", "-p", f"raw.white_level:={WHITE}", "-p", f"raw.gains:={list(GAINS)}",
]  # fmt: skip


@pytest.fixture(scope="module")
def raws(data_dir: Path) -> dict[BayerPattern, Image]:
    folder = data_dir / "raw" / "nikon"
    return {
        pattern: read_raw_image(folder / f"DSC_1339_768x512_{pattern}.raw", WIDTH, HEIGHT, "<u2")
        for pattern in BayerPattern
    }


def write_bag(path: Path, frames: list[tuple[Image, str]]) -> Path:
    with BagWriter(path) as writer:
        for index, (pixels, encoding) in enumerate(frames):
            header = Header(1_000_000_000 + index * 100_000_000, "camera")
            writer.write("/image_raw", image_message(make_message, header, pixels, encoding), header.stamp_ns)
    return path


@pytest.fixture(scope="module")
def nikon_bag(raws: dict[BayerPattern, Image], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("nikon")
    return write_bag(folder / "bag", [(raw, f"bayer_{pattern}16") for pattern, raw in raws.items()])


def binned(raw: Image, pattern: BayerPattern) -> Image:
    """Red, mean green and blue of each 2x2 quad, without interpolation."""
    sites = {"r": [], "g": [], "b": []}
    for index, color in enumerate(pattern.value):
        sites[color].append(raw[index // 2 :: 2, index % 2 :: 2].astype(np.float64))
    return np.stack([sites["r"][0], (sites["g"][0] + sites["g"][1]) / 2, sites["b"][0]], axis=2)


def test_the_four_orders_hold_the_same_quads(nikon_bag: Path, raws: dict[BayerPattern, Image]) -> None:
    with open_bag([nikon_bag]) as bag:
        images = [decode_image(m.message) for m in bag.messages(["/image_raw"])]
    pictures = [binned(i.pixels, i.layout.pattern) for i in images]
    assert [i.layout.pattern for i in images] == list(raws)
    assert all(np.array_equal(p, pictures[0]) for p in pictures)


def test_bilinear_pictures_of_the_four_orders_agree(nikon_bag: Path) -> None:
    """To 34 dB: the orders are permutations inside each quad, so that edges move by a pixel."""
    raw = RawParameters(black_level=BLACK, white_level=WHITE)
    with open_bag([nikon_bag]) as bag:
        colors = [
            develop(decode_frame(m.message, None, rectified=False).image, raw, DemosaicParameters()).color()
            for m in bag.messages(["/image_raw"])
        ]
    assert all(c.dtype == np.uint16 and c.shape == (HEIGHT, WIDTH, 3) for c in colors)
    for color in colors[1:]:
        mean_square = np.mean((colors[0].astype(np.float64) - color)[8:-8, 8:-8] ** 2)
        assert 10 * np.log10(65535**2 / mean_square) >= 34


@pytest.mark.parametrize("method", list(DemosaicMethod))
@pytest.mark.parametrize("crop", [(1, 0), (0, 1), (1, 1)])
def test_cropping_shifts_the_phase(
    raws: dict[BayerPattern, Image], method: DemosaicMethod, crop: tuple[int, int]
) -> None:
    rows, columns = crop
    raw = raws[BayerPattern.RGGB]
    whole = demosaic(raw, BayerPattern.RGGB, method)[rows:, columns:]
    cropped = demosaic(np.ascontiguousarray(raw[rows:, columns:]), BayerPattern.RGGB.shifted(rows, columns), method)
    assert np.array_equal(whole[32:-32, 32:-32], cropped[32:-32, 32:-32])


def test_the_scene_is_found_in_a_warped_copy(raws: dict[BayerPattern, Image], nikon_bag: Path, tmp_path: Path) -> None:
    picture = demosaic(raws[BayerPattern.RGGB], BayerPattern.RGGB)
    balanced = np.clip((picture.astype(np.float64) - BLACK) * GAINS / (WHITE - BLACK), 0, 1)
    write_image(tmp_path / "scene.png", np.rint(balanced**0.45 * 255).astype(np.uint8))
    warp = np.array([[0.83, -0.31, 150.0], [0.27, 0.86, -60.0], [1.2e-4, -6e-5, 1.0]])
    warped = cv2.warpPerspective(picture, warp, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC, borderValue=(700, 700, 700))
    frames = [(raw, f"bayer_{pattern}16") for pattern, raw in raws.items()]
    frames += [(mosaic(warped, pattern), f"bayer_{pattern}16") for pattern in BayerPattern]
    bag = write_bag(tmp_path / "bag", frames)
    out = tmp_path / "out"
    arguments = ["replay", str(bag), "--out", str(out), *RAW, "-p", f"targets.images:=[{tmp_path / 'scene.png'}]"]
    assert main(arguments) == 0
    with (out / "frames.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 8
    corners = np.array([[-0.5, -0.5], [WIDTH - 0.5, -0.5], [WIDTH - 0.5, HEIGHT - 0.5], [-0.5, HEIGHT - 0.5]])
    for index, row in enumerate(rows):
        assert row["status"] in ("detected", "tracked")
        assert row["pose_status"] == "uncalibrated"
        truth = np.eye(3) if index < 4 else normalised_homography(warp)
        H = np.array([float(row[f"h{i}{j}"]) for i in (1, 2, 3) for j in (1, 2, 3)]).reshape(3, 3)
        # Sites are permuted inside the quads, the target is gamma-encoded, the sky has no texture: a pixel is good.
        error = np.hypot(*(transform(H, corners) - transform(truth, corners)).T).mean()
        assert error < 1.5


def test_a_recorded_bag_with_missing_splits(data_dir: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = data_dir / "bags" / "soccer_goal_ros2_mcap_zstd"
    with open_bag([path]) as bag:
        first = decode_image(next(iter(bag.messages(["/camera/image_raw"]))).message)
    # A part of the scene itself serves as the target.
    write_image(tmp_path / "part.png", first.pixels[60:420, 80:560])
    out = tmp_path / "out"
    assert main(["replay", str(path), "--out", str(out), "-p", f"targets.images:=[{tmp_path / 'part.png'}]"]) == 0
    said = capfd.readouterr().err
    assert "soccer_goal_0.mcap" in said
    assert "12" in said
    summary = json.loads((out / "summary.json").read_text())
    with (out / "frames.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2
    assert rows[0]["status"] == "detected"
    H = np.array([float(rows[0][f"h{i}{j}"]) for i in (1, 2, 3) for j in (1, 2, 3)]).reshape(3, 3)
    corners = np.array([[0.0, 0], [479, 0], [479, 359], [0, 359]])
    assert np.hypot(*(transform(H, corners) - corners - (80, 60)).T).mean() < 0.3
    assert any("soccer_goal_0.mcap" in warning for warning in summary["warnings"])


def test_a_recorded_ros1_bag(data_dir: Path, tmp_path: Path) -> None:
    path = data_dir / "bags" / "ros_numpy_test_a.bag"
    with open_bag([path]) as bag:
        topic = next(t.name for t in bag.topics if t.type_name == "sensor_msgs/msg/Image")
        picture = decode_image(next(iter(bag.messages([topic]))).message).pixels
    texture = np.random.default_rng(0).integers(0, 255, (300, 300), dtype=np.uint8)
    write_image(tmp_path / "target.png", cv2.GaussianBlur(texture, (0, 0), 1.5) if picture.std() < 5 else picture)
    out = tmp_path / "out"
    assert main(["replay", str(path), "--out", str(out), "-p", f"targets.images:=[{tmp_path / 'target.png'}]"]) == 0
    with (out / "frames.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert rows
    assert all(row["status"] != "rejected" for row in rows)
