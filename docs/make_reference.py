# SPDX-License-Identifier: Apache-2.0
"""Make the reference of the vision library: python docs/make_reference.py [--pictures].

A page for each chapter of imgu_ros/vision, built from the docstrings: the chapter's own at its head, its picture, the
catalogue's lines (docs/algorithms.csv), then every public function and class; and the page of the commands
(docs/make_commands.py). `--pictures` also draws the pictures: of chapters (docs/pictures/<chapter>.py)
and of functions (docs/function_pictures.py).
"""

from __future__ import annotations

import argparse
import csv
import importlib.util
import inspect
import pkgutil
import re
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator
from enum import Enum
from pathlib import Path
from types import ModuleType

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS))
import make_commands  # noqa: E402

PACKAGE = "imgu_ros.vision"
# REUSE-IgnoreStart
LICENCE = "<!-- SPDX-License-Identifier: Apache-2.0 -->"
# REUSE-IgnoreEnd
#: In the order in which light becomes a pose.
CHAPTERS = {
    "formation": "Image formation",
    "processing": "Image processing",
    "scale_space": "Scale space",
    "keypoints": "Keypoints",
    "descriptors": "Descriptors",
    "matching": "Matching",
    "projective": "Projective geometry",
    "estimation": "Estimation",
    "camera": "Camera",
}
_SECTION = re.compile(r"^(\w[\w ]*)\n-{3,}$", re.MULTILINE)
#: Sections of numpydoc whose lines are `name : text` with continuation lines.
_TABLES = ("Parameters", "Attributes", "Other Parameters")


def main() -> None:
    """Write docs/reference."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--pictures", action="store_true", help="draw the pictures, too")
    pictures = parser.parse_args().pictures
    if pictures:
        for chapter in CHAPTERS:
            draw_picture(chapter, DOCS / "reference" / "images" / f"{chapter}.png")
        subprocess.run([sys.executable, str(DOCS / "function_pictures.py")], check=True)
    for name, text in pages().items():
        (DOCS / "reference" / name).write_text(text, encoding="utf-8")


def pages() -> dict[str, str]:
    """Return the text of every page by its file name."""
    texts = {f"{chapter}.md": _chapter_page(chapter, title) for chapter, title in CHAPTERS.items()}
    lines = [LICENCE, "# The vision library", "", "Generated from the code by `docs/make_reference.py`.", ""]
    for chapter, title in CHAPTERS.items():
        summary = _paragraphs(importlib.import_module(f"{PACKAGE}.{chapter}"))[0]
        lines.append(f"- [{title}]({chapter}.md): {summary}")
    lines += ["", *(inspect.getdoc(importlib.import_module(PACKAGE)) or "").splitlines()]
    lines += ["", "Every algorithm, its function, test, parameter and source: [algorithms.csv](../algorithms.csv).", ""]
    commands = "\n".join([LICENCE, *make_commands.page()])
    return {"README.md": "\n".join(lines), "commands.md": commands, **texts}


def draw_picture(chapter: str, path: Path) -> None:
    """Draw a chapter's picture."""
    source = DOCS / "pictures" / f"{chapter}.py"
    spec = importlib.util.spec_from_file_location(f"picture_of_{chapter}", source)
    assert spec is not None and spec.loader is not None, source
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.draw(path)


def public_objects(module: ModuleType) -> Iterator[tuple[str, object]]:
    """Yield the public functions and classes that a module defines, in its order."""
    for name, value in vars(module).items():
        if name.startswith("_") or getattr(value, "__module__", None) != module.__name__:
            continue
        if inspect.isfunction(value) or inspect.isclass(value):
            yield name, value


def modules_of(chapter: str) -> list[ModuleType]:
    """Return the modules of a chapter, by name."""
    package = importlib.import_module(f"{PACKAGE}.{chapter}")
    names = [item.name for item in pkgutil.walk_packages(package.__path__, f"{package.__name__}.") if not item.ispkg]
    return [importlib.import_module(name) for name in sorted(names)]


def functions_of(chapter: str) -> list[tuple[str, Callable[..., object]]]:
    """Return the public functions of a chapter, by name."""
    found = [each for module in modules_of(chapter) for each in public_objects(module)]
    return [(name, value) for name, value in found if inspect.isfunction(value)]


def _chapter_page(chapter: str, title: str) -> str:
    package = importlib.import_module(f"{PACKAGE}.{chapter}")
    lines = [LICENCE, f"# {title}", "", *_paragraph_lines(package), ""]
    if (DOCS / "pictures" / f"{chapter}.py").exists():
        lines += [f"![{title}](images/{chapter}.png)", ""]
    lines += _catalogue(chapter)
    for module in modules_of(chapter):
        objects = list(public_objects(module))
        if not objects:
            continue
        names = ", ".join(name for name, _ in objects)
        shown = f"from {PACKAGE}.{chapter} import {names}"
        if len(shown) > 100:
            shown = "\n".join([f"from {PACKAGE}.{chapter} import (", *textwrap.wrap(names, 90), ")"])
            shown = shown.replace("\n", "\n    ").replace("\n    )", ",\n)")
        lines += [f"## {module.__name__}", "", "```python", shown, "```", "", *_paragraph_lines(module), ""]
        for name, value in objects:
            lines += _described(name, value, _picture(chapter, name))
    return "\n".join(lines).rstrip() + "\n"


def _catalogue(chapter: str) -> list[str]:
    with (DOCS / "algorithms.csv").open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["function"].startswith(f"{PACKAGE}.{chapter}.")]
    if not rows:
        return []
    lines = ["| section | what | function | reached by | source |", "|---|---|---|---|---|"]
    for row in rows:
        function = _short(row["function"].removeprefix(f"{PACKAGE}.{chapter}."))
        lines.append(
            f"| {row['section']} | {_cell(row['item'])} | `{function}` | {_cell(_code(row['reached_by']))} "
            f"| {_cell(row['source'])} |"
        )
    return [*lines, ""]


def _short(path: str) -> str:
    """Return a dotted path without its modules: as it is imported from its room, a method behind its class."""
    parts = path.split(".")
    return ".".join(parts[-2:] if len(parts) > 1 and parts[-2][0].isupper() else parts[-1:])


def _code(reached_by: str) -> str:
    return reached_by if reached_by == "library" else f"`{reached_by}`"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _picture(chapter: str, name: str) -> str:
    """Return the picture of a function, from the page; empty without one."""
    file = f"images/{chapter}.{name}.png"
    return file if (DOCS / "reference" / file).exists() else ""


def _described(name: str, value: object, picture: str = "") -> list[str]:
    lines = [f"### {name}", ""]
    if inspect.isclass(value) and issubclass(value, Enum):
        lines += [*_docstring_lines(value), "", "Values: " + ", ".join(f"`{member.value}`" for member in value), ""]
        return lines
    lines += ["```python", _signature(name, value), "```", "", *_docstring_lines(value), ""]
    if picture:
        lines += [f"![What goes into {name} and what comes out]({picture})", ""]
    if inspect.isclass(value):
        for member_name, member in vars(value).items():
            if member_name.startswith("_") or not (inspect.isfunction(member) or isinstance(member, property)):
                continue
            text = inspect.getdoc(member) or ""
            call = f"{member_name}" if isinstance(member, property) else _signature(member_name, member)
            lines += [f"- `{' '.join(call.split())}`: {' '.join(text.split(chr(10) * 2)[0].split())}"]
        lines.append("")
    return lines


def _signature(name: str, value: object) -> str:
    try:
        signature = inspect.signature(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return name
    parts = []
    star = False
    for parameter in signature.parameters.values():
        if parameter.name == "self":
            continue
        if parameter.kind is parameter.KEYWORD_ONLY and not star:
            parts.append("*")
            star = True
        star = star or parameter.kind is parameter.VAR_POSITIONAL
        prefix = {parameter.VAR_POSITIONAL: "*", parameter.VAR_KEYWORD: "**"}.get(parameter.kind, "")
        default = "" if parameter.default is parameter.empty else f"={_value(parameter.default)}"
        parts.append(f"{prefix}{parameter.name}{default}")
    text = f"{name}({', '.join(parts)})"
    return text if len(text) <= 100 else f"{name}(\n" + textwrap.indent(",\n".join(parts), "    ") + ",\n)"


def _value(default: object) -> str:
    if isinstance(default, Enum):
        return repr(default.value)
    return default.__name__ if inspect.isfunction(default) or inspect.isclass(default) else repr(default)


def _docstring_lines(value: object) -> list[str]:
    text = inspect.getdoc(value) or ""
    parts = _SECTION.split(text)
    lines = parts[0].strip().splitlines()
    for title, body in zip(parts[1::2], parts[2::2], strict=True):
        lines += ["", f"**{title}**", ""]
        body = body.strip("\n")
        if title in _TABLES:
            lines += _entries(body)
        elif title == "Raises":
            lines += _entries(body, joined=True)
        elif title == "Examples":
            lines += ["```python", *body.splitlines(), "```"]
        else:
            lines += body.splitlines()
    return lines


def _entries(body: str, joined: bool = False) -> list[str]:
    """Return the entries of a section as a list: each begins at the margin and goes on indented."""
    entries: list[str] = []
    for line in body.splitlines():
        if line and not line[0].isspace():
            name, colon, text = line.partition(" : ")
            entries.append(f"- `{name}`{': ' + text if colon else ''}")
        elif entries and line.strip():
            separator = ": " if joined and entries[-1].endswith("`") else " "
            entries[-1] += separator + line.strip()
    return entries


def _paragraph_lines(module: ModuleType) -> list[str]:
    return (inspect.getdoc(module) or "").splitlines()


def _paragraphs(module: ModuleType) -> list[str]:
    return [" ".join(part.split()) for part in (inspect.getdoc(module) or "").split("\n\n")]


if __name__ == "__main__":
    main()
