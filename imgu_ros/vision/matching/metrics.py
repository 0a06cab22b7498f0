# SPDX-License-Identifier: Apache-2.0
"""Distances between descriptors, and which of them make sense for which descriptor (IU 5.1, 5.3, 5.4.2)."""

from __future__ import annotations

import numpy as np

from imgu_ros.arguments import as_integer, shown_value
from imgu_ros.errors import ShapeError
from imgu_ros.types import Choice, Image, Indices, as_plain
from imgu_ros.vision.methods import DESCRIPTORS, DescriptorMethod, method_named


class Metric(Choice):
    """Distances between descriptors a and b; smaller is better."""

    AUTO = "auto"  #: Hamming for uint8 rows, Euclidean for float32 rows; in `metric_for`, NCC for patches
    EUCLIDEAN = "euclidean"  #: |a - b|
    COSINE = "cosine"  #: 1 - cosine of the angle between a and b; 0 to 2
    HAMMING = "hamming"  #: differing bits
    SSD = "ssd"  #: |a - b|^2
    ZMSSD = "zmssd"  #: |a - b|^2 of the rows less their means
    NCC = "ncc"  #: 1 - cosine of the angle between the rows less their means: 1 - normalised cross-correlation


def metrics_of(kind: DescriptorMethod | str) -> tuple[Metric, ...]:
    """Return the metrics that make sense for a kind of descriptor, the one that `auto` stands for first.

    Examples
    --------
    >>> [str(metric) for metric in metrics_of("patch")]
    ['ncc', 'zmssd', 'ssd']
    """
    row = kind if isinstance(kind, DescriptorMethod) else method_named(DESCRIPTORS, kind, "kind")
    return tuple(map(Metric, row.metrics))


def metric_for(kind: DescriptorMethod | str, metric: Metric | str = Metric.AUTO) -> Metric:
    """Return the metric for a kind of descriptor: `auto` becomes the best one, another is checked.

    Raises
    ------
    ShapeError
        If the metric makes no sense for the descriptor; the message says why, and which ones do.

    Examples
    --------
    >>> str(metric_for("sift", "auto"))
    'euclidean'
    """
    row = kind if isinstance(kind, DescriptorMethod) else method_named(DESCRIPTORS, kind, "kind")
    metric, sensible = Metric(metric), metrics_of(row)
    if metric is Metric.AUTO:
        return sensible[0]
    if metric not in sensible:
        raise ShapeError(f"metric {metric}: {row.name} {row.nature}; need {' or '.join(sensible)}")
    return metric


def metric_of_rows(rows: Image, metric: Metric | str = Metric.AUTO) -> Metric:
    """Return the metric for rows of unknown kind: `auto` becomes Hamming for uint8 and Euclidean for float32.

    Raises
    ------
    ShapeError
        If the metric does not fit the rows' data type.
    """
    rows = checked_rows(rows, "rows")
    metric = Metric(metric)
    if metric is Metric.AUTO:
        return Metric.HAMMING if rows.dtype == np.uint8 else Metric.EUCLIDEAN
    if (metric is Metric.HAMMING) != (rows.dtype == np.uint8):
        raise ShapeError(f"metric {metric}: data type {rows.dtype}; hamming needs uint8, the others float32")
    return metric


def checked_rows(rows: Image, name: str) -> Image:
    """Return descriptors as (N, D >= 1) uint8 or finite float32.

    Parameters
    ----------
    rows : (N, D), uint8 (bits) or float32. float64 is taken as float32, and bool, a row of bits each (scikit-image),
        as those bits packed into uint8
    name : what the error calls them

    Raises
    ------
    ShapeError
        If they are not.
    """
    rows = as_plain(rows, name)
    if rows.ndim == 2 and rows.dtype == np.bool_:
        rows = np.packbits(rows, axis=1)
    if rows.ndim == 2 and rows.dtype.kind == "f" and rows.dtype != np.float32:
        with np.errstate(over="ignore"):
            rows = rows.astype(np.float32)
    if rows.ndim != 2 or not rows.shape[1] or rows.dtype not in (np.uint8, np.float32):
        raise ShapeError(f"{name}: shape {rows.shape}, data type {rows.dtype}; need (N, D >= 1) uint8 or float32")
    # Extremes find NaN and infinity without an array of flags.
    if rows.dtype == np.float32 and rows.size and not -np.inf < rows.min() <= rows.max() < np.inf:
        raise ShapeError(f"{name}: NaN or infinity; need finite numbers")
    return rows


def comparable_rows(src: Image, columns: int, dtype: type) -> Image:
    """Return the descriptors `src`, (N, `columns`), as `checked_rows` does, when others of `dtype` compare with them.

    Raises
    ------
    ShapeError
        If `checked_rows` refuses them, or they have another length or data type.
    """
    columns = as_integer(columns, "columns")
    src = checked_rows(src, "src")
    if not (isinstance(dtype, type) and dtype in (np.uint8, np.float32)):
        raise ShapeError(f"dtype: {shown_value(dtype)}; need np.uint8 or np.float32")
    if src.shape[1] != columns or src.dtype != dtype:
        raise ShapeError(f"src: {src.shape[1]} x {src.dtype}; need {columns} x {np.dtype(dtype)}, as dst")
    return src


def require_index(index: Indices, length: int, count: int) -> None:
    """Check indices into `count` rows, of which there are to be `length`.

    Parameters
    ----------
    index : (length,) integers from 0 to count - 1

    Raises
    ------
    ShapeError
        If it is no (length,) array of integers, or one is out of range.
    """
    length = as_integer(length, "length")
    count = as_integer(count, "count")
    if not isinstance(index, np.ndarray) or index.dtype.kind not in "iu" or index.shape != (length,):
        raise ShapeError(f"index: {getattr(index, 'shape', type(index).__name__)}; need ({length},) integers")
    if len(index) and not 0 <= index.min() <= index.max() < count:
        raise ShapeError(f"index: {index.min()} to {index.max()}; need 0 to {count - 1}")
