# SPDX-License-Identifier: Apache-2.0
"""The declared parameters on a ROS node: described, checked as one, and never silently ignored.

rclpy by itself ignores an override whose name is not declared, and its parameter services check one value at a
time. Here an unknown name is refused with the nearest known one, and a set is checked together with the values
that stay.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from imgu_ros.config.components import ReadingParameters
from imgu_ros.config.parameters import Declaration, Parameters, ParameterValue, declaration, declarations
from imgu_ros.config.values import checked_value, is_empty_group, parameters_from
from imgu_ros.errors import ImguError, ParameterError, nearest_name
from imgu_ros.files.frame_reading import check_change

#: Values of this group wait for `ParameterServer.reload`.
STAGED = "targets."
#: Names that rclpy reads by itself.
FOREIGN = ("use_sim_time", "start_type_description_service")
QOS_PREFIX = "qos_overrides."

_TYPES = {
    "bool": Parameter.Type.BOOL,
    "integer": Parameter.Type.INTEGER,
    "double": Parameter.Type.DOUBLE,
    "string": Parameter.Type.STRING,
    "string_array": Parameter.Type.STRING_ARRAY,
    "double_array": Parameter.Type.DOUBLE_ARRAY,
    "integer_array": Parameter.Type.INTEGER_ARRAY,
}
_TOGETHER = "; set values that depend on each other in one call of set_parameters_atomically"


class ParameterServer:
    """Declares every parameter on a node and keeps the checked `Parameters`.

    The node routes its `set_parameters_atomically` through `set_atomically`: the parameter services then answer with
    the reason of every refusal. Reading is safe from any thread.

    Parameters
    ----------
    node : the node; its overrides (command line, parameter files, launch) are the initial values

    Raises
    ------
    ParameterError
        If an override is unknown, has the wrong type, or lies outside its range.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._lock = threading.Lock()
        # rclpy has no public call for the overrides that are not declared.
        overrides = node._parameter_overrides
        self._qos_overrides = [name for name in overrides if name.startswith(QOS_PREFIX)]
        given = {
            name: override.value
            for name, override in overrides.items()
            if name not in FOREIGN and not name.startswith(QOS_PREFIX) and not is_empty_group(name, override.value)
        }
        self._live = parameters_from(given)
        self._values = {d.name: d.default for d in declarations()}
        self._values.update({name: checked_value(name, value) for name, value in given.items()})
        _declare(node, self._values)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._commit)

    @property
    def parameters(self) -> Parameters:
        """The values in force, another object when, and only when, one has changed.

        `targets` are those of the last `reload`.
        """
        with self._lock:
            return self._live

    def staged(self) -> Parameters:
        """Return the values that `reload` puts in force.

        Raises
        ------
        ParameterError
            If they do not fit together.
        """
        with self._lock:
            return parameters_from(self._values)

    def reload(self, loaded: Parameters | None = None) -> Parameters:
        """Put the values of `targets` that were set since the start in force and return all.

        Parameters
        ----------
        loaded : what `staged` gave, where it took long to load: its `targets` come in force, and not later ones; None:
            the newest

        Raises
        ------
        ParameterError
            If they do not fit together; then the old ones stay.
        """
        with self._lock:
            newest = parameters_from(self._values)
            if loaded is None:
                self._live = newest
            else:
                now = replace(newest, targets=loaded.targets)
                self._live = loaded if now == loaded else now
            return self._live

    def set_atomically(
        self, parameters: Sequence[Parameter], set_declared: Callable[[list[Parameter]], SetParametersResult]
    ) -> SetParametersResult:
        """Set parameters together, or none of them and say why.

        Parameters
        ----------
        parameters : as a service or a caller gave them; an integer serves as a double, `[]` as any list. Those that are
            fixed while running may be there, with the values that they have, as in a dump of the node
        set_declared : the node's own `set_parameters_atomically`
        """
        try:
            converted = [p for p in map(self._converted, parameters) if not self._is_fixed_as(p)]
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return set_declared(converted) if converted else SetParametersResult(successful=True)

    def unknown_qos_overrides(self, possible: Collection[str]) -> list[str]:
        """Return a line for each topic with QoS overrides that the node does not have, with the nearest possible one.

        They do not stop a node: parameter files are shared by nodes, and dumped under other remaps.

        Parameters
        ----------
        possible : full parameter names
        """
        lines: dict[str, str] = {}
        for name in self._qos_overrides:
            topic = name.split(".")[1]
            if name not in possible and topic not in lines:
                near = nearest_name(name, possible)
                hint = f"nearest known: {near}" if near else f"need one of {', '.join(sorted(possible)) or 'none'}"
                lines[topic] = f"{name}: unknown parameter; {hint}"
        return list(lines.values())

    def _converted(self, parameter: Parameter) -> Parameter:
        if parameter.name in FOREIGN or parameter.name.startswith(QOS_PREFIX):
            return parameter
        return ros_parameter(parameter.name, checked_value(parameter.name, parameter.value))

    def _is_fixed_as(self, parameter: Parameter) -> bool:
        """Whether it is read-only and has this value."""
        node, name = self._node, parameter.name
        if not node.has_parameter(name) or not node.describe_parameter(name).read_only:
            return False
        present = node.get_parameter(name)
        return bool(present.type_ == parameter.type_ and present.value == parameter.value)

    def _check(self, changed: list[Parameter]) -> SetParametersResult:
        given = {p.name: p.value for p in changed if p.name in self._values}
        live, staged = _split(given)
        try:
            for name, value in staged.items():
                checked_value(name, value)
            together = _together(lambda: parameters_from(live, self._live), given)
            # Staged values may come one by one; those that come in one call are meant to fit.
            if len(staged) > 1:
                parameters_from(_split(self._values)[1] | staged, together)
            check_change(ReadingParameters.of(together), ReadingParameters.of(self._live))
        except ImguError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _commit(self, changed: list[Parameter]) -> None:
        given = {p.name: p.value for p in changed if p.name in self._values}
        live, _ = _split(given)
        with self._lock:
            self._values.update({name: checked_value(name, value) for name, value in given.items()})
            together = parameters_from(live, self._live)
            # Equal values must not cause a rebuild.
            if together != self._live:
                self._live = together


def descriptor(known: Declaration) -> ParameterDescriptor:
    """Return the ROS description of a declared parameter."""
    unit = f" [{known.unit}]" if known.unit else ""
    made = ParameterDescriptor(name=known.name, description=known.description + unit, read_only=known.read_only)
    made.type = _TYPES[known.type_name].value
    constraints = []
    if known.choices:
        constraints.append("one of: " + ", ".join(known.choices))
    if known.bounds:
        low, high = known.bounds
        if known.type_name == "double":
            made.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high), step=0.0)]
        elif known.type_name == "integer":
            made.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
        else:  # ROS has no range for the elements of a list
            constraints.append(f"each {known.range_text}")
    if known.name.startswith(STAGED):
        constraints.append("takes effect on ~/reload")
    made.additional_constraints = "; ".join(constraints)
    return made


def ros_parameter(name: str, value: ParameterValue) -> Parameter:
    """Return a declared parameter's value as rclpy's, typed as declared even when it is an empty list."""
    return Parameter(name, _TYPES[declaration(name).type_name], list(value) if isinstance(value, tuple) else value)


def _declare(node: Node, values: Mapping[str, ParameterValue]) -> None:
    empty = []
    for known in declarations():
        value: Any = values[known.name]
        if value == ():
            # rclpy takes an empty list for one of bytes: declare the type, then set the typed empty list.
            empty.append(ros_parameter(known.name, value))
            value = _TYPES[known.type_name]
        elif isinstance(value, tuple):
            value = list(value)
        node.declare_parameters("", [(known.name, value, descriptor(known))], ignore_override=True)
    Node.set_parameters_atomically(node, empty)


def _split(values: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    live = {name: value for name, value in values.items() if not name.startswith(STAGED)}
    staged = {name: value for name, value in values.items() if name.startswith(STAGED)}
    return live, staged


def _together(check: Callable[[], Parameters], given: Mapping[str, object]) -> Parameters:
    try:
        return check()
    except ParameterError as error:
        hint = _TOGETHER if len(given) == 1 else ""
        raise ParameterError(f"{error}{hint}") from None
