# SPDX-License-Identifier: Apache-2.0
"""Check the lock files and this environment, without a network: python scripts/audit.py LOCK EXTRAS [ADVISORIES].

What is installed is what is locked, and whole: no package more, no version else, no file changed since. Licences are of
those that are allowed. With ADVISORIES, a copy of the OSV database of PyPI (all.zip), no locked version is in it.
Prints what is wrong, a line each; ends with 1 if anything is.
"""

from __future__ import annotations

import base64
import csv
import hashlib
import json
import re
import sys
import zipfile
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import installed
import lock
from packaging.utils import canonicalize_name
from packaging.version import InvalidVersion, Version

#: Licences of what this package, its tests and its tools may need.
ALLOWED = re.compile(
    r"(0BSD|Apache-2\.0|BSD|BSD License|BSD-[23]-Clause|CC0-1\.0|ISC|MIT|MIT-CMU|MPL-2\.0|PSF-2\.0|Zlib|any-OSI"
    r"| AND | OR )+"
)
#: Licences in words of their own, of what tests alone need: PDFium is under BSD-3-Clause and Apache-2.0, and names
#: those of the libraries in its wheel.
IN_OWN_WORDS = {"pypdfium2": "BSD-3-Clause, Apache-2.0, dependency licenses"}
#: Collections of ROS packages, without content; they declare no licence.
EMPTY = {"ros-jazzy-common-interfaces", "ros-jazzy-rclpy"}
#: Not needed by any package: they come with Python's venv module, or are this package.
OWN = {"imgu-ros", "pip"}


def environment_problems(packages: list[lock.Locked]) -> Iterator[str]:
    """Yield how what is installed differs from what is locked, and from what its packages held."""
    locked = {package.name: package.version for package in packages}
    for distribution in metadata.distributions():
        name = canonicalize_name(distribution.metadata["Name"])
        # Wheels of ROS hold what describes their modules a second time; nothing installed that by itself.
        if name in OWN or distribution.read_text("INSTALLER") is None:
            continue
        if locked.get(name) != distribution.version:
            yield f"{name} {distribution.version}: installed; need {locked.get(name) or 'nothing: it is not locked'}"
        yield from changed_files(distribution)
    for name, version in locked.items():
        if installed.version(name) is None:
            yield f"{name} {version}: locked; not installed"


def changed_files(distribution: metadata.Distribution) -> Iterator[str]:
    """Yield which files of a package are not as its list of files (RECORD) has them."""
    name = distribution.metadata["Name"]
    for file, digest, _ in csv.reader((distribution.read_text("RECORD") or "").splitlines()):
        method, _, expected = digest.partition("=")
        if not digest or file.endswith(".pyc"):
            continue
        path = Path(str(distribution.locate_file(file)))
        if not path.is_file():
            yield f"{name}: {file}: missing"
            continue
        with path.open("rb") as source:
            found = base64.urlsafe_b64encode(hashlib.file_digest(source, method).digest()).decode()
        if found.rstrip("=") != expected:
            yield f"{name}: {file}: changed since it was installed"


def licence_problems(packages: list[lock.Locked]) -> Iterator[str]:
    """Yield which packages have a licence that is not on the list, or none."""
    for package in packages:
        if installed.version(package.name) is not None and package.name not in EMPTY:
            licence, _ = installed.licence(package.name)
            if not ALLOWED.fullmatch(licence) and licence != IN_OWN_WORDS.get(package.name):
                yield f"{package.name}: licence {licence or 'not declared'!r}; need one that scripts/audit.py allows"


def advisories(file: Path) -> dict[str, list[dict[str, Any]]]:
    """Return the entries of an OSV database (all.zip) by the names of the packages that they are about.

    Raises
    ------
    SystemExit
        If it is none, or has no entry: nothing would be found in it.
    """
    found: dict[str, list[dict[str, Any]]] = {}
    if not zipfile.is_zipfile(file):
        raise SystemExit(f"{file}: no zip archive; need an OSV database (all.zip of PyPI)")
    with zipfile.ZipFile(file) as archive:
        for name in archive.namelist():
            if not name.endswith(".json"):
                continue
            entry = json.loads(archive.read(name))
            if "withdrawn" in entry:
                continue
            for affected in entry.get("affected", []):
                package = affected.get("package", {})
                if package.get("ecosystem") == "PyPI":
                    found.setdefault(canonicalize_name(package["name"]), []).append({**affected, "id": entry["id"]})
    if not found:
        raise SystemExit(f"{file}: nothing about packages of PyPI; need an OSV database (all.zip of PyPI)")
    return found


def advisory_problems(packages: list[lock.Locked], known: dict[str, list[dict[str, Any]]]) -> Iterator[str]:
    """Yield which locked versions an advisory speaks of."""
    for package in packages:
        for affected in known.get(package.name, []):
            if is_affected(package.version, affected):
                yield f"{package.name} {package.version}: {affected['id']}"


def is_affected(text: str, affected: dict[str, Any]) -> bool:
    """Return whether an entry of OSV speaks of a version (https://ossf.github.io/osv-schema, "Evaluation")."""
    version = Version(text)
    if any(_version(each) == version for each in affected.get("versions", [])):
        return True
    for each in affected.get("ranges", []):
        if each.get("type") != "ECOSYSTEM":
            continue
        inside = False
        events = [(_version(value), kind) for event in each["events"] for kind, value in event.items()]
        for at, kind in sorted((event for event in events if event[0] is not None), key=lambda event: event[0]):
            if kind == "introduced" and version >= at:
                inside = True
            elif (kind == "fixed" and version >= at) or (kind == "last_affected" and version > at):
                inside = False
        if inside:
            return True
    return False


def _version(text: str) -> Version | None:
    try:
        return Version(text)
    except InvalidVersion:
        return None


def main(file: Path, extras: list[str], database: Path | None) -> int:
    """Print what is wrong; return 1 if anything is."""
    python = f"{sys.version_info[0]}.{sys.version_info[1]}"
    everything = lock.read(file)
    packages = lock.select(everything, ["build", "imgu_ros", *extras], python)
    problems = [*environment_problems(packages), *licence_problems(packages)]
    checked = f"{file.name}: {len(packages)} packages as locked, whole, under allowed licences"
    if database is not None:
        # All that is locked, for every Python and use.
        known = advisories(database)
        problems += advisory_problems(everything, known)
        checked += (
            f"; none of {len(everything)} locked versions in {sum(map(len, known.values()))} entries of {database.name}"
        )
    print(*problems or [checked], sep="\n")
    return 1 if problems else 0


if __name__ == "__main__":
    chosen = sys.argv[2].split(",") if sys.argv[2] else []
    sys.exit(main(Path(sys.argv[1]), chosen, Path(sys.argv[3]) if len(sys.argv) > 3 else None))
