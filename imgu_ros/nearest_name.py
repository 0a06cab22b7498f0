# SPDX-License-Identifier: Apache-2.0
"""The known name that a misspelled one probably means; for error messages."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

#: Names come from outside: only the start of an endless one is compared.
_LONGEST = 80


def nearest_name(name: object, known: Iterable[str]) -> str:
    """Return the known name nearest to `name`, whatever the case of either; empty when none is near.

    Parameters
    ----------
    name : as it was given; of something that is no text, its text is compared
    known : the names that are accepted

    Examples
    --------
    >>> nearest_name("BAYER_RGBG8", ["mono8", "bayer_rggb8"])
    'bayer_rggb8'
    >>> nearest_name("h264", ["mono8", "bayer_rggb8"])
    ''
    """
    by_folded: dict[str, str] = {}
    for candidate in known:
        by_folded.setdefault(candidate.casefold(), candidate)
    near = difflib.get_close_matches(str(name)[:_LONGEST].casefold(), by_folded, n=1)
    return by_folded[near[0]] if near else ""
