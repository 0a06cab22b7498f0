# SPDX-License-Identifier: Apache-2.0
"""What of imgu_ros works on this machine, what is missing, and the line that mends it.

Exits 1 when the offline part does not work, or with --ros the live one.
"""

from __future__ import annotations

import argparse
import glob
import importlib
import os
import platform
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

from imgu_ros.cli.terminal import say
from imgu_ros.errors import ImguError

HELP = "what works on this machine, what is missing, and the line that mends it"

_OLDEST_PYTHON = (3, 11)


class Health(StrEnum):
    """How a part is."""

    OK = "ok"
    MISSING = "missing"  #: nothing is broken; something that was not asked for does not work
    BROKEN = "broken"


@dataclass(frozen=True, slots=True)
class Finding:
    """One part, how it is, and what mends it (empty when nothing is to be done)."""

    part: str
    health: Health
    text: str
    remedy: str = ""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--ros", action="store_true", help="exit 1 when live nodes do not work, too")
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(arguments: argparse.Namespace) -> int:
    """Look, and print what was found."""
    findings = [*_offline(), *_ros(), *_extras(), *_cameras()]
    if arguments.json:
        import dataclasses
        import json

        say(*json.dumps([dataclasses.asdict(one) for one in findings], indent=1).split("\n"))
    else:
        say(*lines(findings))
    needed = {"offline"} | ({"ros"} if arguments.ros else set())
    is_lacking = (Health.BROKEN, Health.MISSING) if arguments.ros else (Health.BROKEN,)
    return int(any(_group(one) in needed and one.health in is_lacking for one in findings))


def lines(findings: list[Finding]) -> Iterator[str]:
    """Yield the findings for people."""
    width = max(len(one.part) for one in findings)
    for one in findings:
        yield f"{one.health:<8} {one.part:<{width}}  {one.text}"
        if one.remedy:
            yield f"{'':<8} {'':<{width}}  -> {one.remedy}"


def _group(finding: Finding) -> str:
    return {"Python": "offline", "OpenCV": "offline", "libraries": "offline"}.get(
        finding.part, "ros" if finding.part in ("ROS 2", "messages", "images by DDS") else "beside"
    )


def _offline() -> Iterator[Finding]:
    from imgu_ros.report.versions import package_version

    version = platform.python_version()
    is_new = sys.version_info[:2] >= _OLDEST_PYTHON
    yield Finding(
        "Python", Health.OK if is_new else Health.BROKEN, f"{version}, imgu_ros {package_version()}",
        "" if is_new else "python3.12 -m venv .venv (3.11 or later)",
    )  # fmt: skip
    try:
        import cv2

        has_markers = hasattr(cv2, "aruco")
        yield Finding(
            "OpenCV", Health.OK if has_markers else Health.MISSING,
            f"{cv2.__version__}" + ("" if has_markers else ", without its aruco module: no markers"),
            "" if has_markers else "pip install --upgrade opencv-contrib-python-headless",
        )  # fmt: skip
    except ImportError as error:
        yield Finding("OpenCV", Health.BROKEN, str(error), "pip install opencv-python-headless")
    lacking = []
    for name in ("numpy", "scipy", "yaml", "rosbags", "lz4", "matplotlib", "jinja2", "tqdm", "PIL", "av"):
        try:
            importlib.import_module(name)
        except ImportError:
            lacking.append(name)
    # Without these the rest works: bags where ROS reads them, videos.
    health = Health.OK if not lacking else Health.MISSING if set(lacking) <= {"rosbags", "av"} else Health.BROKEN
    text = f"cannot be imported: {', '.join(lacking)}" if lacking else "all there"
    names = {"yaml": "pyyaml", "PIL": "pillow"}
    remedy = f"pip install {' '.join(names.get(name, name) for name in lacking)}" if lacking else ""
    yield Finding("libraries", health, text, remedy)


def _ros() -> Iterator[Finding]:
    try:
        from imgu_ros.ros.middleware import require_room_to_start, set_profile

        require_room_to_start()
        set_profile()
        importlib.import_module("imgu_ros.ros.transport_probe")
    except ImguError as error:
        yield Finding("ROS 2", Health.BROKEN, str(error))
        return
    except ImportError as error:
        known = f"rclpy cannot be imported ({error})" if os.environ.get("ROS_DISTRO") else "not installed"
        remedy = "source /opt/ros/jazzy/setup.bash"
        if not os.path.isdir("/opt/ros/jazzy"):
            remedy = 'pip install ".[ros]" in the source folder of imgu_ros (x86-64; elsewhere ROS 2 Jazzy by apt)'
        yield Finding("ROS 2", Health.MISSING, f"{known}: no live nodes; replay needs none", remedy)
        return
    from imgu_ros.ros.reach import confinement

    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    where = f"domain {domain}, {confinement() or 'this machine and its network'}"
    middleware = os.environ.get("RMW_IMPLEMENTATION") or "rmw_fastrtps_cpp"
    yield Finding("ROS 2", Health.OK, f"{os.environ.get('ROS_DISTRO') or 'rclpy'}, {middleware}, {where}")
    yield _messages()
    yield _transport()


def _messages() -> Finding:
    from imgu_ros.ros.messages import is_installed

    wanted = {
        "tf2_msgs": ("tf2_msgs/msg/TFMessage", "publish_tf"),
        "foxglove_msgs": ("foxglove_msgs/msg/ImageAnnotations", "annotations"),
        "vision_msgs": ("vision_msgs/msg/Detection2DArray", "detections"),
    }
    lacking = {name: use for name, (kind, use) in wanted.items() if not is_installed(kind)}
    if not lacking:
        return Finding("messages", Health.OK, "all there")
    named = ", ".join(f"{name} ({use})" for name, use in lacking.items())
    packages = " ".join(f"ros-jazzy-{name.replace('_', '-')}" for name in lacking)
    return Finding(
        "optional messages",
        Health.MISSING,
        f"not installed: {named}",
        f"sudo apt install {packages}, where ROS 2 comes from apt",
    )


def _transport() -> Finding:
    from imgu_ros.ros.middleware import against_loss, full_memory, profile_line
    from imgu_ros.ros.transport_probe import probe_transport

    full = full_memory()
    if full:
        return Finding("images by DDS", Health.BROKEN, full)
    transport = probe_transport()
    said = f"{transport.received} of {transport.sent} images of {transport.megabytes:.1f} MB arrived; {profile_line()}"
    if transport.received == transport.sent:
        return Finding("images by DDS", Health.OK, said)
    remedy = against_loss() if transport.received else "unset ROS_AUTOMATIC_DISCOVERY_RANGE ROS_STATIC_PEERS"
    return Finding("images by DDS", Health.BROKEN, said, remedy)


def _extras() -> Iterator[Finding]:
    for part, module, use, extra in (
        ("viewer", "rerun", "imgu view", 'pip install ".[view]" in the source folder of imgu_ros'),
        ("completion", "shtab", "imgu --print-completion", "pip install shtab"),
    ):
        try:
            importlib.import_module(module)
        except ImportError:
            yield Finding(part, Health.MISSING, f"{module} is not installed: no {use}", extra)
        else:
            yield Finding(part, Health.OK, f"{module} for {use}")


def _cameras() -> Iterator[Finding]:
    devices = sorted(glob.glob("/dev/video*"))
    readable = [name for name in devices if os.access(name, os.R_OK | os.W_OK)]
    if readable:
        yield Finding("webcams", Health.OK, f"{', '.join(readable)} for imgu camera")
    elif devices:
        text = f"{', '.join(devices)} cannot be opened by this user"
        yield Finding("webcams", Health.MISSING, text, "sudo usermod -aG video $USER, then log in again")
    else:
        yield Finding("webcams", Health.MISSING, "none; imgu camera also publishes videos and pictures")
