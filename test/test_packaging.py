# SPDX-License-Identifier: Apache-2.0
"""What pip and colcon are told: files, dependencies, pins, the command."""

from __future__ import annotations

import ast
import importlib
import re
import runpy
import subprocess
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

REPOSITORY = Path(__file__).resolve().parent.parent
PACKAGE = REPOSITORY / "imgu_ros"
CONSTRAINTS = ("constraints.txt", "constraints-jazzy.txt")
#: The packages that benchmarks/ compares with need a newer NumPy than Jazzy has.
LOCKED_EXTRAS = {
    "constraints.txt": ("bench", "foreign", "ros", "supply", "test", "view"),
    "constraints-jazzy.txt": ("ros", "test"),
}
#: Every version of Python that a lock file is for.
PYTHONS = {"constraints.txt": ("3.11", "3.12", "3.13", "3.14"), "constraints-jazzy.txt": ("3.11", "3.12")}

#: Imported module -> (name for pip, rosdep key; empty: comes with another key's).
DISTRIBUTIONS = {
    "PIL": ("pillow", "python3-pil"),
    # No key: a video says what to install.
    "av": ("av", ""),
    "shtab": ("shtab", ""),
    "backports": ("backports-zstd", ""),
    "cv2": ("opencv-python-headless", "python3-opencv"),
    "jinja2": ("jinja2", "python3-jinja2"),
    "lz4": ("lz4", ""),
    "markupsafe": ("markupsafe", ""),
    "matplotlib": ("matplotlib", "python3-matplotlib"),
    "numpy": ("numpy", "python3-numpy"),
    # Its key installs by pip, which no released package may depend on: `imgu_ros.bags` says what to install.
    "rosbags": ("rosbags", ""),
    "scipy": ("scipy", "python3-scipy"),
    "tqdm": ("tqdm", "python3-tqdm"),
    "yaml": ("pyyaml", "python3-yaml"),
}


#: Imported modules of optional dependencies -> the extra that has them, the name for pip, the modules that import them.
OPTIONAL = {"rerun": ("view", "rerun-sdk", "imgu_ros.view.rerun_")}


@pytest.fixture(scope="module")
def manifest() -> ElementTree.Element:
    return ElementTree.parse(REPOSITORY / "package.xml").getroot()


@pytest.fixture(scope="module")
def arguments() -> dict[str, Any]:
    """What setup.py passes to setuptools."""
    setuptools = pytest.importorskip("setuptools")
    caught: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(REPOSITORY)
        patch.setattr(setuptools, "setup", caught.update)
        runpy.run_path("setup.py")
    return caught


def imported_roots(folder: Path) -> set[str]:
    roots = set()
    for path in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                roots.update(alias.name.partition(".")[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                roots.add(node.module.partition(".")[0])
    # `compression` is in the standard library from Python 3.14 on.
    return roots - set(sys.stdlib_module_names) - {"compression", "imgu_ros"}


def message_packages(folder: Path) -> set[str]:
    """Return the packages of the message types that are made or awaited by their names ("std_msgs/msg/Header")."""
    texts = [path.read_text(encoding="utf-8") for path in folder.rglob("*.py")]
    return {name for text in texts for name in re.findall(r'"(\w+)/msg/\w+"', text)} - {"package"}


def locked(file: str, needed: list[str], python: str) -> list[Any]:
    lock = runpy.run_path(str(REPOSITORY / "scripts" / "lock.py"))
    return lock["select"](lock["read"](REPOSITORY / file), needed, python)


def pins(file: str, python: str, *needed: str) -> dict[str, str]:
    """Return the versions that a lock file pins for a version of Python, by canonical name."""
    found = locked(file, ["build", *(needed or ("imgu_ros", *LOCKED_EXTRAS[file]))], python)
    assert len({package.name for package in found}) == len(found)
    return {package.name: package.version for package in found}


def test_manifest_is_an_ament_python_package(manifest: ElementTree.Element, arguments: dict[str, Any]) -> None:
    assert manifest.get("format") == "3"
    assert manifest.findtext("export/build_type") == "ament_python"
    assert manifest.findtext("license") == "Apache-2.0"
    assert (arguments["name"], arguments["version"]) == ("imgu_ros", manifest.findtext("version"))
    assert "Apache License" in (REPOSITORY / "LICENSE").read_text()


def test_manifest_is_one_that_the_index_takes(manifest: ElementTree.Element) -> None:
    keys = {item.text for item in manifest if item.tag.endswith("depend")}
    assert not [key for key in keys if key is None or key.endswith("-pip")]
    assert {item.get("type") for item in manifest.findall("url")} == {"website", "repository", "bugtracker"}
    for maintainer in manifest.findall("maintainer"):
        assert re.fullmatch(r"[\w.-]+@[\w-]+(\.[\w-]+)+", maintainer.get("email", ""))


def test_the_citation_is_of_this_version(manifest: ElementTree.Element) -> None:
    """The form was validated by cffconvert, schema 1.2.0."""
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == manifest.findtext("version")
    assert citation["license"] == manifest.findtext("license")
    assert {"cff-version", "message", "title", "authors"} <= citation.keys()


def test_the_rosdoc2_configuration_names_what_exists(manifest: ElementTree.Element) -> None:
    name = manifest.findtext("export/rosdoc2")
    head, settings = yaml.safe_load_all((REPOSITORY / str(name)).read_text(encoding="utf-8"))
    assert head == {"type": "rosdoc2 config", "version": 1}
    (builder,) = settings["builders"]
    assert (REPOSITORY / settings["settings"]["python_source"] / "__init__.py").exists()
    assert (REPOSITORY / builder["sphinx"]["user_doc_dir"] / "index.md").exists()


def test_the_dockerfile_is_shell_and_installs_what_has_no_key() -> None:
    """It cannot be built here: no container engine."""
    text = (REPOSITORY / "docker" / "Dockerfile").read_text(encoding="utf-8").replace("\\\n", " ")
    commands = re.findall(r"^RUN (.*)$", text, re.MULTILINE)
    assert len(commands) >= 3
    for command in commands:
        done = subprocess.run(["sh", "-n", "-c", command], capture_output=True, text=True, timeout=30)
        assert (done.returncode, done.stderr) == (0, ""), command
    for source in re.findall(r"^COPY (\S+) ", text, re.MULTILINE):
        assert (REPOSITORY / source).exists()
    by_pip = {canonicalize_name(Requirement(line).name) for line in re.findall(r'"([\w.-]+>=[^"]*)"', text)}
    without_key = {name for name, key in DISTRIBUTIONS.values() if not key} - {"markupsafe"}  # which comes with jinja2
    assert by_pip == without_key


def test_every_module_and_data_file_is_installed(arguments: dict[str, Any]) -> None:
    folders = {path.parent for path in PACKAGE.rglob("*.py")}
    assert {".".join(folder.relative_to(REPOSITORY).parts) for folder in folders} == set(arguments["packages"])
    patterns = arguments["package_data"][""]
    others = [
        path
        for path in PACKAGE.rglob("*")
        if path.is_file() and path.suffix not in {".py", ".pyc"} and "__pycache__" not in path.parts
    ]
    for path in others:
        package = next(folder for folder in path.parents if folder in folders)
        assert any(path in package.glob(pattern) for pattern in patterns), f"{path}: not in setup.py's package_data"
    shared = {file for _, files in arguments["data_files"] for file in files}
    wanted = {
        str(path.relative_to(REPOSITORY))
        for folder in ("config", "launch")
        for path in (REPOSITORY / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert shared == wanted | {"package.xml", "resource/imgu_ros"}


def test_ros_finds_the_command_and_the_package(arguments: dict[str, Any]) -> None:
    setup_cfg = (REPOSITORY / "setup.cfg").read_text()
    assert "[develop]\nscript_dir=$base/lib/imgu_ros\n" in setup_cfg
    assert "[install]\ninstall_scripts=$base/lib/imgu_ros\n" in setup_cfg
    assert ("share/ament_index/resource_index/packages", ["resource/imgu_ros"]) in arguments["data_files"]


def test_command_exists(arguments: dict[str, Any]) -> None:
    (script,) = arguments["entry_points"]["console_scripts"]
    name, module, function = re.fullmatch(r"(\w+) = ([\w.]+):(\w+)", script).groups()
    assert name == "imgu"
    assert callable(getattr(importlib.import_module(module), function))


def test_imports_are_declared(arguments: dict[str, Any], manifest: ElementTree.Element) -> None:
    required = {canonicalize_name(Requirement(line).name) for line in arguments["install_requires"]}
    keys = {item.text for item in manifest.findall("exec_depend")}
    used = imported_roots(PACKAGE) - OPTIONAL.keys()
    for extra, name, _ in OPTIONAL.values():
        assert name in {canonicalize_name(Requirement(line).name) for line in arguments["extras_require"][extra]}
    third_party = used & DISTRIBUTIONS.keys()
    assert {DISTRIBUTIONS[root][0] for root in third_party} == required
    rosdep_keys = {DISTRIBUTIONS[root][1] for root in third_party} - {""}
    assert rosdep_keys == {key for key in keys if key.startswith("python3-")}
    # What is no library from pip must be a ROS package, declared under its own name.
    imported = (used - third_party) | imported_roots(REPOSITORY / "launch")
    assert imported | message_packages(PACKAGE) == keys - rosdep_keys


@pytest.mark.parametrize(("file", "python"), [(file, python) for file in CONSTRAINTS for python in PYTHONS[file]])
def test_everything_is_pinned(arguments: dict[str, Any], file: str, python: str) -> None:
    pinned = pins(file, python)
    extras = [line for name in LOCKED_EXTRAS[file] for line in arguments["extras_require"][name]]
    for line in ["setuptools", *arguments["install_requires"], *extras]:
        wanted = Requirement(line)
        if wanted.marker and not wanted.marker.evaluate({"python_version": python}):
            continue
        version = pinned.get(canonicalize_name(wanted.name))
        assert version, f"{file}: {wanted.name} is not pinned for Python {python}"
        assert version in wanted.specifier, f"{file}: {wanted.name}=={version}; setup.py needs {wanted.specifier}"


def test_every_optional_dependency_is_locked(arguments: dict[str, Any]) -> None:
    assert set(arguments["extras_require"]) == set(LOCKED_EXTRAS["constraints.txt"])


@pytest.mark.parametrize("machine", ["x86_64", "aarch64"])
@pytest.mark.parametrize("file", CONSTRAINTS)
@pytest.mark.parametrize("extra", ["", "ros", "test"])
def test_dependencies_of_dependencies_are_locked(
    arguments: dict[str, Any], file: str, extra: str, machine: str
) -> None:
    # No more than what is installed can be looked at, on its own Python.
    if f"{sys.version_info[0]}.{sys.version_info[1]}" not in PYTHONS[file]:
        pytest.skip(f"{file} is not for this Python")
    needed = [*arguments["install_requires"], *arguments["extras_require"].get(extra, [])]
    names = ("imgu_ros", extra) if extra else ("imgu_ros",)
    found = pins(file, f"{sys.version_info[0]}.{sys.version_info[1]}", *names).keys() - {"setuptools"}
    wanted = set(closure(needed, {"platform_machine": machine})) - {"setuptools"}
    assert wanted - found == set()
    # Without ROS nothing of ROS is installed.
    assert (extra == "ros") == any(name.startswith("ros-") for name in found)


def closure(requirements: list[str], environment: dict[str, str]) -> Iterator[str]:
    """Yield the names of all that is needed, as far as it is installed here, by the distributions' own metadata."""
    queue, seen = [Requirement(line) for line in requirements], set()
    while queue:
        item = queue.pop()
        if (item.name, *sorted(item.extras)) in seen:
            continue
        seen.add((item.name, *sorted(item.extras)))
        yield canonicalize_name(item.name)
        try:
            lines = metadata.requires(item.name) or []
        except metadata.PackageNotFoundError:
            continue
        for child in map(Requirement, lines):
            marker = child.marker
            if marker is None or any(marker.evaluate({**environment, "extra": extra}) for extra in ["", *item.extras]):
                queue.append(child)


def test_jazzy_pins_are_those_of_ubuntu() -> None:
    for python in PYTHONS["constraints-jazzy.txt"]:
        pinned = pins("constraints-jazzy.txt", python)
        assert (pinned["opencv-python-headless"], pinned["numpy"]) == ("4.6.0.66", "1.26.4")


BLOCKED_IMPORTS = """
import importlib, pkgutil, sys

class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {blocked}:
            raise ModuleNotFoundError(f"No module named {{name!r}} (blocked)", name=name)

sys.meta_path.insert(0, Blocker())
import imgu_ros
for module in pkgutil.walk_packages(imgu_ros.__path__, "imgu_ros."):
    if not module.name.startswith({skipped!r}):
        importlib.import_module(module.name)
"""


def test_everything_but_the_nodes_imports_without_ros() -> None:
    blocked = ["rclpy", "builtin_interfaces", "sensor_msgs", "geometry_msgs", "std_msgs", "rcl_interfaces", "tf2_msgs"]
    skipped = ("imgu_ros.ros.", *(modules for _, _, modules in OPTIONAL.values()))
    code = BLOCKED_IMPORTS.format(blocked=[*blocked, *OPTIONAL], skipped=skipped)
    done = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


HEAVY = {"cv2", "jinja2", "matplotlib", "numpy", "rclpy", "rosbags", "scipy", "tqdm", "yaml"}


def test_help_loads_nothing_heavy() -> None:
    code = f"import sys; from imgu_ros.cli.main import main; main(['--help']); print({HEAVY} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "set()"
