# SPDX-License-Identifier: Apache-2.0
"""The worked example "a learned descriptor" of CONTRIBUTING.md: it holds weights, detects and describes, in batches.

Its weights, drawn by a seed, stand for learned ones: kernels that tell keypoints, and a layer that describes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from imgu_ros.config.parameters import declaration
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import ParameterError
from imgu_ros.localizer import Localizer
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.result import Status
from imgu_ros.simulate.sequence import SimulatedFrame
from imgu_ros.simulate.truth import corner_error
from imgu_ros.types import Image, Points
from imgu_ros.vision.descriptors import Descriptions, sample_patches
from imgu_ros.vision.keypoints import Keypoints, centroid_orientation, level_shares, spread
from imgu_ros.vision.methods import DESCRIPTORS, DescriptorMethod, register_descriptor
from imgu_ros.vision.scale_space.pyramid import Pyramid

KERNELS, SIDE = 8, 9
ROWS, PATCH = 64, 13
BORDER = 16


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """What training would give: kernels that tell keypoints, (K, side, side), and rows that describe them, (D, P)."""

    kernels: NDArray[np.float32]
    rows: NDArray[np.float32]


def learned_weights() -> Weights:
    """Return smooth random kernels without mean, of unit norm, and random orthonormal rows."""
    rng = np.random.default_rng(7)
    kernels = np.stack([cv2.GaussianBlur(rng.normal(size=(SIDE, SIDE)), (0, 0), 1.5) for _ in range(KERNELS)])
    kernels -= kernels.mean(axis=(1, 2), keepdims=True)
    rows = np.linalg.qr(rng.normal(size=(PATCH**2, ROWS)))[0].T
    return Weights((kernels / np.linalg.norm(kernels, axis=(1, 2), keepdims=True)).astype("f4"), rows.astype("f4"))


@dataclass(frozen=True, slots=True)
class LayerParameters:
    """`step_px`: between the samples of a patch, px of the level."""

    step_px: float = 2.0


class Layer:
    """A feature extractor that holds its weights; it counts how often it was made."""

    made = 0

    def __init__(self, parameters: LayerParameters) -> None:
        Layer.made += 1
        self.step_px = parameters.step_px
        self.weights = learned_weights()

    def extract(self, pyramid: Pyramid, max_count: int, even_scales: bool = False) -> Descriptions:
        """See `FeatureExtractor.extract`."""
        shares = level_shares(pyramid, max_count, even_scales)
        keypoints, patches = [], []
        for index, (level, share) in enumerate(zip(pyramid.levels, shares.tolist(), strict=True)):
            smooth = cv2.GaussianBlur(level.image, (0, 0), 1.0)
            xy, response = self._peaks(smooth, share)
            count, angle = len(xy), centroid_orientation(level.image, xy)
            octave = np.full(count, index, np.int32)
            keypoints.append(Keypoints(level.to_full(xy), np.full(count, 2 * level.scale), angle, response, octave))
            patches.append(sample_patches(smooth, xy, np.full(count, self.step_px), angle, PATCH).reshape(count, -1))
        joined = (np.concatenate([getattr(k, name) for k in keypoints]) for name in Keypoints.__dataclass_fields__)
        return Descriptions(Keypoints(*joined), self._described(np.concatenate(patches)))

    def _peaks(self, image: Image, count: int) -> tuple[Points, NDArray[np.float64]]:
        """Return where the activations of all kernels together are strongest, and how strong they are."""
        active = [cv2.filter2D(image, cv2.CV_32F, kernel) for kernel in self.weights.kernels]
        strength = np.sqrt(np.square(active).sum(axis=0))
        is_peak = strength >= cv2.dilate(strength, np.ones((5, 5), np.uint8))
        is_peak[:BORDER] = is_peak[-BORDER:] = is_peak[:, :BORDER] = is_peak[:, -BORDER:] = False
        rows, columns = np.nonzero(is_peak)
        xy, response = np.column_stack((columns, rows)).astype(np.float64), strength[rows, columns].astype(np.float64)
        kept = spread(xy, response, image.shape[::-1], count) if count else np.zeros(0, np.intp)
        return xy[kept], response[kept]

    def _described(self, patches: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the descriptors of the patches of all levels, in one batch: (N, D)."""
        patches = patches - patches.mean(axis=1, keepdims=True)
        activations = patches @ self.weights.rows.T
        return activations / (np.linalg.norm(activations, axis=1, keepdims=True) + 1)


LAYER = DescriptorMethod(
    name="layer",
    make=Layer,
    parameters=LayerParameters,
    columns=ROWS,
    is_binary=False,
    metrics=("euclidean", "cosine"),
    nature="is the output of a layer",
    detects=True,
)
CHOSEN = {
    "keypoints.detector": "layer",
    "descriptor.kind": "layer",
    "keypoints.max_count": 600,
    "pyramid.max_side_px": 640,
    "search.thorough": False,
    "tracking.enabled": False,
}


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    register_descriptor(LAYER)
    Layer.made = 0
    yield
    del DESCRIPTORS["layer"]


def test_it_finds_the_target(
    target_images: tuple[TargetImage, ...], one_target_frames: tuple[SimulatedFrame, ...]
) -> None:
    parameters = parameters_from(CHOSEN)
    targets = prepare_references(target_images[:1], parameters)
    localizer = Localizer(parameters, targets)
    for simulated in one_target_frames[:2]:
        result = localizer.process(simulated.frame)
        assert result.first.status is Status.DETECTED, result.first.reason
        assert result.descriptors.shape[1] == LAYER.columns
        size = result.developed.grey.shape[1::-1]
        assert corner_error(result.first.homography.H, simulated.truths[0].H, targets[0].size, size) < 0.3
    # Without patches, too, matches of keypoints alone tell where it is.
    parameters = parameters_from({**CHOSEN, "refinement.enabled": False})
    found = Localizer(parameters, prepare_references(target_images[:1], parameters)).process(one_target_frames[0].frame)
    assert found.first.status is Status.DETECTED
    assert int(found.first.matches.inliers.sum()) >= 12


def test_its_weights_are_made_once(
    target_images: tuple[TargetImage, ...], one_target_frames: tuple[SimulatedFrame, ...]
) -> None:
    from imgu_ros.localizer import prepare_localizer

    parameters = parameters_from(CHOSEN)
    built = prepare_localizer(target_images, parameters)
    made = Layer.made
    for simulated in one_target_frames[:2]:
        built.localizer.process(simulated.frame)
    again = prepare_localizer(target_images, parameters_from({"homography.threshold_px": 2.0}, parameters), built)
    again.localizer.process(one_target_frames[0].frame)
    assert made == Layer.made == 1


def test_users_choose_it_as_detector_and_descriptor() -> None:
    assert "layer" in declaration("keypoints.detector").choices
    assert "layer" in declaration("descriptor.kind").choices
    with pytest.raises(ParameterError, match=r"^keypoints.detector: 'orb' .*'layer', which .*; need 'layer'$"):
        parameters_from({"descriptor.kind": "layer"})
    with pytest.raises(ParameterError, match=r"^descriptor.kind: 'orb' .*'layer', which .*; need 'layer'$"):
        parameters_from({"keypoints.detector": "layer"})
    with pytest.raises(ParameterError, match=r"^matching.metric: 'ncc' .* is the output of a layer; need"):
        parameters_from({**CHOSEN, "matching.metric": "ncc"})
