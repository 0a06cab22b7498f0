# SPDX-License-Identifier: Apache-2.0
"""What the live tests share: a domain for each module, processes that always end, and a peer on the same graph."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

with warnings.catch_warnings():
    # Importing the ROS wheels warns of things that they do to themselves, once in a process.
    warnings.simplefilter("ignore")
    with contextlib.suppress(ImportError):  # the tests say that they skip
        import rosidl_generator_py  # noqa: F401

REPOSITORY = Path(__file__).resolve().parents[2]

#: Waits end with what they wait for; these bounds are for machines that are busy with something else.
PATIENCE_S = 40.0
#: A process ends in 0.2 s when the machine has time for it.
PROMPT_S = 5.0
_AGAIN_S = 2.0


class Command:
    """An `imgu` command in a process of its own; its output is kept."""

    def __init__(self, arguments: list[str], environment: dict[str, str]) -> None:
        self.lines: list[str] = []
        self.process = subprocess.Popen(
            [sys.executable, "-m", "imgu_ros.cli.main", *arguments],
            env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=REPOSITORY,
        )  # fmt: skip
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def text(self) -> str:
        return "".join(self.lines)

    def wait_for_line(self, part: str, timeout_s: float = PATIENCE_S) -> None:
        end = time.monotonic() + timeout_s
        while part not in self.text:
            assert self.process.poll() is None, f"ended with {self.process.returncode}:\n{self.text}"
            assert time.monotonic() < end, f"no {part!r} in:\n{self.text}"
            time.sleep(0.02)

    def wait(self, timeout_s: float = PATIENCE_S) -> int:
        code = self.process.wait(timeout_s)
        self._reader.join(2)
        return code

    def stop(self, number: signal.Signals = signal.SIGINT) -> float:
        """End it by a signal; return how long that took."""
        started = time.monotonic()
        self.process.send_signal(number)
        self.wait()
        return time.monotonic() - started

    def wait_for_handler(self, number: signal.Signals) -> None:
        """Wait until the process handles a signal: before that the signal would end it as any process."""
        end = time.monotonic() + PATIENCE_S
        status = Path(f"/proc/{self.process.pid}/status")
        while not int(status.read_text().partition("SigCgt:")[2].split()[0], 16) >> (number - 1) & 1:
            assert time.monotonic() < end, f"no handler of {number.name}"
            time.sleep(0.01)

    def kill(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.wait(5)
        if self.process.stdout:
            self.process.stdout.close()

    def _read(self) -> None:
        assert self.process.stdout is not None
        with contextlib.suppress(ValueError):
            self.lines.extend(iter(self.process.stdout.readline, ""))


class Peer:
    """A node of the test itself: hears, publishes and calls."""

    def __init__(self, domain: int) -> None:
        import rclpy
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node

        self.context = Context()
        rclpy.init(args=[], context=self.context, domain_id=domain)
        self.node = Node("peer", context=self.context, enable_rosout=False, start_parameter_services=False)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.heard: dict[str, list[Any]] = defaultdict(list)
        self._subscriptions: dict[str, Any] = {}

    def hear(self, topic: str, type_name: str) -> None:
        from imgu_ros.ros.messages import message_class
        from imgu_ros.ros.qos import output_qos

        self._subscriptions[topic] = self.node.create_subscription(
            message_class(type_name), topic, self.heard[topic].append, output_qos(50)
        )

    def has_publishers(self) -> bool:
        """Whether every topic that is heard has somebody who publishes it."""
        return all(subscription.get_publisher_count() for subscription in self._subscriptions.values())

    def unhear(self, topic: str) -> None:
        self.node.destroy_subscription(self._subscriptions.pop(topic))

    def publisher(self, topic: str, type_name: str, qos: Any = None) -> Any:
        from imgu_ros.ros.messages import message_class
        from imgu_ros.ros.qos import output_qos

        return self.node.create_publisher(message_class(type_name), topic, qos or output_qos(10))

    def wait(
        self, condition: Callable[[], object], what: str, timeout_s: float = PATIENCE_S,
        again: Callable[[], object] = lambda: None,
    ) -> None:  # fmt: skip
        """Spin until the condition holds; call `again` now and then: what is sent before all are matched is lost."""
        end = time.monotonic() + timeout_s
        repeat = time.monotonic() + _AGAIN_S
        while not condition():
            now = time.monotonic()
            assert now < end, f"waited {timeout_s} s for {what}"
            if now >= repeat:
                again()
                repeat = now + _AGAIN_S
            self.executor.spin_once(timeout_sec=0.02)

    def spin(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.02)

    def call(self, service_type: Any, name: str, request: Any, timeout_s: float = PATIENCE_S) -> Any:
        client = self.node.create_client(service_type, name)
        try:
            self.wait(client.service_is_ready, f"service {name}", timeout_s)
            asked = [client.call_async(request)]
            # An answer gets lost when the node has not discovered its reader yet: rarely, and on busy machines.
            again = time.monotonic() + 10

            def answered() -> bool:
                nonlocal again
                if time.monotonic() > again:
                    asked.append(client.call_async(request))
                    again += 10
                return any(future.done() for future in asked)

            self.wait(answered, f"answer of {name}", timeout_s)
            future = next(future for future in asked if future.done())
            return future.result()
        finally:
            self.node.destroy_client(client)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


@dataclass(frozen=True)
class World:
    """A short sequence with its target on disk, and what the pipeline makes of it offline."""

    target: Path
    frames: tuple[Any, ...]
    results: tuple[Any, ...]

    @property
    def arguments(self) -> list[str]:
        return ["-p", f"targets.images:=[{self.target}]", "-p", "targets.widths_m:=[0.5]"]


class Camera:
    """Publishes frames as a driver does: sensor-data QoS, an image and its camera_info."""

    def __init__(self, peer: Peer, base: str = "/cam") -> None:
        from imgu_ros.ros.qos import image_qos

        self._peer = peer
        self._image = peer.publisher(f"{base}/image_raw", "sensor_msgs/msg/Image", image_qos())
        self._info = peer.publisher(f"{base}/camera_info", "sensor_msgs/msg/CameraInfo", image_qos())

    def wait_for_node(self) -> None:
        both = (self._image, self._info)
        self._peer.wait(lambda: all(p.get_subscription_count() for p in both), "the node's subscriptions")
        self._peer.wait(self._peer.has_publishers, "the node's outputs")
        self._peer.spin(0.5)

    @property
    def is_subscribed(self) -> bool:
        return bool(self._image.get_subscription_count())

    def send(self, frame: Any, encoding: str = "bayer_rggb8", K_zero: bool = False, **changes: Any) -> None:
        """Send a frame; `changes` are fields of the image message that lie."""
        self.send_info(frame, frame.stamp_ns, **({"k": np.zeros(9)} if K_zero else {}))
        self.send_image(frame, encoding=encoding, **changes)

    def send_image(self, frame: Any, **changes: Any) -> None:
        from imgu_ros.messages.header import Header
        from imgu_ros.messages.image import image_message
        from imgu_ros.ros.messages import make_message

        image = image_message(make_message, Header(frame.stamp_ns, frame.frame_id), frame.image.pixels, "bayer_rggb8")
        for name, value in changes.items():
            setattr(image, name, value)
        self._image.publish(image)

    def send_info(self, frame: Any, stamp_ns: int, **changes: Any) -> None:
        from imgu_ros.messages.camera_info import camera_info_message
        from imgu_ros.messages.header import Header
        from imgu_ros.ros.messages import make_message

        info = camera_info_message(make_message, Header(stamp_ns, frame.frame_id), frame.camera)
        for name, value in changes.items():
            setattr(info, name, value)
        self._info.publish(info)

    def close(self) -> None:
        """End as a driver that is killed: its publishers are gone."""
        self._peer.node.destroy_publisher(self._image)
        self._peer.node.destroy_publisher(self._info)


@pytest.fixture(scope="session")
def world(tmp_path_factory: pytest.TempPathFactory) -> World:
    """Four frames of a target half a metre wide."""
    import cv2

    from imgu_ros.config.values import parameters_from
    from imgu_ros.localizer import Localizer
    from imgu_ros.reference.templates import TargetImage
    from imgu_ros.reference_kinds import prepare_references
    from imgu_ros.simulate.sequence import Simulation, default_targets, simulate_sequence

    path = tmp_path_factory.mktemp("world") / "poster.png"
    target = default_targets(1, seed=3, width_m=0.5)[0]
    cv2.imwrite(str(path), target.pixels[:, :, ::-1])
    simulation = Simulation(width=480, height=360, frames=4, seed=3)
    frames = tuple(simulated.frame for simulated in simulate_sequence(simulation, [target]))
    parameters = parameters_from({"targets.images": [str(path)], "targets.widths_m": [0.5]})
    chain = Localizer(parameters, prepare_references([TargetImage("poster", target.pixels, 0.5)], parameters))
    results = tuple(chain.process(frame) for frame in frames)
    assert all(result.first.pose is not None for result in results)
    return World(path, frames, results)


@pytest.fixture
def make_camera() -> type[Camera]:
    """Makes cameras on a peer."""
    return Camera


@pytest.fixture(scope="session")
def prompt_s() -> float:
    """Longest time that a process may take to end."""
    return PROMPT_S


@pytest.fixture(scope="module")
def domain(request: pytest.FixtureRequest) -> int:
    """A ROS domain for the whole module."""
    plugins = request.config.pluginmanager.get_plugins()
    return int(next(plugin.free_domain for plugin in plugins if hasattr(plugin, "free_domain"))())


@pytest.fixture(scope="module")
def environment(domain: int) -> dict[str, str]:
    """Environment of processes on the module's domain."""
    path = os.pathsep.join(part for part in (str(REPOSITORY), os.environ.get("PYTHONPATH")) if part)
    return {**os.environ, "ROS_DOMAIN_ID": str(domain), "PYTHONPATH": path, "PYTHONUNBUFFERED": "1"}


@pytest.fixture
def imgu(environment: dict[str, str]) -> Iterator[Callable[..., Command]]:
    """Starts `imgu` commands; whatever still runs at the end is killed."""
    started: list[Command] = []

    def start(*arguments: str) -> Command:
        started.append(Command(list(arguments), environment))
        return started[-1]

    yield start
    for command in started:
        command.kill()


@pytest.fixture
def peer(domain: int) -> Iterator[Peer]:
    """A node of the test itself on the module's domain."""
    pytest.importorskip("rclpy", reason="needs the ros extra")
    made = Peer(domain)
    yield made
    made.close()
