"""YAML values with the meanings that rcl's parameter parser gives them, which are not PyYAML's.

`1e-3` is a number and `null` a text; a list holds scalars of one type; there are no aliases. Source:
rcl_yaml_param_parser of ROS 2 Jazzy.
"""

from __future__ import annotations

import math
import re

import yaml

from imgu_ros.errors import ParameterError

_TRUE = frozenset(("Y", "y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON"))
_FALSE = frozenset(("N", "n", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF"))
_INTEGER = re.compile(r"[+-]?(0[xX][0-9a-fA-F]+|[0-9]+)")
_FLOAT = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_HEX_FLOAT = re.compile(r"[+-]?0[xX]([0-9a-fA-F]+\.?[0-9a-fA-F]*|\.[0-9a-fA-F]+)([pP][+-]?[0-9]+)?")
_SPECIAL = {".nan": "nan", ".NaN": "nan", ".NAN": "nan", ".inf": "inf", ".Inf": "inf", ".INF": "inf"}


def parsed_yaml(text: str, name: str) -> yaml.Node | None:
    """Return the tree of a YAML text; None when it is empty.

    Raises
    ------
    ParameterError
        If it is no YAML, or uses aliases; `name` says where.
    """
    try:
        has_alias = any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, yaml.SafeLoader))
        tree = None if has_alias else yaml.compose(text, yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise ParameterError(f"{name}: {line}{' '.join(str(error.problem).split())}; need valid YAML") from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ParameterError(f"{name}: {' '.join(str(error).split())[:120]}; need valid YAML") from None
    if has_alias:
        raise ParameterError(f"{name}: has YAML aliases, which ROS 2 does not read; need plain values")
    return tree


def parsed_value(text: str, name: str) -> object:
    """Return the value of a YAML text: bool, int, float, str, or a list of one of them; ParameterError otherwise."""
    node = parsed_yaml(text, name)
    if node is None:
        raise ParameterError(f"{name}: no value; need one")
    return plain_value(node, name)


def plain_value(node: yaml.Node, name: str) -> object:
    """Return the value of a YAML node, as `parsed_value`."""
    if isinstance(node, yaml.ScalarNode):
        return _scalar(node, name)
    if not isinstance(node, yaml.SequenceNode):
        raise ParameterError(f"{name}: holds names; need a value or a list of values")
    values: list[object] = []
    for item in node.value:
        if not isinstance(item, yaml.ScalarNode):
            raise ParameterError(f"{name}: a list in a list; need a list of values")
        values.append(_scalar(item, name))
    kinds = list(dict.fromkeys(type(value).__name__ for value in values))
    if len(kinds) > 1:
        hint = " (write 1.0, not 1)" if set(kinds) == {"int", "float"} else ""
        raise ParameterError(f"{name}: a list of {' and '.join(kinds)}; need values of one type{hint}")
    return values


def _scalar(node: yaml.ScalarNode, name: str) -> object:
    text: str = node.value
    if node.style is not None or (node.tag.endswith(":str") and not _is_plain(node)):
        return text
    if text == "":
        raise ParameterError(f"{name}: no value; need one")
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    if _INTEGER.fullmatch(text):
        return _integer(text)
    return _float_or_text(text)


def _float_or_text(text: str) -> float | str:
    """Parse as C's strtod, which leaves what is too large to be a text."""
    unsigned = text.lstrip("+-")
    if len(text) - len(unsigned) > 1:
        return text
    if unsigned in _SPECIAL:
        return float(text.replace(unsigned, _SPECIAL[unsigned]))
    if unsigned.lower() in ("inf", "infinity", "nan"):
        return float(text)
    try:
        if _FLOAT.fullmatch(text):
            value = float(text)
            return text if math.isinf(value) else value
        return float.fromhex(text) if _HEX_FLOAT.fullmatch(text) else text
    except OverflowError:
        return text


def _is_plain(node: yaml.ScalarNode) -> bool:
    """Whether the text is written without quotes and without a tag (`!!str 1`)."""
    mark = node.start_mark
    return mark.buffer is None or not mark.buffer[mark.pointer :].startswith("!")


def _integer(text: str) -> int | float:
    """Parse as C's strtol with base 0: 0x is hexadecimal, a leading 0 octal; what it refuses is left to strtod."""
    digits = text.lstrip("+-")
    base = 16 if digits[:2] in ("0x", "0X") else 8 if len(digits) > 1 and digits[0] == "0" else 10
    try:
        value = int(text, base)
    except ValueError:  # 08
        return float(text)
    return value if -(2**63) <= value < 2**63 else float(value)
