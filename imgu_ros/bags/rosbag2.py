# SPDX-License-Identifier: Apache-2.0
"""A rosbag2 directory: which files belong to it, and which of them are missing."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from imgu_ros.bags.storage import Warnings, seconds
from imgu_ros.bags.text import text_of
from imgu_ros.errors import BagError

METADATA = "metadata.yaml"
_SUFFIXES = (".mcap", ".db3", ".zstd")
#: A real one has some kilobytes; YAML of any size could otherwise eat the memory.
_MAX_METADATA_BYTES = 2**24
_STORAGES = {"mcap": ".mcap", "sqlite3": ".db3"}
#: Gives text for every scalar: there are no tags, dates or numbers that it could refuse.
_LOADER = getattr(yaml, "CBaseLoader", yaml.BaseLoader)


@dataclass(frozen=True, slots=True)
class Announced:
    """What metadata.yaml says.

    Attributes
    ----------
    files : names, in order, without folders
    suffix : of files of the storage that it names, such as ".mcap"; empty: not said
    message_count : messages in all; -1: not said
    file_counts : messages by file name, where said
    starts_ns, ends_ns : times by file name, where said
    """

    files: tuple[str, ...]
    suffix: str
    message_count: int
    file_counts: dict[str, int]
    starts_ns: dict[str, int]
    ends_ns: dict[str, int]


@dataclass(frozen=True, slots=True)
class Split:
    """A file of the bag that is there, and the number of messages that metadata.yaml announces for it (-1: none)."""

    path: Path
    message_count: int


def splits(folder: Path, warnings: Warnings) -> tuple[Split, ...]:
    """Return the bag's files that are there; what is missing becomes a warning.

    Files are looked for by name in the folder, whatever path metadata.yaml gives. Where none of those that it names is
    there, the files that are there are the bag: they were renamed, or their names are of another system.

    Raises
    ------
    BagError
        If the folder holds no bag.
    """
    try:
        present = sorted(path for path in folder.iterdir() if path.suffix in _SUFFIXES and path.is_file())
    except OSError as error:
        raise BagError(f"{folder}: {error.strerror}; need a readable folder") from None
    announced = _announced(folder, warnings)
    if announced is None:
        if not present:
            raise BagError(
                f"{folder}: no bag in this folder; need .mcap or .db3 files, and their {METADATA} (name a .bag itself)"
            )
        return tuple(Split(path, -1) for path in present)
    found = {name: _located(folder, name) for name in announced.files}
    missing = [name for name, path in found.items() if path is None]
    if missing and len(missing) == len(found):
        renamed = _of_storage(present, announced.suffix)
        if not renamed:
            raise BagError(f"{folder}: its files are missing ({_listed(missing)}); need those that {METADATA} names")
        there = _listed([path.name for path in renamed])
        warnings.add(f"{folder.name}: {METADATA} names {_listed(missing)}, which is not there; read instead: {there}")
        only = announced.message_count if len(found) == len(renamed) == 1 else -1
        return tuple(Split(path, only) for path in renamed)
    if missing:
        unnamed = [path.name for path in present if path not in found.values()]
        _warn_of_missing(folder, missing, unnamed, announced, warnings)
    only = announced.message_count if len(found) == 1 else -1
    return tuple(Split(path, announced.file_counts.get(name, only)) for name, path in found.items() if path is not None)


def _announced(folder: Path, warnings: Warnings) -> Announced | None:
    """Return what metadata.yaml says; None, with a warning, when it is missing or makes no sense."""
    path = folder / METADATA
    if not path.exists():
        warnings.add(f"{folder.name}: no {METADATA}: the files in the folder are read")
        return None
    try:
        if path.stat().st_size > _MAX_METADATA_BYTES:
            raise ValueError(f"more than {_MAX_METADATA_BYTES} bytes")
        content = yaml.load(text_of(path.read_bytes()), _LOADER)
        return _parsed(content["rosbag2_bagfile_information"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        warnings.add(f"{folder.name}: {METADATA} cannot be read ({reason}): the files in the folder are read")
        return None


def _parsed(information: dict[str, Any]) -> Announced:
    """Take what is needed, and nothing that is not: topics, QoS profiles, custom data and versions may be anything."""
    counts: dict[str, int] = {}
    starts: dict[str, int] = {}
    ends: dict[str, int] = {}
    described: list[str] = []
    for entry in _listed_in(information, "files"):
        try:
            name = _base_name(entry["path"])
            described.append(name)
            counts[name] = int(entry["message_count"])
            starts[name] = int(entry["starting_time"]["nanoseconds_since_epoch"])
            ends[name] = starts[name] + int(entry["duration"]["nanoseconds"])
        except (KeyError, TypeError, ValueError):
            continue  # it says less of this file
    names = [_base_name(name) for name in _listed_in(information, "relative_file_paths")] or described
    if not names:
        raise ValueError("it names no file")
    try:
        total = int(information.get("message_count", -1))
    except (TypeError, ValueError):
        total = -1
    suffix = _STORAGES.get(str(information.get("storage_identifier", "")), "")
    known = counts.keys() & starts.keys() & ends.keys()
    return Announced(
        tuple(dict.fromkeys(names)),
        suffix,
        total,
        counts,
        {name: starts[name] for name in known},
        {name: ends[name] for name in known},
    )


def _listed_in(information: dict[str, Any], key: str) -> list[Any]:
    value = information.get(key)
    return value if isinstance(value, list) else []


def _base_name(path: Any) -> str:
    """Return the last part of a path of whichever system."""
    return re.split(r"[\\/]", str(path))[-1]


def _located(folder: Path, name: str) -> Path | None:
    """Return the file called `name`, compressed or decompressed since; None when there is none."""
    if not name:
        return None
    for candidate in (name, f"{name}.zstd", name.removesuffix(".zstd")):
        if (folder / candidate).is_file():
            return folder / candidate
    return None


def _of_storage(present: list[Path], suffix: str) -> list[Path]:
    """Return the files of the storage that metadata.yaml names; all, where it names none or there is none of it."""
    return [path for path in present if path.name.removesuffix(".zstd").endswith(suffix)] or present


def _warn_of_missing(
    folder: Path, missing: list[str], unnamed: list[str], announced: Announced, warnings: Warnings
) -> None:
    text = f"{folder.name}: {len(missing)} of {len(announced.files)} files are missing ({_listed(missing)})"
    if all(name in announced.starts_ns for name in missing):
        lost = sum(announced.file_counts[name] for name in missing)
        first = min(announced.starts_ns[name] for name in missing)
        last = max(announced.ends_ns[name] for name in missing)
        text += f": {lost} of {announced.message_count} messages, between {seconds(first)} and {seconds(last)}"
    if unnamed:
        text += f"; not named there, and not read: {_listed(unnamed)}"
    warnings.add(text)


def _listed(names: list[str]) -> str:
    return ", ".join(names) if len(names) <= 3 else f"{names[0]}, {names[1]}, ..., {names[-1]}"
