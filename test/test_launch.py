# SPDX-License-Identifier: Apache-2.0
"""The launch files, and what the real `ros2 launch` makes of them and of a user's own.

`launch_files/recorded` holds the command lines and parameter files that launch_ros of Jazzy gave to the processes, byte
for byte (`launch_files/record.py`). They are read and the commands are run. The launch files themselves are read with
stand-ins for the classes of launch, and must still ask for what was recorded.
"""

from __future__ import annotations

import ast
import itertools
import os
import runpy
import shlex
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import cv2
import numpy as np
import pytest

from imgu_ros.config.files import GivenParameters
from imgu_ros.config.rcl_parameters import RclParameters

REPOSITORY = Path(__file__).resolve().parent.parent
LAUNCH = REPOSITORY / "launch"
RECORDED = REPOSITORY / "test" / "launch_files" / "recorded"
FILES = sorted(path.name for path in LAUNCH.glob("*.launch.py"))


@dataclass
class Context:
    """Launch configurations, the nodes that were started, and the declared arguments."""

    values: dict[str, str]
    nodes: list[Node] = field(default_factory=list)
    declared: dict[str, str] = field(default_factory=dict)


class LaunchConfiguration:
    def __init__(self, name: str) -> None:
        self.name = name

    def perform(self, context: Context) -> str:
        return context.values[self.name]


class DeclareLaunchArgument:
    def __init__(self, name: str, *, default_value: str | None = None, description: str) -> None:
        self.name, self.default, self.description = name, default_value, description

    def visit(self, context: Context) -> None:
        context.declared[self.name] = self.description
        if self.name not in context.values:
            assert self.default is not None, f"{self.name}: no value"
            context.values[self.name] = self.default


class OpaqueFunction:
    def __init__(self, *, function: Callable[[Context], Iterable[Any]]) -> None:
        self.function = function

    def visit(self, context: Context) -> None:
        for action in self.function(context):
            action.visit(context)


class LaunchDescription:
    def __init__(self, actions: Iterable[Any]) -> None:
        self.actions = list(actions)

    def visit(self, context: Context) -> None:
        for action in self.actions:
            action.visit(context)


class ParameterValue:
    def __init__(self, value: object, *, value_type: object) -> None:
        self.value, self.type = value, value_type


class PythonLaunchDescriptionSource:
    def __init__(self, path: str) -> None:
        self.path = path


class IncludeLaunchDescription:
    """Its arguments stay set afterwards: including is no scope in launch."""

    def __init__(self, source: PythonLaunchDescriptionSource, *, launch_arguments: Iterable[tuple[str, str]]) -> None:
        self.source, self.arguments = source, list(launch_arguments)

    def visit(self, context: Context) -> None:
        context.values.update(self.arguments)
        runpy.run_path(self.source.path)["generate_launch_description"]().visit(context)


class Node:
    def __init__(
        self, *, package: str, executable: str, name: str | None = None, namespace: str | None = None,
        parameters: list[Any] | None = None, remappings: list[tuple[str, str]] | None = None,
        arguments: list[str] | None = None, ros_arguments: list[str] | None = None,
        additional_env: dict[str, str] | None = None, output: str = "log",
    ) -> None:  # fmt: skip
        self.package, self.executable, self.name, self.namespace = package, executable, name, namespace
        self.parameters, self.remappings = parameters or [], remappings or []
        self.arguments, self.ros_arguments = arguments or [], ros_arguments or []
        self.environment = additional_env or {}
        assert output in ("screen", "log", "both")
        assert all(isinstance(text, str) for text in [*self.arguments, *self.ros_arguments])

    def visit(self, context: Context) -> None:
        context.nodes.append(self)


@pytest.fixture
def share(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An installed share folder, and the stand-ins in place."""
    folder = tmp_path / "share" / "imgu_ros"
    for name in ("config", "launch"):
        shutil.copytree(REPOSITORY / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    parts: dict[str, dict[str, Any]] = {
        "launch": {"LaunchDescription": LaunchDescription},
        "launch.actions": {
            "DeclareLaunchArgument": DeclareLaunchArgument,
            "IncludeLaunchDescription": IncludeLaunchDescription,
            "OpaqueFunction": OpaqueFunction,
        },
        "launch.substitutions": {"LaunchConfiguration": LaunchConfiguration},
        "launch.launch_description_sources": {"PythonLaunchDescriptionSource": PythonLaunchDescriptionSource},
        "launch_ros": {},
        "launch_ros.actions": {"Node": Node},
        "launch_ros.parameter_descriptions": {"ParameterValue": ParameterValue},
        "ament_index_python": {},
        "ament_index_python.packages": {"get_package_share_directory": lambda _: str(folder)},
    }
    for name, content in parts.items():
        module = ModuleType(name)
        module.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, module)
    return folder


def launched(share: Path, file: str, **values: str) -> Context:
    context = Context(dict(values))
    runpy.run_path(str(share / "launch" / file))["generate_launch_description"]().visit(context)
    return context


def test_files_are_found() -> None:
    assert FILES == ["cameras.launch.py", "perception.launch.py", "replay.launch.py"]


@pytest.mark.parametrize("file", FILES)
def test_every_argument_is_described_and_used_in_the_examples(share: Path, file: str) -> None:
    context = launched(share, file, bag="bag")
    assert all(len(description) > 5 for description in context.declared.values())
    text = ast.get_docstring(ast.parse((LAUNCH / file).read_text()))
    assert text is not None
    lines = [line for line in text.splitlines() if line.strip().startswith("ros2 launch imgu_ros")]
    assert lines
    for line in lines:
        assert file in line
        assert {word.partition(":=")[0] for word in line.split() if ":=" in word} <= context.declared.keys()


def asked(node: Node) -> dict[str, object]:
    """Return the parameters that a launch file asks for inline."""
    values: dict[str, object] = {}
    for parameters in node.parameters:
        if isinstance(parameters, dict):
            values |= {n: v.value if isinstance(v, ParameterValue) else v for n, v in parameters.items()}
    return values


def test_rviz_beside_it(share: Path) -> None:
    given = {"rviz": "true", "namespace": "left", "target": "a/poster.png", "target_prefix": "left/"}
    perception, rviz = launched(share, "perception.launch.py", **given).nodes
    assert asked(perception)["frames.target_prefix"] == "left/"
    assert (rviz.package, rviz.namespace) == ("rviz2", "left")
    assert rviz.arguments[-2:] == ["-f", "left/poster"]
    assert Path(rviz.arguments[1]).is_file()


@pytest.mark.parametrize(
    ("file", "values", "said"),
    [
        ("perception.launch.py", {"rviz": "yes"}, "rviz: 'yes'; need true or false"),
        ("perception.launch.py", {"target": "a.png", "width_m": "wide"}, "width_m: 'wide'; need a number"),
        (
            "perception.launch.py",
            {"params_file": "/no/p.yaml"},
            "params_file: '/no/p.yaml': no such file; need a param",
        ),
        ("cameras.launch.py", {"cameras": "left,left"}, "cameras: 'left,left'; need different names"),
    ],
)
def test_wrong_arguments_are_told(share: Path, file: str, values: dict[str, str], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        launched(share, file, **values)


@dataclass(frozen=True)
class Recorded:
    """A process as the real launch starts it: words of its command line, its environment, and its parameter files."""

    folder: Path
    words: list[str]
    environment: dict[str, str]

    @property
    def name(self) -> str:
        """The node's full name."""
        rules = dict(word.split(":=") for word in self.after("-r"))
        return f"{rules.get('__ns', '/').rstrip('/')}/{rules.get('__node', 'perception')}"

    def after(self, option: str) -> list[str]:
        return [self.words[i + 1] for i, word in enumerate(self.words) if word == option]

    def values(self) -> dict[str, object]:
        """What its files and overrides say, read as a replay reads them."""
        given = GivenParameters(self.name)
        for option, value in itertools.pairwise(self.words):
            if option == "--params-file":
                given.add_file(self.folder / value if value.startswith("params_") else RECORDED.parent / value)
            elif option == "-p":
                given.add_override(value)
        return given.values()


def recorded(folder: Path) -> Recorded:
    words = shlex.split((folder / "command").read_text())
    start = words.index("imgu")
    return Recorded(folder, words[start + 1 :], dict(word.split("=", 1) for word in words[:start]))


LAUNCHES = dict(line.split(": ", 1) for line in (RECORDED.parent / "launches.txt").read_text().splitlines())
PROCESSES = sorted(path.name for path in RECORDED.iterdir())


@pytest.mark.parametrize("case", [case for case, line in LAUNCHES.items() if line.startswith("imgu_ros ")])
def test_the_launch_files_ask_for_what_was_recorded(share: Path, case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(RECORDED.parent)
    _, file, *arguments = shlex.split(LAUNCHES[case])
    nodes = launched(share, file, **dict(argument.split(":=") for argument in arguments)).nodes
    processes = [recorded(RECORDED / name) for name in PROCESSES if name.rpartition("_")[0] == case]
    key: Callable[[Any], list[str]] = lambda either: [either.arguments[0], either.namespace or ""]  # noqa: E731
    for node, process in zip(sorted(nodes, key=key), processes, strict=True):
        assert (node.package, node.executable) == ("imgu_ros", "imgu")
        assert process.words[: len(node.arguments)] == node.arguments
        assert process.environment == node.environment
        if process.words[0] == "play":
            continue
        assert process.name == f"/{node.namespace}/{node.name}".replace("//", "/")
        assert [tuple(word.split(":=")) for word in process.after("-r") if not word.startswith("__")] == node.remappings
        rcl = RclParameters()
        for file in [name for name in process.after("--params-file") if name.startswith("params_")]:
            (section,) = rcl.add_file((process.folder / file).read_bytes(), file)
            assert section == process.name
        written = {name: entry.value for name, entry in rcl.entries(lambda section: True).items()}
        assert written == asked(node)
        assert [p for p in node.parameters if isinstance(p, str)] == [
            name for name in process.after("--params-file") if not name.startswith("params_")
        ]


#: What the user's launch files say, by process.
SAID: dict[str, dict[str, object]] = {
    "python_0": {
        "targets.images": ("poster.png", f"a long name of a picture, {'with commas and spaces, ' * 3}: folded.png"),
        "targets.widths_m": (0.594, 1e-05), "targets.names": ("poster", "second"), "raw.bands": (0, 2, 1), "seed": 7,
        "publish_tf": False, "pose.ambiguity_ratio": 0.001, "raw.black_level": 64.0, "frames.map": "mäp",
        "frames.camera": "", "frames.target_prefix": "on_", "homography.threshold_px": 2.0, "tracking.search_every": 3,
        "compressed.jpeg_quality": 80, "raw.gains": (1.5, 1.0, 2.0),
        "targets.poses": (0.0,) * 6 + (1.0, 1.0, -2.5) + (0.0,) * 4 + (1.0,),
    },
    "python_1": {"targets.images": ("./poster.png",), "targets.widths_m": (1.0,), "frames.map": "2"},
    "xml_0": {
        "targets.images": ("poster.png", "second.png"), "targets.widths_m": (0.594, 1.0), "seed": 7, "frames.map": "5"
    },
    "xml_1": {"targets.images": ("poster.png",), "targets.widths_m": (1.0,), "raw.bands": (2,)},
    "yaml_0": {
        "targets.images": ("poster.png",), "targets.widths_m": (0.594,), "raw.bands": (0, 2), "publish_tf": False,
        "homography.threshold_px": 2.5,
    },
}  # fmt: skip


@pytest.mark.parametrize("name", SAID)
def test_what_a_users_launch_file_says_is_read(name: str) -> None:
    assert recorded(RECORDED / name).values() == SAID[name]


def test_lists_are_written_with_a_tag_of_python() -> None:
    """Else the recordings would show nothing: yaml.safe_load refuses the tag."""
    tagged = [path for path in RECORDED.glob("*/params_*.yaml") if "!!python/tuple" in path.read_text()]
    assert {path.parent.name for path in tagged} >= {"one_camera_0", "two_cameras_0", "bag_0", "python_0"}


@pytest.mark.parametrize("name", [name for name in PROCESSES if name not in ("bag_1", "two_cameras_1")])
def test_nodes_start_as_they_were_launched(name: str, tmp_path: Path, ros_domain: int) -> None:
    pytest.importorskip("rclpy", reason="needs the ros extra")
    process = recorded(RECORDED / name)
    shutil.copytree(process.folder, tmp_path, dirs_exist_ok=True)
    shutil.copy(RECORDED.parent / "perception.yaml", tmp_path)
    pixels = np.random.default_rng(1).integers(0, 255, (60, 80, 3), np.uint8)
    values = process.values()
    images = cast("tuple[str, ...]", values.get("targets.images", ()))
    for image in images:
        # OpenCV looks at the name when it writes, and at the content when it reads.
        (tmp_path / image).write_bytes(cv2.imencode(".png", pixels)[1].tobytes())
    said = f"targets: {', '.join(['poster', 'second'][: len(images)]) if name != 'odd_texts_0' else 'target_007'}"
    said = {"python_0": "targets: poster, second", "parameter_file_0": "targets: none"}.get(name, said)
    command = [sys.executable, "-m", "imgu_ros.cli.main", *process.words]
    environment = os.environ | process.environment | {"PYTHONPATH": str(REPOSITORY)}
    started = subprocess.Popen(
        command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    killer = threading.Timer(60, started.kill)
    killer.start()
    lines = []
    try:
        assert started.stdout is not None
        for line in started.stdout:
            lines.append(line)
            if said in line:
                break
        else:
            pytest.fail("".join(lines))
        started.send_signal(signal.SIGINT)
        rest = started.stdout.read()
        assert started.wait() == 0, rest
    finally:
        killer.cancel()
        started.kill()
        started.communicate()
    text = "".join(lines)
    assert "Traceback" not in text
    assert ("FASTDDS_BUILTIN_TRANSPORTS is DEFAULT" in text) == (name == "odd_texts_0")


def test_the_player_is_started_as_it_was_launched(tmp_path: Path, ros_domain: int) -> None:
    pytest.importorskip("rclpy", reason="needs the ros extra")
    command = [sys.executable, "-m", "imgu_ros.cli.main", *recorded(RECORDED / "bag_1").words]
    done = subprocess.run(
        command,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 1, done.stderr
    assert done.stderr.startswith("imgu: error: recording: ")


def test_a_file_that_launch_leaves_out_of_force_is_named() -> None:
    """`SetParameter` makes the section `/**` the first one: the file for all nodes then comes before the node's own."""
    process = recorded(RECORDED / "python_0")
    given = GivenParameters(process.name)
    for option, value in itertools.pairwise(process.words):
        if option == "--params-file":
            given.add_file(process.folder / value)
        elif option == "-p":
            given.add_override(value)
    (line,) = given.warnings()
    assert line.startswith("homography.threshold_px: 2 is in force, not the later 2.5: ")


@pytest.mark.skipif(not (shutil.which("ros2") and os.environ.get("AMENT_PREFIX_PATH")), reason="needs ros2 launch")
def test_the_real_launch_writes_what_is_recorded(tmp_path: Path) -> None:
    subprocess.run([sys.executable, str(RECORDED.parent / "record.py"), str(tmp_path / "recorded")], check=True)
    assert sorted(path.name for path in (tmp_path / "recorded").iterdir()) == PROCESSES
    for path in RECORDED.glob("*/*"):
        assert (tmp_path / "recorded" / path.relative_to(RECORDED)).read_text() == path.read_text()
