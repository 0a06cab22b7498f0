# SPDX-License-Identifier: Apache-2.0
"""What each room of vision/ exports, and that importing it stays light."""

from __future__ import annotations

import csv
import importlib
import inspect
import pkgutil
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest

import imgu_ros.vision

PACKAGE = "imgu_ros.vision"
ROOMS = [item.name for item in pkgutil.iter_modules(imgu_ros.vision.__path__) if item.ispkg]


def _public(room: ModuleType) -> dict[str, object]:
    """Every public function and class that a module of the room defines."""
    found: dict[str, object] = {}
    for item in pkgutil.walk_packages(room.__path__, f"{room.__name__}."):
        module = importlib.import_module(item.name)
        for name, value in vars(module).items():
            own = getattr(value, "__module__", None) == module.__name__
            named = inspect.isfunction(value) or inspect.isclass(value) or hasattr(value, "__wrapped__")
            if own and named and not name.startswith("_") and not name.endswith("unchecked"):
                assert name not in found, f"{room.__name__}: two modules define {name}"
                found[name] = value
    return found


@pytest.mark.parametrize("name", ROOMS)
def test_a_room_exports_what_is_public_in_it_and_nothing_else(name: str) -> None:
    room = importlib.import_module(f"{PACKAGE}.{name}")
    public = _public(room)
    assert len(public) > 10
    assert sorted(public) == room.__all__, f"imgu_ros/vision/{name}/__init__.py: imports and __all__ are to be these"
    for exported in room.__all__:
        assert getattr(room, exported) is public[exported], exported
    assert (room.__doc__ or "").strip()


def test_every_algorithm_is_reached_by_its_short_path(repository: Path) -> None:
    with (repository / "docs" / "algorithms.csv").open(newline="", encoding="utf-8") as file:
        paths = {row["function"] for row in csv.DictReader(file)}
    assert len(paths) > 150
    for path in paths:
        if not path.startswith(f"{PACKAGE}."):
            continue
        room, *modules, name = path.removeprefix(f"{PACKAGE}.").split(".")
        short = importlib.import_module(f"{PACKAGE}.{room}")
        # A method follows its class, a function its module.
        owner = next((part for part in modules if part[0].isupper()), None)
        reached = getattr(getattr(short, owner), name) if owner else getattr(short, name)
        assert callable(reached) or isinstance(reached, property), path


@pytest.mark.parametrize("name", ROOMS)
def test_any_room_can_be_imported_first(name: str) -> None:
    """Rooms import each other's modules: none may need another one to have been imported before it."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", f"from {PACKAGE}.{name} import *"],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr


def test_the_package_itself_imports_nothing() -> None:
    code = f"import sys, {PACKAGE}\nsys.exit(any(name in sys.modules for name in ('numpy', 'cv2', 'scipy')))"
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0


def test_a_function_named_like_its_module_is_the_function_however_it_is_imported() -> None:
    code = (
        f"import {PACKAGE}.formation.demosaic as first\n"
        f"from {PACKAGE}.formation.demosaic import demosaic as second\n"
        f"from {PACKAGE}.formation import demosaic as third\n"
        "assert first is second is third and callable(third)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_the_short_example() -> None:
    from imgu_ros.vision.projective import estimate_homography, fit_homography
    from imgu_ros.vision.projective.estimate import estimate_homography as from_its_module

    assert estimate_homography is from_its_module and callable(fit_homography)


#: What two values are is said by the function's name, or is points and which of them are valid.
PAIRS = {
    "rq", "distort", "undistort", "ideal_pixels", "project_with_jacobian", "as_correspondences",
    "poses_about_point", "checked_size", "aspect",
}  # fmt: skip


def _functions() -> Iterator[tuple[str, Callable[..., object]]]:
    for name in ROOMS:
        for exported, value in _public(importlib.import_module(f"{PACKAGE}.{name}")).items():
            members = vars(value).items() if inspect.isclass(value) else [(exported, value)]
            for member, function in members:
                function = function.fget if isinstance(function, property) else function
                if inspect.isfunction(function) and not member.startswith("_"):
                    yield member, function


def test_what_has_several_parts_is_an_object_with_names() -> None:
    """A tuple is a list of like things, `tuple[X, ...]`, or one of a few pairs; the rest are dataclasses."""
    functions = list(_functions())
    assert len(functions) > 250
    wrong = []
    for name, function in functions:
        returned = str(inspect.signature(function).return_annotation)
        for parts in re.findall(r"tuple\[((?:[^\[\]]|\[[^\]]*\])*)\]", returned):
            if not parts.endswith(", ...") and (parts.count(",") > 1 or name not in PAIRS):
                wrong.append(f"{name} -> {returned}")
    assert wrong == []
