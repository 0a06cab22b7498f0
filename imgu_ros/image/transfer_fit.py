# SPDX-License-Identifier: Apache-2.0
"""The transfer curve of a camera from samples of a known picture: linear, sRGB, or a fitted monotone curve.

Through a curve with the inverse g, the values z of a camera follow the light f of a known picture by

    g(z) = a_c (1 + s . p) f + b_c

with gain and offset of each colour channel and a shading that is linear in the place p. g is piecewise linear with
increments of 0 and more. All of it is linear in what is sought once the gain of green is set to 1: least squares.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from imgu_ros.types import Choice, Floats
from imgu_ros.vision.formation.transfer import light_of_srgb

#: Pieces of the curve, each as wide.
_PIECES = 16
#: Second differences of the increments count as much as this share of the samples.
_SMOOTHNESS = 3e-4
#: After so many images the curve stays as it is.
_ENOUGH_IMAGES = 8
#: A curve counts when it explains so much of the squares that linear values, and then sRGB, leave.
_EXPLAINED = 0.1
#: Samples beyond so many robust standard deviations count less.
_HUBER = 2.0


class TransferKind(Choice):
    """How a camera's values follow from the light."""

    LINEAR = "linear"  #: they go with it
    SRGB = "srgb"  #: by IEC 61966-2-1
    FITTED = "fitted"  #: by a monotone curve


@dataclass(frozen=True, slots=True, eq=False)
class CurveSamples:
    """Samples of a known picture in one image.

    Attributes
    ----------
    values : (N,) 0 to 1, the camera's
    light : (N,) of the picture there
    places : (N, 2) in the image, centred, of unit size
    channels : the slice of each channel, the one whose gain is 1 in the middle
    weights : (N,) 0 and more
    """

    values: NDArray[np.float32]
    light: NDArray[np.float32]
    places: NDArray[np.float32]
    channels: Sequence[slice]
    weights: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class TransferCurve:
    """A camera's curve.

    Attributes
    ----------
    kind : which
    increments : (K,) of the light over equal pieces of the values, 0 and more, sum 1
    """

    kind: TransferKind
    increments: Floats

    def light(self, share: Floats) -> Floats:
        """Return the light, 0 to 1, of values from 0 to 1; beyond, as at the nearer end."""
        knots = np.linspace(0, 1, len(self.increments) + 1)
        return np.asarray(np.interp(share, knots, np.concatenate(([0.0], np.cumsum(self.increments)))), np.float64)

    @lru_cache(maxsize=4)  # noqa: B019 (a camera has one curve)
    def table(self, black: float, white: float, count: int) -> NDArray[np.float32]:
        """Return the light of each raw value from 0 to `count` - 1, (count,)."""
        share: Floats = (np.arange(count, dtype=np.float64) - black) / (white - black)
        return self.light(share).astype(np.float32)


def _pieces_of(values: NDArray[np.float32]) -> Floats:
    return np.clip(values[:, None] * np.float64(_PIECES) - np.arange(_PIECES), 0, 1)


#: The curve of sRGB.
SRGB_CURVE = TransferCurve(
    TransferKind.SRGB, np.diff(light_of_srgb()[np.rint(np.linspace(0, 255, _PIECES + 1)).astype(int)])
)


class TransferFit:
    """Gathers samples of images and fits the curve to all of them.

    Attributes
    ----------
    curve : by the samples so far; None before the first ones
    images : number of images so far
    """

    def __init__(self) -> None:
        self.images = 0
        self.curve: TransferCurve | None = None
        self._normal: Floats = np.zeros((_PIECES + 1, _PIECES + 1))
        self._increments: Floats = np.full(_PIECES, 1 / _PIECES)

    @property
    def is_settled(self) -> bool:
        """Whether there were enough images: further ones change nothing."""
        return self.images >= _ENOUGH_IMAGES

    def add(self, samples: CurveSamples) -> None:
        """Add an image that has samples of weight, unless there were enough."""
        if self.is_settled or not (samples.weights > 0).any():
            return
        f = samples.light.astype(np.float64)
        pieces = _pieces_of(samples.values)
        middle = samples.channels[len(samples.channels) // 2]
        x, y = samples.places.T
        columns = []
        for part in samples.channels:
            inside = np.zeros(len(f))
            inside[part] = 1
            columns += [inside, inside * f * x, inside * f * y]
            if part is not middle:
                columns.append(inside * f)
        target = np.zeros(len(f))
        target[middle] = f[middle]
        free = np.stack(columns, axis=1)
        # Scale of this image's light, by the curve so far.
        g = pieces @ self._increments
        w = samples.weights.astype(np.float64)
        root = np.sqrt(w)
        fitted = np.linalg.lstsq(np.column_stack((free, target)) * root[:, None], g * root, rcond=None)[0]
        e = g - np.column_stack((free, target)) @ fitted
        sigma = 1.4826 * np.median(np.abs(e[w > 0]))
        root = root / np.sqrt(np.maximum(1, np.abs(e) / (_HUBER * sigma + 1e-9)))
        rows = np.column_stack((pieces, fitted[-1] * target)) * root[:, None]
        free = free * root[:, None]
        q = np.linalg.qr(free)[0]
        rows -= q @ (q.T @ rows)
        self._normal += rows.T @ rows
        self.images += 1
        self.curve = self._chosen()
        self._increments = self.curve.increments

    def _chosen(self) -> TransferCurve:
        """Return the simplest curve that explains the samples so far."""
        fitted = self._fitted()
        best = self._misfit(fitted)
        for curve in (TransferCurve(TransferKind.LINEAR, np.full(_PIECES, 1 / _PIECES)), SRGB_CURVE):
            if best > (1 - _EXPLAINED) * self._misfit(curve.increments):
                return curve
        return TransferCurve(TransferKind.FITTED, fitted / fitted.sum())

    def _misfit(self, increments: Floats) -> float:
        """Return the squares that a curve of this form, scaled to fit, leaves."""
        shape = np.zeros((_PIECES + 1, 2))
        shape[:-1, 0], shape[-1, 1] = increments, -1
        (a, b), (_, d) = shape.T @ self._normal @ shape
        return float(d - b * b / a) if a > 0 else float(d)

    def _fitted(self) -> Floats:
        smooth = np.diff(np.eye(_PIECES), n=2, axis=0)
        normal = self._normal.copy()
        normal[:-1, :-1] += _SMOOTHNESS * np.trace(normal[:-1, :-1]) * smooth.T @ smooth
        values, vectors = np.linalg.eigh(normal)
        rows = np.sqrt(np.maximum(values, 0))[:, None] * vectors.T
        found = lsq_linear(rows[:, :-1], rows[:, -1], bounds=(1e-6, np.inf), tol=1e-10)
        return np.asarray(found.x, np.float64)
