# SPDX-License-Identifier: Apache-2.0
"""Search for a shift of a reference whose motion is unknown, by cross-correlation at low resolution."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from imgu_ros.errors import NoConsensus
from imgu_ros.image.frame_image import FrameImage
from imgu_ros.image.raw_samples import Singles
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TemplateOctave
from imgu_ros.types import Image, Matrix3, Points
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.projective.transform import local_jacobian
from imgu_ros.vision.scale_space.pyramid import PixelScaling

#: Size at which the reference is compared: small enough to try every shift, large enough to be distinctive. Measured:
#: benchmarks/thresholds.py, study reach.
_SIDE_PX = 40
#: Smallest correlation of the best shift. Measured: benchmarks/thresholds.py, study reach.
_MIN_SIMILARITY = 0.3


def shifted_homography(
    frame: FrameImage, reference: Reference, H: Matrix3, camera: Camera | None, reach_px: float
) -> Matrix3:
    """Move a homography by the shift in the reference's plane at which the frame is most similar to the reference.

    Parameters
    ----------
    frame : the frame's image
    reference : whose templates are compared
    H : H_image_template in ideal px, correct but for a shift
    camera : intrinsics when the lens distorts; else None
    reach_px : longest shift, raw px

    Returns
    -------
    H_image_template in ideal px, to about a pixel of the low resolution

    Raises
    ------
    NoConsensus
        If nothing within `reach_px` is similar to the reference.
    """
    octave = _small(reference.templates[frame.is_linear])
    image = octave.level.image
    height, width = image.shape
    frame_from_octave = H @ octave.scaling.full_from_reduced
    centre = np.array([[(width - 1) / 2, (height - 1) / 2]])
    pixel = math.sqrt(abs(float(np.linalg.det(local_jacobian(frame_from_octave, centre)[0]))))
    halvings = min(max(round(math.log2(max(pixel, 1e-9))), 0), frame.most_halvings)
    # No farther than the reference's own size: the perspective is another one there.
    room_x, room_y = (min(math.ceil(reach_px / pixel) + 1, side) for side in (width, height))
    from_first = frame_from_octave @ np.array([[1, 0, -room_x], [0, 1, -room_y], [0, 0, 1]])
    seen = _seen(frame, halvings, from_first, camera, (width + 2 * room_x, height + 2 * room_y))
    similarity: Singles = np.asarray(cv2.matchTemplate(seen, image, cv2.TM_CCOEFF_NORMED), np.float32)
    _, best, _, (column, row) = cv2.minMaxLoc(similarity)
    if not _MIN_SIMILARITY < best <= 1.001:
        raise NoConsensus(f"track: nothing within {reach_px:.0f} px looks like the target ({best:.2f})")
    dx, dy = _between(similarity[row], column), _between(similarity[:, column], row)
    shift = np.array([[1, 0, column + dx - room_x], [0, 1, row + dy - room_y], [0, 0, 1]], np.float64)
    return np.asarray(frame_from_octave @ shift @ np.linalg.inv(octave.scaling.full_from_reduced), np.float64)


def _seen(frame: FrameImage, halvings: int, H: Matrix3, camera: Camera | None, size: tuple[int, int]) -> Image:
    """Return the halved frame as seen through H, ideal px from px of the result, which is (width, height) px large."""
    halved, scaling = frame.halved(halvings), PixelScaling(2.0**halvings)
    right, bottom = size[0] - 1, size[1] - 1
    w = H[2] @ np.array([[0, right, right, 0], [0, 0, bottom, bottom], [1, 1, 1, 1]])
    if camera is None and w.min() > 1e-3 * w.max():
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return cv2.warpPerspective(
            halved, scaling.reduced_from_full @ H, size, flags=flags, borderMode=cv2.BORDER_REPLICATE
        )
    x, y = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    at = np.stack((x.ravel(), y.ravel(), np.ones(x.size))).T @ H.T
    ahead = at[:, 2] > 1e-3 * at[:, 2].max()
    xy: Points = np.asarray(at[:, :2] / np.where(ahead, at[:, 2], 1.0)[:, None], np.float64)
    if camera is not None:
        # The lens model is valid near the image only.
        beyond = 2 * max(frame.shape)
        xy = camera.raw_pixels(np.clip(xy, -beyond, beyond))
    places = np.clip(scaling.from_full_unchecked(xy), -30000, 30000).astype(np.float32)
    places[~ahead] = -30000
    x_map, y_map = (places[:, i].reshape(x.shape) for i in (0, 1))
    return cv2.remap(halved, x_map, y_map, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _between(line: Singles, highest: int) -> float:
    """Return by how much the vertex of the parabola about the highest value lies beside it."""
    if not 0 < highest < len(line) - 1:
        return 0.0
    before, top, after = line[highest - 1 : highest + 2].tolist()
    curved = 2 * top - before - after
    return (after - before) / (2 * curved) if curved > 0 else 0.0


def _small(octaves: Sequence[TemplateOctave]) -> TemplateOctave:
    """Return the octave whose shorter side is nearest to the one that is compared."""

    def off(octave: TemplateOctave) -> float:
        return abs(math.log(min(octave.level.image.shape) / _SIDE_PX))

    return min(octaves, key=off)
