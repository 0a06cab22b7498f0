# SPDX-License-Identifier: Apache-2.0
"""Write a rosbag2 directory that `ros2 bag`, rosbags and Foxglove read."""

from __future__ import annotations

import contextlib
import os
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, Self

from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer, WriterError
from rosbags.serde import SerdeError

from imgu_ros.bags.messages import message_layout, typestore
from imgu_ros.bags.storage import MAX_TIME_NS
from imgu_ros.errors import BagError

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

#: Of rosbag2's formats, the one that Jazzy writes.
_FORMAT_VERSION: Literal[9] = 9

_PLUGINS = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}

# MCAP's own chunk compression is read by every MCAP tool; compression by message, all that SQLite has, by few.
_COMPRESSION_MODES = {"mcap": CompressionMode.STORAGE, "sqlite3": CompressionMode.MESSAGE}


def bag_files(name: str, storage: str = "mcap") -> tuple[str, ...]:
    """Return the names of the files of a bag whose folder is called `name`; the last one makes it a bag."""
    return (f"{name}.{'mcap' if storage == 'mcap' else 'db3'}", "metadata.yaml")


def unfinished_bag_files(name: str) -> tuple[str, ...]:
    """Return the names that such a folder can hold while the bag is written, in whatever storage."""
    return (
        *bag_files(name),
        "metadata.yaml.tmp",
        *(f"{name}.db3{suffix}" for suffix in ("", "-journal", "-wal", "-shm")),
    )


class BagWriter:
    """Writes messages made by `make_message` into a new rosbag2 directory, one by one, in bounded memory.

    Topics appear in the bag with their first message. Use it as a context manager: leaving it completes the bag, after
    an error too, so that what was written can be read.

    Parameters
    ----------
    path : the bag's directory; it must not exist, or be empty
    storage : "mcap" or "sqlite3"
    compression : "none" or "zstd" (MCAP: by chunk; SQLite: by message)

    Raises
    ------
    BagError
        If the directory is not empty or cannot be made, or the storage or compression is unknown.
    """

    def __init__(
        self,
        path: Path,
        storage: Literal["mcap", "sqlite3"] = "mcap",
        compression: Literal["none", "zstd"] = "none",
    ) -> None:
        if storage not in _PLUGINS:
            raise BagError(f"storage: {storage!r}; need {' or '.join(_PLUGINS)}")
        if compression not in ("none", "zstd"):
            raise BagError(f"compression: {compression!r}; need none or zstd")
        self.path = Path(os.path.abspath(path))  # rosbags names the file in the folder after the folder
        if storage == "sqlite3" and set("?#%") & set(str(self.path)):
            raise BagError(f"{self.path}: rosbags cannot write SQLite there; need a path without ? # %")
        self._connections: dict[str, Connection] = {}
        with _bag_errors(self.path):
            _remove_if_empty(self.path)
            self._writer = Writer(self.path, version=_FORMAT_VERSION, storage_plugin=_PLUGINS[storage])
            if compression == "zstd":
                self._writer.set_compression(_COMPRESSION_MODES[storage], CompressionFormat.ZSTD)
            self._writer.open()

    def write(self, topic: str, message: Any, time_ns: int, *also: str) -> None:
        """Append `message` to `topic`.

        Parameters
        ----------
        topic : absolute name, "/camera/image_raw"
        message : made by `make_message`
        time_ns : time of recording, nanoseconds since the epoch, >= 0
        *also : more topics for the same message

        Raises
        ------
        BagError
            If the message is of another type than the topic's earlier ones, has a field that does not fit its type,
            or cannot be written.
        """
        if not 0 <= time_ns < MAX_TIME_NS:
            raise BagError(f"{topic}: time {time_ns} ns; need 0 to {MAX_TIME_NS - 1}")
        type_name = getattr(message, "__msgtype__", None)
        if type_name is None:
            raise BagError(f"{topic}: {type(message).__name__}; need a message made by make_message")
        with _bag_errors(self.path, topic):
            data = typestore().serialize_cdr(message, type_name)
        for name in (topic, *also):
            with _bag_errors(self.path, name):
                self._writer.write(self._connection(name, type_name), int(time_ns), data)

    def copy(self, topic: str, type_name: str, data: bytes | memoryview, time_ns: int) -> None:
        """Append a message that is serialised already (CDR with its encapsulation), of one of our types.

        Raises
        ------
        BagError
            As `write`; if there is no such type.
        """
        if not 0 <= time_ns < MAX_TIME_NS:
            raise BagError(f"{topic}: time {time_ns} ns; need 0 to {MAX_TIME_NS - 1}")
        message_layout(type_name)
        with _bag_errors(self.path, topic):
            self._writer.write(self._connection(topic, type_name), int(time_ns), data)

    def _connection(self, topic: str, type_name: str) -> Connection:
        connection = self._connections.get(topic)
        if connection is None:
            connection = self._writer.add_connection(topic, type_name, typestore=typestore())
            self._connections[topic] = connection
        if connection.msgtype != type_name:
            raise BagError(f"{topic}: message of type {type_name}; need {connection.msgtype}, as the topic's first")
        return connection

    def close(self) -> None:
        """Complete the bag: index and metadata. Closing twice does nothing."""
        if self._writer.storage is None:
            return
        try:
            with _bag_errors(self.path):
                self._writer.close()
        except BagError:
            with contextlib.suppress(Exception):
                self._writer.abort()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.close()
        else:  # the error under way is the one to report
            with contextlib.suppress(BagError):
                self.close()


def _remove_if_empty(path: Path) -> None:
    """Make way for rosbags, which insists on making the directory itself."""
    if path.is_dir() and not path.is_symlink():
        if any(path.iterdir()):
            raise BagError(f"{path}: folder is not empty; need a new or an empty one")
        path.rmdir()
    elif path.exists() or path.is_symlink():
        raise BagError(f"{path}: exists already; need a new or an empty folder")


@contextlib.contextmanager
def _bag_errors(path: Path, topic: str = "") -> Iterator[None]:
    what = f"{path}: {topic}: " if topic else f"{path}: "
    try:
        yield
    except OSError as error:
        raise BagError(f"{what}{error.strerror or error}; need a folder that can be written") from None
    except (WriterError, SerdeError, sqlite3.Error) as error:
        raise BagError(f"{what}cannot write: {' '.join(str(error).split()) or type(error).__name__}") from None
    except (TypeError, ValueError, AttributeError, OverflowError, AssertionError, KeyError) as error:
        # raised by the generated serialisers for a field of the wrong Python type
        raise BagError(f"{what}message cannot be serialised: {error!r}; need fields of the message's types") from None
