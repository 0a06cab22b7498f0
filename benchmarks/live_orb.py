# SPDX-License-Identifier: Apache-2.0
"""Measure the live node beside the node that people write today, on the same topic at the same time.

    python benchmarks/live_orb.py --size 1280x720 --rate 15 --seconds 30 --out live_orb.json

Four processes: a player of a simulated Bayer bag, `imgu node perception`, `orb_node.py` (rclpy and OpenCV's ORB), and a
listener. Prints, as JSON, for each of the two nodes: its poses, its CPU time a frame, and how long a pose took from the
arrival of the frame's camera_info at the listener, with the ratios. Needs the `ros` extra.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from live import IMAGE_TOPIC, INFO_TOPIC, cpu_s, write_bag

from imgu_ros.messages.header import decode_header
from imgu_ros.ros.middleware import PROFILE_VARIABLE, profile_path

_START_S = 4.0
_TAIL_S = 1.0
_MOST_LATE_S = 60.0


@dataclass(frozen=True)
class NodeFigures:
    """What was measured of one node."""

    poses: int
    cpu_ms_a_frame: float
    latency_p50_ms: float
    latency_p95_ms: float
    latency_p99_ms: float


def main() -> int:
    """Measure and print."""
    arguments = _arguments()
    width, height = (int(part) for part in arguments.size.split("x"))
    frames = round(arguments.seconds * arguments.rate)
    with tempfile.TemporaryDirectory(prefix="imgu_live_orb_", dir=arguments.scratch) as folder:
        write_bag(Path(folder), (width, height), arguments.rate, frames, arguments.round)
        os.sync()
        ours, orb = _measured(Path(folder), arguments, frames)
    figures = {
        "size": arguments.size,
        "rate_hz": arguments.rate,
        "frames": frames,
        "imgu": asdict(ours),
        "orb": asdict(orb),
        "cpu_ratio": round(orb.cpu_ms_a_frame / ours.cpu_ms_a_frame, 2),
        "latency_p50_ratio": round(orb.latency_p50_ms / ours.latency_p50_ms, 2),
        "cpu_count": os.cpu_count(),
    }
    text = json.dumps(figures, indent=2)
    print(text)
    if arguments.out:
        arguments.out.write_text(text + "\n", encoding="utf-8")
    return 0


def _measured(folder: Path, arguments: argparse.Namespace, frames: int) -> tuple[NodeFigures, NodeFigures]:
    os.environ["ROS_DOMAIN_ID"] = str(arguments.domain)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ[PROFILE_VARIABLE] = str(profile_path())
    imgu = [sys.executable, "-m", "imgu_ros.cli.main"]
    picture, remap = folder / "poster.png", ["-r", f"image_raw:={IMAGE_TOPIC}"]
    targets = ["-p", f"targets.images:=[{picture}]", "-p", "targets.widths_m:=[0.5]"]
    orb_node = Path(__file__).with_name("orb_node.py")
    nodes = [
        subprocess.Popen([*imgu, "node", "perception", *targets, *remap]),
        subprocess.Popen([sys.executable, str(orb_node), str(picture), "0.5", "--ros-args", *remap]),
    ]
    player = None
    try:
        listener = _Listener(["/pose", "/orb/pose"])
        listener.spin_until(lambda: False, _START_S)  # both have started by then
        before_s = [cpu_s(node.pid) for node in nodes]
        play = [*imgu, "play", str(folder / "bag"), "--wait-for", "2", "--timeout", "30"]
        player = subprocess.Popen(play, stdout=subprocess.DEVNULL)
        listener.spin_until(lambda: player.poll() is not None, arguments.seconds + _MOST_LATE_S)
        if player.poll() != 0:
            raise SystemExit(f"imgu play: exit code {player.poll()}")
        listener.spin_until(lambda: False, _TAIL_S)
        busy_s = [cpu_s(node.pid) - before for node, before in zip(nodes, before_s, strict=True)]
    finally:
        for process in (*nodes, player):
            if process is not None and process.poll() is None:
                process.terminate()
                try:
                    process.wait(10)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()
    listener.close()
    ours, orb = (
        _figures(listener.came_s, posed_s, busy, frames) for posed_s, busy in zip(listener.posed_s, busy_s, strict=True)
    )
    return ours, orb


class _Listener:
    """Hears camera_info and the poses of both, and notes when."""

    def __init__(self, topics: list[str]) -> None:
        import rclpy
        from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node
        from sensor_msgs.msg import CameraInfo

        from imgu_ros.ros.qos import camera_info_qos, output_qos

        rclpy.init(args=[])
        self._node = Node("listener", start_parameter_services=False, enable_rosout=False)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self.came_s: dict[int, float] = {}
        self.posed_s: list[dict[int, float]] = [{} for _ in topics]
        self._hear(INFO_TOPIC, CameraInfo, self.came_s, camera_info_qos())
        for topic, type_, times in zip(topics, (PoseWithCovarianceStamped, PoseStamped), self.posed_s, strict=True):
            self._hear(topic, type_, times, output_qos(50))

    def _hear(self, topic: str, type_: Any, times: dict[int, float], qos: Any) -> None:
        def note(message: Any) -> None:
            times.setdefault(decode_header(message).stamp_ns, time.monotonic())

        self._node.create_subscription(type_, topic, note, qos)

    def spin_until(self, done: Any, at_most_s: float) -> None:
        """Note what comes until `done()`, or the time is over."""
        end = time.monotonic() + at_most_s
        while not done() and time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.1)

    def close(self) -> None:
        """Leave the graph."""
        import rclpy

        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.shutdown()


def _figures(came_s: dict[int, float], posed_s: dict[int, float], busy_s: float, frames: int) -> NodeFigures:
    latencies = [posed_s[stamp] - came_s[stamp] for stamp in posed_s if stamp in came_s]
    if not latencies:
        raise SystemExit("a node had no pose at all; see above")
    p50, p95, p99 = np.percentile(latencies, (50, 95, 99)) * 1e3
    return NodeFigures(
        poses=len(posed_s),
        cpu_ms_a_frame=round(busy_s / frames * 1e3, 1),
        latency_p50_ms=round(float(p50), 2),
        latency_p95_ms=round(float(p95), 2),
        latency_p99_ms=round(float(p99), 2),
    )


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="1280x720", metavar="WxH")
    parser.add_argument("--rate", type=float, default=15.0, metavar="HZ", help="so low that both can follow")
    parser.add_argument("--seconds", type=float, default=30.0, metavar="S")
    parser.add_argument("--round", type=int, default=120, metavar="N", help="frames of a full roll")
    parser.add_argument("--domain", type=int, default=78, metavar="ID", help="ROS domain of the measurement")
    parser.add_argument("--scratch", type=Path, metavar="DIR", help="folder for the bag")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the JSON there too")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
