# SPDX-License-Identifier: Apache-2.0
"""A frame makes no more Python calls, in no more files, than it did: `benchmarks/tracked_path.py` counts them.

The limits are what was measured last, with Python 3.12: a change that lowers a count lowers its limit here. One that
raises it needs a reason in its commit message. `pytest -s` shows the counts.
"""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType, SimpleNamespace

import cv2
import numpy as np
import pytest

from imgu_ros.result import Status
from imgu_ros.shown_text import shown


@dataclass(frozen=True)
class Limit:
    """Most calls of functions of the package, files, moves between files, and all calls by OpenCV's major version."""

    calls: int
    files: int
    moves: int
    all_calls: dict[int, int]


LIMITS = {
    "tracked": Limit(275, 24, 114, {5: 2140, 4: 2158}),
    "empty": Limit(4990, 54, 2310, {5: 37200, 4: 38900}),
}
STATUS = {"tracked": Status.TRACKED, "empty": Status.LOST}


@pytest.fixture(scope="module")
def tracked_path(repository: Path) -> ModuleType:
    path = repository / "benchmarks" / "tracked_path.py"
    spec = importlib.util.spec_from_file_location("tracked_path", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their module up.
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def walks(tracked_path: ModuleType) -> SimpleNamespace:
    return tracked_path.walk_frames()


@pytest.mark.parametrize("frame", LIMITS)
def test_calls_files_and_moves_do_not_grow(frame: str, walks: SimpleNamespace) -> None:
    walk, limit = getattr(walks, frame), LIMITS[frame]
    all_calls = limit.all_calls[int(cv2.__version__.partition(".")[0])]
    print(f"\n{frame}: {walk.calls} calls in {walk.files} files, {walk.moves} moves; {walk.all_calls} all calls")
    assert walk.status == STATUS[frame].value
    assert walk.calls <= limit.calls
    assert walk.files <= limit.files
    assert walk.moves <= limit.moves
    # Before Python 3.12 a comprehension is a call of its own (PEP 709), in libraries too.
    assert walk.all_calls <= all_calls or sys.version_info < (3, 12)


def test_calls_are_counted(tracked_path: ModuleType) -> None:
    """Functions of the package, of others (`np.mean` is Python, and calls more), and in C, on a known function."""

    def process(frame: object) -> SimpleNamespace:
        for _ in range(3):
            shown("text")
        len([shown("text") for _ in range(2)])
        return SimpleNamespace(first=SimpleNamespace(status=Status.TRACKED))

    def process_more(frame: object) -> SimpleNamespace:
        np.mean([1.0, 2.0])
        return process(frame)

    walk = tracked_path.count_calls(process, None)
    assert (walk.calls, walk.files, walk.moves, walk.status) == (5, 1, 0, "tracked")
    assert walk.calls_by_file() == {"shown_text.py": 5}
    # process, five calls of shown, and functions in C that these call.
    assert walk.all_calls >= 1 + 5 + 1
    more = tracked_path.count_calls(process_more, None)
    assert more.calls == 5 and more.all_calls > walk.all_calls + 2
