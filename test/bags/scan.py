# SPDX-License-Identifier: Apache-2.0
"""What an MCAP file or a ROS 1 bag holds by the formats' descriptions alone: a scan from the first record on.

It knows no damage: it ends where a record does not hold, and a chunk that cannot be decompressed is passed over.
"""

from __future__ import annotations

import bz2
import struct
from collections import Counter

import lz4.frame

from imgu_ros.bags.compression import zstd

UNPACK = {b"": bytes, b"none": bytes, b"zstd": zstd.decompress, b"lz4": lz4.frame.decompress, b"bz2": bz2.decompress}
Found = Counter[tuple[int, bytes]]


def scan_mcap(data: bytes) -> Found:
    """Return (time, bytes) of each message of a channel that is defined before it."""
    found: Found = Counter()
    channels: set[int] = set()
    pending = [(data, 8)]
    while pending:
        data, at = pending.pop()
        while at + 9 <= len(data):
            opcode, length = struct.unpack_from("<BQ", data, at)
            content, at = data[at + 9 : at + 9 + length], at + 9 + length
            if opcode == 0 or at > len(data):
                break
            if opcode == 4 and length >= 2:
                channels.add(int.from_bytes(content[:2], "little"))
            elif opcode == 5 and length >= 22:
                channel, _, time_ns = struct.unpack_from("<HIQ", content)
                if channel in channels:
                    found[min(time_ns, 2**63 - 1), content[22:]] += 1
            elif opcode == 6:
                try:
                    (name,) = struct.unpack_from("<I", content, 28)
                    (size,) = struct.unpack_from("<Q", content, 32 + name)
                    assert 40 + name + size == length
                    inner = UNPACK[content[32 : 32 + name]](content[40 + name :])
                except Exception:
                    continue
                pending.append((data, at))
                data, at = inner, 0
    return found


def scan_rosbag1(data: bytes) -> Found:
    """Return (time, bytes) of each message; every connection is known, for they are defined twice."""
    found: Found = Counter()
    pending = [(data, 13)]
    while pending:
        data, at = pending.pop()
        while at + 4 <= len(data):
            end = at + 4 + int.from_bytes(data[at : at + 4], "little")
            fields, at = {}, at + 4
            while at < end <= len(data):
                size = int.from_bytes(data[at : at + 4], "little")
                name, separator, value = data[at + 4 : at + 4 + size].partition(b"=")
                if not separator or at + 4 + size > end:
                    break
                fields[name], at = value, at + 4 + size
            at = end + 4 + int.from_bytes(data[end : end + 4], "little")
            content = data[end + 4 : at]
            if at > len(data):
                break
            if fields.get(b"op") == b"\2" and len(fields.get(b"time", b"")) == 8:
                seconds, nanoseconds = struct.unpack("<II", fields[b"time"])
                found[seconds * 10**9 + nanoseconds, content] += 1
            elif fields.get(b"op") == b"\5":
                try:
                    inner = UNPACK[fields[b"compression"]](content)
                except Exception:
                    continue
                pending.append((data, at))
                data, at = inner, 0
    return found
