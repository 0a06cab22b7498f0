# SPDX-License-Identifier: Apache-2.0
"""Printed pictures that are hard to tell apart: from themselves, shifted, or from one another."""

from __future__ import annotations

import numpy as np

from imgu_ros.errors import ShapeError
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.types import Image, as_image

_COLUMNS, _ROWS = 5, 4
_UNIQUE_TILES = 4


def repeated_picture(width: int = 1280, height: int = 960, seed: int = 0) -> Image:
    """Return a picture whose tiles are all the same but four, like a shelf or a patterned floor with a few marks.

    Parameters
    ----------
    width, height : px, at least 80
    seed : chooses the tile, the four others and their places

    Returns
    -------
    (height, width, 3) uint8, RGB (sRGB)

    Raises
    ------
    ShapeError
        If the size is too small.
    """
    if min(width, height) < 80:
        raise ShapeError(f"picture size: {width} x {height}; need at least 80 x 80 px")
    tile_width, tile_height = -(-width // _COLUMNS), -(-height // _ROWS)
    rng = np.random.default_rng([seed, 0x711E])
    unique = set(rng.choice(_COLUMNS * _ROWS, _UNIQUE_TILES, replace=False).tolist())
    common = procedural_texture(tile_width, tile_height, seed)
    rows = []
    for row in range(_ROWS):
        indices = range(row * _COLUMNS, (row + 1) * _COLUMNS)
        tiles = [procedural_texture(tile_width, tile_height, seed + 1 + i) if i in unique else common for i in indices]
        rows.append(np.concatenate(tiles, axis=1))
    return np.ascontiguousarray(np.concatenate(rows, axis=0)[:height, :width])


def look_alike(picture: Image, seed: int = 0, shared: float = 0.3) -> Image:
    """Return another picture with the same header: its upper part is the given one's, the rest is new.

    Parameters
    ----------
    picture : (H, W, 3) uint8
    seed : chooses what is new
    shared : share of the area that both have in common, 0 to 1

    Raises
    ------
    ShapeError
        If the picture is not such an image, or the share lies outside its range.
    """
    picture = as_image(picture, "picture", channels=(3,), dtypes=(np.uint8,))
    if not 0 <= shared <= 1:
        raise ShapeError(f"shared: {shared:g}; need 0 to 1")
    height, width = picture.shape[:2]
    other = procedural_texture(width, height, seed)
    header = round(shared * height)
    other[:header] = picture[:header]
    return other
