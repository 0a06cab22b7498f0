# SPDX-License-Identifier: Apache-2.0
"""Some seconds of good frames beside a hostile publisher; benchmarks/soak_hostile.py goes on for an hour."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

pytestmark = [pytest.mark.soak, pytest.mark.timeout(280)]

pytest.importorskip("rclpy", reason="needs the ros extra")


def test_no_good_frame_is_lost_unexplained_and_no_hostile_one_gives_a_pose(environment, repository, domain):
    done = subprocess.run(
        [sys.executable, "benchmarks/soak_hostile.py", "--minutes", "0.3", "--hostile-rate", "40",
         "--domain", str(domain)],
        cwd=repository, env=environment, capture_output=True, text=True, timeout=240, check=False,
    )  # fmt: skip
    assert done.stdout.startswith("{"), done.stderr
    figures = json.loads(done.stdout)
    assert figures["complete"] and figures["node_lived"] and figures["exit_code"] == 0
    assert not figures["log_errors"], figures["log_errors_first"]
    assert figures["good_sent"] > 300 and figures["good_with_pose"] > 30, figures
    assert figures["lost_by_us"] == figures["poses_of_hostile_frames"] == 0, figures
    assert figures["hostile_statuses"] > 20
    assert len(figures["hostile_sent"]) >= 6, figures["hostile_sent"]
