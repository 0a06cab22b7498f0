"""Distances between descriptors."""

from __future__ import annotations

import numpy as np

from imgu_ros.errors import ShapeError
from imgu_ros.types import Choice, Image

#: Of the numbers in a row: their squares are summed in single precision.
_LARGEST = 1e15


class Metric(Choice):
    """Distances between descriptors."""

    AUTO = "auto"  #: Hamming for uint8 rows, Euclidean for float32 rows
    EUCLIDEAN = "euclidean"
    COSINE = "cosine"  #: 1 - cosine of the angle between the rows
    HAMMING = "hamming"


def resolved(metric: Metric | str, rows: Image) -> Metric:
    """Return the metric that compares such rows: `auto` becomes Hamming for uint8 and Euclidean for float32.

    Raises
    ------
    ShapeError
        If the metric does not fit the rows' data type.
    """
    metric = Metric(metric)
    if metric is Metric.AUTO:
        return Metric.HAMMING if rows.dtype == np.uint8 else Metric.EUCLIDEAN
    if (metric is Metric.HAMMING) != (rows.dtype == np.uint8):
        raise ShapeError(f"metric {metric}: data type {rows.dtype}; hamming needs uint8, the others float32")
    return metric


def checked_rows(rows: Image, name: str) -> Image:
    """Return descriptors when they are (N, D >= 1) uint8 or float32, finite and below 1e15.

    Raises
    ------
    ShapeError
        If they are not.
    """
    if not isinstance(rows, np.ndarray):
        raise ShapeError(f"{name}: {type(rows).__name__}; need a numpy array")
    if rows.ndim != 2 or not rows.shape[1] or rows.dtype not in (np.uint8, np.float32):
        raise ShapeError(f"{name}: shape {rows.shape}, data type {rows.dtype}; need (N, D >= 1) uint8 or float32")
    # Squares of larger numbers overflow; NaN compares as not less.
    if rows.dtype == np.float32 and rows.size and not max(rows.max(), -rows.min()) < _LARGEST:
        raise ShapeError(f"{name}: NaN or numbers beyond {_LARGEST:g}; need finite numbers")
    return rows
