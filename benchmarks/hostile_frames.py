# SPDX-License-Identifier: Apache-2.0
"""Frames made to break a node, over the wire: it lives, says why it rejects them, and the next good one gives a pose.

    python benchmarks/hostile_frames.py --messages 10000 --out hostile.json

Half of the messages are sensor_msgs/Image, half CompressedImage, each kind to a node of its own, with camera_info that
lies as well: sizes, row lengths, encodings, stamps, cut and damaged files, pictures that fill the memory, calibrations
that are no numbers. Every so often a good frame follows. Prints what became of them as JSON; exits 1 when a node ended,
complained of an error of its own, rejected without a reason, or gave no pose for a good frame. Needs the `ros` extra.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hostile_messages import Liar

from imgu_ros.image_files.images import write_image
from imgu_ros.simulate.sequence import Simulation, default_targets, simulate_sequence

_FRAME_IDS = ("camera", "", "/a b", "x" * 1000, "ü")
_TRANSPORTS = ("raw", "compressed")
#: Of the bad messages every so often the image is good, and camera_info alone lies.
_READABLE_EVERY = 10


def main() -> int:
    """Run it; return the exit code."""
    arguments = _arguments()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", "78")
    with tempfile.TemporaryDirectory(prefix="imgu_hostile_") as folder:
        figures = {transport: Trial(Path(folder), transport, arguments).run() for transport in _TRANSPORTS}
    text = json.dumps(figures | {"ok": all(f["ok"] for f in figures.values())}, indent=2)
    print(text)
    if arguments.out:
        Path(arguments.out).write_text(text + "\n", encoding="utf-8")
    return 0 if all(f["ok"] for f in figures.values()) else 1


class Trial:
    """A node with one transport, and what is sent to it."""

    def __init__(self, folder: Path, transport: str, arguments: argparse.Namespace) -> None:
        self._transport, self._arguments = transport, arguments
        target = default_targets(1)[0]
        write_image(folder / "poster.png", target.pixels)
        self._target = folder / "poster.png"
        self._good = next(iter(simulate_sequence(Simulation(width=320, height=240, frames=1)))).frame
        assert self._good.camera is not None
        self._liar = Liar(random.Random(arguments.seed), self._good.camera.K, (320, 240), _FRAME_IDS)
        self._statuses: list[Any] = []
        self._poses: list[Any] = []
        self._lines: list[str] = []

    def run(self) -> dict[str, Any]:
        """Send everything; return what became of it."""
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import PoseWithCovarianceStamped
        from sensor_msgs.msg import CameraInfo, CompressedImage, Image

        from imgu_ros.ros.qos import output_qos

        process = self._start()
        context = rclpy.Context()
        rclpy.init(args=[], context=context)
        self._node = node = rclpy.create_node("sender", context=context, enable_rosout=False)
        self._executor = rclpy.executors.SingleThreadedExecutor(context=context)
        self._executor.add_node(node)
        kind, topic = (Image, "image_raw") if self._transport == "raw" else (CompressedImage, "image_raw/compressed")
        self._images = node.create_publisher(kind, topic, output_qos(20))
        self._infos = node.create_publisher(CameraInfo, "camera_info", output_qos(20))
        node.create_subscription(DiagnosticArray, "/status", self._statuses.append, 1000)
        node.create_subscription(PoseWithCovarianceStamped, "/pose", self._poses.append, 100)
        try:
            self._wait(lambda: self._images.get_subscription_count() and self._infos.get_subscription_count(), 90)
            self._wait(lambda: node.count_publishers("/pose") and node.count_publishers("/status"), 20)
            answered = [self._good_frame()]
            before = _resident_mb(process.pid)
            largest = before
            for number in range(self._arguments.messages // 2):
                info = self._liar.info(CameraInfo())
                self._infos.publish(info)
                if number % _READABLE_EVERY == 0:  # its camera_info lies all the same
                    self._images.publish(self._good_image(info.header))
                else:
                    self._images.publish(self._liar.image(kind()))
                self._spin(1 / self._arguments.rate)
                if number % 500 == 499:
                    answered.append(self._good_frame())
                    largest = max(largest, _resident_mb(process.pid))
            answered.append(self._good_frame())
            after = _resident_mb(process.pid)
            lived = process.poll() is None
        finally:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(10)
            finally:
                if process.poll() is None:
                    process.kill()
                self._executor.shutdown()
                context.try_shutdown()
        messages = [s.message for m in self._statuses for s in m.status]
        reasons = Counter(message.partition("(")[2].partition(":")[0] for message in messages
                          if message.startswith("rejected:"))  # fmt: skip
        uncalibrated = sum("camera_info" in message for message in messages if not message.startswith("rejected:"))
        silent = messages.count("rejected")
        errors = [line for line in self._lines if "[ERROR]" in line or "Traceback" in line]
        good = sum(took is not None for took in answered)
        return {
            "sent": self._arguments.messages // 2, "statuses": len(self._statuses), "rejected": sum(reasons.values()),
            "reasons": dict(reasons), "rejected_without_reason": silent, "uncalibrated": uncalibrated,
            "good_frames": len(answered), "good_frames_with_pose": good,
            "slowest_answer_s": max((took for took in answered if took is not None), default=None),
            "memory_before_mb": before, "memory_largest_mb": largest, "memory_after_mb": after, "node_lived": lived,
            "errors": errors[:5], "exit_code": process.returncode,
            "ok": lived and good == len(answered) and not silent and not errors and bool(reasons),
        }  # fmt: skip

    def _start(self) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-m", "imgu_ros.cli.main", "node", "perception", "-p", f"targets.images:=[{self._target}]",
             "-p", "targets.widths_m:=[0.5]", "-p", f"image_transport:={self._transport}"],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=Path(__file__).resolve().parents[1],
        )  # fmt: skip
        out = process.stdout
        assert out is not None
        threading.Thread(target=lambda: self._lines.extend(iter(out.readline, "")), daemon=True).start()
        return process

    def _good_frame(self) -> float | None:
        """Send a good frame until its pose comes; return how long that took, None when none came."""
        from imgu_ros.messages.camera_info import camera_info_message
        from imgu_ros.messages.header import Header
        from imgu_ros.ros.messages import make_message

        camera = self._good.camera
        assert camera is not None
        start = time.monotonic()
        while time.monotonic() < start + 30:
            header = Header(time.time_ns(), "camera")
            self._infos.publish(camera_info_message(make_message, header, camera))
            self._images.publish(self._good_image(header))
            before = len(self._poses)
            if self._wait(lambda before=before: len(self._poses) > before, 1.0):
                return time.monotonic() - start
        return None

    def _good_image(self, header: Any) -> Any:
        """Return the good frame's image with a header, ours or a message's."""
        from imgu_ros.messages.compressed_image import compressed_image_message
        from imgu_ros.messages.header import Header
        from imgu_ros.messages.image import image_message
        from imgu_ros.ros.messages import make_message

        pixels, ours = self._good.image.pixels, header if isinstance(header, Header) else Header(0, "camera")
        if self._transport == "raw":
            message = image_message(make_message, ours, pixels, "bayer_rggb8")
        else:
            message = compressed_image_message(make_message, ours, pixels, "bayer_rggb8", file_format="png")
        if ours is not header:
            message.header = header
        return message

    def _wait(self, condition: Any, timeout_s: float) -> bool:
        end = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > end:
                return False
            self._executor.spin_once(timeout_sec=0.02)
        return True

    def _spin(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left)


def _resident_mb(pid: int) -> float:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return round(next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024, 1)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--messages", type=int, default=10_000)
    parser.add_argument("--rate", type=float, default=200.0, metavar="HZ", help="messages a second")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", metavar="FILE")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
