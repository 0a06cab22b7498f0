# SPDX-License-Identifier: Apache-2.0
"""Chromium without a window, driven over a pipe by the Chrome DevTools protocol; every wait is bounded."""

from __future__ import annotations

import base64
import contextlib
import fcntl
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import cv2
import numpy as np

#: WebGL without a graphics card.
SOFTWARE_WEBGL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")

_OPTIONS = (
    "--headless=new", "--remote-debugging-pipe", "--no-first-run", "--no-default-browser-check",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage",
    "--hide-scrollbars",
)  # fmt: skip
#: Chromium speaks on file descriptors 3 (in) and 4 (out): a shell of its own brings the pipes there.
_MOVED = 'exec "$@" 3<&"$TO_BROWSER" 4>&"$FROM_BROWSER"'


def find_chromium() -> str | None:
    """Return the browser's path; None where there is none."""
    return shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


class Chromium:
    """A browser with one page; a context manager.

    Parameters
    ----------
    *options : further ones of the command line

    Attributes
    ----------
    events : what the page said so far, as the protocol has it
    """

    def __init__(self, *options: str) -> None:
        self._profile = tempfile.TemporaryDirectory(prefix="imgu_chromium_", ignore_cleanup_errors=True)
        to_browser, self._out = _pipe()
        self._in, from_browser = _pipe()
        own = [f"--user-data-dir={self._profile.name}", *(["--no-sandbox"] if os.geteuid() == 0 else [])]
        command = [find_chromium() or "chromium", *_OPTIONS, *own, *options]
        self._process = subprocess.Popen(
            ["bash", "-c", _MOVED, "bash", *command, "about:blank"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=(to_browser, from_browser),
            env={**os.environ, "TO_BROWSER": str(to_browser), "FROM_BROWSER": str(from_browser)},
            process_group=0,
        )
        os.close(to_browser)
        os.close(from_browser)
        self._number = 0
        self._rest = b""
        self._session = ""
        self.events: list[dict[str, Any]] = []
        try:
            target = self.call("Target.createTarget", url="about:blank")["targetId"]
            self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
            for domain in ("Page", "Runtime", "Network", "Log"):
                self.call(f"{domain}.enable")
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def call(self, method: str, *, timeout_s: float = 60.0, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol and return its result."""
        self._number += 1
        number = self._number
        message: dict[str, Any] = {"id": number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        data = memoryview(json.dumps(message).encode() + b"\0")
        while data:
            data = data[os.write(self._out, data) :]
        deadline = time.monotonic() + timeout_s
        while (answer := self._next(deadline)).get("id") != number:
            self.events.append(answer)
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']}")
        result: dict[str, Any] = answer["result"]
        return result

    def open(self, address: str, *, width: int = 1400, height: int = 900, is_phone: bool = False) -> None:
        """Open an address in a window of that size."""
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=is_phone
        )
        self.call("Page.navigate", url=address)
        self.wait("document.readyState === 'complete'")

    def value(self, expression: str) -> Any:
        """Return the value of an expression in the page."""
        got = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in got:
            raise RuntimeError(str(got["exceptionDetails"]))
        return got["result"].get("value")

    def wait(self, expression: str, timeout_s: float = 30.0) -> None:
        """Wait until an expression is true; TimeoutError after that time."""
        deadline = time.monotonic() + timeout_s
        while not self.value(expression):
            if time.monotonic() > deadline:
                raise TimeoutError(f"{expression}: not true within {timeout_s:g} s")
            time.sleep(0.05)

    def screenshot(self, path: Path | None = None, *, whole: bool = False) -> np.ndarray:
        """Return the page as it looks, (H, W, 3) RGB; beyond the window too when `whole`."""
        answer = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        data = base64.b64decode(answer["data"])
        if path is not None:
            path.write_bytes(data)
        return cv2.cvtColor(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)

    def click(self, x: float, y: float) -> None:
        """Move the pointer to a place in the window, and press and release its button."""
        self.move(x, y)
        for kind, held in (("mousePressed", 1), ("mouseReleased", 0)):
            self._mouse(kind, x, y, button="left", buttons=held, clickCount=1)

    def drag(self, x: float, y: float, to_x: float, to_y: float) -> None:
        """Press the button, move, and release it."""
        self.move(x, y)
        self._mouse("mousePressed", x, y, button="left", buttons=1, clickCount=1)
        for share in (0.25, 0.5, 0.75, 1.0):
            self._mouse("mouseMoved", x + share * (to_x - x), y + share * (to_y - y), button="left", buttons=1)
        self._mouse("mouseReleased", to_x, to_y, button="left", buttons=0, clickCount=1)

    def move(self, x: float, y: float) -> None:
        """Move the pointer."""
        self._mouse("mouseMoved", x, y)

    def complaints(self) -> list[str]:
        """Return what the page threw, and wrote into the console as an error or a warning."""
        self.value("0")  # what was said before is here then
        found = []
        for event in self.events:
            parameters = event.get("params", {})
            if event["method"] == "Runtime.exceptionThrown":
                found.append(str(parameters["exceptionDetails"]))
            elif event["method"] == "Log.entryAdded" and parameters["entry"]["level"] in ("error", "warning"):
                found.append(parameters["entry"]["text"])
            elif event["method"] == "Runtime.consoleAPICalled" and parameters["type"] in ("error", "warning", "assert"):
                found.append(str(parameters["args"]))
        return found

    def requests(self) -> list[str]:
        """Return the addresses that the page asked for; those of data in the page itself are none."""
        self.value("0")
        sent = [event for event in self.events if event["method"] == "Network.requestWillBeSent"]
        return [
            address
            for event in sent
            if not (address := event["params"]["request"]["url"]).startswith(("data:", "blob:", "about:"))
        ]

    def close(self) -> None:
        """End the browser."""
        self._session = ""
        with contextlib.suppress(Exception):
            self.call("Browser.close", timeout_s=5.0)
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for descriptor in (self._in, self._out):
            os.close(descriptor)
        self._profile.cleanup()

    def _mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def _next(self, deadline: float) -> dict[str, Any]:
        while b"\0" not in self._rest:
            left = deadline - time.monotonic()
            if left <= 0 or not select.select([self._in], [], [], left)[0]:
                raise TimeoutError("chromium: says nothing")
            piece = os.read(self._in, 1 << 20)
            if not piece:
                raise EOFError("chromium: ended")
            self._rest += piece
        one, _, self._rest = self._rest.partition(b"\0")
        message: dict[str, Any] = json.loads(one)
        return message


def _pipe() -> tuple[int, int]:
    """Return the ends of a pipe, neither of which is descriptor 3 or 4."""
    ends = os.pipe()
    moved = [fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, 10) for end in ends]
    for end in ends:
        os.close(end)
    return moved[0], moved[1]


if __name__ == "__main__":
    # python test/browser/chromium.py ADDRESS FILE.png [WIDTH]: for looking at a page.
    with Chromium() as browser:
        width = int(sys.argv[3]) if len(sys.argv) > 3 else 1400
        browser.open(sys.argv[1], width=width, is_phone=width < 600)
        time.sleep(1.0)
        browser.screenshot(Path(sys.argv[2]), whole=True)
        print("\n".join([*browser.complaints(), *browser.requests()]))
