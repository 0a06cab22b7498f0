# SPDX-License-Identifier: Apache-2.0
"""Compare this package's readers of recordings with rosbags' and with mcap's, on intact and on hostile files.

    python benchmarks/bag_readers.py --out benchmarks/figures/bag_readers.json

Intact files: the same messages in MCAP, SQLite and ROS 1, of images (2 MB) and of small messages; each is read twice in
a process of its own by each reader: processor time per message (the faster pass), peak memory above that before it was
opened, and a digest of (topic, time, bytes) that must be equal. Hostile files: the fuzzer's named recordings
(`fuzz/corpus_recordings.py`), read with the bounds that SECURITY.md promises (10 s, 1.5 GB). `mcap` is compared where
it is installed (`pip install mcap`).
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import multiprocessing
import os
import resource
import tempfile
import time
import zlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from fuzz.corpus import CORPUS
from fuzz.kinds import RECORDING
from imgu_ros.bags.compression import decompressed_message
from imgu_ros.bags.reading import open_bag
from imgu_ros.errors import ImguError

_MOST_SECONDS, _MOST_MB = 10.0, 1500.0
#: Seconds after which a process that uses no processor counts as waiting for ever.
_MOST_WAIT = 60.0
_ADDRESS_SPACE = 6 * 2**30
Message = tuple[str, int, Any]
Reader = Callable[[Path], Iterable[Message]]


def ours(path: Path) -> Iterator[Message]:
    """Read with this package."""
    with open_bag([path]) as bag:
        # rosbag2 may have compressed each message by itself, which rosbags undoes too.
        for raw in bag.raw_messages():
            yield raw.channel.topic, raw.time_ns, decompressed_message(raw.data)


def rosbags(path: Path) -> Iterator[Message]:
    """Read with rosbags, whose reader for any recording takes files of one and folders of several."""
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        yield from ((connection.topic, time_ns, data) for connection, time_ns, data in reader.messages())


def mcap(path: Path) -> Iterator[Message]:
    """Read with the mcap library."""
    from mcap.reader import make_reader

    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        yield from ((channel.topic, message.log_time, message.data) for _, channel, message in reader.iter_messages())


READERS: dict[str, Reader] = {"ours": ours, "rosbags": rosbags, "mcap": mcap}


def recordings(folder: Path, images: int, small: int) -> Iterator[tuple[str, Path, Path]]:
    """Write the intact files; yield name, what ours and rosbags open, and the file alone."""
    store = get_typestore(Stores.ROS2_JAZZY)
    data = np.random.default_rng(1).integers(0, 64, 1920 * 1080, dtype=np.uint8)  # about half when compressed
    header = store.types["std_msgs/msg/Header"](store.types["builtin_interfaces/msg/Time"](1, 2), "camera")
    image = store.types["sensor_msgs/msg/Image"](header, 1080, 1920, "bayer_rggb8", 0, 1920, data)
    text = store.types["std_msgs/msg/String"](data="a small message of a recording with many of them")
    for kind, message, count in (("images", image, images), ("small messages", text, small)):
        type_name = message.__msgtype__
        content = store.serialize_cdr(message, type_name)
        for plugin in (StoragePlugin.MCAP, StoragePlugin.SQLITE3):
            for method in ("none", "zstd"):
                path = folder / f"{kind}-{plugin.name}-{method}".replace(" ", "_")
                writer = Writer(path, version=9, storage_plugin=plugin)
                if method == "zstd":
                    is_mcap = plugin == StoragePlugin.MCAP
                    mode = CompressionMode.STORAGE if is_mcap else CompressionMode.MESSAGE
                    writer.set_compression(mode, CompressionFormat.ZSTD)
                with writer:
                    connection = writer.add_connection("/topic", type_name, typestore=store)
                    for number in range(count):
                        writer.write(connection, 10**18 + number * 10**7, content)
                file = next(one for one in path.iterdir() if one.suffix in (".mcap", ".db3"))
                yield f"{kind}, {plugin.name}, {method}", path, file
        ros1 = get_typestore(Stores.ROS1_NOETIC)
        if kind == "images":
            header1 = ros1.types["std_msgs/msg/Header"](0, header.stamp, "camera")
            message = ros1.types[type_name](header1, 1080, 1920, "bayer_rggb8", 0, 1920, data)
        content = ros1.serialize_ros1(message, type_name)
        for compression in (None, Writer1.CompressionFormat.LZ4):
            path = folder / f"{kind}-{compression}.bag".replace(" ", "_")
            writer1 = Writer1(path)
            if compression is not None:
                writer1.set_compression(compression)
            with writer1:
                connection = writer1.add_connection("/topic", type_name, typestore=ros1)
                for number in range(count):
                    writer1.write(connection, 10**18 + number * 10**7, content)
            yield f"{kind}, ROS1, {'none' if compression is None else 'lz4'}", path, path


def _status_mb(name: str) -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(f"{name}:"))


def _cpu_seconds(pid: int) -> float:
    """Return the processor time of a process; 0 when it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _read(reader: str, path: Path, passes: int, answers: Any) -> None:
    """Read in this process, which ends with it; put what came of it."""
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE, _ADDRESS_SPACE))
    Path("/proc/self/clear_refs").write_text("5")
    base = _status_mb("VmRSS")
    answer: dict[str, Any] = {"messages": 0, "error": "", "is_expected": True}
    seconds = []
    try:
        for _ in range(passes):
            start, digest, taken = time.process_time(), 0, 0.0
            for count, (topic, time_ns, data) in enumerate(READERS[reader](path), 1):
                answer["messages"] = max(answer["messages"], count)
                before = time.process_time()
                digest = zlib.crc32(data, zlib.crc32(f"{topic} {time_ns}".encode(), digest))
                taken += time.process_time() - before  # the digest is not the reader's
            seconds.append(time.process_time() - start - taken)
            answer["digest"] = digest
    except BaseException as error:
        answer["error"] = f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"
        declared = type(error).__module__.startswith(("rosbags", "mcap")) or isinstance(error, ImguError)
        answer["is_expected"] = declared
        seconds.append(time.process_time() - start)
    answer["cpu_s"], answer["peak_mb"] = min(seconds), _status_mb("VmHWM") - base
    answers.send(answer)


def read(reader: str, path: Path, passes: int = 1) -> dict[str, Any]:
    """Read a file in a process of its own, which is ended when it takes too much processor time, or waits."""
    receiving, sending = multiprocessing.Pipe(duplex=False)
    process = multiprocessing.get_context("fork").Process(target=_read, args=(reader, path, passes, sending))
    process.start()
    sending.close()
    answer: dict[str, Any] = {"messages": 0, "error": "ended", "is_expected": False, "cpu_s": 999.0, "peak_mb": 0.0}
    begin = time.monotonic()
    try:
        while not receiving.poll(0.5):
            used, waited = _cpu_seconds(process.pid or 0), time.monotonic() - begin
            if used > 4 * _MOST_SECONDS * passes or (waited > _MOST_WAIT and used < 1):
                break
        else:
            answer = receiving.recv()
    except EOFError:
        answer["error"] = "the process died"
    process.kill()
    process.join()
    return answer


def intact(images: int, small: int, readers: list[str]) -> list[dict[str, Any]]:
    """Compare the readers on files that are whole."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, path, file in recordings(Path(folder), images, small):
            row: dict[str, Any] = {"recording": name}
            for reader in readers:
                if reader == "mcap" and file.suffix != ".mcap":
                    continue
                answer = read(reader, file if reader == "mcap" else path, 2)
                count = max(1, answer["messages"])
                row[reader] = {
                    "us_a_message": round(1e6 * answer["cpu_s"] / count, 2),
                    "peak_mb": round(answer["peak_mb"], 1),
                    "messages": answer["messages"],
                    "is_equal": answer.get("digest") == row.get("digest", answer.get("digest")),
                    "error": answer["error"],
                }
                row.setdefault("digest", answer.get("digest"))
            row.pop("digest")
            rows.append(row)
            print(json.dumps(row), flush=True)
    return rows


def hostile(readers: list[str]) -> dict[str, Any]:
    """Count what becomes of the fuzzer's named recordings."""
    rows: dict[str, Any] = {}
    for name, entry in CORPUS.items():
        if entry.reader != RECORDING:
            continue
        with tempfile.TemporaryDirectory() as folder:
            path = entry.build(Path(folder))
            rows[name] = {
                reader: read(reader, path) for reader in readers if reader != "mcap" or path.suffix == ".mcap"
            }
            if entry.deep:
                for one in Path(folder).rglob("*"):
                    one.parent.chmod(0o755)
        print(name, json.dumps(rows[name]), flush=True)
    return {
        reader: {
            "files": sum(reader in row for row in rows.values()),
            "beyond the bounds": _named(
                rows, reader, lambda answer: answer["cpu_s"] > _MOST_SECONDS or answer["peak_mb"] > _MOST_MB
            ),
            "undeclared errors": _named(rows, reader, lambda answer: not answer["is_expected"]),
            "fewer messages": sum(
                row[reader]["messages"] < row["ours"]["messages"] for row in rows.values() if reader in row
            ),
        }
        for reader in readers
    }


def _named(rows: dict[str, Any], reader: str, holds: Callable[[dict[str, Any]], bool]) -> list[str]:
    return [name for name, row in rows.items() if reader in row and holds(row[reader])]


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=100)
    parser.add_argument("--small", type=int, default=100_000)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    readers = ["ours", "rosbags"] + (["mcap"] if importlib.util.find_spec("mcap") else [])
    document = {
        "intact": intact(arguments.images, arguments.small, readers),
        "hostile": hostile(readers),
    }
    if arguments.out:
        arguments.out.write_text(json.dumps(document, indent=1) + "\n")
    print(json.dumps(document["hostile"], indent=1))


if __name__ == "__main__":
    main()
