# SPDX-License-Identifier: Apache-2.0
"""Numbers in the code: each says why it has its value, and those that were measured name the study that repeats it."""

from __future__ import annotations

import ast
import io
import json
import re
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "imgu_ros"
BENCHMARKS = ROOT / "benchmarks"
#: Folders and files whose constants must be explained: the pipeline, and the estimators that it calls.
ROOMS = (
    "detect", "image", "localizer.py", "pose", "reference", "track",
    "vision/camera", "vision/estimation", "vision/matching", "vision/projective",
)  # fmt: skip
#: Constants that the script varies and whose figures are not in the stored file.
NOT_STORED = {
    "close_octaves", "close_richness", "outlier_sigmas", "floor_px", "misfit_cells", "sampled_beyond_px", "wider",
}  # fmt: skip
#: Where a comment or a page names a script, with a study of `thresholds.py` or a part of another script.
SCRIPT = re.compile(r"benchmarks/(\w+)\.py`*(?:,? +(?:study|studies) `?([\w-]+)`?| +(--part) ([\w-]+))?")


@dataclass(frozen=True, slots=True)
class Constant:
    """A number at the top of a module, and the comment above or beside it."""

    module: str
    name: str
    line: int
    comment: str


def constants(path: Path) -> Iterator[Constant]:
    """Yield the module's assignments of numbers, also in tuples, dictionaries and calls."""
    text = path.read_text(encoding="utf-8")
    comments = {
        token.start[0]: token.string
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
        if token.type == tokenize.COMMENT
    }
    lines = text.splitlines()
    for node in ast.parse(text).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None or not _has_number(node.value):
            continue
        above, line = [], node.lineno - 1
        while lines[line - 1].startswith("#"):
            above.insert(0, lines[line - 1])
            line -= 1
        beside = [comments[n] for n in range(node.lineno, (node.end_lineno or 0) + 1) if n in comments]
        words = [text.lstrip("#: ") for text in (*above, *beside) if not text.startswith("# fmt:")]
        for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
            # An element assigned to belongs to a constant that was explained where it was made.
            parts = target.elts if isinstance(target, ast.Tuple) else [target]
            names = [part.id for part in parts if isinstance(part, ast.Name)]
            module = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
            yield from (Constant(module, name, node.lineno, " ".join(words)) for name in names)


def _has_number(value: ast.expr) -> bool:
    return any(isinstance(node, ast.Constant) and type(node.value) in (int, float) for node in ast.walk(value))


def modules() -> list[Path]:
    """Return the modules of the rooms."""
    return [path for room in ROOMS for path in ([PACKAGE / room] if room.endswith(".py") else _python(PACKAGE / room))]


def _python(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.py"))


@pytest.fixture
def thresholds(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The script with the studies."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import thresholds  # type: ignore[import-not-found]

    return thresholds


def test_rooms_hold_constants() -> None:
    for room in ROOMS:
        assert (PACKAGE / room).exists(), room
    assert len([constant for path in modules() for constant in constants(path)]) > 200


def test_every_number_says_why() -> None:
    bare = [c for path in modules() for c in constants(path) if not c.comment]
    assert [f"{c.module}:{c.line}: {c.name}; need a comment above or beside it" for c in bare] == []


def test_every_script_and_study_named_exists(thresholds: Any) -> None:
    files = [*_python(PACKAGE), *_python(ROOT / "test"), *_python(BENCHMARKS), *_python(ROOT / "fuzz")]
    files += [*(ROOT / "docs").rglob("*.md"), *ROOT.glob("*.md"), ROOT / "CHANGELOG.rst"]
    wrong, named = [], 0
    for path in files:
        # A name may be continued on the next line of a comment.
        text = re.sub(r"\n\s*#:? ?", " ", path.read_text(encoding="utf-8"))
        for script, study, option, part in SCRIPT.findall(text):
            named += 1
            source = BENCHMARKS / f"{script}.py"
            if not source.exists():
                wrong.append(f"{path.relative_to(ROOT)}: benchmarks/{script}.py does not exist")
            elif study and (script != "thresholds" or study not in thresholds.STUDIES):
                wrong.append(f"{path.relative_to(ROOT)}: benchmarks/{script}.py has no study {study!r}")
            elif option and f'"{part}"' not in source.read_text(encoding="utf-8"):
                wrong.append(f"{path.relative_to(ROOT)}: benchmarks/{script}.py has no {option} {part!r}")
    assert wrong == []
    assert named > 20


def test_every_studied_constant_names_its_study(thresholds: Any) -> None:
    studies = {key: name for name, study in thresholds.STUDIES.items() for key in study.tried}
    assert studies.keys() == thresholds.CONSTANTS.keys()
    known = {(c.module, c.name): c.comment for path in modules() for c in constants(path)}
    wrong = []
    for key, place in thresholds.CONSTANTS.items():
        module, _, name = place.partition(":")
        comment = known.get((module, name.partition(".")[0]))
        if comment is None:
            wrong.append(f"{place}: no such constant; CONSTANTS in benchmarks/thresholds.py says where {key!r} is")
        elif ("thresholds", studies[key]) not in [found[:2] for found in SCRIPT.findall(comment)]:
            wrong.append(f"{place}: need 'benchmarks/thresholds.py, study {studies[key]}' in its comment")
    assert wrong == []


def test_stored_figures_are_of_the_values_in_the_code(thresholds: Any) -> None:
    stored = json.loads((BENCHMARKS / "figures" / "thresholds.json").read_text(encoding="utf-8"))["studies"]
    assert stored.keys() == thresholds.STUDIES.keys()
    wrong = []
    for name, study in thresholds.STUDIES.items():
        assert not stored[name]["quick"], name
        assert stored[name]["used"].keys() == study.tried.keys() - NOT_STORED, name
        for key, used in stored[name]["used"].items():
            value = thresholds.current_value(thresholds.CONSTANTS[key])
            if value != used:
                wrong.append(f"{thresholds.CONSTANTS[key]}: {value}, but {used} was measured: run study {name} again")
    assert wrong == []


def test_a_constant_is_changed_for_a_while(thresholds: Any) -> None:
    for place, other in (
        ("track.tracker:_HELD_SHARE", 0.75),
        ("reference.verification:NEEDED", 0.5),
        ("detect.detector:_FEWEST_VOTES", [1, 2, 3]),
    ):
        before = thresholds.current_value(place)
        with thresholds.changed(place, other):
            assert thresholds.current_value(place) == other != before
        assert thresholds.current_value(place) == before


@pytest.mark.parametrize(
    ("text", "comments"),
    [
        ("#: Why.\n_A = 1\n_B = 2.5\n", ["Why.", ""]),
        ("_A = (1, 2)  # beside\n", ["beside"]),
        ("# fmt: skip\n_A = {'a': -3}\n", [""]),
        ("#: Two\n#: lines.\n_A, _B = 1, f(2)\n", ["Two lines.", "Two lines."]),
        ("_NAME = 'x'\n_FLAG = True\ndef f():\n    a = 1\n", []),
    ],
)
def test_comments_are_seen(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, text: str, comments: list[str]) -> None:
    (tmp_path / "module.py").write_text(text)
    monkeypatch.setattr(f"{__name__}.PACKAGE", tmp_path)
    assert [constant.comment for constant in constants(tmp_path / "module.py")] == comments


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("benchmarks/thresholds.py, study blur", ("thresholds", "blur", "", "")),
        ("`benchmarks/calibration_misfit.py --part noise`", ("calibration_misfit", "", "--part", "noise")),
        ("(`benchmarks/replay.py`)", ("replay", "", "", "")),
    ],
)
def test_names_of_scripts_are_seen(text: str, found: tuple[str, ...]) -> None:
    assert SCRIPT.findall(text) == [found]
