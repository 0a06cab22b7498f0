# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import cv2
import numpy as np
import pytest

from imgu_ros.errors import ShapeError
from imgu_ros.vision.matching import hamming_distance, match


def _counted(a: np.ndarray, b: np.ndarray) -> int:
    """The definition, on whole rows as numbers of Python."""
    return bin(int.from_bytes(a.tobytes(), "big") ^ int.from_bytes(b.tobytes(), "big")).count("1")


@pytest.mark.parametrize("length", [1, 3, 32, 64])
def test_all_pairs_against_pythons_own_bits(length: int) -> None:
    rng = np.random.default_rng(length)
    a, b = rng.integers(0, 256, (20, length), np.uint8), rng.integers(0, 256, (30, length), np.uint8)
    expected = [[_counted(one, other) for other in b] for one in a]
    got = hamming_distance(a[:, None], b)
    assert got.dtype == np.int64 and got.tolist() == expected
    assert hamming_distance(a, b[:20]).tolist() == [expected[i][i] for i in range(20)]
    assert hamming_distance(a, b[7]).tolist() == [row[7] for row in expected]
    assert hamming_distance(a[2], b[3]).shape == () and int(hamming_distance(a[2], b[3])) == expected[2][3]
    # OpenCV's own.
    assert got.tolist() == [[cv2.norm(one, other, cv2.NORM_HAMMING) for other in b] for one in a]


def test_a_distance_of_bits_one_by_one() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.integers(0, 2, (9, 21)).astype(bool), rng.integers(0, 2, (9, 21)).astype(bool)
    assert hamming_distance(a, b).tolist() == (a != b).sum(axis=1).tolist()
    assert hamming_distance(a, b).tolist() == hamming_distance(np.packbits(a, axis=1), np.packbits(b, axis=1)).tolist()


def test_views_and_none() -> None:
    a = np.random.default_rng(1).integers(0, 256, (8, 64), np.uint8)
    assert (
        hamming_distance(a[::-2, ::2], a[::2, ::2]).tolist()
        == hamming_distance(a[::-2, ::2].copy(), a[::2, ::2].copy()).tolist()
    )
    assert hamming_distance(a[:0], a[:0]).shape == (0,)
    assert hamming_distance(a[:0, None], a).shape == (0, 8)


def test_it_is_what_matches_tell() -> None:
    rng = np.random.default_rng(2)
    src, dst = rng.integers(0, 256, (40, 32), np.uint8), rng.integers(0, 256, (50, 32), np.uint8)
    found = match(src, dst, ratio=1, mutual=False)
    table = hamming_distance(src[:, None], dst)
    assert found.distance.tolist() == table[found.index_src, found.index_dst].tolist()
    assert found.distance[np.argsort(found.index_src)].tolist() == table.min(axis=1).tolist()


@pytest.mark.parametrize(
    ("a", "b"),
    [
        (np.zeros((2, 4), np.uint8), np.zeros((2, 5), np.uint8)),
        (np.zeros((2, 4), np.uint8), np.zeros((3, 4), np.uint8)),
        (np.zeros((2, 4), np.uint8), np.zeros((2, 4), bool)),
        (np.zeros((2, 4)), np.zeros((2, 4))),
        (np.zeros((2, 0), np.uint8), np.zeros((2, 0), np.uint8)),
        (np.uint8(3), np.uint8(3)),
        ([[1, 2]], [[1, 2]]),
        (None, np.zeros((2, 4), np.uint8)),
    ],
)
def test_rows_that_do_not_compare_are_refused(a: object, b: object) -> None:
    with pytest.raises(ShapeError, match=r"^(a|b|a, b): [^\n]+; need [^\n]+$"):
        hamming_distance(a, b)  # type: ignore[arg-type]
