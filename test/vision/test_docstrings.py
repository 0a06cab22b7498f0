# SPDX-License-Identifier: Apache-2.0
"""The examples in the docstrings of vision/ run, and every parameter is described."""

from __future__ import annotations

import doctest
import importlib
import inspect
import pkgutil
import re
from types import ModuleType

import pytest

import imgu_ros.vision

MODULES = [
    importlib.import_module(item.name)
    for item in pkgutil.walk_packages(imgu_ros.vision.__path__, "imgu_ros.vision.")
    if not item.ispkg and item.name.count(".") > 2  # a table of methods is in no room
]


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.__name__.removeprefix("imgu_ros.vision."))
def test_examples_run(module: ModuleType) -> None:
    assert doctest.testmod(module).failed == 0


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.__name__.removeprefix("imgu_ros.vision."))
def test_every_parameter_is_described(module: ModuleType) -> None:
    missing = []
    for name, function in vars(module).items():
        if name.startswith("_") or not inspect.isfunction(function) or function.__module__ != module.__name__:
            continue
        text = inspect.getdoc(function) or ""
        if name.endswith("unchecked") and " without the checks of " in text.partition("\n")[0]:
            continue  # the parameters of the function that checks them
        parameters = inspect.signature(function).parameters
        missing += [f"{name}: {p}" for p in parameters if not re.search(rf"\b{re.escape(p)}\b", text)]
    assert missing == []


def test_there_are_examples_in_every_chapter() -> None:
    finder = doctest.DocTestFinder()
    chapters = {module.__name__.split(".")[2] for module in MODULES}
    shown = {m.__name__.split(".")[2] for m in MODULES for found in finder.find(m) if found.examples}
    assert shown == chapters
