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
from imgu_ros.types import Floats, Image, Indices, Matrix3, Points, as_image, as_points
from imgu_ros.vision.estimation.covariance import window_correlation
from imgu_ros.vision.matching.sheet import Sheet
from imgu_ros.vision.projective.increments import PlaneMotion

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
        self._last: Patches | None = None

    def select(self, chosen: Indices) -> Patches:
        """Return some patches, (N,) their indices, ready for comparison; the same ones again cost nothing."""
        if self._last is None or not np.array_equal(self._last.chosen, chosen):
            self._prepare(chosen)
            self._last = Patches(
                chosen, self.centres[chosen], self.window_px, self._solvers[chosen], self._contrast[chosen]
            )
        return self._last

    def _prepare(self, chosen: Indices) -> None:
        missing = chosen[~self._ready[chosen]]
        if not len(missing):
            return
        area = self.window_px**2
        rim = self.window_px // 2 + 1
        side = self.window_px + 2
        corner = self.centres[missing].astype(np.intp) - rim
        views = np.lib.stride_tricks.sliding_window_view(self._image, (side, side))
        patches = views[corner[:, 1], corner[:, 0]].astype(np.float64)
        columns = np.stack(
            (
                patches[:, 1:-1, 1:-1].reshape(-1, area),
                ((patches[:, 1:-1, 2:] - patches[:, 1:-1, :-2]) / 2).reshape(-1, area),
                ((patches[:, 2:, 1:-1] - patches[:, :-2, 1:-1]) / 2).reshape(-1, area),
            ),
            axis=2,
        )
        # Without their means the columns know nothing of the offset: it need not be solved for.
        columns -= columns.mean(axis=1, keepdims=True)
        norms = np.sqrt((columns**2).sum(axis=1))
        textured = norms[:, 0] > _FLAT * self.window_px
        safe = np.where(norms > 0, norms, 1.0)
        unit = columns / safe[:, None, :]
        normal = unit.transpose(0, 2, 1) @ unit
        textured &= np.linalg.eigvalsh(normal)[:, 0] > _WEAKEST
        normal[~textured] = np.eye(3)
        self._solvers[missing, :3] = np.linalg.solve(normal, unit.transpose(0, 2, 1)) / safe[:, :, None]
        self._solvers[missing, 3] = 1 / area
        self._contrast[missing] = np.where(textured, norms[:, 0], 0.0)
        self._ready[missing] = True


class Patches:
    """Some of a bank's patches; not for several threads at once, as the room for intermediate results is kept.

    Parameters
    ----------
    chosen : (N,) their indices
    centres : (N, 2) px
    window_px : side of a patch
    solvers : (N, 4, window_px^2) from samples to gain, gain times displacement (x, y), and mean
    contrast : (N,) norm of the patch without its mean; 0 where it cannot be compared
    """

    def __len__(self) -> int:
        return len(self.chosen)

    def __init__(
        self,
        chosen: Indices,
        centres: Points,
        window_px: int,
        solvers: NDArray[np.float32],
        contrast: NDArray[np.float32],
    ) -> None:
        self.chosen = chosen
        self.centres = centres
        self._side = window_px
        self._area = window_px**2
        self._overlap: Floats | None = None
        self._motions: dict[bool, PlaneMotion] = {}
        self._solvers = solvers
        self._contrast = contrast
        offset = np.arange(-(window_px // 2), window_px // 2 + 1, dtype=np.float32)
        self._x, self._y = (np.ascontiguousarray(grid.ravel()) for grid in np.meshgrid(offset, offset))
        self._places = np.empty((3, len(chosen), self._area), np.float32)
        self._seen = np.empty((len(chosen), self._area), np.float32)

    def sampled(
        self,
        picture: Image,
        H: Matrix3,
        bend: LocalBend | None = None,
        sheet: Sheet | None = None,
        first: int | None = None,
    ) -> Image:
        """Sample another picture where the patches should be in it, bilinearly.

        Parameters
        ----------
        picture : (H, W) uint8, uint16 or float32
        H : (3, 3) px of the picture from px of the patches' one
        bend : of the lens about the centres as H maps them; None: none
        sheet : how `picture` was cut to one square for each patch; None: it was not
        first : only so many patches; None: all

        Returns
        -------
        (N, window_px^2), the picture's data type; beyond the border the picture's rim goes on

        Raises
        ------
        DegenerateConfiguration
            If H maps a centre to infinity.
        """
        at = self.centres[:first] @ H[:, :2].T + H[:, 2]
        if not len(at):
            return np.zeros((0, self._area), picture.dtype)
        scale = float(at[:, 2].mean())
        if not scale > 0 or not at[:, 2].min() > 1e-6 * scale:
            raise DegenerateConfiguration("H: a patch would lie behind the camera; need all in front")
        x, y, w = self._places[:, :first]
        single = (H / scale).astype(np.float32)
        start = (at / scale).astype(np.float32)
        for row, places in enumerate((x, y, w)):
            np.add(start[:, row, None], single[row, 0] * self._x + single[row, 1] * self._y, out=places)
        # A patch far larger than its distance to the vanishing line reaches beyond it: it is no use, but no error.
        np.maximum(w, 1e-6, out=w)
        np.divide(x, w, out=x)
        np.divide(y, w, out=y)
        if bend is not None:
            _bend(x, y, bend)
        if sheet is not None:
            sheet.move(x, y)
        np.clip(x, -_FARTHEST, _FARTHEST, out=x)
        np.clip(y, -_FARTHEST, _FARTHEST, out=y)
        return cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    @property
    def overlap(self) -> Floats:
        """The share of its pixels that each patch shares with each other one, (N, N); worked out once."""
        if self._overlap is None:
            self._overlap = window_correlation(self.centres, self._side)
        return self._overlap

    def motions(self, affine: bool) -> PlaneMotion:
        """Return what fits motions to the patches' displacements; made once."""
        if affine not in self._motions:
            self._motions[affine] = PlaneMotion(self.centres, affine)
        return self._motions[affine]

    def displacements(self, samples: Image) -> Displacements:
        """Compare the patches with samples, (N, window_px^2), that `sampled` took for them, or for the first N."""
        first = len(samples)
        if first > len(self._seen) or samples.shape[1:] != self._seen.shape[1:]:
            raise ShapeError(f"samples: shape {samples.shape}; need at most {self._seen.shape}")
        seen, contrast = self._seen[:first], self._contrast[:first]
        np.copyto(seen, samples)
        gain, a_dx, a_dy, mean = (self._solvers[:first] @ seen[:, :, None])[:, :, 0].T
        variance = np.einsum("np,np->n", seen, seen) - self._area * mean**2
        usable = (variance > self._area * _FLAT**2) & (contrast > 0) & (np.abs(gain) * contrast > 1e-3)
        inverse = usable / np.where(usable, gain, 1.0)
        xy = np.stack((a_dx * inverse, a_dy * inverse), axis=1).astype(np.float64)
        similarity = usable * gain * contrast / np.sqrt(np.where(usable, variance, 1.0))
        return Displacements(xy, np.clip(similarity, -1.0, 1.0).astype(np.float64))


def _bend(x: NDArray[np.float32], y: NDArray[np.float32], bend: LocalBend) -> None:
    """Bend places about their centres, in place."""
    straight, bent, by = (a.astype(np.float32) for a in (bend.straight, bend.bent, bend.by_straight))
    x -= straight[:, 0, None]
    y -= straight[:, 1, None]
    bent_x = bent[:, 0, None] + by[:, 0, 0, None] * x + by[:, 0, 1, None] * y
    y *= by[:, 1, 1, None]
    y += bent[:, 1, None] + by[:, 1, 0, None] * x
    x[:] = bent_x
