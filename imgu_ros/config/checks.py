# SPDX-License-Identifier: Apache-2.0
"""Which parameters make sense together, and why the others do not.

A value by itself is checked where it is read (`parameter_values.checked_value`); here are the values that depend on
each other.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from imgu_ros.config.parameters import CameraParameters, Parameters, RawParameters
from imgu_ros.errors import ParameterError
from imgu_ros.vision.methods import DESCRIPTORS, DETECTORS

#: Of a covariance, relative: numbers are written with a few digits.
_ROUNDING = 1e-5


def check_together(parameters: Parameters) -> None:
    """Check the values that depend on each other.

    Raises
    ------
    ParameterError
        If parallel lists disagree, the levels or bands of raw data contradict each other, or the methods of the chain
        make no sense together (`why_not`).
    """
    for reason in (
        *_about_targets(parameters),
        *_about_camera(parameters.camera),
        *_about_raw(parameters.raw),
        why_not(parameters),
    ):
        if reason:
            raise ParameterError(reason)


def why_not(parameters: Parameters) -> str:
    """Return why the chain's methods make no sense together: what was got, what is needed; empty when they do.

    It speaks of detector, descriptor, metric, pyramid, preprocessing and the numbers that count what these give; every
    other choice (demosaicking, kernel, sampler, score, error, refinement, tracking) goes with every choice.

    Examples
    --------
    >>> from imgu_ros.config.parameters import KeypointsParameters, PyramidParameters
    >>> why_not(Parameters())
    ''
    >>> laplacian = PyramidParameters(kind="laplacian")
    >>> why_not(Parameters(pyramid=laplacian, keypoints=KeypointsParameters(detector="dog"))).partition(";")[0]
    "pyramid.kind: 'laplacian' leaves few structures, and keypoints.detector 'dog' looks for those of every size"
    """
    return next(_contradictions(parameters), "")


def _contradictions(p: Parameters) -> Iterator[str]:
    kind, metric, descriptor = p.descriptor.kind, p.matching.metric, DESCRIPTORS[p.descriptor.kind]
    if metric != "auto" and metric not in descriptor.metrics:
        need = " or ".join(("auto", *descriptor.metrics))
        yield f"matching.metric: {metric!r}, and descriptor.kind {kind!r} {descriptor.nature}; need {need}"
    detector, edges, threshold = p.keypoints.detector, p.preprocess.edges, p.preprocess.threshold
    if descriptor.detects and detector != kind:
        yield f"keypoints.detector: {detector!r}, and descriptor.kind {kind!r} finds its own keypoints; need {kind!r}"
    if detector not in DETECTORS and detector != kind:
        yield f"descriptor.kind: {kind!r}, and keypoints.detector {detector!r} describes, too; need {detector!r}"
    if detector in DETECTORS and DETECTORS[detector].finds_every_scale:
        seen = f"keypoints.detector {detector!r} looks for those of every size"
        for name, value, wrong, others in (
            ("pyramid.kind", p.pyramid.kind, p.pyramid.kind == "laplacian", "coarse or fine"),
            ("preprocess.edges", edges, edges != "none", "none"),
            ("preprocess.threshold", threshold, threshold != "none", "none"),
        ):
            if wrong:
                yield f"{name}: {value!r} leaves few structures, and {seen}; need {others}, or another detector"
    if edges != "none" and threshold != "none":
        yield (
            f"preprocess.threshold: {threshold!r} leaves steps of one height to preprocess.edges {edges!r}, and "
            f"nothing to tell places apart; need one of the two"
        )
    fewest = p.homography.min_inliers
    if p.keypoints.max_count < fewest:
        yield f"keypoints.max_count: {p.keypoints.max_count}; need at least homography.min_inliers ({fewest})"
    if p.refinement.max_points < fewest and (p.refinement.enabled or p.tracking.enabled):
        yield f"refinement.max_points: {p.refinement.max_points}; need at least homography.min_inliers ({fewest})"


def _about_targets(parameters: Parameters) -> Iterator[str]:
    targets = parameters.targets
    count = len(targets.images)
    for name, values, each in (
        ("widths_m", targets.widths_m, 1),
        ("names", targets.names, 1),
        ("poses", targets.poses, 7),
    ):
        if len(values) not in (0, count * each):
            need = f"none, or {count * each}: {'one' if each == 1 else 'seven'} for each of targets.images"
            yield f"targets.{name}: {len(values)} values; need {need}"


def _about_camera(camera: CameraParameters) -> Iterator[str]:
    given = camera.covariance
    side = math.isqrt(len(given))
    if not given:
        return
    if side * side != len(given) or side < 4:
        yield (
            f"camera.covariance: {len(given)} values; need 16 (fx, fy, cx, cy by themselves), or (4 + n)^2 with n "
            "distortion coefficients, row by row"
        )
        return
    variances = given[:: side + 1]
    if min(variances) < 0:
        yield f"camera.covariance: a variance of {min(variances):g}; need 0 or more on the diagonal"
    for i in range(side):
        for j in range(i):
            one, other = given[i * side + j], given[j * side + i]
            most = math.sqrt(max(variances[i], 0) * max(variances[j], 0))
            if abs(one - other) > _ROUNDING * most or abs(one) > (1 + _ROUNDING) * most:
                yield (
                    f"camera.covariance: {one:g} in row {i + 1}, column {j + 1}, and {other:g} in row {j + 1}, column "
                    f"{i + 1}; need the same, at most {most:.6g} by the variances"
                )
                return


def _about_raw(raw: RawParameters) -> Iterator[str]:
    if len(raw.gains) != 3:
        yield f"raw.gains: {len(raw.gains)} values; need 3 (red, green, blue)"
    if len(raw.grey_weights) != 3:
        yield f"raw.grey_weights: {len(raw.grey_weights)} values; need 3 (red, green, blue)"
    elif not any(raw.grey_weights):
        yield "raw.grey_weights: all 0; need at least one other value"
    if 0 < raw.white_level <= raw.black_level:
        yield f"raw.white_level: {raw.white_level:g}; need more than raw.black_level ({raw.black_level:g})"
    yield _about_bands(raw)


def _about_bands(raw: RawParameters) -> str:
    """Return what is wrong with a band mode whose weights or reference are missing, or do not go with the bands."""
    name, values = {
        "weighted": ("raw.band_weights", raw.band_weights),
        "spectral_angle": ("raw.reference_spectrum", raw.reference_spectrum),
    }.get(raw.band_mode, ("", ()))
    if not name:
        return ""
    if not values:
        return f"{name}: none; need one value for each band when raw.band_mode is {raw.band_mode!r}"
    if raw.bands and len(values) != len(raw.bands):
        return f"{name}: {len(values)} values; need {len(raw.bands)}, one for each of raw.bands"
    if not any(values):
        return f"{name}: all 0; need at least one other value"
    if raw.band_mode == "spectral_angle" and len(values) < 2:
        return f"{name}: 1 value; need 2 or more for an angle between spectra"
    return ""
