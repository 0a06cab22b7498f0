# SPDX-License-Identifier: Apache-2.0
"""Fiducial markers: poses against exact truth and another method, and what must never go out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest
from marker_scenes import FAMILY, FINE, HEIGHT, LAYOUT, WIDTH, K, error_m, exposed, placed, put, scene

from imgu_ros.build_cache import BuildCache
from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.frame import Frame
from imgu_ros.localizer import Localizer, prepare_localizer
from imgu_ros.reference.marker import MarkerReference, marker_image
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import make_references, prepare_references
from imgu_ros.result import PoseStatus, Status
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.vision.camera.intrinsics import make_camera
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
from imgu_ros.vision.markers import marker_cells

pytestmark = pytest.mark.skipif(not hasattr(cv2, "aruco"), reason="this OpenCV has no aruco module")


def localizer(numbers: Sequence[int], width_m: float = 0.1, family: str = FAMILY, **values: object) -> Localizer:
    parameters = parameters_from({name.replace("__", "."): value for name, value in values.items()})
    images = [marker_image(f"m{number}", family, number, width_m) for number in numbers]
    return Localizer(parameters, make_references(images, parameters))


@pytest.mark.parametrize(
    ("family", "number"), [("tag36h11", 7), ("tag16h5", 3), ("tag25h9", 30), ("aruco_5x5_100", 12), ("aruco_4x4_50", 0)]
)
def test_a_marker_is_found_and_tracked_more_exactly_than_by_its_corners(family: str, number: int) -> None:
    """Truth is exact; the second method is OpenCV's own pose of the refined corners."""
    own = localizer([number], family=family)
    cells = marker_cells(family, number)
    errors, theirs, statuses = [], [], []
    for index in range(4):
        R, t = placed(0.05 + 0.01 * index, -0.03, 0.8, 35 + index)
        light = scene()
        put(light, cells, 0.1, R, t)
        frame = exposed(light, seed=index, index=index)
        found = own.process(frame).first
        statuses.append(found.status)
        errors.append(error_m(found, t))
        assert np.linalg.norm(cv2.Rodrigues(R @ found.pose.R.T)[0]) < 0.01
        grey = cv2.cvtColor(frame.image.pixels, cv2.COLOR_BayerBG2GRAY)
        corners = found.outline.astype(np.float32).reshape(-1, 1, 2).copy()
        cv2.cornerSubPix(grey, corners, (3, 3), (-1, -1), (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.01))
        square = np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) * 0.05
        _, _, shift = cv2.solvePnP(square, corners, K, None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
        theirs.append(float(np.linalg.norm(shift.ravel() - t)))
    assert statuses == [Status.DETECTED, *[Status.TRACKED] * 3]
    assert max(errors) < 5e-4
    assert np.median(errors) < np.median(theirs) / 2


def test_the_outline_is_that_of_the_black_square() -> None:
    R, t = placed(0, 0, 0.6, 0, 0)
    light = scene()
    put(light, marker_cells(FAMILY, 7), 0.1, R, t)
    found = localizer([7]).process(exposed(light)).first
    half = 680 * 0.05 / 0.6
    expected = np.array([[-half, -half], [half, -half], [half, half], [-half, half]]) + (319.5, 239.5)
    assert found.outline is not None
    assert np.abs(found.outline - expected).max() < 0.05


def test_covariances_hold() -> None:
    """Squared errors in units of the covariance, of views that differ in place, tilt and noise."""
    nees = []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        R, t = placed(*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.5, 1.2), rng.uniform(15, 55), rng.uniform(0, 360))
        light = scene()
        put(light, marker_cells(FAMILY, 7), 0.1, R, t)
        found = localizer([7]).process(exposed(light, seed)).first
        if found.pose is None:
            assert found.pose_status is PoseStatus.AMBIGUOUS
            continue
        error = np.concatenate((t - found.pose.t, cv2.Rodrigues(R @ found.pose.R.T)[0].ravel()))
        nees.append(float(error @ np.linalg.solve(found.pose.covariance, error)))
    assert len(nees) >= 20
    assert np.mean(np.array(nees) < 12.59) >= 0.9


@pytest.mark.parametrize("side_px", [18, 24, 40])
def test_small_markers_are_found(side_px: int) -> None:
    R, t = placed(0.02, 0.01, 680 * 0.05 / side_px, 30)
    light = scene()
    put(light, marker_cells(FAMILY, 7), 0.05, R, t)
    found = localizer([7], 0.05).process(exposed(light)).first
    assert found.status is Status.DETECTED, found.reason
    assert np.linalg.norm(found.solutions[0].t - t) < 0.01 * t[2]


def test_a_curve_of_the_camera_is_learnt_of_the_marker() -> None:
    """A curve moves edges between black and white by tenths of a px: a lens of the same corners would be off."""
    R, t = placed(0.03, 0.02, 0.8, 40)
    light = scene()
    put(light, marker_cells(FAMILY, 7), 0.1, R, t)
    coded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    linear = exposed(light)
    values = linear.image.pixels.astype(np.float64) / 255
    pixels = np.rint(255 * np.where(values <= 0.0031308, 12.92 * values, 1.055 * values ** (1 / 2.4) - 0.055))
    frame = replace(linear, image=RawImage(pixels.astype(np.uint8), LAYOUT))
    found = localizer([7]).process(frame).first
    assert error_m(found, t) < 1.5e-3
    assert coded.shape == light.shape
    fixed = localizer([7], raw__transfer="linear").process(frame).first
    assert np.linalg.norm(fixed.solutions[0].t - t) > 3 * error_m(found, t)


def test_half_out_of_view_it_is_tracked() -> None:
    own = localizer([7])
    statuses = []
    for index in range(8):
        R, t = placed(0.21 + 0.012 * index, 0, 0.6, 20)
        light = scene()
        put(light, marker_cells(FAMILY, 7), 0.1, R, t)
        found = own.process(exposed(light, index, index=index)).first
        statuses.append(found.status)
        if found.pose is not None:
            assert error_m(found, t) < 2e-3
    # At 0.282 m its centre is on the border of the frame.
    assert statuses[0] is Status.DETECTED
    assert statuses[1:7] == [Status.TRACKED] * 6


def test_another_id_never_goes_out() -> None:
    """Every known id but that in view is lost; so is a known one when its marker is replaced at the same place."""
    own = localizer([8, 7, 100, 586])
    R, t = placed(0, 0, 0.7, 25)
    light = scene()
    put(light, marker_cells(FAMILY, 7), 0.1, R, t)
    assert [result.status for result in own.process(exposed(light))] == [
        Status.LOST, Status.DETECTED, Status.LOST, Status.LOST
    ]  # fmt: skip
    light = scene()
    put(light, marker_cells(FAMILY, 8), 0.1, R, t)
    statuses = {result.name: result.status for result in own.process(exposed(light, 1, index=1))}
    assert statuses == {"m8": Status.DETECTED, "m7": Status.LOST, "m100": Status.LOST, "m586": Status.LOST}


@pytest.mark.parametrize("change", ["inverted", "mirrored", "noise", "other_family", "blank"])
def test_what_is_no_marker_of_that_id(change: str) -> None:
    cells = marker_cells(FAMILY, 7)
    inner = np.random.default_rng(3).random((6, 6)) < 0.5
    shown = {
        "inverted": ~cells,
        "mirrored": cells[:, ::-1],
        "noise": np.pad(inner, 1),
        "other_family": marker_cells("aruco_6x6_250", 7),
        "blank": np.zeros((8, 8), bool),
    }[change]
    R, t = placed(0, 0, 0.5, 15)
    light = scene()
    put(light, shown, 0.1, R, t)
    for result in localizer([7, 0, 300]).process(exposed(light)):
        assert result.status is Status.LOST
        assert result.pose is None
        assert result.reason


def test_a_marker_that_is_cut_off_is_not_detected() -> None:
    """A code that is not in view cannot be read."""
    R, t = placed(0.29, 0, 0.6, 10)
    light = scene()
    put(light, marker_cells(FAMILY, 7), 0.1, R, t)
    assert localizer([7]).process(exposed(light)).first.status is Status.LOST


def test_two_of_one_id_are_reported() -> None:
    light = scene()
    for x in (-0.1, 0.1):
        put(light, marker_cells(FAMILY, 7), 0.08, *placed(x, 0, 0.7, 20))
    put(light, marker_cells(FAMILY, 9), 0.08, *placed(0, 0.12, 0.7, 20))
    twice, once = localizer([7, 9], 0.08).process(exposed(light))
    assert twice.status is Status.LOST
    assert "2 markers with its id are in view" in twice.reason
    assert once.status is Status.DETECTED


def test_a_dim_frame() -> None:
    R, t = placed(0, 0, 0.7, 25)
    light = scene()
    put(light, marker_cells(FAMILY, 7), 0.1, R, t)
    frame = exposed(light * np.float32(0.12))
    assert error_m(localizer([7]).process(frame).first, t) < 3e-3


def test_a_lens_that_distorts() -> None:
    distortion = [-0.2, 0.05, 0.0, 0.0, 0.0]
    R, t = placed(-0.16, 0.1, 0.7, 30)
    light = scene()
    put(light, marker_cells(FAMILY, 7), 0.1, R, t)
    x, y = np.meshgrid(np.arange(WIDTH * FINE, dtype=np.float64), np.arange(HEIGHT * FINE, dtype=np.float64))
    raw = np.column_stack(((x.ravel() + 0.5) / FINE - 0.5, (y.ravel() + 0.5) / FINE - 0.5))
    ideal = cv2.undistortPoints(raw.reshape(-1, 1, 2), K, np.array(distortion), P=K).reshape(*light.shape, 2)
    ideal = ((ideal + 0.5) * FINE - 0.5).astype(np.float32)
    seen = cv2.remap(light, ideal[..., 0], ideal[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    frame = replace(exposed(seen), camera=make_camera(K, distortion, "plumb_bob", WIDTH, HEIGHT))
    assert error_m(localizer([7]).process(frame).first, t) < 1e-3


def test_markers_and_pictures_in_one_list() -> None:
    picture = procedural_texture(320, 240, seed=4)
    parameters, R, t = Parameters(), *placed(0.12, 0, 0.8, 20)
    light = scene()
    put(light, marker_cells(FAMILY, 7), 0.1, R, t)
    # The picture lies flat at the left, 0.2 m wide.
    shown = (picture / np.float32(255)) ** 2.2 @ np.float32([0.299, 0.587, 0.114]) * 0.8
    size = round(680 * 0.2 / 0.8) * FINE
    small = cv2.resize(shown, (size, size * 3 // 4), interpolation=cv2.INTER_AREA)
    light[150 * FINE : 150 * FINE + small.shape[0], 60 * FINE : 60 * FINE + small.shape[1]] = small
    images = [
        marker_image("m7", FAMILY, 7, 0.1),
        TargetImage("poster", picture, 0.2),
        marker_image("m8", FAMILY, 8, 0.1),
    ]
    built = prepare_localizer(images, parameters)
    for index in range(3):
        marker, poster, other = built.localizer.process(exposed(light, index, index=index))
        assert marker.status.found and poster.status.found, poster.reason
        assert other.status is Status.LOST
        assert error_m(marker, t) < 1e-3
    assert poster.pose is not None
    assert abs(poster.pose.t[2] - 0.8) < 0.01


def test_hundreds_of_markers_cost_nothing_until_they_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """No features, no templates: 200 are known in less than a second, and one that is seen makes its own alone."""
    from imgu_ros.reference import features, planar

    def refuse(*_: object) -> None:
        raise AssertionError("features of a marker")

    monkeypatch.setattr(planar, "target_features", refuse)
    monkeypatch.setattr(features, "target_features", refuse)
    images = [marker_image(f"m{number}", FAMILY, number, 0.1) for number in range(200)]
    parameters, cache = Parameters(), BuildCache()
    references = prepare_references(images, parameters, cache)
    own = Localizer(parameters, references, cache)
    own.prepare()
    assert not any(reference.templates or reference.light for reference in references)
    light = scene()
    put(light, marker_cells(FAMILY, 42), 0.1, *placed(0, 0, 0.7, 25))
    found = [result.name for result in own.process(exposed(light)) if result.status.found]
    assert found == ["m42"]
    assert sum(bool(reference.templates) or bool(reference.light) for reference in references) == 1


def test_the_same_numbers_again() -> None:
    light = scene()
    put(light, marker_cells(FAMILY, 7), 0.1, *placed(0, 0, 0.7, 25))
    first, second = (localizer([7, 8]).process(exposed(light)).first for _ in range(2))
    assert first.pose is not None and second.pose is not None
    assert first.pose.t.tobytes() == second.pose.t.tobytes()
    assert first.pose.covariance.tobytes() == second.pose.covariance.tobytes()


def test_photographs(data_dir: object) -> None:
    """Of the markers in photographs most are found, and none elsewhere than where OpenCV finds it."""
    from pathlib import Path

    folder = Path(str(data_dir)) / "apriltag" / "rotation"
    if not folder.is_dir():
        pytest.skip("no photographs of markers")
    camera = make_camera(np.array([[329.87, 0, 528.0], [0, 332.95, 396.0], [0, 0, 1]]), [], "plumb_bob", 1056, 792)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    count = 0
    for path in sorted(folder.glob("*.png"))[::3]:
        grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if hasattr(cv2.aruco, "ArucoDetector"):
            corners, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(grey)
        else:
            corners, ids, _ = cv2.aruco.detectMarkers(grey, dictionary)
        number = int(np.ravel(ids)[0])
        frame = Frame(RawImage(grey, PixelLayout(ColorModel.LUMA)), 1, "camera", camera)
        found, other = localizer([number, (number + 1) % 587], 0.065).process(frame)
        assert found.status is Status.DETECTED, (path.name, found.reason)
        assert found.outline is not None
        assert np.abs(found.outline - np.roll(corners[0][0], 2, axis=0)).max() < 2
        assert other.status is Status.LOST
        count += 1
    assert count >= 5


def test_kind_follows_from_the_entry() -> None:
    images = [marker_image("m7", FAMILY, 7, 0.1), TargetImage("poster", procedural_texture(160, 120, seed=1), 0.2)]
    marker, poster = make_references(images, Parameters())
    assert isinstance(marker, MarkerReference)
    assert (marker.kind, poster.kind) == ("marker", "target")
    assert marker.has_template_of(make_references(images, Parameters())[0])
    assert not marker.has_template_of(poster)
