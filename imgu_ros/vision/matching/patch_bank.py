# SPDX-License-Identifier: Apache-2.0
"""The patches of a picture that is sought in others: what does not depend on those is worked out once."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import as_integer
from imgu_ros.errors import ShapeError
from imgu_ros.types import Floats, Image, Indices, Points, as_points
from imgu_ros.vision.matching.alignment import FLAT, LONGEST_PX, Patches, PreparedPatches, as_grey

#: Smallest eigenvalue of a patch's normal matrix, scaled to a unit diagonal: below, it is flat or one straight edge.
_WEAKEST = 1e-3
#: The samples of a wider patch, 171^2, would not fit one row of `cv2.remap`, which has at most 32767.
_WIDEST_WINDOW_PX = 171


class PatchBank:
    """Square patches of a picture, each made ready for comparison when it is first asked for.

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
    A picture, and another one that shows it 3 px farther right; `H` says 2 px:

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
        self._solvers = np.empty((count, 4, area), np.float32)
        self._contrast = np.zeros(count, np.float32)
        self._ready = np.zeros(count, bool)
        self._last: Patches | None = None

    def select(self, chosen: Indices) -> Patches:
        """Return some patches ready for comparison; the same ones again cost nothing.

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
        if self._last is None or not np.array_equal(self._last.chosen, chosen):
            if len(chosen) > LONGEST_PX or (len(chosen) and not 0 <= chosen.min() <= chosen.max() < len(self.centres)):
                raise ShapeError(
                    f"chosen: {len(chosen)} from {chosen.min()} to {chosen.max()}; need 0 to {len(self.centres) - 1}"
                )
            # A copy: the caller may go on to change his.
            index = chosen.astype(np.intp)
            self._prepare(index)
            self._last = Patches(
                PreparedPatches(index, self.centres[index], self.window_px, self._solvers[index], self._contrast[index])
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
        textured = norms[:, 0] > FLAT * self.window_px
        safe = np.where(norms > 0, norms, 1.0)
        unit = columns / safe[:, None, :]
        normal = unit.transpose(0, 2, 1) @ unit
        textured &= np.linalg.eigvalsh(normal)[:, 0] > _WEAKEST
        normal[~textured] = np.eye(3)
        self._solvers[missing, :3] = np.linalg.solve(normal, unit.transpose(0, 2, 1)) / safe[:, :, None]
        self._solvers[missing, 3] = 1 / area
        self._contrast[missing] = np.where(textured, norms[:, 0], 0.0)
        self._ready[missing] = True
