# SPDX-License-Identifier: Apache-2.0
"""The lock files, constraints*.txt: exact versions, the digests of their wheels, and what needs them.

A comment before each package names what needs it: `imgu_ros` itself, `build`, or optional dependencies of setup.py.

    python scripts/lock.py constraints.txt imgu_ros,ros,test

prints what `imgu_ros[ros,test]` needs on this Python, for `pip install --require-hashes --no-deps --requirement`.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from pathlib import Path

#: The versions of Python that are locked for; constraints-jazzy.txt is for the first two alone, as its NumPy is.
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
BLOCK = re.compile(
    r"# (?P<needed_by>[\w, ]+)\n"
    r"(?P<name>[a-z0-9-]+)==(?P<version>[a-z0-9.+!-]+)"
    r"(?: ; python_version >= \"(?P<first>3\.\d+)\" and python_version <= \"(?P<last>3\.\d+)\")?"
    r"(?P<hashes>(?: \\\n    --hash=sha256:[0-9a-f]{64})+)\n"
)


@dataclass(frozen=True)
class Locked:
    """One package of a lock file."""

    name: str
    version: str
    #: The digests of the wheels that may be installed.
    sha256: tuple[str, ...]
    #: `imgu_ros`, `build`, names of optional dependencies.
    needed_by: tuple[str, ...]
    #: The versions of Python that it is for, one after the other.
    pythons: tuple[str, ...] = PYTHONS

    def __str__(self) -> str:
        """Return the lines of the lock file."""
        first, last = self.pythons[0], self.pythons[-1]
        marker = "" if self.pythons == PYTHONS else f' ; python_version >= "{first}" and python_version <= "{last}"'
        hashes = "".join(f" \\\n    --hash=sha256:{digest}" for digest in self.sha256)
        return f"# {', '.join(self.needed_by)}\n{self.name}=={self.version}{marker}{hashes}\n"


def read(path: Path) -> list[Locked]:
    """Return the packages of a lock file; what is not exactly as scripts/pin writes it is refused."""
    header, separator, text = path.read_text(encoding="utf-8").partition("\n\n")
    if not separator or any(not line.startswith("#") for line in header.splitlines()):
        raise SystemExit(f"{path}: got no header of comments and an empty line; need a file made by scripts/pin")
    packages, position = [], 0
    while position < len(text):
        block = BLOCK.match(text, position)
        if block is None:
            line = header.count("\n") + 3 + text.count("\n", 0, position)
            raise SystemExit(f"{path}: the package after line {line - 1}: need a name, a version and SHA-256 digests")
        first, last = block["first"] or PYTHONS[0], block["last"] or PYTHONS[-1]
        if first not in PYTHONS or last not in PYTHONS:
            raise SystemExit(
                f"{path}: {block['name']}: got Python {first} to {last}; need some of {', '.join(PYTHONS)}"
            )
        pythons = PYTHONS[PYTHONS.index(first) : PYTHONS.index(last) + 1]
        needed_by = tuple(block["needed_by"].split(", "))
        digests = tuple(re.findall("[0-9a-f]{64}", block["hashes"]))
        packages.append(Locked(block["name"], block["version"], digests, needed_by, pythons))
        position = block.end()
    return packages


def select(packages: list[Locked], names: list[str], python: str) -> list[Locked]:
    """Return the packages that any of `names` (`imgu_ros`, `build`, optional dependencies) needs on this Python."""
    unknown = set(names) - {name for package in packages for name in package.needed_by}
    if unknown:
        raise SystemExit(
            f"{', '.join(sorted(unknown))}: not locked; need scripts/pin --keep after a change of setup.py"
        )
    return [package for package in packages if python in package.pythons and set(names) & set(package.needed_by)]


if __name__ == "__main__":
    file, needed = sys.argv[1:]
    python = f"{sys.version_info[0]}.{sys.version_info[1]}"
    print(*select(read(Path(file)), needed.split(","), python), sep="", end="")
