# SPDX-License-Identifier: Apache-2.0
"""Families of markers, and finding them in drawings."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from imgu_ros.errors import ShapeError
from imgu_ros.vision.markers import (
    MarkerFinder,
    marker_cells,
    marker_codes,
    marker_count,
    marker_distance,
    nearest_marker,
    require_marker_family,
)
from imgu_ros.vision.markers.dictionaries import MARKER_FAMILIES

HAS_ARUCO = hasattr(cv2, "aruco")
needs_aruco = pytest.mark.skipif(not HAS_ARUCO, reason="this OpenCV has no aruco module")
#: The code of AprilTag's tag36h11 0, its most significant bit at the top left (Olson 2011).
TAG36H11_0 = 0xD5D628584


def drawn(family: str, number: int, cell_px: int = 12) -> np.ndarray:
    cells = np.pad(marker_cells(family, number), 2, constant_values=True)
    return np.kron(cells, np.full((cell_px, cell_px), 255, np.uint8))


def known_families() -> list[str]:
    found = []
    for family in MARKER_FAMILIES:
        try:
            require_marker_family(family)
        except ShapeError:
            continue
        found.append(family)
    return found


@needs_aruco
def test_every_marker_has_a_black_border_and_is_found_upright() -> None:
    families = known_families()
    assert len(families) >= 20
    for family in families:
        number = marker_count(family) - 1
        cells = marker_cells(family, number)
        assert cells.shape[0] == cells.shape[1]
        assert not (cells[0].any() or cells[-1].any() or cells[:, 0].any() or cells[:, -1].any())
        side = 12 * len(cells)
        (found,) = [each for each in MarkerFinder(family).find(drawn(family, number)) if each.number == number]
        # The square begins after two cells of white.
        expected = np.array([[24, 24], [24 + side, 24], [24 + side, 24 + side], [24, 24 + side]]) - 0.5
        assert np.abs(found.corners - expected).max() < 1.5, family


@needs_aruco
def test_apriltag_is_as_its_own_library_has_it() -> None:
    code = marker_cells("tag36h11", 0)[1:-1, 1:-1].ravel()
    assert int("".join("1" if bit else "0" for bit in code), 2) == TAG36H11_0


@needs_aruco
def test_the_apriltag_library_agrees() -> None:
    """Second method: another program reads id and orientation of what is drawn here."""
    library = pytest.importorskip("apriltag").apriltag("tag36h11")
    for number in (0, 7, 586):
        (found,) = library.detect(drawn("tag36h11", number, 20))
        assert found["id"] == number
        # Its x axis goes to the right of the picture: (1, 0) is seen right of (0, 0).
        right = found["homography"] @ (1, 0, 1)
        assert right[0] / right[2] - found["center"][0] > 50


@needs_aruco
@pytest.mark.parametrize("zoom", [1, 3])
def test_places_are_those_of_the_image_whatever_the_zoom(zoom: int) -> None:
    image = np.full((200, 260), 255, np.uint8)
    image[40:160, 70:190] = cv2.resize(
        marker_cells("aruco_5x5_100", 12).astype(np.uint8) * 255, (120, 120), interpolation=cv2.INTER_NEAREST
    )
    (found,) = MarkerFinder("aruco_5x5_100").find(image, zoom)
    assert found.number == 12
    assert np.abs(found.corners - [[69.5, 39.5], [189.5, 39.5], [189.5, 159.5], [69.5, 159.5]]).max() < 1.2
    assert MarkerFinder("aruco_5x5_100").find(image, zoom, only={13}) == []


@needs_aruco
def test_distances_of_codes() -> None:
    """Hamming distances by brute force of a small family."""
    codes = marker_codes("tag16h5")
    assert codes.shape == (30, 4, 4)
    for number in (0, 11, 29):
        own = codes[number]
        expected = min(
            int((np.rot90(other, -turn) ^ own).sum())
            for index, other in enumerate(codes)
            for turn in range(4)
            if (index, turn) != (number, 0)
        )
        assert marker_distance("tag16h5", number) == expected >= 5
    assert nearest_marker("tag36h11", 7, marker_codes("tag36h11")[9]) == 0
    assert min(marker_distance("tag36h11", number) for number in range(0, 587, 50)) >= 11


@needs_aruco
@pytest.mark.parametrize("number", [-1, 587])
def test_an_id_out_of_range(number: int) -> None:
    with pytest.raises(ShapeError, match="no such id; need 0 to 586"):
        marker_cells("tag36h11", number)


def test_an_unknown_family_names_the_nearest() -> None:
    with pytest.raises(ShapeError, match="tag36h12: no family of markers; did you mean tag36h11"):
        require_marker_family("tag36h12")
    with pytest.raises(ShapeError, match="need one of tag16h5"):
        require_marker_family("qr")


def test_an_opencv_without_markers(monkeypatch: pytest.MonkeyPatch) -> None:
    from imgu_ros.vision.markers import dictionaries

    dictionaries.marker_dictionary.cache_clear()
    if HAS_ARUCO:
        monkeypatch.delattr(cv2, "aruco")
    with pytest.raises(ShapeError, match="has no aruco module; need .*python3-opencv"):
        require_marker_family("tag36h11")
    dictionaries.marker_dictionary.cache_clear()
