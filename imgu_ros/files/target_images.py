# SPDX-License-Identifier: Apache-2.0
"""Load the known targets that the parameters name: pictures, fiducial markers, and boards of these."""

from __future__ import annotations

import os
import re
import unicodedata
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters, TargetsParameters
from imgu_ros.errors import FileError, ParameterError, ShapeError
from imgu_ros.files.board_file import BOARD_SUFFIXES, read_board
from imgu_ros.image_files.images import read_image_file
from imgu_ros.reference.bundle import BundleImage, bundle_image
from imgu_ros.reference.dot_layout import DotLayout
from imgu_ros.reference.family import FamilyImage, family_image
from imgu_ros.reference.marker import MarkerImage, board_image, marker_image
from imgu_ros.reference.marker_layout import MarkerLayout, PlacedMarker
from imgu_ros.reference.pattern import pattern_image
from imgu_ros.reference.templates import TargetImage
from imgu_ros.shown_text import quoted
from imgu_ros.types import Image
from imgu_ros.vision.markers import marker_count, marker_distance, require_marker_family
from imgu_ros.vision.markers.dictionaries import MARKER_FAMILIES

_MIN_SIDE_PX = 16
#: Memory that a chain takes to prepare a target, for each of its pixels (measured with default methods).
_PIXEL_BYTES = 25
#: Grey values between the darkest and the brightest pixel below which a picture has nothing to find.
_MIN_CONTRAST = 8
#: The note about a picture whose colour is the paper's.
_SHAPE = "a white shape on transparency: taken as white on black"
#: With what goes round it a name makes names of topics and of files, which have at most 255 characters.
_LONGEST_NAME = 128
#: A marker: family and id, or all ids.
_MARKER = re.compile(r"([A-Za-z]\w*):(\*|-?\d{1,9})", re.ASCII)
_TOKEN = re.compile(r"[A-Za-z](?!\w*__)\w*", re.ASCII)


def load_target_images(
    targets: TargetsParameters,
    on_warning: Callable[[str], None] = lambda text: None,
    *,
    limits: LimitsParameters = DEFAULT_LIMITS,
) -> tuple[TargetImage, ...]:
    """Return the targets: pictures, upright, as their orientation tags say, and on white where they are transparent;
    markers, of entries like `tag36h11:7`; all ids of a family, `tag36h11:*`; and boards, of files like `board.yaml`.

    Parameters
    ----------
    targets : `images` with `~` and `$VARIABLES` expanded; a width left out is 0 (unknown), a name left out is the
        file's stem made a valid ROS name, or family and id of a marker, `tag36h11_7`
    on_warning : called for each thing the user should know
    limits : what decoding a picture, and preparing a target of it, may cost

    Returns
    -------
    One for each of `images`, in their order; pixels are uint8.

    Raises
    ------
    FileError
        If a file is missing, no image, too small, or blank, or no board file.
    ParameterError
        If a name is no ROS name, two targets have the same, or the same marker, or there is no such marker.
    """
    entries = [_marker_of(text) or _path_of(text) for text in targets.images]
    names = [_checked_name(name) for name in targets.names] or [_default_name(entry) for entry in entries]
    _refuse_collisions(names, entries)
    widths = targets.widths_m or (0.0,) * len(entries)
    images: list[TargetImage] = []
    for name, entry, width in zip(names, entries, widths, strict=True):
        if not isinstance(entry, _Family):
            images.append(_image_of(entry, name, float(width), on_warning, limits))
    single = [entry for entry in entries if not isinstance(entry, _Family)]
    _refuse_shared_markers(images, single)
    if len(single) < len(entries):
        _refuse_places(targets, entries)
        taken = [marker for image in images for marker in _markers_of(image)]
        number = len(entries)
        for index, entry in enumerate(entries):
            if isinstance(entry, _Family):
                own = frozenset(marker.number for marker in taken if marker.family == entry.family)
                images.insert(index, family_image(names[index], entry.family, float(widths[index]), own, number))
                number += marker_count(entry.family)
        _refuse_names_of_ids(images)
    return tuple(images)


def _refuse_places(targets: TargetsParameters, entries: Sequence[_Entry]) -> None:
    """Raise where markers of any id have one place in the map, or a family is there twice."""
    families = [entry for entry in entries if isinstance(entry, _Family)]
    if targets.poses:
        raise ParameterError(
            f"targets.poses: with {families[0]} in targets.images, of which each marker has a place of its own; need "
            f"an entry for each, {families[0].family}:0, {families[0].family}:1, ..."
        )
    for family in families:
        if families.count(family) > 1:
            raise ParameterError(f"targets.images: {family} twice; need it once")


def _refuse_names_of_ids(images: Sequence[TargetImage]) -> None:
    """Raise where the name of a target is the one that an id of a family would have."""
    names = {image.name for image in images}
    for image in images:
        if isinstance(image, FamilyImage):
            ids = (marker for marker in range(marker_count(image.family)) if marker not in image.taken)
            for marker in ids:
                if image.member_name(marker) in names:
                    raise ParameterError(
                        f"targets.names: {image.member_name(marker)!r} for a target and for {image.family}:{marker}; "
                        "need different names"
                    )


def _image_of(
    entry: _Marker | Path, name: str, width_m: float, on_warning: Callable[[str], None], limits: LimitsParameters
) -> TargetImage:
    if isinstance(entry, _Marker):
        return marker_image(name, entry.family, entry.number, width_m)
    if entry.suffix.lower() in BOARD_SUFFIXES:
        board = read_board(entry, limits)
        if isinstance(board, DotLayout) or (isinstance(board, MarkerLayout) and not board.markers):
            return pattern_image(name, board, width_m)
        if isinstance(board, MarkerLayout):
            return board_image(name, board, width_m)
        if width_m:
            raise ParameterError(
                f"targets.widths_m: {width_m:g} of {entry}: markers on several planes have no one width; need 0, and "
                "sizes in the file"
            )
        return bundle_image(name, board)
    return TargetImage(name, _target_pixels(entry, on_warning, limits), width_m)


def _refuse_shared_markers(images: Sequence[TargetImage], entries: Sequence[_Marker | Path]) -> None:
    """Raise where a marker belongs to two targets: which one is seen could not be told."""
    owners: dict[str, tuple[TargetImage, _Marker | Path]] = {}
    for image, entry in zip(images, entries, strict=True):
        for marker in _markers_of(image):
            if str(marker) in owners:
                other, whose = owners[str(marker)]
                raise ParameterError(
                    f"targets.images: {marker} belongs to both {_words(other, whose)} and {_words(image, entry)}; need "
                    "each marker in one target"
                )
            owners[str(marker)] = image, entry


def _markers_of(image: TargetImage) -> Sequence[PlacedMarker]:
    if isinstance(image, BundleImage):
        return [each.marker for each in image.markers]
    return image.layout.markers if isinstance(image, MarkerImage) else ()


def _words(image: TargetImage, entry: _Marker | Path) -> str:
    return f"target {image.name}" if isinstance(entry, _Marker) else f"board {entry}"


@dataclass(frozen=True)
class _Family:
    family: str

    def __str__(self) -> str:
        return f"{self.family}:*"


@dataclass(frozen=True)
class _Marker:
    family: str
    number: int

    def __str__(self) -> str:
        return f"{self.family}:{self.number}"


#: What `targets.images` may name.
_Entry = _Marker | _Family | Path


def _marker_of(text: str) -> _Marker | _Family | None:
    """Return the marker, or all of a family, that an entry names; None when it names a file.

    Raises
    ------
    ParameterError
        If there is no such marker.
    """
    match = _MARKER.fullmatch(text)
    if match is None or os.path.exists(text):
        return None
    family, number = match.groups()
    try:
        require_marker_family(family)
        if number == "*":
            return _Family(family)
        found = _Marker(family, int(number))
        distance = marker_distance(family, found.number)
    except ShapeError as error:
        raise ParameterError(f"targets.images: {error}") from None
    if not distance:
        raise ParameterError(
            f"targets.images: {text}: turned, it looks like itself or another one of {family}; need another id"
        )
    return found


def _path_of(text: str) -> Path:
    if text in MARKER_FAMILIES and not os.path.exists(text):
        raise ParameterError(f"targets.images: {text}: a family of markers without an id; need {text}:0 or {text}:*")
    return expanded_path(text)


def _default_name(entry: _Entry) -> str:
    if isinstance(entry, _Family):
        return entry.family
    return f"{entry.family}_{entry.number}" if isinstance(entry, _Marker) else name_from_stem(entry.stem)


def expanded_path(text: str) -> Path:
    """Return the path that a parameter names, with `~` and `$VARIABLES` replaced.

    Raises
    ------
    FileError
        If it is empty, or a variable is not set.
    """
    if not text:
        raise FileError("targets.images: empty file name; need the path of an image")
    path = os.path.expandvars(os.path.expanduser(text))
    unset = re.search(r"\$(\w+|\{[^}]*\})", path)
    if unset and not os.path.exists(path):
        raise FileError(f"{text}: variable {unset.group()} is not set; need it for the path")
    return Path(path)


def name_from_stem(stem: str) -> str:
    """Return the valid ROS name nearest to a file's stem: letters, digits, single underscores, a letter first.

    A long one is cut, and ends in a checksum that tells it from others.
    """
    ascii_only = unicodedata.normalize("NFKD", stem).encode("ascii", "ignore").decode()
    name = re.sub(r"_+", "_", re.sub(r"[^A-Za-z0-9]+", "_", ascii_only)).strip("_")
    if not name:
        return "target"
    name = name if name[0].isalpha() else f"target_{name}"
    if len(name) <= _LONGEST_NAME:
        return name
    return f"{name[: _LONGEST_NAME - 9].rstrip('_')}_{zlib.crc32(stem.encode('utf-8', 'surrogatepass')):08x}"


def _checked_name(name: str) -> str:
    if len(name) > _LONGEST_NAME or not _TOKEN.fullmatch(name):
        raise ParameterError(
            f"targets.names: {quoted(name)}; need letters, digits and single underscores, a letter first, "
            f"at most {_LONGEST_NAME}"
        )
    return name


def _refuse_collisions(names: list[str], entries: list[_Entry]) -> None:
    seen: dict[str, _Entry] = {}
    for name, entry in zip(names, entries, strict=True):
        if name in seen:
            raise ParameterError(f"targets.names: {name!r} for both {seen[name]} and {entry}; need different names")
        seen[name] = entry


def _target_pixels(path: Path, on_warning: Callable[[str], None], limits: LimitsParameters) -> Image:
    file = read_image_file(path, upright=True, limits=limits, pixel_bytes=_PIXEL_BYTES)
    pixels, notes = _as_8_bit(file.pixels), file.notes
    if file.alpha is not None and _contrast(pixels) < _MIN_CONTRAST:
        # A white shape on nothing: its form is in the alpha channel alone.
        shape = _as_8_bit(file.alpha)
        if _contrast(shape) >= _MIN_CONTRAST:
            pixels, notes = shape, (_SHAPE,)
    for note in notes:
        on_warning(f"{path}: {note}")
    if min(pixels.shape[:2]) < _MIN_SIDE_PX:
        size = f"{pixels.shape[1]} x {pixels.shape[0]}"
        raise FileError(f"{path}: {size} px; need a target of at least {_MIN_SIDE_PX} x {_MIN_SIDE_PX}")
    contrast = _contrast(pixels)
    if contrast < _MIN_CONTRAST:
        raise FileError(f"{path}: blank (grey values differ by {contrast}); need a picture with texture")
    return pixels


def _contrast(pixels: Image) -> int:
    """Return by how much the grey values of a picture differ."""
    grey = pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
    return int(grey.max()) - int(grey.min())


def _as_8_bit(pixels: Image) -> Image:
    """Scale to 8 bits; 10- or 12-bit values in 16-bit files keep their contrast."""
    if pixels.dtype == np.uint8:
        return pixels
    if pixels.dtype == np.uint16:
        full_scale = float(2 ** max(8, int(pixels.max()).bit_length()) - 1)
        return cv2.convertScaleAbs(pixels, alpha=255 / full_scale)
    scaled = np.empty(pixels.shape, np.uint8)
    for row, values in zip(scaled, pixels, strict=True):
        row[:] = np.rint(np.clip(np.nan_to_num(values), 0, 1) * 255)
    return scaled
