# SPDX-License-Identifier: Apache-2.0
"""The list of files that a run writes into its folder: what a later run may remove, and nothing else."""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from imgu_ros.errors import FileError
from imgu_ros.file_access.text_files import write_text
from imgu_ros.replay.folder_lock import LOCK

MANIFEST = ".imgu_files.json"

_VERSION = 1
_MOST_BYTES = 4_000_000
_MOST_DEPTH = 3
_MOST_CHARACTERS = 1024


@dataclass(frozen=True, slots=True)
class Manifest:
    """What a folder's list says.

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
    """Return what the folder's list says; None when there is none. It is trusted in nothing.

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
