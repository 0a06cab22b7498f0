"""What a frame should show of a target where an estimate says it is: points to look for, and where they would be."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imgu_ros.errors import NoConsensus
from imgu_ros.perception.targets import AlignmentLevel, Target
from imgu_ros.types import Matrix3, Points
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.projective.dlt import homography_dlt
from imgu_ros.vision.projective.transform import local_jacobian


@dataclass(frozen=True, slots=True, eq=False)
class Expectation:
    """Points of a target that should be in view.

    Attributes
    ----------
    octave : the level of the target whose pixels come out nearest in size to the picture's
    template_xy : (N, 2) template px
    predicted : (N, 2) raw px
    H_raw : raw px from template px; through a lens that bends, the nearest homography
    """

    octave: AlignmentLevel
    template_xy: Points
    predicted: Points
    H_raw: Matrix3

    @property
    def raw_from_level(self) -> Matrix3:
        """Raw px from the octave's px, (3, 3)."""
        sx, sy = self.octave.level.step
        return np.asarray(self.H_raw @ np.array([[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1]]))


def expect(
    target: Target,
    H: Matrix3,
    camera: Camera | None,
    shape: tuple[int, ...],
    *,
    step: int,
    margin: int,
    most: int,
    fewest: int,
) -> Expectation:
    """Choose points of a target that should be in view.

    Parameters
    ----------
    target, H : H_image_template in ideal px
    camera : intrinsics when the lens distorts; else None
    shape : (height, width) of the frame
    step : raw px in a pixel of the picture that will be looked at
    margin : nearest to the frame's border, raw px
    most, fewest : number of points

    Raises
    ------
    NoConsensus
        If fewer than `fewest` are in view.
    """
    octave = _fitting_level(target, H, step)
    corners = octave.corners
    mapped = corners @ H[:, :2].T + H[:, 2]
    ahead = mapped[:, 2] > 0
    corners, mapped = corners[ahead], mapped[ahead]
    xy = mapped[:, :2] / mapped[:, 2:]
    if camera is not None and len(xy):
        xy = camera.raw_pixels(xy)
    inside = (xy >= margin).all(axis=1) & (xy < np.array((shape[1], shape[0])) - margin).all(axis=1)
    # The corners come best spread first: so do those in view.
    chosen = np.flatnonzero(inside)[:most]
    if len(chosen) < fewest:
        raise NoConsensus(f"patches: {len(chosen)} in view; need {fewest}")
    template_xy, predicted = corners[chosen], xy[chosen]
    return Expectation(octave, template_xy, predicted, H if camera is None else homography_dlt(template_xy, predicted))


def _fitting_level(target: Target, H: Matrix3, step: int) -> AlignmentLevel:
    """Return the octave whose pixels come out nearest in size to the picture's, each `step` of the frame's."""
    width, height = target.size
    centre = np.array([[(width - 1) / 2, (height - 1) / 2]])
    pixels = math.sqrt(abs(float(np.linalg.det(local_jacobian(H, centre)[0]))))
    pixels /= step  # px of the picture in a template px
    steps = np.array([a.level.scale for a in target.alignment if len(a.corners)] or [1.0])
    return target.alignment[int(np.argmin(np.abs(np.log(steps * max(pixels, 1e-9)))))]
