# SPDX-License-Identifier: Apache-2.0
"""The structure of the package as a Markdown table: rooms with their modules, lines, and what they import.

python docs/make_structure.py             # the working tree
python docs/make_structure.py 7e4276b     # another revision
"""

from __future__ import annotations

import argparse
import ast
import subprocess
from collections.abc import Mapping
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent
PACKAGE = "imgu_ros"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("revision", nargs="?", metavar="REV", help="default: the working tree")
    print(table(sources(parser.parse_args().revision)))


def sources(revision: str | None) -> dict[str, str]:
    """Return the text of every module by its path below the package."""
    if revision is None:
        paths = (REPOSITORY / PACKAGE).rglob("*.py")
        return {str(path.relative_to(REPOSITORY / PACKAGE)): path.read_text(encoding="utf-8") for path in paths}
    listed = _git("ls-tree", "-r", "--name-only", revision, f"{PACKAGE}/").splitlines()
    names = [name for name in listed if name.endswith(".py")]
    return {name.removeprefix(f"{PACKAGE}/"): _git("show", f"{revision}:{name}") for name in names}


def table(texts: Mapping[str, str]) -> str:
    """Return the table of rooms, those that import least first."""
    modules: dict[str, int] = {}
    lines: dict[str, int] = {}
    imports: dict[str, set[str]] = {}
    for path, text in texts.items():
        room = _room(path)
        modules[room] = modules.get(room, 0) + 1
        lines[room] = lines.get(room, 0) + len(text.splitlines())
        imports.setdefault(room, set()).update(_imported_rooms(text) - {room})
    rows = ["| room | modules | lines | imports |", "|---|---|---|---|"]
    for room in sorted(modules, key=lambda each: (len(_below(each, imports)), each)):
        used = ", ".join(sorted(imports[room]))
        rows.append(f"| {room} | {modules[room]} | {lines[room]} | {used} |")
    return "\n".join([*rows, f"| all | {sum(modules.values())} | {sum(lines.values())} | |"])


def _room(path: str) -> str:
    first, _, rest = path.partition("/")
    return f"{first}/" if rest else first.removesuffix(".py")


def _imported_rooms(text: str) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(f"{PACKAGE}."):
            parts = (node.module or "").split(".")[1:]
            folder = (REPOSITORY / PACKAGE / parts[0]).is_dir() or len(parts) > 1
            found.add(f"{parts[0]}/" if folder else parts[0])
    return found


def _below(room: str, imports: Mapping[str, set[str]]) -> set[str]:
    below: set[str] = set()
    waiting = [room]
    while waiting:
        for each in imports.get(waiting.pop(), set()) - below:
            below.add(each)
            waiting.append(each)
    return below


def _git(*arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=REPOSITORY, capture_output=True, text=True, check=True).stdout


if __name__ == "__main__":
    main()
