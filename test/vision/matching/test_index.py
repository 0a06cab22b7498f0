# SPDX-License-Identifier: Apache-2.0
"""The shared index against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from imgu_ros.errors import ShapeError
from imgu_ros.vision.matching.index import build_index

PICTURES, ROWS = 40, 300


def noisy(rng: np.random.Generator, rows: NDArray[np.uint8], flipped: float) -> NDArray[np.uint8]:
    """Rows of which each bit is flipped with a probability."""
    flips = np.packbits(rng.random((len(rows), rows.shape[1] * 8)) < flipped, axis=1)
    return rows ^ flips


@pytest.fixture(scope="module")
def pictures() -> list[NDArray[np.uint8]]:
    rng = np.random.default_rng(5)
    return [rng.integers(0, 256, (ROWS, 32), np.uint8) for _ in range(PICTURES)]


@pytest.mark.parametrize("flipped", [0.05, 0.12, 0.18])
def test_pictures_in_view_come_first(pictures: list[NDArray[np.uint8]], flipped: float) -> None:
    """80 rows of three pictures each, noisy, among 500 of none; brute force gives how many could be told."""
    rng = np.random.default_rng(6)
    shown = (3, 17, 31)
    rows = np.concatenate([noisy(rng, pictures[i][:80], flipped) for i in shown])
    rows = np.concatenate([rows, rng.integers(0, 256, (500, 32), np.uint8)])
    votes = build_index(pictures).votes(rows)
    assert sorted(np.argsort(-votes)[:3].tolist()) == list(shown)
    assert votes[list(shown)].min() > 3 * max(1, np.delete(votes, shown).max())

    everything = np.concatenate(pictures)
    distance = np.bitwise_xor(rows[:240, None], everything[None])
    nearest = np.unpackbits(distance, axis=2).sum(axis=2).argmin(axis=1) // ROWS
    told = np.bincount(nearest, minlength=PICTURES)
    assert (votes <= told).all()  # a vote is never wrong here
    if flipped <= 0.12:
        assert votes.sum() >= 0.6 * told.sum()


def test_numbers_vote_by_the_signs_of_projections() -> None:
    rng = np.random.default_rng(7)
    pictures = [rng.random((100, 128), np.float32) for _ in range(9)]
    rows = pictures[4][:50] + rng.normal(0, 0.05, (50, 128)).astype(np.float32)
    votes = build_index(pictures).votes(rows)
    assert votes.argmax() == 4 and votes[4] >= 40 and np.delete(votes, 4).sum() == 0


def test_a_row_that_two_pictures_share_tells_nothing(pictures: list[NDArray[np.uint8]]) -> None:
    index = build_index([pictures[0], pictures[1], pictures[0]])
    assert index.votes(pictures[0][:50]).tolist() == [0, 0, 0]
    assert index.votes(pictures[1][:50]).tolist() == [0, 50, 0]


def test_the_same_pictures_give_the_same_index(pictures: list[NDArray[np.uint8]]) -> None:
    first, second = build_index(pictures[:5]), build_index(pictures[:5])
    np.testing.assert_array_equal(first.keys, second.keys)
    np.testing.assert_array_equal(first.order, second.order)
    assert (first.chosen != build_index(pictures[:5], seed=1).chosen).any()


def test_nothing_filed_and_nothing_asked() -> None:
    index = build_index([np.zeros((0, 32), np.uint8)] * 2)
    assert index.votes(np.zeros((4, 32), np.uint8)).tolist() == [0, 0]
    index = build_index([np.zeros((3, 32), np.uint8)])
    assert index.votes(np.zeros((0, 32), np.uint8)).tolist() == [0]


def test_bad_input() -> None:
    rows = np.zeros((3, 32), np.uint8)
    with pytest.raises(ShapeError, match="pictures: none"):
        build_index([])
    with pytest.raises(ShapeError, match="seed"):
        build_index([rows], seed=-1)
    with pytest.raises(ShapeError, match="even number"):
        build_index([np.zeros((3, 5), np.uint8)])
    with pytest.raises(ShapeError):
        build_index([rows, np.zeros((3, 16), np.uint8)])
    with pytest.raises(ShapeError):
        build_index([rows]).votes(np.zeros((3, 32), np.float32))
