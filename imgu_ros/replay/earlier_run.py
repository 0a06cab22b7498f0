# SPDX-License-Identifier: Apache-2.0
"""The files of an earlier run: its list of them, and their removal. Files of anybody else are never removed."""

from __future__ import annotations

import contextlib
import json
import os
import stat
from collections.abc import Collection
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from imgu_ros.errors import FileError
from imgu_ros.file_access.text_files import write_text
from imgu_ros.replay.folder_lock import LOCK

MANIFEST = ".imgu_files.json"

_VERSION = 1
_MOST_BYTES = 4_000_000
_MOST_DEPTH = 3
_MOST_CHARACTERS = 1024
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW
#: Tolerance between a file's last change and the mark of the run's last write; some file systems count in 2 s.
_SLACK_NS = 3_000_000_000
_KINDS = {stat.S_IFDIR: "a folder", stat.S_IFLNK: "a symbolic link", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}


@dataclass(frozen=True, slots=True)
class Manifest:
    """The list of files in a folder.

    Attributes
    ----------
    kind : what the run was: `replay`, `simulation`
    files : relative names, parts joined by /
    began_ns : when the list was written, before every file in it; by the clock of the file system
    """

    kind: str
    files: frozenset[str]
    began_ns: int


def write_manifest(out: Path, kind: str, files: Collection[str]) -> None:
    """Write the list of the files that are about to be written.

    Raises
    ------
    FileError
        If it cannot be written.
    """
    text = json.dumps({"version": _VERSION, "kind": kind, "files": sorted(files)}, indent=1) + "\n"
    write_text(out / MANIFEST, text, synced=True)


def read_manifest(out: Path) -> Manifest | None:
    """Read the list of a folder, which is not trusted; None when there is none.

    Raises
    ------
    FileError
        If there is something that is no such list, or it names what is not in this folder.
    OSError
        If it cannot be read.
    """
    path = out / MANIFEST
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise FileError(f"{path}: {error.strerror}; need another folder") from None
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode):
        os.close(descriptor)
        raise FileError(f"{path}: no regular file; need another folder")
    with open(descriptor, "rb") as file:
        text = file.read(_MOST_BYTES + 1)
    try:
        if len(text) > _MOST_BYTES:
            raise ValueError(f"more than {_MOST_BYTES} bytes")
        kind, files = _parsed(json.loads(text))
    except (ValueError, RecursionError) as error:
        raise FileError(f"{path}: not a run's list of files ({error}); need another folder") from None
    return Manifest(kind, files, status.st_mtime_ns)


@dataclass(frozen=True, slots=True)
class EarlierRun:
    """A run that wrote into the folder.

    Attributes
    ----------
    manifest : its list
    until_ns : when it last wrote; None: not known
    """

    manifest: Manifest
    until_ns: int | None


class EarlierFiles:
    """Finds the files in the way, and removes them when all are an earlier run's; a context manager.

    A file is an earlier run's when that run's list names it, it is a regular file, and was not changed after that run
    had ended. Folders are opened once and without following links: the checked files are those that are removed.

    Parameters
    ----------
    out : the folder
    wanted : names of the files that are about to be written
    earlier : the run before; None when there was none

    Raises
    ------
    FileError
        If anything else is in the way, naming it.
    """

    def __init__(self, out: Path, wanted: Collection[str], earlier: EarlierRun | None) -> None:
        self._out = out
        self._earlier = earlier
        self._listed = frozenset[str]() if earlier is None else earlier.manifest.files
        self._files: list[str] = []
        self._folders: dict[str, int | None] = {}
        names = self._listed | set(wanted)
        with ExitStack() as stack:
            self._stack = stack
            self._folders[""] = self._open(str(out), os.O_RDONLY | os.O_DIRECTORY, None)
            for folder in sorted(_parents(names)):  # an outer one before those in it
                self._look_into(folder, names)
            for name in sorted(names):
                self._look_at(name)
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def remove(self, first: str) -> None:
        """Remove all files, `first` before the others, then the folders that have become empty."""
        for name in sorted(self._files, key=lambda name: name != first):
            folder, _, base = name.rpartition("/")
            with contextlib.suppress(FileNotFoundError):
                os.unlink(base, dir_fd=self._folders[folder])
        for path in sorted(filter(None, self._folders), reverse=True):  # an inner one before those around it
            folder, _, base = path.rpartition("/")
            if self._folders[path] is not None:
                os.rmdir(base, dir_fd=self._folders[folder])

    def _look_into(self, path: str, names: Collection[str]) -> None:
        """Open a folder; refuse what is none, and one that holds anything which is not listed."""
        self._folders[path] = None
        status = self._status(path)
        if status is None:
            return
        if not stat.S_ISDIR(status.st_mode):
            raise self._refused(path, _kind(status))
        if path not in _parents(self._listed):
            raise self._refused(path, self._not_ours())
        folder, _, base = path.rpartition("/")
        descriptor = self._open(base, _FOLDER, self._folders[folder])
        self._folders[path] = descriptor
        known = set(names) | _parents(names)
        for entry in sorted(os.listdir(descriptor)):
            if f"{path}/{entry}" not in known:
                raise self._refused(f"{path}/{entry}", self._not_ours())

    def _look_at(self, name: str) -> None:
        status = self._status(name)
        if status is None:
            return
        if name not in self._listed:
            raise self._refused(name, self._not_ours())
        if not stat.S_ISREG(status.st_mode):
            raise self._refused(name, _kind(status))
        assert self._earlier is not None
        began_ns, until_ns = self._earlier.manifest.began_ns, self._earlier.until_ns
        if until_ns is None:
            raise self._refused(name, "nothing tells whether it was changed since its run")
        if not began_ns - _SLACK_NS <= status.st_mtime_ns <= until_ns + _SLACK_NS:
            raise self._refused(name, "changed since the run that wrote it")
        self._files.append(name)

    def _status(self, name: str) -> os.stat_result | None:
        folder, _, base = name.rpartition("/")
        descriptor = self._folders[folder]
        if descriptor is None:
            return None
        try:
            return os.stat(base, dir_fd=descriptor, follow_symlinks=False)
        except FileNotFoundError:
            return None

    def _open(self, name: str, flags: int, within: int | None) -> int:
        descriptor = os.open(name, flags, dir_fd=within)
        self._stack.callback(os.close, descriptor)
        return descriptor

    def _not_ours(self) -> str:
        if self._earlier is None:
            return f"no list of a run ({MANIFEST}) names it: it is yours, or of an earlier version"
        return f"not in the earlier run's list ({MANIFEST})"

    def _refused(self, name: str, what: str) -> FileError:
        return FileError(f"{self._out / name}: {what}; it is not removed: move it away, or name another folder")


def _kind(status: os.stat_result) -> str:
    return f"{_KINDS.get(stat.S_IFMT(status.st_mode), 'a special file')} where a run has its own"


def _parents(names: Collection[str]) -> set[str]:
    """Return the folders that relative names lie in."""
    return {"/".join(parts[:end]) for parts in (name.split("/") for name in names) for end in range(1, len(parts))}


def _parsed(document: object) -> tuple[str, frozenset[str]]:
    if not isinstance(document, dict) or document.get("version") != _VERSION:
        raise ValueError(f"need version {_VERSION}")
    kind, files = document.get("kind"), document.get("files")
    if not isinstance(kind, str) or not kind.isidentifier() or not isinstance(files, list):
        raise ValueError("need kind and files")
    for name in files:
        if not isinstance(name, str) or not _is_inside(name):
            raise ValueError(f"{str(name)[:80]!a} is no name in the folder")
    return kind[:40], frozenset(files)


def _is_inside(name: str) -> bool:
    parts = name.split("/")
    try:
        os.fsencode(name)
    except UnicodeEncodeError:  # half a character, which no file's name has
        return False
    return (
        len(name) <= _MOST_CHARACTERS
        and "\0" not in name
        and len(parts) <= _MOST_DEPTH
        and not any(part in ("", ".", "..", MANIFEST, LOCK) for part in parts)
    )
