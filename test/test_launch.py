"""The launch files: read with stand-ins for launch and launch_ros, and what they would start is started.

The stand-ins do what those of Jazzy do with these actions, as far as the launch files need it: arguments with defaults,
functions of the context, files in files, and the command line that a node gets.
"""

from __future__ import annotations

import ast
import runpy
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml

REPOSITORY = Path(__file__).resolve().parent.parent
LAUNCH = REPOSITORY / "launch"
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

    def command(self, folder: Path) -> list[str]:
        """Return the command line after the executable's name, as launch_ros makes it."""
        command = [*self.arguments, *(["--ros-args", *self.ros_arguments] if self.ros_arguments else []), "--ros-args"]
        if self.name is not None:
            command += ["-r", f"__node:={self.name}"]
        if self.namespace:
            command += ["-r", f"__ns:=/{self.namespace.lstrip('/')}"]
        for number, parameters in enumerate(self.parameters):
            path = str(parameters)
            if isinstance(parameters, dict):
                full_name = f"/{self.namespace}/{self.name}" if self.namespace and self.name else "/**"
                path = str(folder / f"launch_params_{number}.yaml")
                Path(path).write_text(yaml.safe_dump({full_name: {"ros__parameters": parameters}}))
            command += ["--params-file", path]
        for source, target in self.remappings:
            command += ["-r", f"{source}:={target}"]
        return command


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


def test_one_camera(share: Path) -> None:
    (node,) = launched(share, "perception.launch.py", target="poster.png", width_m="0.42", image="/cam/image_raw").nodes
    assert (node.package, node.executable, node.arguments) == ("imgu_ros", "imgu", ["node", "perception"])
    assert node.parameters == [{"targets.images": ["poster.png"], "targets.widths_m": [0.42]}]
    assert node.remappings == [("image_raw", "/cam/image_raw")]
    assert Path(node.environment["FASTRTPS_DEFAULT_PROFILES_FILE"]).is_file()
    (node,) = launched(share, "perception.launch.py", params_file="p.yaml", large_images="false").nodes
    assert node.parameters == ["p.yaml"], "nothing of the file is overridden by defaults"
    assert node.environment == {}


def test_rviz_beside_it(share: Path) -> None:
    given = {"rviz": "true", "namespace": "left", "target": "a/poster.png", "target_prefix": "left/"}
    perception, rviz = launched(share, "perception.launch.py", **given).nodes
    assert perception.parameters[0]["frames.target_prefix"] == "left/"
    assert (rviz.package, rviz.namespace) == ("rviz2", "left")
    assert rviz.arguments[-2:] == ["-f", "left/poster"]
    assert Path(rviz.arguments[1]).is_file()


@pytest.mark.parametrize(
    ("file", "values", "said"),
    [
        ("perception.launch.py", {"rviz": "yes"}, "rviz: 'yes'; need true or false"),
        ("perception.launch.py", {"target": "a.png", "width_m": "wide"}, "width_m: 'wide'; need a number"),
        ("cameras.launch.py", {"cameras": "left,left"}, "cameras: 'left,left'; need different names"),
    ],
)
def test_wrong_arguments_are_told(share: Path, file: str, values: dict[str, str], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        launched(share, file, **values)


def test_several_cameras(share: Path) -> None:
    nodes = launched(share, "cameras.launch.py", cameras="left, right", target="poster.png", publish_tf="true").nodes
    assert [(node.namespace, node.name) for node in nodes] == [("left", "perception"), ("right", "perception")]
    assert [node.parameters[0]["frames.target_prefix"] for node in nodes] == ["left/", "right/"]
    assert all(node.remappings == [("image_raw", "image_raw")] for node in nodes)


def test_a_bag(share: Path) -> None:
    perception, player = launched(share, "replay.launch.py", bag="bags/one", loop="true").nodes
    assert perception.parameters == [{"use_sim_time": True}]
    assert player.arguments == ["play", "bags/one", "--wait-for", "1", "--rate", "1.0", "--loop"]


def test_the_commands_are_understood(share: Path, tmp_path: Path, ros_domain: int) -> None:
    """The command lines, run: the node refuses the target that is not there, the player the bag."""
    pytest.importorskip("rclpy", reason="needs the ros extra")
    nodes = launched(
        share, "replay.launch.py", bag="no_bag", target="/nowhere/x.png", namespace="left", transport="compressed"
    ).nodes
    nodes += launched(share, "cameras.launch.py", cameras="a", target="/nowhere/y.png").nodes
    for node, said in zip(nodes, ("/nowhere/x.png", "no_bag", "/nowhere/y.png"), strict=True):
        command = [sys.executable, "-m", "imgu_ros.cli.main", *node.command(tmp_path)]
        done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, timeout=60)
        assert done.returncode == 1, done.stderr
        assert done.stderr.startswith("imgu: error: ")
        assert said in done.stderr
