# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import ShapeError
from imgu_ros.vision.matching import hamming, numbers
from imgu_ros.vision.matching.gallery import prepare_gallery
from imgu_ros.vision.matching.metrics import Metric
from imgu_ros.vision.matching.nearest import match, match_to_gallery


def distance_by_definition(a, b, metric):
    if metric == "hamming":
        return float(sum((int(x) ^ int(y)).bit_count() for x, y in zip(a, b, strict=True)))
    a, b = [float(x) for x in a], [float(x) for x in b]
    if metric == "euclidean":
        return math.dist(a, b)
    if metric in ("zmssd", "ncc"):
        a, b = ([x - math.fsum(row) / len(row) for x in row] for row in (a, b))
    if metric in ("ssd", "zmssd"):
        return math.dist(a, b) ** 2
    lengths = math.hypot(*a) * math.hypot(*b)
    return 1 - (math.fsum(x * y for x, y in zip(a, b, strict=True)) / lengths if lengths else 0)


def matched_by_loops(src, dst, metric, ratio, mutual, xy=None, same_place=8.0):
    """Tentative matches as {src row: (set of equally near dst rows, distance, quotient)}, by plain loops."""
    table = [[distance_by_definition(a, b, metric) for b in dst] for a in src]
    found = {}
    for i, row in enumerate(table):
        best = min(row)
        nearest = {j for j, d in enumerate(row) if d == best}
        if mutual:
            nearest = {j for j in nearest if table[i][j] == min(table[k][j] for k in range(len(src)))}
        choices = {}
        for j in nearest:
            rivals = [
                d
                for k, d in enumerate(row)
                if k != j and (xy is None or max(abs(xy[k][0] - xy[j][0]), abs(xy[k][1] - xy[j][1])) > same_place)
            ]
            if not rivals:
                quotient = 0.0
            else:
                quotient = best / min(rivals) if min(rivals) > 0 else 1.0
            if ratio >= 1 or quotient < ratio:
                choices[j] = quotient
        if choices:
            found[i] = (choices, best)
    return found


def check(src, dst, metric, ratio, mutual, xy=None, same_place=8.0):
    got = match(src, dst, metric, ratio, mutual, xy, same_place)
    expected = matched_by_loops(src, dst, metric, ratio, mutual, xy, same_place)
    quotients = []
    assert len(set(got.index_src.tolist())) == len(got)
    for i, j, d in zip(got.index_src.tolist(), got.index_dst.tolist(), got.distance, strict=True):
        assert i in expected
        choices, best = expected[i]
        assert j in choices
        assert d == pytest.approx(best, rel=1e-6, abs=1e-6)
        quotients.append(choices[j])
    assert all(a <= b + 1e-9 for a, b in itertools.pairwise(quotients))
    return got, expected


bits = st.integers(0, 2**32).map(lambda seed: np.random.default_rng(seed))


@given(bits, st.integers(1, 12), st.integers(1, 12), st.sampled_from([0.5, 0.85, 1.0]), st.booleans(), st.booleans())
def test_hamming_with_ties_against_loops(rng, n, m, ratio, mutual, placed):
    # One byte of few values: many ties and exact copies.
    src, dst = rng.integers(0, 8, (n, 1), np.uint8), rng.integers(0, 8, (m, 1), np.uint8)
    xy = rng.integers(0, 40, (m, 2)).astype(float) if placed else None
    got, expected = check(src, dst, "hamming", ratio, mutual, xy)
    if not mutual:
        # Of equally near rows the first is taken: what is kept is what the loops keep for that row.
        table = [[distance_by_definition(a, b, "hamming") for b in dst] for a in src]
        firsts = {i: row.index(min(row)) for i, row in enumerate(table)}
        assert dict(zip(got.index_src.tolist(), got.index_dst.tolist(), strict=True)) == {
            i: firsts[i] for i in expected if firsts[i] in expected[i][0]
        }


@pytest.mark.parametrize("metric", ["auto", "euclidean", "cosine", "hamming", "ssd", "zmssd", "ncc"])
@given(bits, st.integers(1, 20), st.integers(1, 20), st.sampled_from([0.7, 0.9, 1.0]), st.booleans(), st.booleans())
def test_every_metric_against_loops(metric, rng, n, m, ratio, mutual, placed):
    if metric == "hamming":
        src, dst = rng.integers(0, 256, (n, 32), np.uint8), rng.integers(0, 256, (m, 32), np.uint8)
    else:
        src, dst = rng.normal(size=(n, 9)).astype(np.float32), rng.normal(size=(m, 9)).astype(np.float32)
    xy = rng.integers(0, 30, (m, 2)).astype(float) if placed else None
    got, expected = check(src, dst, "euclidean" if metric == "auto" else metric, ratio, mutual, xy)
    if metric != "hamming":  # no ties: the very same rows
        assert set(got.index_src.tolist()) == set(expected)
    if metric == "auto":
        same = match(src, dst, Metric.AUTO, ratio, mutual, xy)
        np.testing.assert_array_equal(same.index_src, got.index_src)


@given(bits, st.integers(1, 40), st.integers(1, 40), st.sampled_from([1, 3, 31, 32, 33, 70]), st.booleans())
def test_bits_in_blocks_and_of_any_length(rng, n, m, columns, placed):
    # Nearly equal and nearly opposite rows: the largest sums, where single precision is at its limit.
    base = rng.integers(0, 256, columns, np.uint8) if placed else np.uint8(255 * rng.integers(0, 2))
    src, dst = (base ^ np.uint8(255) * rng.integers(0, 2, (k, 1), np.uint8) for k in (n, m))
    src, dst = (rows * np.ones(columns, np.uint8) for rows in (src, dst))
    for rows in (src, dst):
        rows[rng.random(len(rows)) < 0.5, rng.integers(0, columns)] ^= np.uint8(1 << rng.integers(0, 8))
    xy = rng.integers(0, 40, (m, 2)).astype(float) if placed else None
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(hamming, "_BLOCK_ELEMENTS", int(rng.integers(1, 200)))
        patch.setattr(hamming, "_PRODUCT_ELEMENTS", int(rng.integers(1, 400)))
        patch.setattr(numbers, "_BLOCK_ELEMENTS", int(rng.integers(1, 200)))
        got, _ = check(src, dst, "hamming", 0.9, True, xy)
        tables = np.concatenate([table.copy() for table in hamming.binary_rows(dst).tables(src)])
        check(src[:, :2].astype(np.float32), dst[:, :2].astype(np.float32), "euclidean", 0.9, True, xy)
    added = 256 * -(-columns // 32)
    expected = [[added + 8 * columns - 2 * distance_by_definition(a, b, "hamming") for b in dst] for a in src]
    np.testing.assert_array_equal(tables, expected)
    assert all(a.is_integer() for a in got.distance.tolist())


def test_rows_of_many_bits():
    rng = np.random.default_rng(11)
    src = rng.integers(0, 256, (5, 5000), np.uint8)
    dst = np.vstack([~src, src[::-1]])
    got = match(src, dst)
    assert got.index_dst.tolist() == [9 - i for i in got.index_src.tolist()] and len(got) == 5
    assert not got.distance.any()


def test_a_gallery_answers_as_the_rows_themselves():
    rng = np.random.default_rng(12)
    xy = rng.uniform(0, 60, (90, 2))
    binary = rng.integers(0, 256, (50, 32), np.uint8), rng.integers(0, 256, (90, 32), np.uint8)
    real = [rng.normal(size=(k, 40)).astype(np.float32) for k in (50, 90)]
    for metric in Metric:
        src, dst = binary if metric is Metric.HAMMING else real
        gallery = prepare_gallery(dst, metric, xy)
        assert len(gallery) == 90
        for _ in range(2):  # using it does not change it
            got, expected = match_to_gallery(src, gallery, 0.95), match(src, dst, metric, 0.95, dst_xy=xy)
            for name in ("index_src", "index_dst", "distance"):
                np.testing.assert_array_equal(getattr(got, name), getattr(expected, name))
        with pytest.raises(ShapeError, match="need"):
            match_to_gallery(src[:, :7], gallery)


@pytest.mark.parametrize("metric", ["euclidean", "ssd", "zmssd", "ncc", "cosine"])
@pytest.mark.parametrize("size", [1e-30, 1.0, 3e35])
def test_numbers_of_any_size(metric, size):
    rng = np.random.default_rng(13)
    dst = (rng.normal(size=(40, 30)) * size).astype(np.float32)
    src = (dst[::-1].astype(float) * 1.001).astype(np.float32)
    got = match(src, dst, metric, 0.5)
    assert sorted(got.index_src.tolist()) == list(range(40))
    assert (got.index_dst == 39 - got.index_src).all() and np.isfinite(got.distance).all()


@pytest.mark.parametrize("metric", ["euclidean", "ssd", "zmssd", "ncc"])
def test_small_differences_of_large_numbers(metric):
    # Products of such rows agree in all digits of single precision.
    rng = np.random.default_rng(14)
    dst = (1e5 + rng.integers(-8, 9, (50, 20)) / 16).astype(np.float32)
    src = (dst[rng.permutation(50)] + rng.integers(-1, 2, (50, 20)) / 16).astype(np.float32)
    check(src, dst, metric, 0.9, True)


def test_offset_and_gain():
    rng = np.random.default_rng(15)
    src, dst = (rng.integers(0, 64, (k, 25)).astype(np.float32) for k in (20, 30))
    gain, offset = rng.integers(1, 5, (30, 1)), rng.integers(-100, 100, (30, 1))
    for metric, changed in (("zmssd", dst + offset), ("ncc", dst * gain + offset), ("cosine", dst * gain)):
        a, b = (match(src, rows.astype(np.float32), metric, 1.0, False) for rows in (dst, changed))
        np.testing.assert_array_equal(a.index_dst, b.index_dst)
        np.testing.assert_allclose(a.distance, b.distance, atol=1e-12)


def test_constant_patches_resemble_nothing():
    flat = np.full((2, 9), 0.1, np.float32)
    other = np.arange(9, dtype=np.float32)[None]
    assert match(flat, np.vstack([flat, other]), "ncc", 1.0, False).distance.tolist() == [1.0, 1.0]


def test_euclidean_ties_of_whole_numbers():
    rng = np.random.default_rng(5)
    for _ in range(20):
        src = rng.integers(0, 3, (9, 2)).astype(np.float32)
        dst = rng.integers(0, 3, (7, 2)).astype(np.float32)
        check(src, dst, "euclidean", 1.0, True)
        check(src, dst, "euclidean", 0.8, False)


def test_sift_like_numbers_are_exact():
    rng = np.random.default_rng(6)
    src = rng.integers(0, 256, (60, 128)).astype(np.float32)
    dst = np.vstack([src[::-1] + rng.integers(-9, 10, src.shape), rng.integers(0, 256, (30, 128))]).astype(np.float32)
    got, _ = check(src, dst, "euclidean", 0.85, True)
    np.testing.assert_array_equal(np.sort(got.index_src), np.arange(60))
    np.testing.assert_array_equal(got.index_dst, 59 - got.index_src)


def test_ratio_by_hand():
    dst = np.array([[0.0], [10.0]], np.float32)
    src = np.array([[1.0], [4.0], [9.5]], np.float32)  # quotients 1/9, 4/6, 0.5/9.5
    got = match(src, dst, ratio=0.6, mutual=False)
    assert got.index_src.tolist() == [2, 0]
    assert got.index_dst.tolist() == [1, 0]
    assert got.distance.tolist() == [0.5, 1.0]
    assert len(got) == 2
    assert match(src, dst, ratio=4 / 6 + 1e-6, mutual=False).index_src.tolist() == [2, 0, 1]
    assert match(src, dst, ratio=0.9, mutual=True).index_src.tolist() == [2, 0]


def test_two_exact_copies_are_ambiguous_but_one_place_is_not():
    row = np.array([[7, 7]], np.uint8)
    dst = np.vstack([row, row, row ^ 255])
    assert len(match(row, dst, ratio=0.99)) == 0
    assert match(row, dst, ratio=1).index_dst.tolist() == [0]
    near, far = np.array([[5.0, 5], [13, -3], [90, 90]]), np.array([[5.0, 5], [13.1, 5], [90, 90]])
    assert match(row, dst, ratio=0.5, dst_xy=near).index_dst.tolist() == [0]
    assert len(match(row, dst, ratio=0.5, dst_xy=far)) == 0
    assert len(match(row, dst, ratio=0.5, dst_xy=far, same_place_px=9)) == 1


def test_all_rows_at_one_place_have_no_rival():
    rng = np.random.default_rng(7)
    src, dst = rng.integers(0, 256, (3, 4), np.uint8), rng.integers(0, 256, (6, 4), np.uint8)
    assert len(match(src, dst, ratio=0.1, mutual=False, dst_xy=np.zeros((6, 2)))) == 3


def test_rows_of_zeros_have_no_direction():
    src = np.array([[1, 0], [0, 0]], np.float32)
    dst = np.array([[0, 0], [0.3, 0.9539392], [-1, 0]], np.float32)
    got = match(src, dst, "cosine", 1.0, False)
    by_row = dict(zip(got.index_src.tolist(), got.distance, strict=True))
    assert by_row == {0: pytest.approx(0.7, abs=1e-6), 1: 1.0}
    check(src, dst, "cosine", 1.0, False)
    check(src, dst, "cosine", 0.8, False)


@pytest.mark.parametrize(("n", "m"), [(0, 5), (5, 0), (0, 0)])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_nothing_to_match(n, m, dtype):
    got = match(np.zeros((n, 32), dtype), np.zeros((m, 32), dtype), dst_xy=np.zeros((m, 2)))
    assert len(got) == 0 and got.index_src.dtype == np.intp and got.distance.shape == (0,)


def test_single_rows():
    one, other = np.array([[1, 2]], np.float32), np.array([[4, 6]], np.float32)
    got = match(one, other)
    assert (got.index_src.tolist(), got.index_dst.tolist(), got.distance.tolist()) == ([0], [0], [5.0])


def test_views_and_read_only_rows():
    rng = np.random.default_rng(8)
    wide = rng.integers(0, 256, (10, 64), np.uint8)
    src, dst = wide[:, ::2], wide[::-1, ::2]
    src.flags.writeable = dst.flags.writeable = False
    got = match(src, dst)
    np.testing.assert_array_equal(got.index_dst, 9 - got.index_src)
    assert len(got) == 10 and not got.distance.any()


F, B = np.ones((3, 8), np.float32), np.ones((3, 8), np.uint8)


@pytest.mark.parametrize(
    ("src", "dst", "options"),
    [
        (F, B, {}),
        (F, F[:, :4], {}),
        (F, F.astype(int), {}),
        (F.tolist(), F, {}),
        (None, F, {}),
        (F[0], F, {}),
        (F[:, :0], F[:, :0], {}),
        (F, F, {"metric": "hamming"}),
        (B, B, {"metric": "euclidean"}),
        (B, B, {"metric": "manhattan"}),
        (F * np.nan, F, {}),
        (F, np.where(np.eye(3, 8) > 0, np.inf, F).astype(np.float32), {"metric": "cosine"}),
        (B, F, {"metric": "ncc"}),
        (F, F, {"same_place_px": -1}),
        (F, F, {"same_place_px": math.nan}),
        (F, F, {"ratio": math.nan}),
        (F, F, {"ratio": 0}),
        (F, F, {"dst_xy": np.zeros((2, 2))}),
        (F, F, {"dst_xy": np.zeros((3, 3))}),
        (F, F, {"dst_xy": np.full((3, 2), np.nan)}),
    ],
)
def test_bad_input_is_refused(src, dst, options):
    with pytest.raises(ShapeError, match=r"^[^\n]+need[^\n]+$"):
        match(src, dst, **options)
