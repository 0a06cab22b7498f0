# SPDX-License-Identifier: Apache-2.0
"""Which parameter values go together, and why others conflict.

`values.checked_value` checks a value alone; here are the values that depend on each other.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from imgu_ros.config.parameters import CameraParameters, Parameters, RawParameters, TargetsParameters
from imgu_ros.errors import ParameterError
from imgu_ros.vision.methods import DESCRIPTORS, DETECTORS

#: Relative tolerance of a covariance's symmetry: numbers in files have few digits.
_ROUNDING = 1e-5


def check_together(parameters: Parameters) -> None:
    """Check the values that depend on each other.

    Raises
    ------
    ParameterError
        If parallel lists disagree, the levels or bands of raw data contradict each other, or the chosen methods
        conflict (`method_conflict`).
    """
    for reason in (
        *_target_faults(parameters.targets),
        *_camera_faults(parameters.camera),
        *_raw_faults(parameters.raw),
        method_conflict(parameters),
    ):
        if reason:
            raise ParameterError(reason)


def method_conflict(parameters: Parameters) -> str:
    """Return which of the chosen methods conflict, and what is needed; empty when none do.

    Detector, descriptor, metric, pyramid and preprocessing depend on each other, and so do the numbers of keypoints,
    patches and inliers. Every other choice (demosaicking, kernel, sampler, score, error, refinement, tracking) goes
    with every choice.

    Examples
    --------
    >>> from imgu_ros.config.parameters import KeypointsParameters, PyramidParameters
    >>> method_conflict(Parameters())
    ''
    >>> laplacian = PyramidParameters(kind="laplacian")
    >>> method_conflict(Parameters(pyramid=laplacian, keypoints=KeypointsParameters(detector="dog"))).partition(",")[0]
    "pyramid.kind: 'laplacian' conflicts with keypoints.detector 'dog'"
    """
    return next(_method_conflicts(parameters), "")


def _method_conflicts(p: Parameters) -> Iterator[str]:
    kind, metric, descriptor = p.descriptor.kind, p.matching.metric, DESCRIPTORS[p.descriptor.kind]
    metrics = ("auto", *descriptor.metrics)
    if metric not in metrics:
        yield (
            f"matching.metric: {metric!r} conflicts with descriptor.kind {kind!r}, which {descriptor.nature}; need "
            f"{' or '.join(metrics)}"
        )
    detector, edges, threshold = p.keypoints.detector, p.preprocess.edges, p.preprocess.threshold
    if descriptor.detects and detector != kind:
        yield (
            f"keypoints.detector: {detector!r} conflicts with descriptor.kind {kind!r}, which detects its own "
            f"keypoints; need {kind!r}"
        )
    if detector not in DETECTORS and detector != kind:
        yield (
            f"descriptor.kind: {kind!r} conflicts with keypoints.detector {detector!r}, which describes its keypoints; "
            f"need {detector!r}"
        )
    if detector in DETECTORS and DETECTORS[detector].finds_every_scale:
        for name, value, is_wrong, others in (
            ("pyramid.kind", p.pyramid.kind, p.pyramid.kind == "laplacian", "coarse or fine"),
            ("preprocess.edges", edges, edges != "none", "none"),
            ("preprocess.threshold", threshold, threshold != "none", "none"),
        ):
            if is_wrong:
                yield (
                    f"{name}: {value!r} conflicts with keypoints.detector {detector!r}, which builds its scales from "
                    f"plain grey values; need {others}, or another detector"
                )
    if edges != "none" and threshold != "none":
        yield (
            f"preprocess.threshold: {threshold!r} conflicts with preprocess.edges {edges!r}: all edges of a binary "
            "image are equally strong; need one of the two"
        )
    fewest = p.homography.min_inliers
    if p.keypoints.max_count < fewest:
        yield f"keypoints.max_count: {p.keypoints.max_count}; need at least homography.min_inliers ({fewest})"
    if p.refinement.max_points < fewest and (p.refinement.enabled or p.tracking.enabled):
        yield f"refinement.max_points: {p.refinement.max_points}; need at least homography.min_inliers ({fewest})"


def _target_faults(targets: TargetsParameters) -> Iterator[str]:
    count = len(targets.images)
    for name, values, each in (
        ("widths_m", targets.widths_m, 1),
        ("names", targets.names, 1),
        ("poses", targets.poses, 7),
    ):
        if len(values) not in (0, count * each):
            need = f"none, or {count * each}: {'one' if each == 1 else 'seven'} for each of targets.images"
            yield f"targets.{name}: {len(values)} values; need {need}"


def _camera_faults(camera: CameraParameters) -> Iterator[str]:
    given = camera.covariance
    side = math.isqrt(len(given))
    if not given:
        return
    if side * side != len(given) or side < 4:
        yield (
            f"camera.covariance: {len(given)} values; need 16 (fx, fy, cx, cy alone), or (4 + n)^2 with n distortion "
            "coefficients, row by row"
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
                    f"{i + 1}; need equal values, at most {most:.6g} by the variances"
                )
                return


def _raw_faults(raw: RawParameters) -> Iterator[str]:
    for name, values in (("gains", raw.gains), ("grey_weights", raw.grey_weights)):
        if len(values) != 3:
            yield f"raw.{name}: {len(values)} values; need 3 (red, green, blue)"
    if not any(raw.grey_weights):
        yield "raw.grey_weights: all 0; need at least one other value"
    if 0 < raw.white_level <= raw.black_level:
        yield f"raw.white_level: {raw.white_level:g}; need more than raw.black_level ({raw.black_level:g})"
    yield _band_fault(raw)


def _band_fault(raw: RawParameters) -> str:
    """Return why the weights or the spectrum that a band mode needs are missing or do not match the bands."""
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
