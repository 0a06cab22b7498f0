# SPDX-License-Identifier: Apache-2.0
"""Which parameters go together: every combination of the pipeline's methods, by the rules written once more."""

from __future__ import annotations

import itertools
import re
from dataclasses import fields

import pytest

from imgu_ros.config.checks import method_conflict
from imgu_ros.config.parameters import (
    DescriptorParameters,
    HomographyParameters,
    KeypointsParameters,
    MatchingParameters,
    Parameters,
    PreprocessParameters,
    PyramidParameters,
    RefinementParameters,
    declaration,
    declarations,
)
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import ParameterError, ShapeError
from imgu_ros.vision.matching.metrics import Metric, metric_for, metrics_of
from imgu_ros.vision.methods import DESCRIPTORS

BITS = {"orb", "brief"}
HISTOGRAMS = {"sift", "rootsift"}


def is_wanted(detector: str, descriptor: str, metric: str, kind: str, edges: str, threshold: str) -> bool:
    comparable = {
        "auto": True,
        "hamming": descriptor in BITS,
        "euclidean": descriptor in HISTOGRAMS,
        "cosine": descriptor in HISTOGRAMS,
        "ssd": descriptor == "patch",
        "zmssd": descriptor == "patch",
        "ncc": descriptor == "patch",
    }[metric]
    whole = detector not in ("dog", "mser") or (kind != "laplacian" and edges == threshold == "none")
    return comparable and whole and (edges == "none" or threshold == "none")


def values_of(*names: str) -> list[tuple[str, ...]]:
    return list(itertools.product(*(declaration(name).choices for name in names)))


def test_every_combination_is_accepted_or_refused_in_one_line() -> None:
    """detector x descriptor x metric x sampler x refinement x kernel x pyramid x edges x threshold."""
    pictures = [
        (PyramidParameters(kind=kind, kernel=kernel), PreprocessParameters(edges=edges, threshold=threshold))
        for kind, kernel, edges, threshold in values_of(
            "pyramid.kind", "pyramid.kernel", "preprocess.edges", "preprocess.threshold"
        )
    ]
    fits = [
        HomographyParameters(sampler=sampler, refine=refine)
        for sampler, refine in values_of("homography.sampler", "homography.refine")
    ]
    # Made once, not for every one of the combinations.
    others = {field.name: getattr(Parameters(), field.name) for field in fields(Parameters)}
    accepted = count = 0
    for detector, kind, metric in values_of("keypoints.detector", "descriptor.kind", "matching.metric"):
        keypoints, descriptor = KeypointsParameters(detector=detector), DescriptorParameters(kind=kind)
        matching = MatchingParameters(metric=metric)
        for pyramid, preprocess in pictures:
            wanted = is_wanted(detector, kind, metric, pyramid.kind, preprocess.edges, preprocess.threshold)
            for homography in fits:
                others |= {"keypoints": keypoints, "descriptor": descriptor, "matching": matching}
                others |= {"pyramid": pyramid, "preprocess": preprocess, "homography": homography}
                parameters = Parameters(**others)
                reason = method_conflict(parameters)
                assert (reason == "") is wanted, (reason, parameters)
                assert not reason or re.fullmatch(r"[a-z_.]+: '[a-z_]+'.+; need [^\n]+", reason)
                count += 1
                accepted += wanted
    assert count == 6 * 5 * 7 * 3 * 3 * 2 * 3 * 2 * 4
    # Descriptors with metrics: 2 x 2 + 2 x 3 + 4. Of four detectors, kinds x (thresholds, and edges without one); of
    # dog and mser, two kinds. Then kernels, samplers, refinements.
    assert accepted == 14 * (4 * 3 * 4 + 2 * 2) * 3 * 2 * 4


def test_metrics_are_those_of_the_library() -> None:
    for kind in DESCRIPTORS:
        for metric in Metric:
            parameters = Parameters(
                descriptor=DescriptorParameters(kind=str(kind)), matching=MatchingParameters(metric=str(metric))
            )
            reason = method_conflict(parameters)
            try:
                metric_for(kind, metric)
            except ShapeError:
                assert reason.endswith("need " + " or ".join(("auto", *metrics_of(kind))))
            else:
                assert not reason


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"matching.metric": "cosine"},
            "matching.metric: 'cosine' conflicts with descriptor.kind 'orb', which is binary; need auto or hamming",
        ),
        (
            {"keypoints.detector": "mser", "pyramid.kind": "laplacian"},
            (
                "pyramid.kind: 'laplacian' conflicts with keypoints.detector 'mser', which builds its scales from "
                "plain grey values; need coarse or fine, or another detector"
            ),
        ),
        (
            {"keypoints.detector": "dog", "preprocess.edges": "strength"},
            (
                "preprocess.edges: 'strength' conflicts with keypoints.detector 'dog', which builds its scales from "
                "plain grey values; need none, or another detector"
            ),
        ),
        (
            {"keypoints.detector": "mser", "preprocess.threshold": "fixed"},
            (
                "preprocess.threshold: 'fixed' conflicts with keypoints.detector 'mser', which builds its scales from "
                "plain grey values; need none, or another detector"
            ),
        ),
        (
            {"preprocess.edges": "strength", "preprocess.threshold": "otsu"},
            (
                "preprocess.threshold: 'otsu' conflicts with preprocess.edges 'strength': all edges of a binary image "
                "are equally strong; need one of the two"
            ),
        ),
        (
            {"keypoints.max_count": 8, "homography.min_inliers": 9},
            "keypoints.max_count: 8; need at least homography.min_inliers (9)",
        ),
        ({"homography.min_inliers": 151}, "refinement.max_points: 150; need at least homography.min_inliers (151)"),
    ],
)
def test_what_was_got_and_what_is_needed(values: dict[str, object], message: str) -> None:
    with pytest.raises(ParameterError) as caught:
        parameters_from(values)
    assert str(caught.value) == message


def test_counts_that_nobody_asks_for_are_free() -> None:
    alone = {"homography.min_inliers": 300, "refinement.enabled": False, "tracking.enabled": False}
    assert parameters_from(alone).refinement == RefinementParameters(enabled=False)
    assert parameters_from({"homography.min_inliers": 150, "keypoints.max_count": 150}).keypoints.max_count == 150


def test_every_single_change_of_the_defaults_is_accepted() -> None:
    """But for a metric of another descriptor: a user compares methods by changing one word."""
    refused = set()
    for known in declarations():
        for value in known.choices or ((True, False) if known.type_name == "bool" else ()):
            try:
                parameters_from({known.name: value})
            except ParameterError:
                refused.add((known.name, value))
    assert refused == {
        ("raw.band_mode", "weighted"), ("raw.band_mode", "spectral_angle"), ("matching.metric", "euclidean"),
        ("matching.metric", "cosine"), ("matching.metric", "ssd"), ("matching.metric", "zmssd"),
        ("matching.metric", "ncc"),
    }  # fmt: skip
