# SPDX-License-Identifier: Apache-2.0
"""Requests for lifecycle transitions that are not possible; a file of its own because it replaces a fault of rclpy."""

from __future__ import annotations

from typing import Any

from rclpy.lifecycle import LifecycleNode


def refuse_impossible_transitions(node: LifecycleNode) -> None:
    """Have `~/change_state` answer "no" to a transition that the node's state does not allow, and log which do.

    rclpy by itself raises an error and leaves the request without an answer.
    """
    services = {service.srv_name.rpartition("/")[2]: service for service in node.services}
    change_state = services["change_state"]
    change = change_state.callback

    def asked(name: str) -> Any:
        service: Any = services[name]
        return service.callback(service.srv_type.Request(), service.srv_type.Response())

    def on_change_state(request: Any, response: Any) -> Any:
        transitions = [one.transition for one in asked("get_available_transitions").available_transitions]
        possible = {one.id: one.label for one in transitions}
        wanted = request.transition
        if wanted.label or wanted.id in possible:
            return change(request, response)
        state = asked("get_state").current_state.label
        need = ", ".join(f"{label} ({number})" for number, label in possible.items()) or "none: it is final"
        node.get_logger().warning(f"transition {wanted.id}: not possible in lifecycle state {state}; possible: {need}")
        response.success = False
        return response

    change_state.callback = on_change_state
