# SPDX-License-Identifier: Apache-2.0
"""`imgu view --live`: what its server gives a browser, of messages that a node publishes."""

from __future__ import annotations

import contextlib
import json
import socket
import urllib.error
import urllib.request
from collections.abc import Iterator

import cv2
import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

from imgu_ros.cli.main import main
from imgu_ros.messages.compressed_image import compressed_image_message
from imgu_ros.messages.header import Header
from imgu_ros.ros.live_page import LiveState, _served
from imgu_ros.ros.messages import make_message


def picture(value: int, file_format: str = "jpeg"):
    pixels = np.full((24, 32, 3), value, np.uint8)
    return compressed_image_message(make_message, Header(0, "camera"), pixels, "rgb8", file_format=file_format)


def status(name: str, text: str, level: int = 1):
    entry = make_message("diagnostic_msgs/msg/DiagnosticStatus", level=level, name=name, message=text)
    return make_message("diagnostic_msgs/msg/DiagnosticArray", status=[entry])


@pytest.fixture
def served() -> Iterator[tuple[LiveState, str]]:
    state = LiveState()
    with _served(state, None) as port:
        yield state, f"http://127.0.0.1:{port}"


def got(address: str, host: str | None = None) -> bytes:
    request = urllib.request.Request(address, headers={} if host is None else {"Host": host})
    with urllib.request.urlopen(request, timeout=10) as answer:
        return answer.read()


def parts(stream) -> Iterator[tuple[str, bytes]]:
    """The parts of a multipart/x-mixed-replace stream (RFC 2046, 5.1)."""
    while line := stream.readline():
        if line.strip() != b"--frame":
            continue
        headers = {}
        while line := stream.readline().strip():
            name, _, value = line.partition(b": ")
            headers[name] = value
        yield headers[b"Content-Type"].decode(), stream.read(int(headers[b"Content-Length"]))


def test_pictures_are_streamed_as_they_come(served):
    state, address = served
    state.add_picture(picture(10))
    with urllib.request.urlopen(f"{address}/frames", timeout=10) as stream:
        read = parts(stream)
        for value, file_format in ((10, "jpeg"), (90, "jpeg"), (200, "png")):
            if value != 10:
                state.add_picture(picture(value, file_format))
            kind, content = next(read)
            assert kind == f"image/{file_format}"
            pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
            assert pixels.shape == (24, 32, 3)
            assert abs(float(pixels.mean()) - value) < 3


def test_the_state_says_what_there_is(served):
    state, address = served
    assert json.loads(got(f"{address}/state")) == {
        "text": "no frames yet: is `imgu node perception` running, and does a camera publish?",
        "targets": [],
    }
    state.add_status(status("<script>alert(1)</script>", "lost", 1))
    for value in range(3):
        state.add_picture(picture(value))
    said = json.loads(got(f"{address}/state"))
    assert said["targets"] == [["<script>alert(1)</script>", 1, "lost"]]
    assert said["text"].startswith("3 frames, ")
    # Names reach the page as text alone.
    page = got(address + "/").decode()
    assert "textContent" in page and "innerHTML" not in page


def test_other_sites_and_other_paths_get_nothing(served):
    _, address = served
    for path, host, code in (("/", "evil.example", 403), ("/state", "evil.example:80", 403), ("/../etc", None, 404)):
        with pytest.raises(urllib.error.HTTPError) as error:
            got(address + path, host)
        assert error.value.code == code
        error.value.close()


def test_a_port_that_is_taken(capsys):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert main(["view", "--live", "--port", str(port)]) == 1
    assert f"port {port}: Address already in use; need a free one" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["results", "--live"],
        ["--live", "--port", "70000"],
        ["--live", "--web"],
        ["results", "--port", "9000"],
        ["--live", "--out", "x.rrd"],
    ],
)
def test_wrong_usage(capsys, arguments):
    assert main(["view", *arguments]) == 2
    assert "--live" in capsys.readouterr().err


def test_a_live_node_is_seen_and_ctrl_c_ends_it_while_a_page_is_open(imgu, peer, world, make_camera):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"http://127.0.0.1:{port}"
    view = imgu("view", "--live", "--port", str(port))
    view.wait_for_line("shows /debug_image/compressed")
    imgu("node", "perception", *world.arguments, "-r", "image_raw:=/cam/image_raw")
    camera = make_camera(peer)
    camera.wait_for_node()
    with urllib.request.urlopen(f"{address}/frames", timeout=60) as stream:
        read = parts(stream)
        for frame in world.frames:
            camera.send(frame)
            peer.spin(0.05)
        _, content = next(read)
        pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
        assert pixels.shape == (360, 480, 3)
        peer.wait(lambda: json.loads(got(f"{address}/state"))["targets"], "the status")
        ((name, level, text),) = json.loads(got(f"{address}/state"))["targets"]
        assert (name, level) == ("poster", 0)
        assert "metric" in text
        assert view.stop() < 5
        assert view.process.returncode == 0
        with contextlib.suppress(OSError):
            list(read)
