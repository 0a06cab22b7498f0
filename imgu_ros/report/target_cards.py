# SPDX-License-Identifier: Apache-2.0
"""What a report shows of each target: its picture, its size, and what makes it a poor one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imgu_ros.reference.templates import TargetImage
from imgu_ros.report.samples import jpeg_of

#: A report shows the pictures of so many targets: of boards of markers there may be hundreds.
MOST_CARDS = 24
_SIDE, _QUALITY = 240, 80


@dataclass(frozen=True, slots=True, eq=False)
class TargetCard:
    """One target.

    Attributes
    ----------
    name, entry : of it, and the entry of `targets.images`
    size : width and height of its picture, px; of markers on several planes, of the first one
    width_m : printed width; 0: unknown
    score : of `imgu check`, 0 to 100; None: not known
    remark : what makes it a poor target; empty: nothing does
    jpeg : its picture
    """

    name: str
    entry: str
    size: tuple[int, int]
    width_m: float
    score: int | None
    remark: str
    jpeg: bytes


def target_cards(
    images: Sequence[TargetImage], entries: Sequence[str], remarks: Mapping[str, str], scores: Mapping[str, int]
) -> tuple[TargetCard, ...]:
    """Return the cards of the first targets.

    Parameters
    ----------
    images : as `load_target_images` returns them
    entries : of `targets.images`
    remarks, scores : by name, see `load_remarks` and `target_scores`
    """
    return tuple(
        _card(image, entry, remarks.get(image.name, ""), scores.get(image.name))
        for image, entry in zip(images[:MOST_CARDS], entries, strict=False)
    )


def _card(image: TargetImage, entry: str, remark: str, score: int | None) -> TargetCard:
    pixels = image.pixels
    height, width = pixels.shape[:2]
    colour = pixels if pixels.ndim == 3 else np.repeat(pixels[:, :, None], 3, axis=2)
    return TargetCard(
        image.name, entry, (width, height), image.width_m, score, remark, jpeg_of(colour, _SIDE, _QUALITY)
    )
