# SPDX-License-Identifier: Apache-2.0
"""Entries of `targets.images` that are markers, beside pictures."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from imgu_ros.config.parameters import TargetsParameters
from imgu_ros.errors import FileError, ParameterError
from imgu_ros.files.target_images import load_target_images
from imgu_ros.image_files.images import write_image
from imgu_ros.reference.family import FamilyImage
from imgu_ros.reference.marker import MarkerImage

needs_aruco = pytest.mark.skipif(not hasattr(cv2, "aruco"), reason="this OpenCV has no aruco module")
TEXTURE = np.random.default_rng(0).integers(0, 256, (40, 60, 3), np.uint8)


@needs_aruco
def test_markers_and_pictures_in_one_list(tmp_path: Path) -> None:
    write_image(tmp_path / "poster.png", TEXTURE)
    entries = ("tag36h11:7", str(tmp_path / "poster.png"), "aruco_5x5_100:12")
    first, poster, second = load_target_images(TargetsParameters(images=entries, widths_m=(0.1, 0.5, 0.05)))
    assert isinstance(first, MarkerImage) and isinstance(second, MarkerImage)
    assert (first.name, str(first.layout.markers[0]), first.width_m) == ("tag36h11_7", "tag36h11:7", 0.1)
    assert (second.name, str(second.layout.markers[0]), second.width_m) == (
        "aruco_5x5_100_12",
        "aruco_5x5_100:12",
        0.05,
    )
    assert (poster.name, poster.kind, poster.width_m) == ("poster", "", 0.5)
    (named,) = load_target_images(TargetsParameters(images=("tag36h11:7",), names=("dock",)))
    assert (named.name, named.width_m) == ("dock", 0.0)


@needs_aruco
@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("tag36h11:587", "targets.images: tag36h11:587: no such id; need 0 to 586"),
        ("tag36h11:-1", "no such id; need 0 to 586"),
        ("tag36h12:7", "tag36h12: no family of markers; did you mean tag36h11?"),
        ("aruco_5x5_10:7", "did you mean aruco_5x5_100"),
        ("tag36h11", "a family of markers without an id; need tag36h11:0 or tag36h11:*"),
        ("tag36h12:*", "tag36h12: no family of markers; did you mean tag36h11?"),
        ("aruco_original:1023", "turned, it looks like itself or another one of aruco_original; need another id"),
    ],
)
def test_what_is_refused(entry: str, message: str) -> None:
    with pytest.raises(ParameterError, match=re.escape(message)):
        load_target_images(TargetsParameters(images=(entry,)))


@needs_aruco
def test_all_ids_of_a_family(tmp_path: Path) -> None:
    """Those of other entries are theirs; numbers and names follow."""
    (tmp_path / "wall.yaml").write_text("grid: {family: tag36h11, rows: 1, columns: 2, size: 0.1, gap: 0.02}")
    entries = ("aruco_4x4_50:*", "tag36h11:7", "tag36h11:*", str(tmp_path / "wall.yaml"))
    targets = TargetsParameters(images=entries, widths_m=(0.1, 0.2, 0.3, 0.0), names=("bin", "door", "tag", "wall"))
    bins, door, tags, wall = load_target_images(targets)
    assert isinstance(bins, FamilyImage) and isinstance(tags, FamilyImage)
    assert (bins.family, bins.width_m, bins.first_number, bins.member_name(9)) == ("aruco_4x4_50", 0.1, 4, "bin_9")
    assert (tags.family, tags.width_m, tags.first_number) == ("tag36h11", 0.3, 4 + 50)
    assert (door.name, wall.name) == ("door", "wall")
    assert [tags.has(marker) for marker in (0, 1, 2, 7, 8)] == [False, False, True, False, True]


@needs_aruco
@pytest.mark.parametrize(
    ("targets", "message"),
    [
        (
            TargetsParameters(images=("tag36h11:*",), poses=(0, 0, 0, 0, 0, 0, 1)),
            "targets.poses: with tag36h11:* in targets.images, of which each marker has a place of its own",
        ),
        (
            TargetsParameters(images=("tag36h11:*", "tag36h11:*"), names=("a", "b")),
            "targets.images: tag36h11:* twice; need it once",
        ),
        (
            TargetsParameters(images=("tag36h11:*", "aruco_4x4_50:3"), names=("a", "a_12")),
            "targets.names: 'a_12' for a target and for tag36h11:12; need different names",
        ),
    ],
)
def test_families_that_are_refused(targets: TargetsParameters, message: str) -> None:
    with pytest.raises(ParameterError, match=re.escape(message)):
        load_target_images(targets)


@needs_aruco
def test_one_marker_twice_needs_two_names() -> None:
    with pytest.raises(ParameterError, match="'tag36h11_7' for both tag36h11:7 and tag36h11:7"):
        load_target_images(TargetsParameters(images=("tag36h11:7", "tag36h11:7")))


def test_an_opencv_without_markers(monkeypatch: pytest.MonkeyPatch) -> None:
    from imgu_ros.vision.markers import dictionaries

    dictionaries.marker_dictionary.cache_clear()
    if hasattr(cv2, "aruco"):
        monkeypatch.delattr(cv2, "aruco")
    with pytest.raises(ParameterError, match=r"targets\.images: tag36h11: .* has no aruco module; need "):
        load_target_images(TargetsParameters(images=("tag36h11:7",)))
    dictionaries.marker_dictionary.cache_clear()


def test_a_file_may_have_such_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_image(tmp_path / "shelf.png", TEXTURE)
    (tmp_path / "shelf.png").rename(tmp_path / "tag36h11:7")
    (picture,) = load_target_images(TargetsParameters(images=("tag36h11:7",)))
    assert not isinstance(picture, MarkerImage)
    with pytest.raises(FileError):
        load_target_images(TargetsParameters(images=("missing.png",)))
