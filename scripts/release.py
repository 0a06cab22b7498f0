# SPDX-License-Identifier: Apache-2.0
"""Make a release of this repository: python scripts/release.py VERSION [--dry-run] [--out DIR]; see scripts/release."""

from __future__ import annotations

import argparse
import datetime
import os
import re
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VERSION = re.compile(r"(0|[1-9]\d*)\.(0|[1-9]\d*)\.(0|[1-9]\d*)")
FORTHCOMING = "Forthcoming\n-----------\n"
#: Top-level domains that belong to nobody (RFC 2606): an address there is a placeholder.
RESERVED = re.compile(r"\.(example|invalid|test|localhost)\b")


class ReleaseError(Exception):
    """Why there is no release."""


def main(arguments: Sequence[str]) -> int:
    """Make the release; return the exit code."""
    parser = argparse.ArgumentParser(prog="scripts/release", description=(__doc__ or "").partition(":")[0])
    parser.add_argument(
        "version", metavar="VERSION", help="major.minor.patch, larger than the one in package.xml or it"
    )
    parser.add_argument(
        "--dry-run", action="store_true", help="in a copy: this folder and its history stay as they are"
    )
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="where wheel and source archive go")
    parsed = parser.parse_args(arguments)
    try:
        if parsed.dry_run:
            with tempfile.TemporaryDirectory(prefix="imgu_release_") as folder:
                tree = copy(ROOT, Path(folder) / "imgu_ros")
                release(tree, parsed.version, parsed.out.resolve(), placeholders_allowed=True)
        else:
            release(ROOT, parsed.version, parsed.out.resolve())
    except ReleaseError as error:
        print(f"scripts/release: error: {error}", file=sys.stderr)
        return 1
    if parsed.dry_run:
        print("A dry run: nothing was committed or tagged here.")
    else:
        print(f"Look at it: git show {parsed.version}. Then: git push origin HEAD {parsed.version}")
        print("For the ROS index: bloom-release imgu_ros. For pip: twine upload dist/*")
    return 0


def release(tree: Path, version: str, out: Path, placeholders_allowed: bool = False, today: str = "") -> list[Path]:
    """Set the version, commit, tag and build in a repository; return wheel and source archive.

    Raises
    ------
    ReleaseError
        If the version, the changelog or the state of the repository allows no release.
    """
    check(tree, version, placeholders_allowed)
    set_version(tree, version, today or datetime.datetime.now(datetime.UTC).date().isoformat())
    git(tree, "commit", "--quiet", "--all", "--message", version)
    git(tree, "tag", "--annotate", version, "--message", version)
    files = build(tree, version, out)
    for file in files:
        problems = list(paths_of_a_machine(file, tree))
        if problems:
            raise ReleaseError(f"{file.name}: {problems[0]}; need files that name no machine")
        print(file)
    return files


def check(tree: Path, version: str, placeholders_allowed: bool) -> None:
    """Refuse what allows no release."""
    if not VERSION.fullmatch(version):
        raise ReleaseError(f"version {version!r}; need major.minor.patch")
    manifest = (tree / "package.xml").read_text(encoding="utf-8")
    (now,) = re.findall(r"<version>(.*)</version>", manifest)
    if _numbers(version) < _numbers(now):
        raise ReleaseError(f"version {version}: package.xml has {now} already; need a larger one")
    if git(tree, "status", "--porcelain", "--untracked-files=no"):
        raise ReleaseError("changes that are not committed; need a clean tree")
    if git(tree, "tag", "--list", version):
        raise ReleaseError(f"tag {version}: exists; need another version")
    section = (tree / "CHANGELOG.rst").read_text(encoding="utf-8").partition(FORTHCOMING)[2]
    if not section.startswith("* "):
        raise ReleaseError("CHANGELOG.rst: no entry under Forthcoming; need what changed")
    if not placeholders_allowed and RESERVED.search(re.sub(r"<!--.*?-->", "", manifest, flags=re.DOTALL)):
        raise ReleaseError("package.xml: maintainer and addresses are placeholders; need those of who publishes it")


def set_version(tree: Path, version: str, date: str) -> None:
    """Write the version into package.xml, CITATION.cff and the changelog, whose section it closes."""
    title = f"{version} ({date})"
    _replace(tree / "package.xml", r"<version>.*</version>", f"<version>{version}</version>")
    _replace(tree / "CITATION.cff", r"^version: .*$", f"version: {version}")
    _replace(tree / "CITATION.cff", r"^(date-released: .*\n)?license:", f"date-released: {date}\nlicense:")
    _replace(tree / "CHANGELOG.rst", re.escape(FORTHCOMING), f"{title}\n{'-' * len(title)}\n")


def build(tree: Path, version: str, out: Path) -> list[Path]:
    """Build a wheel and a source archive with what is installed, their times those of the commit; return both."""
    out.mkdir(parents=True, exist_ok=True)
    environment = {**os.environ, "SOURCE_DATE_EPOCH": git(tree, "log", "-1", "--format=%ct")}
    with tempfile.TemporaryDirectory(prefix="imgu_build_") as folder:
        source = copy(tree, Path(folder) / "imgu_ros")
        for kind in ("wheel", "sdist"):  # each in a process of its own: setuptools keeps state
            code = f"import sys; from setuptools.build_meta import build_{kind} as build; build(sys.argv[1])"
            command = [sys.executable, "-c", code, str(out)]
            done = subprocess.run(command, cwd=source, env=environment, capture_output=True, text=True, check=False)
            if done.returncode != 0:
                raise ReleaseError(f"the build failed: {(done.stderr.strip().splitlines() or ['?'])[-1]}")
    return [out / f"imgu_ros-{version}.tar.gz", out / f"imgu_ros-{version}-py3-none-any.whl"]


def paths_of_a_machine(archive: Path, *folders: Path) -> Iterator[str]:
    """Yield the files of a wheel or source archive that name one of these folders, the home folder or the build's."""
    named = {str(folder).encode() for folder in (*folders, Path.home(), Path(tempfile.gettempdir()) / "imgu_build_")}
    for name, content in contents(archive):
        for path in named - {b"/"}:
            if path in content or name.startswith("/"):
                yield f"{name}: names {path.decode()}"


def contents(archive: Path) -> Iterator[tuple[str, bytes]]:
    """Yield name and content of every file of a wheel or source archive."""
    if archive.suffix == ".whl":
        with zipfile.ZipFile(archive) as wheel:
            for name in wheel.namelist():
                yield name, wheel.read(name)
        return
    with tarfile.open(archive) as source:
        for member in source:
            file = source.extractfile(member)
            if file is not None:
                yield member.name, file.read()


def copy(tree: Path, place: Path) -> Path:
    """Return a clone of a repository's last commit."""
    subprocess.run(
        ["git", "clone", "--quiet", "--no-hardlinks", str(tree), str(place)], check=True, capture_output=True
    )
    for key in ("user.name", "user.email"):
        git(place, "config", key, git(tree, "log", "-1", "--format=%an" if key == "user.name" else "--format=%ae"))
    return place


def git(tree: Path, *arguments: str) -> str:
    """Run git in a repository; return what it prints."""
    done = subprocess.run(["git", *arguments], cwd=tree, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise ReleaseError(f"git {arguments[0]}: {done.stderr.strip() or done.stdout.strip()}")
    return done.stdout.strip()


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(map(int, version.split(".")))


def _replace(path: Path, pattern: str, text: str) -> None:
    old = path.read_text(encoding="utf-8")
    new, count = re.subn(pattern, text, old, count=1, flags=re.MULTILINE)
    if count != 1:
        raise ReleaseError(f"{path.name}: nothing matches {pattern!r}; need the form of the other releases")
    path.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
