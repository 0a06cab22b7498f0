# SPDX-License-Identifier: Apache-2.0
"""Every named case: no traceback, bounded memory and time, nothing lost, and what the case itself needs."""

from __future__ import annotations

import pytest

from fuzz.corpus_texts import ENTRIES
from fuzz.pool import run_entry


@pytest.mark.parametrize("name", ENTRIES)
def test_case(pool, name) -> None:
    failures, _ = run_entry(pool, name)
    assert failures == []
