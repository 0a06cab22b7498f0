# SPDX-License-Identifier: Apache-2.0
"""Status of each target -> diagnostic_msgs/DiagnosticArray."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from imgu_ros.messages.factory import MessageFactory
from imgu_ros.messages.header import Header, header_message
from imgu_ros.result import PoseStatus, ReferenceResult, Result, Stage, Status
from imgu_ros.shown_text import shown

#: Characters of an encoding's name that are shown.
_SHOWN = 60
#: diagnostic_msgs/DiagnosticStatus.level
OK, WARN, ERROR = 0, 1, 2

_LEVELS = {
    Status.TRACKED: OK,
    Status.DETECTED: OK,
    Status.LOST: WARN,
    Status.DEGENERATE: WARN,
    Status.REJECTED: ERROR,
}
#: A missing width is the user's choice; a missing calibration or an ambiguous pose is a warning.
_POSE_LEVELS = {PoseStatus.AMBIGUOUS: WARN, PoseStatus.UNCALIBRATED: WARN}


def status_message(make: MessageFactory, header: Header, result: Result) -> Any:
    """Return a diagnostic_msgs/DiagnosticArray with one entry for each target.

    An entry's name is the target's, its hardware_id the camera's frame, its values are named as the columns of
    frames.csv; what is unknown is left out.
    """
    return make(
        "diagnostic_msgs/msg/DiagnosticArray",
        header=header_message(make, header),
        status=[_entry(make, header, result, target) for target in result],
    )


def held_up_message(make: MessageFactory, header: Header, names: Sequence[str], text: str) -> Any:
    """Return a diagnostic_msgs/DiagnosticArray with the status `held_up` of each target: this frame takes long."""
    entries = [
        make(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=WARN,
            name=name,
            message=text,
            hardware_id=header.frame_id,
            values=[make("diagnostic_msgs/msg/KeyValue", key="status", value="held_up")],
        )
        for name in names
    ]
    return make("diagnostic_msgs/msg/DiagnosticArray", header=header_message(make, header), status=entries)


def image_words(message: Any) -> str:
    """Return size and encoding of an image message, `1920 x 1080 bayer_rggb8`, or its format; empty for others."""
    if hasattr(message, "encoding"):
        return f"{message.width} x {message.height} {shown(str(message.encoding), _SHOWN)}"
    return shown(str(message.format), _SHOWN) if hasattr(message, "format") else ""


def _entry(make: MessageFactory, header: Header, result: Result, target: ReferenceResult) -> Any:
    level = max(_LEVELS[target.status], _POSE_LEVELS.get(target.pose_status, OK))
    reason = target.reason or result.reason
    words = ", ".join(word.value for word in (target.status, target.pose_status) if word.value)
    values = _values(result, target)
    return make(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=level,
        name=target.name,
        message=shown(f"{words}: {reason}" if reason else words),
        hardware_id=header.frame_id,
        values=[make("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in values.items()],
    )


def _values(result: Result, target: ReferenceResult) -> dict[str, str]:
    values = {"status": target.status.value}
    if target.pose_status is not PoseStatus.NONE:
        values["pose_status"] = target.pose_status.value
    if result.keypoints is not None:
        values["n_keypoints"] = str(len(result.keypoints))
    if target.matches is not None:
        values["n_matches"] = str(len(target.matches.matches))
    if target.homography is not None:
        values["n_inliers"] = str(np.count_nonzero(target.homography.inliers))
        values["rms_px"] = repr(float(target.homography.rms_px))
    if target.confirmed_share is not None:
        values["confirmed_share"] = repr(float(target.confirmed_share))
    if target.ambiguity is not None:
        values["ambiguity"] = repr(float(target.ambiguity))
    if target.calibration is not None:
        values["calibration_chi_squared"] = repr(target.calibration.chi_squared)
    if result.total_ns:
        values["t_total_ms"] = repr(result.total_ns / 1e6)
    times = result.times_ns or {}
    values.update({f"t_{stage.value}_ms": repr(times[stage] / 1e6) for stage in Stage if stage in times})
    return values
