# SPDX-License-Identifier: Apache-2.0
"""How soon poses resume when a camera is killed and started again, with another resolution or encoding each time.

    python benchmarks/camera_restarts.py --times 20 --out restarts.json

The camera is a process of its own that publishes at 30 Hz, and ends by SIGKILL as a driver that crashes. The node's
processor time is also measured before anybody listens. Prints, as JSON, the time from the first image sent to the first
pose, the node's memory, and its share of a processor at rest; exits 1 when poses took longer than 0.5 s, memory grew
by more than 5 MB, or the node used more than 2 % of a core at rest. Needs the `ros` extra.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from imgu_ros.image_files.images import write_image
from imgu_ros.simulate.sequence import Simulation, default_targets, simulate_sequence
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout

_SIZES = ((640, 480), (1280, 720), (320, 240))
_LAYOUTS = {
    "bayer_rggb8": PixelLayout(ColorModel.BAYER, BayerPattern.RGGB),
    "mono8": PixelLayout(ColorModel.MONO),
    "rgb8": PixelLayout(ColorModel.RGB),
}
_LONGEST_S, _MOST_MB, _MOST_AT_REST = 0.5, 5.0, 0.02


def main() -> int:
    """Run it; return the exit code."""
    arguments = _arguments()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", "76")
    if arguments.camera is not None:
        be_camera(arguments.camera)
        return 0
    with tempfile.TemporaryDirectory(prefix="imgu_restarts_") as folder:
        figures = measure(Path(folder), arguments)
    text = json.dumps(figures, indent=2)
    print(text)
    if arguments.out:
        Path(arguments.out).write_text(text + "\n", encoding="utf-8")
    return 0 if figures["ok"] else 1


def measure(folder: Path, arguments: argparse.Namespace) -> dict[str, Any]:
    """Start the node, then one camera after the other; return the figures."""
    import rclpy
    from geometry_msgs.msg import PoseWithCovarianceStamped

    target = folder / "poster.png"
    write_image(target, default_targets(1)[0].pixels)
    node = subprocess.Popen(
        [sys.executable, "-m", "imgu_ros.cli.main", "node", "perception", "-p", f"targets.images:=[{target}]", "-p",
         "targets.widths_m:=[0.5]"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        cwd=Path(__file__).resolve().parents[1],
    )  # fmt: skip
    out = node.stdout
    assert out is not None
    lines: list[str] = []
    threading.Thread(target=lambda: lines.extend(iter(out.readline, "")), daemon=True).start()
    resumed_s: list[float] = []
    memory_mb: list[float] = []
    try:
        while not any("targets: poster" in line for line in lines):
            time.sleep(0.1)
        time.sleep(2.0)
        at_rest = _share_of_core(node.pid, arguments.rest)
        rclpy.init(args=[])
        peer = rclpy.create_node("listener", enable_rosout=False)
        poses: list[int] = []
        peer.create_subscription(PoseWithCovarianceStamped, "/pose", lambda _: poses.append(time.time_ns()), 10)
        for number in range(arguments.times):
            resumed_s.append(_one_camera(peer, poses, number))
            memory_mb.append(_resident_mb(node.pid))
        lived = node.poll() is None
    finally:
        node.send_signal(signal.SIGINT)
        try:
            node.wait(10)
        finally:
            if node.poll() is None:
                node.kill()
        rclpy.try_shutdown()
    complaints = [line for line in lines if "[ERROR]" in line or "Traceback" in line]
    settled = memory_mb[min(len(memory_mb) - 1, 2 * len(_SIZES))]
    grown = memory_mb[-1] - settled
    return {
        "times": arguments.times, "resumed_s_median": sorted(resumed_s)[len(resumed_s) // 2],
        "resumed_s_max": max(resumed_s), "memory_mb": memory_mb, "memory_grown_mb": round(grown, 1),
        "share_of_core_at_rest": at_rest, "node_lived": lived, "complaints": complaints[:5],
        "ok": lived and not complaints and max(resumed_s) <= _LONGEST_S and grown <= _MOST_MB
        and at_rest <= _MOST_AT_REST,
    }  # fmt: skip


def be_camera(number: int) -> None:
    """Publish at 30 Hz until killed; print when the first image went out."""
    import rclpy

    from imgu_ros.messages.camera_info import camera_info_message
    from imgu_ros.messages.header import Header
    from imgu_ros.messages.image import image_message
    from imgu_ros.ros.messages import make_message, message_class
    from imgu_ros.ros.qos import image_qos

    (width, height), encoding = _SIZES[number % len(_SIZES)], list(_LAYOUTS)[number // 2 % len(_LAYOUTS)]
    simulation = Simulation(width=width, height=height, frames=30, layout=_LAYOUTS[encoding])
    frames = [one.frame for one in itertools.islice(simulate_sequence(simulation, default_targets(1)), 6)]
    rclpy.init(args=[])
    node = rclpy.create_node("camera", enable_rosout=False)
    images = node.create_publisher(message_class("sensor_msgs/msg/Image"), "image_raw", image_qos())
    infos = node.create_publisher(message_class("sensor_msgs/msg/CameraInfo"), "camera_info", image_qos())
    while not (images.get_subscription_count() and infos.get_subscription_count()):
        time.sleep(0.01)
    time.sleep(0.2)
    print(time.time_ns(), flush=True)
    for index in itertools.count():
        frame = frames[min(index % 10, 10 - index % 10)]
        header = Header(time.time_ns(), "camera")
        assert frame.camera is not None
        infos.publish(camera_info_message(make_message, header, frame.camera))
        images.publish(image_message(make_message, header, frame.image.pixels, encoding))
        time.sleep(1 / 30)


def _one_camera(peer: Any, poses: list[int], number: int) -> float:
    """Start a camera, wait for poses, kill it; return the time from its first image to the first pose."""
    import rclpy

    camera = subprocess.Popen([sys.executable, __file__, "--camera", str(number)], stdout=subprocess.PIPE, text=True)
    first: list[int] = []
    out = camera.stdout
    assert out is not None
    threading.Thread(target=lambda: first.append(int(out.readline() or 0)), daemon=True).start()
    poses.clear()
    try:
        end = time.monotonic() + 60
        while len(poses) < 10 and time.monotonic() < end:
            rclpy.spin_once(peer, timeout_sec=0.02)
    finally:
        camera.kill()
        camera.wait()
    return (poses[0] - first[0]) / 1e9 if poses and first else float("inf")


def _share_of_core(pid: int, seconds: float) -> float:
    def used_s() -> float:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    before, start = used_s(), time.monotonic()
    time.sleep(seconds)
    return round((used_s() - before) / (time.monotonic() - start), 4)


def _resident_mb(pid: int) -> float:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return round(next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024, 1)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("--rest", type=float, default=20.0, metavar="S", help="seconds of rest to measure")
    parser.add_argument("--out", metavar="FILE")
    parser.add_argument("--camera", type=int, help=argparse.SUPPRESS)
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
