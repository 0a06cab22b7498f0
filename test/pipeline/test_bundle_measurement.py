# SPDX-License-Identifier: Apache-2.0
"""Places of markers on a thing, measured: against exact truth, with honest covariances; and what cannot be measured."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from marker_scenes import CAMERA, FAMILY, exposed, put_sheet, scene, sheet
from scipy.spatial.transform import Rotation

from imgu_ros.bags.messages import make_message
from imgu_ros.bags.writing import BagWriter
from imgu_ros.cli.main import main
from imgu_ros.config.parameters import TargetsParameters
from imgu_ros.errors import TooFewPoints
from imgu_ros.files.target_images import load_target_images
from imgu_ros.messages.camera_info import camera_info_message
from imgu_ros.messages.header import Header
from imgu_ros.messages.image import image_message
from imgu_ros.pose.bundle_measurement import measure_bundle
from imgu_ros.reference.bundle import BundleImage
from imgu_ros.reference.marker_layout import PlacedMarker
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.rigid import RigidTransform

NAMES = ("a", "b", "c", "d")
#: Covariance of a pose: depth and tilt are known less well.
SIGMA = np.diag([1e-4, 1e-4, 5e-4, 3e-3, 3e-3, 5e-4]) ** 2


def places(rng: np.random.Generator) -> dict[str, RigidTransform]:
    """Return four markers on a thing, the first at the origin."""
    found = {"a": RigidTransform(np.eye(3), np.zeros(3))}
    for name in NAMES[1:]:
        found[name] = RigidTransform(Rotation.random(random_state=rng).as_matrix(), rng.uniform(-0.1, 0.1, 3))
    return found


def seen(
    rng: np.random.Generator, thing: dict[str, RigidTransform], groups: Sequence[Sequence[str]], shared: bool = False
) -> list[dict[str, Pose]]:
    """Return noisy poses of the markers of each group in a frame of its own."""
    frames = []
    factor = np.array([[2e-4, 0, 0, 0, 1e-3, 0]]).T
    error = rng.normal() * factor[:, 0]
    for group in groups:
        camera = RigidTransform(Rotation.random(random_state=rng).as_matrix(), np.array([0, 0, rng.uniform(0.5, 1)]))
        poses = {}
        for name in group:
            true = camera.after(thing[name])
            noise = rng.multivariate_normal(np.zeros(6), SIGMA) + (error if shared else 0)
            # R_true = Exp(d) R_seen
            R = Rotation.from_rotvec(noise[3:]).inv().as_matrix() @ true.R
            pose = Pose(R, true.t - noise[:3], SIGMA, 0.1)
            poses[name] = pose.with_shared_error(factor) if shared else pose
        frames.append(poses)
    return frames


def squared_error(true: RigidTransform, place: Pose) -> float:
    turn = Rotation.from_matrix(true.R @ place.R.T).as_rotvec()
    error = np.concatenate((true.t - place.t, turn))
    return float(error @ np.linalg.solve(place.covariance, error))


def test_places_and_their_covariances() -> None:
    squared, away = [], []
    for seed in range(25):
        rng = np.random.default_rng(seed)
        thing = places(rng)
        measured = measure_bundle(seen(rng, thing, [NAMES[:3], NAMES[1:], NAMES] * 4), NAMES)
        assert measured.frames == 12
        assert not measured.markers["a"].place.covariance.any()
        assert 0.6 < measured.markers["b"].rms < 1.4
        for name in NAMES[1:]:
            squared.append(squared_error(thing[name], measured.markers[name].place))
            away.append(np.linalg.norm(thing[name].t - measured.markers[name].place.t))
    # 75 values of six degrees of freedom: mean 6, standard deviation 3.5.
    assert 4.8 < np.mean(squared) < 7.2
    assert 0.88 < np.mean(np.array(squared) < 12.59) <= 1
    assert max(away) < 2e-3


def test_markers_that_are_never_together_with_the_first_are_reached_over_others() -> None:
    rng = np.random.default_rng(1)
    thing = places(rng)
    measured = measure_bundle(seen(rng, thing, [("a", "b"), ("b", "c"), ("c", "d")] * 6), NAMES)
    assert dict(measured.markers["a"].together) == {"b": 6}
    assert dict(measured.markers["c"].together) == {"b": 6, "d": 6}
    assert all(squared_error(thing[name], measured.markers[name].place) < 22.5 for name in NAMES[1:])
    sizes = [np.trace(measured.markers[name].place.covariance[:3, :3]) for name in NAMES[1:]]
    assert sizes[0] < sizes[1] < sizes[2]


def test_poses_of_the_other_solution_are_left_out() -> None:
    rng = np.random.default_rng(2)
    thing = places(rng)
    frames = seen(rng, thing, [NAMES] * 12)
    for index in (1, 5, 8):
        flipped = frames[index]["b"]
        frames[index]["b"] = Pose(Rotation.from_rotvec((0.6, 0, 0)).as_matrix() @ flipped.R, flipped.t, SIGMA, 0.1)
    measured = measure_bundle(frames, NAMES)
    assert [measured.markers[name].left_out for name in NAMES] == [0, 3, 0, 0]
    assert all(squared_error(thing[name], measured.markers[name].place) < 22.5 for name in NAMES[1:])
    assert measured.scale < 1.5


def test_what_all_poses_share_does_not_become_smaller_by_their_number() -> None:
    squared, sizes = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        thing = places(rng)
        measured = measure_bundle(seen(rng, thing, [NAMES] * 30, shared=True), NAMES)
        squared += [squared_error(thing[name], measured.markers[name].place) for name in NAMES[1:]]
        sizes.append(np.trace(measured.markers["b"].place.covariance))
    assert np.mean(np.array(squared) < 12.59) > 0.85


def test_contradictions_make_covariances_larger() -> None:
    rng = np.random.default_rng(4)
    thing = places(rng)
    frames = seen(rng, thing, [NAMES] * 10)
    said = [{name: Pose(p.R, p.t, p.covariance / 9, p.rms_px) for name, p in frame.items()} for frame in frames]
    assert measure_bundle(said, NAMES).scale == pytest.approx(9 * measure_bundle(frames, NAMES).scale, rel=0.5)


@pytest.mark.parametrize(
    ("groups", "words"),
    [
        ([("a", "b")] * 5, "c, d: not connected with a: c is in 0 of 5 frames that show two markers"),
        ([("a", "b"), ("c", "d")] * 5, "c, d: not connected with a: c is in 5 of 10 frames"),
        ([NAMES] * 2, "b, c, d: not connected with a: .*need 3 frames that show it beside a marker"),
        ([("a",), ("b",), ("c",), ("d",)] * 9, "b is in 0 of 0 frames"),
        ([], "not connected"),
    ],
)
def test_too_little_is_seen(groups: Sequence[Sequence[str]], words: str) -> None:
    rng = np.random.default_rng(5)
    with pytest.raises(TooFewPoints, match=words):
        measure_bundle(seen(rng, places(rng), groups), NAMES)


def box(numbers: Sequence[int]) -> dict[int, RigidTransform]:
    """Return markers on three faces of a box that is not quite square."""
    angles = [(0.0, 0.0, 0.0), (3.0, 88.0, 1.0), (-92.0, 2.0, 0.0)]
    found = {}
    for number, each in zip(numbers, angles, strict=True):
        R = Rotation.from_euler("xyz", each, degrees=True).as_matrix()
        found[number] = RigidTransform(R, R @ (0.002 * number, 0.001, 0.05))
    return found


def recorded(path: Path, thing: dict[int, RigidTransform], count: int, calibrated: bool = True) -> None:
    """Write a bag of a thing that is turned before a camera."""
    with BagWriter(path, "mcap") as bag:
        for index in range(count):
            a = 2 * math.pi * index / count
            R = Rotation.from_euler("XY", (180 + 35 + 8 * math.sin(2 * a), -45 + 14 * math.cos(a)), degrees=True)
            camera = RigidTransform(R.as_matrix(), np.array((0.02 * math.sin(a), 0.01, 0.6 + 0.1 * math.cos(a))))
            light = scene()
            for number, place in thing.items():
                at = camera.after(place)
                if at.R[:, 2] @ at.t < 0:
                    put_sheet(light, *sheet([PlacedMarker(FAMILY, number, 0.08)]), at.R, at.t)
            frame = exposed(light, index, index=index)
            header = Header(frame.stamp_ns, "camera")
            if calibrated:
                bag.write("/camera_info", camera_info_message(make_message, header, CAMERA), frame.stamp_ns)
            image = image_message(make_message, header, frame.image.pixels, "bayer_rggb8")
            bag.write("/image_raw", image, frame.stamp_ns)


@pytest.mark.skipif(not hasattr(cv2, "aruco"), reason="this OpenCV has no aruco module")
def test_from_a_recording_to_a_board_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    thing = box((3, 4, 5))
    recorded(tmp_path / "bag", thing, 16)
    out = tmp_path / "box.yaml"
    command = ["make", "tag36h11:3-5", "--measure", str(tmp_path / "bag"), "--width-m", "0.08", "--out", str(out)]
    assert main(command) == 0
    said = capsys.readouterr().out
    assert "tag36h11:3: the origin" in said and "tag36h11:3 and tag36h11:5 16" in said
    assert f"-p targets.images:={out}" in said
    (image,) = load_target_images(TargetsParameters(images=(str(out),)))
    assert isinstance(image, BundleImage)
    origin = thing[3].inverse()
    for each in image.markers:
        true = origin.after(thing[each.marker.number])
        assert each.marker.size == 0.08
        assert np.linalg.norm(true.t - each.place.t) < 2e-4
        assert np.linalg.norm(Rotation.from_matrix(true.R @ each.place.R.T).as_rotvec()) < 2e-3
        if each.marker.number != 3:
            assert squared_error(true, each.place) < 30  # of scenes that are drawn to hundredths of a px
            assert np.sqrt(np.trace(each.place.covariance[:3, :3])) < 2e-4


@pytest.mark.skipif(not hasattr(cv2, "aruco"), reason="this OpenCV has no aruco module")
def test_what_cannot_be_measured_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = tmp_path / "bag"
    recorded(bag, box((3, 4, 5)), 6)
    out = tmp_path / "box.yaml"

    def error(*arguments: str) -> str:
        assert main(["make", *arguments, "--out", str(out)]) == 1
        assert not out.exists()
        return capsys.readouterr().err

    measure = ("--measure", str(bag), "--width-m", "0.08")
    assert "tag36h11:9: not connected with tag36h11:3: tag36h11:9 is in 0 of" in error("tag36h11:3,4,9", *measure)
    assert "0 of 6 frames show two markers" in error("tag36h11:10,11", *measure)
    assert "need 2 to 100 different ids" in error("tag36h11:3", *measure)
    assert "need 2 to 100 different ids" in error("tag36h11:3,3", *measure)
    assert "tag36h11:x: no markers; need family and ids" in error("tag36h11:x", *measure)
    assert "no such id; need 0 to 586" in error("tag36h11:580-590", *measure)
    assert "--width-m: need the width of the markers" in error("tag36h11:3,4", "--measure", str(bag))
    assert "--seed: of a print" in error("tag36h11:3,4", *measure, "--seed", "3")
    assert "missing" in error("tag36h11:3,4", "--measure", str(tmp_path / "missing"), "--width-m", "0.08")
    recorded(tmp_path / "blind", box((3, 4, 5)), 3, calibrated=False)
    assert "no frame has a calibration" in error(
        "tag36h11:3-5", "--measure", str(tmp_path / "blind"), "--width-m", "0.08"
    )


@pytest.mark.skipif(not hasattr(cv2, "aruco"), reason="this OpenCV has no aruco module")
def test_a_print_uses_no_camera(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "print.pdf")
    assert main(["make", "tag36h11:3", "--width-m", "0.1", "--out", out, "-p", "camera.info_file:=x"]) == 1
    assert "camera.info_file: not used by this command" in capsys.readouterr().err
