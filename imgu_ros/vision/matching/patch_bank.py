# SPDX-License-Identifier: Apache-2.0
"""Alignment of image patches by inverse compositional Lucas-Kanade (Baker & Matthews 2004, section 3.2).

For each patch T of an image, everything that does not depend on the second image is computed once. The second image is
sampled where a warp W maps the patch's pixels; with gain and offset of the light it is

    I(W(x)) = a T(x + d) + b = a T + b + a d . grad T,

linear in (a, b, a d): the least-squares solution is one small matrix times the samples. The displacement d is in px of
the first image: the patch's centre c is seen at W(c - d).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgu_ros.arguments import as_integer, shown_value
from imgu_ros.errors import DegenerateConfiguration, ShapeError
from imgu_ros.types import Floats, Image, Indices, Matrix3, Points, as_image, as_matrix, as_points
from imgu_ros.vision.matching.patch_atlas import LONGEST_PX, PatchAtlas
from imgu_ros.vision.projective.plane_motion import PlaneMotion

#: Grey levels (standard deviation) below which a patch has no contrast.
_FLAT = 0.5
#: Smallest eigenvalue of a patch's normal matrix, scaled to a unit diagonal: below, it is flat or one straight edge.
_WEAKEST = 1e-3
#: The samples of a wider patch, 171^2, would not fit one row of `cv2.remap`, which has at most 32767.
_WIDEST_WINDOW_PX = 171
#: Interpolation mixes neighbouring pixels: two patches share noise a little beyond the samples that they share.
#: Measured: benchmarks/thresholds.py, study covariance.
_SAMPLED_BEYOND_PX = 1
#: Smallest contrast, in grey levels times pixels, of what a patch explains of the samples.
_LEAST_EXPLAINED = 1e-3
#: Largest coordinates of samples: `remap` takes 16-bit ones.
_FARTHEST = 30000.0
#: The third coordinate of a patch's centre, H scaled so that its largest number is 1: below, it lies at infinity.
_NEAREST = 1e-12
#: Grey levels of float images are smaller: their squares are finite.
_BRIGHTEST = 1e9
#: Larger coordinates come from a lens model outside its range.
_LARGEST_DISTORTED = 1e15


@dataclass(frozen=True, slots=True, eq=False)
class Displacements:
    """The comparison of patches with samples of another image.

    Attributes
    ----------
    xy : (N, 2) px of the first image: displacement of the samples from where they should have been taken
    similarity : (N,) -1 to 1: correlation of samples and patch, both without their means, as far as the patch's own
        contrast explains the samples; 0 where the patch or the samples are flat
    """

    xy: Points
    similarity: Floats


@dataclass(frozen=True, slots=True, eq=False)
class LocalDistortion:
    """Lens distortion about N points, to first order.

    Attributes
    ----------
    straight : (N, 2) px, the points as seen without a lens
    distorted : (N, 2) px, as seen through the lens
    by_straight : (N, 2, 2) derivative of `distorted`
    """

    straight: Points
    distorted: Points
    by_straight: Floats


class PatchBank:
    """Square patches of an image, each prepared for comparison when it is first selected.

    Parameters
    ----------
    image : (H, W) uint8, uint16 or float32; in grey levels: a contrast of less than one is none
    centres : (N, 2) px, rounded to whole pixels; those too near the border for a patch are left out
    window_px : side of a patch, odd, 5 to 171

    Attributes
    ----------
    centres : (M, 2) px, of the patches that fit
    homogeneous : (3, M) the same, one a column, with a 1
    window_px : side of a patch

    Raises
    ------
    ShapeError
        If the image, the centres or the window are not as said.

    Examples
    --------
    An image, and another one that shows it 3 px farther right; `H` says 2 px:

    >>> y, x = np.mgrid[:40, :40]
    >>> image = (100 + 50 * np.sin(x / 4) * np.cos(y / 3)).astype(np.float32)
    >>> moved = np.roll(image, 3, axis=1)
    >>> patches = PatchBank(image, [[12, 12], [20, 25], [25, 14]], 11).select(np.array([0, 2]))
    >>> H = np.array([[1, 0, 2], [0, 1, 0], [0, 0, 1]])
    >>> seen = patches.displacements(patches.sampled(moved, H))
    >>> (seen.xy.round(1) + 0.0).tolist(), bool((seen.similarity > 0.9).all())
    ([[-1.0, 0.0], [-1.0, 0.0]], True)
    """

    def __init__(self, image: Image, centres: ArrayLike, window_px: int) -> None:
        window_px = as_integer(window_px, "window_px")
        if not 5 <= window_px <= _WIDEST_WINDOW_PX or window_px % 2 != 1:
            raise ShapeError(f"window_px: {window_px!r}; need an odd number, 5 to {_WIDEST_WINDOW_PX}")
        self._image = as_grey(image, "image")
        height, width = self._image.shape
        # One pixel more on each side, for the derivative.
        rim = window_px // 2 + 1
        whole = np.rint(as_points(centres, "centres"))
        fits = (whole >= rim).all(axis=1) & (whole < np.array((width, height)) - rim).all(axis=1)
        self.centres: Points = np.ascontiguousarray(whole[fits])
        self.homogeneous: Floats = np.vstack((self.centres.T, np.ones(len(self.centres))))
        self.window_px = window_px
        count, area = len(self.centres), window_px**2
        #: From samples to gain, gain times displacement (x, y), and mean; norm of a patch without its mean, 0 where it
        #: cannot be compared; pixels of a patch as (1, x, y) from its centre, one a column.
        self.solvers = np.empty((count, 4, area), np.float32)
        self.contrast = np.zeros(count, np.float32)
        offset = np.arange(-(window_px // 2), window_px // 2 + 1, dtype=np.float32)
        x, y = np.meshgrid(offset, offset)
        self.offsets = np.stack((np.ones(area, np.float32), x.ravel(), y.ravel()))
        self._ready = np.zeros(count, bool)
        self._last: Patches | None = None

    def select(self, chosen: Indices) -> Patches:
        """Return some patches, prepared for comparison; the last selection is kept.

        Parameters
        ----------
        chosen : (N,) indices of `centres`

        Raises
        ------
        ShapeError
            If they are no integers from 0 to M - 1, or more than a map of OpenCV's has rows.
        """
        if not isinstance(chosen, np.ndarray) or chosen.dtype.kind not in "iu" or chosen.ndim != 1:
            shown = f"{chosen.shape} {chosen.dtype}" if isinstance(chosen, np.ndarray) else type(chosen).__name__
            raise ShapeError(f"chosen: {shown}; need (N,) integers")
        if len(chosen) > LONGEST_PX or (len(chosen) and not 0 <= chosen.min() <= chosen.max() < len(self.centres)):
            raise ShapeError(
                f"chosen: {len(chosen)} from {chosen.min()} to {chosen.max()}; need 0 to {len(self.centres) - 1}"
            )
        # A copy: the caller may change theirs.
        return self.select_unchecked(chosen.astype(np.intp))

    def select_unchecked(self, chosen: Indices) -> Patches:
        """`select` without the checks of its argument, which is kept."""
        if self._last is None or not np.array_equal(self._last.chosen, chosen):
            if not self._ready[chosen].all():
                self._prepare(chosen[~self._ready[chosen]])
            self._last = Patches.unchecked(self, chosen)
        return self._last

    def _prepare(self, missing: Indices) -> None:
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
        # Columns without their means are independent of the offset: it need not be solved for.
        columns -= columns.mean(axis=1, keepdims=True)
        norms = np.sqrt((columns**2).sum(axis=1))
        textured = norms[:, 0] > _FLAT * self.window_px
        safe = np.where(norms > 0, norms, 1.0)
        unit = columns / safe[:, None, :]
        normal = unit.transpose(0, 2, 1) @ unit
        textured &= np.linalg.eigvalsh(normal)[:, 0] > _WEAKEST
        normal[~textured] = np.eye(3)
        self.solvers[missing, :3] = np.linalg.solve(normal, unit.transpose(0, 2, 1)) / safe[:, :, None]
        self.solvers[missing, 3] = 1 / area
        self.contrast[missing] = np.where(textured, norms[:, 0], 0.0)
        self._ready[missing] = True


class Patches:
    """Some of a bank's patches, from `PatchBank.select`. Not thread-safe: buffers of intermediate results are kept.

    Attributes
    ----------
    chosen : (N,) their indices in the bank
    centres : (N, 2) px
    bounds : left, top, right and bottom of the centres, px; empty without patches
    """

    @classmethod
    def unchecked(cls, bank: PatchBank, chosen: Indices) -> Patches:
        """Return prepared patches of a bank; `PatchBank.select` calls this."""
        patches = cls.__new__(cls)
        patches.chosen = chosen
        patches.centres = centres = bank.centres[chosen]
        patches.bounds = (*centres.min(axis=0).tolist(), *centres.max(axis=0).tolist()) if len(chosen) else ()
        patches._window_px, patches._area, patches._offsets = bank.window_px, bank.window_px**2, bank.offsets
        patches._solvers, patches._contrast = bank.solvers[chosen], bank.contrast[chosen]
        patches._homogeneous = bank.homogeneous[:, chosen]
        patches._places = np.empty((3 * len(chosen), patches._area), np.float32)
        patches._seen = np.empty((len(chosen), patches._area), np.float32)
        patches._overlap, patches._motions = None, {}
        return patches

    chosen: Indices
    centres: Points
    bounds: tuple[float, ...]
    _window_px: int
    _area: int
    _offsets: NDArray[np.float32]
    _solvers: NDArray[np.float32]
    _contrast: NDArray[np.float32]
    _homogeneous: Floats
    _places: NDArray[np.float32]
    _seen: NDArray[np.float32]
    _overlap: Floats | None
    _motions: dict[bool, PlaneMotion]

    def __len__(self) -> int:
        return len(self.chosen)

    def sampled(
        self,
        image: Image,
        H: Matrix3,
        distortion: LocalDistortion | None = None,
        atlas: PatchAtlas | None = None,
        first: int | None = None,
    ) -> Image:
        """Sample another image bilinearly where the patches should be in it.

        Parameters
        ----------
        image : (H, W) uint8, uint16 or float32
        H : (3, 3) px of the image from px of the patches' image
        distortion : of the lens about the centres as H maps them; None: none
        atlas : by which `image` was cut to one square for each patch; None: it was not
        first : number of patches; None: all

        Returns
        -------
        (N, window_px^2), the image's data type; beyond the border the outermost pixels are repeated

        Raises
        ------
        DegenerateConfiguration
            If H maps a centre to infinity.
        ShapeError
            If an argument is not as said, or there are fewer patches than `first`.
        """
        image = as_grey(image, "image")
        H = as_matrix(H, (3, 3), "H")
        if first is None:
            first = len(self.chosen)
        elif not (isinstance(first, int | np.integer) and first is not True and 0 <= first <= len(self.chosen)):
            raise ShapeError(f"first: {shown_value(first)}; need 0 to {len(self.chosen)}")
        if not isinstance(distortion, LocalDistortion | None) or not isinstance(atlas, PatchAtlas | None):
            raise ShapeError(
                f"distortion, atlas: {shown_value(distortion)}, {shown_value(atlas)}; "
                "need a LocalDistortion or None, a PatchAtlas or None"
            )
        if atlas is not None and (len(atlas.origins) < first or image.shape[1] != atlas.side):
            raise ShapeError(
                f"atlas: {len(atlas.origins)} squares of {atlas.side} px, image {image.shape}; "
                f"need at least {first}, of its width"
            )
        if not first:
            return np.zeros((0, self._area), image.dtype)
        if distortion is not None:
            distortion = _checked_distortion(distortion, first)
        return self.sampled_unchecked(image, H, distortion, atlas, first)

    def sampled_unchecked(
        self, image: Image, H: Matrix3, distortion: LocalDistortion | None, atlas: PatchAtlas | None, first: int
    ) -> Image:
        """`sampled` without the checks of its arguments; `first` is at least 1."""
        # The largest number of H may be as large or small as floats are.
        H = H / (float(np.abs(H).max()) or 1.0)
        at = H @ self._homogeneous[:, :first]
        scale, nearest = float(at[2].sum()) / first, float(at[2].min())
        if not scale > _NEAREST or not nearest > 1e-6 * scale:
            raise DegenerateConfiguration("H: a patch would lie behind the camera; need all in front")
        H, at, nearest = H / scale, at / scale, nearest / scale
        # Homogeneous coordinates of the pixels, linear in (1, offset x, offset y): x, y, and w, which is 1 on average.
        linear = np.empty((3, first, 3))
        linear[:, :, 0] = at
        linear[:, :, 1:] = H[:, None, :2]
        half = self._window_px // 2
        reach = half * float(np.abs(H[2, :2]).sum())
        x, y, w = linear
        if distortion is not None:
            # distorted + by ((x, y) / w - straight), times w
            by = distortion.by_straight
            end = distortion.distorted - (by @ distortion.straight[:, :, None])[:, :, 0]
            distorted_x = by[:, 0, :1] * x + by[:, 0, 1:] * y + end[:, :1] * w
            linear[1] = by[:, 1, :1] * x + by[:, 1, 1:] * y + end[:, 1:] * w
            linear[0] = distorted_x
        # Where w is at least half of that at the centre, coordinates are at most twice as large as these.
        farthest = np.abs(linear[:2]).max() * (1 + 2 * half) / nearest
        # Whether all pixels are near the image, none near infinity.
        plain = nearest > 2 * reach and 2 * farthest < _FARTHEST
        if atlas is not None:
            x += atlas.shift[:first, :1] * w
            y += atlas.shift[:first, 1:] * w
        places = np.matmul(linear.astype(np.float32).reshape(-1, 3), self._offsets, out=self._places[: 3 * first])
        at_x, at_y, at_w = places[:first], places[first : 2 * first], places[2 * first :]
        if not plain:
            # A patch far larger than its distance to the vanishing line reaches beyond it: of no use, but no error.
            np.maximum(at_w, 1e-6, out=at_w)
        np.divide(at_x, at_w, out=at_x)
        np.divide(at_y, at_w, out=at_y)
        if not plain:
            np.clip(at_x, -_FARTHEST, _FARTHEST, out=at_x)
            np.clip(at_y, -_FARTHEST, _FARTHEST, out=at_y)
        return cv2.remap(image, at_x, at_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    @property
    def overlap(self) -> Floats:
        """Correlation of the patches' noise, (N, N): the share of samples in common, as `window_correlation`."""
        if self._overlap is None:
            side = self._window_px + _SAMPLED_BEYOND_PX
            x, y = np.ascontiguousarray(self.centres.T)
            x = np.maximum(1 - np.abs(np.subtract.outer(x, x)) / side, 0)
            y = np.maximum(1 - np.abs(np.subtract.outer(y, y)) / side, 0)
            self._overlap = np.asarray(x * y, np.float64)
        return self._overlap

    def motions(self, affine: bool) -> PlaneMotion:
        """Return the `PlaneMotion` of the patches' centres; it is kept."""
        if affine not in self._motions:
            self._motions[affine] = PlaneMotion.unchecked(self.centres, affine)
        return self._motions[affine]

    def displacements(self, samples: Image) -> Displacements:
        """Compare the patches with samples of another image.

        Parameters
        ----------
        samples : (N, window_px^2) uint8, uint16 or float32, from `sampled`, of all patches or of the first N

        Raises
        ------
        ShapeError
            If they are not as said.
        """
        if not isinstance(samples, np.ndarray) or samples.ndim != 2 or samples.shape[1] != self._area:
            raise ShapeError(f"samples: {getattr(samples, 'shape', type(samples).__name__)}; need (N, {self._area})")
        if len(samples) > len(self._seen):
            raise ShapeError(f"samples: shape {samples.shape}; need at most {self._seen.shape}")
        return self.displacements_unchecked(as_grey(samples, "samples") if len(samples) else samples)

    def displacements_unchecked(self, samples: Image) -> Displacements:
        """`displacements` without the checks of its argument."""
        first = len(samples)
        seen, contrast = self._seen[:first], self._contrast[:first]
        np.copyto(seen, samples)
        solution = (self._solvers[:first] @ seen[:, :, None])[:, :, 0]
        gain, mean = solution[:, 0], solution[:, 3]
        variance = np.einsum("np,np->n", seen, seen) - self._area * mean * mean
        explained = gain * contrast
        usable = (variance > self._area * _FLAT**2) & (np.abs(explained) > _LEAST_EXPLAINED)
        if not usable.all():
            solution[~usable], variance[~usable], explained[~usable] = (1, 0, 0, 0), 1, 0
        xy = solution[:, 1:3] / gain[:, None]
        similarity = explained / np.sqrt(variance)
        # np.clip takes five times as long.
        np.minimum(np.maximum(similarity, -1.0, out=similarity), 1.0, out=similarity)
        return Displacements(xy.astype(np.float64), similarity.astype(np.float64))


def as_grey(image: Image, name: str) -> Image:
    """Return an image that OpenCV can sample, its squares finite: (H, W) uint8, uint16 or float32.

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


def _checked_distortion(distortion: LocalDistortion, count: int) -> LocalDistortion:
    straight = as_matrix(distortion.straight, (count, 2), "straight")
    distorted = as_matrix(distortion.distorted, (count, 2), "distorted")
    by = as_matrix(distortion.by_straight, (count, 2, 2), "by_straight")
    if not all(np.abs(a).max() < _LARGEST_DISTORTED for a in (straight, distorted, by)):
        raise ShapeError(f"distortion: numbers of {_LARGEST_DISTORTED:g} and more; need places in an image")
    return LocalDistortion(straight, distorted, by)
