# SPDX-License-Identifier: Apache-2.0
"""What goes into the pipeline."""

from __future__ import annotations

from dataclasses import dataclass

from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.formation.layout import RawImage


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One raw image with the camera that took it.

    Attributes
    ----------
    image : the raw pixels and their layout
    stamp_ns : time of exposure, as the header says, in nanoseconds
    frame_id : the camera's optical frame
    camera : intrinsics; None when the camera is not calibrated, or what camera_info says of it cannot be used
    camera_reason : why there is no camera, for people; empty when there is one, or no camera_info either
    camera_remarks : what people should know of a camera that is used, one line each
    """

    image: RawImage
    stamp_ns: int
    frame_id: str
    camera: Camera | None
    camera_reason: str = ""
    camera_remarks: tuple[str, ...] = ()
