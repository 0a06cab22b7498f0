# SPDX-License-Identifier: Apache-2.0
"""All ids of a family as one entry: those that are seen become references, and only these cost anything."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
import pytest
from marker_scenes import error_m, exposed, placed, put, put_sheet, scene, sheet

from imgu_ros.config.parameters import TargetsParameters
from imgu_ros.config.values import parameters_from
from imgu_ros.files.target_images import load_target_images
from imgu_ros.frame import Frame
from imgu_ros.localizer import Localizer
from imgu_ros.reference import family
from imgu_ros.reference.marker_layout import PlacedMarker
from imgu_ros.reference_kinds import make_references
from imgu_ros.result import Status
from imgu_ros.types import Floats
from imgu_ros.vision.markers import marker_cells

pytestmark = pytest.mark.skipif(not hasattr(cv2, "aruco"), reason="this OpenCV has no aruco module")
#: Where a marker is, by its name.
PLACES = {"tag36h11_4": -0.2, "tag36h11_586": 0.0, "aruco_5x5_100_12": 0.2}


def localizer(*entries: str, **values: object) -> Localizer:
    parameters = parameters_from(values)
    targets = TargetsParameters(images=entries, widths_m=(0.1,) * len(entries))
    return Localizer(parameters, make_references(load_target_images(targets), parameters))


def seen(index: int, *names: str) -> tuple[Frame, Mapping[str, Floats]]:
    """Return a frame of markers, and where each is, m."""
    light, truth = scene(), {}
    for name in names:
        R, truth[name] = placed(PLACES[name], -0.03 + 0.005 * index, 0.8, 35 + index)
        kind, _, number = name.rpartition("_")
        put(light, marker_cells(kind, int(number)), 0.1, R, truth[name])
    return exposed(light, seed=index, index=index), truth


def test_ids_become_references_when_they_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 586 and 100 ids known, three are seen; the same numbers come out as with an entry for each."""
    own = localizer("tag36h11:4", "tag36h11:*", "aruco_5x5_100:*")
    listed = localizer("tag36h11:4", "tag36h11:586", "aruco_5x5_100:12")
    made = []
    marker_image = family.marker_image
    monkeypatch.setattr(family, "marker_image", lambda name, *rest: made.append(name) or marker_image(name, *rest))
    names: list[list[str]] = []
    for index in range(8):
        shown = [*PLACES] if index >= 3 else ["tag36h11_4"]
        frame, truth = seen(index, *shown)
        result, expected = own.process(frame), listed.process(frame)
        names.append([*result.references])
        for name in shown:
            found = result.references.get(name)
            if found is None or found.status is Status.LOST:
                continue  # it is looked for now and then only
            assert error_m(found, truth[name]) < 1e-3
            if index >= 3 and expected.references[name].status == found.status:
                pose = expected.references[name].pose
                np.testing.assert_array_equal(found.pose.transform.matrix, pose.transform.matrix)
                np.testing.assert_array_equal(found.pose.covariance, pose.covariance)
    assert names[0] == ["tag36h11_4", "tag36h11", "aruco_5x5_100"]
    assert names[-1] == ["tag36h11_4", "tag36h11_586", "aruco_5x5_100_12"]
    last = own.process(seen(8, *PLACES)[0])
    assert [found.status for found in last] == [Status.TRACKED] * 3
    # Numbers in messages: after the entries, each family's ids in turn.
    assert [found.number for found in last] == [0, 3 + 586, 3 + 587 + 12]
    assert set(made) == {"tag36h11_586", "aruco_5x5_100_12"}
    own.reset()
    assert [found.name for found in own.process(seen(9)[0])] == ["tag36h11_4", "tag36h11", "aruco_5x5_100"]


def test_what_was_seen_stays_and_is_lost_or_found_again() -> None:
    own = localizer("tag36h11:*")
    assert own.process(seen(0, "tag36h11_4")[0]).first.status is Status.DETECTED
    gone = own.process(seen(1)[0])
    assert [(found.name, found.status) for found in gone] == [("tag36h11_4", Status.LOST)]
    assert own.process(seen(2, "tag36h11_4")[0]).first.status is Status.DETECTED
    other = localizer("tag36h11:*", seed=7)
    other.continue_from(own)
    assert other.process(seen(3, "tag36h11_4")[0]).first.status is Status.TRACKED


def test_members_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(family, "MOST_MEMBERS", 1)
    own = localizer("tag36h11:*")
    own.process(seen(0, "tag36h11_4")[0])
    assert [found.name for found in own.process(seen(1, "tag36h11_586")[0])] == ["tag36h11_586"]
    both = own.process(seen(2, "tag36h11_4", "tag36h11_586")[0])
    assert len(both.references) == 1 and both.first.status.found


def test_a_frame_costs_what_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """No code of an id that was not seen is looked at, whatever the family's size."""
    looked_at = []
    has = family.FamilyImage.has
    monkeypatch.setattr(family.FamilyImage, "has", lambda self, marker: looked_at.append(marker) or has(self, marker))
    own = localizer("tag36h11:*")
    for index in range(12):
        own.process(seen(index, "tag36h11_4")[0])
    assert set(looked_at) == {4} and len(looked_at) <= 4


def test_a_marker_that_cannot_be_told_from_others_is_none() -> None:
    (image,) = load_target_images(TargetsParameters(images=("aruco_original:*",)))
    assert isinstance(image, family.FamilyImage)
    assert image.has(5) and not image.has(1023)


def test_while_many_are_tracked_one_more_is_found_at_once() -> None:
    """Fewer wait for the next search."""
    own, few = localizer("tag36h11:*"), localizer("tag36h11:*")
    statuses = []
    for index in range(2):
        for each, known in ((own, 13), (few, 5)):
            ids = range(known + index)
            markers = [PlacedMarker("tag36h11", i, 0.05, 0.075 * (i % 5 - 2), 0.075 * (1 - i // 5)) for i in ids]
            R, t = placed(0.0, 0.002 * index, 0.7, 25, 5)
            light = scene()
            put_sheet(light, *sheet(markers), R, t)
            found = each.process(exposed(light, seed=index, index=index))
            statuses.append(sum(one.status.found for one in found))
    assert statuses == [13, 5, 14, 5]
