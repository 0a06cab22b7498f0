# SPDX-License-Identifier: Apache-2.0
"""What every node of this package is: managed, configured by parameters, idle while nobody listens."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from typing import Any, Generic, Protocol, TypeVar, cast

from rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

from imgu_ros.errors import ImguError, ParameterError
from imgu_ros.ros.background_call import BackgroundCall
from imgu_ros.ros.middleware import lacks_memory, profile_line
from imgu_ros.ros.outputs import Outputs
from imgu_ros.ros.parameter_sections import unheeded_parameters
from imgu_ros.ros.parameters import ParameterServer
from imgu_ros.ros.plain_logger import PlainLogger
from imgu_ros.ros.process import run_node
from imgu_ros.ros.stopping import StopSignal
from imgu_ros.ros.transitions import refuse_impossible_transitions

_THROTTLE_S = 5.0
_END_S = 1.0


class Input(Protocol):
    """What a node takes its frames from."""

    @property
    def group(self) -> CallbackGroup:
        """Of the subscriptions' callbacks."""

    @property
    def is_open(self) -> bool:
        """Whether it is subscribed."""

    def close(self) -> None:
        """Drop the subscriptions."""


InputT = TypeVar("InputT", bound=Input)
T = TypeVar("T")


class ManagedNode(LifecycleNode, Generic[InputT]):
    """A lifecycle node with `~/pause`, `~/reset` and `~/reload`.

    Who derives from it has an `_input`, and says what `_load`, `_drop`, `_watch`, `_begin`, `_reset` and `_reload` do.

    Parameters
    ----------
    name : of the node
    stop : tells when the process is asked to stop
    """

    _input: InputT
    _plain_logger: PlainLogger | None = None

    def __init__(self, name: str, stop: StopSignal) -> None:
        super().__init__(name, enable_logger_service=True)
        refuse_impossible_transitions(self)
        self._stop = stop
        self._failure: ImguError | None = None
        self._lifecycle = "unconfigured"
        self._paused = False
        # The machine's time: with use_sim_time a timer would stand still until /clock comes.
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._outputs: Outputs | None = None
        self._server = ParameterServer(self)
        self._beside = BackgroundCall()
        # While one of them is answered the other callbacks go on.
        self._slow_services = MutuallyExclusiveCallbackGroup()
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.create_service(Trigger, "~/reset", self._on_reset)

    def get_logger(self) -> PlainLogger:
        """Return the node's logger; what it logs acts on no terminal."""
        if self._plain_logger is None:
            self._plain_logger = PlainLogger(super().get_logger().name)
        return self._plain_logger

    def start(self) -> None:
        """Configure and activate when `autostart` says so.

        Raises
        ------
        ImguError
            If the node cannot be configured.
        """
        if not self._server.parameters.autostart:
            return
        if self.trigger_configure() != TransitionCallbackReturn.SUCCESS:
            raise self._failure or ImguError(f"{self.get_name()}: cannot be configured; see the log")
        self.trigger_activate()

    def frame_group(self) -> CallbackGroup | None:
        """Return the group of the inputs' callbacks while they are subscribed."""
        return self._input.group if self._input.is_open else None

    def close(self) -> bool:
        """Drop the inputs and end the threads; return whether they have ended."""
        self._input.close()
        return self._beside.close(_END_S)

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> Any:
        """See `ParameterServer.set_atomically`."""
        return self._server.set_atomically(parameter_list, super().set_parameters_atomically)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load the targets and create the publishers."""
        try:
            with self._stop.interruptible():
                self._load()
        except ImguError as error:
            self._failure = error
            if state.label != "unconfigured" or not self._server.parameters.autostart:
                self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        self._lifecycle = "inactive"
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to look for listeners."""
        self._lifecycle = "active"
        self._begin()
        self._watch()
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Drop the inputs."""
        self._lifecycle = "inactive"
        self._input.close()
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the targets and destroy the publishers."""
        self._lifecycle = "unconfigured"
        self._input.close()
        self._drop()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Drop everything; the process ends when it is asked to."""
        self._lifecycle = "finalized"
        self._input.close()
        self._drop()
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Go back to the beginning."""
        return self.on_cleanup(state)

    def _load(self) -> None:
        """Make what the parameters ask for.

        Raises
        ------
        ImguError
            If it cannot be made.
        """
        raise NotImplementedError

    def _drop(self) -> None:
        """Forget what was loaded."""
        raise NotImplementedError

    def _begin(self) -> None:
        """Do what is to be done once, when the node becomes active."""
        raise NotImplementedError

    def _watch(self) -> None:
        """Subscribe when somebody listens, and only then."""
        raise NotImplementedError

    def _reset(self) -> str:
        """Forget what earlier frames told; return what was done."""
        raise NotImplementedError

    async def _reload(self) -> str:
        """Load again; return what is there now."""
        raise NotImplementedError

    def _create_slow_service(self, name: str, act: Callable[[], Awaitable[str]]) -> None:
        """Offer a Trigger that may take long; frames, timers and other services go on meanwhile."""

        async def on_request(_: Any, response: Any) -> Any:
            try:
                self._require_configured()
                response.message = await act()
                response.success = True
            except ImguError as error:
                response.message = str(error)
                response.success = False
            return response

        self.create_service(Trigger, name, on_request, callback_group=self._slow_services)

    async def _do_beside(self, work: Callable[[], T]) -> T:
        # A service is called by an executor.
        return await self._beside.do(work, cast(Executor, self.executor))

    def _on_reset(self, _: Any, response: Any) -> Any:
        response.message, response.success = self._reset(), True
        return response

    def _on_pause(self, request: Any, response: Any) -> Any:
        self._paused = bool(request.data)
        self._watch()
        response.message, response.success = "paused" if self._paused else "running", True
        return response

    def _require_configured(self) -> None:
        if self._outputs is None:
            raise ParameterError(f"lifecycle state: {self._lifecycle}; need inactive or active")

    def _log_failure(self, line: str) -> None:
        self.get_logger().error(line, throttle_duration_sec=_THROTTLE_S, throttle_time_source_type=self._steady)

    def _log_warning(self, line: str) -> None:
        self.get_logger().warning(line)

    def _log_rejected(self, reason: str) -> None:
        self.get_logger().warning(
            f"frame rejected: {reason}", throttle_duration_sec=_THROTTLE_S, throttle_time_source_type=self._steady
        )


def run_managed(make: Callable[[], ManagedNode[Any]], ros_arguments: Sequence[str], stop: StopSignal) -> int:
    """Run a node until the process is asked to stop; return the exit code.

    Raises
    ------
    ImguError
        If the node cannot start: a bad parameter, a target that cannot be used, a missing package.
    """

    def make_node() -> ManagedNode[Any]:
        node = make()
        (node.get_logger().warning if lacks_memory() else node.get_logger().info)(profile_line())
        for line in unheeded_parameters(ros_arguments, node.get_fully_qualified_name()):
            node.get_logger().warning(line)
        return node

    return run_node(make_node, ros_arguments, stop)
