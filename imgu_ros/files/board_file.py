# SPDX-License-Identifier: Apache-2.0
"""Board files: YAML that says which markers are where on one thing."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import FileError, ShapeError, nearest_name
from imgu_ros.file_access.bounded_reading import file_bytes
from imgu_ros.files.yaml_tree import yaml_tree
from imgu_ros.reference.bundle import BundleMarker
from imgu_ros.reference.dot_layout import DotLayout, DotTemplate
from imgu_ros.reference.marker_layout import (
    LayoutTemplate,
    MarkerLayout,
    PlacedMarker,
    PlacedSquares,
    charuco_layout,
    grid_layout,
)
from imgu_ros.shown_text import quoted
from imgu_ros.vision.camera.euler import from_euler
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.rigid import RigidTransform, rigid_transform
from imgu_ros.vision.markers import marker_cells, marker_distance

#: What is on one plane, or markers on several.
Board = MarkerLayout | DotLayout | tuple[BundleMarker, ...]
#: Suffixes of board files among the entries of `targets.images`.
BOARD_SUFFIXES = (".yaml", ".yml")
_NEED = "need a board file: one of markers, grid, charuco, chessboard, dots"
#: Kinds of boards, and what each has beside what is optional.
_GRID = {"family": None, "rows": None, "columns": None, "size": None, "gap": None, "first_id": 0}
_CHARUCO = {
    "family": None, "rows": None, "columns": None, "square": None, "size": None, "first_id": 0, "legacy": False,
}  # fmt: skip
_CHESSBOARD = {"rows": None, "columns": None, "square": None}
_DOTS = {"rows": None, "columns": None, "spacing": None, "diameter": None, "shifted": False}
_MARKER = {"family": None, "id": None, "size": None, "x": 0.0, "y": 0.0, "turn_deg": 0}
_QUATERNION, _ANGLES = "quaternion", ("roll_deg", "pitch_deg", "yaw_deg")
#: What a marker has that is not on the plane of the others.
_OFF_PLANE = ("z", _QUATERNION, *_ANGLES, "covariance")
_PLACED = {
    "family": None, "id": None, "size": None, "x": 0.0, "y": 0.0, "z": 0.0, _QUATERNION: (0, 0, 0, 1),
    **dict.fromkeys(_ANGLES, 0.0), "covariance": (0,) * 36,
}  # fmt: skip
#: More than any board has: preparing one takes a second.
_MOST_MARKERS = 1000
#: Lengths beyond are a mistaken unit, m.
_SHORTEST_M, _LONGEST_M = 1e-4, 1e4
#: Smaller cells of a template lose their edges, px.
_LEAST_CELL_PX = 2.0
#: Normals whose cosine is larger face the same side.
_ALIKE = 0.5
#: Edges that overlap by less are rounding, as a share of a marker.
_ROUNDING = 1e-6


def read_board(path: Path, limits: LimitsParameters = DEFAULT_LIMITS) -> Board:
    """Return what a board file says: the layout of a board, or the markers of a bundle.

    Parameters
    ----------
    path : of the file
    limits : `text_mb`

    Raises
    ------
    FileError
        If it cannot be read, is no board file, or the board that it describes cannot be.
    """
    need = f"a board file of at most {limits.text_mb} MB (limits.text_mb)"
    try:
        content = yaml_tree(file_bytes(path, need, 1_000_000 * limits.text_mb).decode(), limits)
    except UnicodeDecodeError:
        raise FileError(f"{path}: no text; {_NEED}") from None
    except (yaml.YAMLError, ValueError) as error:
        raise FileError(f"{path}: no YAML ({' '.join(str(error).split())[:200]}); {_NEED}") from None
    return board_of(content, str(path))


def board_of(content: Any, source: str) -> Board:
    """Return the board that the content of a file describes, texts in dictionaries and lists.

    Parameters
    ----------
    content : as `yaml_tree` returns it
    source : the file, for messages

    Raises
    ------
    FileError
        As `read_board`.
    """
    kinds = [kind for kind in _KINDS if isinstance(content, dict) and kind in content]
    if len(kinds) != 1:
        got = " and ".join(kinds) if kinds else "none of these keys"
        raise FileError(f"{source}: {got}; {_NEED}")
    (kind,) = kinds
    try:
        _require_known(content, (kind, *(("family", "size") if kind == "markers" else ())), "")
        board = _KINDS[kind](content)
        _require_possible(board)
    except (FileError, ShapeError) as error:
        raise FileError(f"{source}: {error}") from None
    return board


class _CheckedKeys:
    """A dictionary whose keys are known, and its values by their types.

    Parameters
    ----------
    content : texts by key
    known : keys and what holds where one is left out; None: it is needed
    name : of the entry, for messages
    """

    def __init__(self, content: Any, known: Mapping[str, Any], name: str) -> None:
        self._name = name
        if not isinstance(content, dict):
            raise FileError(f"{name}: {quoted(str(content)[:80])}; need {', '.join(known)}")
        _require_known(content, known, name)
        missing = [key for key, value in known.items() if value is None and content.get(key) is None]
        if missing:
            raise FileError(f"{name}: no {missing[0]}; need {', '.join(key for key in known if known[key] is None)}")
        self._content = {**known, **content}

    def text(self, key: str) -> str:
        return str(self._content[key])

    def number(self, key: str) -> float:
        text = self._content[key]
        try:
            value = float(text)
        except (TypeError, ValueError, OverflowError):
            value = math.nan
        if not abs(value) <= _LONGEST_M:
            raise FileError(f"{self._name}.{key}: {quoted(str(text)[:80])}; need a number, up to {_LONGEST_M:g}")
        return value

    def numbers(self, *keys: str) -> list[float]:
        return [self.number(key) for key in keys]

    def list(self, key: str, count: int) -> list[float]:
        values = self._content[key]
        if not isinstance(values, list | tuple) or len(values) != count:
            raise FileError(f"{self._name}.{key}: {quoted(str(values)[:80])}; need a list of {count} numbers")
        return [_CheckedKeys({key: value}, {key: None}, self._name).number(key) for value in values]

    def length(self, key: str) -> float:
        value = self.number(key)
        if not value >= _SHORTEST_M:
            raise FileError(f"{self._name}.{key}: {value:g} m; need at least {_SHORTEST_M:g} m")
        return value

    def whole(self, key: str, least: int) -> int:
        value = self.number(key)
        if value != int(value) or value < least:
            raise FileError(f"{self._name}.{key}: {self.text(key)[:80]}; need a whole number from {least} on")
        return int(value)

    def is_true(self, key: str) -> bool:
        text = self.text(key).lower()
        if text not in ("true", "false"):
            raise FileError(f"{self._name}.{key}: {quoted(self.text(key)[:80])}; need true or false")
        return text == "true"


def _require_known(content: Mapping[str, Any], known: Sequence[str] | Mapping[str, Any], name: str) -> None:
    for key in content:
        if key not in known:
            near = nearest_name(key, known)
            hint = f"did you mean {near}?" if near else f"need {', '.join(known)}"
            raise FileError(f"{name + ': ' if name else ''}{quoted(str(key)[:80])}: no key of a board; {hint}")


def _of_markers(content: Mapping[str, Any]) -> Board:
    entries = content["markers"]
    if not isinstance(entries, list) or not entries:
        raise FileError("markers: need a list of at least one")
    _require_count(len(entries))
    common = {key: content[key] for key in ("family", "size") if key in content}
    named = [(entry, common, f"markers[{index}]") for index, entry in enumerate(entries)]
    if any(key in entry for entry in entries if isinstance(entry, dict) for key in _OFF_PLANE):
        return tuple(_placed(*each) for each in named)
    return MarkerLayout(tuple(_marker(*each) for each in named))


def _placed(entry: Any, common: Mapping[str, Any], name: str) -> BundleMarker:
    own = _CheckedKeys({**common, **entry} if isinstance(entry, dict) else entry, _PLACED, name)
    if _QUATERNION in entry and any(key in entry for key in _ANGLES):
        raise FileError(f"{name}: {_QUATERNION} and angles; need one of them")
    if _QUATERNION in entry:
        place = rigid_transform([*own.numbers("x", "y", "z"), *own.list(_QUATERNION, 4)], f"{name}.{_QUATERNION}")
    else:
        angles = np.radians(own.numbers(*_ANGLES))
        place = RigidTransform(from_euler(angles, "zyx"), np.array(own.numbers("x", "y", "z")))
    covariance = np.reshape(own.list("covariance", 36), (6, 6))
    scale = float(np.abs(covariance).max())
    if not np.allclose(covariance, covariance.T, rtol=0, atol=_ROUNDING * scale) or (
        np.linalg.eigvalsh((covariance + covariance.T) / 2).min() < -_ROUNDING * scale
    ):
        raise FileError(f"{name}.covariance: need 36 numbers of a symmetric matrix without negative eigenvalues")
    marker = PlacedMarker(own.text("family"), own.whole("id", 0), own.length("size"))
    return BundleMarker(marker, Pose(place.R, place.t, (covariance + covariance.T) / 2, 0.0))


def _marker(entry: Any, common: Mapping[str, Any], name: str) -> PlacedMarker:
    own = _CheckedKeys({**common, **entry} if isinstance(entry, dict) else entry, _MARKER, name)
    turn = own.number("turn_deg")
    if turn % 90:
        raise FileError(f"{name}.turn_deg: {turn:g}; need a multiple of 90")
    number = own.whole("id", 0)
    return PlacedMarker(
        own.text("family"), number, own.length("size"), own.number("x"), own.number("y"), int(turn // 90) % 4
    )


def _of_grid(content: Mapping[str, Any]) -> MarkerLayout:
    own = _CheckedKeys(content["grid"], _GRID, "grid")
    rows, columns = own.whole("rows", 1), own.whole("columns", 1)
    _require_count(rows * columns)
    first = own.whole("first_id", 0)
    numbers = range(first, first + rows * columns)
    return grid_layout(own.text("family"), rows, columns, own.length("size"), own.length("gap"), numbers)


def _of_charuco(content: Mapping[str, Any]) -> MarkerLayout:
    own = _CheckedKeys(content["charuco"], _CHARUCO, "charuco")
    rows, columns = own.whole("rows", 2), own.whole("columns", 2)
    _require_count(rows * columns // 2)
    square, size, is_legacy = own.length("square"), own.length("size"), own.is_true("legacy")
    if not size < square:
        raise FileError(f"charuco.size: {size:g} m; need less than the square's side of {square:g} m")
    first, is_white_first = own.whole("first_id", 0), is_legacy and rows % 2 == 0
    count = (rows * columns + is_white_first) // 2
    return charuco_layout(own.text("family"), columns, rows, square, size, range(first, first + count), is_legacy)


def _of_chessboard(content: Mapping[str, Any]) -> MarkerLayout:
    own = _CheckedKeys(content["chessboard"], _CHESSBOARD, "chessboard")
    rows, columns = own.whole("rows", 4), own.whole("columns", 4)
    _require_count(rows * columns, "squares")
    return MarkerLayout((), PlacedSquares(columns, rows, own.length("square"), first_is_black=True))


def _of_dots(content: Mapping[str, Any]) -> DotLayout:
    own = _CheckedKeys(content["dots"], _DOTS, "dots")
    rows, columns = own.whole("rows", 3), own.whole("columns", 3)
    _require_count(rows * columns, "dots")
    spacing, diameter, is_shifted = own.length("spacing"), own.length("diameter"), own.is_true("shifted")
    nearest = spacing * (math.sqrt(2) if is_shifted else 1.0)
    if not diameter < nearest:
        raise FileError(f"dots.diameter: {diameter:g} m; need less than the {nearest:g} m between two dots")
    return DotLayout(columns, rows, spacing, diameter, is_shifted)


#: What a board file may hold.
_KINDS: dict[str, Callable[[Mapping[str, Any]], Board]] = {
    "markers": _of_markers,
    "grid": _of_grid,
    "charuco": _of_charuco,
    "chessboard": _of_chessboard,
    "dots": _of_dots,
}


def _require_count(count: int, what: str = "markers") -> None:
    if count > _MOST_MARKERS:
        raise FileError(f"{count} {what}; need at most {_MOST_MARKERS}")


def _require_possible(board: Board) -> None:
    """Raise where markers are none of their family, look alike, are twice there, or overlap."""
    seen = set()
    for marker in markers_of(board):
        marker_cells(marker.family, marker.number)
        if not marker_distance(marker.family, marker.number):
            raise FileError(f"{marker}: turned, it looks like itself or another one of its family; need another id")
        if (marker.family, marker.number) in seen:
            raise FileError(f"{marker}: twice; need each marker once")
        seen.add((marker.family, marker.number))
    overlapping = _coinciding(board) if isinstance(board, tuple) else _overlapping(board.markers)
    for first, second in overlapping:
        raise FileError(f"{first} and {second} overlap; need places with white between them")
    if isinstance(board, tuple):
        return
    template = DotTemplate(board) if isinstance(board, DotLayout) else LayoutTemplate(board)
    if (cell_px := template.cell_px) < _LEAST_CELL_PX:
        raise FileError(
            f"{board.width:g} m wide: cells of its smallest detail would have {cell_px:.2g} px in the template; need "
            f"at least {_LEAST_CELL_PX:g}: a smaller board, or several"
        )


def markers_of(board: Board) -> Sequence[PlacedMarker]:
    """Return the markers of a board or a bundle."""
    return [each.marker for each in board] if isinstance(board, tuple) else board.markers


def _coinciding(markers: Sequence[BundleMarker]) -> Iterator[tuple[PlacedMarker, PlacedMarker]]:
    """Yield those whose centres are nearer than half the smaller one and that face the same side."""
    for index, first in enumerate(markers):
        for second in markers[:index]:
            away = float(np.linalg.norm(first.place.t - second.place.t))
            if away < min(first.marker.size, second.marker.size) / 2 and (
                float(first.place.R[:, 2] @ second.place.R[:, 2]) > _ALIKE
            ):
                yield second.marker, first.marker


def _overlapping(markers: Sequence[PlacedMarker]) -> Iterator[tuple[PlacedMarker, PlacedMarker]]:
    for index, first in enumerate(markers):
        for second in markers[:index]:
            least = (first.size + second.size) / 2 * (1 - _ROUNDING)
            if max(abs(first.x - second.x), abs(first.y - second.y)) < least:
                yield second, first


def bundle_text(markers: Sequence[BundleMarker], remarks: Mapping[str, str], head: Sequence[str] = ()) -> str:
    """Return the text of a board file; numbers round-trip.

    Parameters
    ----------
    markers : of a bundle
    remarks : for people, by marker
    head : for people, lines at the top
    """
    lines = [f"# {line}" for line in head] + ["markers:"]
    for each in markers:
        numbers = each.place.transform.numbers().tolist()
        lines += [f"# {remarks[str(each.marker)]}"] if str(each.marker) in remarks else []
        x, y, z = (_shown(value) for value in numbers[:3])
        lines.append(f"- family: {each.marker.family}")
        lines.append(f"  id: {each.marker.number}")
        lines.append(f"  size: {_shown(each.marker.size)}")
        lines += [f"  x: {x}", f"  y: {y}", f"  z: {z}"]
        lines.append(f"  quaternion: [{', '.join(map(_shown, numbers[3:]))}]")
        if each.place.covariance.any():
            rows = [", ".join(map(_shown, row)) for row in each.place.covariance.tolist()]
            lines.append(f"  covariance: [{(',' + chr(10) + '    ').join(rows)}]")
    return "\n".join(lines) + "\n"


def _shown(value: float) -> str:
    return repr(float(value) + 0.0)
