# SPDX-License-Identifier: Apache-2.0
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
from numpy.typing import NDArray

from imgu_ros.arguments import shown_value
from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.types import Floats, Image, Indices, Matrix3, Points, as_image, as_matrix
from imgu_ros.vision.estimation.covariance import window_correlation
from imgu_ros.vision.matching.patch_atlas import PatchAtlas
from imgu_ros.vision.projective.plane_motion import PlaneMotion

#: Grey levels (standard deviation) below which a patch has no contrast.
FLAT = 0.5
#: Interpolation mixes neighbouring pixels: two patches share noise a little beyond the samples that they share.
#: Measured: benchmarks/thresholds.py, study covariance.
_SAMPLED_BEYOND_PX = 1
#: Of a patch's contrast, in grey levels times pixels, what must be seen again.
_LEAST_EXPLAINED = 1e-3
#: Coordinates beyond this are no places in a picture; `remap` takes 16-bit ones, and pictures of no more pixels.
_FARTHEST = 30000.0
#: Longest side of an image: `remap` takes 16-bit coordinates.
LONGEST_PX = 32000
#: The third coordinate of a patch's centre, H scaled so that its largest number is 1: below, it lies at infinity.
_NEAREST = 1e-12
#: Grey levels of float pictures are smaller: their squares are floats.
_BRIGHTEST = 1e9
#: Coordinates as large as this come from a lens model that has lost its way.
_BEYOND = 1e15


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
class LocalDistortion:
    """How a lens bends the plane of the picture about N points.

    Attributes
    ----------
    straight : (N, 2) px, the points as they would be seen without a lens
    bent : (N, 2) px, as they are seen
    by_straight : (N, 2, 2) derivative of `bent`
    """

    straight: Points
    bent: Points
    by_straight: Floats


@dataclass(frozen=True, slots=True, eq=False)
class PreparedPatches:
    """N patches with what does not depend on the picture that they are compared with.

    Attributes
    ----------
    chosen : (N,) their indices
    centres : (N, 2) px
    window_px : side of a patch
    solvers : (N, 4, window_px^2) from samples to gain, gain times displacement (x, y), and mean
    contrast : (N,) norm of the patch without its mean; 0 where it cannot be compared
    """

    chosen: Indices
    centres: Points
    window_px: int
    solvers: NDArray[np.float32]
    contrast: NDArray[np.float32]


class Patches:
    """Some of a bank's patches, from `PatchBank.select`.

    Not for several threads at once, as the room for intermediate results is kept.

    Attributes
    ----------
    chosen : (N,) their indices in the bank
    centres : (N, 2) px
    bounds : left, top, right and bottom of the centres, px; empty without patches
    """

    def __init__(self, prepared: PreparedPatches) -> None:
        self.chosen = prepared.chosen
        self.centres = prepared.centres
        self.bounds: tuple[float, ...] = ()
        if len(self.centres):
            self.bounds = (*self.centres.min(axis=0).tolist(), *self.centres.max(axis=0).tolist())
        self._side = prepared.window_px
        self._area = prepared.window_px**2
        self._overlap: Floats | None = None
        self._motions: dict[bool, PlaneMotion] = {}
        self._solvers = prepared.solvers
        self._contrast = prepared.contrast
        half = prepared.window_px // 2
        offset = np.arange(-half, half + 1, dtype=np.float32)
        x, y = (grid.ravel() for grid in np.meshgrid(offset, offset))
        self._half = half
        self._offsets = np.stack((np.ones_like(x), x, y))
        self._homogeneous = np.vstack((self.centres.T, np.ones(len(self.centres))))
        self._places = np.empty((3 * len(self.chosen), self._area), np.float32)
        self._seen = np.empty((len(self.chosen), self._area), np.float32)

    def __len__(self) -> int:
        return len(self.chosen)

    def sampled(
        self,
        picture: Image,
        H: Matrix3,
        bend: LocalDistortion | None = None,
        sheet: PatchAtlas | None = None,
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
        ShapeError
            If the picture, H, the bend or the sheet are not as said, or there are fewer patches than `first`.
        """
        picture = as_grey(picture, "picture")
        H = as_matrix(H, (3, 3), "H")
        if first is None:
            first = len(self.chosen)
        elif not (isinstance(first, int | np.integer) and first is not True and 0 <= first <= len(self.chosen)):
            raise ShapeError(f"first: {shown_value(first)}; need 0 to {len(self.chosen)}")
        if not isinstance(bend, LocalDistortion | None) or not isinstance(sheet, PatchAtlas | None):
            raise ShapeError(
                f"bend, sheet: {shown_value(bend)}, {shown_value(sheet)}; "
                "need a LocalDistortion or None, a PatchAtlas or None"
            )
        if sheet is not None and (len(sheet.origins) < first or picture.shape[1] != sheet.side):
            raise ShapeError(
                f"sheet: {len(sheet.origins)} squares of {sheet.side} px, picture {picture.shape}; "
                f"need at least {first}, of its width"
            )
        if not first:
            return np.zeros((0, self._area), picture.dtype)
        numerators, plain = self._numerators(H, first, bend, sheet)
        places = np.matmul(numerators, self._offsets, out=self._places[: 3 * first])
        x, y, w = places[:first], places[first : 2 * first], places[2 * first :]
        if not plain:
            # A patch far larger than its distance to the vanishing line reaches beyond it: no use, but no error.
            np.maximum(w, 1e-6, out=w)
        np.divide(x, w, out=x)
        np.divide(y, w, out=y)
        if not plain:
            np.clip(x, -_FARTHEST, _FARTHEST, out=x)
            np.clip(y, -_FARTHEST, _FARTHEST, out=y)
        return cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    def _numerators(
        self, H: Matrix3, first: int, bend: LocalDistortion | None, sheet: PatchAtlas | None
    ) -> tuple[NDArray[np.float32], bool]:
        """Return the homogeneous places of the `first` patches' pixels as what is linear in (1, offset x, offset y).

        Returns
        -------
        (3 N, 3): the first N for x, then those for y and for w, which is 1 on average; and whether all places are near
        the picture, none near infinity
        """
        # Its largest number may be as large or small as floats are.
        H = H / (float(np.abs(H).max()) or 1.0)
        at = H @ self._homogeneous[:, :first]
        scale, nearest = float(at[2].sum()) / first, float(at[2].min())
        if not scale > _NEAREST or not nearest > 1e-6 * scale:
            raise DegenerateConfiguration("H: a patch would lie behind the camera; need all in front")
        H, at, nearest = H / scale, at / scale, nearest / scale
        linear = np.empty((3, first, 3))
        linear[:, :, 0] = at
        linear[:, :, 1:] = H[:, None, :2]
        reach = self._half * float(np.abs(H[2, :2]).sum())
        plain = nearest > 2 * reach
        x, y, w = linear
        if bend is not None:
            start, end, by = _plain_bend(bend, first)
            # end + by ((x, y) / w - start), times w
            end = end - (by @ start[:, :, None])[:, :, 0]
            bent_x = by[:, 0, :1] * x + by[:, 0, 1:] * y + end[:, :1] * w
            linear[1] = by[:, 1, :1] * x + by[:, 1, 1:] * y + end[:, 1:] * w
            linear[0] = bent_x
        # Where w is at least half of what it is at the centre, places are at most twice as far away as these.
        farthest = np.abs(linear[:2]).max() * (1 + 2 * self._half) / nearest
        if sheet is not None:
            x += sheet.shift[:first, :1] * w
            y += sheet.shift[:first, 1:] * w
        return linear.astype(np.float32).reshape(-1, 3), plain and 2 * farthest < _FARTHEST

    @property
    def overlap(self) -> Floats:
        """The share of its pixels' noise that each patch shares with each other one, (N, N); worked out once."""
        if self._overlap is None:
            self._overlap = window_correlation(self.centres, self._side + _SAMPLED_BEYOND_PX)
        return self._overlap

    def motions(self, affine: bool) -> PlaneMotion:
        """Return what fits motions to the patches' displacements; made once."""
        if affine not in self._motions:
            self._motions[affine] = PlaneMotion(self.centres, affine)
        return self._motions[affine]

    def displacements(self, samples: Image) -> Displacements:
        """Compare the patches with samples of another picture.

        Parameters
        ----------
        samples : (N, window_px^2) uint8, uint16 or float32, that `sampled` took for all patches, or for the first N

        Raises
        ------
        ShapeError
            If they are not as said.
        """
        if not isinstance(samples, np.ndarray) or samples.ndim != 2 or samples.shape[1] != self._area:
            raise ShapeError(f"samples: {getattr(samples, 'shape', type(samples).__name__)}; need (N, {self._area})")
        first = len(samples)
        if first > len(self._seen):
            raise ShapeError(f"samples: shape {samples.shape}; need at most {self._seen.shape}")
        if first:
            samples = as_grey(samples, "samples")
        seen, contrast = self._seen[:first], self._contrast[:first]
        np.copyto(seen, samples)
        told = (self._solvers[:first] @ seen[:, :, None])[:, :, 0]
        gain, mean = told[:, 0], told[:, 3]
        variance = np.einsum("np,np->n", seen, seen) - self._area * mean * mean
        explained = gain * contrast
        usable = (variance > self._area * FLAT**2) & (np.abs(explained) > _LEAST_EXPLAINED)
        if not usable.all():
            told[~usable], variance[~usable], explained[~usable] = (1, 0, 0, 0), 1, 0
        xy = told[:, 1:3] / gain[:, None]
        similarity = explained / np.sqrt(variance)
        # np.clip takes five times as long.
        np.minimum(np.maximum(similarity, -1.0, out=similarity), 1.0, out=similarity)
        return Displacements(xy.astype(np.float64), similarity.astype(np.float64))


def as_grey(image: Image, name: str) -> Image:
    """Return an image that OpenCV can sample, its squares floats: (H, W) uint8, uint16 or float32.

    Raises
    ------
    ShapeError
        If it is another array, or larger; `name` is what the error calls it.
    """
    image = as_image(image, name)
    if max(image.shape) > LONGEST_PX:
        raise ShapeError(f"{name}: shape {image.shape}; need at most {LONGEST_PX} px a side")
    if image.dtype.kind == "f" and not np.abs(image).max() < _BRIGHTEST:
        raise ShapeError(f"{name}: up to {np.abs(image).max():g}; need less than {_BRIGHTEST:g}")
    return image


def _plain_bend(bend: LocalDistortion, count: int) -> tuple[Points, Points, Floats]:
    """Return a bend's arrays, checked.

    Raises
    ------
    ShapeError
        If they are of another number of points, not finite, or no places in a picture.
    """
    straight, bent = as_matrix(bend.straight, (count, 2), "straight"), as_matrix(bend.bent, (count, 2), "bent")
    by = as_matrix(bend.by_straight, (count, 2, 2), "by_straight")
    if not all(np.abs(a).max() < _BEYOND for a in (straight, bent, by)):
        raise ShapeError(f"bend: numbers of {_BEYOND:g} and more; need places in a picture")
    return straight, bent, by
