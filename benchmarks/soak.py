# SPDX-License-Identifier: Apache-2.0
"""Measure the live node over hours of frames, as fast as it goes: its memory and its latency must stay what they were.

    python benchmarks/soak.py --frames 108000 --out soak.json

Two processes: `imgu node perception`, and this one, which publishes simulated 640x480 Bayer frames with their
camera_info, one before the pose of the last has come, and hears poses. Stamps go on by a thirtieth of a second: 108,000
frames are an hour of a camera. Prints as JSON: frames a second, those that were lost, the node's growth (median of
resident less shared memory over the last 5 % of the frames, minus that over the 10th to the 15th %), and the latency
from publishing to the pose in the first and in the last tenth. Needs the `ros` extra.
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
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from live import IMAGE_TOPIC, INFO_TOPIC, START_NS

from imgu_ros.frame import Frame
from imgu_ros.image_files.images import write_image
from imgu_ros.messages.camera_info import camera_info_message
from imgu_ros.messages.header import Header, decode_header
from imgu_ros.messages.image import image_message
from imgu_ros.ros.middleware import PROFILE_VARIABLE, profile_path
from imgu_ros.simulate.sequence import Simulation, default_targets, simulate_sequence

_PERIOD_NS = 33_333_333
_FIRST_POSE_S = 60.0
#: A frame whose pose has not come by then is given up.
_LOST_S = 2.0
_PAGE = os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True)
class Figures:
    """What was measured; memory in MB of 10^6 bytes."""

    size: str
    frames: int
    frames_per_s: float
    without_pose: int
    own_mb_early: float
    own_mb_late: float
    growth_mb: float
    latency_p50_ms_first_tenth: float
    latency_p50_ms_last_tenth: float
    latency_p99_ms_first_tenth: float
    latency_p99_ms_last_tenth: float
    p99_ratio: float
    cpu_count: int


def main() -> int:
    """Measure and print."""
    arguments = _arguments()
    width, height = (int(part) for part in arguments.size.split("x"))
    os.environ["ROS_DOMAIN_ID"] = str(arguments.domain)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ[PROFILE_VARIABLE] = str(profile_path())
    target = default_targets(1)[0]
    # The last frame of the motion is the first one again.
    simulation = Simulation(width=width, height=height, frames=arguments.round + 1, rate_hz=30.0)
    frames = [s.frame for s in islice(simulate_sequence(simulation, [target]), arguments.round)]
    with tempfile.TemporaryDirectory(prefix="imgu_soak_") as folder:
        picture = Path(folder) / "poster.png"
        write_image(picture, target.pixels)
        targets = ["-p", f"targets.images:=[{picture}]", "-p", "targets.widths_m:=[0.5]"]
        node = subprocess.Popen(
            [sys.executable, "-m", "imgu_ros.cli.main", "node", "perception", *targets]
            + ["-r", f"image_raw:={IMAGE_TOPIC}", "--log-level", "error"]
        )
        try:
            figures = _measured(arguments, frames, node.pid)
        finally:
            node.terminate()
            try:
                node.wait(10)
            except subprocess.TimeoutExpired:
                node.kill()
                node.wait()
    text = json.dumps(asdict(figures), indent=2)
    print(text)
    if arguments.out:
        arguments.out.write_text(text + "\n", encoding="utf-8")
    return 0


def _measured(arguments: argparse.Namespace, frames: list[Frame], pid: int) -> Figures:
    feeder = _Feeder(frames)
    feeder.wait_for_first_pose()
    count = arguments.frames
    own = np.zeros(count)
    started = time.monotonic()
    for index in range(count):
        feeder.feed(index, arguments.ahead)
        own[index] = _own_bytes(pid)
        if (index + 1) % (count // 20 or 1) == 0:
            print(f"soak: {index + 1} of {count} frames", file=sys.stderr, flush=True)
    feeder.drain(0)
    seconds = time.monotonic() - started
    feeder.close()
    early = float(np.median(own[int(0.10 * count) : int(0.15 * count)])) / 1e6
    late = float(np.median(own[int(0.95 * count) :])) / 1e6
    latencies = [feeder.latencies_s[part] for part in (slice(None, count // 10), slice(-(count // 10), None))]
    (first50, first99), (last50, last99) = (np.percentile(part, (50, 99)) * 1e3 for part in latencies)
    return Figures(
        size=arguments.size,
        frames=count,
        frames_per_s=round(count / seconds, 1),
        without_pose=feeder.lost,
        own_mb_early=round(early, 2),
        own_mb_late=round(late, 2),
        growth_mb=round(late - early, 2),
        latency_p50_ms_first_tenth=round(float(first50), 2),
        latency_p50_ms_last_tenth=round(float(last50), 2),
        latency_p99_ms_first_tenth=round(float(first99), 2),
        latency_p99_ms_last_tenth=round(float(last99), 2),
        p99_ratio=round(float(last99 / first99), 3),
        cpu_count=os.cpu_count() or 0,
    )


class _Feeder:
    """Publishes frames and hears their poses."""

    def __init__(self, frames: list[Frame]) -> None:
        import rclpy
        from geometry_msgs.msg import PoseWithCovarianceStamped
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node
        from sensor_msgs.msg import CameraInfo, Image

        from imgu_ros.ros.messages import make_message
        from imgu_ros.ros.qos import camera_info_qos, image_qos, output_qos

        rclpy.init(args=[])
        self._node = Node("feeder", start_parameter_services=False, enable_rosout=False)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._images = self._node.create_publisher(Image, IMAGE_TOPIC, image_qos())
        self._infos = self._node.create_publisher(CameraInfo, INFO_TOPIC, camera_info_qos())
        self._node.create_subscription(PoseWithCovarianceStamped, "/pose", self._on_pose, output_qos(50))
        self._messages: list[tuple[Any, Any]] = []
        for frame in frames:
            header = Header(START_NS, frame.frame_id)
            image = image_message(make_message, header, frame.image.pixels, "bayer_rggb8")
            self._messages.append((image, camera_info_message(make_message, header, frame.camera)))
        self._sent_s: dict[int, float] = {}
        self._next_ns = START_NS
        self.latencies_s: list[float] = []
        self.lost = 0

    def wait_for_first_pose(self) -> None:
        """Send the first frame again and again, slowly, until the node has found everybody."""
        end = time.monotonic() + _FIRST_POSE_S
        while not self.latencies_s:
            if time.monotonic() > end:
                raise SystemExit(f"no pose in {_FIRST_POSE_S:g} s; see above")
            self._send(0)
            self.drain(0, 0.2)
        self.drain(0)
        self.latencies_s.clear()
        self.lost = 0

    def feed(self, index: int, ahead: int) -> None:
        """Send a frame, and wait until at most `ahead` have no pose yet."""
        self._send(index)
        self.drain(ahead)

    def drain(self, left: int, at_most_s: float = _LOST_S) -> None:
        """Wait until at most `left` frames have no pose yet; give the rest up after a while."""
        end = time.monotonic() + at_most_s
        while len(self._sent_s) > left:
            if time.monotonic() > end:
                self.lost += len(self._sent_s) - left
                self._sent_s = dict(islice(reversed(self._sent_s.items()), left))
                return
            self._executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        """Leave the graph."""
        import rclpy

        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.shutdown()

    def _send(self, index: int) -> None:
        stamp_ns = self._next_ns
        self._next_ns += _PERIOD_NS
        messages = self._messages[index % len(self._messages)]
        for message, publisher in zip(messages, (self._images, self._infos), strict=True):
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
            publisher.publish(message)
        self._sent_s[stamp_ns] = time.monotonic()

    def _on_pose(self, message: Any) -> None:
        # A pose of a frame that was given up counts as lost.
        sent_s = self._sent_s.pop(decode_header(message).stamp_ns, None)
        if sent_s is not None:
            self.latencies_s.append(time.monotonic() - sent_s)


def _own_bytes(pid: int) -> int:
    fields = Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()
    return (int(fields[1]) - int(fields[2])) * _PAGE


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="640x480", metavar="WxH")
    parser.add_argument("--frames", type=int, default=108_000, metavar="N")
    parser.add_argument("--round", type=int, default=120, metavar="N", help="frames of a full roll")
    parser.add_argument("--ahead", type=int, default=1, metavar="N", help="frames sent before their poses have come")
    parser.add_argument("--domain", type=int, default=79, metavar="ID", help="ROS domain of the measurement")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the JSON there too")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
