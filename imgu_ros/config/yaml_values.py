# SPDX-License-Identifier: Apache-2.0
"""Scalars of YAML with the types of rcl's parser, which are not those of PyYAML.

`1e-3` is a double, `010` the integer 8 and `null` a string. Source: `get_value` of rcl_yaml_param_parser (ROS 2 Jazzy),
which uses C's strtoll and strtod.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import yaml

from imgu_ros.errors import ParameterError

#: rcl uses libyaml, and so does PyYAML where it was built with it; its own parser accepts nearly the same.
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_TRUE = frozenset(("Y", "y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON"))
_FALSE = frozenset(("N", "n", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF"))
#: Longer texts are not taken for numbers: the conversion takes time quadratic in their length.
_LONGEST_NUMBER = 1000
_STRING_TAG = "tag:yaml.org,2002:str"
#: What C's isspace accepts: strtoll and strtod skip it before a number.
_SPACE = " \t\n\v\f\r"
_INTEGER = re.compile(r"[+-]?(0[xX][0-9a-fA-F]+|[0-9]+)")
_DECIMAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_HEXADECIMAL = re.compile(r"[+-]?0[xX](?P<whole>[0-9a-fA-F]*)\.?(?P<part>[0-9a-fA-F]*)([pP](?P<power>[+-]?[0-9]+))?")
_NAMED = re.compile(r"[+-]?(inf(inity)?|nan(\([0-9a-zA-Z_]*\))?)", re.IGNORECASE)
#: YAML's own names of infinity, which C does not know.
_INFINITIES = (".inf", ".Inf", ".INF")
_YAML_NAMES = frozenset((".nan", ".NaN", ".NAN", *(sign + name for sign in ("", "+", "-") for name in _INFINITIES)))


def scalar_value(event: yaml.ScalarEvent) -> bool | int | float | str:
    """Return a scalar's value with rcl's type: bool, 64-bit int, float, or the text itself."""
    text = str(event.value).partition("\0")[0]  # a C string ends there
    if event.tag == _STRING_TAG or event.style in ("'", '"'):
        return text
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    number = text.lstrip(_SPACE)
    if len(number) > _LONGEST_NUMBER:
        return text
    value: int | float | None = _integer(number)
    if value is None:
        value = _double(number)
    return text if value is None else value


def yaml_events(data: bytes, source: str) -> Iterator[yaml.Event]:
    """Yield the events of a YAML text in UTF-8, or UTF-16 with a byte order mark; ParameterError if it is not YAML."""
    if not data.startswith((b"\xff\xfe", b"\xfe\xff")):
        try:
            data.decode("utf-8")
        except UnicodeDecodeError as error:
            line = data[: error.start].count(b"\n") + 1
            byte = data[error.start]
            raise ParameterError(
                f"{source}: line {line}: byte 0x{byte:02X} is not UTF-8; need a text in UTF-8"
            ) from None
    try:
        yield from yaml.parse(data, _LOADER)
    except yaml.MarkedYAMLError as error:
        line_text = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise ParameterError(f"{source}: {line_text}{' '.join(str(error.problem).split())}; need valid YAML") from None
    except (yaml.YAMLError, ValueError) as error:
        raise ParameterError(f"{source}: {' '.join(str(error).split())[:120]}; need valid YAML") from None


def _integer(text: str) -> int | None:
    """Parse as strtoll with base 0: 0x is hexadecimal, a leading 0 octal; None: no integer, or more than 64 bits."""
    if not _INTEGER.fullmatch(text):
        return None
    digits = text.lstrip("+-")
    base = 16 if digits[:2] in ("0x", "0X") else 8 if len(digits) > 1 and digits[0] == "0" else 10
    try:
        value = int(text, base)
    except ValueError:  # 08, or thousands of digits
        return None
    return value if -(2**63) <= value < 2**63 else None


def _double(text: str) -> float | None:
    """Parse as strtod does; None: no number, too large, or so small that digits get lost."""
    if text in _YAML_NAMES:
        return float(text.replace(".", ""))
    if _NAMED.fullmatch(text):
        return float(text.partition("(")[0])
    hexadecimal = _HEXADECIMAL.fullmatch(text)
    if hexadecimal and (hexadecimal["whole"] or hexadecimal["part"]):
        return _hexadecimal(text, hexadecimal)
    if not _DECIMAL.fullmatch(text):
        return None
    value = float(text)
    if math.isinf(value):
        return None
    if value == 0.0:
        return value if not re.search("[1-9]", re.split("[eE]", text)[0]) else None
    if abs(value) < sys.float_info.min:
        try:
            return value if Fraction(text) == Fraction(value) else None
        except ValueError:  # thousands of digits
            return None
    return value


def _hexadecimal(text: str, parts: re.Match[str]) -> float | None:
    try:
        value = float.fromhex(text)
    except (OverflowError, ValueError):
        return None
    digits = (parts["whole"] + parts["part"]).lstrip("0")
    if value == 0.0:
        return None if digits else value
    if abs(value) < sys.float_info.min:
        exact = Fraction(int(digits, 16)) * Fraction(2) ** (int(parts["power"] or 0) - 4 * len(parts["part"]))
        return value if exact == abs(Fraction(value)) else None
    return value
