# SPDX-License-Identifier: Apache-2.0
"""Values of parameters: from given values to checked `Parameters`, and back."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, cast

from imgu_ros.config.checks import check_together
from imgu_ros.config.parameters import Declaration, Parameters, ParameterValue, declaration, declarations
from imgu_ros.errors import ParameterError, nearest_name

#: Choices reserved for later versions: refused with that reason.
RESERVED_CHOICES = {("reference", "keyframe"), ("reference", "rotation")}

#: ROS's integers have 64 bits.
_LARGEST_INTEGER = 2**63 - 1
_SHOWN_CHARACTERS = 80


def checked_value(name: str, value: object) -> ParameterValue:
    """Return `value` in the declared type of the parameter `name`.

    An integer serves as a double, a list or numpy array as an array, one value as an array of one, and None as an empty
    array (ROS gives no value for `[]`, which has no type there); the name of a frame loses leading slashes; nothing
    else is converted.

    Raises
    ------
    ParameterError
        If the name is unknown, or the value has another type or lies outside its range or choices.
    """
    known = declaration(name)
    if known.type_name.endswith("_array"):
        element = known.type_name.removesuffix("_array")
        if value is None or isinstance(value, bool | int | float | str):
            value = [] if value is None else [value]
        if not _is_list(value):
            raise ParameterError(f"{name}: {_shown(value)} ({type(value).__name__}); need a list of {element}s")
        items = list(cast("Iterable[object]", value))
        return tuple(_checked_scalar(f"{name}[{i}]", item, element, known) for i, item in enumerate(items))
    scalar = cast(ParameterValue, _checked_scalar(name, value, known.type_name, known))
    return scalar.lstrip("/") if known.is_frame and isinstance(scalar, str) else scalar


def is_empty_group(name: str, value: object) -> bool:
    """Return whether a name without a value is that of a group (`homography: {}`), which sets nothing."""
    return value is None and any(known.name.startswith(f"{name}.") for known in declarations())


def parameters_from(values: Mapping[str, object], base: Parameters | None = None) -> Parameters:
    """Return `base` (the defaults when None) with the named values replaced, all checked, one by one and together.

    Raises
    ------
    ParameterError
        As `checked_value`, and as `check_together`.
    """
    result = base or Parameters()
    for name, value in values.items():
        checked = checked_value(name, value)
        result = _replaced(result, name.split("."), checked)
    check_together(result)
    return result


def parameter_values(parameters: Parameters) -> dict[str, ParameterValue]:
    """Return every parameter's value by its full name, in the order of declaration."""
    values: dict[str, ParameterValue] = {}
    for known in declarations():
        value: Any = parameters
        for part in known.name.split("."):
            value = getattr(value, part)
        values[known.name] = value
    return values


def _checked_scalar(name: str, value: object, type_name: str, known: Declaration) -> Any:
    expected = {"bool": bool, "integer": int, "double": float, "string": str}[type_name]
    if isinstance(value, str):  # an enumeration's member
        value = str.__str__(value)
    elif getattr(value, "ndim", None) == 0 and hasattr(value, "item"):  # a numpy scalar
        value = value.item()
    if type_name == "double" and type(value) is int and abs(value) <= _LARGEST_INTEGER:
        value = float(value)
    if type(value) is not expected:
        # ROS tools write strings such as `on` or `1e3` without quotes, and read them as another type.
        quotes = ", in quotes" if type_name == "string" and isinstance(value, int | float) else ""
        raise ParameterError(f"{name}: {_shown(value)} ({type(value).__name__}); need {_article(type_name)}{quotes}")
    if known.choices and value not in known.choices:
        if (known.name, value) in RESERVED_CHOICES:
            raise ParameterError(
                f"{name}: {value!r} is reserved and not available in this version; need {_listed(known.choices)}"
            )
        near = nearest_name(value, known.choices)
        raise ParameterError(
            f"{name}: {_shown(value)}; need {_listed(known.choices)}" + (f" (nearest: {near})" if near else "")
        )
    if isinstance(value, int | float) and not isinstance(value, bool):
        low, high = known.bounds or (-math.inf, math.inf)
        if not low <= value <= high or value in (-math.inf, math.inf):
            unit = f" {known.unit}" if known.unit else ""
            raise ParameterError(f"{name}: {_shown(value)}; need {known.range_text or 'a finite number'}{unit}")
    return value


def _is_list(value: object) -> bool:
    if isinstance(value, str | bytes | bytearray | Mapping) or getattr(value, "ndim", 1) == 0:
        return False
    return hasattr(value, "__len__") and hasattr(value, "__getitem__")


def _shown(value: object) -> str:
    """Return a value for a message, on one line of limited length."""
    if isinstance(value, int) and abs(value) > _LARGEST_INTEGER:
        return f"an integer of {value.bit_length()} bits"
    text = " ".join(repr(value).split())
    return text if len(text) <= _SHOWN_CHARACTERS else text[:_SHOWN_CHARACTERS] + "..."


def _article(type_name: str) -> str:
    return {"bool": "true or false", "integer": "an integer", "double": "a number", "string": "a string"}[type_name]


def _listed(choices: tuple[str, ...]) -> str:
    return " or ".join(repr(c) for c in choices) if len(choices) < 3 else "one of " + ", ".join(choices)


def _replaced(group: Any, path: list[str], value: ParameterValue) -> Any:
    if len(path) > 1:
        return replace(group, **{path[0]: _replaced(getattr(group, path[0]), path[1:], value)})
    return replace(group, **{path[0]: value})
