# SPDX-License-Identifier: Apache-2.0
"""A frame's result -> visualization_msgs/MarkerArray: each target with a pose, and how sure its place is."""

from __future__ import annotations

from typing import Any

import numpy as np

from imgu_ros.messages.annotations import STATUS_COLORS
from imgu_ros.messages.factory import MessageFactory
from imgu_ros.messages.geometry import pose_of, vector
from imgu_ros.messages.header import Header, header_message
from imgu_ros.result import ReferenceResult, Result
from imgu_ros.shown_text import NAME_CHARACTERS, shown
from imgu_ros.types import Floats
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.pose import Pose

# Values of Marker.type and Marker.action.
_SPHERE, _LINE_STRIP, _TEXT = 2, 4, 9
_ADD, _DELETE_ALL = 0, 3
#: Half axes of the ellipsoid in which the true place lies with 95 %, in standard deviations.
_SIGMAS_95 = 7.8147**0.5  # chi-squared of 3 degrees of freedom
#: The outline's sides may differ from the known width by this share: else it is of another plane than the pose's, as
#: on a bundle of markers, where it is that of one marker.
_OTHER_PLANE = 0.05
#: Of the width: thickness of the outline, height of the letters.
_LINE, _LETTER = 0.01, 0.1
#: Size of letters where the width is not known, m.
_USUAL_LETTER_M = 0.02


def markers_message(make: MessageFactory, header: Header, result: Result) -> Any:
    """Return a visualization_msgs/MarkerArray in the camera's frame that replaces the one before.

    For each target with a pose, in the name space of its name: its outline (0), its name (1), and the ellipsoid in
    which its origin lies with 95 % (2).
    """
    markers = [_marker(make, header, "", 0, _LINE_STRIP, action=_DELETE_ALL)]
    for found in result:
        if found.pose is not None:
            markers += _target_markers(make, header, found, found.pose, result.frame.camera)
    return make("visualization_msgs/msg/MarkerArray", markers=markers)


def _target_markers(
    make: MessageFactory, header: Header, found: ReferenceResult, pose: Pose, camera: Camera | None
) -> list[Any]:
    color = _color(make, STATUS_COLORS[found.status])
    width_m = found.width_m
    made = []
    corners = _corners(found, pose, camera)
    if corners is not None:
        points = [
            make("geometry_msgs/msg/Point", x=x, y=y, z=z) for x, y, z in [*corners.tolist(), corners[0].tolist()]
        ]
        thickness = vector(make, np.array((_LINE * width_m, 0.0, 0.0)))
        made.append(_marker(make, header, found.name, 0, _LINE_STRIP, points=points, scale=thickness, color=color))
    made.append(
        _marker(
            make, header, found.name, 1, _TEXT, color=color, text=shown(found.name, NAME_CHARACTERS),
            pose=pose_of(make, np.eye(3), pose.t),
            scale=vector(make, np.array((0.0, 0.0, _LETTER * width_m or _USUAL_LETTER_M))),
        )
    )  # fmt: skip
    variances, axes = np.linalg.eigh(pose.covariance[:3, :3])
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    made.append(
        _marker(
            make, header, found.name, 2, _SPHERE, color=_color(make, STATUS_COLORS[found.status], 0.4),
            pose=pose_of(make, axes, pose.t),
            scale=vector(make, 2 * _SIGMAS_95 * np.sqrt(np.maximum(variances, 0.0))),
        )
    )  # fmt: skip
    return made


def _corners(found: ReferenceResult, pose: Pose, camera: Camera | None) -> Floats | None:
    """Return where the outline's corners are in the camera's frame, (4, 3) m: their rays meet the target's plane."""
    if camera is None or found.outline is None or not found.width_m:
        return None
    normalized, is_valid = camera.undistort(found.outline)
    rays = np.column_stack((normalized, np.ones(len(normalized))))
    normal = pose.R[:, 2]
    if not is_valid.all() or (np.sign(rays @ normal) != np.sign(pose.t @ normal)).any():
        return None
    corners: Floats = rays * ((pose.t @ normal) / (rays @ normal))[:, None]
    width_m = float(np.linalg.norm(corners[1] - corners[0]))
    return corners if abs(width_m / found.width_m - 1) < _OTHER_PLANE else None


def _marker(
    make: MessageFactory, header: Header, name_space: str, number: int, kind: int, action: int = _ADD, **fields: object
) -> Any:
    return make(
        "visualization_msgs/msg/Marker",
        header=header_message(make, header), ns=name_space, id=number, type=kind, action=action, **fields,
    )  # fmt: skip


def _color(make: MessageFactory, rgb: tuple[int, int, int], alpha: float = 1.0) -> Any:
    r, g, b = (channel / 255 for channel in rgb)
    return make("std_msgs/msg/ColorRGBA", r=r, g=g, b=b, a=alpha)
