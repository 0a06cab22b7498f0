# SPDX-License-Identifier: Apache-2.0
"""Measure the live path: a player, the node `perception` and a listener, three processes on this machine.

    python benchmarks/live.py --size 1920x1080 --rate 15 --seconds 60 --out live.json

Writes a simulated Bayer bag first (one round of a smooth motion, again and again), plays it at its own rate, and
prints what was lost (published, never delivered), skipped (replaced by a newer frame before it was worked on), and how
long each pose took, as JSON. Needs the `ros` extra.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from imgu_ros.bags.messages import make_message
from imgu_ros.bags.writing import BagWriter
from imgu_ros.image_files.images import write_image
from imgu_ros.messages.camera_info import camera_info_message
from imgu_ros.messages.header import Header, decode_header
from imgu_ros.messages.image import image_message
from imgu_ros.ros.middleware import PROFILE_VARIABLE, profile_path
from imgu_ros.simulate.sequence import Simulation, default_targets, simulate_sequence

START_NS = 1_700_000_000_000_000_000
IMAGE_TOPIC = "/camera/image_raw"
INFO_TOPIC = "/camera/camera_info"
_DEADLINE_S = 60.0


@dataclass(frozen=True)
class Figures:
    """What was measured. Latency: from the arrival of a frame's camera_info at the listener to that of its pose."""

    size: str
    rate_hz: float
    seconds: float
    profile: bool
    published: int
    delivered: int
    lost: int
    poses: int
    skipped_before_first_pose: int
    skipped_after_first_pose: int
    latency_p50_ms: float
    latency_p95_ms: float
    latency_p99_ms: float
    latency_max_ms: float
    node_rss_mb: float
    node_cpu_ms_a_frame: float
    played: str
    sigint_exit_code: int
    sigint_exit_s: float
    cpu_count: int
    load_average_before: float


@dataclass(frozen=True)
class _Node:
    rss_mb: float
    busy_s: float
    exit_code: int
    exit_s: float


def main() -> int:
    """Measure and print."""
    arguments = _arguments()
    width, height = (int(part) for part in arguments.size.split("x"))
    with tempfile.TemporaryDirectory(prefix="imgu_live_", dir=arguments.scratch) as folder:
        count = round(arguments.seconds * arguments.rate)
        write_bag(Path(folder), (width, height), arguments.rate, count, arguments.round)
        # What is still to be written to the disk would hold up those who read from it.
        os.sync()
        figures = measure(Path(folder), arguments, count)
    text = json.dumps(asdict(figures), indent=2)
    print(text)
    if arguments.out:
        arguments.out.write_text(text + "\n", encoding="utf-8")
    return 0


def write_bag(folder: Path, size: tuple[int, int], rate_hz: float, count: int, around: int) -> None:
    """Write `poster.png` and `bag`, `count` messages of a motion that comes round every `around` frames."""
    target = default_targets(1)[0]
    write_image(folder / "poster.png", target.pixels)
    # The last frame of the motion is the first one again.
    simulation = Simulation(width=size[0], height=size[1], frames=around + 1, rate_hz=rate_hz)
    frames = [simulated.frame for simulated in islice(simulate_sequence(simulation, [target]), min(around, count))]
    with BagWriter(folder / "bag") as bag:
        for index in range(count):
            frame = frames[index % around]
            header = Header(START_NS + round(index * 1e9 / rate_hz), frame.frame_id)
            info = camera_info_message(make_message, header, frame.camera)
            bag.write(INFO_TOPIC, info, header.stamp_ns)
            image = image_message(make_message, header, frame.image.pixels, "bayer_rggb8")
            bag.write(IMAGE_TOPIC, image, header.stamp_ns)


def measure(folder: Path, arguments: argparse.Namespace, count: int) -> Figures:
    """Run the three processes and return what came out."""
    os.environ["ROS_DOMAIN_ID"] = str(arguments.domain)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.pop(PROFILE_VARIABLE, None)
    if arguments.no_profile:
        # The commands leave those alone who choose their transports themselves.
        os.environ["FASTDDS_BUILTIN_TRANSPORTS"] = "DEFAULT"
    else:
        os.environ[PROFILE_VARIABLE] = str(profile_path())
    load = os.getloadavg()[0]
    imgu = [sys.executable, "-m", "imgu_ros.cli.main"]
    targets = ["-p", f"targets.images:=[{folder / 'poster.png'}]", "-p", "targets.widths_m:=[0.5]"]
    node = subprocess.Popen([*imgu, "node", "perception", *targets, "-r", f"image_raw:={IMAGE_TOPIC}"])
    player = None
    try:
        listener = _Listener()
        time.sleep(3.0)  # the node has started by then
        busy_s = cpu_s(node.pid)
        player = subprocess.Popen(
            [*imgu, "play", str(folder / "bag"), "--wait-for", "1", "--timeout", "30"],
            stdout=subprocess.PIPE,
            text=True,
        )
        listener.listen(player, count / arguments.rate + _DEADLINE_S)
        played = player.communicate(timeout=10)[0]
        rss_mb = _rss_mb(node.pid)
        busy_s = cpu_s(node.pid) - busy_s
        started = time.monotonic()
        node.send_signal(signal.SIGINT)
        exit_code = node.wait(10)
        exit_s = time.monotonic() - started
    finally:
        for process in (node, player):
            if process is not None and process.poll() is None:
                process.kill()
                process.wait()
    listener.close()
    return _figures(arguments, listener, played, _Node(rss_mb, busy_s, exit_code, exit_s), load)


class _Listener:
    """Hears poses, status and diagnostics, and notes when; it is the third process."""

    def __init__(self) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node

        from imgu_ros.ros.messages import message_class
        from imgu_ros.ros.qos import camera_info_qos, output_qos

        rclpy.init(args=[])
        self._node = Node("listener", start_parameter_services=False, enable_rosout=False)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self.came_s: dict[int, float] = {}
        self.posed_s: dict[int, float] = {}
        self.processed: set[int] = set()
        self.delivered = 0

        def hear(topic: str, type_name: str, note: Any, qos: Any) -> None:
            self._node.create_subscription(message_class(type_name), topic, note, qos)

        now = time.monotonic
        hear(
            INFO_TOPIC, "sensor_msgs/msg/CameraInfo",
            lambda m: self.came_s.setdefault(decode_header(m).stamp_ns, now()), camera_info_qos(),
        )  # fmt: skip
        hear(
            "/pose", "geometry_msgs/msg/PoseWithCovarianceStamped",
            lambda m: self.posed_s.setdefault(decode_header(m).stamp_ns, now()), output_qos(50),
        )  # fmt: skip
        array = "diagnostic_msgs/msg/DiagnosticArray"
        hear("/status", array, lambda m: self.processed.add(decode_header(m).stamp_ns), output_qos(50))
        hear("/diagnostics", array, self._note_diagnostics, output_qos(10))

    def listen(self, player: subprocess.Popen[str], deadline_s: float) -> None:
        """Spin until the player has ended and the last diagnostics have come."""
        end = time.monotonic() + deadline_s
        while player.poll() is None and time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.1)
        until = time.monotonic() + 2.5
        while time.monotonic() < until:
            self._executor.spin_once(timeout_sec=0.1)

    def close(self) -> None:
        """Leave the graph."""
        import rclpy

        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.shutdown()

    def _note_diagnostics(self, message: Any) -> None:
        for entry in message.status:
            values = {value.key: value.value for value in entry.values}
            if entry.name.endswith(": input"):
                self.delivered = int(values["frames"])


def _figures(
    arguments: argparse.Namespace,
    heard: _Listener,
    played: str,
    node: _Node,
    load: float,
) -> Figures:
    published = int((re.search(rf"{IMAGE_TOPIC} (\d+)", played) or [0, 0])[1])
    stamps = [START_NS + round(index * 1e9 / arguments.rate) for index in range(published)]
    first_pose_s = min(heard.posed_s.values(), default=0.0)
    missing = [stamp for stamp in stamps if stamp not in heard.processed]
    lost = published - heard.delivered
    latencies = [heard.posed_s[s] - heard.came_s[s] for s in heard.posed_s if s in heard.came_s]
    percentiles = np.percentile(latencies, (50, 95, 99, 100)) * 1e3 if latencies else np.full(4, np.nan)
    # A frame that came while the first pose was being found.
    before = sum(heard.came_s.get(stamp, 0.0) < first_pose_s for stamp in missing)
    return Figures(
        size=arguments.size,
        rate_hz=arguments.rate,
        seconds=arguments.seconds,
        profile=not arguments.no_profile,
        published=published,
        delivered=heard.delivered,
        lost=lost,
        poses=len(heard.posed_s),
        skipped_before_first_pose=before,
        skipped_after_first_pose=len(missing) - before - lost,
        latency_p50_ms=round(float(percentiles[0]), 2),
        latency_p95_ms=round(float(percentiles[1]), 2),
        latency_p99_ms=round(float(percentiles[2]), 2),
        latency_max_ms=round(float(percentiles[3]), 2),
        node_rss_mb=round(node.rss_mb, 1),
        node_cpu_ms_a_frame=round(node.busy_s / max(1, len(heard.processed)) * 1e3, 1),
        played=" ".join(played.split("\n")[1:]).strip(),
        sigint_exit_code=node.exit_code,
        sigint_exit_s=round(node.exit_s, 3),
        cpu_count=os.cpu_count() or 0,
        load_average_before=round(load, 2),
    )


def _rss_mb(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def cpu_s(pid: int) -> float:
    """Return the CPU time that a process has used, s."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="1920x1080", metavar="WxH")
    parser.add_argument("--rate", type=float, default=15.0, metavar="HZ")
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S")
    parser.add_argument(
        "--round",
        type=int,
        default=120,
        metavar="N",
        help="frames of a full roll: 120 turn the camera by 3 degrees from frame to frame",
    )
    parser.add_argument("--no-profile", action="store_true", help="without the DDS profile for large images")
    parser.add_argument("--domain", type=int, default=77, metavar="ID", help="ROS domain of the measurement")
    parser.add_argument("--scratch", type=Path, metavar="DIR", help="folder for the bag (2 MB a frame)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the JSON there too")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
