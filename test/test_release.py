# SPDX-License-Identifier: Apache-2.0
"""scripts/release, in copies of this repository."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture
def release(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(str(REPOSITORY / "scripts"))
    yield importlib.import_module("release")
    sys.modules.pop("release", None)


def git(tree: Path, *arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=tree, capture_output=True, text=True, check=True, timeout=60)
    return done.stdout.strip()


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A repository of the files as they are here, in one commit."""
    if not (REPOSITORY / ".git").exists():
        pytest.skip("not a repository")
    place = tmp_path / "tree"
    place.mkdir()
    names = git(REPOSITORY, "ls-files").splitlines()
    kept = [n for n in names if not n.startswith(("test/", "benchmarks/", "docs/reference/", "fuzz/"))]
    for name in kept:
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_bytes((REPOSITORY / name).read_bytes())
    git(place, "init", "--quiet")
    git(place, "config", "user.name", "somebody")
    git(place, "config", "user.email", "somebody@test.invalid")
    git(place, "add", "--all")
    git(place, "commit", "--quiet", "--message", "as it is")
    return place


def test_a_release_sets_tags_and_builds(release: ModuleType, tree: Path, tmp_path: Path) -> None:
    files = release.release(tree, "1.2.3", tmp_path / "dist", placeholders_allowed=True, today="2030-01-02")
    assert [file.name for file in files] == ["imgu_ros-1.2.3.tar.gz", "imgu_ros-1.2.3-py3-none-any.whl"]
    assert git(tree, "describe") == "1.2.3"
    assert git(tree, "status", "--porcelain") == ""
    assert set(git(tree, "show", "--format=", "--name-only").splitlines()) == {
        "package.xml",
        "CITATION.cff",
        "CHANGELOG.rst",
    }
    changelog = (tree / "CHANGELOG.rst").read_text()
    assert "\n1.2.3 (2030-01-02)\n------------------\n* First" in changelog and "Forthcoming" not in changelog
    citation = (tree / "CITATION.cff").read_text()
    assert "\nversion: 1.2.3\ndate-released: 2030-01-02\nlicense: Apache-2.0\n" in citation
    with zipfile.ZipFile(files[1]) as wheel:
        names = wheel.namelist()
        metadata = wheel.read("imgu_ros-1.2.3.dist-info/METADATA").decode()
    assert re.search(r"^Version: 1\.2\.3$", metadata, re.MULTILINE)
    assert "imgu_ros/cli/main.py" in names and "imgu_ros-1.2.3.data/data/share/imgu_ros/package.xml" in names
    with tarfile.open(files[0]) as source:
        assert "imgu_ros-1.2.3/scripts/release" in source.getnames()


def test_a_wheel_that_names_a_folder_of_this_machine_is_found(release: ModuleType, tmp_path: Path) -> None:
    wheel = tmp_path / "harmless-1.0-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("clean.py", "x = 1")
        archive.writestr("dirty.py", f"x = {str(tmp_path)!r}")
    assert [line.split(":")[0] for line in release.paths_of_a_machine(wheel, tmp_path)] == ["dirty.py"]


@pytest.mark.parametrize(
    ("version", "change", "reason"),
    [
        ("1.2", None, "need major.minor.patch"),
        ("0.0.9", None, "need a larger one"),
        ("1.0.0", ("README.md", "# imgu_ros", "# other"), "not committed"),
        ("1.0.0", None, "placeholders"),
    ],
)
def test_what_allows_no_release(
    release: ModuleType, tree: Path, version: str, change: tuple[str, str, str] | None, reason: str
) -> None:
    if change:
        name, old, new = change
        (tree / name).write_text((tree / name).read_text().replace(old, new))
    with pytest.raises(release.ReleaseError, match=reason):
        release.check(tree, version, placeholders_allowed=False)


def test_a_version_is_released_once(release: ModuleType, tree: Path) -> None:
    git(tree, "tag", "1.0.0")
    with pytest.raises(release.ReleaseError, match="exists"):
        release.check(tree, "1.0.0", placeholders_allowed=True)


def test_a_release_without_changes_is_refused(release: ModuleType, tree: Path) -> None:
    release.set_version(tree, "1.0.0", "2030-01-02")
    git(tree, "commit", "--quiet", "--all", "--message", "1.0.0")
    with pytest.raises(release.ReleaseError, match="no entry under Forthcoming"):
        release.check(tree, "1.0.1", placeholders_allowed=True)


def test_a_dry_run_leaves_everything_as_it_is(
    release: ModuleType, tree: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(release, "ROOT", tree)
    before = git(tree, "rev-parse", "HEAD")
    assert release.main(["7.0.0", "--dry-run", "--out", str(tmp_path / "dist")]) == 0
    assert "A dry run" in capsys.readouterr().out
    assert (git(tree, "rev-parse", "HEAD"), git(tree, "tag"), git(tree, "status", "--porcelain")) == (before, "", "")
    assert (tmp_path / "dist" / "imgu_ros-7.0.0-py3-none-any.whl").exists()
