# SPDX-License-Identifier: Apache-2.0
"""One index over the descriptors of many pictures: which of them a frame may show (Indyk & Motwani 1998).

Comparing a frame with hundreds of pictures costs hundreds of comparisons. Rows of bits that differ in few of them often
agree in *all* of some 16 bits: rows are filed by these under a number, in several tables with different bits, and only
those filed under a query's numbers are compared with it. Some true matches are missed, and of those of a picture in
view enough are not to tell it from the others. What it is good for is to choose; then match exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imgu_ros.arguments import as_integer, as_sequence
from imgu_ros.errors import ShapeError
from imgu_ros.types import Image, Indices
from imgu_ros.vision.matching.metrics import checked_rows, comparable_rows

#: Number of tables: each misses some true matches, and another finds them. Measured: benchmarks/thresholds.py, study
#: many.
_TABLES = 16
#: Bits of a key beyond the logarithm of the number of rows: more bits, fewer rows that share a key by chance. Measured:
#: benchmarks/thresholds.py, study many.
_SPARE_BITS = 2
#: A key is held in 32 bits.
_MOST_KEY_BITS = 30
#: Rows under one key beyond which it is skipped: they cost time in proportion and say little. Measured:
#: benchmarks/thresholds.py, study many.
_LARGEST_BUCKET = 24
#: Share of the bits in which two descriptors of one place may differ: half of that of different places. Measured:
#: benchmarks/thresholds.py, study many.
_ALIKE = 0.25
#: A row does not vote when the nearest row of another picture is nearly as near. Measured: benchmarks/thresholds.py,
#: study many.
_RATIO = 0.8
#: Numbers become as many signs of random projections (Charikar 2002).
_SIGNS = 256
#: Seed of the chosen bits: the same pictures give the same index.
_SEED = 0


@dataclass(frozen=True, slots=True, eq=False)
class DescriptorIndex:
    """Descriptors of P pictures, filed.

    Attributes
    ----------
    bits : (M, B) uint8 rows of all pictures, one after another
    picture : (M,) which picture each row is of
    count : P
    chosen : (T, K) which bits make a row's number in each of the T tables
    keys : (T, M) numbers in ascending order
    order : (T, M) the row of each
    projection : (D, 256) that makes bits of float32 rows; None for rows of bits
    """

    bits: Image
    picture: NDArray[np.int32]
    count: int
    chosen: Indices
    keys: NDArray[np.uint32]
    order: NDArray[np.int32]
    projection: NDArray[np.float32] | None

    def votes(self, rows: Image) -> Indices:
        """Return for each picture how many rows have their nearest filed row in it, clearly before any other's, (P,).

        Parameters
        ----------
        rows : (N, D), as the pictures'

        Raises
        ------
        ShapeError
            If the rows are not of the pictures' kind.
        """
        width = self.bits.shape[1] if self.projection is None else self.projection.shape[0]
        rows = comparable_rows(rows, width, np.uint8 if self.projection is None else np.float32)
        if not len(rows) or not len(self.bits):
            return np.zeros(self.count, np.intp)
        bits = _as_bits(rows, self.projection)
        numbers = _numbers(bits, self.chosen)
        asked, found = [], []
        for keys, order, wanted in zip(self.keys, self.order, numbers, strict=True):
            first, last = (np.searchsorted(keys, wanted, side) for side in ("left", "right"))
            size = np.where(last - first <= _LARGEST_BUCKET, last - first, 0)
            query = np.repeat(np.arange(len(rows)), size)
            place = np.arange(len(query)) - np.repeat(np.cumsum(size) - size, size) + first[query]
            asked.append(query)
            found.append(order[place])
        return self._counted(bits, np.concatenate(asked), np.concatenate(found))

    def _counted(self, bits: Image, asked: Indices, found: NDArray[np.int32]) -> Indices:
        differing: Image = bits[asked] ^ self.bits[found]
        distance = _POPULATION[differing.view(np.uint16)].sum(axis=1, dtype=np.int64)
        # By query, then by distance, then by picture, in one sort.
        entries = np.sort((asked.astype(np.int64) << 40) | (distance << 24) | self.picture[found])
        query, distance, picture = entries >> 40, (entries >> 24) & 0xFFFF, entries & 0xFFFFFF
        first = np.flatnonzero(np.diff(query, prepend=-1))
        nearest = picture[first]
        rival = np.full(len(bits), np.iinfo(np.int64).max)
        others = np.flatnonzero(picture != np.repeat(nearest, np.diff(np.append(first, len(query)))))
        np.minimum.at(rival, query[others], distance[others])
        clear = (distance[first] <= _ALIKE * 8 * bits.shape[1]) & (distance[first] < _RATIO * rival[query[first]])
        return np.bincount(nearest[clear], minlength=self.count)


def build_index(pictures: Sequence[Image], seed: int = _SEED) -> DescriptorIndex:
    """File the descriptors of pictures.

    Parameters
    ----------
    pictures : at least one; (M_i, D) each, all uint8 (bits, D even) or all float32
    seed : >= 0, chooses bits and projections; the same pictures and seed give the same index

    Raises
    ------
    ShapeError
        If there is no picture, the rows are not of that kind, or the seed is negative.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> pictures = [rng.integers(0, 256, (50, 32), np.uint8) for _ in range(3)]
    >>> build_index(pictures).votes(pictures[1][:20]).tolist()
    [0, 20, 0]
    """
    seed = as_integer(seed, "seed")
    pictures = as_sequence(pictures, "pictures")
    if not len(pictures):
        raise ShapeError("pictures: none; need at least one")
    if seed < 0:
        raise ShapeError(f"seed: {seed}; need an integer >= 0")
    pictures = [checked_rows(rows, f"pictures[{number}]") for number, rows in enumerate(pictures)]
    for rows in pictures:
        comparable_rows(rows, pictures[0].shape[1], pictures[0].dtype.type)
    rng = np.random.default_rng(seed)
    projection = None
    if pictures[0].dtype != np.uint8:
        projection = rng.standard_normal((pictures[0].shape[1], _SIGNS)).astype(np.float32)
    elif pictures[0].shape[1] % 2 or not pictures[0].shape[1]:
        raise ShapeError(f"pictures: {pictures[0].shape[1]} bytes in a row; need an even number")
    bits = np.concatenate([_as_bits(rows, projection) for rows in pictures])
    picture = np.repeat(np.arange(len(pictures), dtype=np.int32), [len(rows) for rows in pictures])
    length = min(max(math.ceil(math.log2(max(len(bits), 2))) + _SPARE_BITS, 8), _MOST_KEY_BITS, 8 * bits.shape[1])
    chosen = np.stack([rng.permutation(8 * bits.shape[1])[:length] for _ in range(_TABLES)])
    numbers = _numbers(bits, chosen)
    order = np.argsort(numbers, axis=1, kind="stable").astype(np.int32)
    keys = np.take_along_axis(numbers, order, axis=1)
    return DescriptorIndex(bits, picture, len(pictures), chosen, keys, order, projection)


def _as_bits(rows: Image, projection: NDArray[np.float32] | None) -> Image:
    """Return rows as bits: float32 ones by the signs of projections of what differs from the row's mean."""
    if projection is None:
        return np.ascontiguousarray(rows)
    return np.packbits((rows - rows.mean(axis=1, keepdims=True)) @ projection > 0, axis=1)


def _numbers(bits: Image, chosen: Indices) -> NDArray[np.uint32]:
    """Return the number of each row in each table, (T, M)."""
    numbers = np.zeros((len(chosen), len(bits)), np.uint32)
    for table, places in enumerate(chosen.tolist()):
        for place in places:
            numbers[table] <<= 1
            numbers[table] |= (bits[:, place // 8] >> (7 - place % 8)) & 1
    return numbers


#: Number of bits set in each 16-bit number; np.bitwise_count is in NumPy 2 alone.
_POPULATION = np.unpackbits(np.arange(2**16, dtype=np.uint16).view(np.uint8).reshape(-1, 2), axis=1).sum(
    axis=1, dtype=np.uint8
)
