# SPDX-License-Identifier: Apache-2.0
"""A frame's result -> what viewers draw over its image: foxglove_msgs/ImageAnnotations."""

from __future__ import annotations

from typing import Any

import numpy as np

from imgu_ros.messages.factory import MessageFactory
from imgu_ros.messages.header import Header, header_message
from imgu_ros.result import PoseStatus, ReferenceResult, Result, Status
from imgu_ros.shown_text import NAME_CHARACTERS, shown
from imgu_ros.types import Points

#: RGB; told apart by people with any colour vision (Okabe & Ito 2008).
STATUS_COLORS = {
    Status.TRACKED: (86, 180, 233),
    Status.DETECTED: (0, 200, 130),
    Status.LOST: (230, 159, 0),
    Status.DEGENERATE: (204, 121, 167),
    Status.REJECTED: (213, 94, 0),
}
#: Of what agrees with a find.
INLIER_COLOR = (255, 230, 60)

# Values of PointsAnnotation.type.
_POINTS, _LINE_LOOP = 1, 2
#: Thickness of a line, and height of a letter, in parts of the outline's diagonal, with bounds in px.
_LINE, _LINE_PX = 1 / 200, (1.5, 6.0)
_LETTER, _LETTER_PX = 1 / 12, (12.0, 60.0)


def annotations_message(make: MessageFactory, header: Header, result: Result) -> Any:
    """Return a foxglove_msgs/ImageAnnotations: outline, inliers and label of each target that was found.

    Positions are raw px as in `outline`: (0, 0) is the centre of the top left pixel.
    """
    points, texts = [], []
    stamp = header_message(make, header).stamp
    for found in result:
        if found.outline is None:
            continue
        color = STATUS_COLORS[found.status]
        diagonal = float(np.linalg.norm(np.ptp(found.outline, axis=0)))
        thickness = float(np.clip(_LINE * diagonal, *_LINE_PX))
        if found.matches is not None:
            inliers = found.matches.image_xy[found.matches.inliers]
            points.append(_points(make, stamp, _POINTS, inliers, INLIER_COLOR, 2 * thickness))
        points.append(_points(make, stamp, _LINE_LOOP, found.outline, color, thickness))
        x, y = found.outline[0]
        texts.append(
            make(
                "foxglove_msgs/msg/TextAnnotation",
                timestamp=stamp,
                position=make("foxglove_msgs/msg/Point2", x=float(x), y=float(y)),
                text=label(found),
                font_size=float(np.clip(_LETTER * diagonal, *_LETTER_PX)),
                text_color=_color(make, color),
                background_color=_color(make, (0, 0, 0), 0.6),
            )
        )
    message = make("foxglove_msgs/msg/ImageAnnotations", circles=[], points=points, texts=texts)
    if hasattr(message, "timestamp"):  # in packages since 2026, where it counts more than those of the parts
        message.timestamp = stamp
    return message


def decode_inliers(message: Any) -> Points:
    """Read a message of `annotations_message`: the inliers of all targets, (N, 2) raw px."""
    parts = [part.points for part in message.points if part.type == _POINTS]
    return np.array([(point.x, point.y) for points in parts for point in points], np.float64).reshape(-1, 2)


def label(found: ReferenceResult) -> str:
    """Return a target's name with its distance, or with what became of its pose."""
    name = shown(found.name, NAME_CHARACTERS)
    if found.pose is not None:
        return f"{name} {float((found.pose.t @ found.pose.t) ** 0.5):.3g} m"
    return f"{name} {found.pose_status}" if found.pose_status is not PoseStatus.NONE else name


def _points(
    make: MessageFactory, stamp: Any, kind: int, xy: Points, color: tuple[int, int, int], thickness: float
) -> Any:
    return make(
        "foxglove_msgs/msg/PointsAnnotation",
        timestamp=stamp,
        type=kind,
        points=[make("foxglove_msgs/msg/Point2", x=x, y=y) for x, y in xy.tolist()],
        outline_color=_color(make, color),
        fill_color=_color(make, color, 0.0),
        thickness=thickness,
    )


def _color(make: MessageFactory, rgb: tuple[int, int, int], alpha: float = 1.0) -> Any:
    r, g, b = (channel / 255 for channel in rgb)
    return make("foxglove_msgs/msg/Color", r=r, g=g, b=b, a=alpha)
