"""ROS 2 parameter files and overrides, read as rcl reads them, without ROS."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import yaml

from imgu_ros.errors import FileError, ParameterError
from imgu_ros.files.yaml_values import parsed_value, parsed_yaml, plain_value
from imgu_ros.parameter_values import checked_value
from imgu_ros.params import Declaration, declarations

_MAX_BYTES = 2**22
_SECTION = "ros__parameters"
#: Parameters that every ROS 2 node has by itself; without ROS they mean nothing.
_OF_EVERY_NODE = re.compile(r"use_sim_time|start_type_description_service|qos_overrides\..*")


def read_parameter_file(path: Path | str, node_name: str = "perception") -> dict[str, object]:
    """Return the values that a ROS 2 parameter file gives to a node, by full name ("homography.threshold_px").

    Sections for all nodes (`/**`) come first, then those of the node's own name. Other nodes' sections do not count.

    Parameters
    ----------
    path : the YAML file
    node_name : with or without namespace

    Raises
    ------
    FileError
        If the file cannot be read.
    ParameterError
        If it is no YAML, has no section for the node, or a parameter is unknown (the nearest known one is named), of
        the wrong type, or out of range.
    """
    path = Path(path)
    root = parsed_yaml(_text(path), str(path))
    if not isinstance(root, yaml.MappingNode):
        raise ParameterError(f"{path}: no sections; need '/**:' or '{node_name}:' with '{_SECTION}:' in it")
    values: dict[str, object] = {}
    for section in _sections_of(root, path, node_name):
        for name, node in _flattened(section, "", path):
            if _OF_EVERY_NODE.fullmatch(name):
                continue
            value = plain_value(node, f"{path}: {name}")
            try:
                values[name] = checked_value(name, value)
            except ParameterError as error:
                raise ParameterError(f"{path}: {error}") from None
    return values


def parse_override(text: str) -> tuple[str, object]:
    """Return name and value of "name:=value"; the value is YAML with ROS 2's meanings.

    Raises
    ------
    ParameterError
        If there is no ":=", no name, no value, or the value is neither a scalar nor a list of scalars.
    """
    name, separator, value = text.partition(":=")
    if not separator or not name.strip():
        raise ParameterError(f"{text!r}: no parameter name and value; need NAME:=VALUE")
    return name.strip(), parsed_value(value, name.strip())


def parameter_file_text(values: Mapping[str, object] | None = None, names: Collection[str] | None = None) -> str:
    """Return a parameter file with every parameter and its description.

    Parameters
    ----------
    values : instead of the defaults, by full name
    names : only these parameters, by full name; None: all

    ROS 2 cannot tell the type of an empty list: such parameters are commented out.
    """
    lines = ["# Parameters of imgu_ros. A line left out keeps its default.", "/**:", f"  {_SECTION}:"]
    groups: tuple[str, ...] = ()
    for known in declarations():
        if names is not None and known.name not in names:
            continue
        *parents, leaf = known.name.split(".")
        for depth, group in enumerate(parents):
            if groups[: depth + 1] != tuple(parents[: depth + 1]):
                lines.append(f"{_indent(depth)}{group}:")
        groups = tuple(parents)
        value = (values or {}).get(known.name, known.default)
        lines.append(f"{_indent(len(parents))}# {_comment(known)}")
        is_empty_list = isinstance(value, list | tuple) and not value
        lines.append(f"{_indent(len(parents))}{'# ' if is_empty_list else ''}{leaf}: {_yaml(value)}")
    return _without_empty_groups(lines)


def _text(path: Path) -> str:
    try:
        if path.is_file() and path.stat().st_size > _MAX_BYTES:
            raise FileError(f"{path}: {path.stat().st_size} bytes; need a parameter file")
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise FileError(f"{path}: {error.strerror}; need a parameter file") from None
    except UnicodeDecodeError:
        raise ParameterError(f"{path}: not a text file; need a YAML parameter file") from None


def _sections_of(root: yaml.MappingNode, path: Path, node_name: str) -> list[yaml.MappingNode]:
    """Return the sections for the node: wildcards first, then its own."""
    found = list(_sections(root, "", path))
    full_name = "/" + node_name.strip("/")
    wild = [node for name, node in found if "*" in name and _pattern(name).fullmatch(full_name)]
    own = [(name, node) for name, node in found if "*" not in name and name == full_name]
    if not own and "/" not in node_name.strip("/"):
        # Without ROS there is no namespace: the section of the only node of this name will be meant.
        own = [
            (name, node) for name, node in found if "*" not in name and name.rpartition("/")[2] == node_name.strip("/")
        ]
        if len({name for name, _ in own}) > 1:
            names = ", ".join(sorted({name for name, _ in own}))
            raise ParameterError(f"{path}: several sections for node {node_name!r} ({names}); need one")
    if not wild and not own:
        names = ", ".join(name for name, _ in found) or "none"
        need = f"'/**:' or '{node_name}:' with '{_SECTION}:' in it"
        raise ParameterError(f"{path}: no section for node {node_name!r} (found: {names}); need {need}")
    return [*wild, *(node for _, node in own)]


def _sections(node: yaml.MappingNode, prefix: str, path: Path) -> Iterator[tuple[str, yaml.MappingNode]]:
    """Yield each node's full name (or pattern) and its parameters."""
    for key, value in node.value:
        name = str(key.value)
        if name == _SECTION:
            if not prefix:
                raise ParameterError(f"{path}: '{_SECTION}:' outside of a node's section; need '/**:' above it")
            if isinstance(value, yaml.MappingNode):
                yield prefix, value
            elif value.value != "":
                raise ParameterError(f"{path}: {prefix}: '{_SECTION}:' holds no names; need NAME: VALUE lines")
        elif isinstance(value, yaml.MappingNode):
            yield from _sections(value, f"{prefix}/{name.strip('/')}", path)


def _pattern(name: str) -> re.Pattern[str]:
    """Return the expression for a name with rcl's wildcards: `*` is one token, `**` any number of them."""
    tokens = {"**": r"(/\w+)*", "*": r"/\w+"}
    return re.compile("".join(tokens.get(token, "/" + re.escape(token)) for token in name.strip("/").split("/")))


def _flattened(node: yaml.MappingNode, prefix: str, path: Path) -> Iterator[tuple[str, yaml.Node]]:
    for key, value in node.value:
        if not isinstance(key, yaml.ScalarNode) or not key.value:
            raise ParameterError(f"{path}: line {key.start_mark.line + 1}: a name is no text; need NAME: VALUE")
        name = f"{prefix}{key.value}"
        if isinstance(value, yaml.MappingNode):
            yield from _flattened(value, f"{name}.", path)
        else:
            yield name, value


def _indent(depth: int) -> str:
    return "    " + "  " * depth


def _comment(known: Declaration) -> str:
    facts = [known.type_name]
    if known.unit:
        facts.append(known.unit)
    if known.choices:
        facts.append(" | ".join(known.choices))
    if known.minimum is not None or known.maximum is not None:
        facts.append(f"{_bound(known.minimum)} to {_bound(known.maximum)}".strip())
    if known.read_only:
        facts.append("read-only")
    return f"{known.description} [{', '.join(facts)}]"


def _bound(value: float | None) -> str:
    return "" if value is None else str(int(value)) if float(value).is_integer() else repr(value)


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
