# SPDX-License-Identifier: Apache-2.0
"""Every file says its licence: by a line at its top, or in REUSE.toml where it cannot hold one."""

from __future__ import annotations

import re
import subprocess
import tomllib
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent
# REUSE-IgnoreStart
LINE = re.compile(rb"(?:# |<!-- |\.\. |// |/\* |)SPDX-License-Identifier: Apache-2\.0(?: -->| \*/)?")
# REUSE-IgnoreEnd
#: The licences themselves: ours, in two places, and that of others' files among ours.
OURS = ("LICENSE", "LICENSES/Apache-2.0.txt")
TEXTS = {*OURS, "LICENSES/MIT.txt"}
#: What an unpacked source archive and a build have beside the repository's files, or otherwise than these.
MADE = re.compile(
    r"(.*/)?(\.[^/]+|__pycache__|[^/]+\.egg-info|imgu_demo[^/]*)(/.*)?|(build|dist|install|log)/.*|PKG-INFO"
)


def files() -> list[str]:
    """Return the repository's files; in a source archive, all there are."""
    done = subprocess.run(["git", "ls-files", "-z"], cwd=REPOSITORY, capture_output=True, text=True, check=False)
    names = done.stdout.split("\0")
    if done.returncode != 0 or "setup.py" not in names:
        names = [str(path.relative_to(REPOSITORY)) for path in REPOSITORY.rglob("*")]
        names = [name for name in names if not MADE.fullmatch(name)]
        if "PKG-INFO" in {path.name for path in REPOSITORY.iterdir()}:
            # setuptools writes it anew for the archive, without comments.
            names.remove("setup.cfg")
    return sorted(name for name in names if (REPOSITORY / name).is_file())


def annotated() -> list[str]:
    """Return the patterns of REUSE.toml that a licence is given to."""
    with (REPOSITORY / "REUSE.toml").open("rb") as file:
        annotations = tomllib.load(file)["annotations"]
    known = [each for each in annotations if each.get("SPDX-License-Identifier") in ("Apache-2.0", "MIT")]
    return [path for each in known for path in ([each["path"]] if isinstance(each["path"], str) else each["path"])]


def matches(pattern: str, name: str) -> bool:
    """Whether a pattern of REUSE.toml stands for a file: `*` is within a folder, `**` goes into folders."""
    parts = {"**": ".*", "*": "[^/]*"}
    return (
        re.fullmatch("".join(parts.get(part, re.escape(part)) for part in re.split(r"(\*+)", pattern)), name)
        is not None
    )


def has_line(name: str) -> bool:
    """Whether one of a file's first three lines is its licence."""
    lines = (REPOSITORY / name).read_bytes()[:4096].splitlines()[:3]
    return any(LINE.fullmatch(line) for line in lines)


def test_every_file_says_its_licence() -> None:
    patterns, names = annotated(), files()
    assert len(names) > 100
    silent = [
        name
        for name in names
        if name not in TEXTS and not has_line(name) and not any(matches(pattern, name) for pattern in patterns)
    ]
    assert silent == [], (
        "need the licence's line, as every other file has it, first (after #! or <?xml); in a generated file, written "
        "by what generates it; for a format without comments, an entry in REUSE.toml"
    )


def test_no_pattern_is_left_over() -> None:
    names = files()
    assert [pattern for pattern in annotated() if not any(matches(pattern, name) for name in names)] == []


def test_what_could_have_a_line_is_not_excused() -> None:
    kept = re.compile(r"test/launch_files/recorded/.*|imgu_ros/report/templates/uPlot\..*")
    excused = [
        name for name in files() if any(matches(pattern, name) for pattern in annotated()) and not kept.match(name)
    ]
    assert {Path(name).suffix for name in excused} <= {"", ".csv", ".jpg", ".json", ".png", ".typed", ".webp"}


def test_the_licence_is_whole() -> None:
    first, second = OURS
    assert (REPOSITORY / first).read_text() == (REPOSITORY / second).read_text()
