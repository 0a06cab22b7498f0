# SPDX-License-Identifier: Apache-2.0
"""Measure the pipeline spread over six processes beside the one of the node `perception`, on the same frames.

    python benchmarks/stages.py --size 640x480 --frames 100 --out stages.json

Each frame is sent to all seven nodes when the one before has come out. Prints as JSON: whether status and corners are
the same, and for each hop the bytes of a frame and when its message was here, counted from the moment the image was
sent (median). Tracking, refinement and the thorough search are off: see docs/stage-nodes.md. Needs the `ros` extra.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(random.randint(1, 100))

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import deserialize_message

from imgu_ros.frame import Frame
from imgu_ros.image_files.images import write_image
from imgu_ros.messages.camera_info import camera_info_message
from imgu_ros.messages.features import decode_homographies
from imgu_ros.messages.header import Header
from imgu_ros.messages.image import image_message
from imgu_ros.ros.messages import make_message, message_class
from imgu_ros.ros.middleware import PROFILE_VARIABLE, profile_path
from imgu_ros.ros.qos import image_qos, output_qos
from imgu_ros.simulate.sequence import Simulation, default_targets, simulate_sequence

STAGES = ("demosaic", "pyramid", "features", "matcher", "homography", "pose")
IMAGE, CLOUD = "sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2"
INFO, STATUS = "sensor_msgs/msg/CameraInfo", "diagnostic_msgs/msg/DiagnosticArray"
HOPS = {
    "image_mono": IMAGE,
    "reduced/image_mono": IMAGE,
    "pyramid/level_0": IMAGE,
    "pyramid/level_1": IMAGE,
    "pyramid/level_2": IMAGE,
    "pyramid/level_3": IMAGE,
    "keypoints": CLOUD,
    "matches": CLOUD,
    "homography": CLOUD,
    "homography/inliers": CLOUD,
    "status": STATUS,
    "pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "pose/status": STATUS,
}
ONE = {"homography": CLOUD, "status": STATUS, "pose": HOPS["pose"]}
OFF = ("tracking.enabled", "refinement.enabled", "search.thorough")
_DEADLINE_S = 60.0
_AGAIN_S = 2.0


@dataclass(frozen=True)
class Hop:
    """One topic: bytes of a frame's message, and when it was here."""

    topic: str
    bytes_a_frame: float
    arrived_p50_ms: float
    arrived_p95_ms: float


@dataclass(frozen=True)
class Figures:
    """What was measured."""

    size: str
    frames: int
    sent_again: int
    found: int
    same_status: int
    largest_corner_difference_px: float
    six: list[Hop]
    one: list[Hop]
    cpu_count: int
    load_average_before: float


class Listener:
    """Hears topics as bytes, and when they came."""

    def __init__(self) -> None:
        rclpy.init(args=[])
        self.node = Node("listener", enable_rosout=False)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.heard: dict[str, dict[int, tuple[float, bytes]]] = defaultdict(dict)

    def hear(self, topic: str, type_name: str) -> None:
        """Subscribe."""

        def keep(content: bytes) -> None:
            seconds, nanoseconds = struct.unpack_from("<iI", content, 4)
            self.heard[topic].setdefault(seconds * 10**9 + nanoseconds, (time.monotonic(), content))

        self.node.create_subscription(message_class(type_name), topic, keep, output_qos(20), raw=True)

    def wait(self, condition: Callable[[], object], what: str, again: Callable[[], None] = lambda: None) -> int:
        """Spin until the condition holds, calling `again` now and then; return how often."""
        repeats, end, due = 0, time.monotonic() + _DEADLINE_S, time.monotonic() + _AGAIN_S
        while not condition():
            now = time.monotonic()
            if now > end:
                raise SystemExit(f"waited {_DEADLINE_S:.0f} s for {what}")
            if now > due:
                again()
                repeats, due = repeats + 1, now + _AGAIN_S
            self.executor.spin_once(timeout_sec=0.02)
        return repeats


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    os.environ.setdefault(PROFILE_VARIABLE, str(profile_path()))
    load = os.getloadavg()[0]
    width, height = map(int, arguments.size.split("x"))
    target = default_targets(1, seed=0, width_m=0.5)[0]
    simulation = Simulation(width=width, height=height, frames=arguments.frames)
    frames = [simulated.frame for simulated in simulate_sequence(simulation, [target])]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "poster.png"
        write_image(path, target.pixels)
        nodes = _start(path)
        try:
            figures = _measured(arguments.size, frames, load)
        finally:
            for node in nodes:
                node.send_signal(signal.SIGINT)
            for node in nodes:
                node.wait(10)
            rclpy.try_shutdown()
    text = json.dumps(asdict(figures), indent=2)
    print(text)
    if arguments.out:
        arguments.out.write_text(text + "\n", encoding="utf-8")
    return 0


def _start(target: Path) -> list[subprocess.Popen[bytes]]:
    given = [f"targets.images:=[{target}]", "targets.widths_m:=[0.5]", *(f"{name}:=false" for name in OFF)]
    parameters = [part for value in given for part in ("-p", value)]
    remaps = ["-r", "image_raw:=/cam/image_raw", "-r", "camera_info:=/cam/camera_info"]
    started = []
    for name in ("perception", *STAGES):
        namespace = ["-r", f"__ns:=/{'one' if name == 'perception' else 'six'}"]
        command = [sys.executable, "-m", "imgu_ros.cli.main", "node", name, *parameters, *remaps, *namespace]
        started.append(subprocess.Popen(command, stderr=subprocess.DEVNULL))
    return started


def _measured(size: str, frames: list[Frame], load: float) -> Figures:
    listener = Listener()
    image = listener.node.create_publisher(message_class(IMAGE), "/cam/image_raw", image_qos())
    info = listener.node.create_publisher(message_class(INFO), "/cam/camera_info", image_qos())
    for prefix, topics in (("/six/", HOPS), ("/one/", ONE)):
        for topic, type_name in topics.items():
            listener.hear(prefix + topic, type_name)
    listener.wait(lambda: image.get_subscription_count() == 2, "the nodes")
    sent: dict[int, float] = {}
    again = 0

    def send(frame: Frame) -> None:
        header = Header(frame.stamp_ns, frame.frame_id)
        assert frame.camera is not None
        message = image_message(make_message, header, frame.image.pixels, "bayer_rggb8")
        info.publish(camera_info_message(make_message, header, frame.camera))
        sent.setdefault(frame.stamp_ns, time.monotonic())
        image.publish(message)

    last = ("/six/pose/status", "/six/status", "/six/image_mono", "/one/status")
    for frame in frames:
        send(frame)
        out = lambda ns=frame.stamp_ns: all(ns in listener.heard[topic] for topic in last)  # noqa: E731
        again += listener.wait(out, f"frame at {frame.stamp_ns}", lambda frame=frame: send(frame))
    stamps = [frame.stamp_ns for frame in frames]
    differences = [_difference(listener.heard, ns) for ns in stamps]
    same = [
        _status(listener.heard["/six/status"][ns][1]) == _status(listener.heard["/one/status"][ns][1]) for ns in stamps
    ]
    return Figures(
        size=size,
        frames=len(frames),
        sent_again=again,
        found=sum(d is not None for d in differences),
        same_status=sum(same),
        largest_corner_difference_px=max((d for d in differences if d is not None), default=0.0),
        six=_hops(listener.heard, sent, "/six/", HOPS),
        one=_hops(listener.heard, sent, "/one/", ONE),
        cpu_count=os.cpu_count() or 1,
        load_average_before=load,
    )


def _hops(heard: Any, sent: dict[int, float], prefix: str, topics: dict[str, str]) -> list[Hop]:
    hops = []
    for topic in topics:
        messages = heard[prefix + topic]
        if not messages:
            continue
        took = [(arrived - sent[ns]) * 1e3 for ns, (arrived, _) in messages.items()]
        size = float(np.mean([len(content) for _, content in messages.values()]))
        hops.append(Hop(topic, size, float(np.percentile(took, 50)), float(np.percentile(took, 95))))
    return hops


def _difference(heard: Any, stamp_ns: int) -> float | None:
    """Return how far the corners of the two lie apart, px; None when neither found the target."""
    H = [_matrix(heard[topic].get(stamp_ns)) for topic in ("/six/homography", "/one/homography")]
    if H[0] is None and H[1] is None:
        return None
    if H[0] is None or H[1] is None:
        return float("inf")
    return float(np.abs(_corners(H[0]) - _corners(H[1])).max())


def _matrix(kept: tuple[float, bytes] | None) -> Any:
    if kept is None:
        return None
    rows = decode_homographies(deserialize_message(kept[1], message_class(CLOUD)))
    return rows[0]["h"].reshape(3, 3) if len(rows) else None


def _corners(H: Any) -> Any:
    x = np.array([[0, 0, 1], [900, 0, 1], [900, 640, 1], [0, 640, 1.0]]) @ H.T
    return x[:, :2] / x[:, 2:]


def _status(content: bytes) -> list[str]:
    message = deserialize_message(content, message_class(STATUS))
    return [value.value for status in message.status for value in status.values if value.key == "status"]


if __name__ == "__main__":
    raise SystemExit(main())
