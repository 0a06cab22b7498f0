# SPDX-License-Identifier: Apache-2.0
"""The life of a node's process: start, spin, and an orderly end on SIGINT and SIGTERM."""

from __future__ import annotations

import gc
import os
import re
import sys
import time
from collections.abc import Callable, Sequence
from typing import Protocol

import rclpy
from rclpy.context import Context
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from imgu_ros.errors import ImguError, ParameterError
from imgu_ros.ros.middleware import lacks_memory, profile_line
from imgu_ros.ros.parameter_sections import parameter_fault, unheeded_parameters
from imgu_ros.ros.stopping import StopRequested, StopSignal
from imgu_ros.threads import one_processor_left_over

#: The executor's wait for a callback, s.
_LONGEST_WAIT_S = 1.0


class RunnableNode(Protocol):
    """What `run_node` needs of a node besides being an rclpy `Node`."""

    def start(self) -> None:
        """Begin the work; called once, from the main thread, before the first callback."""

    def close(self) -> bool:
        """End the threads of the node and say whether all have ended; safe to call more than once."""


def run_node(make_node: Callable[[], Node], ros_arguments: Sequence[str], stop: StopSignal) -> int:
    """Run a node until the process is asked to stop and return the exit code, 0.

    Parameters
    ----------
    make_node : makes the node, a `RunnableNode`
    ros_arguments : `--ros-args ...` as given by the user
    stop : entered already, so that a signal that comes while the modules are imported is not lost

    Raises
    ------
    ImguError
        If the node cannot start: a bad parameter, a target that cannot be used, a missing package.
    """
    finished = True
    try:
        with stop.interruptible():
            init_ros(ros_arguments)
            node = _made(make_node)
            (node.get_logger().warning if lacks_memory() else node.get_logger().info)(profile_line())
            for line in unheeded_parameters(ros_arguments, node.get_fully_qualified_name()):
                node.get_logger().warning(line)
        try:
            with stop.interruptible():
                node.start()  # type: ignore[attr-defined]
            spare_collector()
            # Of the few processors of a robot the camera's driver and the middleware need one.
            with one_processor_left_over():
                _spin(node, stop)
        finally:
            finished = node.close()  # type: ignore[attr-defined]
            node.destroy_node()
    except StopRequested:
        pass
    finally:
        rclpy.try_shutdown()
    if not finished:
        # A thread is still deep in a computation that Python cannot end; it publishes nothing any more. The
        # interpreter's own exit would wait for it, or end it in the middle of C++ code.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0)
    return 0


def spare_collector() -> None:
    """Take all objects that exist now out of Python's garbage collections; call it when the work begins.

    The modules alone hold 60,000 objects. To go through them takes 30 ms, half a frame's time at 15 Hz.
    """
    gc.collect()
    gc.freeze()


def init_ros(ros_arguments: Sequence[str]) -> None:
    """Initialise rclpy without its signal handlers (see `imgu_ros.ros.stopping`).

    Raises
    ------
    ParameterError
        If the ROS arguments cannot be parsed.
    """
    try:
        rclpy.init(args=["imgu", *ros_arguments], signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # rclpy has public names for none of its errors here, all of which derive from it
        # rcl names neither the line nor the name.
        fault = parameter_fault(ros_arguments)
        raise ParameterError(fault or f"ROS arguments: {_without_source_lines(str(error))}") from None


def _made(make_node: Callable[[], Node]) -> Node:
    try:
        return make_node()
    except ImguError:
        raise
    except (ValueError, RuntimeError) as error:
        # Names, namespaces and QoS overrides that rclpy refuses, each with its own class of error.
        raise ParameterError(f"ROS arguments: {_without_source_lines(str(error))}") from None


def make_executor(context: Context | None = None) -> Executor:
    """Return rclpy's events executor, or its single-threaded one where the former is not available.

    At 60 images a second the node's main thread takes 3.7 % of a processor in the former and 8.7 % in the latter, which
    goes through some fifty entities for each message (`benchmarks/executors.py`). What the events executor lacks is not
    used in this package: coroutines as callbacks, guard conditions, and subscriptions that take a message's info.
    """
    try:
        from rclpy.experimental import EventsExecutor

        made: Executor = EventsExecutor(context=context)
    except (ImportError, RuntimeError, OSError):  # rclpy is too old, or stderr is closed: it enables the faulthandler
        return SingleThreadedExecutor(context=context)
    return made


def _spin(node: Node, stop: StopSignal) -> None:
    executor = make_executor(node.context)
    executor.add_node(node)
    # A callback ends the wait, so that Python's signal handler runs and the loop below sees the request.
    stop.on_request(lambda: executor.create_task(_nothing))
    try:
        while not stop.requested:
            try:
                executor.spin_once(timeout_sec=_LONGEST_WAIT_S)
            except Exception as error:
                # A request that rclpy itself cannot handle must not end the node.
                node.get_logger().error(f"{type(error).__name__}: {_without_source_lines(str(error))}")
                time.sleep(0.01)
    finally:
        executor.remove_node(node)
        executor.shutdown()


def _nothing() -> None:
    """Give the executor something to call."""


def _without_source_lines(text: str) -> str:
    """Strip rcl's places in its own source (`, at ./src/x.c:12`) and line ends."""
    return " ".join(re.sub(r",? at \S+:\d+", "", text).split()).removeprefix("failed to initialize rcl: ")
