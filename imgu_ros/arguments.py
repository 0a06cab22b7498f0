# SPDX-License-Identifier: Apache-2.0
"""Checks of arguments that are no arrays: numbers, seeds, lists, objects."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from imgu_ros.errors import ShapeError


def as_generator(rng: np.random.Generator | int, name: str = "rng") -> np.random.Generator:
    """Return a generator of random numbers: the given one, or a new one of a seed.

    Parameters
    ----------
    rng : a generator, which is returned as it is, or a seed: an integer >= 0. None is refused: a result that cannot be
        repeated is asked for by `np.random.default_rng()`
    name : what the error calls it

    Raises
    ------
    ShapeError
        If it is neither.
    """
    if isinstance(rng, np.random.Generator):
        return rng
    if isinstance(rng, int | np.integer) and not isinstance(rng, bool) and rng >= 0:
        return np.random.default_rng(int(rng))
    raise ShapeError(f"{name}: {shown_value(rng)}; need a numpy.random.Generator, or a seed: an integer >= 0")


def as_number(value: float, name: str) -> float:
    """Return a real number, of Python or numpy, as a float; NaN and infinities stay.

    Raises
    ------
    ShapeError
        If it is something else: a string, a bool, an array, an integer beyond floats.
    """
    if isinstance(value, float | int | np.floating | np.integer) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:
            pass
    raise ShapeError(f"{name}: {shown_value(value)}; need a number")


def as_integer(value: int, name: str) -> int:
    """Return an integer, of Python or numpy, as an int.

    Raises
    ------
    ShapeError
        If it is something else: a float (3.0 is one), a bool, a string, or beyond 64 bits.
    """
    if isinstance(value, int | np.integer) and not isinstance(value, bool) and abs(int(value)) < 2**63:
        return int(value)
    raise ShapeError(f"{name}: {shown_value(value)}; need an integer")


def as_flag(value: bool, name: str) -> bool:
    """Return a bool of Python or numpy as a bool.

    Raises
    ------
    ShapeError
        If it is something else, of which it is anyone's guess whether it means yes.
    """
    if isinstance(value, bool | np.bool_):
        return bool(value)
    raise ShapeError(f"{name}: {shown_value(value)}; need True or False")


def require_type(value: object, kind: type, name: str) -> None:
    """Refuse what is not an object of a class.

    Raises
    ------
    ShapeError
        If `value` is not a `kind`.
    """
    if not isinstance(value, kind):
        raise ShapeError(f"{name}: {shown_value(value)}; need a {kind.__name__}")


def require_methods(value: object, methods: Sequence[str], name: str) -> None:
    """Refuse what has not these methods and properties.

    Raises
    ------
    ShapeError
        If `value` lacks one of `methods`.
    """
    missing = [method for method in methods if not hasattr(type(value), method) and not hasattr(value, method)]
    if missing:
        raise ShapeError(f"{name}: {shown_value(value)} without {', '.join(missing)}; need an object with it")


def as_sequence(values: Any, name: str) -> Sequence[Any]:
    """Return a list, a tuple, or an array row by row, as a sequence; a string is none.

    Raises
    ------
    ShapeError
        If it is no list, tuple or array.
    """
    if isinstance(values, Sequence) and not isinstance(values, str | bytes):
        return values
    if isinstance(values, np.ndarray) and values.ndim:
        return list(values)
    raise ShapeError(f"{name}: {shown_value(values)}; need a list")


def shown_value(value: object) -> str:
    """Return a value for an error message, on one short line: numbers and words themselves, of others their type."""
    if isinstance(value, int) and abs(value) >= 2**63:
        return f"an integer of {value.bit_length()} bits"
    if isinstance(value, str):
        value = value[:41]
    if value is None or isinstance(value, bool | int | float | complex | str | np.generic):
        text = repr(value)
        return text if len(text) <= 40 else f"{text[:40]}..."
    return type(value).__name__
