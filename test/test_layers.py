# SPDX-License-Identifier: Apache-2.0
"""The structure of the package: which layer may import what, how files are named, sized and documented."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
PACKAGE = REPOSITORY / "imgu_ros"

MOST_LINES = 450
#: As long as the list of parameters is.
LONG_LISTS = {"config.parameters"}
CATCH_ALL_NAMES = {"util", "utils", "helper", "helpers", "misc", "common", "tools"}

MESSAGE_PACKAGES = {
    "action_msgs", "builtin_interfaces", "diagnostic_msgs", "geometry_msgs", "lifecycle_msgs", "nav_msgs",
    "rcl_interfaces", "rosgraph_msgs", "sensor_msgs", "std_msgs", "std_srvs", "tf2_msgs", "visualization_msgs",
}  # fmt: skip
#: Modules of a ROS installation: under ros/ alone.
ROS_MODULES = {"rclpy", "rosidl_runtime_py", "rosidl_parser", "ament_index_python", "tf2_ros", "rpyutils"}
#: Fields that exist in messages and nowhere else: touched in messages/ alone.
MESSAGE_FIELDS = {"nanosec", "is_bigendian", "distortion_model", "point_step", "row_step", "is_dense"}

#: Files, clocks, processes and the network: not the business of an algorithm.
NOT_FOR_VISION = {
    "asyncio", "datetime", "io", "logging", "multiprocessing", "os", "pathlib", "shutil", "signal", "socket", "sqlite3",
    "subprocess", "tempfile", "threading", "time",
}  # fmt: skip
NUMERIC = {"numpy", "scipy", "cv2"}

#: The rooms, from the bottom up: a module imports from its own room and from those before it.
ORDER = (
    "shown_text", "errors", "arguments", "types", "file_access", "vision", "config", "frame", "image",
    "result", "reasons", "build_cache", "pose", "reference", "track", "camera_memory", "detect",
    "reference_kinds", "localizer", "remarks", "process_memory", "stop_signals", "threads",
    "image_files", "messages", "files", "simulate", "check", "report", "bags", "replay", "view", "bench", "ros", "cli",
)  # fmt: skip
#: From a frame to a result: knows no message, no file and no recording.
PIPELINE = {
    "frame", "image", "result", "reasons", "build_cache", "reference", "pose", "track", "detect",
    "camera_memory", "reference_kinds", "localizer",
}  # fmt: skip

#: What a room may import from outside the standard library, where that is limited.
THIRD_PARTY = {
    **{key: set[str]() for key in ("shown_text", "errors")},
    **{key: {"numpy"} for key in ("arguments", "types")},
    **dict.fromkeys(("vision", "messages", *PIPELINE), NUMERIC),
    "config": {"yaml"},
}


@dataclass(frozen=True, slots=True)
class Source:
    """One module: its dotted name without the package's (`vision.camera.pose`) and its text."""

    name: str
    text: str

    @property
    def layer(self) -> str:
        return self.name.partition(".")[0]


def package_sources() -> list[Source]:
    paths = sorted(PACKAGE.rglob("*.py"))
    return [
        Source(".".join(path.relative_to(PACKAGE).with_suffix("").parts), path.read_text(encoding="utf-8"))
        for path in paths
    ]


def imported_names(source: Source) -> Iterator[str]:
    """Yield the dotted name of everything that a module imports, at its top or inside a function."""
    for node in ast.walk(ast.parse(source.text)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = f"imgu_ros.{source.name}".split(".")
                base = ".".join([*parts[: len(parts) - node.level], *filter(None, [base])])
            yield from (f"{base}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            # importlib.import_module("rclpy"), __import__("rclpy"), find_spec("rclpy")
            function = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if function in {"import_module", "__import__"} and isinstance(node.args[0].value, str):
                yield node.args[0].value


def wrong_imports(source: Source) -> Iterator[str]:
    """Yield what breaks the laws of the layers."""
    for name in imported_names(source):
        root, _, rest = name.partition(".")
        if root == "imgu_ros":
            room = rest.partition(".")[0]
            if room and ORDER.index(room) > ORDER.index(source.layer):
                yield f"{source.name} imports {name}: {room} is above {source.layer}"
            elif source.layer == "vision" and room not in {"vision", "errors", "arguments", "types"}:
                yield f"{source.name} imports {name}: vision/ knows arrays and nothing else"
            elif source.layer in PIPELINE and room == "file_access":
                yield f"{source.name} imports {name}: the pipeline knows no files"
            elif room == "ros" and source.layer not in {"ros", "cli"}:
                yield f"{source.name} imports {name}: only commands may"
        elif root in ROS_MODULES | MESSAGE_PACKAGES and source.layer != "ros":
            yield f"{source.name} imports {name}: only ros/ may"
        elif root == "rosbags" and source.layer not in {"bags", "messages"}:
            yield f"{source.name} imports {name}: only bags/ and messages/ may"
        elif root in sys.stdlib_module_names:
            if source.layer == "vision" and root in NOT_FOR_VISION:
                yield f"{source.name} imports {name}: vision/ knows no files, clocks or processes"
        elif source.layer in THIRD_PARTY and root not in THIRD_PARTY[source.layer]:
            need = ", ".join(sorted(THIRD_PARTY[source.layer])) or "nothing"
            yield f"{source.name} imports {name}: {source.layer} may import {need}"


def wrong_fields(source: Source) -> Iterator[str]:
    """Yield accesses to fields of messages outside messages/."""
    if source.layer == "messages":
        return
    for node in ast.walk(ast.parse(source.text)):
        if not isinstance(node, ast.Attribute):
            continue
        nested = node.value.attr if isinstance(node.value, ast.Attribute) else ""
        if node.attr in MESSAGE_FIELDS or f"{nested}.{node.attr}" in {"stamp.sec", "header.stamp", "clock.sec"}:
            yield f"{source.name}:{node.lineno} touches .{nested + '.' if nested else ''}{node.attr}: only messages/"


def undocumented(source: Source) -> Iterator[str]:
    """Yield the public modules, classes and functions without a docstring."""
    tree = ast.parse(source.text)
    if tree.body and not ast.get_docstring(tree):
        yield f"{source.name}: the module has no docstring"
    for node in tree.body:
        if not isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) or node.name.startswith("_"):
            continue
        # A group of parameters is described by its fields.
        if not ast.get_docstring(node) and not (
            source.name == "config.parameters" and node.name.endswith("Parameters")
        ):
            yield f"{source.name}: {node.name} has no docstring"


def too_long(source: Source) -> Iterator[str]:
    count = len(source.text.splitlines())
    if count > MOST_LINES and source.name not in LONG_LISTS:
        yield f"{source.name}: {count} lines; need at most {MOST_LINES}: give the second job a file of its own"


def catch_all(source: Source) -> Iterator[str]:
    for part in CATCH_ALL_NAMES.intersection(source.name.split(".")):
        yield f"{source.name}: named {part!r}; need a name that says what it does"


RULES: tuple[Callable[[Source], Iterator[str]], ...] = (
    wrong_imports, wrong_fields, undocumented, too_long, catch_all,
)  # fmt: skip


@pytest.mark.parametrize("rule", RULES)
def test_package_keeps_the_rule(rule: Callable[[Source], Iterator[str]]) -> None:
    sources = package_sources()
    assert len(sources) > 20
    assert [violation for source in sources for violation in rule(source)] == []


@pytest.mark.parametrize(
    ("rule", "name", "text"),
    [
        (wrong_imports, "vision.edges", "import time"),
        (wrong_imports, "vision.edges", "from datetime import datetime"),
        (wrong_imports, "vision.edges", "def f():\n    import rclpy"),
        (wrong_imports, "vision.edges", "import matplotlib.pyplot as plt"),
        (wrong_imports, "vision.edges", "from imgu_ros.frame import Frame"),
        (wrong_imports, "vision.camera.pose", "from ...messages import frame"),
        (wrong_imports, "vision.edges", "from imgu_ros.config import parameters"),
        (wrong_imports, "localizer", "from imgu_ros.messages.frame import decode_frame"),
        (wrong_imports, "localizer", "if TYPE_CHECKING:\n    from sensor_msgs.msg import Image"),
        (wrong_imports, "localizer", "import yaml"),
        (wrong_imports, "messages.image", "from sensor_msgs.msg import Image"),
        (wrong_imports, "files.images", "from rosbags.typesys import Stores"),
        (wrong_imports, "messages.image", "import imgu_ros.bags.reading"),
        (wrong_imports, "report.table", "from imgu_ros.bags.reading import open_bag"),
        (wrong_imports, "bags.reading", "from rclpy.serialization import deserialize_message"),
        (wrong_imports, "replay.replay", "def f():\n    from imgu_ros.ros import messages"),
        (wrong_imports, "replay.replay", "from imgu_ros.cli import main"),
        (wrong_imports, "ros.player", "from rosbags.highlevel import AnyReader"),
        (wrong_imports, "cli.node", "import importlib\nimportlib.import_module('rclpy')"),
        (wrong_imports, "types", "import cv2"),
        (wrong_fields, "ros.node", "def f(m):\n    return m.header.stamp"),
        (wrong_fields, "replay.replay", "def f(m):\n    return m.stamp.sec"),
        (wrong_fields, "replay.replay", "def f(m):\n    m.is_bigendian = 1"),
        (undocumented, "files.images", "def read_image(path):\n    pass"),
        (undocumented, "files.images", '"""Module."""\nclass Reader:\n    x = 1'),
        (too_long, "files.images", "x = 1\n" * (MOST_LINES + 1)),
        (catch_all, "vision.utils", ""),
        (catch_all, "messages.helpers.image", ""),
    ],
)
def test_rule_sees_the_violation(rule: Callable[[Source], Iterator[str]], name: str, text: str) -> None:
    assert list(rule(Source(name, text)))


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("vision.edges", "import math\nimport cv2\nfrom scipy import ndimage\nfrom imgu_ros.errors import ShapeError"),
        ("vision.camera.pose", "from .intrinsics import Camera\nfrom ...types import Points"),
        ("localizer", "import time\nfrom imgu_ros.config.parameters import Parameters"),
        ("messages.image", "def f(m):\n    return m.header.stamp.nanosec"),
        ("bags.reading", "from rosbags.highlevel import AnyReader\nfrom imgu_ros.messages.frame import decode_frame"),
        ("ros.node", "import rclpy\nfrom sensor_msgs.msg import Image\nfrom imgu_ros.bags.reading import open_bag"),
        ("cli.node", "def run(a):\n    from imgu_ros.ros.perception import main"),
    ],
)
def test_rules_let_pass_what_is_allowed(name: str, text: str) -> None:
    source = Source(name, f'"""Module."""\n{text}')
    assert [*wrong_imports(source), *wrong_fields(source)] == []


def test_a_class_name_exists_once() -> None:
    names: dict[str, list[str]] = {}
    for source in package_sources():
        for node in ast.walk(ast.parse(source.text)):
            if isinstance(node, ast.ClassDef):
                names.setdefault(node.name, []).append(source.name)
    assert len(names) > 300
    assert {name: modules for name, modules in names.items() if len(modules) > 1} == {}


#: Places of one machine, and hosts of package indexes: the repository is for every machine.
FOREIGN = re.compile(r"(?<![\w.~$}>-])/(home|root|tmp|work|Users)/\w|pypi\.org|pythonhosted", re.IGNORECASE)
BINARY = {".png", ".jpg", ".webp", ".pyc", ".mcap", ".db3", ".bag", ".npz", ".tiff", ".pgm"}
FOLDERS = (".ci", "benchmarks", "config", "docker", "docs", "fuzz", "imgu_ros", "launch", "resource", "scripts", "test")


def test_repository_names_no_machine() -> None:
    files = [
        path for path in REPOSITORY.iterdir() if path.is_file() and not path.name.startswith((".git", ".coverage"))
    ]
    files += [REPOSITORY / ".gitignore"]
    files += [path for folder in FOLDERS for path in (REPOSITORY / folder).rglob("*") if path.is_file()]
    found = [
        f"{path.relative_to(REPOSITORY)}:{number}: {line.strip()}"
        for path in files
        if path.suffix not in BINARY
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if FOREIGN.search(line)
    ]
    # The line above that defines the pattern.
    assert [line for line in found if "re.compile" not in line] == []


def test_pattern_for_machine_paths() -> None:
    assert FOREIGN.search("see " + "/".join(["", "home", "someone", "bag"]))
    assert FOREIGN.search("/".join(["", "tmp", "x.png"]))
    assert not FOREIGN.search("$HOME/work/bags ../tmp/x ${ROOT}/tmp/x camera/home/image")
