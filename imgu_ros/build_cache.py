# SPDX-License-Identifier: Apache-2.0
"""Parts made of given values: made once, and used again by whoever needs the same made of equal values."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np

P = ParamSpec("P")
T = TypeVar("T")


class BuildCache:
    """What was made, by the function that made it and the arguments that it was given.

    A function sees nothing but its arguments, so that what it makes cannot depend on a value that its key lacks: a
    changed parameter makes new what was given its value, and only that. Give a function the values that it reads, not
    all parameters. Arrays count as equal when they are the same object, everything else by `==`.

    Not for several threads at once.

    Parameters
    ----------
    before : parts that are used again where they are asked for with equal arguments, until `settle`
    """

    def __init__(self, before: BuildCache | None = None) -> None:
        self._made: dict[Hashable, tuple[Any, tuple[Any, ...]]] = {}
        self._before = {} if before is None else before._made

    def make(self, function: Callable[P, T], *arguments: P.args, **named: P.kwargs) -> T:
        """Return what `function` makes of hashable or array arguments, or made of equal ones before."""
        given = (*arguments, *sorted(named.items()))
        key = (function, *(_identity(value) for value in given))
        if key not in self._made:
            # The arguments are kept: as long as an array lives no other has its identity.
            made = self._before.get(key)
            self._made[key] = (function(*arguments, **named), given) if made is None else made
        return cast(T, self._made[key][0])

    def settle(self) -> None:
        """Let go of what was made before and not asked for again."""
        self._before = {}


def _identity(value: Any) -> Hashable:
    if isinstance(value, np.ndarray):
        return np.ndarray, id(value)
    known: Hashable = value
    return known
