# SPDX-License-Identifier: Apache-2.0
"""Matches of a plane of which many are wrong, with the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imgu_ros.types import Mask, Matrix3, Points
from imgu_ros.vision.projective.homography import HomographyEstimate, normalised_homography, tangent_basis
from imgu_ros.vision.projective.transform import transform

#: px: the source picture's side, and the frame's.
SIDE = 1000.0
#: Wrong matches: anywhere in the frame; over 40 frames; one at a million px on either side; within a tenth of the
#: target; all on one spot; over a million px on both sides.
KINDS = ("uniform", "far", "million", "near", "clump", "far on both sides")


@dataclass(frozen=True, slots=True, eq=False)
class PlaneMatches:
    """Matches, and where they come from.

    Attributes
    ----------
    H : (3, 3), dst ~ H src
    src, dst : (N, 2) px
    true : (N,) which of them come from H
    """

    H: Matrix3
    src: Points
    dst: Points
    true: Mask

    def nees(self, estimate: HomographyEstimate) -> float:
        """Squared error of H in units of its covariance, on the tangent space: chi-squared of 8."""
        basis = tangent_basis(estimate.H)
        error = basis.T @ (self.H - estimate.H).ravel()
        return float(error @ np.linalg.solve(basis.T @ estimate.covariance @ basis, error))

    def corner_error(self, H: Matrix3) -> float:
        """Mean distance of the source's mapped corners from where they are, px; infinite behind the horizon."""
        corners = np.array([[0, 0], [SIDE, 0], [SIDE, SIDE], [0, SIDE]])
        mapped = corners @ H[:, :2].T + H[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            away = mapped[:, :2] / mapped[:, 2:] - transform(self.H, corners)
        return float(np.nan_to_num(np.hypot(*away.T), nan=np.inf).mean())


def plane_matches(
    kind: str, share: float, scale: float, seed: int, noise: float = 1.0, true: int = 100
) -> PlaneMatches:
    """Return matches of a picture with a tilted view of it.

    Parameters
    ----------
    kind : of the wrong ones, one of KINDS
    share : of the wrong ones in all, 0 to below 1
    scale : width of the view, as a share of the frame's
    seed : of the draws
    noise : px, standard deviation of the coordinates of dst
    true : number of true ones
    """
    rng = np.random.default_rng((seed, KINDS.index(kind), round(1000 * scale), round(100 * share)))
    angle, (g, h) = rng.uniform(-0.6, 0.6), rng.uniform(-0.3, 0.3, 2) / SIDE
    c, s, size = scale * np.cos(angle), scale * np.sin(angle), scale * SIDE
    x, y = rng.uniform(0.6 * size, SIDE - 0.6 * size, 2) if scale < 0.8 else (SIDE / 2, SIDE / 2)
    view = np.array([[c, -0.8 * s, 0], [s, 0.8 * c, 0], [g, h, 1]])
    to_centre, to_place = np.eye(3), np.eye(3)
    to_centre[:2, 2], to_place[:2, 2] = -SIDE / 2, (x, y)
    H = normalised_homography(to_place @ view @ to_centre)
    src = rng.uniform(0, SIDE, (true, 2))
    dst = transform(H, src) + rng.normal(0, noise, (true, 2))
    wrong = round(true * share / (1 - share))
    wrong_src, wrong_dst = rng.uniform(0, SIDE, (wrong, 2)), rng.uniform(0, SIDE, (wrong, 2))
    if kind == "far":
        wrong_dst = (wrong_dst - SIDE / 2) * 40
    elif kind == "million":
        wrong_dst[:1], wrong_src[1:2] = (1e6, -1e6), (-1e6, 1e6)
    elif kind == "near":
        wrong_dst = transform(H, wrong_src) + rng.normal(0, 0.1 * size, (wrong, 2))
    elif kind == "clump":
        wrong_dst = rng.uniform(0, SIDE, 2) + rng.normal(0, 5, (wrong, 2))
    elif kind == "far on both sides":
        wrong_src, wrong_dst = rng.uniform(-1e6, 1e6, (wrong, 2)), rng.uniform(-1e6, 1e6, (wrong, 2))
    order = rng.permutation(true + wrong)
    return PlaneMatches(H, np.vstack((src, wrong_src))[order], np.vstack((dst, wrong_dst))[order], (order < true))
