# SPDX-License-Identifier: Apache-2.0
"""The output folder of a run: locked, cleared of an earlier run's files on request, with a list of its files."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from imgu_ros.errors import FileError
from imgu_ros.file_access.atomic_files import file_errors, part_path, sync_file
from imgu_ros.replay.earlier_run import MANIFEST, EarlierFiles, EarlierRun, read_manifest, write_manifest
from imgu_ros.replay.folder_lock import LOCK, FolderLock, last_work_ns, locked_folder

#: Interval at which a run that writes marks the time.
_MARK_INTERVAL_S = 0.5


@dataclass(frozen=True, slots=True)
class OutputFiles:
    """The files that a run writes into its folder.

    Attributes
    ----------
    kind : of the run; one kind never replaces another's files
    files : relative names, parts joined by /
    mark : the one that is written last and says that all are complete
    """

    kind: str
    files: tuple[str, ...]
    mark: str


@dataclass(slots=True, eq=False)
class RunFolder:
    """The folder of a run at work. Can be handed to another process that has inherited `lock`.

    Attributes
    ----------
    path : of the folder
    device, inode : what the folder is, whatever its name
    lock : descriptor of the lock's file
    """

    path: Path
    device: int
    inode: int
    lock: int
    _next_s: float = 0.0

    @contextlib.contextmanager
    def writing(self) -> Iterator[None]:
        """Mark a write: `renew` before it when the last mark is old, and after it when it took long.

        Without the second mark, a run that is killed behind a slow write would leave files that look changed by others.
        """
        if time.monotonic() >= self._next_s:
            self.renew()
        yield
        if time.monotonic() >= self._next_s:
            self.renew()

    def renew(self) -> None:
        """Mark the time for later runs: files that are changed later were changed by others.

        Raises
        ------
        FileError
            If the folder was removed, renamed or replaced: nothing is written into another one.
        """
        self._next_s = time.monotonic() + _MARK_INTERVAL_S
        try:
            status = os.stat(self.path)
        except OSError as error:
            raise FileError(f"{self.path}: {error.strerror}; need a folder that stays while it is written to") from None
        if (status.st_dev, status.st_ino) != (self.device, self.inode):
            raise FileError(f"{self.path}: replaced meanwhile; need a folder that stays while it is written to")
        self.mark_time()

    def mark_time(self) -> None:
        """Mark that the run has written until now, whether or not the folder is still there."""
        os.utime(self.lock)

    def make(self, name: str) -> Path:
        """Make a folder in this one, and never this one again, should it be gone; return its path.

        Raises
        ------
        FileError
            If it cannot be made.
        """
        self.renew()
        path = self.path / name
        with file_errors(path):
            path.mkdir()
        return path

    def publish(self, *moves: tuple[str, str]) -> None:
        """Give complete files, or folders of them, their names, in order.

        Parameters
        ----------
        *moves : relative names: where it is, where it belongs

        Raises
        ------
        FileError
            If the folder was replaced, or something is in the way.
        """
        self.renew()
        for source, target in moves:
            try:
                sync_tree(self.path / source)
                os.rename(self.path / source, self.path / target)
            except OSError as error:
                raise FileError(f"{self.path / target}: {error.strerror}; need a folder that can be written") from None
        for folder in sorted({parent for source, _ in moves for parent in Path(source).parents}, reverse=True)[:-1]:
            with contextlib.suppress(OSError):  # others put something there
                os.rmdir(self.path / folder)

    def sync(self, names: Sequence[str]) -> None:
        """Wait until files are on the disk; those that there are."""
        for name in names:
            with contextlib.suppress(FileNotFoundError):
                sync_file(self.path / name)
        self.renew()


@contextlib.contextmanager
def output_folder(
    out: Path,
    contents: OutputFiles,
    *,
    overwrite: bool,
    inputs: Sequence[Path] = (),
    on_warning: Callable[[str], None] = lambda text: None,
) -> Iterator[RunFolder]:
    """Make the folder `out`, lock it, remove an earlier run's files, and list those that are about to be written.

    Parameters
    ----------
    out : made with its parents when it does not exist
    contents : what is written
    overwrite : replace the files of an earlier run of the same kind; nothing else is ever removed
    inputs : what is about to be read, and must not be removed
    on_warning : called when the file system has no locks

    Raises
    ------
    FileError
        If `out` is not a folder or cannot be written, is in use, is not empty and `overwrite` is false, or anything in
        the way is not an earlier run's, unchanged.
    """
    with _folder_errors(out):
        check_output_folder(out, contents, overwrite=overwrite, inputs=inputs)
        out.mkdir(parents=True, exist_ok=True)
    with _folder_errors(out), contextlib.ExitStack() as stack:
        lock = stack.enter_context(locked_folder(out))
        if not lock.is_sure:
            on_warning(f"{out}: this file system has no locks; see to it that no second run writes there")
        _make_room(out, contents, overwrite, lock)
        status = os.stat(out)
        folder = RunFolder(out, status.st_dev, status.st_ino, lock.descriptor)
        write_manifest(out, contents.kind, _all_names(contents))
        folder.renew()
        held = stack.pop_all()
    with held:
        try:
            yield folder
        finally:
            folder.mark_time()


def check_output_folder(out: Path, contents: OutputFiles, *, overwrite: bool, inputs: Sequence[Path] = ()) -> None:
    """Raise what `output_folder` would, without touching anything; what only trying shows remains."""
    with _folder_errors(out):
        if not out.exists():
            return
        if not out.is_dir():
            raise FileError(f"{out}: not a folder; need a folder for the results")
        earlier = _checked(out, contents, overwrite, last_work_ns(out))
        _refuse_inputs(out, contents, earlier, inputs)
        if overwrite:
            with EarlierFiles(out, _all_names(contents), earlier):
                pass


def sync_tree(path: Path) -> None:
    """Wait until a file, or all files of a folder, are on the disk."""
    for inner in path.iterdir() if path.is_dir() else ():
        sync_file(inner)
    sync_file(path)


def _make_room(out: Path, contents: OutputFiles, overwrite: bool, lock: FolderLock) -> None:
    earlier = _checked(out, contents, overwrite, lock.worked_until_ns)
    with EarlierFiles(out, _all_names(contents), earlier) as files:
        files.remove(first=contents.mark)


def _checked(out: Path, contents: OutputFiles, overwrite: bool, until_ns: int | None) -> EarlierRun | None:
    """Return the run before; refuse a folder that is not empty, and one of another kind of run."""
    if not overwrite and set(os.listdir(out)) - {LOCK}:
        raise FileError(f"{out}: folder is not empty; need a new or an empty one, or --overwrite")
    manifest = read_manifest(out)
    if manifest is None:
        return None
    if manifest.kind != contents.kind:
        raise FileError(f"{out}: holds the files of a {manifest.kind}; need another folder for a {contents.kind}")
    return EarlierRun(manifest, until_ns)


def _refuse_inputs(out: Path, contents: OutputFiles, earlier: EarlierRun | None, inputs: Sequence[Path]) -> None:
    names = _all_names(contents) | (frozenset() if earlier is None else earlier.manifest.files)
    places = {_real(out / name.partition("/")[0]) for name in names}
    for path in inputs:
        read = _real(path)
        if any(read.is_relative_to(place) or place.is_relative_to(read) for place in places):
            raise FileError(f"{out}: would replace {path}, which is to be read; need another folder")


def _real(path: Path) -> Path:
    return Path(os.path.realpath(path))  # unlike `resolve` it raises nothing, whatever links lead to


def _all_names(contents: OutputFiles) -> frozenset[str]:
    """Return the names of all files, also those that are there only while they are written."""
    beside = [part_path(Path(name)).name for name in (*contents.files, MANIFEST) if "/" not in name]
    return frozenset((*contents.files, *beside))


@contextlib.contextmanager
def _folder_errors(out: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        where = out / os.fsdecode(error.filename) if isinstance(error.filename, str | bytes) else out
        raise FileError(f"{where}: {error.strerror}; need a folder that can be written") from None
