# SPDX-License-Identifier: Apache-2.0
"""Bundles: markers on several planes of a rigid thing, with one pose."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest
from marker_scenes import (
    CAMERA,
    FAMILY,
    HEIGHT,
    WIDTH,
    K,
    error_m,
    exposed,
    nees,
    placed,
    put_sheet,
    scene,
    sheet,
)

from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.localizer import Localizer, prepare_localizer
from imgu_ros.reference.bundle import BundleMarker, BundleReference, bundle_image
from imgu_ros.reference.marker import marker_image
from imgu_ros.reference.marker_layout import PlacedMarker
from imgu_ros.reference_kinds import make_references
from imgu_ros.result import PoseStatus, Status
from imgu_ros.types import Floats, Image
from imgu_ros.vision.camera.euler import from_euler
from imgu_ros.vision.camera.intrinsics import make_camera
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.markers.finding import MarkerFinder

pytestmark = pytest.mark.skipif(not hasattr(cv2, "aruco"), reason="this OpenCV has no aruco module")

SIDE, SIZE = 0.1, 0.08
EXACT = np.zeros((6, 6))


def cube(size: float = SIZE, side: float = SIDE, covariance: Floats = EXACT) -> tuple[BundleMarker, ...]:
    """Return four upright faces, numbered about the y axis, and the top."""
    turns = [from_euler((0.0, math.radians(90 * n), 0.0), "zyx") for n in range(4)]
    turns.append(from_euler((-math.pi / 2, 0.0, 0.0), "zyx"))
    return tuple(
        BundleMarker(PlacedMarker(FAMILY, number, size), Pose(R, R @ (0, 0, side / 2), covariance, 0.0))
        for number, R in enumerate(turns)
    )


def cube_scene(markers: Sequence[BundleMarker], R: Floats, t: Floats, hidden: Sequence[int] = ()) -> Image:
    light = scene()
    for each in markers:
        place = each.place
        R_seen, t_seen = R @ place.R, R @ place.t + t
        if R_seen[:, 2] @ t_seen < 0 and each.marker.number not in hidden:
            put_sheet(light, *sheet([each.marker], margin_m=0.01), R_seen, t_seen)
    return light


def view(yaw_deg: float, pitch_deg: float, z: float, x: float = 0.02, y: float = 0.01) -> tuple[Floats, Floats]:
    """Return camera_from_thing: turned about its upright axis, then seen from above."""
    R = from_euler((0.0, math.radians(yaw_deg), 0.0), "zyx")
    return from_euler((math.pi - math.radians(pitch_deg), 0.0, 0.0), "zyx") @ R, np.array((x, y, z))


def localizer(markers: Sequence[BundleMarker], parameters: Parameters | None = None) -> Localizer:
    p = parameters or Parameters()
    return Localizer(p, make_references([bundle_image("cube", tuple(markers))], p))


def test_a_cube_is_found_by_all_faces_in_view() -> None:
    """More exactly than by its best face alone, whose pose is that of the cube by the same file."""
    squared, own_errors, alone = [], [], []
    for index in range(6):
        R, t = view(35 + 7 * index, -30 - 2 * index, 0.9 + 0.05 * index)
        frame = exposed(cube_scene(cube(), R, t), seed=index)
        found = localizer(cube()).process(frame).first
        assert found.pose_status is PoseStatus.METRIC, found.reason
        assert np.linalg.norm(cv2.Rodrigues(R @ found.pose.R.T)[0]) < 5e-3
        own_errors.append(error_m(found, t))
        squared.append(nees(found, R, t))
        for each in cube():
            single = localizer([each]).process(frame).first
            if single.solutions:
                alone.append(float(np.linalg.norm(single.solutions[0].t - t)))
    assert max(own_errors) < 5e-4
    assert np.median(own_errors) < 0.75 * np.median(alone)
    assert np.median(squared) < 12.59


def test_another_face_tells_which_of_two_poses_is_right() -> None:
    """One face alone, small and seen nearly straight on, is ambiguous, and so reported; with a second one it is not."""
    markers = cube(0.045, 0.056)
    R, t = view(25, -8, 1.3)
    frame = exposed(cube_scene(markers, R, t))
    single = localizer(markers[:1]).process(frame).first
    assert single.status is Status.DETECTED
    assert single.ambiguity is not None
    hidden = exposed(cube_scene(markers, R, t, hidden=[1, 2, 3, 4]))
    alone = localizer(markers).process(hidden).first
    assert alone.ambiguity == pytest.approx(localizer(markers[:1]).process(hidden).first.ambiguity)
    both = localizer(markers).process(frame).first
    assert both.pose_status is PoseStatus.METRIC
    assert both.ambiguity is not None and both.ambiguity < 0.5
    assert np.linalg.norm(cv2.Rodrigues(R @ both.pose.R.T)[0]) < 0.03


def test_one_face_straight_on_is_reported_as_ambiguous() -> None:
    markers = cube(0.035, 0.045)
    R, t = view(1, -1, 1.0)
    found = localizer(markers).process(exposed(cube_scene(markers, R, t))).first
    assert found.pose_status is PoseStatus.AMBIGUOUS
    assert found.pose is None and len(found.solutions) == 2
    assert "two poses fit alike" in found.reason
    assert min(np.linalg.norm(pose.t - t) for pose in found.solutions) < 0.02


def test_it_is_tracked_round_and_faces_come_into_view_without_a_search(monkeypatch: pytest.MonkeyPatch) -> None:
    own = localizer(cube())
    statuses = []
    for index in range(24):
        R, t = view(30 + 6 * index, -25, 0.9)
        found = own.process(exposed(cube_scene(cube(), R, t), index, index=index)).first
        statuses.append(found.status)
        assert error_m(found, t) < 1e-3
        # After the first frame nothing is searched for any more.
        monkeypatch.setattr(MarkerFinder, "find", None)
    assert statuses == [Status.DETECTED, *[Status.TRACKED] * 23]


def test_a_covered_face_does_not_matter() -> None:
    R, t = view(40, -30, 0.9)
    found = localizer(cube()).process(exposed(cube_scene(cube(), R, t, hidden=[0]))).first
    assert error_m(found, t) < 1e-3


def test_no_face_in_view_or_others_than_known() -> None:
    assert localizer(cube()).process(exposed(scene())).first.status is Status.LOST
    R, t = view(40, -30, 0.9)
    others = tuple(replace(each, marker=PlacedMarker(FAMILY, each.marker.number + 20, SIZE)) for each in cube())
    found = localizer(cube()).process(exposed(cube_scene(others, R, t))).first
    assert found.status is Status.LOST
    assert found.reason


def test_uncertain_places_are_in_the_covariance() -> None:
    """Poses with markers that are off by as much as the file says have an honest covariance; else they have not."""
    sigma = np.diag([1e-3] * 3 + [0.01] * 3) ** 2
    told, untold = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        real = tuple(
            replace(
                each,
                place=Pose(
                    cv2.Rodrigues(rng.normal(0, 0.01, 3))[0] @ each.place.R,
                    each.place.t + rng.normal(0, 1e-3, 3),
                    EXACT,
                    0.0,
                ),
            )
            for each in cube()
        )
        R, t = view(*rng.uniform((20, -40), (70, -20)), rng.uniform(0.7, 1.1))
        frame = exposed(cube_scene(real, R, t), seed)
        told.append(nees(localizer(cube(covariance=sigma)).process(frame).first, R, t))
        untold.append(nees(localizer(cube()).process(frame).first, R, t))
    assert np.mean(np.array(told) < 12.59) >= 0.8
    assert np.median(untold) > 3 * np.median(told)


def test_the_calibrations_covariance_is_in_the_poses() -> None:
    """The derivative by a focal length is that of poses with another one."""
    R, t = view(40, -30, 0.8)
    frame = exposed(cube_scene(cube(), R, t))
    covariance = np.zeros((9, 9))
    covariance[0, 0] = 1.0
    known = replace(frame, camera=replace(CAMERA, covariance=covariance + np.eye(9) * 1e-16))
    other = K.copy()
    other[0, 0] += 1
    moved = replace(frame, camera=make_camera(other, [], "plumb_bob", WIDTH, HEIGHT))
    first, second = (localizer(cube()).process(each).first.pose for each in (known, moved))
    assert first is not None and second is not None and first.shared is not None
    change = np.concatenate((second.t - first.t, cv2.Rodrigues(second.R @ first.R.T)[0].ravel()))
    column = first.shared[:, np.argmax(np.linalg.norm(first.shared, axis=0))]
    column = column * np.sign(column @ change)
    assert np.linalg.norm(column - change) < 0.1 * np.linalg.norm(change)


def test_without_a_calibration_it_is_found_and_has_no_pose() -> None:
    R, t = view(40, -30, 0.9)
    found = localizer(cube()).process(replace(exposed(cube_scene(cube(), R, t)), camera=None)).first
    assert found.status is Status.DETECTED
    assert (found.pose_status, found.pose) == (PoseStatus.UNCALIBRATED, None)


def test_bundles_and_markers_in_one_list_and_tracks_of_the_same_continue() -> None:
    R, t = view(40, -30, 0.9, x=-0.1)
    light = cube_scene(cube(), R, t)
    place = placed(0.15, 0.0, 0.9, 20)
    put_sheet(light, *sheet([PlacedMarker(FAMILY, 99, 0.08)]), *place)
    images = [bundle_image("cube", cube()), marker_image("m99", FAMILY, 99, 0.08)]
    built = prepare_localizer(images, Parameters())
    thing, marker = built.localizer.process(exposed(light))
    assert error_m(thing, t) < 1e-3
    assert np.linalg.norm(marker.solutions[0].t - place[1]) < 2e-3
    again = prepare_localizer(images, Parameters(), built)
    again.localizer.continue_from(built.localizer)
    assert [each.status for each in again.localizer.process(exposed(light, 1, index=1))] == [Status.TRACKED] * 2
    (reference, _), (other,) = built.references, make_references([bundle_image("c", cube(side=0.11))], Parameters())
    assert isinstance(reference, BundleReference)
    assert reference.has_template_of(again.references[0]) and not reference.has_template_of(other)


def test_a_neighbour_whose_place_is_known_tells_which_pose_is_right() -> None:
    """`targets.poses` of a bundle is of the thing: its faces have their own places in the map by it."""
    markers = cube(0.035, 0.045)
    R, t = view(1, -1, 1.0, x=-0.1)
    light = cube_scene(markers, R, t)
    R_other, t_other = placed(0.12, 0.02, 0.9, 35)
    put_sheet(light, *sheet([PlacedMarker(FAMILY, 99, 0.1)]), R_other, t_other)
    map_from_thing = RigidTransform(R_other, t_other).inverse().after(RigidTransform(R, t))
    poses = [*map_from_thing.numbers(), 0, 0, 0, 0, 0, 0, 1]
    images = [bundle_image("cube", markers), marker_image("m99", FAMILY, 99, 0.1)]
    found = {}
    for name, values in (("alone", {}), ("in map", {"targets.poses": [float(value) for value in poses]})):
        # Poses of targets are one for each of `targets.images`.
        values = {**values, "targets.images": ["cube.yaml", "tag36h11:99"], "targets.widths_m": [0.0, 0.1]}
        parameters = parameters_from(values)
        own = Localizer(parameters, make_references(images, parameters))
        found[name] = own.process(exposed(light)).first
    assert found["alone"].pose_status is PoseStatus.AMBIGUOUS
    assert found["in map"].pose_status is PoseStatus.METRIC
    assert np.linalg.norm(cv2.Rodrigues(R @ found["in map"].pose.R.T)[0]) < 0.1
