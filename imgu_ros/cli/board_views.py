# SPDX-License-Identifier: Apache-2.0
"""Views of a chessboard in image files or in a recording: what `imgu calibrate` works from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from imgu_ros.bags.frame_files import is_picture_name, is_recording, natural_order
from imgu_ros.bags.reading import open_bag
from imgu_ros.bags.recorded_images import recorded_images
from imgu_ros.cli.picture_layout import picture_layout
from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import BagError, FileError, ImguError, ParameterError, TooFewPoints
from imgu_ros.image.frame_image import develop
from imgu_ros.image_files.images import read_image_file
from imgu_ros.types import Image, Points
from imgu_ros.vision.camera.calibration import FEWEST_VIEWS
from imgu_ros.vision.camera.chessboard import FEWEST_CORNERS, Chessboard, find_chessboard
from imgu_ros.vision.camera.view_choice import choose_views
from imgu_ros.vision.formation.layout import RawImage

#: Pictures on which other sizes of the board are tried when none was found.
_KEPT_FOR_HINT = 2
#: Of a bag's pictures in which the quick detector finds nothing, one in so many goes through the slow one.
_THOROUGH_EVERY = 5
_NO_BOARD = "no board found"


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """A picture in which the board was found: its name, its size in px, and the corners, (N, 2) px."""

    name: str
    width: int
    height: int
    corners: Points


@dataclass(frozen=True, slots=True)
class RefusedPicture:
    """A picture that is not used, and why."""

    name: str
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class BoardViews:
    """What was found.

    Attributes
    ----------
    width, height : px, of the pictures in `views`
    views : different views of the board
    refused : the other pictures
    notes : what was done to files, each with the name of the first file
    """

    width: int
    height: int
    views: tuple[BoardView, ...]
    refused: tuple[RefusedPicture, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _Picture:
    name: str
    grey: Image | None
    reason: str = ""
    notes: tuple[str, ...] = ()


def find_board_views(
    paths: Sequence[Path],
    board: Chessboard,
    parameters: Parameters,
    *,
    pattern: str | None = None,
    most: int = 50,
    on_progress: Callable[[int, int | None], None] = lambda done, total: None,
    on_trial: Callable[[int, int | None], None] = lambda done, total: None,
) -> BoardViews:
    """Look for the board in image files, folders of them, or one recording: a bag, or videos.

    Parameters
    ----------
    paths : images and folders, or the parts of one bag
    board : what to look for
    parameters : `image_topic`, `raw.encoding`, and how raw pixels are developed
    pattern : the image files are Bayer mosaics of this pattern; None: they are what `raw.encoding` says, else pictures
    most : views to choose at most
    on_progress : called after each picture with the number of those done and, when it is known, of all
    on_trial : called likewise while boards of other sizes are looked for, when this one is in no picture

    Raises
    ------
    TooFewPoints
        If the board is found in fewer than three different views; says what was found instead.
    FileError, BagError, ParameterError
        If a path does not exist, or a bag cannot be read; `pattern` is for image files alone, `image_topic` for bags.
    """
    bags = [path for path in paths if is_recording(path)]
    if bags and len(bags) < len(paths):
        raise ParameterError(f"{paths[0]}: bags and images mixed; need one recording, or images")
    if bags and pattern:
        raise ParameterError(f"--pattern: {pattern} for a bag; need -p raw.encoding:=bayer_{pattern}8")
    if not bags and parameters.image_topic:
        raise ParameterError(f"image_topic: {parameters.image_topic!r} for image files; need it for a bag only")
    files = () if bags else _image_files(paths)
    pictures = _of_bag(bags, parameters) if bags else _of_files(files, parameters, pattern)
    found: list[BoardView] = []
    refused: list[RefusedPicture] = []
    kept: list[Image] = []
    noted: dict[str, list[str]] = {}
    misses = 0
    for index, picture in enumerate(pictures):
        corners = None
        for note in picture.notes:
            noted.setdefault(note, []).append(picture.name)
        if picture.grey is None:
            refused.append(RefusedPicture(picture.name, picture.reason))
        else:
            # In a video the slow detector is worth its time now and then only: the next frame will do as well.
            corners = find_chessboard(picture.grey, board, thorough=not bags or misses % _THOROUGH_EVERY == 0)
            if corners is None:
                misses += 1
                refused.append(RefusedPicture(picture.name, _NO_BOARD))
                if index & (index - 1) == 0:  # 0, 1, 2, 4, 8, ...: spread over a recording of any length
                    kept = [*kept, picture.grey][-_KEPT_FOR_HINT:]
            else:
                height, width = picture.grey.shape
                found.append(BoardView(picture.name, width, height, corners))
        on_progress(index + 1, len(files) or None)
    if not found and not refused:
        raise BagError(f"{paths[0]}: no picture in it; need views of the board")
    notes = [f"{names[0]}{and_others(len(names) - 1)}: {note}" for note, names in noted.items()]
    return replace(_chosen(found, refused, board, kept, most, on_trial), notes=tuple(notes))


def and_others(count: int) -> str:
    """Return " and 3 others" for 3; nothing for 0."""
    return f" and {count} other{'s' * (count > 1)}" if count else ""


def _chosen(
    found: list[BoardView],
    refused: list[RefusedPicture],
    board: Chessboard,
    kept: list[Image],
    most: int,
    on_trial: Callable[[int, int | None], None],
) -> BoardViews:
    if not found:
        raise TooFewPoints(_nothing_found(refused, board, kept, on_trial))
    (width, height), _ = Counter((view.width, view.height) for view in found).most_common(1)[0]
    fitting = [view for view in found if (view.width, view.height) == (width, height)]
    refused = refused + [
        RefusedPicture(view.name, f"{view.width} x {view.height} px; the others have {width} x {height}")
        for view in found
        if (view.width, view.height) != (width, height)
    ]
    indices = choose_views([view.corners for view in fitting], width, height, most, board_xy=board.corners())
    refused += [
        RefusedPicture(view.name, "like another view" if len(indices) < most else f"beyond {most} views")
        for index, view in enumerate(fitting)
        if index not in indices
    ]
    if len(indices) < FEWEST_VIEWS:
        reasons = Counter(picture.reason for picture in refused)
        others = "".join(f"; {count} x {reason}" for reason, count in reasons.most_common(3))
        shown = f"{len(found)} picture{'s show' if len(found) > 1 else ' shows'} {len(indices)} different view"
        raise TooFewPoints(
            f"views: {shown}{'s' * (len(indices) > 1)} of the {board.columns}x{board.rows} board; need at least "
            f"{FEWEST_VIEWS}, tilted in different directions{others}"
        )
    return BoardViews(width, height, tuple(fitting[i] for i in indices), tuple(refused))


def _nothing_found(
    refused: list[RefusedPicture],
    board: Chessboard,
    kept: list[Image],
    on_trial: Callable[[int, int | None], None],
) -> str:
    unread = [picture for picture in refused if picture.reason != _NO_BOARD]
    if len(unread) == len(refused):
        return f"board: none of {len(refused)} pictures can be read; the first: {unread[0].name}: {unread[0].reason}"
    start = f"board: no {board.columns}x{board.rows} board found in {len(refused)} pictures"
    other = _other_size(kept, board, on_trial)
    if other is not None:
        return f"{start}, but a {other.columns}x{other.rows} one; need --board with the number of inner corners"
    return f"{start}; need pictures of the whole board, sharp, with a white margin; --board counts inner corners"


def _other_size(kept: list[Image], board: Chessboard, on_trial: Callable[[int, int | None], None]) -> Chessboard | None:
    """Look for a board of nearly the size that was asked for, the largest first (smaller ones are a part of it)."""
    sizes = [
        (board.columns + more, board.rows + more_rows)
        for more in (1, 0, -1, -2)
        for more_rows in (1, 0, -1, -2)
        if (more, more_rows) != (0, 0) and min(board.columns + more, board.rows + more_rows) >= FEWEST_CORNERS
    ]
    largest_first = sorted(sizes, key=lambda size: -size[0] * size[1])
    trials = [(grey, size) for grey in kept for size in largest_first]
    for index, (grey, (columns, rows)) in enumerate(trials):
        on_trial(index, len(trials))
        other = Chessboard(columns, rows, board.square_m)
        if find_chessboard(grey, other, quick=False) is not None:
            return other
    return None


def _of_files(files: Sequence[Path], parameters: Parameters, pattern: str | None) -> Iterator[_Picture]:
    for path in files:
        try:
            file = read_image_file(path, limits=parameters.limits)
            layout = picture_layout(path, file.pixels, pattern, parameters.raw.encoding)
            yield replace(_developed(str(path), RawImage(file.pixels, layout), parameters), notes=file.notes)
        except FileError as error:
            yield _Picture(str(path), None, str(error).removeprefix(f"{path}: "))


def _of_bag(bags: Sequence[Path], parameters: Parameters) -> Iterator[_Picture]:
    with open_bag(bags, limits=parameters.limits) as bag:
        for picture in recorded_images(bag, parameters.image_topic, parameters.raw.encoding, limits=parameters.limits):
            name = f"{picture.stamp_ns / 1e9:.3f} s"
            if picture.image is None:
                yield _Picture(name, None, picture.reason, picture.remarks)
            else:
                yield replace(_developed(name, picture.image, parameters), notes=picture.remarks)


def _developed(name: str, image: RawImage, parameters: Parameters) -> _Picture:
    try:
        return _Picture(name, develop(image, parameters.raw, parameters.demosaic).grey)
    except ImguError as error:
        return _Picture(name, None, str(error))


def _image_files(paths: Sequence[Path]) -> tuple[Path, ...]:
    files: list[Path] = []
    for path in paths:
        if not path.exists():
            raise FileError(f"{path}: No such file or directory; need a bag, a video, images or folders of images")
        if not path.is_dir():
            files.append(path)
            continue
        inside = sorted(filter(is_picture_name, path.iterdir()), key=natural_order)
        if not inside:
            raise FileError(f"{path}: no image in it; need PNG, JPEG, TIFF or PNM files, a video, or a bag")
        files += inside
    return tuple(files)
