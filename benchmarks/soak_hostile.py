# SPDX-License-Identifier: Apache-2.0
"""An hour of the live node at the camera's rate, with a hostile publisher beside the good one.

    python benchmarks/soak_hostile.py --minutes 60 --out benchmarks/figures/soak_hostile.json

Three processes: `imgu node perception`; `benchmarks/hostile_publisher.py`, which sends garbage to the same topics and
calls the services; and this one, which publishes simulated 640x480 Bayer frames with their camera_info at 30 Hz and
hears what becomes of each. Every good frame must come out as a pose, or be accounted for: lost on the way by the
middleware (of all that was sent what did not come), or skipped by the node (`/diagnostics` counts), hostile frames
included in both. What is not is `unexplained`, and a frame that came out without a pose is counted with its reason:
both are the node's fault. The node's memory (resident less shared, every second) is compared between the second tenth
of the time and the last; in the first tenth the largest messages come, one behind the other.

Prints a line a minute, writes the JSON every five minutes (`"complete": false`) and at the end, and ends with 1 when
the node ended or complained of an error of its own, a good frame was lost by its fault, a pose came out of a hostile
frame, or the memory grew by more than 5 MB (in 20 minutes or more). `--transport compressed` sends PNG files instead.
Needs the `ros` extra.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from live import IMAGE_TOPIC, INFO_TOPIC

from imgu_ros.frame import Frame
from imgu_ros.image_files.images import write_image
from imgu_ros.messages.camera_info import camera_info_message
from imgu_ros.messages.compressed_image import compressed_image_message
from imgu_ros.messages.header import Header, decode_header
from imgu_ros.messages.image import image_message
from imgu_ros.ros.middleware import PROFILE_VARIABLE, profile_path
from imgu_ros.simulate.sequence import Simulation, default_targets, simulate_sequence

_RATE_HZ = 30.0
_FIRST_POSE_S = 90.0
#: A frame of which nothing was heard for so long is lost.
_LOST_S = 10.0
_PARTIAL_MINUTES = 5
_MOST_GROWTH_MB = 5.0
_FLAT_MINUTES = 20
_COUNTED = ("lost", "skipped", "rejected", "unreadable", "frames")
_NOT_WITHOUT_POSE = ("tracked, metric", "detected, metric", "one frame has held")
#: What the log says of requests that rclpy itself cannot answer.
_REFUSED = ("is not a valid Parameter.Type", "KeyError: ''")
_PAGE, _TICK = os.sysconf("SC_PAGE_SIZE"), os.sysconf("SC_CLK_TCK")
_HERE = Path(__file__).resolve().parent


def main() -> int:
    """Run it; return the exit code."""
    arguments = _arguments()
    os.environ["ROS_DOMAIN_ID"] = str(arguments.domain)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ[PROFILE_VARIABLE] = str(profile_path())
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    width, height = (int(part) for part in arguments.size.split("x"))
    target = default_targets(1)[0]
    # The last frame of the motion is the first one again.
    simulation = Simulation(width=width, height=height, frames=arguments.round + 1, rate_hz=_RATE_HZ)
    frames = [s.frame for s in islice(simulate_sequence(simulation, [target]), arguments.round)]
    with tempfile.TemporaryDirectory(prefix="imgu_soak_") as folder:
        picture, log = Path(folder) / "poster.png", Path(folder) / "node.log"
        write_image(picture, target.pixels)
        node = _started(
            ["-m", "imgu_ros.cli.main", "node", "perception", "-p", f"targets.images:=[{picture}]",
             "-p", "targets.widths_m:=[0.5]", "-p", f"image_transport:={arguments.transport}",
             "-r", f"image_raw:={IMAGE_TOPIC}"],
            log,
        )  # fmt: skip
        hostile = None
        soak = Soak(arguments, frames, node.pid, log)
        try:
            soak.wait_for_first_pose()
            if not arguments.hostile_rate:
                soak.hostile = {"images": 0}
            if arguments.hostile_rate:
                hostile = _started(
                    [str(_HERE / "hostile_publisher.py"), "--rate", str(arguments.hostile_rate),
                     "--large", str(arguments.large),
                     "--frame-id", frames[0].frame_id, "--transport", arguments.transport],
                    Path(folder) / "hostile.log",
                )  # fmt: skip
            soak.run(lambda: node.poll() is None)
        except KeyboardInterrupt:
            print("soak: interrupted", file=sys.stderr)
        finally:
            if hostile is not None:
                _end(hostile)
                soak.hostile = _last_json(Path(folder) / "hostile.log")
            soak.finish()
            soak.node_lived = node.poll() is None
            _end(node)
            soak.exit_code = node.returncode
            figures = soak.figures(complete=soak.minutes >= arguments.minutes)
            _write(figures, arguments.out)
            soak.close()
    print(json.dumps(figures, indent=2))
    return 0 if figures["ok"] else 1


class Soak:
    """The good publisher, and what it hears."""

    def __init__(self, arguments: argparse.Namespace, frames: list[Frame], pid: int, log: Path) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import PoseWithCovarianceStamped
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node
        from rclpy.signals import SignalHandlerOptions
        from sensor_msgs.msg import CameraInfo, CompressedImage, Image

        from imgu_ros.ros.messages import make_message
        from imgu_ros.ros.qos import camera_info_qos, image_qos, output_qos

        self._arguments, self._pid, self._log = arguments, pid, log
        # Its own handlers would end the context, and this program without its children.
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._node = node = Node("feeder", start_parameter_services=False, enable_rosout=False)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        raw = arguments.transport == "raw"
        topic = IMAGE_TOPIC if raw else f"{IMAGE_TOPIC}/compressed"
        self._images = node.create_publisher(Image if raw else CompressedImage, topic, image_qos())
        self._infos = node.create_publisher(CameraInfo, INFO_TOPIC, camera_info_qos())
        node.create_subscription(PoseWithCovarianceStamped, "/pose", self._on_pose, output_qos(200))
        node.create_subscription(DiagnosticArray, "/status", self._on_status, output_qos(200))
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, output_qos(10))
        self._messages: list[tuple[Any, Any]] = []
        for frame in frames:
            header = Header(0, frame.frame_id)
            if raw:
                image = image_message(make_message, header, frame.image.pixels, "bayer_rggb8")
            else:
                image = compressed_image_message(
                    make_message, header, frame.image.pixels, "bayer_rggb8", file_format="png"
                )
            self._messages.append((image, camera_info_message(make_message, header, frame.camera)))
        self.hostile: dict[str, int] = {}
        self.node_lived, self.exit_code = True, None
        self._counts: dict[str, int] = {}
        self._causes: Counter[str] = Counter()
        self._begin()

    @property
    def minutes(self) -> float:
        """How long frames have been sent."""
        return (self._last_s - self._started_s) / 60

    def wait_for_first_pose(self) -> None:
        """Send frames, slowly, until the node has found everybody."""
        end_s = time.monotonic() + _FIRST_POSE_S
        while not self._latencies_s or not self._counts:
            if time.monotonic() > end_s:
                raise SystemExit(f"no pose in {_FIRST_POSE_S:g} s:\n{self._log.read_text(errors='replace')}")
            self._send()
            self._listen(0.2)
        self._listen(1.5)
        self._begin()

    def run(self, node_lives: Any) -> None:
        """Send frames at their rate for as long as asked."""
        due_s = time.monotonic()
        told = 0
        while self.minutes < self._arguments.minutes and node_lives():
            self._send()
            self._last_s = time.monotonic()
            # Held up for more than a second: what was missed is not made up for.
            due_s = max(due_s + 1 / _RATE_HZ, self._last_s - 1.0)
            self._listen(max(0.0, due_s - self._last_s))
            if self._last_s - self._sampled_s >= 1.0:
                self._sample()
            if int(self.minutes) > told:
                told = int(self.minutes)
                self._tell(told)

    def finish(self) -> None:
        """Hear the last of what becomes of the frames."""
        self._listen(4.0)
        self._sample()

    def figures(self, *, complete: bool) -> dict[str, Any]:
        """Return what was measured so far."""
        tenth = max(1, len(self._own_mb) // 10)
        own = np.array(self._own_mb or [0.0])
        early, late = float(np.median(own[tenth : 2 * tenth] if len(own) > 2 else own)), float(np.median(own[-tenth:]))
        latencies = np.array(self._latencies_s or [np.nan]) * 1e3
        part = max(1, len(latencies) // 10)
        no_word = sum(1 for sent_s in self._sent_s.values() if self._last_s - sent_s > 0.0)
        skipped, lost, came, unreadable = (
            self._counts.get(key, 0) - self._before.get(key, 0) for key in ("skipped", "lost", "frames", "unreadable")
        )
        # What the subscription's queue lost nobody counts: of all that was sent it is what did not come.
        if "images" in self.hostile:
            lost = max(lost, self._good_sent + self.hostile["images"] - came - unreadable)
        lines = self._log.read_text(errors="replace").splitlines()
        errors = [line for line in lines if any(word in line for word in ("[ERROR]", "[FATAL]", "Traceback"))]
        errors = [line for line in errors if not any(word in line for word in _REFUSED)]
        unexplained = max(0, no_word - skipped - lost)
        growth_mb = round(late - early, 2)
        figures = {
            "complete": complete,
            "minutes": round(self.minutes, 2),
            "size": self._arguments.size,
            "transport": self._arguments.transport,
            "hostile_hz": self._arguments.hostile_rate,
            "good_sent": self._good_sent,
            "good_with_pose": len(self._latencies_s),
            "good_without_pose": sum(self._without.values()),
            "good_without_pose_reasons": dict(self._without.most_common(8)),
            "good_of_which_nothing_was_heard": no_word,
            "not_delivered": lost,
            "node_skipped": skipped,
            "unexplained": unexplained,
            "poses_of_hostile_frames": self._false_poses,
            "hostile_statuses": self._hostile_statuses,
            "hostile_sent": self.hostile,
            "own_mb_early": round(early, 2),
            "own_mb_late": round(late, 2),
            "own_mb_largest": round(float(own.max()), 2),
            "growth_mb": growth_mb,
            "own_mb_by_minute": self._own_mb_by_minute(),
            "latency_p50_ms_first_tenth": round(float(np.median(latencies[:part])), 2),
            "latency_p50_ms_last_tenth": round(float(np.median(latencies[-part:])), 2),
            "latency_p99_ms": round(float(np.percentile(latencies, 99)), 2),
            "latency_max_ms": round(float(latencies.max()), 2),
            "node_cpu_percent": round(100 * (self._cpu_s - self._cpu_before_s) / max(1e-9, 60 * self.minutes), 1),
            "causes_in_diagnostics": dict(self._causes.most_common()),
            "log_lines": len(lines),
            "log_errors": len(errors),
            "log_errors_first": errors[:5],
            "node_lived": self.node_lived,
            "exit_code": self.exit_code,
            "cpu_count": os.cpu_count() or 0,
        }
        lost_by_us = unexplained + figures["good_without_pose"]
        fine = self.node_lived and not errors and not lost_by_us and not self._false_poses
        is_flat = growth_mb <= _MOST_GROWTH_MB or self.minutes < _FLAT_MINUTES
        return figures | {"lost_by_us": lost_by_us, "ok": bool(fine and is_flat)}

    def close(self) -> None:
        """Leave the graph."""
        import rclpy

        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown()

    def _begin(self) -> None:
        self._started_s = self._last_s = self._sampled_s = time.monotonic()
        self._sent_s: dict[int, float] = {}
        self._good: set[int] = set()
        self._good_sent = self._false_poses = self._hostile_statuses = 0
        self._latencies_s: list[float] = []
        self._without: Counter[str] = Counter()
        self._own_mb: list[float] = []
        self._cpu_before_s = self._cpu_s = _cpu_s(self._pid)
        self._before = dict(self._counts)
        self._causes.clear()

    def _send(self) -> None:
        stamp_ns = time.time_ns()
        message = self._messages[self._good_sent % len(self._messages)]
        for part, publisher in zip(message, (self._images, self._infos), strict=True):
            part.header.stamp.sec, part.header.stamp.nanosec = divmod(stamp_ns, 10**9)
            publisher.publish(part)
        self._good_sent += 1
        self._sent_s[stamp_ns] = time.monotonic()
        self._good.add(stamp_ns)

    def _listen(self, seconds: float) -> None:
        end_s = time.monotonic() + seconds
        while True:
            self._executor.spin_once(timeout_sec=max(0.0, end_s - time.monotonic()))
            if time.monotonic() >= end_s:
                return

    def _on_pose(self, message: Any) -> None:
        stamp_ns = decode_header(message).stamp_ns
        sent_s = self._sent_s.pop(stamp_ns, None)
        if sent_s is not None:
            self._latencies_s.append(time.monotonic() - sent_s)
        elif stamp_ns not in self._good:
            self._false_poses += 1

    def _on_status(self, message: Any) -> None:
        stamp_ns = decode_header(message).stamp_ns
        if stamp_ns not in self._good:
            self._hostile_statuses += 1
            return
        said = message.status[0].message
        # A pose comes beside the status of a frame that has one; "held up" is not the last word.
        if stamp_ns in self._sent_s and not said.startswith(_NOT_WITHOUT_POSE):
            del self._sent_s[stamp_ns]
            self._without["".join(c for c in said if not c.isdigit())[:120]] += 1

    def _on_diagnostics(self, message: Any) -> None:
        for entry in message.status:
            values = {value.key: value.value for value in entry.values}
            if entry.name.endswith(": input"):
                self._counts = {
                    key: int(values[key]) for key in ("lost", "skipped", "rejected", "unreadable", "frames")
                }
            elif entry.name.endswith(": output"):
                self._causes.update(values["causes"].split())

    def _sample(self) -> None:
        self._sampled_s = time.monotonic()
        with suppress(OSError):  # the node has ended
            self._own_mb.append(_own_mb(self._pid))
            self._cpu_s = _cpu_s(self._pid)

    def _own_mb_by_minute(self) -> list[float]:
        """Return the median of every 60 samples, which take a little more than a minute."""
        minutes = (self._own_mb[start : start + 60] for start in range(0, len(self._own_mb), 60))
        return [round(float(np.median(minute)), 1) for minute in minutes]

    def _tell(self, minute: int) -> None:
        no_word = sum(1 for sent_s in self._sent_s.values() if self._last_s - sent_s > _LOST_S)
        print(
            f"soak: {minute} of {self._arguments.minutes:g} min: {self._good_sent} good frames, "
            f"{len(self._latencies_s)} with a pose, {sum(self._without.values())} without, {no_word} unheard of; "
            f"node {self._own_mb[-1]:.1f} MB, {self._counts}",
            file=sys.stderr, flush=True,
        )  # fmt: skip
        if minute % _PARTIAL_MINUTES == 0:
            _write(self.figures(complete=False), self._arguments.out)


def _started(arguments: list[str], log: Path) -> subprocess.Popen[bytes]:
    with log.open("wb") as out:
        return subprocess.Popen([sys.executable, *arguments], stdout=out, stderr=subprocess.STDOUT)


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(10)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _last_json(log: Path) -> dict[str, int]:
    """Return what a process printed last; what it said instead, if that is none, goes to stderr."""
    text = log.read_text(errors="replace").strip()
    with suppress(ValueError, IndexError):
        return dict(json.loads(text.splitlines()[-1]))
    print(f"soak: the hostile publisher failed: {text}", file=sys.stderr)
    return {}


def _write(figures: dict[str, Any], path: Path | None) -> None:
    if path is not None:
        path.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


def _own_mb(pid: int) -> float:
    fields = Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()
    return (int(fields[1]) - int(fields[2])) * _PAGE / 1e6


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICK


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0, metavar="M")
    parser.add_argument("--size", default="640x480", metavar="WxH")
    parser.add_argument("--round", type=int, default=120, metavar="N", help="frames of a full roll")
    parser.add_argument("--large", type=int, default=2, metavar="N", help="weight of the largest hostile images")
    parser.add_argument("--hostile-rate", type=float, default=10.0, metavar="HZ", help="0: no hostile publisher")
    parser.add_argument("--transport", choices=("raw", "compressed"), default="raw")
    parser.add_argument("--domain", type=int, default=79, metavar="ID", help="ROS domain of the measurement")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the JSON there too")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
