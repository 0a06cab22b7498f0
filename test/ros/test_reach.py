# SPDX-License-Identifier: Apache-2.0
"""Which processes a node can reach, from the environment, the machine's ports and its shared memory."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

from imgu_ros.ros.reach import (
    another_user,
    confinement,
    domain_text,
    elsewhere,
    foreign_users,
    has_no_names,
    other_domains,
)

NAMES = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY")
HEAD = "   sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode\n"


def node_in(domain: int) -> Any:
    return SimpleNamespace(context=SimpleNamespace(get_domain_id=lambda: domain))


@pytest.fixture(autouse=True)
def plain_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (*NAMES, "RMW_IMPLEMENTATION"):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({}, ""),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, ""),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": ""}, ""),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"}, ""),
        ({"ROS_STATIC_PEERS": "10.0.0.7"}, ""),
        ({"ROS_LOCALHOST_ONLY": "0"}, ""),
        ({"ROS_LOCALHOST_ONLY": "1"}, "this machine alone: ROS_LOCALHOST_ONLY=1"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, "this machine alone: ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"),
        # rcl takes what it does not know for LOCALHOST.
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "subnet"}, "this machine alone: ROS_AUTOMATIC_DISCOVERY_RANGE=subnet"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, "no other process: ROS_AUTOMATIC_DISCOVERY_RANGE=OFF"),
        (
            {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": "10.0.0.7"},
            "this machine alone: ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, but for ROS_STATIC_PEERS=10.0.0.7",
        ),
    ],
)
def test_confinement(monkeypatch: pytest.MonkeyPatch, values: dict[str, str], said: str) -> None:
    for name, value in values.items():
        monkeypatch.setenv(name, value)
    assert confinement() == said
    assert domain_text(node_in(7)) == "ROS domain 7" + (f", {said}" if said else "")


def udp(folder: Path, *ports: int) -> Path:
    """Write the table of UDP sockets as Linux shows it."""
    lines = [
        f"{k:5d}: 0100007F:{port:04X} 00000000:0000 07 00000000:00000000 00:00000000 00000000     0        0 1 2 0 0\n"
        for k, port in enumerate(ports)
    ]
    path = folder / "udp"
    path.write_text(HEAD + "".join(lines))
    return path


def test_domains_of_this_machine(tmp_path: Path) -> None:
    # Discovery and data of the first participant of domain 0 and of the third of domain 62; single ports are no ROS's.
    table = udp(tmp_path, 7410, 7411, 22914, 22915, 53, 7660, 8161, 40000, 40001, 7400)
    assert other_domains(5, table) == [0, 62]
    assert other_domains(62, table) == [0]
    assert other_domains(0, tmp_path / "none") == []


def test_what_is_said_of_other_domains(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imgu_ros.ros.reach.other_domains", lambda own: [n for n in (0, 3) if n != own])
    assert elsewhere(node_in(3)) == (
        "this machine has nodes in ROS domain 0 as well: set ROS_DOMAIN_ID to the same in both"
    )
    monkeypatch.setattr("imgu_ros.ros.reach.other_domains", lambda own: [])
    assert elsewhere(node_in(3)) == ""


def test_the_likely_cause_of_a_publisher_that_is_found_and_not_heard(monkeypatch: pytest.MonkeyPatch) -> None:
    unknown, known = SimpleNamespace(node_name="_NODE_NAME_UNKNOWN_"), SimpleNamespace(node_name="driver")
    assert has_no_names([unknown]) and not has_no_names([unknown, known]) and not has_no_names([])
    monkeypatch.setattr("imgu_ros.ros.reach.foreign_users", lambda: ["robot"])
    said = another_user(nameless=True)
    assert said.startswith("not even its node's name arrives, so it most likely runs as another user")
    assert "(/dev/shm has fastrtps files of robot)" in said
    assert said.endswith("set FASTDDS_BUILTIN_TRANSPORTS=UDPv4 in both")
    assert another_user(nameless=False).startswith("if it does, it may run as another user")
    # Confined to this machine, rmw_fastrtps does not look at the variable.
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    assert another_user(nameless=True).endswith("UDPv4 in both and ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET")
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")
    assert another_user(nameless=True) == ""


def test_users_with_shared_memory(tmp_path: Path) -> None:
    for name in ("fastrtps_0123456789abcdef", "fastrtps_port7000", "sem.other"):
        (tmp_path / name).touch()
    mine = tmp_path.stat().st_uid
    assert foreign_users(tmp_path, own=mine) == []
    assert len(foreign_users(tmp_path, own=mine + 1)) == 1
    assert os.geteuid() == mine
