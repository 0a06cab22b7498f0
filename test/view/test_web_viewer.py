# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from chromium import SOFTWARE_WEBGL

from imgu_ros.messages.annotations import STATUS_COLORS
from imgu_ros.result import Status

if TYPE_CHECKING:
    from chromium import Chromium

pytest.importorskip("rerun")

#: The viewer draws after 10 to 20 s without a graphics card.
PATIENCE_S = 90.0


@pytest.fixture
def served(replayed: tuple[Path, Path], tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "imgu_ros.cli.main", "view", replayed[1], "--out", tmp_path / "v.rrd", "--web"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, process_group=0) as process:
        yield process
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)  # which ends the server too


def address_of(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    for line in process.stdout:
        if found := re.match(r"(http://\S+) \(Ctrl-C ends it\)", line):
            return found[1]
    pytest.fail("no address was printed")


def listeners(port: int) -> set[str]:
    """Return the addresses on which something listens at a TCP port, hexadecimal as the kernel has them."""
    found = set()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(table).read_text().splitlines()[1:]:
            address, number = line.split()[1].split(":")
            if line.split()[3] == "0A" and int(number, 16) == port:
                found.add(address)
    return found


def ports_of(address: str) -> tuple[int, int]:
    page = urlsplit(address)
    data = urlsplit(parse_qs(page.query)["url"][0].removeprefix("rerun+"))
    assert page.port and data.port
    return page.port, data.port


@pytest.mark.timeout(180)
@pytest.mark.browser_options(*SOFTWARE_WEBGL)
def test_viewer_shows_pictures_and_outlines(served: subprocess.Popen[str], chromium: Chromium) -> None:
    address = address_of(served)
    chromium.open(address + "&renderer=webgl", width=1200, height=800)
    deadline = time.monotonic() + PATIENCE_S
    while not is_drawn(chromium.screenshot()):
        assert time.monotonic() < deadline, "the viewer does not show the recording"
        time.sleep(1.0)
    # Nothing was fetched from elsewhere: the page's policy had the browser refuse it.
    by_id = {}
    for event in chromium.events:
        if event["method"] == "Network.requestWillBeSent":
            by_id[event["params"]["requestId"]] = event["params"]["request"]["url"]
        elif event["method"] == "Network.loadingFailed" and event["params"].get("blockedReason") == "csp":
            by_id.pop(event["params"]["requestId"], None)
    assert {urlsplit(url).hostname for url in by_id.values() if url.startswith("http")} == {"127.0.0.1"}


def is_drawn(page: np.ndarray) -> bool:
    """Whether outlines of tracked posters are seen at the left, over a picture, and the path at the right."""
    left, right = page[60:450, :600].astype(int), page[60:450, 600:].astype(int)
    outline = (np.abs(left - STATUS_COLORS[Status.TRACKED]) < 12).all(axis=2)
    is_colourful = np.ptp(left, axis=2) > 60
    ellipsoids = np.ptp(right, axis=2) > 60
    return outline.sum() > 200 and is_colourful.sum() > 2000 and ellipsoids.sum() > 200


def test_served_on_this_machine_alone_until_ctrl_c(served: subprocess.Popen[str]) -> None:
    ports = ports_of(address_of(served))
    for port in ports:
        assert listeners(port) == {"0100007F"}
    os.kill(served.pid, signal.SIGINT)
    assert served.wait(30) == 0
    for port in ports:
        with pytest.raises(ConnectionRefusedError), socket.create_connection(("127.0.0.1", port), 2):
            pass
