# SPDX-License-Identifier: Apache-2.0
"""The plane of a reference: its outline in template px and, where its printed width is known, its metric frame."""

from __future__ import annotations

import numpy as np

from imgu_ros.types import Matrix3, Points
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.projective.transform import inverse3


class Plane:
    """A rectangle of `width` x `height` template px on a plane.

    Parameters
    ----------
    width, height : of the template, px
    width_m : printed width, outer edge to outer edge; 0: unknown
    outer : left, top, right and bottom of the outer edges, template px; None: those of the template
    origin : of the metric frame, template px; None: the middle of the outer edges

    Attributes
    ----------
    size : width and height
    outline : (4, 2) template px, the outer corners: top left, top right, bottom right, bottom left
    outline_homogeneous : (3, 4), the same in homogeneous coordinates, one a column
    metres_from_template : (3, 3) affine; the metric frame has x right, y up
    """

    def __init__(
        self,
        width: int,
        height: int,
        width_m: float,
        outer: tuple[float, float, float, float] | None = None,
        origin: tuple[float, float] | None = None,
    ) -> None:
        self.size = width, height
        self.width_m = width_m
        left, top, right, bottom = outer or (-0.5, -0.5, width - 0.5, height - 0.5)
        self.outline = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
        self.outline_homogeneous = np.vstack((self.outline.T, np.ones(4)))
        scale = width_m / (right - left)
        x, y = origin or ((left + right) / 2, (top + bottom) / 2)
        self.metres_from_template = np.array([[scale, 0, -scale * x], [0, -scale, scale * y], [0, 0, 1]])
        for array in (self.outline, self.outline_homogeneous, self.metres_from_template):
            array.flags.writeable = False

    def motion(self, S: Matrix3) -> RigidTransform:
        """Return a motion (3, 3) of the template, which keeps its size, as one of the metric frame."""
        moved = self.metres_from_template @ S @ inverse3(self.metres_from_template)
        c, s = moved[:2, 0] / np.hypot(*moved[:2, 0])
        R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        return RigidTransform(R, np.array((*moved[:2, 2], 0.0)))

    def to_metres(self, template_xy: Points) -> Points:
        """Map template px (N, 2) to the metric frame."""
        M = self.metres_from_template
        return np.asarray(template_xy @ M[:2, :2].T + M[:2, 2])
