# SPDX-License-Identifier: Apache-2.0
"""From a folder of results to a file that a viewer opens."""

from __future__ import annotations

import glob
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from pathlib import Path

from imgu_ros.errors import FileError
from imgu_ros.view.foxglove_recording import write_foxglove
from imgu_ros.view.recorded_frames import ScreenFrame, screen_frames
from imgu_ros.view.results_folder import ReplayResults, open_results, seen_frames

#: Names of the files in the folder of the results.
RERUN_FILE, FOXGLOVE_FILE = "view.rrd", "view.mcap"


def view_with_rerun(
    folder: Path,
    out: Path | None = None,
    recording: Sequence[Path] = (),
    *,
    on_progress: Callable[[int, int | None], None] = lambda done, total: None,
    on_warning: Callable[[str], None] = lambda text: None,
) -> Path:
    """Write a replay's results as a Rerun recording; return its path.

    Parameters
    ----------
    folder : of the results
    out : the file; None: `view.rrd` in the folder
    recording : where the recording is that was replayed; empty: where it was then, and no pictures if it is gone
    on_progress : called after each frame with the number of frames done and of all
    on_warning : called once for each warning

    Raises
    ------
    FileError, BagError, ParameterError
        If the results or the recording cannot be read, or the file cannot be written.
    """
    from imgu_ros.view.rerun_recording import write_rerun

    results = open_results(folder)
    path = out or folder / RERUN_FILE
    pictures = _frames(_recording(recording, results, on_warning), results)
    with closing(seen_frames(results)) as frames, closing(pictures):
        write_rerun(path, results, frames, pictures, on_progress)
    return path


def view_with_foxglove(
    folder: Path,
    out: Path | None = None,
    recording: Sequence[Path] = (),
    *,
    on_progress: Callable[[int, int | None], None] = lambda done, total: None,
    on_warning: Callable[[str], None] = lambda text: None,
) -> Path:
    """Write a replay's results and what was replayed as one MCAP file; return its path.

    Parameters, errors: as `view_with_rerun`; the file is `view.mcap`.
    """
    results = open_results(folder)
    path = out or folder / FOXGLOVE_FILE
    given = _recording(recording, results, on_warning)
    with closing(_frames(given, results)) as frames:
        write_foxglove(path, results, given, frames, on_progress)
    return path


def _recording(given: Sequence[Path], results: ReplayResults, on_warning: Callable[[str], None]) -> tuple[Path, ...]:
    """Return what was replayed; nothing when it is gone."""
    recording = tuple(given) or results.recording
    missing = next((path for path in recording if not _is_there(path)), None)
    if missing is not None and given:
        raise FileError(f"{missing}: does not exist; need the recording that was replayed")
    if missing is not None:
        on_warning(f"{missing}: not there any more, so there are no pictures; --recording PATH says where it is")
        return ()
    return recording


def _frames(recording: tuple[Path, ...], results: ReplayResults) -> Generator[ScreenFrame]:
    if recording:
        yield from screen_frames(recording, results)


def _is_there(path: Path) -> bool:
    """Whether there is a file or folder, or one that fits a pattern."""
    return path.exists() or next(glob.iglob(str(path), recursive=True), None) is not None
