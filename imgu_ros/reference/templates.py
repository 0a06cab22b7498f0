# SPDX-License-Identifier: Apache-2.0
"""Templates: the image of a reference at every octave, with the points whose patches are aligned with frames."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import cv2
import numpy as np

from imgu_ros.image.frame_image import LightKind, grey_of
from imgu_ros.image.raw_samples import LightLevel, light_levels
from imgu_ros.reference.template_cells import TemplateCells
from imgu_ros.types import Image, Points
from imgu_ros.vision.formation.transfer import light_of_srgb, linear_from_srgb, srgb_from_linear
from imgu_ros.vision.keypoints.spreading import spread
from imgu_ros.vision.matching.patch_bank import PatchBank
from imgu_ros.vision.scale_space.pyramid import Level, PixelScaling, PyramidKind, build_pyramid

#: Weakest corner for a patch, as a share of the strongest response. Measured: benchmarks/thresholds.py, study tracking.
_CORNER_QUALITY = 0.005
#: Smallest distance of two patch centres, px of the level. Measured: benchmarks/thresholds.py, study tracking.
_CORNER_DISTANCE_PX = 6
#: The best-spread patches come first: sets of so many and more patches are each spread over the whole image.
_FIRST_SPREAD = 40


@dataclass(frozen=True, slots=True, eq=False)
class TargetImage:
    """A known flat picture.

    Attributes
    ----------
    name : in topics, files and frames
    pixels : (H, W) or (H, W, 3) RGB, uint8
    width_m : printed width, outer edge to outer edge; 0: unknown
    is_linear : whether values go with the light, as a sensor's; else they are sRGB, as those of image files
    kind : of the reference that is made of it, a key of `imgu_ros.reference_kinds.KINDS`; empty: as the parameter
        `reference` says
    """

    kind: ClassVar[str] = ""

    name: str
    pixels: Image
    width_m: float
    is_linear: bool = False

    @property
    def sheet_width_m(self) -> float:
        """Width of all that the picture shows; that of a marker has a margin."""
        return self.width_m

    @property
    def entry(self) -> str:
        """The entry of `targets.images` that names it without a file; empty: it is a picture."""
        return ""

    def shows_the_same(self, other: TargetImage) -> bool:
        """Return whether both are the same picture, of whatever width."""
        if self.pixels is other.pixels:
            return self.is_linear == other.is_linear
        return self.is_linear == other.is_linear and bool(np.array_equal(self.pixels, other.pixels))


class TemplateOctave:
    """A template at one scale: of a known image, few octaves are ever seen.

    Parameters
    ----------
    level : the image, uint8, and its scale
    count : number of patches that are used at once

    Attributes
    ----------
    level : as given
    scaling : between the template and the level
    scale : template px in one px of the level
    patches : about the corners, by the side of a patch, px of the level; those of the last side are kept
    """

    def __init__(self, level: Level, count: int) -> None:
        self.level = level
        self.scaling, self.scale = PixelScaling(level.step), level.scale
        self.patches = _PatchesBySide(self)
        self._count = count

    @cached_property
    def corners(self) -> Points:
        """Centres of patches, best spread first: (N, 2) px of the full-resolution template."""
        return _corners(self.level, self._count)

    @cached_property
    def cells(self) -> TemplateCells:
        """Cells that are compared with frames, see `imgu_ros.reference.verification`."""
        return TemplateCells(self.level.image)


class TemplatePatches(PatchBank):
    """Patches about the corners of a template's octave.

    Parameters
    ----------
    octave : the octave
    window_px : side of a patch, px of the octave's level

    Attributes
    ----------
    template_xy : (M, 2) centres of the patches, template px
    """

    def __init__(self, octave: TemplateOctave, window_px: int) -> None:
        super().__init__(octave.level.image, octave.level.from_full(octave.corners), window_px)
        self.template_xy = octave.scaling.to_full_unchecked(self.centres)


class _PatchesBySide(dict[int, TemplatePatches]):
    def __init__(self, octave: TemplateOctave) -> None:
        super().__init__()
        self._octave = octave

    def __missing__(self, window_px: int) -> TemplatePatches:
        self.clear()
        self[window_px] = TemplatePatches(self._octave, window_px)
        return self[window_px]


class TemplatePyramids(dict[bool, tuple[Level, ...]]):
    """The octaves of an image, from fine to coarse, by whether their values are linear in the light or sRGB.

    Each pyramid is computed when it is first asked for.

    Parameters
    ----------
    image : the image
    grey_weights : of red, green and blue; not used for a grey image
    kernel : of the pyramid
    """

    def __init__(self, image: TargetImage, grey_weights: tuple[float, ...], kernel: str) -> None:
        super().__init__()
        self._image = image
        self._grey_weights = grey_weights
        self._kernel = kernel

    def __missing__(self, linear: bool) -> tuple[Level, ...]:
        pixels = self._image.pixels
        if linear != self._image.is_linear:
            pixels = linear_from_srgb(pixels) if linear else srgb_from_linear(pixels)
        grey = grey_template(pixels, self._grey_weights)
        self[linear] = build_pyramid(grey, PyramidKind.COARSE, levels=8, min_side_px=24, kernel=self._kernel).levels
        return self[linear]

    __hash__ = object.__hash__  # type: ignore[assignment]  # a key of the build cache, by identity


class Templates(dict[bool, tuple[TemplateOctave, ...]]):
    """The octaves of `TemplatePyramids` with their patches; computed when they are first asked for.

    Parameters
    ----------
    pyramids : of the image
    max_points : number of patches that are used at once
    """

    def __init__(self, pyramids: TemplatePyramids, max_points: int) -> None:
        super().__init__()
        self._pyramids = pyramids
        self._max_points = max_points

    def __missing__(self, linear: bool) -> tuple[TemplateOctave, ...]:
        self[linear] = tuple(TemplateOctave(level, self._max_points) for level in self._pyramids[linear])
        return self[linear]

    __hash__ = object.__hash__  # type: ignore[assignment]  # a key of the build cache, by identity


class LightTemplates(dict[LightKind, tuple[LightLevel, ...]]):
    """An image in floats at every octave, as the raw samples of a sensor are compared with it.

    Parameters
    ----------
    image : the image
    grey_weights : of red, green and blue; not used for a grey image
    """

    def __init__(self, image: TargetImage, grey_weights: tuple[float, ...]) -> None:
        super().__init__()
        self._image = image
        self._grey_weights = grey_weights

    def __missing__(self, kind: LightKind) -> tuple[LightLevel, ...]:
        image = self._image
        if kind is LightKind.CODED:
            pixels = srgb_from_linear(image.pixels) if image.is_linear else image.pixels
            light = pixels.astype(np.float32) / np.float32(255)
        else:
            values = np.linspace(0, 1, 256) if image.is_linear else light_of_srgb()
            light = values.astype(np.float32)[image.pixels]
        if kind is LightKind.COLOR:
            light = light if light.ndim == 3 else np.stack((light, light, light), axis=2)
        elif light.ndim == 3:
            weights = np.divide(self._grey_weights, sum(self._grey_weights)).astype(np.float32)
            light = np.asarray(light @ weights, np.float32)
        self[kind] = light_levels(np.ascontiguousarray(light))
        return self[kind]

    __hash__ = object.__hash__  # type: ignore[assignment]  # a key of the build cache, by identity


def grey_template(pixels: Image, weights: tuple[float, ...]) -> Image:
    """Return the grey image of a template.

    Parameters
    ----------
    pixels : (H, W) or (H, W, 3) RGB, uint8
    weights : of red, green and blue; not used for a grey image
    """
    return np.ascontiguousarray(pixels) if pixels.ndim == 2 else grey_of(pixels, weights)


def _corners(level: Level, count: int) -> Points:
    corners = cv2.goodFeaturesToTrack(level.image, 6 * count, _CORNER_QUALITY, _CORNER_DISTANCE_PX)
    xy = np.zeros((0, 2)) if corners is None else corners.reshape(-1, 2).astype(np.float64)
    # goodFeaturesToTrack sorts by strength but does not return it: the rank serves as well.
    rank = -np.arange(len(xy), dtype=np.float64)
    size = (level.image.shape[1], level.image.shape[0])
    # However many of them are taken, from the first, lie spread over the picture.
    counts = [3 * count]
    while counts[0] > _FIRST_SPREAD:
        counts.insert(0, counts[0] // 2)
    order = np.concatenate([spread(xy, rank, size, n) for n in counts])
    _, first = np.unique(order, return_index=True)
    return level.to_full(xy[order[np.sort(first)]])
