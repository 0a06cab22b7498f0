"""A rosbag2 directory: which files belong to it, and which of them are missing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import yaml

from imgu_ros.bags.storage import Warnings, seconds
from imgu_ros.errors import BagError

METADATA = "metadata.yaml"
_SUFFIXES = (".mcap", ".db3", ".zstd")
#: A real one has some kilobytes; YAML of any size could otherwise eat the memory.
_MAX_METADATA_BYTES = 2**24


@dataclass(frozen=True, slots=True)
class Announced:
    """What metadata.yaml says.

    Attributes
    ----------
    files : names, in order
    message_count : messages in all; -1: not said
    file_counts : messages by file name, where said
    starts_ns, ends_ns : times by file name, where said
    """

    files: tuple[str, ...]
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

    Raises
    ------
    BagError
        If the folder holds no bag, or none of the files that its metadata.yaml names.
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
    if missing:
        if len(missing) == len(found):
            raise BagError(f"{folder}: its files are missing ({_listed(missing)}); need those that {METADATA} names")
        _warn_of_missing(folder, missing, announced, warnings)
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
        content = yaml.load(path.read_text(encoding="utf-8"), getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        return _parsed(content["rosbag2_bagfile_information"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        warnings.add(f"{folder.name}: {METADATA} cannot be read ({reason}): the files in the folder are read")
        return None


def _parsed(information: Any) -> Announced:
    names = [PurePosixPath(str(name)).name for name in information["relative_file_paths"]]
    if not names:
        raise ValueError("it names no file")
    counts: dict[str, int] = {}
    starts: dict[str, int] = {}
    ends: dict[str, int] = {}
    for entry in information.get("files") or ():
        name = PurePosixPath(str(entry["path"])).name
        counts[name] = int(entry["message_count"])
        starts[name] = int(entry["starting_time"]["nanoseconds_since_epoch"])
        ends[name] = starts[name] + int(entry["duration"]["nanoseconds"])
    return Announced(tuple(dict.fromkeys(names)), int(information.get("message_count", -1)), counts, starts, ends)


def _located(folder: Path, name: str) -> Path | None:
    """Return the file called `name`, compressed or decompressed since; None when there is none."""
    for candidate in (name, f"{name}.zstd", name.removesuffix(".zstd")):
        if (folder / candidate).is_file():
            return folder / candidate
    return None


def _warn_of_missing(folder: Path, missing: list[str], announced: Announced, warnings: Warnings) -> None:
    text = f"{folder.name}: {len(missing)} of {len(announced.files)} files are missing ({_listed(missing)})"
    if all(name in announced.file_counts for name in missing):
        lost = sum(announced.file_counts[name] for name in missing)
        first = min(announced.starts_ns[name] for name in missing)
        last = max(announced.ends_ns[name] for name in missing)
        text += f": {lost} of {announced.message_count} messages, between {seconds(first)} and {seconds(last)}"
    warnings.add(text)


def _listed(names: list[str]) -> str:
    return ", ".join(names) if len(names) <= 3 else f"{names[0]}, {names[1]}, ..., {names[-1]}"
