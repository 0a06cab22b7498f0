# SPDX-License-Identifier: Apache-2.0
"""The reference of the vision library and its catalogue of algorithms against the code."""

from __future__ import annotations

import csv
import importlib
import importlib.util
import re
import subprocess
import sys
from collections.abc import Iterable
from functools import reduce
from pathlib import Path
from types import ModuleType

import cv2
import pytest

from imgu_ros.cli.main import COMMANDS
from imgu_ros.config.parameters import declaration, declarations

CHAPTERS = (
    "formation processing scale_space keypoints descriptors matching projective estimation camera".split()
)  # in the order in which light becomes a pose
#: Parameters whose every value is an algorithm.
METHODS = (
    "demosaic.method raw.band_mode preprocess.derivative pyramid.kind pyramid.kernel keypoints.detector "
    "descriptor.kind matching.metric homography.estimator homography.sampler homography.error homography.refine"
).split()
NOT_METHODS = {"auto", "none"}
#: Sections of the lecture notes that the library covers.
SECTIONS = (
    "1.1.1 1.1.2 1.1.3 1.1.4 1.1.5 1.1.6 1.2.2 1.2.3 1.2.4 1.2.5 1.3 1.4 1.4.4 2.1 2.2.1 2.2.2 2.2.3 2.2.4 2.2.5 "
    "2.2.6 2.3 3.1 3.2 3.3 4.1 4.2.1 4.2.2 4.2.3 4.2.4 4.3.1 5.1 5.2 5.3 5.4 5.4.2 5.5 6.1 6.2 6.3 6.4 6.4.5 6.5 "
    "7.1 7.2 7.3.1 7.3.2 7.3.3 7.3.4 7.3.5 7.5 7.6 8.1.1 8.1.2 8.1.3 8.1.4 8.1.5"
).split()


@pytest.fixture(scope="module")
def make_reference(repository: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_reference", repository / "docs" / "make_reference.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def catalogue(repository: Path) -> list[dict[str, str]]:
    with (repository / "docs" / "algorithms.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_pages_are_current(make_reference: ModuleType, repository: Path) -> None:
    for name, text in make_reference.pages().items():
        assert (repository / "docs" / "reference" / name).read_text() == text, "run: python docs/make_reference.py"


@pytest.mark.parametrize("chapter", CHAPTERS)
def test_pictures_are_made_by_code(make_reference: ModuleType, repository: Path, tmp_path: Path, chapter: str) -> None:
    make_reference.draw_picture(chapter, tmp_path / "picture.png")
    drawn = cv2.imread(str(tmp_path / "picture.png"))
    kept = cv2.imread(str(repository / "docs" / "reference" / "images" / f"{chapter}.png"))
    assert drawn is not None and drawn.std() > 5
    assert kept is not None
    # Fonts and versions of libraries move a pixel; another picture differs in many.
    assert abs(drawn.shape[0] - kept.shape[0]) <= 8 and abs(drawn.shape[1] - kept.shape[1]) <= 8
    assert abs(float(drawn.mean()) - float(kept.mean())) < 8, "run: python docs/make_reference.py --pictures"


@pytest.fixture(scope="module")
def function_pictures(make_reference: ModuleType) -> ModuleType:
    return importlib.import_module("function_pictures")  # beside make_reference, which put its folder on the path


@pytest.mark.parametrize("chapter", CHAPTERS)
def test_every_function_has_its_picture(
    make_reference: ModuleType, function_pictures: ModuleType, repository: Path, tmp_path: Path, chapter: str
) -> None:
    """Of those that take or give more than single numbers; the first is drawn anew."""
    calls = function_pictures.example_calls(chapter)
    functions = make_reference.functions_of(chapter)
    wanted = {name for name, each in functions if function_pictures.has_picture(name, each, calls)}
    images = repository / "docs" / "reference" / "images"
    assert {path.name.split(".")[1] for path in images.glob(f"{chapter}.*.png")} == wanted, (
        "run: python docs/make_reference.py --pictures"
    )
    assert len(wanted) >= 0.7 * len(functions)
    name, function = next(each for each in functions if each[0] in wanted)
    function_pictures.draw(function, calls[function], tmp_path / "picture.png")
    drawn = cv2.imread(str(tmp_path / "picture.png"))
    kept = cv2.imread(str(images / f"{chapter}.{name}.png"))
    assert drawn is not None and kept is not None and drawn.std() > 5
    assert abs(drawn.shape[0] - kept.shape[0]) <= 8 and abs(float(drawn.mean()) - float(kept.mean())) < 8


def test_every_algorithm_imports(catalogue: list[dict[str, str]]) -> None:
    for row in catalogue:
        assert _imported(row["function"]) is not None, row["function"]


def test_every_algorithm_has_a_collected_test(
    catalogue: list[dict[str, str]], repository: Path, request: pytest.FixtureRequest
) -> None:
    missing = {row["test"] for row in catalogue} - _without_parameters(item.nodeid for item in request.session.items)
    if missing:  # this run is of a part of the tests
        files = sorted({test.split("::")[0] for test in missing})
        command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-p", "no:cacheprovider", *files]
        out = subprocess.run(command, cwd=repository, capture_output=True, text=True, timeout=100).stdout
        missing -= _without_parameters(out.splitlines())
    assert not missing, sorted(missing)


def test_every_algorithm_is_reached_as_it_says(catalogue: list[dict[str, str]]) -> None:
    known = {d.name for d in declarations()}
    for row in catalogue:
        for way in row["reached_by"].split("; "):
            name, assigned, value = way.partition(":=")
            if way == "library":
                continue
            if way.startswith("imgu "):
                assert way.split()[1] in COMMANDS, row
                continue
            assert name in known, row
            if assigned and declaration(name).choices:
                assert value in declaration(name).choices, row


def test_every_method_that_can_be_chosen_is_listed(catalogue: list[dict[str, str]]) -> None:
    listed = {way for row in catalogue for way in row["reached_by"].split("; ")}
    for name in METHODS:
        for value in set(declaration(name).choices) - NOT_METHODS:
            assert f"{name}:={value}" in listed


def test_every_algorithm_has_a_section_and_a_source(catalogue: list[dict[str, str]]) -> None:
    assert all(row["source"].strip() and row["item"].strip() for row in catalogue)
    assert {row["implementation"] for row in catalogue} == {"OpenCV", "ours"}
    listed = [row["section"] for row in catalogue]
    missing = [s for s in SECTIONS if not any(section == s or section.startswith(f"{s}.") for section in listed)]
    assert not missing, missing


def _without_parameters(tests: Iterable[str]) -> set[str]:
    return {re.sub(r"\[.*", "", test) for test in tests if "::" in test}


def _imported(path: str) -> object:
    """Return what a dotted path names: a module's function or class, or a member of it."""
    parts = path.split(".")
    for split in range(len(parts) - 1, 0, -1):
        try:
            module = importlib.import_module(".".join(parts[:split]))
        except ModuleNotFoundError:
            continue
        return reduce(getattr, parts[split:], module)
    raise AssertionError(path)
