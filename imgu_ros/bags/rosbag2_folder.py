# SPDX-License-Identifier: Apache-2.0
"""A rosbag2 directory: the files that belong to it, and those that are missing.

metadata.yaml is not read by rosbags, which needs more than 40 s for a large one and raises RecursionError for nested
lists (`benchmarks/figures/bag_readers.json`).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from imgu_ros.bags.storage import MAX_TIME_NS, Storage, WarningLog, seconds
from imgu_ros.bags.text import text_of
from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import BagError, FileError
from imgu_ros.file_access.bounded_reading import file_bytes
from imgu_ros.files.yaml_tree import yaml_tree
from imgu_ros.shown_text import NAME_CHARACTERS, shown

METADATA = "metadata.yaml"
_SUFFIXES = (".mcap", ".db3", ".zstd")
_STORAGES = {"mcap": ".mcap", "sqlite3": ".db3"}
_INTEGER = re.compile(r"-?[0-9]{1,19}")


@dataclass(frozen=True, slots=True)
class FolderMetadata:
    """What metadata.yaml says.

    Attributes
    ----------
    files : names, in order, without folders
    suffix : of files of the storage that it names, such as ".mcap"; empty: not said
    message_count : messages in all; -1: not said
    file_counts : messages by file name, where said
    starts_ns, ends_ns : times by file name, where said
    topic_counts : messages by topic, where said
    """

    files: tuple[str, ...]
    suffix: str
    message_count: int
    file_counts: dict[str, int]
    starts_ns: dict[str, int]
    ends_ns: dict[str, int]
    topic_counts: dict[str, int]


@dataclass(frozen=True, slots=True)
class SplitFile:
    """A file of the bag that is there, and the number of messages that metadata.yaml announces for it (-1: none)."""

    path: Path
    message_count: int


@dataclass(frozen=True, slots=True, eq=False)
class RecordingFolder:
    """A rosbag2 directory.

    Attributes
    ----------
    splits : its files that are there
    topic_counts : messages by topic that metadata.yaml announces; empty where it does not, or a file is missing
    """

    splits: tuple[SplitFile, ...]
    topic_counts: dict[str, int] = field(default_factory=dict)

    def difference(self, storages: Iterable[Storage]) -> str:
        """Return which topics have another number of messages than metadata.yaml announces; empty when none has."""
        there: dict[str, int] = {}
        for storage in storages:
            for channel, count in storage.counts.items():
                there[channel.topic] = there.get(channel.topic, 0) + count
        if not self.topic_counts:
            return ""
        names = sorted(there.keys() | self.topic_counts.keys())
        pairs = [(name, there.get(name, 0), self.topic_counts.get(name, 0)) for name in names]
        others = [
            f"{shown(name, NAME_CHARACTERS)} {count} (announced: {said})"
            for name, count, said in pairs
            if count != said
        ]
        more = f" and {len(others) - 5} other topics" if len(others) > 5 else ""
        return f"{METADATA} announces other numbers of messages: {', '.join(others[:5])}{more}" if others else ""


def recording(folder: Path, warnings: WarningLog, limits: LimitsParameters = DEFAULT_LIMITS) -> RecordingFolder:
    """Return what of a bag is there; what is missing becomes a warning.

    Files are looked for by name in the folder, whatever path metadata.yaml gives. Where none of those that it names is
    there, the files that are there are the bag: they were renamed, or their names are of another system.

    Raises
    ------
    BagError
        If the folder holds no bag.
    """
    try:
        entries = {path.name: path for path in folder.iterdir()}
    except OSError as error:
        raise BagError(f"{folder}: {error.strerror}; need a readable folder") from None
    present = [entries[name] for name in sorted(entries) if name.endswith(_SUFFIXES) and entries[name].is_file()]
    announced = _announced(folder, warnings, limits)
    if announced is None:
        if not present:
            raise BagError(
                f"{folder}: no bag, video or picture in this folder; need .mcap or .db3 files, and their {METADATA} "
                "(name a .bag itself)"
            )
        return RecordingFolder(tuple(SplitFile(path, -1) for path in present))
    found = {name: _located(entries, name) for name in announced.files}
    missing = [name for name, path in found.items() if path is None]
    if missing and len(missing) == len(found):
        renamed = _of_storage(present, announced.suffix)
        if not renamed:
            raise BagError(f"{folder}: its files are missing ({_listed(missing)}); need those that {METADATA} names")
        there = _listed([path.name for path in renamed])
        warnings.add(f"{folder.name}: {METADATA} names {_listed(missing)}, which is not there; read instead: {there}")
        _warn_of_unnamed(folder, present, renamed, warnings)
        only = announced.message_count if len(found) == len(renamed) == 1 else -1
        return RecordingFolder(tuple(SplitFile(path, only) for path in renamed))
    if missing:
        _warn_of_missing(folder, missing, announced, warnings)
    _warn_of_unnamed(folder, present, [path for path in found.values() if path], warnings)
    only = announced.message_count if len(found) == 1 else -1
    splits: dict[Path, SplitFile] = {}  # one for each file: of two names of one file, its messages would come twice
    for name, path in found.items():
        if path is not None:
            splits.setdefault(path, SplitFile(path, announced.file_counts.get(name, only)))
    return RecordingFolder(tuple(splits.values()), {} if missing else announced.topic_counts)


def _announced(folder: Path, warnings: WarningLog, limits: LimitsParameters) -> FolderMetadata | None:
    """Return what metadata.yaml says; None, with a warning, when it is missing or makes no sense."""
    path = folder / METADATA
    if not path.exists():
        warnings.add(f"{folder.name}: no {METADATA}: the files in the folder are read")
        return None
    try:
        if not path.is_file():
            raise ValueError("no regular file")
        need = f"{METADATA} of at most {limits.text_mb} MB (limits.text_mb)"
        content = yaml_tree(text_of(file_bytes(path, need, 1_000_000 * limits.text_mb)), limits)
        wrong: list[str] = []
        metadata = _parsed(content["rosbag2_bagfile_information"], wrong)
        if wrong:
            others = f" (and {len(wrong) - 1} others)" if len(wrong) > 1 else ""
            warnings.add(f"{folder.name}: {METADATA}: {wrong[0]}{others}: ignored; need a number of at most 19 digits")
        return metadata
    except (FileError, ValueError, KeyError, TypeError, AttributeError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        warnings.add(f"{folder.name}: {METADATA} cannot be read ({reason}): the files in the folder are read")
        return None


def _parsed(information: dict[str, Any], wrong: list[str]) -> FolderMetadata:
    """Take what is needed, and nothing that is not: topics, QoS profiles, custom data and versions may be anything.

    Descriptions of numbers that are none are added to `wrong`; missing ones are not.
    """
    counts: dict[str, int] = {}
    starts: dict[str, int] = {}
    ends: dict[str, int] = {}
    described: list[str] = []
    for entry in _listed_in(information, "files"):
        try:
            name = _base_name(entry["path"])
            described.append(name)
            counts[name] = _number(entry["message_count"])
            starts[name] = _number(entry["starting_time"]["nanoseconds_since_epoch"])
            ends[name] = starts[name] + _number(entry["duration"]["nanoseconds"])
        except ValueError as error:
            wrong.append(str(error))
        except (KeyError, TypeError):
            continue  # it says less of this file
    names = [
        _base_name(name) for name in _listed_in(information, "relative_file_paths") if isinstance(name, str)
    ] or described
    if not names:
        raise ValueError("it names no file")
    total = -1
    try:
        total = _number(information.get("message_count"))
    except ValueError as error:
        wrong.append(str(error))
    except TypeError:
        pass
    suffix = _STORAGES.get(str(information.get("storage_identifier", "")), "")
    known = counts.keys() & starts.keys() & ends.keys()
    of_topics: dict[str, int] = {}
    try:
        for entry in _listed_in(information, "topics_with_message_count"):
            topic = str(entry["topic_metadata"]["name"])
            of_topics[topic] = of_topics.get(topic, 0) + _number(entry["message_count"])
    except ValueError as error:
        wrong.append(str(error))
        of_topics = {}
    except (KeyError, TypeError):
        of_topics = {}
    return FolderMetadata(
        tuple(dict.fromkeys(names)),
        suffix,
        total,
        counts,
        {name: starts[name] for name in known},
        {name: ends[name] for name in known},
        of_topics,
    )


def _listed_in(information: dict[str, Any], key: str) -> list[Any]:
    value = information.get(key)
    return value if isinstance(value, list) else []


def _number(value: Any) -> int:
    """Return a count or a time in nanoseconds; ValueError for a text that is neither, TypeError for no text."""
    if not isinstance(value, str):
        raise TypeError
    if not _INTEGER.fullmatch(value.strip()) or not 0 <= int(value) <= MAX_TIME_NS:
        shortened = f"{value[:20]}... ({len(value)} characters)" if len(value) > 40 else value
        raise ValueError(f"{shortened!r} is neither a count nor a time")
    return int(value)


def _base_name(path: Any) -> str:
    """Return the last part of a path of whichever system; TypeError for what is no text."""
    return re.split(r"[\\/]", path)[-1]


def _located(entries: Mapping[str, Path], name: str) -> Path | None:
    """Return the file called `name`, compressed or decompressed since; None when there is none."""
    candidates = (name, f"{name}.zstd", name.removesuffix(".zstd"))
    return next((entries[one] for one in candidates if one in entries and entries[one].is_file()), None)


def _of_storage(present: list[Path], suffix: str) -> list[Path]:
    """Return the files of the storage that metadata.yaml names; all, where it names none or there is none of it."""
    return [path for path in present if path.name.removesuffix(".zstd").endswith(suffix)] or present


def _warn_of_unnamed(folder: Path, present: list[Path], read: list[Path], warnings: WarningLog) -> None:
    unnamed = [path.name for path in present if path not in read]
    if unnamed:
        warnings.add(f"{folder.name}: not named in {METADATA}, and not read: {_listed(unnamed)}")


def _warn_of_missing(folder: Path, missing: list[str], announced: FolderMetadata, warnings: WarningLog) -> None:
    text = f"{folder.name}: {len(missing)} of {len(announced.files)} files are missing ({_listed(missing)})"
    if all(name in announced.starts_ns for name in missing):
        lost = sum(announced.file_counts[name] for name in missing)
        first = min(announced.starts_ns[name] for name in missing)
        last = max(announced.ends_ns[name] for name in missing)
        text += f": {lost} of {announced.message_count} messages, between {seconds(first)} and {seconds(last)}"
    warnings.add(text)


def _listed(names: list[str]) -> str:
    few = [shown(name, NAME_CHARACTERS) for name in (names if len(names) <= 3 else [*names[:2], names[-1]])]
    return ", ".join(few if len(names) <= 3 else [*few[:2], "...", few[2]])
