# SPDX-License-Identifier: Apache-2.0
"""Run the pipeline on two hosts of one machine: two network namespaces with a cable between them.

    python benchmarks/two_hosts.py --frames 100 --rate 10 --split keypoints --out two_hosts.json

The first host has the camera and the stages up to `--split`, the second the rest and a listener; each has its own
shared memory, so that everything between them goes through the cable, by UDP. Prints as JSON how many frames came out
at the other end, when, and what went through the cable. `--without-picture` spares the cable `image_mono`, with which
`homography` looks whether a target is there.

Needs Linux, `ip`, `unshare` and `nsenter`, and the permission to make namespaces: root, or a kernel that gives it to
users. Where that is missing, it says so and exits with 77.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

STAGES = ("demosaic", "pyramid", "features", "matcher", "homography", "pose")
#: What goes through the cable, and how many stages are before it.
SPLITS = {"raw": 0, "reduced": 1, "pyramid": 2, "keypoints": 3, "matches": 4, "homography": 5}
SKIPPED = 77
_INSIDE = "IMGU_TWO_HOSTS"
_LEFT, _RIGHT = "10.77.0.1", "10.77.0.2"
_START_S = 90.0


@dataclass(frozen=True)
class Figures:
    """What was measured. Latency: from the sending of the image on one host to the pose's status on the other."""

    size: str
    rate_hz: float
    split: str
    picture_crosses: bool
    sent: int
    came_out: int
    posed: int
    latency_p50_ms: float
    latency_p95_ms: float
    bytes_a_frame: float
    megabits_a_second: float
    bytes_a_second_at_rest: float


def main() -> int:
    """Measure and print."""
    arguments = _arguments()
    if arguments.listen:
        return _listen(arguments.listen)
    if os.environ.get(_INSIDE) != "1":
        reason = _why_not()
        if reason:
            print(f"skipped: {reason}")
            return SKIPPED
        environment = {**os.environ, _INSIDE: "1"}
        inside = ["unshare", "--map-root-user", "--net", "--mount", "--fork", sys.executable, *sys.argv]
        return subprocess.run(inside, env=environment, check=False).returncode
    figures = _measured(arguments)
    text = json.dumps(asdict(figures), indent=2)
    print(text)
    if arguments.out:
        arguments.out.write_text(text + "\n", encoding="utf-8")
    return 0 if figures.came_out else 1


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--rate", type=float, default=10.0)
    parser.add_argument("--split", choices=list(SPLITS), default="keypoints", help="what goes through the cable")
    parser.add_argument("--without-picture", action="store_true", help="homography does without image_mono")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--listen", type=Path, help=argparse.SUPPRESS)
    return parser.parse_args()


def _why_not() -> str:
    if sys.platform != "linux":
        return "network namespaces need Linux"
    missing = [name for name in ("unshare", "nsenter", "ip", "mount") if not shutil.which(name)]
    if missing:
        return f"no {', '.join(missing)} (packages util-linux, iproute2)"
    cable = "ip link add imgu0 type veth peer name imgu1 && mount -t tmpfs none /dev/shm"
    tried = ["unshare", "--map-root-user", "--net", "--mount", "sh", "-c", cable]
    result = subprocess.run(tried, capture_output=True, text=True, check=False)
    said = " ".join(result.stderr.split())
    return f"network namespaces are not allowed here ({said})" if result.returncode else ""


def _measured(arguments: argparse.Namespace) -> Figures:
    # What the two hosts have of their own: network, shared memory.
    other = subprocess.Popen(["unshare", "--net", "--mount", "sleep", "infinity"])
    started: list[subprocess.Popen[bytes]] = []
    try:
        with tempfile.TemporaryDirectory() as folder:
            _connect(other.pid)
            return _run(arguments, Path(folder), _there(other.pid), started)
    finally:
        for process in started:
            process.send_signal(signal.SIGINT)
        for process in started:
            process.wait(10)
        other.kill()
        other.wait(5)


def _there(pid: int) -> list[str]:
    """Return what puts a command on the second host."""
    return ["nsenter", f"--target={pid}", "--net", "--mount", f"--wd={Path.cwd()}"]


def _connect(pid: int) -> None:
    time.sleep(0.3)
    there = _there(pid)
    for command in (
        ["ip", "link", "add", "cable", "type", "veth", "peer", "name", "cable", "netns", str(pid)],
        *([*host, "mount", "-t", "tmpfs", "none", "/dev/shm"] for host in ([], there)),
        *([*host, "ip", "link", "set", "lo", "up"] for host in ([], there)),
        ["ip", "addr", "add", f"{_LEFT}/24", "dev", "cable"],
        [*there, "ip", "addr", "add", f"{_RIGHT}/24", "dev", "cable"],
        *([*host, "ip", "link", "set", "cable", "up"] for host in ([], there)),
        *([*host, "ip", "route", "add", "224.0.0.0/4", "dev", "cable"] for host in ([], there)),
    ):
        subprocess.run(command, check=True)


def _run(
    arguments: argparse.Namespace, folder: Path, there: list[str], started: list[subprocess.Popen[bytes]]
) -> Figures:
    os.environ.update(ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET", ROS_DOMAIN_ID="7", ROS_LOG_DIR=str(folder / "log"))
    frames, target = _simulated(arguments, folder)
    given = [f"targets.images:=[{target}]", "targets.widths_m:=[0.5]"]
    given += ["tracking.enabled:=false", "refinement.enabled:=false", "search.thorough:=false"]
    parameters = [part for value in given for part in ("-p", value)] + ["-r", "__ns:=/cam"]
    for position, name in enumerate(STAGES):
        host = [] if position < SPLITS[arguments.split] else there
        spared = ["-r", "image_mono:=nowhere"] if arguments.without_picture and name == "homography" else []
        command = [*host, sys.executable, "-m", "imgu_ros.cli.main", "node", name, *parameters, *spared]
        started.append(subprocess.Popen(command, stderr=subprocess.DEVNULL))
    heard = folder / "heard.json"
    listener = subprocess.Popen([*there, sys.executable, str(Path(__file__).resolve()), "--listen", str(heard)])
    try:
        sent, crossed, rest = _send(frames, arguments.rate)
    finally:
        listener.send_signal(signal.SIGTERM)
        listener.wait(20)
    came = {int(stamp): value for stamp, value in json.loads(heard.read_text()).items()}
    took = [(came[stamp][0] - at) * 1e3 for stamp, at in sent.items() if stamp in came]
    seconds = len(sent) / arguments.rate
    moved = crossed - rest * seconds
    return Figures(
        size=arguments.size,
        rate_hz=arguments.rate,
        split=arguments.split,
        picture_crosses=not arguments.without_picture and SPLITS[arguments.split] in (1, 2, 3, 4),
        sent=len(sent),
        came_out=len(took),
        posed=sum(came[stamp][1] for stamp in sent if stamp in came),
        latency_p50_ms=float(np.percentile(took, 50)) if took else 0.0,
        latency_p95_ms=float(np.percentile(took, 95)) if took else 0.0,
        bytes_a_frame=moved / len(sent),
        megabits_a_second=moved * 8e-6 / seconds,
        bytes_a_second_at_rest=rest,
    )


def _simulated(arguments: argparse.Namespace, folder: Path) -> tuple[list[Any], Path]:
    from imgu_ros.image_files.images import write_image
    from imgu_ros.simulate.sequence import Simulation, default_targets, simulate_sequence

    width, height = map(int, arguments.size.split("x"))
    image = default_targets(1, seed=0, width_m=0.5)[0]
    write_image(folder / "poster.png", image.pixels)
    simulation = Simulation(width=width, height=height, frames=arguments.frames)
    return [simulated.frame for simulated in simulate_sequence(simulation, [image])], folder / "poster.png"


def _send(frames: list[Any], rate_hz: float) -> tuple[dict[int, float], float, float]:
    """Play the camera; return when each frame was sent, and the cable's bytes: in all, and a second at rest."""
    import rclpy
    from rclpy.node import Node

    from imgu_ros.messages.camera_info import camera_info_message
    from imgu_ros.messages.header import Header
    from imgu_ros.messages.image import image_message
    from imgu_ros.ros.messages import make_message, message_class
    from imgu_ros.ros.qos import image_qos

    rclpy.init(args=[])
    node = Node("camera", enable_rosout=False)
    image = node.create_publisher(message_class("sensor_msgs/msg/Image"), "/cam/image_raw", image_qos())
    info = node.create_publisher(message_class("sensor_msgs/msg/CameraInfo"), "/cam/camera_info", image_qos())
    end = time.monotonic() + _START_S
    # camera_info: demosaic, homography and pose.
    while not image.get_subscription_count() or info.get_subscription_count() < 3:
        if time.monotonic() > end:
            raise SystemExit(f"the stages did not find each other within {_START_S:.0f} s")
        time.sleep(0.05)
    time.sleep(3.0)
    before = _crossed()
    time.sleep(2.0)
    rest = (_crossed() - before) / 2.0
    before, sent = _crossed(), {}
    due = time.monotonic()
    for frame in frames:
        time.sleep(max(0.0, due - time.monotonic()))
        due += 1 / rate_hz
        header = Header(frame.stamp_ns, frame.frame_id)
        message = image_message(make_message, header, frame.image.pixels, "bayer_rggb8")
        info.publish(camera_info_message(make_message, header, frame.camera))
        sent[frame.stamp_ns] = time.monotonic()
        image.publish(message)
    time.sleep(4.0)
    crossed = _crossed() - before
    node.destroy_node()
    rclpy.try_shutdown()
    return sent, crossed, rest


def _crossed() -> float:
    """Return the bytes that went through the cable, either way."""
    told = subprocess.run(["ip", "-s", "-j", "link", "show", "cable"], capture_output=True, text=True, check=True)
    figures = json.loads(told.stdout)[0]["stats64"]
    return float(figures["rx"]["bytes"] + figures["tx"]["bytes"])


def _listen(path: Path) -> int:
    """Be the listener: write when each frame came out, and whether with a pose, to a file at the end."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node

    from imgu_ros.messages.header import decode_header
    from imgu_ros.ros.messages import message_class
    from imgu_ros.ros.qos import output_qos

    stopped: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda got, _: stopped.append(got))
    rclpy.init(args=[], signal_handler_options=rclpy.SignalHandlerOptions.NO)
    node = Node("listener", enable_rosout=False)
    came: dict[int, tuple[float, bool]] = {}

    def keep(message: Any) -> None:
        metric = any(value.value == "metric" for status in message.status for value in status.values)
        came[decode_header(message).stamp_ns] = (time.monotonic(), metric)

    kind = message_class("diagnostic_msgs/msg/DiagnosticArray")
    node.create_subscription(kind, "/cam/pose/status", keep, output_qos(20))
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not stopped:
        executor.spin_once(timeout_sec=0.05)
    path.write_text(json.dumps(came), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
