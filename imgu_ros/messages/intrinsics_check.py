# SPDX-License-Identifier: Apache-2.0
"""Whether an intrinsic matrix can be a camera's: the signs of a placeholder, of other units, of another resolution.

The limits are wide enough for every camera that was met: telephoto lenses of 600 mm, circular fisheyes of 220 degrees,
sensors of which a part was calibrated as if it were all, simulated pinholes of 150 degrees.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from imgu_ros.types import Matrix3
from imgu_ros.vision.camera.distortion_model import DistortionModel

#: Angle of view of a pinhole, degrees.
WIDEST_DEG = 155.0
NARROWEST_DEG = 0.5
#: A circular fisheye's image may be much smaller than the sensor: focal length as a share of the longer side.
SHORTEST_FISHEYE = 0.1
#: Principal point as a share of the side: outside, no lens; outside the second, worth a word.
POSSIBLE = (0.15, 0.85)
USUAL = (0.35, 0.65)
#: Off in both directions by more than this share: the numbers of a smaller or larger image.
RESCALED = 0.1
#: Off by more in one direction, while in the middle of the binned image or of the window: of which K is, is open.
CLEARLY_OFF = 0.12
#: A smaller share is a principal point that was not filled, not one of a smaller image.
_NO_CENTRE = 0.02
#: fx / fy, and skew / fx, worth a word.
ASPECT = 2.0
SKEW = 0.05
#: p1, p2 worth a word.
TANGENTIAL = 0.03
#: P's focal length over K's, up to which rectification explains it: without distortion, with it, of wide lenses.
RECTIFIED = (1.25, 2.5, 6.0)


@dataclass(frozen=True, slots=True)
class Verdict:
    """Result of the checks.

    Attributes
    ----------
    problem : why this cannot be a camera; empty when it can
    remarks : what is unusual
    """

    problem: str = ""
    remarks: tuple[str, ...] = ()


def check_intrinsics(
    matrix: Matrix3,
    model: DistortionModel,
    size: tuple[int, int],
    window: tuple[int, int, int, int],
    binning: tuple[int, int],
) -> Verdict:
    """Judge K, or P[:3, :3], of a whole sensor.

    Parameters
    ----------
    matrix : (3, 3) upper triangular, positive focal lengths
    model : of the lens
    size : width and height of the sensor, px
    window : x, y, width and height of the part that is read, px of the sensor
    binning : sensor pixels in one of the image's, along x and y
    """
    problem = (
        _placeholder(matrix) or _focal_problem(matrix, model, size) or _centre_problem(matrix, size, window, binning)
    )
    return Verdict(problem) if problem else Verdict(remarks=tuple(_remarks(matrix, size)))


def focal_ratio_remark(K: Matrix3, P: Matrix3, model: DistortionModel, distorted: bool) -> str:
    """Return a remark when the focal lengths of K and P differ by more than rectification explains; else empty.

    Parameters
    ----------
    K, P : (3, 3), of P its first three columns; positive focal lengths
    model, distorted : of the lens, and whether it bends at all
    """
    wide = model is not DistortionModel.PLUMB_BOB
    most = RECTIFIED[0 if not distorted else 2 if wide else 1]
    for name, axis in (("fx", 0), ("fy", 1)):
        ratio = P[axis, axis] / K[axis, axis]
        if not 1 / most <= ratio <= most:
            return (
                f"K and P disagree: {name} is {K[axis, axis]:g} px in K and {P[axis, axis]:g} px in P, {ratio:.3g} "
                f"times as much; rectification explains {1 / most:.2g} to {most:.2g}"
            )
    return ""


def tangential_remark(model: DistortionModel, coefficients: Sequence[float]) -> str:
    """Return a remark when p1 or p2 is so large that something else may stand in their places; else empty."""
    p1, p2 = (*coefficients, 0.0, 0.0, 0.0, 0.0)[2:4]
    if model is DistortionModel.EQUIDISTANT or max(abs(p1), abs(p2)) <= TANGENTIAL:
        return ""
    return (
        f"D has p1 {p1:g} and p2 {p2:g}, at most 0.01 in most lenses: it may be in another order than k1 k2 p1 p2 k3, "
        "or of another model"
    )


def _placeholder(matrix: Matrix3) -> str:
    if matrix[0, 0] == matrix[1, 1] == 1 and not matrix[:2, 2].any():
        return "is the identity: a placeholder; need focal lengths and principal point in px"
    return ""


def _focal_problem(matrix: Matrix3, model: DistortionModel, size: tuple[int, int]) -> str:
    for name, focal, side in (("fx", float(matrix[0, 0]), size[0]), ("fy", float(matrix[1, 1]), size[1])):
        view = math.degrees(2 * math.atan2(side / 2, focal))
        fisheye = model is DistortionModel.EQUIDISTANT
        short = focal < SHORTEST_FISHEYE * max(size) if fisheye else view > WIDEST_DEG
        if short or view < NARROWEST_DEG:
            unit = " (in metres?)" if focal < 0.5 else " (in millimetres?)" if short else ""
            return (
                f"has {name} {focal:g} px, an angle of view of {view:.3g} deg across {side} px{unit}; need a focal "
                f"length in px: {0.3 * side:.0f} to {5 * side:.0f} of most lenses"
            )
    return ""


def _centre_problem(
    matrix: Matrix3, size: tuple[int, int], window: tuple[int, int, int, int], binning: tuple[int, int]
) -> str:
    x, y, *part = window
    read = (part[0], part[1])
    if (x, y) == (0, 0) and binning == (1, 1) and _is_central(matrix, read):
        return ""  # K of the window is then that of the sensor
    u, v = _shares(matrix, size)
    seen = f"has its principal point at ({matrix[0, 2]:g}, {matrix[1, 2]:g}) px of {size[0]} x {size[1]} px"
    binned = (read[0] // binning[0], read[1] // binning[1])
    for other, words in ((binned, "binned image"), (read, "window (roi)")):
        exists = max(binning) > 1 if words == "binned image" else (x or y)
        if exists and _is_central(matrix, other) and max(abs(u - 0.5), abs(v - 0.5)) >= CLEARLY_OFF:
            return (
                f"{seen}, and in the middle of the {words}, {other[0]} x {other[1]} px: it may be K of either, and is "
                f"to be the sensor's at full resolution; need K of {size[0]} x {size[1]} px, or width, height, roi and "
                "binning as K has them"
            )
    rescaled = (u - 0.5) * (v - 0.5) > 0 and min(abs(u - 0.5), abs(v - 0.5)) >= RESCALED
    possible = all(POSSIBLE[0] <= share <= POSSIBLE[1] for share in (u, v))
    if possible and not rescaled:
        return ""
    hint = (
        f", as of an image of about {2 * matrix[0, 2]:.0f} x {2 * matrix[1, 2]:.0f} px"
        if rescaled and min(u, v) > _NO_CENTRE
        else ""
    )
    whole = read == size and (abs(u) > _NO_CENTRE or abs(v) > _NO_CENTRE)
    part_of = "; if the image is a part of the sensor, need width, height and K of all of it, and roi" if whole else ""
    return f"{seen}{hint}; need it near the middle, ({(size[0] - 1) / 2:g}, {(size[1] - 1) / 2:g}){part_of}"


def _is_central(matrix: Matrix3, size: tuple[int, int]) -> bool:
    return min(size) > 0 and all(abs(share - 0.5) < RESCALED for share in _shares(matrix, size))


def _remarks(matrix: Matrix3, size: tuple[int, int]) -> list[str]:
    remarks = []
    middle = ((size[0] - 1) / 2, (size[1] - 1) / 2)
    if not all(USUAL[0] <= share <= USUAL[1] for share in _shares(matrix, size)):
        remarks.append(
            f"has its principal point at ({matrix[0, 2]:g}, {matrix[1, 2]:g}) px of {size[0]} x {size[1]} px, far from "
            f"the middle, ({middle[0]:g}, {middle[1]:g}): right for a part of a larger sensor alone"
        )
    if not 1 / ASPECT <= matrix[0, 0] / matrix[1, 1] <= ASPECT:
        remarks.append(f"has fx {matrix[0, 0]:g} and fy {matrix[1, 1]:g} px; most pixels are square: fx = fy expected")
    if abs(matrix[0, 1]) > SKEW * matrix[0, 0]:
        remarks.append(f"has the skew {matrix[0, 1]:g} px beside fx {matrix[0, 0]:g} px; 0 expected")
    return remarks


def _shares(matrix: Matrix3, size: tuple[int, int]) -> tuple[float, float]:
    return float((matrix[0, 2] + 0.5) / size[0]), float((matrix[1, 2] + 0.5) / size[1])
