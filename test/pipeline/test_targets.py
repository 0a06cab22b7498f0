# SPDX-License-Identifier: Apache-2.0
"""Targets: conventions and refusals."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import ShapeError
from imgu_ros.reference.planar import Target, TargetImage, prepare_targets


def test_metric_frame(targets: tuple[Target, ...]) -> None:
    """Origin at the centre, x right, y up; the width is measured from outer edge to outer edge."""
    target = targets[0]
    width, height = target.size
    metres = target.to_metres(target.outline_template)
    h = target.width_m * height / width
    w = target.width_m
    assert_allclose(metres, [[-w / 2, h / 2], [w / 2, h / 2], [w / 2, -h / 2], [-w / 2, -h / 2]], atol=1e-12)


def test_described_at_every_scale(targets: tuple[Target, ...]) -> None:
    octaves = np.unique(targets[0].features.described.keypoints.octave)
    assert len(octaves) >= 8
    assert len(targets[0].features.described.keypoints) == len(targets[0].features.described.descriptors)
    assert all(len(a.corners) > 20 for a in targets[0].octaves(linear=True)[:3])


@pytest.mark.parametrize(
    "pixels",
    [
        np.full((400, 300), 128, np.uint8),
        np.full((400, 300, 3), 128, np.uint8),
        np.random.default_rng(0).integers(0, 255, (20, 20), dtype=np.uint8),
        np.random.default_rng(0).random((300, 300)),
        np.zeros((300, 300, 4), np.uint8),
    ],
)
def test_unusable_pictures_are_refused(pixels: np.ndarray) -> None:
    with pytest.raises(ShapeError, match="target poster"):
        prepare_targets([TargetImage("poster", pixels, 0.1)], Parameters())
