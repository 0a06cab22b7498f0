# SPDX-License-Identifier: Apache-2.0
"""Random parameters, right and wrong, set many times a second while frames flow: nothing is lost, nothing breaks.

    python benchmarks/parameter_storm.py --seconds 30 --sets 200 --out storm.json

Starts a node and a camera as processes of their own, sets every parameter that can be set while frames flow, and
prints what became of frames and sets as JSON. Exits 1 when a frame was lost, a set was not answered, the node does not
hold what it accepted, or it has complained of anything but targets that are too poor for some settings. Needs the
`ros` extra.
"""

from __future__ import annotations

import argparse
import json
import math
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

from imgu_ros.config.parameters import Declaration, Parameters, ParameterValue, declarations
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import ParameterError
from imgu_ros.image_files.images import write_image
from imgu_ros.simulate.sequence import Simulation, default_targets, simulate_sequence

_WRONG: dict[str, list[Any]] = {
    "bool": [1, "yes"], "integer": [-7.5, "x", -(2**40)], "double": ["x", math.nan, math.inf, -1e300],
    "string": ["no such thing", 3], "string_array": [[1, 2]], "double_array": [["a"], [math.nan]],
    "integer_array": [[0.5], [-5]],
}  # fmt: skip
#: Larger ones take a frame's search minutes, which tells nothing about parameters.
_LARGEST = 3000.0
#: A service keeps ten requests and drops what comes beyond: so many are on their way at a time.
_AT_ONCE = 8


def main() -> int:
    """Run it; return the exit code."""
    arguments = _arguments()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", "77")
    if arguments.camera:
        publish_frames(Path(arguments.camera), arguments.rate, arguments.seconds)
        return 0
    with tempfile.TemporaryDirectory(prefix="imgu_storm_") as folder:
        figures = storm(Path(folder), arguments)
    text = json.dumps(figures, indent=2)
    print(text)
    if arguments.out:
        Path(arguments.out).write_text(text + "\n", encoding="utf-8")
    return 0 if figures["ok"] else 1


def random_value(known: Declaration, rng: random.Random) -> tuple[Any, bool]:
    """Return a value for a parameter, and whether it was meant to be right by itself."""
    if rng.random() < 0.3:
        return rng.choice(_WRONG[known.type_name]), False
    element = known.type_name.removesuffix("_array")
    if element != known.type_name:
        return [_scalar(known, element, rng) for _ in range(rng.choice((0, 1, 3, 3)))], True
    return _scalar(known, element, rng), True


def _scalar(known: Declaration, element: str, rng: random.Random) -> Any:
    if known.choices:
        return rng.choice(known.choices)
    if element == "bool":
        return rng.random() < 0.5
    if element == "string":
        return rng.choice(("map", "odom", "", "a_frame"))
    low, high = known.bounds or (-_LARGEST, _LARGEST)
    high = min(high, max(_LARGEST, low + 1))
    return rng.randint(math.ceil(low), math.floor(high)) if element == "integer" else rng.uniform(low, high)


def settable() -> list[Declaration]:
    """Return the parameters that can be set while frames flow."""
    # A file is looked for, and an encoding among those that are known: not every text is a value of these.
    looked_up = ("targets.", "camera.info_file", "raw.encoding")
    return [known for known in declarations() if not known.read_only and not known.name.startswith(looked_up)]


def storm(folder: Path, arguments: argparse.Namespace) -> dict[str, Any]:
    """Start node and camera, set parameters, and return what became of it."""
    target = default_targets(1)[0]
    write_image(folder / "poster.png", target.pixels)
    node = subprocess.Popen(
        [sys.executable, "-m", "imgu_ros.cli.main", "node", "perception", "-p",
         f"targets.images:=[{folder / 'poster.png'}]", "-p", "targets.widths_m:=[0.5]"],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=Path(__file__).resolve().parents[1],
    )  # fmt: skip
    lines: list[str] = []
    assert node.stdout is not None
    reader = threading.Thread(target=lambda: lines.extend(iter(node.stdout.readline, "")), daemon=True)  # type: ignore[union-attr]
    reader.start()
    camera = subprocess.Popen(
        [sys.executable, __file__, "--camera", str(folder), "--rate", str(arguments.rate), "--seconds",
         str(arguments.seconds)], stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        setter = Setter(arguments)
        figures = setter.run()
        sent = int(camera.communicate(timeout=arguments.seconds + 60)[0] or 0)
        time.sleep(2.5)
        figures |= setter.diagnostics()
        lived = node.poll() is None
        node.send_signal(signal.SIGINT)
        node.wait(10)
        reader.join(2)
    finally:
        for process in (node, camera):
            if process.poll() is None:
                process.kill()
                process.wait()
    complaints = Counter(line.partition("]: ")[2].strip() for line in lines if "[ERROR]" in line or "Traceback" in line)
    # Some settings leave too few keypoints on the target: said, and the old parameters stay in use.
    surprising = {text: n for text, n in complaints.items() if "the old parameters stay in use" not in text}
    delivered = int(figures.pop("delivered", 0))
    figures |= {
        "frames_sent": sent, "frames_delivered": delivered, "frames_not_delivered": sent - delivered,
        "node_lived": lived, "refused_by_the_chain": sum(complaints.values()) - sum(surprising.values()),
        "surprising_complaints": surprising, "exit_code": node.returncode,
    }  # fmt: skip
    figures["ok"] = bool(
        lived and sent == delivered and not surprising and figures["unanswered"] == 0 and figures["as_accepted"]
        and figures["refusals_without_reason"] == 0
    )  # fmt: skip
    return figures


class Setter:
    """A client that sets parameters and keeps what the node must hold."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self._rng = random.Random(arguments.seed)
        self._seconds, self._sets = arguments.seconds, arguments.sets
        self._known = settable()
        self._model = Parameters()
        self._heard: list[Any] = []
        self._seen: list[Any] = []
        self._node: Any = None

    def run(self) -> dict[str, Any]:
        """Set parameters for the given time; return what the node said."""
        import rclpy
        from rcl_interfaces.srv import GetParameters, SetParametersAtomically
        from rclpy.parameter import Parameter, parameter_value_to_python

        rclpy.init(args=[])
        self._node = node = rclpy.create_node("setter", enable_rosout=False)
        self._listen()
        client = node.create_client(SetParametersAtomically, "/perception/set_parameters_atomically")
        if not client.wait_for_service(60):
            raise SystemExit("the node does not start")
        _spin_until(node, lambda: self._heard and self._seen)
        futures: list[tuple[dict[str, Any], Any]] = []
        waiting: list[Any] = []
        start = time.monotonic()
        while (now := time.monotonic()) < start + self._seconds:
            waiting = [future for future in waiting if not future.done()]
            while len(futures) < (now - start) * self._sets and len(waiting) < _AT_ONCE:
                chosen = self._rng.sample(self._known, self._rng.choice((1, 1, 1, 2, 3)))
                values = {known.name: random_value(known, self._rng)[0] for known in chosen}
                request = SetParametersAtomically.Request()
                request.parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
                waiting.append(client.call_async(request))
                futures.append((values, waiting[-1]))
            rclpy.spin_once(node, timeout_sec=0.002)
        _spin_until(node, lambda: all(future.done() for _, future in futures), 20)
        results = [(values, future.result().result) for values, future in futures if future.done()]
        wrong = [self._disagreement(values, result) for values, result in results]
        get = node.create_client(GetParameters, "/perception/get_parameters")
        get.wait_for_service(10)
        names = [known.name for known in self._known]
        asked = get.call_async(GetParameters.Request(names=names))
        _spin_until(node, asked.done, 20)
        held = {n: parameter_value_to_python(v) for n, v in zip(names, asked.result().values, strict=True)}
        different = [name for name, value in held.items() if _listed(value) != _value(self._model, name)]
        return {
            "seconds": self._seconds,
            "sets": len(futures),
            "sets_a_second": len(futures) / self._seconds,
            "accepted": sum(result.successful for _, result in results),
            "refused": sum(not result.successful for _, result in results),
            "unanswered": len(futures) - len(results),
            "refusals_without_reason": sum(not r.successful and not r.reason for _, r in results),
            "disagreements": [text for text in wrong if text][:5],
            "as_accepted": not different and not any(wrong),
            "different": different,
        }

    def _disagreement(self, values: dict[str, Any], result: Any) -> str:
        """Take what was accepted into the model; return what the node should have said otherwise."""
        try:
            new = parameters_from(values, self._model)
        except ParameterError as error:
            return f"accepted {values}, but {error}" if result.successful else ""
        if not result.successful:
            return f"refused {values}: {result.reason}"
        self._model = new
        return ""

    def diagnostics(self) -> dict[str, Any]:
        """Return the node's own figures of now."""
        import rclpy

        self._heard.clear()
        _spin_until(self._node, lambda: len(self._heard) > 1, 20)
        entry = next(status for status in self._heard[-1].status if status.name.endswith(": input"))
        values = {value.key: value.value for value in entry.values}
        rclpy.try_shutdown()
        figures = {name: int(values[name]) for name in ("lost", "skipped", "rejected")}
        return {"delivered": int(values["frames"]), "statuses": len(self._seen), **figures}

    def _listen(self) -> None:
        from diagnostic_msgs.msg import DiagnosticArray

        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._heard.append, 10)
        self._node.create_subscription(DiagnosticArray, "/status", self._seen.append, 100)


def publish_frames(folder: Path, rate_hz: float, seconds: float) -> None:
    """Publish frames from when the node subscribes until it was long enough; print how many."""
    import rclpy

    from imgu_ros.messages.camera_info import camera_info_message
    from imgu_ros.messages.header import Header
    from imgu_ros.messages.image import image_message
    from imgu_ros.ros.messages import make_message, message_class
    from imgu_ros.ros.qos import image_qos

    simulated = simulate_sequence(Simulation(width=640, height=480, frames=60), default_targets(1))
    frames = [one.frame for one in simulated]
    rclpy.init(args=[])
    node = rclpy.create_node("camera", enable_rosout=False)
    images = node.create_publisher(message_class("sensor_msgs/msg/Image"), "image_raw", image_qos())
    infos = node.create_publisher(message_class("sensor_msgs/msg/CameraInfo"), "camera_info", image_qos())
    end = time.monotonic() + 60
    while not (images.get_subscription_count() and infos.get_subscription_count()) and time.monotonic() < end:
        time.sleep(0.05)
    time.sleep(1.0)
    start, sent = time.monotonic(), 0
    while time.monotonic() < start + seconds + 1.0:
        frame = frames[sent % len(frames)]
        header = Header(time.time_ns(), "camera_optical_frame")
        infos.publish(camera_info_message(make_message, header, frame.camera))
        images.publish(image_message(make_message, header, frame.image.pixels, "bayer_rggb8"))
        sent += 1
        time.sleep(max(0.0, start + sent / rate_hz - time.monotonic()))
    time.sleep(1.0)
    print(sent)
    rclpy.try_shutdown()


def _value(parameters: Parameters, name: str) -> ParameterValue:
    value: Any = parameters
    for part in name.split("."):
        value = getattr(value, part)
    return value  # type: ignore[no-any-return]


def _listed(value: Any) -> Any:
    if hasattr(value, "tolist"):
        value = value.tolist()
    return tuple(value) if isinstance(value, list) else value


def _spin_until(node: Any, condition: Any, timeout_s: float = 60.0) -> None:
    import rclpy

    end = time.monotonic() + timeout_s
    while not condition() and time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.02)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--sets", type=float, default=200.0, metavar="HZ", help="sets a second")
    parser.add_argument("--rate", type=float, default=30.0, metavar="HZ", help="frames a second")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", metavar="FILE")
    parser.add_argument("--camera", help=argparse.SUPPRESS)
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
