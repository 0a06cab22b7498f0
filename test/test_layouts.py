# SPDX-License-Identifier: Apache-2.0
"""Layouts of RViz and Foxglove: they can be read, and speak of topics that the node has, of the types they show."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from imgu_ros.messages.results import OUTPUTS

CONFIG = Path(__file__).resolve().parent.parent / "config"
TOPICS = {
    **{row.name: row.type_name for row in OUTPUTS},
    "diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}


def test_rviz() -> None:
    manager = yaml.safe_load((CONFIG / "perception.rviz").read_text())["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "map"
    shown = {}
    for display in manager["Displays"]:
        kind = display["Class"].removeprefix("rviz_default_plugins/")
        assert kind in ("Grid", "TF", "Odometry", "Path", "Image", "MarkerArray")
        if "Topic" in display:
            topic = display["Topic"]
            assert TOPICS[topic["Value"]].rpartition("/")[2] == kind
            assert topic["Reliability Policy"] in ("Reliable", "Best Effort")
            shown[topic["Value"]] = display["Enabled"]
    assert shown == {
        "odom": True, "path": True, "map/odom": False, "map/path": False, "debug_image": True, "markers": True,
    }  # fmt: skip


def strings(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        for key, item in value.items():
            yield key
            yield from strings(item)
    elif isinstance(value, list):
        for item in value:
            yield from strings(item)
    elif isinstance(value, str):
        yield value


def panels(layout: Any) -> Iterator[str]:
    if isinstance(layout, str):
        yield layout
    else:
        assert layout["direction"] in ("row", "column")
        yield from panels(layout["first"])
        yield from panels(layout["second"])


def test_foxglove() -> None:
    layout = json.loads((CONFIG / "perception.foxglove.json").read_text())
    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])
    topics = {match[1] for text in strings(layout["configById"]) if (match := re.match(r"/([a-z_/]+)", text))}
    assert (
        {"odom", "map/odom", "image_color/compressed", "annotations", "markers", "camera_info"}
        <= topics
        <= TOPICS.keys()
    )
