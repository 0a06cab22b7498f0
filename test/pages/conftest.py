# SPDX-License-Identifier: Apache-2.0
"""Makes the modules of this folder importable, and the inputs of the pages once."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent))


@pytest.fixture(scope="session")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the commands on the pages read."""
    import inputs

    folder = tmp_path_factory.mktemp("inputs")
    inputs.make(folder)
    return folder


@pytest.fixture
def workplace(inputs: Path, tmp_path: Path) -> Path:
    """A folder of a reader: a copy of the inputs, for commands write beside them."""
    place = tmp_path / "reader"
    shutil.copytree(inputs, place)
    return place
