# SPDX-License-Identifier: Apache-2.0
"""Open the files of recordings: the format is recognised by the first bytes, not by the name."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

from imgu_ros.bags.byte_file import ByteFile
from imgu_ros.bags.compression import ZSTD_MAGIC, Expansion, TemporarySpace, decompress_file
from imgu_ros.bags.rosbag2_folder import METADATA, recording
from imgu_ros.bags.salvage.chunked_storage import ChunkedStorage
from imgu_ros.bags.salvage.mcap_format import MAGIC as MCAP_MAGIC
from imgu_ros.bags.salvage.mcap_index import MCAP
from imgu_ros.bags.salvage.rosbag1_format import MAGIC as ROSBAG1_MAGIC
from imgu_ros.bags.salvage.rosbag1_index import ROSBAG1
from imgu_ros.bags.sqlite_storage import SqliteStorage
from imgu_ros.bags.storage import Storage, WarningLog
from imgu_ros.config.parameters import LimitsParameters
from imgu_ros.errors import BagError

_SQLITE_MAGIC = b"SQLite format 3\0"
_FORMATS = {MCAP_MAGIC: MCAP, ROSBAG1_MAGIC: ROSBAG1}
NEED = "need a ROS 1 bag, a rosbag2 folder, .mcap or .db3 file, a video, or pictures"


def require_different(paths: Sequence[Path]) -> None:
    """Refuse a bag, or a file of a bag, beside itself: every frame would come twice."""
    known: dict[Path, Path] = {}
    for path in map(Path, paths):
        if path.parts and path.parts[0] == "file:":
            raise BagError(f"{path}: a URL; need a path, {NEED.removeprefix('need ')}")
        try:
            real = path.resolve()
        except (OSError, RuntimeError, ValueError) as error:  # symbolic links in a circle, a zero byte
            raise BagError(f"{path}: {_reason(error)}; {NEED}") from None
        real = real.parent if real.name == METADATA else real
        for earlier, given in known.items():
            if earlier in (real, real.parent) or earlier.parent == real:
                raise BagError(f"{path}: the same bag as {given}; need each bag once")
        known[real] = path


def _reason(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return "symbolic links in a circle" if isinstance(error, RuntimeError) else str(error)


class FileOpener:
    """Opens the files of bags, and closes them with `stack`."""

    def __init__(self, limits: LimitsParameters, warnings: WarningLog, stack: ExitStack) -> None:
        self.limits, self.warnings, self.stack = limits, warnings, stack
        self.space = TemporarySpace(limits)

    def storages(self, path: Path) -> list[Storage]:
        """Open all files of the bag at `path`."""
        try:
            if path.name == METADATA and path.is_file():
                path = path.parent
            is_folder = path.is_dir()
        except (OSError, RuntimeError, ValueError) as error:  # a name that is too long, a folder that is not readable
            raise BagError(f"{path}: {_reason(error)}; {NEED}") from None
        if not is_folder:
            return self.opened(path, path.name)
        storages: list[Storage] = []
        errors: list[BagError] = []
        folder = recording(path, self.warnings, self.limits)
        for split in folder.splits:
            try:
                opened = self.opened(split.path, split.path.name)
            except BagError as error:
                errors.append(error)
                continue
            storages += opened
            count = sum(sum(storage.counts.values()) for storage in opened)
            if count < split.message_count:
                self.warnings.add(
                    f"{split.path.name}: {count} of the {split.message_count} messages that {METADATA} announces"
                )
            elif count > split.message_count >= 0:
                self.warnings.add(f"{split.path.name}: {count} messages, {METADATA} announces {split.message_count}")
        if errors and not storages:
            raise errors[0]
        difference = "" if errors else folder.difference(storages)
        if difference:
            self.warnings.add(f"{path.name}: {difference}")
        for skipped in errors:
            self.warnings.add(f"skipped: {skipped}")
        return storages

    def opened(self, path: Path, name: str) -> list[Storage]:
        """Open one file, whatever its name says, by its first bytes; several that follow one another in it."""
        file = ByteFile(path)
        storages: list[Storage]
        try:
            if not path.is_file():
                raise BagError(f"{path}: not a regular file; {NEED}")
            if file.size == 0:
                raise BagError(f"{path}: empty file; {NEED}")
            magic = file.read(0, min(file.size, 16))
            form = next((form for begin, form in _FORMATS.items() if magic.startswith(begin)), None)
            if form is not None:
                found = form.index(file, self.limits)
                expansion = Expansion(self.limits)
                storages = [
                    ChunkedStorage(file, name, self.warnings, index, form, self.limits, expansion) for index in found
                ]
            elif magic == _SQLITE_MAGIC:
                file.close()
                storages = [SqliteStorage(path, name, self.warnings, self.limits, self.space)]
            elif magic.startswith(ZSTD_MAGIC) and path.suffix == ".zstd":
                file.close()
                return self.decompressed(path, name)
            else:
                raise BagError(f"{path}: not a bag (begins with {magic[:8].hex()}); {NEED}")
        except BaseException:
            file.close()
            raise
        for storage in storages:
            self.stack.callback(storage.close)
        return storages

    def decompressed(self, path: Path, name: str) -> list[Storage]:
        """Open a file that rosbag2 compressed as a whole, from a temporary copy that `stack` removes."""
        try:
            folder = Path(self.stack.enter_context(TemporaryDirectory(prefix="imgu_bag_")))
        except OSError as error:
            raise BagError(f"{path}: no temporary folder to decompress it: {error.strerror}") from None
        plain = folder / (path.stem or "bag")
        damage = decompress_file(path, plain, self.limits, self.space)
        if damage:
            self.warnings.add(f"{name}: {damage}")
        if plain.stat().st_size == 0:
            raise BagError(f"{path}: nothing can be decompressed ({damage or 'it is empty'}); {NEED}")
        return self.opened(plain, name)
