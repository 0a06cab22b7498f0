# SPDX-License-Identifier: Apache-2.0
"""A publisher that means harm, for `benchmarks/soak_hostile.py`: garbage on a node's topics, and calls of its services.

    python benchmarks/hostile_publisher.py --rate 10 --seed 0

Images of every wrong size, encoding, stamp and frame_id, the good camera's frame_id among them; readable images of
noise, of the good camera's size and larger; camera_info of other frame_ids, with numbers that are none, with a frame_id
or coefficients of a megabyte; bytes that are no message, cut messages, messages of another type; parameters that do not
exist or have no such type; bursts of service calls. It does not lie in camera_info in the good camera's name: who has
camera_info of that name is believed. It ends on SIGTERM and prints how many messages of each kind it sent, as JSON.
"""

from __future__ import annotations

import argparse
import json
import random
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hostile_messages import Liar, set_data
from live import IMAGE_TOPIC, INFO_TOPIC

_OTHERS = ("", "/a b", "x" * 1000, "ü", "\x1b[2Jred", "evil", "second camera", "=1+1")
_K = (600.0, 0.0, 320.0, 0.0, 600.0, 240.0, 0.0, 0.0, 1.0)
#: Of a hundred messages so many are of each kind.
_SHARES = {
    "lying image": 40, "lying camera_info": 15, "no message": 12, "noise of the good size": 10, "random frame_id": 8,
    "endless camera_info": 5, "endless frame_id": 2, "large image": 2, "parameters": 4, "burst of calls": 1,
    "another node's topic": 1,
}  # fmt: skip
_BURST = 30
#: Largest images that come first, one behind the other: the memory that they need is reached before it is measured.
_FIRST_LARGE = 40


def main() -> int:
    """Send until SIGTERM; return the exit code."""
    import rclpy

    arguments = _arguments()
    rclpy.init(args=[])
    ends = False

    def end(*_: object) -> None:
        nonlocal ends
        ends = True

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, end)
    shares = _SHARES | {"large image": arguments.large}
    sender = _Sender(random.Random(arguments.seed), arguments.frame_id, arguments.transport, shares)
    sent: Counter[str] = Counter()
    for _ in range(_FIRST_LARGE):
        sent[sender.send("large image")] += 1
        time.sleep(0.05)
    due_s = time.monotonic()
    while not ends:
        kind = sender.send()
        sent[kind] += 1
        due_s = max(due_s + 1 / arguments.rate, time.monotonic() - 1.0)
        time.sleep(max(0.0, due_s - time.monotonic()))
    print(json.dumps({"images": sender.images} | dict(sorted(sent.items()))))
    rclpy.try_shutdown()
    return 0


class _Sender:
    def __init__(self, rng: random.Random, good_frame_id: str, transport: str, shares: dict[str, int]) -> None:
        from rcl_interfaces.srv import GetParameters, SetParameters
        from rclpy.node import Node
        from rosgraph_msgs.msg import Clock
        from sensor_msgs.msg import CameraInfo, CompressedImage, Image
        from std_srvs.srv import Trigger

        from imgu_ros.ros.qos import camera_info_qos, image_qos

        self._rng, self._transport, self._shares = rng, transport, shares
        self._kind = Image if transport == "raw" else CompressedImage
        topic = IMAGE_TOPIC if transport == "raw" else f"{IMAGE_TOPIC}/compressed"
        self._images = Liar(rng, np.array(_K), (640, 480), (*_OTHERS, good_frame_id))
        self._infos = Liar(rng, np.array(_K), (640, 480), _OTHERS)
        self._info_type = CameraInfo
        self._node = node = Node("hostile", start_parameter_services=False, enable_rosout=False)
        self._image = node.create_publisher(self._kind, topic, image_qos())
        self._info = node.create_publisher(CameraInfo, INFO_TOPIC, camera_info_qos())
        self._clock = node.create_publisher(Clock, "/clock", 10)
        self._set, self._get = SetParameters, GetParameters
        self._setter = node.create_client(SetParameters, "/perception/set_parameters")
        self._getter = node.create_client(GetParameters, "/perception/get_parameters")
        self._reset_type, self._resetter = Trigger, node.create_client(Trigger, "/perception/reset")
        self._noise = rng.randbytes(640 * 480)
        self._large = bytes(1920 * 1080 * 3)
        self._number = 0
        self.images = 0
        self._kinds: dict[str, Callable[[], None]] = {
            "lying image": lambda: self._publish_image(self._images.image(self._kind())),
            "lying camera_info": lambda: self._info.publish(self._infos.info(self._info_type())),
            "no message": self._no_message,
            "noise of the good size": lambda: self._readable(self._images, 640, 480, "mono8", self._noise),
            "random frame_id": self._random_frame_id,
            "endless camera_info": self._endless_info,
            "endless frame_id": self._endless_frame_id,
            "large image": lambda: self._readable(self._infos, 1920, 1080, "rgb8", self._large),
            "parameters": self._parameters,
            "burst of calls": self._burst,
            "another node's topic": lambda: self._clock.publish(rng.randbytes(rng.choice((0, 3, 12, 500)))),
        }

    def send(self, kind: str = "") -> str:
        """Send a message of a kind, by default a random one; return the kind."""
        kind = kind or self._rng.choices(list(self._shares), weights=list(self._shares.values()))[0]
        try:
            self._kinds[kind]()
        except RuntimeError:  # rcl itself refuses to send it
            return f"{kind}, not sent"
        return kind

    def _publish_image(self, message: Any) -> None:
        self._image.publish(message)
        self.images += 1

    def _no_message(self) -> None:
        from rclpy.serialization import serialize_message

        rng = self._rng
        image = serialize_message(self._images.image(self._kind()))
        info = serialize_message(self._infos.info(self._info_type()))
        data = rng.choice((
            b"", b"\0\1\0\0", rng.randbytes(rng.choice((3, 40, 5000))), image[: rng.randrange(len(image))],
            info[: rng.randrange(len(info))], info, image, b"\7" + image[1:], b"\0\1\0\0" + b"\xff" * 64,
        ))  # fmt: skip
        on_images = data is info or rng.random() < 0.7
        (self._publish_image if on_images else self._info.publish)(data)

    def _readable(self, liar: Liar, width: int, height: int, encoding: str, data: bytes) -> None:
        message = liar.header(self._kind())
        if self._transport == "raw":
            message.width, message.height, message.encoding = width, height, encoding
            message.step = len(data) // height
            set_data(message, data)
        else:
            message = liar.image(message)
        self._publish_image(message)

    def _random_frame_id(self) -> None:
        self._number += 1
        info, image = self._infos.info(self._info_type()), self._images.image(self._kind())
        image.header = info.header
        info.header.frame_id = f"camera {self._number}"
        self._info.publish(info)
        self._publish_image(image)

    def _endless_info(self) -> None:
        info = self._infos.info(self._info_type())
        if self._rng.random() < 0.5:
            info.d = [0.1] * 100_000
        else:
            info.header.frame_id = "y" * 1_000_000
        self._info.publish(info)

    def _endless_frame_id(self) -> None:
        image = self._images.image(self._kind())
        image.header.frame_id = f"{self._number}" + "z" * 1_000_000
        self._publish_image(image)

    def _parameters(self) -> None:
        from rcl_interfaces.msg import Parameter, ParameterValue

        rng = self._rng
        names = ("no.such", "x" * 10_000, "", "homography.min_inliers", "targets.images", "\x1b[2J")
        value = ParameterValue(type=rng.choice((0, 1, 2, 3, 4, 5, 200)), double_value=float("nan"))
        value.string_value = "y" * 1000
        self._call(self._setter, self._set.Request(parameters=[Parameter(name=rng.choice(names), value=value)]))

    def _burst(self) -> None:
        for _ in range(_BURST):
            self._call(self._getter, self._get.Request(names=["no.such"] * 50))
        self._call(self._resetter, self._reset_type.Request())

    def _call(self, client: Any, request: Any) -> None:
        """Call, and care for no answer."""
        if client.service_is_ready():
            client.remove_pending_request(client.call_async(request))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rate", type=float, default=10.0, metavar="HZ", help="messages a second")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--large", type=int, default=2, metavar="N", help="weight of the largest images; others: 98")
    parser.add_argument("--frame-id", default="camera", help="the good camera's")
    parser.add_argument("--transport", choices=("raw", "compressed"), default="raw")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
