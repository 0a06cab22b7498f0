# SPDX-License-Identifier: Apache-2.0
"""The folder that a replay writes into: refused when it holds something else, cleared of earlier results on request."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from imgu_ros.errors import FileError

RESULTS = "results"
_FILES = ("frames.csv", "ambiguous.csv", "summary.json", "report.html")
_TRAJECTORIES = "poses_*.tum"


def prepare_output_folder(out: Path, *, overwrite: bool, inputs: Sequence[Path] = ()) -> None:
    """Make `out`, empty of a replay's files.

    Parameters
    ----------
    out : made with its parents when it does not exist
    overwrite : remove the files of an earlier replay; nothing else is ever removed
    inputs : what is about to be read, and must not be removed

    Raises
    ------
    FileError
        If `out` is not a folder, cannot be made or written, is not empty and `overwrite` is false, or an input is among
        the files to be removed.
    """
    check_output_folder(out, overwrite=overwrite, inputs=inputs)
    try:
        out.mkdir(parents=True, exist_ok=True)
        _remove_earlier(out)
        probe = out / "frames.csv"
        probe.touch()
    except OSError as error:
        raise FileError(f"{out}: {error.strerror}; need a folder that can be written") from None


def check_output_folder(out: Path, *, overwrite: bool, inputs: Sequence[Path] = ()) -> None:
    """Raise what `prepare_output_folder` would, without touching anything; what only trying shows remains."""
    try:
        if out.exists() and not out.is_dir():
            raise FileError(f"{out}: not a folder; need a folder for the results")
        if out.is_dir() and any(out.iterdir()) and not overwrite:
            raise FileError(f"{out}: folder is not empty; need a new or an empty one, or --overwrite")
        results = (out / RESULTS).resolve()
        for path in inputs:
            if path.resolve().is_relative_to(results) or results.is_relative_to(path.resolve()):
                raise FileError(f"{out}: would replace {path}, which is to be read; need another folder")
        if results.is_dir() and not _is_bag(results):
            raise FileError(f"{results}: holds more than a bag; need another folder")
    except OSError as error:
        raise FileError(f"{out}: {error.strerror}; need a folder that can be written") from None


def _remove_earlier(out: Path) -> None:
    for path in (*(out / name for name in _FILES), *out.glob(_TRAJECTORIES)):
        path.unlink(missing_ok=True)
    if (out / RESULTS).is_dir():
        shutil.rmtree(out / RESULTS)


def _is_bag(folder: Path) -> bool:
    return all(path.name == "metadata.yaml" or path.suffix in (".mcap", ".db3") for path in folder.iterdir())
