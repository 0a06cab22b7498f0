# SPDX-License-Identifier: Apache-2.0
"""Parts: made once of equal values, made anew of others, and let go when nobody asks for them again."""

from __future__ import annotations

import gc
import weakref

import numpy as np

from imgu_ros.build_cache import BuildCache


class Made:
    """What a function makes, unlike any other."""


CALLS: list[tuple[object, ...]] = []


def thing(*values: object) -> Made:
    CALLS.append(values)
    return Made()


def another(*values: object) -> Made:
    return Made()


def test_equal_values_make_one_thing() -> None:
    parts, array = BuildCache(), np.zeros(3)
    first = parts.make(thing, array, 2.0, ("a", 1))
    assert parts.make(thing, array, 2.0, ("a", 1)) is first
    # An array is the one that it is, whatever it holds.
    assert parts.make(thing, array.copy(), 2.0, ("a", 1)) is not first
    assert parts.make(thing, array, 2.5, ("a", 1)) is not first
    assert parts.make(another, array, 2.0, ("a", 1)) is not first


def test_the_next_takes_over_what_it_asks_for_and_the_rest_is_let_go() -> None:
    before = BuildCache()
    kept, left = before.make(thing, 1), before.make(thing, 2)
    count, gone = len(CALLS), weakref.ref(left)
    after = BuildCache(before)
    assert after.make(thing, 1) is kept
    after.settle()
    assert len(CALLS) == count
    assert before.make(thing, 2) is left, "who goes on with the old parts loses nothing"
    del before, left
    gc.collect()
    assert gone() is None
    assert after.make(thing, 2) is not None and len(CALLS) == count + 1


def test_an_array_that_is_gone_is_not_mistaken_for_another() -> None:
    parts = BuildCache()
    made = {id(parts.make(thing, np.zeros(1000))) for _ in range(50)}
    assert len(made) == 50
