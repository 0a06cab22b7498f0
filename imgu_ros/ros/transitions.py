# SPDX-License-Identifier: Apache-2.0
"""Answers requests for lifecycle transitions that are not possible: rclpy raises an error and leaves them waiting."""

from __future__ import annotations

from typing import Any

from rclpy.lifecycle import LifecycleNode


def refuse_impossible_transitions(node: LifecycleNode) -> None:
    """Have `~/change_state` answer "no" to a transition that the node's state does not allow, and log which do."""
    # rclpy keeps both to itself and has no public way to them.
    service, machine = node._service_change_state, node._state_machine
    change = service.callback

    def on_change_state(request: Any, response: Any) -> Any:
        possible = {number: label for number, label, *_ in machine.available_transitions}
        wanted = request.transition
        if wanted.label or wanted.id in possible:
            return change(request, response)
        state = machine.current_state[1]
        need = ", ".join(f"{label} ({number})" for number, label in possible.items()) or "none: it is final"
        node.get_logger().warning(f"transition {wanted.id}: not possible in lifecycle state {state}; possible: {need}")
        response.success = False
        return response

    service.callback = on_change_state
