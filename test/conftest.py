# SPDX-License-Identifier: Apache-2.0
"""What all tests share: real data, DDS domains, hypothesis profiles, and the line that says what was skipped."""

from __future__ import annotations

import os
import random
import re
import shutil
import socket
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from chromium import Chromium

# Before any test imports rclpy or starts a process: nothing leaves this machine.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ.pop("ROS_STATIC_PEERS", None)
# rclpy writes logs: not into the user's home.
_LOGS = tempfile.mkdtemp(prefix="imgu_test_logs_")
os.environ["ROS_LOG_DIR"] = _LOGS
# As the `imgu` command does, and before numpy is imported: small matrices gain nothing from a second BLAS thread.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Plots are drawn into files, never on a screen.
os.environ["MPLBACKEND"] = "Agg"

settings.register_profile("ci", deadline=None, derandomize=True, max_examples=20)
settings.register_profile("default", deadline=None, derandomize=True, max_examples=25)
settings.register_profile("thorough", deadline=None, max_examples=1000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci" if os.environ.get("CI") else "default"))

REPOSITORY = Path(__file__).resolve().parent.parent
if (BROWSER := str(REPOSITORY / "test" / "browser")) not in sys.path:  # `chromium`
    sys.path.append(BROWSER)

#: Domains whose UDP ports lie below the range that Linux gives to outgoing connections.
_DOMAINS = range(1, 102)


@pytest.fixture(scope="session")
def repository() -> Path:
    """Root of the repository."""
    return REPOSITORY


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the real images and bags: `$IMGU_DATA`, or `../shared/data`. Skips the test when there is none."""
    folder = Path(os.environ.get("IMGU_DATA") or REPOSITORY.parent / "shared" / "data")
    if not folder.is_dir():
        pytest.skip("no real data: set IMGU_DATA")
    return folder


@pytest.fixture
def ros_domain(monkeypatch: pytest.MonkeyPatch) -> int:
    """A ROS domain that nobody on this machine uses, set as ROS_DOMAIN_ID for this test and the processes it starts."""
    domain = free_domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    return domain


def free_domain() -> int:
    """Return a ROS domain in which no participant runs.

    The first participant of domain d on a machine listens on UDP port 7410 + 250 d (DDSI-RTPS 2.5, 9.6.2.3).
    """
    for domain in random.sample(_DOMAINS, len(_DOMAINS)):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("127.0.0.1", 7410 + 250 * domain))
            except OSError:
                continue
            return domain
    pytest.fail("every ROS domain is in use on this machine")


def pytest_unconfigure() -> None:
    """Remove the logs."""
    shutil.rmtree(_LOGS, ignore_errors=True)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say how many tests were skipped, and why, in one line."""
    skipped = terminalreporter.stats.get("skipped", [])
    reasons = Counter(_reason(report) for report in skipped)
    listed = "; ".join(f"{count} x {reason}" for reason, count in reasons.most_common())
    terminalreporter.write_line(f"tests skipped: {len(skipped)}" + (f" ({listed})" if listed else ""))


def _reason(report: pytest.TestReport) -> str:
    text = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    return re.sub(r"^Skipped: ", "", text)


@pytest.fixture(params=["ros", "bags"], scope="session")
def make(request):
    """A message factory."""
    if request.param == "ros":
        pytest.importorskip("sensor_msgs.msg", reason="the `ros` extra is not installed")
        from imgu_ros.ros.messages import make_message
    else:
        from imgu_ros.bags.messages import make_message
    return make_message


@pytest.fixture
def chromium(request: pytest.FixtureRequest) -> Iterator[Chromium]:
    """A browser; the marker `browser_options` gives options. Skips the test without Chromium, but not in CI."""
    from chromium import Chromium, find_chromium

    if find_chromium() is None:
        if os.environ.get("CI"):
            pytest.fail("no chromium on the PATH; need: apt install chromium")
        pytest.skip("no chromium on the PATH")
    marker = request.node.get_closest_marker("browser_options")
    with Chromium(*(marker.args if marker else ())) as browser:
        yield browser
