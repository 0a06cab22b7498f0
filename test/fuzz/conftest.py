# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
if str(REPOSITORY) not in sys.path:  # pytest that was not started as a module
    sys.path.append(str(REPOSITORY))


@pytest.fixture(scope="module")
def pool():
    """One worker process for a file's cases."""
    from fuzz.pool import Pool

    with Pool() as pool:
        yield pool
