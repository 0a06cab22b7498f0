# SPDX-License-Identifier: Apache-2.0
"""Rerun's own web viewer, served on this machine alone."""

from __future__ import annotations

import contextlib
import ctypes
import importlib.util
import os
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

from imgu_ros.errors import FileError, ImguError
from imgu_ros.view.page_server import HOST, page_server

#: Longest wait for the server to listen, and to end.
_PATIENCE_S = 20.0
#: The server keeps what it serves in memory: this, and as much as the file has.
_MEMORY_BYTES = 256_000_000
#: Of Linux: sys/prctl.h.
_PR_SET_PDEATHSIG = 1


@contextlib.contextmanager
def web_viewer(recording: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Serve a Rerun recording in Rerun's web viewer on 127.0.0.1, for a browser that then asks no other machine.

    Parameters
    ----------
    recording : an .rrd file

    Yields
    ------
    the address to open, and the server's process, which ends with the context

    Raises
    ------
    ImguError
        If the server does not start.
    """
    page, data = _free_ports(2)
    most = recording.stat().st_size + _MEMORY_BYTES
    command = [
        str(_executable()), str(recording), "--serve-web", "--bind", HOST, "--web-viewer-port", str(page),
        "--port", str(data), "--server-memory-limit", f"{-(-most // 1_000_000)}MB", "--hide-welcome-screen",
    ]  # fmt: skip
    # Rerun's programs report their use to their makers unless they run in CI.
    environment = {**os.environ, "CI": "true", "TELEMETRY_ENABLED": "false"}
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment,
        process_group=0, preexec_fn=_end_with_parent,
    )  # fmt: skip
    try:
        for port in (page, data):
            _wait_for(port, process)
        source = quote(f"rerun+http://{HOST}:{data}/proxy", safe="")
        with page_server(page, data) as port:
            yield f"http://{HOST}:{port}/?url={source}", process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _end_with_parent() -> None:
    """Have the kernel end this process with the one that started it, however that ends."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _executable() -> Path:
    found = importlib.util.find_spec("rerun_cli")
    if found is None or found.origin is None:
        raise FileError("rerun_cli: not installed; need rerun-sdk")
    return Path(found.origin).parent / "rerun"


def _free_ports(count: int) -> list[int]:
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(count)]
        for each in sockets:
            each.bind((HOST, 0))
        return [each.getsockname()[1] for each in sockets]


def _wait_for(port: int, process: subprocess.Popen[bytes]) -> None:
    deadline = time.monotonic() + _PATIENCE_S
    while time.monotonic() < deadline:
        if process.poll() is not None:
            raise ImguError(f"rerun: its server ended with code {process.returncode}; need a working rerun-sdk")
        with contextlib.suppress(OSError), socket.create_connection((HOST, port), 1.0):
            return
        time.sleep(0.05)
    raise ImguError(f"rerun: its server does not listen within {_PATIENCE_S:g} s; need a working rerun-sdk")
