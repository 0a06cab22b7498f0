# SPDX-License-Identifier: Apache-2.0
"""Some hostile frames over the wire; benchmarks/hostile_frames.py sends ten thousand."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

pytestmark = [pytest.mark.soak, pytest.mark.timeout(280)]

pytest.importorskip("rclpy", reason="needs the ros extra")


def test_the_node_lives_says_why_and_sees_the_next_good_frame(environment, repository):
    done = subprocess.run(
        [sys.executable, "benchmarks/hostile_frames.py", "--messages", "300", "--seed", "1"],
        cwd=repository, env=environment, capture_output=True, text=True, timeout=240, check=False,
    )  # fmt: skip
    assert done.stdout.startswith("{"), done.stderr
    figures = json.loads(done.stdout)
    assert figures.pop("ok"), figures
    for transport, said in figures.items():
        assert said["good_frames"] == said["good_frames_with_pose"] == 2, transport
        assert {"raw": "encoding", "compressed": "compressed image"}[transport] in said["reasons"]
        # A camera_info that lies costs the pose alone.
        assert said["uncalibrated"] > 0 and "camera_info" not in said["reasons"]
