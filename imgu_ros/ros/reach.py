# SPDX-License-Identifier: Apache-2.0
"""Which processes a node can reach: its ROS domain, restrictions to this machine, and shared memory of other users."""

from __future__ import annotations

import os
import pwd
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from rclpy.node import Node

from imgu_ros.ros.middleware import is_fast_dds

_RANGE, _PEERS, _ALONE = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY"
#: Values that confine nothing; whatever rcl does not know it takes for LOCALHOST.
_WIDE = ("", "SUBNET", "SYSTEM_DEFAULT")
_UDP = Path("/proc/net/udp")
_SHARED_MEMORY = Path("/dev/shm")
#: A DDS participant's ports: base + 250 x domain + 10 + 2 x its number, and the next one.
_BASE_PORT, _DOMAIN_PORTS, _FIRST_UNICAST = 7400, 250, 10
#: Beyond it ports are those that Linux gives to anybody.
_LARGEST_DOMAIN = 101
_MOST_NAMED = 5
NO_NAME = "_NODE_NAME_UNKNOWN_"


def domain_id(node: Node) -> int:
    """Return the ROS domain that a node is in."""
    return int(node.context.get_domain_id())


def domain_text(node: Node) -> str:
    """Return a node's domain, and what of the environment keeps it from others: `ROS domain 0`."""
    confined = confinement()
    return f"ROS domain {domain_id(node)}" + (f", {confined}" if confined else "")


def confinement() -> str:
    """Return what of the environment keeps this process from reaching others; empty when nothing does."""
    if os.environ.get(_ALONE) == "1":
        return f"this machine alone: {_ALONE}=1"
    reach = os.environ.get(_RANGE, "")
    if reach in _WIDE:
        return ""
    if reach == "OFF":
        return f"no other process: {_RANGE}=OFF"
    peers = os.environ.get(_PEERS, "")
    return f"this machine alone: {_RANGE}={reach}" + (f", but for {_PEERS}={peers}" if peers else "")


def elsewhere(node: Node) -> str:
    """Return where else on this machine nodes are, and what to do; empty when there are none."""
    others = other_domains(domain_id(node))
    if not others or confinement().startswith("no other"):
        return ""
    named = ", ".join(map(str, others[:_MOST_NAMED]))
    return f"this machine has nodes in ROS domain {named} as well: set ROS_DOMAIN_ID to the same in both"


def other_domains(own: int, table: Path = _UDP) -> list[int]:
    """Return the other domains in which this machine has DDS participants, by the UDP ports that they hold."""
    try:
        lines = table.read_text(encoding="ascii").splitlines()[1:]
    except OSError:
        return []
    ports = {int(line.split()[1].rpartition(":")[2], 16) for line in lines if len(line.split()) > 1}
    domains = set()
    for port in ports:
        domain, offset = divmod(port - _BASE_PORT, _DOMAIN_PORTS)
        is_first = offset >= _FIRST_UNICAST and offset % 2 == 0
        if 0 <= domain <= _LARGEST_DOMAIN and is_first and port + 1 in ports:
            domains.add(domain)
    return sorted(domains - {own})


def has_no_names(endpoints: Sequence[Any]) -> bool:
    """Return whether endpoints are known, and the name of none of their nodes: it comes the way that messages come."""
    return bool(endpoints) and all(endpoint.node_name == NO_NAME for endpoint in endpoints)


def another_user(nameless: bool) -> str:
    """Return why nothing comes of a publisher that was found, when its process is likely another user's.

    Fast DDS sends within a machine by shared memory, and its files belong to the user who made them: publisher and
    subscriber find each other by UDP, and nothing else arrives, not even the name of the publisher's node.

    Parameters
    ----------
    nameless : whether not even the name of its node has come

    Returns
    -------
    str
        Empty where another middleware is used.
    """
    if not is_fast_dds():
        return ""
    guess = "not even its node's name arrives, so it most likely runs" if nameless else "if it does, it may run"
    found = foreign_users()
    # Files that an ended process has left are another user's as well, and block as much (eProsima/Fast-DDS#3535).
    users = f" ({_SHARED_MEMORY} has fastrtps files of {', '.join(found[:_MOST_NAMED])})" if found else ""
    return (
        f"{guess} as another user or in another container{users}, whose shared memory this process cannot use: "
        f"run both as the same user, or set FASTDDS_BUILTIN_TRANSPORTS=UDPv4 in both{_transports_note()}"
    )


def foreign_users(folder: Path = _SHARED_MEMORY, own: int | None = None) -> list[str]:
    """Return the other users of this machine whose Fast DDS has shared memory, by name."""
    own = os.geteuid() if own is None else own
    return sorted({_user(uid) for uid in _owners(folder.glob("fastrtps_*")) if uid != own})


def _owners(paths: Iterable[Path]) -> set[int]:
    owners = set()
    for path in paths:
        try:
            owners.add(path.stat().st_uid)
        except OSError:  # gone since
            continue
    return owners


def _user(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return f"user {uid}"


def _transports_note() -> str:
    # With these rmw_fastrtps chooses the transports itself, whatever the variable says.
    if os.environ.get(_ALONE) == "1":
        return f" and {_ALONE}=0"
    return f" and {_RANGE}=SUBNET" if os.environ.get(_RANGE, "") not in _WIDE else ""
