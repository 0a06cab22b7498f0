# SPDX-License-Identifier: Apache-2.0
"""Files that are never seen in part: written beside their place and renamed, or grown by whole lines."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import stat
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

from imgu_ros.errors import FileError

_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0)
#: Bytes of a name that the name of its part has, so that both fit into the 255 of a file system.
_NAME_BYTES = 200
#: No file beside this one, or none in its place: a folder that others own, a file that is mounted by itself.
_NOT_REPLACEABLE = (errno.EACCES, errno.EPERM, errno.EROFS, errno.EBUSY)


def write_whole(path: Path, content: bytes, *, synced: bool = False) -> None:
    """Write a whole file: it is there with all of `content`, or as it was before.

    A symbolic link is followed, and the file keeps its mode and, where that may be, its owner. What is no regular file
    (a pipe, `/dev/stdout`) is written directly, and so is a file whose folder cannot be written.

    Parameters
    ----------
    path : the file
    content : all of it
    synced : wait until it is on the disk; always done for a file that replaces another

    Raises
    ------
    FileError
        If the file cannot be written, or is there and may not be written: its folder's permission is not enough.
    """
    with file_errors(path):
        real = _followed(path)
        before = _status(real)
        if _is_device(real) or (before is not None and not stat.S_ISREG(before.st_mode)):
            _write_in_place(real, content)
            return
        if before is not None and not os.access(real, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        try:
            _replace(real, content, before, synced)
        except OSError as error:
            if before is None or error.errno not in _NOT_REPLACEABLE:
                raise
            _write_in_place(real, content)


def part_path(path: Path) -> Path:
    """Return where a file is written before it gets its name."""
    name = os.fsdecode(os.fsencode(path.name)[:_NAME_BYTES])
    return path.with_name(f".{name}.part")


class LineFile:
    """A text file (UTF-8) that gets its name with its first lines and grows by whole lines, each written at once.

    Characters that are none in UTF-8 (half a pair, of a name that came as other bytes) are written as escapes. What is
    at the path is replaced. A context manager.

    Parameters
    ----------
    path : the file
    head : its first lines
    continues : go on with the file that is there

    Raises
    ------
    FileError
        If the file cannot be written, here and in every call: then its last line is the last that was written whole.
    """

    def __init__(self, path: Path, head: str = "", continues: bool = False) -> None:
        self._path = path
        if continues:
            with file_errors(path):
                self._descriptor = os.open(path, os.O_WRONLY | getattr(os, "O_NOFOLLOW", 0))
            return
        with file_errors(path):
            self._descriptor, part = _new_part(path)
        try:
            self.write(head)
            with file_errors(path):
                os.replace(part, path)
        except BaseException:
            os.close(self._descriptor)
            _remove(part)
            raise

    def write(self, lines: str) -> int:
        """Append whole lines."""
        data = memoryview(lines.encode("utf-8", "backslashreplace"))
        with file_errors(self._path):
            begin = os.lseek(self._descriptor, 0, os.SEEK_END)
            done = 0
            try:
                while done < len(data):
                    done += os.write(self._descriptor, data[done:])
            except BaseException:
                os.ftruncate(self._descriptor, begin)
                raise
        return len(lines)

    def close(self) -> None:
        """Close the file; closing twice does nothing."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            with file_errors(self._path):
                os.close(descriptor)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def sync_file(path: Path) -> None:
    """Wait until a file is on the disk, or a folder's names are; where the file system cannot say, do not."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def file_errors(path: Path) -> Iterator[None]:
    """Turn what the operating system says of a file into a FileError."""
    try:
        yield
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = getattr(error, "strerror", None) or error
        raise FileError(f"{path}: {reason}; need a file that can be written") from None


def _replace(path: Path, content: bytes, before: os.stat_result | None, synced: bool) -> None:
    descriptor, part = _new_part(path)
    try:
        with open(descriptor, "wb") as file:
            if before is not None:
                with contextlib.suppress(OSError):
                    os.fchown(descriptor, before.st_uid, before.st_gid)
                os.fchmod(descriptor, stat.S_IMODE(before.st_mode))
            file.write(content)
            file.flush()
            if synced or before is not None:
                os.fsync(descriptor)
        os.replace(part, path)
    except BaseException:
        _remove(part)
        raise
    if synced:
        sync_file(path.parent)


def _new_part(path: Path) -> tuple[int, Path]:
    """Create the file beside `path`; return its descriptor and its name."""
    part = part_path(path)
    with contextlib.suppress(FileExistsError):
        return os.open(part, _NEW, 0o666), part
    # One that a killed process left, or another process is writing.
    part = part.with_name(f"{part.name}{secrets.token_hex(4)}")
    return os.open(part, _NEW, 0o666), part


def _followed(path: Path) -> Path:
    """Return where a symbolic link leads; not beyond a device or an open file of this process."""
    for _ in range(40):
        if not path.is_symlink() or str(path).startswith(("/dev/", "/proc/")):
            return path
        path = path.parent / os.readlink(path)
    raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))


def _is_device(path: Path) -> bool:
    """Return whether a path is a name of the kernel's, whatever it leads to."""
    return str(path).startswith(("/dev/fd/", "/dev/std", "/proc/"))


def _status(path: Path) -> os.stat_result | None:
    """Return what a file is; None when there is none."""
    try:
        return os.stat(path)
    except FileNotFoundError:
        return None


def _write_in_place(path: Path, content: bytes) -> None:
    with path.open("wb") as file:
        file.write(content)


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.unlink()
