# SPDX-License-Identifier: Apache-2.0
"""A page on this machine that shows what the live node finds: `debug_image` as it comes, and each target's status."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import rclpy
from rclpy.node import Node

from imgu_ros.errors import ImguError
from imgu_ros.ros.messages import message_class
from imgu_ros.ros.middleware import set_profile
from imgu_ros.ros.process import init_ros, make_executor
from imgu_ros.ros.qos import output_qos
from imgu_ros.ros.stopping import StopRequested, StopSignal

HOST = "127.0.0.1"
#: The port that is tried first; a free one where it is taken.
PORT = 8765
IMAGE_TOPIC, STATUS_TOPIC = "debug_image/compressed", "status"
_BOUNDARY = b"frame"
#: Older frames are not shown as if they were live, s.
_STALE_S = 2.0
_RATE_OVER = 20
#: A stream looks so often whether the server ends, s.
_PATIENCE_S = 1.0
_PNG = b"\x89PNG"

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>imgu live</title>
<style>
body { margin: 0 auto; max-width: 80rem; padding: 0.75rem; background: #111; color: #eee; font: 1rem sans-serif }
img { width: 100%; background: #222; min-height: 12rem; display: block }
table { border-spacing: 0.75rem 0.25rem; margin-top: 0.5rem }
.l0 { color: #56b4e9 } .l1 { color: #e69f00 } .l2 { color: #d55e00 }
</style></head><body>
<img src="/frames" alt="frames of debug_image">
<p id="rate">waiting for frames</p><table id="targets"></table>
<script>
const rate = document.getElementById("rate"), targets = document.getElementById("targets");
async function look() {
  try {
    const state = await (await fetch("/state")).json();
    rate.textContent = state.text;
    targets.replaceChildren(...state.targets.map(([name, level, text]) => {
      const row = document.createElement("tr");
      for (const [value, kind] of [[name, ""], [text, "l" + level]]) {
        const cell = row.appendChild(document.createElement("td"));
        cell.textContent = value; cell.className = kind;
      }
      return row;
    }));
  } catch { rate.textContent = "imgu view has ended"; }
  setTimeout(look, 300);
}
look();
</script></body></html>
"""
_POLICY = "default-src 'self' 'unsafe-inline'; form-action 'none'; frame-ancestors 'none'"


@dataclass(slots=True, eq=False)
class LiveState:
    """What came last, for the pages that look; written by the node, read by the server's threads."""

    picture: bytes = b""
    number: int = 0
    targets: list[tuple[str, int, str]] = field(default_factory=list)
    times: deque[float] = field(default_factory=lambda: deque(maxlen=_RATE_OVER))
    changed: threading.Condition = field(default_factory=threading.Condition)
    is_over: bool = False

    def add_picture(self, message: Any) -> None:
        """Take a sensor_msgs/CompressedImage."""
        with self.changed:
            self.picture = bytes(message.data)
            self.number += 1
            self.times.append(time.monotonic())
            self.changed.notify_all()

    def add_status(self, message: Any) -> None:
        """Take a diagnostic_msgs/DiagnosticArray of `status`."""
        with self.changed:
            self.targets = [(one.name, int.from_bytes(one.level, "little"), one.message) for one in message.status]

    def end(self) -> None:
        """Have every stream end."""
        with self.changed:
            self.is_over = True
            self.changed.notify_all()

    def pictures(self) -> Iterator[bytes]:
        """Yield pictures as they come, the newest when several came at once."""
        seen = 0
        while True:
            with self.changed:
                while not self.is_over and self.number == seen:
                    self.changed.wait()
                if self.is_over:
                    return
                seen, picture = self.number, self.picture
            yield picture

    def described(self) -> dict[str, Any]:
        """Return what the page says, as JSON has it."""
        with self.changed:
            times = list(self.times)
            if not times:
                text = "no frames yet: is `imgu node perception` running, and does a camera publish?"
            elif time.monotonic() - times[-1] > _STALE_S:
                text = f"no frame for {time.monotonic() - times[-1]:.0f} s"
            else:
                rate = (len(times) - 1) / (times[-1] - times[0]) if times[-1] > times[0] else 0.0
                text = f"{self.number} frames, {rate:.1f} a second"
            return {"text": text, "targets": self.targets}


def run_live_page(port: int | None, ros_arguments: Sequence[str], stop: StopSignal, say: Callable[[str], None]) -> None:
    """Serve the page until the process is asked to stop.

    Parameters
    ----------
    port : of 127.0.0.1; None: 8765, or a free one when that is taken
    ros_arguments : `--ros-args ...`, for remaps
    stop : entered already
    say : takes lines for people

    Raises
    ------
    ImguError
        If the port cannot be had.
    ParameterError
        If the ROS arguments cannot be parsed.
    """
    set_profile()
    state = LiveState()
    with contextlib.suppress(StopRequested), _served(state, port) as address:
        with stop.interruptible():
            init_ros(ros_arguments)
        node = Node("live_page", start_parameter_services=False, enable_rosout=False)
        image = node.create_subscription(
            message_class("sensor_msgs/msg/CompressedImage"), IMAGE_TOPIC, state.add_picture, output_qos(2)
        )
        node.create_subscription(
            message_class("diagnostic_msgs/msg/DiagnosticArray"), STATUS_TOPIC, state.add_status, output_qos(5)
        )
        say(f"http://{HOST}:{address} shows {image.topic_name}; Ctrl-C ends")
        executor = make_executor(node.context)
        executor.add_node(node)
        stop.on_request(lambda: executor.create_task(lambda: None))
        try:
            while not stop.requested:
                executor.spin_once(timeout_sec=_PATIENCE_S)
        finally:
            executor.shutdown()
            node.destroy_node()
            rclpy.try_shutdown()


@contextlib.contextmanager
def _served(state: LiveState, port: int | None) -> Iterator[int]:
    handler = _handler(state)
    try:
        server = ThreadingHTTPServer((HOST, PORT if port is None else port), handler)
    except OSError as error:
        if port is not None:
            raise ImguError(f"port {port}: {error.strerror}; need a free one, or no --port") from None
        server = ThreadingHTTPServer((HOST, 0), handler)
    server.daemon_threads = True
    with server:
        threading.Thread(target=server.serve_forever, name="live_page", daemon=True).start()
        try:
            yield server.server_address[1]
        finally:
            state.end()
            server.shutdown()


def _handler(state: LiveState) -> type[BaseHTTPRequestHandler]:
    class LivePageHandler(BaseHTTPRequestHandler):
        timeout = 30.0

        def do_GET(self) -> None:
            # A page of another site that has this address under its own name (DNS rebinding) gets nothing.
            if (self.headers.get("Host") or "").partition(":")[0] not in (HOST, "localhost"):
                self.send_error(403)
            elif self.path == "/":
                self._answer("text/html; charset=utf-8", _PAGE.encode())
            elif self.path == "/state":
                self._answer("application/json", json.dumps(state.described()).encode())
            elif self.path == "/frames":
                with contextlib.suppress(OSError):  # the browser went away
                    self._stream()
            else:
                self.send_error(404)

        def _answer(self, kind: str, content: bytes) -> None:
            self.send_response(200)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(content)))
            self.send_header("Content-Security-Policy", _POLICY)
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(content)

        def _stream(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={_BOUNDARY.decode()}")
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            for picture in state.pictures():
                kind = b"image/png" if picture.startswith(_PNG) else b"image/jpeg"
                size = str(len(picture)).encode()
                head = b"--%s\r\nContent-Type: %s\r\nContent-Length: %s\r\n\r\n" % (_BOUNDARY, kind, size)
                self.wfile.write(head + picture + b"\r\n")

        def log_message(self, format: str, *arguments: Any) -> None:
            """Say nothing."""

    return LivePageHandler
