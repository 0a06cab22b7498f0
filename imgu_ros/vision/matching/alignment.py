"""Patches of a picture found in another by inverse compositional Lucas-Kanade (Baker & Matthews 2004, section 3.2).

Of each patch T of the first picture the part that does not depend on the second is worked out once. The second picture
is sampled where a warp W says that the patch's pixels are; with gain and offset of the light it is

    I(W(x)) = a T(x + d) + b = a T + b + a d . grad T,

linear in (a, b, a d): the least-squares solution is one small matrix times the samples. The displacement d is in the
first picture's pixels: the patch's centre c is seen at W(c - d).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.types import Floats, Image, Indices, Matrix3, Points, as_image, as_matrix, as_points

#: Smallest eigenvalue of a patch's normal matrix, scaled to a unit diagonal: below, it is flat or one straight edge.
_WEAKEST = 1e-3
#: Grey levels (standard deviation) below which a patch has no contrast.
_FLAT = 0.5
#: Coordinates beyond this are no places in a picture; `remap` takes 16-bit ones.
_FARTHEST = 30000.0


@dataclass(frozen=True, slots=True, eq=False)
class Displacements:
    """What comparing patches with samples of another picture tells.

    Attributes
    ----------
    xy : (N, 2) px of the first picture: where samples would have to be taken from, relative to where they were
    similarity : (N,) -1 to 1: correlation of samples and patch, both without their means, as far as the patch's own
        contrast explains the samples; 0 where the patch or the samples are flat
    """

    xy: Points
    similarity: Floats


@dataclass(frozen=True, slots=True, eq=False)
class LocalBend:
    """How a lens bends the plane of the picture about N points; (N, 2), (N, 2) px and (N, 2, 2)."""

    straight: Points
    bent: Points
    by_straight: Floats


class PatchBank:
    """Square patches of a picture, each made ready for comparison when it is first asked for.

    Parameters
    ----------
    image : (H, W) uint8, uint16 or float32
    centres : (N, 2) px, rounded to whole pixels; those too near the border for a patch are left out
    window_px : side of a patch, odd, at least 5

    Attributes
    ----------
    centres : (M, 2) px, of the patches that fit
    window_px : side of a patch

    Raises
    ------
    ShapeError
        If the image or the centres are not as said, or the window is even or smaller than 5.
    """

    def __init__(self, image: Image, centres: ArrayLike, window_px: int) -> None:
        if window_px < 5 or window_px % 2 == 0:
            raise ShapeError(f"window_px: {window_px!r}; need an odd number, at least 5")
        self._image = as_image(image)
        height, width = self._image.shape
        # One pixel more on each side, for the derivative.
        rim = window_px // 2 + 1
        whole = np.rint(as_points(centres, "centres"))
        fits = (whole >= rim).all(axis=1) & (whole < np.array((width, height)) - rim).all(axis=1)
        self.centres: Points = np.ascontiguousarray(whole[fits])
        self.window_px = window_px
        count, area = len(self.centres), window_px**2
        self._solvers = np.empty((count, 4, area), np.float32)
        self._contrast = np.zeros(count, np.float32)
        self._ready = np.zeros(count, bool)
        offset = np.arange(-(window_px // 2), window_px // 2 + 1, dtype=np.float32)
        self._x, self._y = (np.ascontiguousarray(grid.ravel()) for grid in np.meshgrid(offset, offset))

    def sampled(self, picture: Image, H: ArrayLike, chosen: Indices, bend: LocalBend | None = None) -> Image:
        """Sample another picture where patches should be in it, bilinearly.

        Parameters
        ----------
        picture : (H, W) uint8, uint16 or float32
        H : (3, 3) px of the picture from px of the patches' one
        chosen : (N,) which patches
        bend : of the lens about the chosen centres as H maps them; None: none

        Returns
        -------
        (N, window_px^2), the picture's data type; beyond the border the picture's rim goes on

        Raises
        ------
        DegenerateConfiguration
            If H maps a centre to infinity.
        """
        H = as_matrix(H, (3, 3), "H")
        at = self.centres[chosen] @ H[:, :2].T + H[:, 2]
        if not len(at):
            return np.zeros((0, self.window_px**2), picture.dtype)
        scale = float(at[:, 2].mean())
        if not scale > 0 or not at[:, 2].min() > 1e-6 * scale:
            raise DegenerateConfiguration("H: a patch would lie behind the camera; need all in front")
        x, y = self._places(at / scale, H / scale)
        if bend is not None:
            x, y = _bent(x, y, bend)
        np.clip(x, -_FARTHEST, _FARTHEST, out=x)
        np.clip(y, -_FARTHEST, _FARTHEST, out=y)
        return cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    def displacements(self, samples: Image, chosen: Indices) -> Displacements:
        """Compare patches with samples (N, window_px^2) that `sampled` took for the `chosen` ones, (N,)."""
        area = self.window_px**2
        if samples.shape != (len(chosen), area):
            raise ShapeError(f"samples: shape {samples.shape}; need {(len(chosen), area)}")
        self._prepare(chosen)
        seen = np.asarray(samples, np.float32)
        # Sums of squares of numbers about a mean far from 0 would lose digits.
        seen = seen - seen.mean(axis=1, keepdims=True)
        gain, _, a_dx, a_dy = (self._solvers[chosen] @ seen[:, :, None])[:, :, 0].T
        variance = np.einsum("np,np->n", seen, seen)
        contrast = self._contrast[chosen]
        usable = (variance > area * _FLAT**2) & (contrast > 0) & (np.abs(gain) * contrast > 1e-3)
        safe = np.where(usable, gain, 1.0)
        xy = np.stack((a_dx / safe, a_dy / safe), axis=1).astype(np.float64)
        similarity = np.where(usable, gain * contrast / np.sqrt(np.where(usable, variance, 1.0)), 0.0)
        xy[~usable] = 0.0
        return Displacements(xy, np.clip(similarity, -1.0, 1.0).astype(np.float64))

    def _places(self, at: Floats, H: Matrix3) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return where the patches' pixels come to lie, x and y, (N, window_px^2) each."""
        single = H.astype(np.float32)
        start = at.astype(np.float32)[:, :, None]
        x, y, w = (start[:, row] + (single[row, 0] * self._x + single[row, 1] * self._y)[None] for row in range(3))
        # A patch far larger than its distance to the vanishing line reaches beyond it: it is no use, but no error.
        np.maximum(w, 1e-6, out=w)
        np.divide(x, w, out=x)
        np.divide(y, w, out=y)
        return x, y

    def _prepare(self, chosen: Indices) -> None:
        missing = chosen[~self._ready[chosen]]
        if not len(missing):
            return
        rim = self.window_px // 2 + 1
        side = self.window_px + 2
        corner = self.centres[missing].astype(np.intp) - rim
        views = np.lib.stride_tricks.sliding_window_view(self._image, (side, side))
        patches = views[corner[:, 1], corner[:, 0]].astype(np.float64)
        inner = patches[:, 1:-1, 1:-1]
        columns = np.empty((len(missing), self.window_px**2, 4))
        flat = (len(missing), -1)
        columns[:, :, 0] = (inner - inner.mean(axis=(1, 2), keepdims=True)).reshape(flat)
        columns[:, :, 1] = 1.0
        columns[:, :, 2] = ((patches[:, 1:-1, 2:] - patches[:, 1:-1, :-2]) / 2).reshape(flat)
        columns[:, :, 3] = ((patches[:, 2:, 1:-1] - patches[:, :-2, 1:-1]) / 2).reshape(flat)
        norms = np.sqrt((columns**2).sum(axis=1))
        textured = norms[:, 0] > _FLAT * self.window_px
        unit = columns / np.where(norms > 0, norms, 1.0)[:, None, :]
        normal = unit.transpose(0, 2, 1) @ unit
        textured &= np.linalg.eigvalsh(normal)[:, 0] > _WEAKEST
        normal[~textured] = np.eye(4)
        solvers = np.linalg.solve(normal, unit.transpose(0, 2, 1)) / np.where(norms > 0, norms, 1.0)[:, :, None]
        self._solvers[missing] = solvers
        self._contrast[missing] = np.where(textured, norms[:, 0], 0.0)
        self._ready[missing] = True


def _bent(
    x: NDArray[np.float32], y: NDArray[np.float32], bend: LocalBend
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    straight, bent, by = (a.astype(np.float32) for a in (bend.straight, bend.bent, bend.by_straight))
    x = x - straight[:, 0, None]
    y = y - straight[:, 1, None]
    return (
        bent[:, 0, None] + by[:, 0, 0, None] * x + by[:, 0, 1, None] * y,
        bent[:, 1, None] + by[:, 1, 0, None] * x + by[:, 1, 1, None] * y,
    )
