# SPDX-License-Identifier: Apache-2.0
"""The line on a thin lens against numbers worked out by hand."""

from __future__ import annotations

import re

from imgu_ros.simulate.capture import Capture
from imgu_ros.simulate.lens import described_lens
from imgu_ros.vision.camera.intrinsics import Camera, make_camera


def camera(focal_px: float) -> Camera:
    return make_camera([[focal_px, 0, 799.5], [0, focal_px, 599.5], [0, 0, 1]], (), "plumb_bob", 1600, 1200)


def test_a_lens_focused_near() -> None:
    # Image distance 2000 px x 5 um = 10 mm; 1/f = 1/10 mm + 1/500 mm: f = 9.804 mm, aperture 9.804 / 2 = 4.902 mm.
    # A circle of 5 um: 1/d = 1/0.5 -+ 5e-6 / (4.902e-3 x 10e-3) = 2 -+ 0.102 per m.
    # Hyperfocal: f^2 / (N c) + f = 96.12e-6 / 10e-6 + 0.0098 = 9.62 m.
    said = described_lens(Capture(f_number=2.0, focus_m=0.5, pitch_m=5e-6), camera(2000))
    assert said == (
        "lens: 9.8 mm f/2, sensor 8 x 6 mm (4:3); sharp to a pixel from 0.476 to 0.527 m, hyperfocal distance 9.62 m"
    )


def test_a_lens_focused_beyond_its_hyperfocal_distance() -> None:
    said = described_lens(Capture(f_number=8.0, focus_m=5.0, pitch_m=5e-6), camera(1000))
    near = float(re.search(r"sharp to a pixel beyond ([\d.]+) m", said)[1])
    hyperfocal = float(re.search(r"hyperfocal distance ([\d.]+) m", said)[1])
    assert hyperfocal < 5 and 0.5 * hyperfocal < near < hyperfocal


def test_a_lens_that_follows_the_targets() -> None:
    said = described_lens(Capture(f_number=4.0, pitch_m=5e-6), camera(2000))
    # Its focal length when focused far away: 10 mm; 1e-4 / (4 x 5e-6) + 0.01.
    assert said == "lens: 10 mm f/4, sensor 8 x 6 mm (4:3); focused at the targets, hyperfocal distance 5.01 m"
