# SPDX-License-Identifier: Apache-2.0
"""What a simulated thin lens is: its focal length, its sensor, and between which depths it is sharp."""

from __future__ import annotations

import math

from imgu_ros.simulate.capture import Capture, thin_lens
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.formation.optics import DepthOfField, ThinLens, depth_of_field, hyperfocal_distance
from imgu_ros.vision.formation.pixel_array import PixelArray


def described_lens(capture: Capture, camera: Camera) -> str:
    """Return a line for people on the lens of a capture with an f-number; sharp is what blurs over a pixel at most."""
    array = PixelArray(camera.width, camera.height, capture.pitch_m)
    lens = thin_lens(capture, camera, math.inf if capture.focus_m is None else capture.focus_m)
    across, up = array.aspect
    sensor = f"{1e3 * array.width_m:.3g} x {1e3 * array.height_m:.3g} mm ({across}:{up})"
    return f"lens: {1e3 * lens.focal_length_m:.3g} mm f/{lens.f_number:g}, sensor {sensor}; {_sharp(capture, lens)}"


def _sharp(capture: Capture, lens: ThinLens) -> str:
    hyperfocal = hyperfocal_distance(lens.focal_length_m, lens.f_number, capture.pitch_m)
    words = f"hyperfocal distance {hyperfocal:.3g} m"
    if capture.focus_m is None:
        return f"focused at the targets, {words}"
    return f"sharp to a pixel {_between(depth_of_field(lens, capture.pitch_m))}, {words}"


def _between(field: DepthOfField) -> str:
    if math.isinf(field.far_m):
        return f"beyond {field.near_m:.3g} m"
    return f"from {field.near_m:.3g} to {field.far_m:.3g} m"
