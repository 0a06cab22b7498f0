# SPDX-License-Identifier: Apache-2.0
"""The lock of an output folder: one run at a time writes there; a second one gets an error that names the first.

The kernel releases it when the process ends, however it ends: no lock outlives its run.
"""

from __future__ import annotations

import contextlib
import errno
import getpass
import json
import os
import shlex
import socket
import stat
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from imgu_ros.errors import FileError
from imgu_ros.shown_text import NAME_CHARACTERS, shown

#: Locked while a run writes; its modification time is that of the last write.
LOCK = ".imgu_lock"

_OPEN = os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK
_WITHOUT_LOCKS = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL, errno.EBADF)
#: A check whether a folder is in use holds its lock for a moment.
_ATTEMPTS, _PAUSE_S = 5, 0.03
_MOST_BYTES = 8192


@dataclass(frozen=True, slots=True)
class FolderLock:
    """A lock that is held.

    Attributes
    ----------
    descriptor : of the lock's file
    worked_until_ns : when the previous run last wrote; None when there was none
    is_sure : False where the file system has no locks
    """

    descriptor: int
    worked_until_ns: int | None
    is_sure: bool


@contextlib.contextmanager
def locked_folder(out: Path) -> Iterator[FolderLock]:
    """Hold the lock of the folder `out`.

    Raises
    ------
    FileError
        If another run holds it, or the lock cannot be made.
    OSError
        If the folder cannot be written.
    """
    descriptor = _opened(out, os.O_CREAT)
    try:
        is_sure = _try_lock(out, descriptor)
        before = os.fstat(descriptor)
        _write_owner(descriptor)
        if before.st_size:  # the time is the run's before, until this one begins to write
            os.utime(descriptor, ns=(before.st_atime_ns, before.st_mtime_ns))
        yield FolderLock(descriptor, before.st_mtime_ns if before.st_size else None, is_sure)
    finally:
        os.close(descriptor)


def last_work_ns(out: Path) -> int | None:
    """Return when the previous run last wrote into `out`; None when there was none. Changes nothing.

    Raises
    ------
    FileError
        If a run is at work there.
    """
    try:
        descriptor = _opened(out, 0)
    except FileNotFoundError:
        return None
    try:
        _try_lock(out, descriptor)
        status = os.fstat(descriptor)
        return status.st_mtime_ns if status.st_size else None
    finally:
        os.close(descriptor)


def _opened(out: Path, flags: int) -> int:
    path = out / LOCK
    try:
        descriptor = os.open(path, _OPEN | flags, 0o666)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.EISDIR, errno.ENXIO):
            raise FileError(f"{path}: no regular file; need another folder") from None
        raise
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode) or (status.st_size and not _owner(descriptor)):
        os.close(descriptor)
        raise FileError(f"{path}: no lock of a run; need another folder")
    return descriptor


def _try_lock(out: Path, descriptor: int) -> bool:
    """Lock the file; return False where the file system cannot."""
    # Imported here: systems without it have no locks of this kind.
    try:
        import fcntl
    except ImportError:
        return False
    for attempt in range(_ATTEMPTS):
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in _WITHOUT_LOCKS:
                return False
            if error.errno not in (errno.EAGAIN, errno.EACCES):
                raise
            if attempt < _ATTEMPTS - 1:
                time.sleep(_PAUSE_S)
        else:
            return True
    owner = _described(_owner(descriptor))
    raise FileError(f"{out}: another run writes there: {owner}; need another folder, or the end of that run")


def _write_owner(descriptor: int) -> None:
    user = ""
    with contextlib.suppress(OSError, KeyError, ImportError):
        user = getpass.getuser()
    owner = {
        "command": shlex.join([Path(sys.argv[0]).name or "imgu", *sys.argv[1:]])[:1000],
        "pid": os.getpid(),
        "user": user,
        "host": socket.gethostname(),
        "since": time.strftime("%Y-%m-%d %H:%M:%S %z"),
    }
    text = (json.dumps(owner) + "\n").encode("ascii")
    # In this order a full disk costs nothing of what was there.
    os.pwrite(descriptor, text, 0)
    os.ftruncate(descriptor, len(text))


def _owner(descriptor: int) -> dict[str, object]:
    """Return the present or last owner of the lock; empty when the file does not name one."""
    try:
        owner = json.loads(os.pread(descriptor, _MOST_BYTES, 0))
    except (ValueError, RecursionError):
        return {}
    return owner if isinstance(owner, dict) and "pid" in owner else {}


def _described(owner: dict[str, object]) -> str:
    if not owner:
        return "it has just begun"

    command, pid, user, host, since = (
        shown(str(owner.get(name, "?")), NAME_CHARACTERS) for name in ("command", "pid", "user", "host", "since")
    )
    return f"{command} (process {pid} of {user} on {host}, since {since})"
