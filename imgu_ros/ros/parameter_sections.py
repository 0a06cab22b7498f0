"""Finds parameter files that say nothing to a node: rclpy ignores them without a word."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import yaml


def files_without_section(ros_arguments: Sequence[str], node_name: str) -> list[str]:
    """Return a line for each given parameter file that has no section for the node.

    Parameters
    ----------
    ros_arguments : as given to rclpy, which has read them already: the files exist and are parameter files
    node_name : fully qualified, "/namespace/name"
    """
    lines = []
    for path in _parameter_files(ros_arguments):
        sections = list(_sections(yaml.safe_load(Path(path).read_text(encoding="utf-8"))))
        if not any(_applies(section, node_name) for section in sections):
            lines.append(f"{path}: sections for {', '.join(sections) or 'no node'}; need one for {node_name} or /**")
    return lines


def _parameter_files(arguments: Sequence[str]) -> Iterator[str]:
    following = iter(arguments)
    for argument in following:
        if argument == "--params-file":
            yield next(following, "")
        elif argument.startswith("--params-file="):
            yield argument.partition("=")[2]


def _sections(tree: Any, path: str = "") -> Iterator[str]:
    """Yield the names of the nodes that a parameter file speaks of, as patterns of full names."""
    if not isinstance(tree, dict):
        return
    for key, value in tree.items():
        if key == "ros__parameters":
            yield path
        else:
            name = str(key)
            yield from _sections(value, f"{path}{name}" if name.startswith("/") else f"{path}/{name}")


def _applies(section: str, node_name: str) -> bool:
    # rcl's wildcards: ** for any number of names, * for one.
    parts = [".*" if part == "**" else "[^/]+" if part == "*" else re.escape(part) for part in section.split("/")]
    return re.fullmatch("/".join(parts).replace("/.*", "(/.*)?"), node_name) is not None
