# SPDX-License-Identifier: Apache-2.0
"""ROS 2 parameter files and overrides, read without ROS as rcl reads them; parameter files written."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from imgu_ros.config.parameters import Declaration, LimitsParameters, declaration, declarations
from imgu_ros.config.rcl_parameters import SECTION, RclParameters, section_applies, with_slash
from imgu_ros.config.values import checked_value, is_empty_group
from imgu_ros.errors import ParameterError
from imgu_ros.file_access.bounded_reading import file_bytes

#: Parameters of every ROS 2 node; they have no meaning without ROS.
_OF_EVERY_NODE = re.compile(r"use_sim_time|start_type_description_service|qos_overrides\..*")


def read_parameter_file(path: Path | str, node_name: str = "perception") -> dict[str, object]:
    """Return the values that a ROS 2 parameter file gives to a node, by full name ("homography.threshold_px").

    Parameters
    ----------
    path : the YAML file
    node_name : with or without namespace

    Raises
    ------
    FileError
        If the file cannot be read.
    ParameterError
        If it is not YAML, has no section for the node, or a parameter is unknown (the nearest known one is named), of
        the wrong type, or out of range.
    """
    given = GivenParameters(node_name)
    given.add_file(path)
    return given.values()


class GivenParameters:
    """The parameter files and overrides of one command line, combined as ROS 2 combines them for a live node.

    Parameters
    ----------
    node_name : with or without namespace. Without ROS there is no namespace: in a file without a section of exactly
        this name, the section of its only node of this name in any namespace is read
    """

    def __init__(self, node_name: str = "perception") -> None:
        self._name = node_name.strip("/")
        self._given = RclParameters()
        self._in_namespace: set[str] = set()

    def add_file(self, path: Path | str) -> None:
        """Add a parameter file; FileError or ParameterError if it cannot be used."""
        path = Path(path)
        sections = list(dict.fromkeys(self._given.add_file(parameter_file_bytes(path), str(path))))
        if any(section_applies(section, f"/{self._name}") for section in sections if "*" not in section):
            return
        others = [section for section in sections if "/" not in self._name and section.endswith(f"/{self._name}")]
        same = [section for section in others if "*" not in section]
        if len(same) > 1:
            raise ParameterError(f"{path}: several sections for node {self._name!r} ({', '.join(same)}); need one")
        self._in_namespace.update(same)
        if not any(map(self._applies, sections)):
            names = ", ".join(sections) or "none"
            need = f"'/**:' or '{self._name}:' with '{SECTION}:' in it"
            raise ParameterError(f"{path}: no section for node {self._name!r} (found: {names}); need {need}")

    def add_override(self, text: str) -> str:
        """Add "NAME:=VALUE" and return the name; ParameterError if it cannot be parsed."""
        return self._given.add_override(text)

    def values(self) -> dict[str, object]:
        """Return the checked values by full name, without the parameters of every ROS 2 node.

        Raises
        ------
        ParameterError
            If a parameter is unknown, of the wrong type, or out of range.
        """
        values: dict[str, object] = {}
        for name, entry in self._given.entries(self._applies).items():
            if _OF_EVERY_NODE.fullmatch(name) or is_empty_group(name, entry.value):
                continue
            try:
                values[name] = checked_value(name, entry.value)
            except ParameterError as error:
                raise ParameterError(f"{entry.source}: {error}" if entry.source else str(error)) from None
        return values

    def warnings(self) -> list[str]:
        """Return a line for each parameter whose value in force is not the one given last."""
        return self._given.overruled(self._applies)

    def _applies(self, section: str) -> bool:
        section = with_slash(section)
        return section in self._in_namespace or section_applies(section, f"/{self._name}")


def parameter_file_bytes(path: Path | str) -> bytes:
    """Return a parameter file's content; FileError if it cannot be read or is too large to be one."""
    most = LimitsParameters().text_mb
    return file_bytes(Path(path), f"a parameter file of at most {most} MB", 1_000_000 * most)


def parameter_file_text(
    values: Mapping[str, object] | None = None, names: Iterable[str] | None = None, *, empty_lists: bool = False
) -> str:
    """Return a parameter file with every parameter and its description.

    Parameters
    ----------
    values : instead of the defaults, by full name
    names : only these parameters, by full name and in this order, those of a group together; None: all
    empty_lists : write `[]`; else such parameters are commented out: ROS 2 cannot tell the type of an empty list, and
        nodes of others may refuse it
    """
    lines = ["# Parameters of imgu_ros. A line left out keeps its default.", "/**:", f"  {SECTION}:"]
    groups: tuple[str, ...] = ()
    for known in declarations() if names is None else map(declaration, names):
        *parents, leaf = known.name.split(".")
        for depth, group in enumerate(parents):
            if groups[: depth + 1] != tuple(parents[: depth + 1]):
                lines.append(f"{_indent(depth)}{group}:")
        groups = tuple(parents)
        value = (values or {}).get(known.name, known.default)
        lines.append(f"{_indent(len(parents))}# {_comment(known)}")
        is_empty_list = isinstance(value, list | tuple) and not value
        lines.append(
            f"{_indent(len(parents))}{'# ' if is_empty_list and not empty_lists else ''}{leaf}: {_yaml(value)}"
        )
    return _without_empty_groups(lines)


def _indent(depth: int) -> str:
    return "    " + "  " * depth


def _comment(known: Declaration) -> str:
    facts = [known.type_name]
    if known.unit:
        facts.append(known.unit)
    if known.choices:
        facts.append(" | ".join(known.choices))
    if known.bounds:
        facts.append(known.range_text)
    if known.read_only:
        facts.append("read-only")
    return f"{known.description} [{', '.join(facts)}]"


def _yaml(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        text = repr(value)
        return text if "." in text or "e" not in text else text.replace("e", ".0e")
    if isinstance(value, list | tuple):
        return f"[{', '.join(_yaml(item) for item in value)}]"
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
        return f'"{escaped}"'
    return str(value)


def _without_empty_groups(lines: list[str]) -> str:
    """Comment out a group all of whose parameters are: a name without a value is an error in ROS 2."""
    result: list[str] = []
    for i, line in enumerate(lines):
        depth = len(line) - len(line.lstrip())
        if i > 2 and line.endswith(":") and not line.lstrip().startswith("#"):
            inside = []
            for other in lines[i + 1 :]:
                if len(other) - len(other.lstrip()) <= depth:
                    break
                inside.append(other)
            if all(other.lstrip().startswith("#") for other in inside):
                line = f"{' ' * depth}# {line.lstrip()}"
        result.append(line)
    return "\n".join(result) + "\n"
