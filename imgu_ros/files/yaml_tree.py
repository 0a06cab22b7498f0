# SPDX-License-Identifier: Apache-2.0
"""YAML that somebody else wrote as a tree of texts, at a cost that its aliases and nesting do not decide."""

from __future__ import annotations

from typing import Any

import yaml

from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters

#: libyaml where PyYAML was built with it.
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_DEEPEST = 100
#: What a value counts beside its text, bytes: a million of them take a few seconds.
_VALUE = 4
_NULLS = frozenset(("", "~", "null", "Null", "NULL"))
_NO_KEY = object()


def yaml_tree(text: str, limits: LimitsParameters = DEFAULT_LIMITS) -> Any:
    """Return the first document of a YAML text as dictionaries, lists and texts; None for what is empty.

    Tags mean nothing, and numbers stay text: whoever needs one knows how long it may be. Of keys that come twice the
    last counts; `<<` is a key like others, as in OpenCV and in yaml-cpp.

    Parameters
    ----------
    text : the YAML
    limits : `text_mb` bounds its values, 4 bytes and their text each, those that an alias repeats counted again

    Raises
    ------
    yaml.YAMLError
        If it is no YAML.
    ValueError
        If it is larger than that, nested more than 100 deep, or has a key that is no text.
    """
    builder = _Builder(1_000_000 * limits.text_mb)
    for event in yaml.parse(text, _LOADER):
        builder.take(event)
        if builder.is_complete:
            break
    return builder.root


class _Builder:
    """Builds the first document from events."""

    def __init__(self, most: int) -> None:
        self.root: Any = None
        self.is_complete = False
        self._most = most
        #: Open lists and dictionaries, each with the key that waits for its value, its anchor and its size.
        self._open: list[list[Any]] = []
        self._anchors: dict[str, tuple[Any, int]] = {}

    def take(self, event: yaml.Event) -> None:
        match event:
            case yaml.ScalarEvent():
                plain = event.implicit[0] and event.style not in ("'", '"')
                value = None if plain and event.value in _NULLS else str(event.value)
                self._put(value, len(event.value) + _VALUE, event.anchor)
            case yaml.SequenceStartEvent():
                self._begin([], event.anchor)
            case yaml.MappingStartEvent():
                self._begin({}, event.anchor)
            case yaml.SequenceEndEvent() | yaml.MappingEndEvent():
                container, _, anchor, size = self._open.pop()
                self._put(container, size, anchor)
            case yaml.AliasEvent():
                anchor = str(event.anchor)
                if anchor not in self._anchors:
                    mark: Any = event.start_mark
                    raise yaml.MarkedYAMLError(problem=f"undefined alias {anchor[:40]}", problem_mark=mark)
                self._put(*self._anchors[anchor], None)
            case yaml.DocumentEndEvent():
                self.is_complete = True

    def _begin(self, container: Any, anchor: str | None) -> None:
        if len(self._open) >= _DEEPEST:
            raise ValueError(f"nested more than {_DEEPEST} deep")
        self._open.append([container, _NO_KEY, anchor, _VALUE])

    def _put(self, value: Any, size: int, anchor: str | None) -> None:
        if anchor:
            self._anchors[anchor] = value, size
        if not self._open:
            self.root = value
            return
        top = self._open[-1]
        top[3] += size
        if top[3] > self._most:
            raise ValueError(
                f"more than {self._most / 1e6:g} MB of values, its aliases counted; need less (limits.text_mb)"
            )
        container, key = top[0], top[1]
        if isinstance(container, list):
            container.append(value)
        elif key is _NO_KEY:
            if isinstance(value, list | dict):
                raise ValueError("a key that is no text")
            top[1] = value or ""
        else:
            container[key] = value
            top[1] = _NO_KEY
