# SPDX-License-Identifier: Apache-2.0
"""Targets: conventions and refusals."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import ShapeError
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references


def test_metric_frame(targets: tuple[Reference, ...]) -> None:
    """Origin at the centre, x right, y up; the width is measured from outer edge to outer edge."""
    target = targets[0]
    width, height = target.size
    metres = target.plane.to_metres(target.outline_template)
    h = target.width_m * height / width
    w = target.width_m
    assert_allclose(metres, [[-w / 2, h / 2], [w / 2, h / 2], [w / 2, -h / 2], [-w / 2, -h / 2]], atol=1e-12)


def test_described_at_every_scale(targets: tuple[Reference, ...]) -> None:
    octaves = np.unique(targets[0].features.described.keypoints.octave)
    assert len(octaves) >= 8
    assert len(targets[0].features.described.keypoints) == len(targets[0].features.described.descriptors)
    assert all(len(a.corners) > 20 for a in targets[0].templates[True][:3])


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
        prepare_references([TargetImage("poster", pixels, 0.1)], Parameters())
