# SPDX-License-Identifier: Apache-2.0
"""What a node logs of names from outside: nothing in it acts on a terminal, and throttled lines stay apart."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

from rclpy.impl import rcutils_logger
from rclpy.impl.rcutils_logger import _rclpy

from imgu_ros.ros.managed_node import ManagedNode
from imgu_ros.ros.plain_logger import PlainLogger


@pytest.fixture
def logged(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return what reaches rcutils."""
    lines: list[str] = []
    monkeypatch.setattr(_rclpy, "rclpy_logging_rcutils_log", lambda _, __, line, *___: lines.append(line))
    return lines


def test_lines_do_not_act_and_are_not_endless(logged: list[str]) -> None:
    logger = PlainLogger("camera")
    logger.warning("frame_id '\x1b]0;x\x07\x9b2J\u202e\n[ERROR] forged' é 漢字")
    logger.error("encoding " + "x" * 10**6)
    assert logged[0] == r"frame_id '\x1b]0;x\x07\x9b2J\u202e\n[ERROR] forged' é 漢字"
    assert len(logged[1]) <= 2000


def test_each_caller_has_its_own_throttle(logged: list[str]) -> None:
    """rclpy keeps what it throttles by the line that logs, which is not in our logger."""
    logger = PlainLogger("camera")
    for number in range(3):
        logger.warning(f"first {number}", throttle_duration_sec=60)
        logger.error(f"second {number}", throttle_duration_sec=60)
    assert logged == ["first 0", "second 0"]


def test_nodes_log_through_it() -> None:
    class Bare(ManagedNode):  # type: ignore[type-arg]
        def __init__(self) -> None:
            self._logger = rcutils_logger.RcutilsLogger("bare")

        def destroy_node(self) -> None:
            pass

        def __del__(self) -> None:
            pass

    node = Bare()
    assert isinstance(node.get_logger(), PlainLogger) and node.get_logger() is node.get_logger()
