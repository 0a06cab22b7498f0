# SPDX-License-Identifier: Apache-2.0
"""Parameter files and overrides, combined as rcl combines them.

A replay must read from a file what the live node reads from it through rcl. rcl parses YAML events with a small state
machine, and this is that machine. Surprising consequences: sections apply in the order of their first appearance, not
by how specific they are; `-p` belongs to the section `/**`; a value does not replace an earlier one of another type;
tags other than `!!str` are ignored; of nested lists the last inner one is used; aliases are refused.
Source: rcl_yaml_param_parser and rclpy's `Node.get_parameters` of ROS 2 Jazzy.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field

import yaml

from imgu_ros.config.yaml_values import scalar_value, yaml_events
from imgu_ros.errors import ParameterError

SECTION = "ros__parameters"

#: The section that overrides of the command line belong to.
_COMMAND_LINE = "/**"
#: Limits on one section's parameters and on the length of a full name, far above those of any node.
_MOST_PARAMETERS, _LONGEST_NAME = 5000, 1000
_NODE_NAME = re.compile(r"/?((\*\*?|[A-Za-z_][A-Za-z0-9_]*)/)*(\*\*?|[A-Za-z_][A-Za-z0-9_]*)")
#: rcl stores a value for each type under one name; rclpy takes the first of these.
_TYPES = ("bool", "int", "float", "str", "list of bool", "list of int", "list of float", "list of str")


@dataclass(slots=True, eq=False)
class _Entry:
    """One parameter in one section: a value for each type that was given, and the value given last."""

    name: str
    values: dict[str, object] = field(default_factory=dict)
    given: object = None
    source: str = ""
    order: int = 0

    @property
    def value(self) -> object:
        """The value in force; None where only an empty group was given."""
        return next((self.values[kind] for kind in _TYPES if kind in self.values), self.given)


class RclParameters:
    """The parameter files and overrides of one command line, section by section."""

    def __init__(self) -> None:
        self._sections: dict[str, list[_Entry]] = {}
        self._count = 0

    def add_file(self, data: bytes, source: str) -> list[str]:
        """Add a parameter file and return the names of its sections, each with a leading slash.

        Raises
        ------
        ParameterError
            If rcl would refuse it; `source` and the line say where.
        """
        machine = _Machine(self, source)
        for event in yaml_events(data, source):
            machine.take(event)
        return machine.sections

    def add_override(self, text: str) -> str:
        """Add "NAME:=VALUE" or "NODE:NAME:=VALUE" and return the parameter's name.

        Raises
        ------
        ParameterError
            If there is no ":=", no name, no value, or the value is neither a scalar nor a list of scalars.
        """
        left, separator, value = text.partition(":=")
        node, _, name = left.strip().rpartition(":")
        if not separator or not name:
            raise ParameterError(f"{text!r}: no parameter name and value; need NAME:=VALUE")
        entry = self.entry(node or _COMMAND_LINE, name)
        before = entry.order
        machine = _Machine(self, "", entry)
        for event in yaml_events(value.encode("utf-8", "surrogatepass"), name):
            machine.take_value(event)
        if entry.order == before:
            raise ParameterError(f"{name}: no value; need one")
        return name

    def entries(self, applies: Callable[[str], bool]) -> dict[str, _Entry]:
        """Return the entries in force for a node, by parameter; `applies` tells whether a section is the node's."""
        return {entry.name: entry for name, entries in self._sections.items() if applies(name) for entry in entries}

    def overruled(self, applies: Callable[[str], bool]) -> list[str]:
        """Return a line for each parameter that ROS 2 leaves at another value than the one that was given last."""
        last: dict[str, _Entry] = {}
        for section, entries in self._sections.items():
            for entry in entries if applies(section) else ():
                if entry.order >= last.get(entry.name, entry).order:
                    last[entry.name] = entry
        return [
            f"{name}: {entry.value!r} is in force, not the later {last[name].given!r}: ROS 2 keeps a value when the "
            "next has another type, and applies sections in the order of their first appearance"
            for name, entry in self.entries(applies).items()
            if repr(entry.value) != repr(last[name].given)
        ]

    def entry(self, section: str, name: str, source: str = "") -> _Entry:
        """Return the entry of a parameter, a new one if there is none yet."""
        entries = self.section(section)
        for entry in entries:
            if entry.name == name:
                return entry
        if len(entries) >= _MOST_PARAMETERS:
            raise ParameterError(f"{source}: more than {_MOST_PARAMETERS} parameters in {section[:80]!r}; need less")
        entries.append(_Entry(name, source=source))
        return entries[-1]

    def section(self, name: str) -> list[_Entry]:
        """Return a section's entries; a new section comes last in the order."""
        return self._sections.setdefault(name, [])

    def stamp(self, entry: _Entry, given: object, source: str) -> None:
        """Record the value given last."""
        self._count += 1
        entry.given, entry.source, entry.order = given, source, self._count


def section_applies(section: str, node_name: str) -> bool:
    """Return whether a section's name, with wildcards, matches a node's; both begin with a slash."""
    pattern = section.replace("/*", "(/\\w+)")
    return re.fullmatch(pattern, node_name, re.ASCII) is not None


def with_slash(name: str) -> str:
    """Return a node's name with one leading slash."""
    return name if name.startswith("/") else f"/{name}"


class _Machine:
    """rcl's parser of one file, or of the value of one override (that of `entry`)."""

    def __init__(self, owner: RclParameters, source: str, entry: _Entry | None = None) -> None:
        self.sections: list[str] = []
        self._owner, self._source = owner, source
        self._line = 0
        self._is_key, self._in_list, self._is_new_map, self._in_section = True, False, False, False
        self._depth = 0
        self._names, self._groups = _Path("/"), _Path(".")
        self._section = ""
        self._entry = entry
        self._list_kind = ""

    def take(self, event: yaml.Event) -> None:
        """Take the next event of a file."""
        self._line = event.start_mark.line + 1 if event.start_mark else 0
        match event:
            case yaml.ScalarEvent():
                take = self._key if self._is_key else self._value
                take(event)
            case yaml.SequenceStartEvent():
                if self._is_key:
                    raise self._error("a list in place of a name", "NAME: VALUE")
                if not self._in_section:
                    raise self._error(f"a list outside of `{SECTION}`", f"`/**:` and `{SECTION}:` above the parameters")
                self._start_list()
            case yaml.SequenceEndEvent():
                self._end_list()
                self._is_key = True
            case yaml.MappingStartEvent():
                self._depth += 1
                # The mapping right below `ros__parameters` is not a group.
                self._is_new_map = not (self._in_section and self._depth - self._names.count == 3)
                self._is_key = True
            case yaml.MappingEndEvent():
                self._end_map()
                self._depth -= 1
            case yaml.AliasEvent():
                raise self._error("an alias, which ROS 2 does not read", "plain values")

    def take_value(self, event: yaml.Event) -> None:
        """Take the next event of an override's value."""
        match event:
            case yaml.ScalarEvent():
                self._store(event)
            case yaml.SequenceStartEvent():
                self._start_list()
            case yaml.SequenceEndEvent():
                self._end_list()
            case yaml.MappingStartEvent() | yaml.AliasEvent():
                kind = "a mapping" if isinstance(event, yaml.MappingStartEvent) else "an alias"
                name = self._entry.name if self._entry else ""
                raise self._error(kind, "a value or a list of values", name)

    def _key(self, event: yaml.ScalarEvent) -> None:
        name = str(event.value).partition("\0")[0]
        if not event.value:
            raise self._error("an empty name", "NAME: VALUE")
        if self._in_section:
            self._parameter_key(name)
        elif not name.startswith(SECTION):
            self._check_length(self._names, name)
            self._names.push(name)
        else:
            self._open_section()
        self._is_key = False

    def _open_section(self) -> None:
        if not self._names.count:
            raise self._error(f"'{SECTION}:' outside of a node's section", "'/**:' above it")
        if not _NODE_NAME.fullmatch(self._names.text):
            raise self._error(f"{self._names.text!r} is not a node name", "'/**', or names separated by '/'")
        self._section, self._entry = self._names.text, None
        self.sections.append(with_slash(self._section))
        self._owner.section(self._section)
        self._names.pop()
        self._in_section = True

    def _parameter_key(self, name: str) -> None:
        if self._is_new_map:
            if self._entry is None:
                raise self._error("a group without a name", "NAME: VALUE")
            self._groups.set(self._entry.name, self._groups.count + 1)
            self._is_new_map = False
        self._check_length(self._groups, name)
        if not self._groups.count:
            self._entry = self._owner.entry(self._section, name, self._source)
        else:
            # As in rcl, the entry of the group becomes its first parameter.
            self._entry = self._owner.entry(self._section, self._groups.text, self._source)
            self._entry.name = f"{self._groups.text}.{name}"

    def _check_length(self, groups: _Path, name: str) -> None:
        if len(groups.text) + len(name) > _LONGEST_NAME:
            length = len(groups.text) + len(name)
            raise self._error(f"a name of {length} characters with its groups", f"at most {_LONGEST_NAME}")

    def _value(self, event: yaml.ScalarEvent) -> None:
        if not self._in_section or self._entry is None:
            raise self._error(
                f"a value outside of '{SECTION}:'", f"'/**:' with '{SECTION}:' and NAME: VALUE lines in it"
            )
        self._store(event)
        if not self._in_list:
            self._is_key = True

    def _store(self, event: yaml.ScalarEvent) -> None:
        entry = self._entry
        assert entry is not None
        if event.value == "" and event.style not in ("'", '"'):
            raise self._error("no value", "one", entry.name)
        value = scalar_value(event)
        kind = type(value).__name__
        if not self._in_list:
            entry.values[kind] = value
            self._owner.stamp(entry, value, self._source)
            return
        if not self._list_kind:
            self._list_kind = kind
            entry.values[f"list of {kind}"] = []
        elif self._list_kind != kind:
            hint = " (write 1.0, not 1)" if {self._list_kind, kind} == {"int", "float"} else ""
            raise self._error(f"a list of {self._list_kind} and {kind}", f"values of one type{hint}", entry.name)
        values = entry.values[f"list of {kind}"]
        assert isinstance(values, list)
        values.append(value)
        self._owner.stamp(entry, values, self._source)

    def _start_list(self) -> None:
        self._in_list, self._list_kind = True, ""

    def _end_list(self) -> None:
        if self._in_list and not self._list_kind and self._entry is not None:
            self._owner.stamp(self._entry, [], self._source)
        self._in_list = False

    def _end_map(self) -> None:
        if self._in_section:
            if self._groups.count:
                self._groups.pop()
            else:
                self._in_section = False
        elif self._depth == self._names.count + 1:
            self._names.pop()

    def _error(self, found: str, need: str, name: str = "") -> ParameterError:
        place = f"{self._source}: line {self._line}: " if self._source else ""
        return ParameterError(f"{place}{name}{': ' if name else ''}{found}; need {need}")


class _Path:
    """Names joined by a separator, and the number of keys they came from: one key may hold several names."""

    def __init__(self, separator: str) -> None:
        self._separator = separator
        self.text = ""
        self.count = 0

    def set(self, text: str, count: int) -> None:
        self.text, self.count = text, count

    def push(self, name: str) -> None:
        between = "" if not self.count or self.text.endswith(self._separator) else self._separator
        self.text = f"{self.text}{between}{name}" if self.count else name
        self.count += 1

    def pop(self) -> None:
        if self.count == 1:
            self.text = ""
        elif self.count > 1 and self._separator in self.text:
            self.text = self.text.rpartition(self._separator)[0]
        self.count = max(self.count - 1, 0)
