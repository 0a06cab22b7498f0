# SPDX-License-Identifier: Apache-2.0
"""Alignment of a plane's picture with the raw samples of a sensor, nothing demosaicked.

Each site p of the mosaic is predicted from the picture's channel c that the site sees, integrated over the site's area
and the point spread:

    raw(p) = a_c  integral of T_c(G p + o) over the offsets o  + b_c,

with G the homography from the image to the picture. Gain a_c and offset b_c are those of a patch, so that neither white
balance nor shading nor a black level that is a little wrong matters; a point spread that is a little wider or narrower
than assumed changes the prediction by its second derivatives, which are solved along. What is estimated is the motion
of the plane: eight numbers, by Gauss-Newton steps (Baker & Matthews 2004) whose weights come from the residuals.

Patches do not only err by noise: a print differs from its file, it bends, a lens model is not exact. The displacement
of each patch beside the plane's motion is a random effect, whose variance is estimated from how far the patches
disagree (Paule & Mandel 1982); it is in the weights of the patches and in the covariance.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import cv2
import numpy as np

from imgu_ros.errors import NoConsensus
from imgu_ros.image.raw_samples import (
    SITE_VARIANCE,
    Lens,
    LightLevel,
    Mosaic,
    RowScan,
    Singles,
    inside_picture,
    patch_sites,
    spread_samples,
    undistorted,
)
from imgu_ros.image.transfer_fit import CurveSamples
from imgu_ros.track.patch_equations import (
    PatchEquations,
    PatchSolution,
    SitesFit,
    median_of,
    noise_of,
    smooth_misfit_of,
)
from imgu_ros.types import Floats, Indices, Mask, Matrix3, Points

#: Side of a patch, px of the mosaic; even: it begins at a quad.
PATCH_PX = 10
#: Photon noise of a bright site, as a start.
_FIRST_NOISE = 1 / 9000
#: The share of it that is there in the dark.
_DARK = 0.01
#: Registration error that is taken to be there at a site, px, as a start.
_FIRST_REGISTRATION_PX = 0.02
#: Residuals beyond so many standard deviations count less (Huber 1964). Measured: benchmarks/thresholds.py, study
#: samples.
_HUBER = 2.5
#: Samples whose covariance with the picture is a smaller share of the product of their means are flat but for rounding.
_FLAT = 1e-5
#: Widest point spread that is followed, px^2.
_WIDEST_SPREAD = 36.0
#: Patches in the first iterations; the others join when these move less, px. Measured: benchmarks/thresholds.py, study
#: samples.
_SCOUTS, _SCOUTED_PX = 32, 0.2
#: Most iterations; some follow a spread that is wide. Measured: benchmarks/thresholds.py, study samples.
_ITERATIONS = 10
#: A motion that goes to and fro between two choices of what agrees is in the covariance up to so much, px.
_TO_AND_FRO_PX = 0.1
#: Moves farther by this factor, after such a small one, lead away from where it had nearly settled.
_AWAY = 8.0
#: A change of the spread below these is linear, or does not matter for the next iteration, px^2.
_SMALL_SPREAD, _SAME_SPREAD = 0.1, 0.01
#: Of edges that are known exactly: the spread of a sharp frame, px^2; up to this iteration it settles to so much, px^2;
#: afterwards small changes choose no other samples, as a step from one choice to another is more. Most iterations.
_SHARP, _STEADY_AFTER, _SMALLER_SPREAD, _MORE_ITERATIONS = np.array((0.3, 0.0, 0.3)), 5, 0.02, 14
#: Gains of patches that differ by this share, or more, from the mean count less; and how well no shading is known.
_SHADED, _SHADED_PRIOR = 0.2, 1e-3
#: Squared errors of the estimate for each unit of misfit beyond that of noise: a homography absorbs eight of eighteen
#: numbers of a smooth error, which leave no residual. More beyond what noise alone makes in one frame of a thousand, as
#: of a rolling shutter that nothing is known of. Measured: benchmarks/thresholds.py, study samples.
_UNSEEN, _BY_CHANCE, _UNSEEN_BEYOND = 2.0, 2.96, 7.0
#: A point spread is not quite symmetric: it shifts each patch by this share of its width. Measured:
#: benchmarks/thresholds.py, study samples.
_ASYMMETRIC = 0.02
#: The same of edges that are known exactly, as a share of it. Measured: benchmarks/markers.py.
_OF_EXACT = 0.5
#: A motion during the exposure turns, and changes its speed: its mean place, which is seen, is off its middle by this
#: share of the square of its length in px, as along a circle with a radius of 40 px. Measured:
#: benchmarks/thresholds.py, study samples.
_UNSTEADY = 0.001
#: Nearer to the border of a picture that ends there, samples show what lies beyond, px.
_RIM_PX = 1.0
#: Of the samples of a patch, every so many are used for the transfer curve.
_EVERY = 7
#: From so much below the white level on, a share of the span, a sample may be clipped.
_NEARLY_WHITE = 0.01


class SiteAlignment:
    """Aligns a plane's picture with the raw samples in patches.

    Parameters
    ----------
    mosaic : the raw samples
    levels : the picture at every scale, fine to coarse, with as many channels as the mosaic
    H : H_image_picture in ideal px, right to a fraction of a px
    centres : (N, 2) px of the picture, of the patches; those outside the image are left out
    lens : raw px of ideal ones; None: they are the same
    scan : how the image moves while its rows are exposed one after the other; None: all are exposed at once
    spread : (3,) px^2, as of a fit to a frame before; None: unknown
    fewest : patches that must be in view and agree
    size : width and height of a picture beyond which nothing is known; None: it goes on as at its border

    Attributes
    ----------
    chosen : indices of the patches in view
    T, scale : see `SitesFit`; px of the image in one of the picture, in the middle

    Raises
    ------
    NoConsensus
        If fewer than `fewest` patches are in view or agree, or if the motion does not settle.
    DegenerateConfiguration
        If the patches do not determine a homography.
    """

    def __init__(
        self,
        mosaic: Mosaic,
        levels: Sequence[LightLevel],
        H: Matrix3,
        centres: Points,
        lens: Lens | None = None,
        scan: RowScan | None = None,
        spread: Floats | None = None,
        fewest: int = 6,
        size: tuple[int, int] | None = None,
    ) -> None:
        self._fewest = fewest
        height, width = mosaic.values.shape
        mapped = centres @ H[:, :2].T + H[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            at = mapped[:, :2] / mapped[:, 2:]
        seen = at if scan is None else scan.seen(at)
        raw_at, by_ideal = (seen, None) if lens is None else lens(seen)
        origins = np.rint((raw_at - (PATCH_PX - 1) / 2) / 2)
        inside = (mapped[:, 2] > 0) & (origins >= 0).all(axis=1)
        inside &= (2 * origins[:, 0] + PATCH_PX <= width) & (2 * origins[:, 1] + PATCH_PX <= height)
        self.chosen = np.flatnonzero(inside)
        if len(self.chosen) < fewest:
            raise NoConsensus(f"sites: {len(self.chosen)} patches in view; need {fewest}")
        self._at = at[self.chosen]
        x, y = self._centre = self._at.mean(axis=0)
        self._unit = unit = float(np.sqrt(((self._at - self._centre) ** 2).mean()))
        self.T = np.array([[1 / unit, 0, -x / unit], [0, 1 / unit, -y / unit], [0, 0, 1]])
        self._levels = levels
        # The determinant of the local Jacobian in the middle: px of the image in one of the picture, squared.
        w = median_of(mapped[self.chosen, 2])
        self.scale = math.sqrt(abs(cv2.determinant(H)) / w**3)
        self._texels_px = [self.scale * float(level.scaling.step[0]) for level in levels]
        self._G: Matrix3 = np.linalg.inv(self.T @ H)
        self._to_ideal = None if by_ideal is None else np.linalg.inv(by_ideal[self.chosen])
        self._read(mosaic, 2 * origins[self.chosen].astype(np.intp), seen[self.chosen], lens)
        self._doubts: Floats = np.zeros((0, len(self._at), 2))
        if scan is not None:
            self._doubts = scan.doubts[:, self.chosen] * (seen[self.chosen, 1:] - scan.row)
            later = self._rows - np.float32(scan.row)
            self._x -= later * (scan.by_row[self.chosen, :1] / unit).astype(np.float32)
            self._y -= later * (scan.by_row[self.chosen, 1:] / unit).astype(np.float32)
        if size is not None:
            self._usable &= inside_picture(self._G, self._x, self._y, size, _RIM_PX / self.scale)
        self._normalised = (self._at - self._centre) / unit
        x, y = self._normalised.T
        self._by = by = np.zeros((len(x), 2, 8))
        by[:, 0, 0] = by[:, 1, 3] = x
        by[:, 0, 1] = by[:, 1, 4] = y
        by[:, 0, 2] = by[:, 1, 5] = 1
        by[:, 0, 6], by[:, 0, 7] = -x * x, -x * y
        by[:, 1, 6], by[:, 1, 7] = -x * y, -y * y
        by *= unit
        self._is_exact = size is not None
        self._spread: Floats = (_SHARP if self._is_exact else np.zeros(3)) if spread is None else spread
        self._shading: Singles = np.ones_like(self._x)
        self._buffers: Singles = np.empty((3, 0), np.float32)
        self._set_spread()

    def _read(self, mosaic: Mosaic, origins: Indices, seen: Points, lens: Lens | None) -> None:
        """Take the samples of the patches: places (N, S), channel after channel, light, and whether they are usable."""
        sites = patch_sites(PATCH_PX, mosaic.channels)
        row, column, self._slices = sites.row, sites.column, sites.slices
        y, x = origins[:, 1:] + row, origins[:, :1] + column
        self._rows = y.astype(np.float32)
        values = mosaic.values[y, x]
        white = mosaic.white or float(values.max()) + 1
        span = white - mosaic.black
        self._share = (values - np.float32(mosaic.black)) * np.float32(1 / span)
        z = self._share if mosaic.light is None else mosaic.light[values]
        self._usable = sites.first_in(origins, mosaic.values.shape) & (values < white - _NEARLY_WHITE * span)
        self._summed = 0
        self._sums: list[tuple[float, float]] = []
        self._brightness = np.maximum(z, 0) + np.float32(_DARK)
        # What the samples are explained by: derivatives by a displacement (x, y) and by the spread (xx, xy, yy), of
        # each channel the prediction and a constant; at the end the samples.
        count = len(self._slices)
        self._terms = np.zeros((2 * count + 6, *z.shape), np.float32)
        for constant, part in zip(self._terms[5 + count : -1], self._slices, strict=True):
            constant[:, part] = 1
        self._terms[-1] = z
        if lens is not None:
            x, y = sites.interpolated(undistorted(lens, seen, origins[:, None] + sites.knots))
        self._x = ((x - self._centre[0]) / self._unit).astype(np.float32)
        self._y = ((y - self._centre[1]) / self._unit).astype(np.float32)

    def _set_spread(self) -> None:
        """Set the level, and the samples whose weighted mean is what a site sees: products of two rows of taps."""
        xx, xy, yy = self._spread.tolist()
        middle, half, angle = (xx + yy) / 2, math.hypot((xx - yy) / 2, xy), math.atan2(2 * xy, xx - yy) / 2
        variances = middle + half + SITE_VARIANCE, middle - half + SITE_VARIANCE
        self._level, self._picture, taps = spread_samples(self._levels, self._texels_px, variances)
        taps = taps.turned(angle)
        self._offsets, self._steepness = taps.offsets, taps.steepness
        # The mean of derivatives over the spread; that by a variance is half the second derivative.
        self._means = taps.means.astype(np.float32)
        # Memory that is new has to be mapped: as long as all the rest takes.
        if self._buffers.shape[1] < len(self._offsets) * self._x.size:
            self._buffers = np.empty((3, len(self._offsets) * self._x.size), np.float32)

    def fit(self, agreeing: Mask | None = None, must_settle: bool = True) -> SitesFit:
        """Return the plane's motion.

        Parameters
        ----------
        agreeing : which of the given patches agreed in a frame before; None: unknown
        must_settle : else, where it goes away from where it had nearly settled, that is the answer
        """
        noise, registration, own = _FIRST_NOISE, _FIRST_REGISTRATION_PX**2, 0.0
        total = len(self._at)
        kept: Mask = np.ones(total, bool) if agreeing is None else agreeing[self.chosen]
        # Some patches bring the others near: then one prediction of all is linear enough.
        # Edges that are known exactly tell much, and each in one direction: all at once.
        count = total if self._is_exact else min(_SCOUTS, total)
        last, unsettled = np.zeros(8), np.zeros(8)
        nearest: tuple[float, PatchSolution, Matrix3, Floats] | None = None
        is_lost = False
        for iteration in range(_MORE_ITERATIONS if self._is_exact else _ITERATIONS):
            slope2, by = self._predict(count), self._by[:count]
            usable, brightness = self._usable[:count], self._brightness[:count]
            weights = usable / (np.float32(noise) * brightness + np.float32(registration) * slope2)
            equations = PatchEquations(self._terms[:, :count], weights, len(self._slices), by)
            solution = equations.solved(own, kept[:count], 1, self._fewest, self._least_own(), self._is_exact)
            before = self._G
            own, spread, moved = solution.own, solution.theta[8:], self._moved(solution.theta, by)
            e = equations.residuals(by @ solution.theta[:8], spread)
            noise, registration = noise_of(e, slope2, brightness, usable)
            if count == total:
                kept = solution.kept
                small = _SMALLER_SPREAD if self._is_exact and iteration <= _STEADY_AFTER else _SMALL_SPREAD
                if np.abs(spread).max() < small and solution.is_settled(last):
                    # Once more from there: samples that are off count less.
                    self._G = before
                    variance = np.float32(noise) * brightness + np.float32(registration) * slope2
                    weights = usable / (variance * np.maximum(np.abs(e) / (np.float32(_HUBER) * np.sqrt(variance)), 1))
                    equations = PatchEquations(self._terms, weights, len(self._slices), by)
                    solution = equations.solved(own, kept, 2, self._fewest, self._least_own(), self._is_exact)
                    own, kept, spread = solution.own, solution.kept, solution.theta[8:]
                    moved = self._moved(solution.theta, by)
                    break
            if (
                not must_settle
                and moved <= _TO_AND_FRO_PX
                and count == total
                and (nearest is None or moved < nearest[0])
            ):
                nearest = moved, solution, self._G, self._spread
            elif nearest is not None and moved > max(_TO_AND_FRO_PX, _AWAY * nearest[0]):
                is_lost = True
                break
            last = solution.theta[:8]
            self._shade(*equations.gains)
            if np.abs(spread).max() > (_SMALL_SPREAD if self._is_exact and iteration > _STEADY_AFTER else _SAME_SPREAD):
                self._widen(spread)
            if count < total and moved < _SCOUTED_PX:
                count = total
        else:
            is_lost = moved > _TO_AND_FRO_PX or len(solution.kept) < total
            if is_lost and (must_settle or nearest is None):
                raise NoConsensus(f"sites: they still move by {moved:.2f} px; need a better start")
            # To and fro between two choices of what agrees.
            unsettled = last
        if is_lost and nearest is not None:
            # Few patches of a sharp frame: away again from where they had nearly settled.
            moved, solution, self._G, self._spread = nearest
            own, kept, spread, unsettled = solution.own, solution.kept, solution.theta[8:], solution.theta[:8]
        H = np.linalg.inv(self._G @ self.T)
        covariance = np.linalg.inv(solution.information) * self._inflation(smooth_misfit_of(solution, self._normalised))
        covariance += np.outer(unsettled, unsettled)
        return SitesFit(
            H / np.linalg.norm(H),
            self.chosen,
            kept,
            solution.displacements,
            self.T,
            solution.information,
            covariance,
            self._doubted(),
            math.sqrt(own),
            math.sqrt(registration),
            noise,
            moved,
            self._spread + spread,
        )

    def _doubted(self) -> Floats:
        """Return the covariance of the motion by the doubt of how the image moves during the exposure, (8, 8)."""
        covariance: Floats = np.zeros((8, 8))
        for doubt in self._doubts:
            wrong = np.linalg.lstsq(self._by.reshape(-1, 8), doubt.ravel(), rcond=None)[0]
            covariance += np.outer(wrong, wrong)
        xx, xy, yy = self._spread.tolist()
        # By the variance of a box: of a motion at constant speed.
        length2 = 12 * 2 * math.hypot((xx - yy) / 2, xy)
        covariance[[2, 5], [2, 5]] += (_UNSTEADY * length2 / self._unit) ** 2
        return covariance

    def _inflation(self, misfit: float) -> float:
        """Return the factor on the covariance by a misfit that is 1 where there is noise alone."""
        return 1 + _UNSEEN * max(misfit - 1, 0) + _UNSEEN_BEYOND * max(misfit - _BY_CHANCE, 0)

    def samples(self, kept: Mask) -> CurveSamples:
        """Return some of the samples, as the transfer curve is fitted to them."""
        self._predict(len(self._at))
        values = self._terms[5 : 5 + len(self._slices)].sum(axis=0)
        weights = (self._usable & kept[:, None]).astype(np.float32)
        places = np.stack((self._x, self._y), axis=-1)
        parts = [slice(part.start, part.stop, _EVERY) for part in self._slices]
        ends = np.cumsum([0, *(values[:, part].size for part in parts)])
        joined = [np.concatenate([each[:, part].ravel() for part in parts]) for each in (self._share, values, weights)]
        return CurveSamples(
            joined[0],
            joined[1],
            np.concatenate([places[:, part].reshape(-1, 2) for part in parts]),
            [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)],
            joined[2],
        )

    def _shade(self, gains: Floats, weights: Floats) -> None:
        """Let the light vary over the target, linearly, as the patches' gains do, (N, C) with weights."""
        mean = (weights * gains).sum(axis=0) / weights.sum(axis=0)
        if not mean.min() > 0:
            return
        # Few patches have a gain that differs by more; those are reflections, or not of the target.
        relative = gains / mean - 1
        weights = weights * mean**2 / (1 + (relative / _SHADED) ** 2)
        x = np.column_stack((np.ones(len(gains)), self._normalised[: len(gains)]))
        total = weights.sum(axis=1)
        normal = (x.T * total) @ x + np.eye(3) * (_SHADED_PRIOR * float(total.sum()))
        _, sx, sy = np.linalg.solve(normal, x.T @ (weights * relative).sum(axis=1))
        self._shading *= 1 + np.float32(sx) * self._x + np.float32(sy) * self._y

    def _least_own(self) -> float:
        """Return the least variance of the patches' own displacements, px^2."""
        share = _ASYMMETRIC * (_OF_EXACT if self._is_exact else 1.0)
        return share**2 * max(float(self._spread[0] + self._spread[2]), 0.0)

    def _widen(self, change: Floats) -> None:
        """Make the point spread wider by (xx, xy, yy) px^2."""
        xx, xy, yy = self._spread + change
        values, vectors = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
        values = np.clip(values, -SITE_VARIANCE / 2, _WIDEST_SPREAD)
        xx, xy, _, yy = (vectors * values @ vectors.T).ravel()
        self._spread = np.array([xx, xy, yy])
        self._set_spread()

    def _moved(self, theta: Floats, by: Floats) -> float:
        """Move the homography; return the largest motion of a patch, px."""
        p = theta[:8] * self._steepness
        self._G = self._G @ (np.eye(3) + np.array([*p, 0]).reshape(3, 3))
        return float(np.abs(by @ p).max())

    def _places(self, count: int) -> tuple[Singles, Singles, Singles]:
        """Return where the sites are in the level, x and y (count, S), and their taps beside, (2, K, count, 1)."""
        G = self._level.scaling.reduced_from_full @ self._G
        # Jacobian of the level's px by the image's, at the patches' centres.
        at = self._normalised[:count] @ G[:, :2].T + G[:, 2]
        J = G[:2, :2] - (at[:, :2] / at[:, 2:])[:, :, None] * G[2, :2]
        J /= at[:, 2, None, None] * self._unit
        if self._to_ideal is not None:
            J @= self._to_ideal[:count]
        by_tap = (J.reshape(-1, 2) @ self._offsets.T).astype(np.float32).reshape(count, 2, -1, 1)
        (a, b, c), (d, e, f), (g, h, i) = G.astype(np.float32)
        x, y = self._x[:count], self._y[:count]
        w = 1 / (g * x + h * y + i)
        return (a * x + b * y + c) * w, (d * x + e * y + f) * w, by_tap.transpose(1, 2, 0, 3)

    def _predict(self, count: int) -> Singles:
        """Set the terms of the first patches; return the squared slope of their light, (count, S)."""
        terms, taps, any_tells = self._terms[:, :count], len(self._offsets), False
        if count != self._summed:
            self._summed, usable, light = count, self._usable[:count], terms[-1] * self._usable[:count]
            self._sums = [(float(usable[:, p].sum()) + 1e-9, float(light[:, p].sum())) for p in self._slices]
        x, y, by_tap = self._places(count)
        for index, (channel, part) in enumerate(zip(self._picture, self._slices, strict=True)):
            shape = taps, count, part.stop - part.start
            u, v, seen = [each[: math.prod(shape)].reshape(shape) for each in self._buffers]
            np.add(x[:, part], by_tap[0], out=u)
            np.add(y[:, part], by_tap[1], out=v)
            # In wide rows.
            u, v, seen = [each.reshape(taps, -1) for each in (u, v, seen)]
            cv2.remap(channel, u, v, cv2.INTER_LINEAR, seen, borderMode=cv2.BORDER_REPLICATE)
            means = (self._means @ seen).reshape(6, *shape[1:])
            means *= self._shading[:count, part]
            f = means[5]
            terms[5 + index, :, part] = f
            gain = self._gain(index, f, f * self._usable[:count, part], terms[-1, :, part])
            any_tells |= gain > 0
            np.multiply(means[:5], np.float32(gain), out=terms[:5, :, part])
        if not any_tells:
            raise NoConsensus("sites: they do not vary as the picture does")
        slope2: Singles = terms[0] ** 2 + terms[1] ** 2
        return slope2

    def _gain(self, channel: int, f: Singles, used: Singles, z: Singles) -> float:
        """Return the gain of a channel; 0 where the samples tell none.

        Parameters
        ----------
        channel : its number
        f, used : the predictions, and those that are usable, else 0
        z : the samples
        """
        (n, of_z), of_f = self._sums[channel], float(used.sum())
        power, gain = float(np.vdot(used, f)) - of_f**2 / n, float(np.vdot(used, z)) - of_f * of_z / n
        return gain / power if power > 0 and gain > _FLAT * abs(of_f * of_z) / n else 0.0
