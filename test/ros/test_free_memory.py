# SPDX-License-Identifier: Apache-2.0
"""A node returns the memory that it has freed, while it runs; without that it grows with the sizes of its messages."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="glibc's")

#: Blocks of an image's size are freed among small ones that stay, in a thread other than the main one.
_PROGRAM = """
import ctypes, sys, threading, time
from pathlib import Path
from imgu_ros.process_memory import bound_free_memory
from imgu_ros.ros import managed_node
from imgu_ros.ros.perception import PerceptionNode
from imgu_ros.ros.process import init_ros, make_executor
from imgu_ros.ros.stopping import StopSignal

libc = ctypes.CDLL(None)
libc.malloc.restype, libc.malloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t]
libc.free.argtypes = [ctypes.c_void_p]
managed_node._FREE_MEMORY_S = float(sys.argv[1])


def block(size):
    at = libc.malloc(size)
    ctypes.memset(at, 1, size)
    return at


def scatter():
    blocks = []
    for _ in range(200):
        blocks.append(block(600_000))
        block(1000)
    for at in blocks:
        libc.free(at)


def resident_mb():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


bound_free_memory()
init_ros([])
node = PerceptionNode(StopSignal())
executor = make_executor(node.context)
executor.add_node(node)
before = resident_mb()
thread = threading.Thread(target=scatter)
thread.start()
thread.join()
end = time.monotonic() + 2
while time.monotonic() < end:
    executor.spin_once(timeout_sec=0.1)
print(resident_mb() - before)
executor.remove_node(node)
executor.shutdown()
node.close()
node.destroy_node()
"""


def test_a_node_returns_what_it_has_freed(ros_domain: int) -> None:
    environment = os.environ | {
        "ROS_DOMAIN_ID": str(ros_domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }  # fmt: skip

    def kept_mb(interval_s: str) -> float:
        command = [sys.executable, "-c", _PROGRAM, interval_s]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 0, done.stderr
        return float(done.stdout)

    # Of 120 MB.
    assert kept_mb("0.2") < 30 < 60 < kept_mb("1000")
