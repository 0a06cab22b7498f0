# SPDX-License-Identifier: Apache-2.0
"""Sequences without a bag, and the textures that they show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imgu_ros.errors import ParameterError, ShapeError
from imgu_ros.reference.templates import TargetImage
from imgu_ros.simulate.sequence import Simulation, default_camera, default_targets, simulate_sequence
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout
from imgu_ros.vision.formation.sensor import Sensor

SMALL = Simulation(width=320, height=180, frames=4, seed=5)
TARGETS = tuple(TargetImage(f"t{i}", procedural_texture(160, 120, i), 0.4) for i in range(3))


def test_same_seed_gives_the_same_frames() -> None:
    first, again = (list(simulate_sequence(SMALL, TARGETS[:1])) for _ in range(2))
    other = list(simulate_sequence(replace(SMALL, seed=6), TARGETS[:1]))
    assert len(first) == 4
    for a, b, c in zip(first, again, other, strict=True):
        np.testing.assert_array_equal(a.frame.image.pixels, b.frame.image.pixels)
        np.testing.assert_array_equal(a.truths[0].H, b.truths[0].H)
        assert (a.frame.image.pixels != c.frame.image.pixels).mean() > 0.5


def test_frames_are_what_was_asked_for() -> None:
    layout = PixelLayout(ColorModel.BAYER, BayerPattern.GBRG)
    simulation = replace(SMALL, layout=layout, sensor=Sensor(12), rate_hz=10, start_ns=7, frame_id="cam")
    frames = list(simulate_sequence(simulation, TARGETS))
    assert [f.frame.stamp_ns for f in frames] == [7, 100_000_007, 200_000_007, 300_000_007]
    for simulated in frames:
        frame = simulated.frame
        assert frame.frame_id == "cam"
        assert frame.image.layout == layout
        assert frame.image.pixels.shape == (180, 320)
        assert frame.image.pixels.dtype == np.uint16
        assert 255 < frame.image.pixels.max() < 4096
        assert not frame.image.pixels.flags.writeable
        assert frame.camera is not None
        assert [t.target for t in simulated.truths] == ["t0", "t1", "t2"]
        assert all(t.stamp_ns == frame.stamp_ns for t in simulated.truths)


def test_truth_agrees_with_its_own_pose() -> None:
    # H against the pinhole projection of the target's four outer corners, written out.
    for simulated in simulate_sequence(replace(SMALL, sensor=None), TARGETS):
        camera = simulated.frame.camera
        assert camera is not None
        for truth, target in zip(simulated.truths, TARGETS, strict=True):
            assert truth.pose is not None
            corners = np.array([[-0.5, -0.5, 1], [159.5, -0.5, 1], [159.5, 119.5, 1], [-0.5, 119.5, 1]])
            half_w, half_h = target.width_m / 2, target.width_m / 2 * 120 / 160
            metric = np.array([[-half_w, half_h, 0], [half_w, half_h, 0], [half_w, -half_h, 0], [-half_w, -half_h, 0]])
            by_H = corners @ truth.H.T
            np.testing.assert_allclose(
                by_H[:, :2] / by_H[:, 2:], camera.project(metric @ truth.pose.R.T + truth.pose.t), atol=1e-9
            )
            assert np.linalg.norm(truth.H) == pytest.approx(1)
            assert (truth.H @ [79.5, 59.5, 1])[2] > 0
            # Seen from the front: the normal points to the camera.
            assert truth.pose.R[:, 2] @ truth.pose.t < 0


def test_noise_of_one_frame_does_not_depend_on_the_others() -> None:
    long = list(simulate_sequence(replace(SMALL, frames=9), TARGETS[:1]))
    short = list(simulate_sequence(replace(SMALL, frames=3), TARGETS[:1]))
    # Frame 0 is the same view in both.
    np.testing.assert_array_equal(long[0].frame.image.pixels, short[0].frame.image.pixels)


def test_threads_change_nothing() -> None:
    alone, together = (list(simulate_sequence(SMALL, TARGETS, workers=n)) for n in (1, 3))
    assert len(together) == 4
    for a, b in zip(alone, together, strict=True):
        assert a.frame.stamp_ns == b.frame.stamp_ns
        np.testing.assert_array_equal(a.frame.image.pixels, b.frame.image.pixels)
    abandoned = simulate_sequence(replace(SMALL, frames=1000), TARGETS, workers=2)
    next(abandoned)
    abandoned.close()  # type: ignore[attr-defined]
    with pytest.raises(ShapeError, match="width"):
        next(simulate_sequence(SMALL, [replace(TARGETS[0], width_m=0.0)], workers=2))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 321}, "even"),
        ({"width": 8}, "size: 8x180"),
        ({"frames": 0}, "frames: 0"),
        ({"rate_hz": 0.0}, "rate: 0 Hz"),
        ({"rate_hz": float("nan")}, "rate"),
        ({"camera": default_camera(640, 480)}, "camera: 640x480; need the image size, 320x180"),
    ],
)
def test_impossible_simulations_are_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        next(simulate_sequence(replace(SMALL, **change), TARGETS[:1]))  # type: ignore[arg-type]


def test_texture_has_detail_at_every_scale_and_in_every_color() -> None:
    texture = procedural_texture(seed=3)
    assert texture.shape == (960, 1280, 3)
    assert texture.dtype == np.uint8
    light = texture.astype(float)
    # Contrast that is lost from one octave to the next, from single pixels to sixty-fourths of the width.
    for _ in range(7):
        half = light.reshape(light.shape[0] // 2, 2, light.shape[1] // 2, 2, 3).mean(axis=(1, 3))
        lost = light - np.kron(half, np.ones((2, 2, 1)))
        assert (lost.std(axis=(0, 1)) > 5).all()
        light = half[: half.shape[0] // 2 * 2]
    spread = texture.astype(float).std(axis=2)
    assert spread.mean() > 15


def test_texture_follows_its_seed() -> None:
    np.testing.assert_array_equal(procedural_texture(64, 48, 1), procedural_texture(64, 48, 1))
    assert (procedural_texture(64, 48, 1) != procedural_texture(64, 48, 2)).mean() > 0.9
    assert [t.name for t in default_targets(2, 0)] == ["poster", "poster_2"]
    with pytest.raises(ShapeError, match="texture size"):
        procedural_texture(8, 100)
