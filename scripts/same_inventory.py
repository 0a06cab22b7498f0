# SPDX-License-Identifier: Apache-2.0
"""Compare what users have in this working tree with another revision: nothing may be lost.

Listed of each tree are the commands with their options and choices, the parameters with type, default and range, the
nodes, topics and services (by the documentation and the texts in the code: no node is started), the arguments of launch
files, the files in `config/`, and the files that `imgu simulate` and `imgu replay` write with their columns, entries
and topics. Exits 1 when an item is missing or has changed; prints new items.
"""

from __future__ import annotations

import argparse
import ast
import csv
import json
import re
import runpy
import sys
import tempfile
import types
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

from same_numbers import ROOT, Job, bag_messages, commit_of, export, run_jobs

#: Names of items, such as `parameter homography.score choice truncated`, with a value that must stay (or "").
Inventory = dict[str, str]

NODES = ("perception", "demosaic", "pyramid", "features", "matcher", "homography", "pose")
_SIMULATE = "--size 320x240 --frames 4 --targets 2"
_REPLAY = "--record keypoints matches path image_color image_mono debug_image pyramid/level_0"
_POSES = "targets.poses:=[0.0,0.0,0.0,0.0,0.0,0.0,1.0,1.0,0.0,0.0,0.0,0.0,0.0,1.0]"


def losses(old: Inventory, new: Inventory) -> list[str]:
    """Return a line for each item of `old` that `new` lacks or has with another value."""
    lines = []
    for name, value in old.items():
        if name not in new:
            lines.append(f"{name}: missing")
        elif new[name] != value and not _is_wider(name, value, new[name]):
            lines.append(f"{name}: {value} became {new[name]}")
    return lines


def _is_wider(name: str, old: str, new: str) -> bool:
    """Return whether a range became wider, or a parameter can now be set while running."""
    if name.endswith((" minimum", " maximum")):
        return not new or (bool(old) and (float(new) < float(old)) == name.endswith(" minimum"))
    return name.endswith(" can be set") and new == "at any time"


def option_items(command: str, text: str) -> Inventory:
    """Return the options, choices and number of positional arguments in the text of `imgu COMMAND --help`."""
    items = {f"command {command}": ""}
    positional = 0
    section = ""
    for line in text.splitlines():
        if re.match(r"\S.*:$", line):
            section = line
        elif section == "positional arguments:" and re.match(r"  [^\s.]", line):
            positional += 1
        # Between names and help are two spaces or more; a metavar can contain single ones.
        elif found := re.match(r"  (-.+?)(?:  .*)?$", line):
            items |= _option_items(command, found[1])
    if positional:
        items[f"{command}: positional arguments"] = str(positional)
    return items


def _option_items(command: str, declared: str) -> Inventory:
    items = {}
    choices = re.search(r"\{(.+?)\}", declared)
    for name in re.findall(r"(?<![\w-])--?[a-z][\w-]*", declared):
        option = f"{command} {name}"
        items[option] = "with a value" if re.search(rf"{re.escape(name)} [^-,\s]", declared) else "without a value"
        for choice in choices[1].split(",") if choices else ():
            items[f"{option} {choice}"] = ""
    return items


def parameter_items(markdown: str) -> Inventory:
    """Return the parameters in the tables of the text of `imgu params --markdown`."""
    items = {}
    for line in markdown.splitlines():
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        if len(cells) < 5 or not re.fullmatch(r"`[\w.]+`", cells[0]):
            continue
        name, type_name, default, values, note = f"parameter {cells[0].strip('`')}", *cells[1:5]
        items |= {name: "", f"{name} type": type_name, f"{name} default": default}
        items[f"{name} can be set"] = "before the start" if "*Fixed while running.*" in note else "at any time"
        limits = re.match(r"(\S*) to (\S+)", values)
        items |= {f"{name} minimum": limits[1] if limits else "", f"{name} maximum": limits[2] if limits else ""}
        items |= {f"{name} choice {choice}": "" for choice in re.findall(r"`([^`]+)`", values)}
    return items


def topic_items(page: str) -> Inventory:
    """Return the topics in the tables and the services in the text of a page of the documentation."""
    items = {}
    for line in page.splitlines():
        cells = [cell.strip() for cell in line.split("|")[1:-1]]
        if len(cells) == 3 and re.search(r"\b\w+_msgs/\w+", cells[1]):
            items |= {f"topic {topic}": cells[1] for topic in re.findall(r"`([^`]+)`", cells[0])}
        elif len(cells) == 3 and cells[0].strip("`") in NODES and cells[0].startswith("`"):
            items |= {
                f"topic {topic} of {cells[0]}": "" for topic in re.findall(r"`([a-z_/<>]+)`", cells[1] + cells[2])
            }
    for services, type_name in re.findall(r"(`~/\w+`(?:, `~/\w+`)*)\s+\((std_srvs/\w+)\)", page):
        items |= {f"service {service}": type_name for service in re.findall(r"`(.+?)`", services)}
    return items


def text_items(tree: Path, documented: Inventory) -> Inventory:
    """Return those documented topics and services that the code of `tree` names in a text."""
    written = {text.lstrip("/") for path in (tree / "imgu_ros").rglob("*.py") for text in _texts(path)}
    names = sorted({item.split()[1] for item in documented})

    def is_written(name: str) -> bool:
        start, placeholder, _ = name.lstrip("/").partition("<")
        return start in written or (bool(placeholder) and any(text.startswith(start) for text in written))

    return {f"{name} in the code": "" for name in names if is_written(name)}


def _texts(path: Path) -> Iterator[str]:
    """Yield the string constants of a module; what an f-string inserts is `*`."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else "*" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


class _Stub(types.ModuleType):
    """A module of ROS' launch system, in which everything exists and does nothing."""

    def __getattr__(self, name: str) -> Any:
        return mock.MagicMock(name=name)


def launch_items(tree: Path) -> Inventory:
    """Return the launch files and their arguments; ROS' launch system is not needed."""
    items = {}
    for path in sorted((tree / "launch").glob("*.launch.py")):
        items[f"launch file {path.name}"] = ""
        imported = re.findall(
            r"^\s*from ((?:launch|ament)[\w.]*) import|^import ((?:launch|ament)[\w.]*)", path.read_text(), re.M
        )
        names = {".".join(name.split(".")[:n]) for pair in imported for name in pair if name for n in (1, 2, 3)}
        stubs: dict[str, Any] = {name: _Stub(name) for name in names}
        declare = stubs.setdefault("launch.actions", _Stub("launch.actions")).DeclareLaunchArgument = mock.MagicMock()
        with mock.patch.dict(sys.modules, stubs):
            runpy.run_path(str(path))["generate_launch_description"]()
        for call in declare.call_args_list:
            items[f"launch file {path.name} argument {call.args[0]}"] = str(call.kwargs.get("default_value"))
    return items


def folder_items(folder: Path, name: str) -> Inventory:
    """Return the files of a folder, with the columns of tables, entries of JSON, and topics of bags."""
    items = {}
    for path in sorted(folder.iterdir()):
        file = f"{name} writes {path.name}"
        items[file] = ""
        if path.suffix == ".csv":
            with path.open(newline="") as opened:
                items |= {f"{file} column {column}": "" for column in next(csv.reader(opened), [])}
        elif path.suffix == ".json":
            items |= {f"{file} entry {entry}": "" for entry in _entries(json.loads(path.read_text()))}
        elif (path / "metadata.yaml").is_file():
            for topic, messages in bag_messages(path).items():
                items[f"{file} topic {topic}"] = messages[0].type_name if messages else "empty"
    return items


def _entries(value: Any, name: str = "") -> Iterator[str]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _entries(inner, f"{name}.{key}" if name else key)
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        for inner in value:
            yield from _entries(inner, f"{name}[]")
    else:
        yield name


def inventory(tree: Path, folder: Path) -> Inventory:
    """Return what users have in `tree`; `folder` is for temporary files."""

    def run(commands: dict[str, list[str]]) -> dict[str, str]:
        """Run command lines of `imgu`; return what those that succeeded print."""
        jobs = {name: Job(command, folder / name) for name, command in commands.items()}
        if run_jobs(tree, jobs.values(), folder).wait():
            raise SystemExit(f"same_inventory: error: {tree}: imgu does not run")
        failures.update((name, job.failure()) for name, job in jobs.items() if job.failure())
        return {name: job.text() for name, job in jobs.items() if name not in failures}

    failures: dict[str, str] = {}
    top = run({"help": ["--help"]})["help"]
    commands = re.findall(r"^    (\w+)\b", top.partition("COMMAND\n")[2], re.MULTILINE)
    bag, results = folder / "simulate", folder / "replay"
    printed = run(
        {f"help-{name}": [name, "--help"] for name in commands}
        | {f"node-{name}": ["node", name, "--help"] for name in NODES}
        | {"all": ["params", "--markdown", "--all"], "params": ["params", "--markdown"]}
        | {"simulate": ["simulate", "--out", str(bag), *_SIMULATE.split()]}
        | {"replay": ["replay", str(bag), "--params-file", str(bag / "params.yaml"), "--out", str(results)]
           + ["--truth", str(bag / "truth.csv"), "-p", _POSES, "-p", "publish_tf:=true", *_REPLAY.split()]}
    )  # fmt: skip
    for name in ("params", "simulate", "replay"):
        if name in failures:
            raise SystemExit(f"same_inventory: error: {tree}: imgu {name}: {failures[name]}")
    items: Inventory = {}
    for name in commands:
        items |= option_items(name, printed.get(f"help-{name}", ""))
    items |= {f"node {name}": "" for name in NODES if f"node-{name}" in printed}
    items |= parameter_items(printed.get("all", printed["params"]))
    items |= folder_items(bag, "simulate") | folder_items(results, "replay")
    documented: Inventory = {}
    for page in ("interfaces.md", "stage-nodes.md"):
        documented |= topic_items((tree / "docs" / page).read_text())
    items |= documented | text_items(tree, documented) | launch_items(tree)
    items |= {f"file config/{path.name}": "" for path in (tree / "config").iterdir()}
    return items


def main(arguments: Sequence[str]) -> int:
    """Compare; return the exit code."""
    parser = argparse.ArgumentParser(prog="scripts/same_inventory", description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("revision", nargs="?", default="origin/main", metavar="REV", help="default: origin/main")
    parser.add_argument("--list", action="store_true", help="print the items of the working tree and compare nothing")
    parsed = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="same_inventory-") as name:
        folder = Path(name)
        new = inventory(ROOT, folder / "new")
        if parsed.list:
            print(*(f"{item}: {value}" if value else item for item, value in new.items()), sep="\n")
            return 0
        commit = commit_of(parsed.revision)
        export(commit, folder / "tree")
        old = inventory(folder / "tree", folder / "old")
    lost = losses(old, new)
    added = [item for item in new if item not in old]
    print(*(f"new      {item}" for item in added), *(f"LOST     {line}" for line in lost), sep="\n")
    print(f"{len(old)} items of {parsed.revision} ({commit[:10]}): {len(lost)} lost or changed, {len(added)} new")
    return 1 if lost else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
