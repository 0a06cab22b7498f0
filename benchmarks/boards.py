# SPDX-License-Identifier: Apache-2.0
"""Poses of boards and cubes of fiducial markers against their exact truth, and beside single markers.

    python benchmarks/boards.py --seed 71 --views 200 --json benchmarks/figures/boards.json

Frames of 640x480 with a focal length of 680 px, of `board_views.py`, raw and linear; each view is one by itself.

board: six tags of 80 mm, gaps of 30 mm, at 1.5 m, tilted by up to 60 degrees; beside it each of its tags alone, of
    which the best one is that with the smallest uncertainty of its position.
covered: the same, half covered from one side, 0.8 to 1.5 m away.
other: the same, one of its tags exchanged for another id: no pose may go out.
charuco: ChArUco boards of 5 x 4 squares of 40 mm, markers of 30 mm, 0.6 to 1.5 m away.
cube: a cube of 100 mm with tags of 80 mm on five faces, 0.5 to 2 m away, from any side but from below. A flip is a
    rotation that is off by 0.3 rad or more.
measured: where the tags of such a cube are on it, by 24 frames from any side but from below, 0.4 to 0.8 m away, one
    cube for ten views: each of its other tags relative to the first counts as a view. Where one of them is not seen
    often enough beside others, the cube counts as not found.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from board_views import (
    INK,
    PAPER,
    Sheet,
    Tag,
    board_frame,
    cube_frame,
    cube_places,
    cube_pose,
    grid_of,
    pose_in_view,
    sheet_of,
)
from numpy.typing import NDArray
from print_views import RAW_PARAMETERS

from imgu_ros.config.values import parameters_from
from imgu_ros.errors import TooFewPoints
from imgu_ros.localizer import Localizer
from imgu_ros.pose.bundle_measurement import measure_bundle
from imgu_ros.reference.bundle import BundleMarker, bundle_image
from imgu_ros.reference.marker import board_image, marker_image
from imgu_ros.reference.marker_layout import MarkerLayout, PlacedMarker, charuco_layout
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import make_references
from imgu_ros.result import ReferenceResult, Result
from imgu_ros.vision.camera.pose import Pose

Floats = NDArray[np.floating]

FAMILY, COUNT = "tag36h11", 587
SIZE, GAP, CUBE = 0.08, 0.03, 0.1
#: A rotation that is off by more is the other solution of a plane, rad.
_FLIPPED = 0.3
#: Frames by which a thing is measured.
_MEASURED_FRAMES = 24
#: Bound of the squared error in units of the covariance, 95 % of six degrees of freedom.
_INSIDE = 12.59


@dataclass
class BoardFigures:
    """What became of the views of one study.

    Attributes
    ----------
    views, found, ambiguous, flips : numbers of views; a flip went out as a pose
    errors_mm, nees : of the poses that went out
    single_mm, best_mm : errors of single tags, all, and the most certain one of each view
    """

    views: int = 0
    found: int = 0
    ambiguous: int = 0
    flips: int = 0
    errors_mm: list[float] = field(default_factory=list)
    nees: list[float] = field(default_factory=list)
    single_mm: list[float] = field(default_factory=list)
    best_mm: list[float] = field(default_factory=list)

    def take(self, result: ReferenceResult, R: Floats, t: Floats) -> None:
        """Add one view."""
        self.views += 1
        self.found += result.status.found
        if not result.status.found:
            return
        if result.pose is None:
            self.ambiguous += 1
            return
        self.add(result.pose, R, t)

    def add(self, pose: Pose, R: Floats, t: Floats) -> None:
        """Add a pose and its truth."""
        turn = cv2.Rodrigues(R @ pose.R.T)[0].ravel()
        error = np.concatenate((t - pose.t, turn))
        self.flips += bool(np.linalg.norm(turn) > _FLIPPED)
        self.errors_mm.append(1e3 * float(np.linalg.norm(error[:3])))
        self.nees.append(float(error @ np.linalg.solve(pose.covariance, error)))

    def row(self) -> dict[str, float | int | None]:
        """Return the figures by name."""

        def of(values: Sequence[float], percent: float) -> float | None:
            return round(float(np.percentile(values, percent)), 4) if values else None

        return {
            "views": self.views,
            "found": self.found,
            "ambiguous": self.ambiguous,
            "flips": self.flips,
            "median_mm": of(self.errors_mm, 50),
            "p95_mm": of(self.errors_mm, 95),
            "nees_p50": of(self.nees, 50),
            "inside": round(float(np.mean(np.array(self.nees) < _INSIDE)), 3) if self.nees else None,
            "single_median_mm": of(self.single_mm, 50),
            "best_single_median_mm": of(self.best_mm, 50),
            "best_single_p95_mm": of(self.best_mm, 95),
        }


def processed(view: object, images: Sequence[TargetImage]) -> Result:
    """Return the result of one frame."""
    parameters = parameters_from(RAW_PARAMETERS)
    return Localizer(parameters, make_references(images, parameters)).process(view)  # type: ignore[arg-type]


def layout_of(tags: Sequence[Tag]) -> MarkerLayout:
    """Return the layout of tags."""
    return MarkerLayout(tuple(PlacedMarker(FAMILY, tag.number, tag.size, tag.x, tag.y) for tag in tags))


def six_tags(rng: np.random.Generator) -> list[Tag]:
    """Return a board of six tags with random ids."""
    return grid_of(rng.permutation(COUNT)[:6].tolist(), 3, SIZE, GAP)


def board(rng: np.random.Generator, figures: BoardFigures) -> None:
    """Add a view of a board, and what its tags give alone."""
    tags = six_tags(rng)
    sheet = sheet_of(tags)
    R, t = pose_in_view(rng, sheet, (1.5, 1.5), 60)
    frame = board_frame(sheet, R, t, rng)
    figures.take(processed(frame, [board_image("board", layout_of(tags))]).first, R, t)
    alone = processed(frame, [marker_image(f"m{tag.number}", FAMILY, tag.number, SIZE) for tag in tags])
    errors: dict[float, float] = {}
    for tag, found in zip(tags, alone, strict=True):
        if found.solutions:
            pose = found.solutions[0]
            at = R @ (tag.x, tag.y, 0) + t
            errors[float(np.trace(pose.covariance[:3, :3]))] = 1e3 * float(np.linalg.norm(pose.t - at))
    if errors:
        figures.single_mm += errors.values()
        figures.best_mm.append(errors[min(errors)])


def covered(rng: np.random.Generator, figures: BoardFigures) -> None:
    """Add a view of a board that is half covered."""
    tags = six_tags(rng)
    sheet = sheet_of(tags)
    R, t = pose_in_view(rng, sheet, (0.8, 1.5), 60)
    frame = board_frame(sheet, R, t, rng, covered=0.5)
    figures.take(processed(frame, [board_image("board", layout_of(tags))]).first, R, t)


def other(rng: np.random.Generator, figures: BoardFigures) -> None:
    """Add a view of a board that has another id at one place."""
    tags = six_tags(rng)
    at, number = int(rng.integers(6)), int(rng.integers(COUNT))
    while number in {tag.number for tag in tags}:
        number = int(rng.integers(COUNT))
    shown = [Tag(number, tag.size, tag.x, tag.y) if i == at else tag for i, tag in enumerate(tags)]
    sheet = sheet_of(shown)
    R, t = pose_in_view(rng, sheet, (0.8, 1.5), 60)
    figures.take(processed(board_frame(sheet, R, t, rng), [board_image("board", layout_of(tags))]).first, R, t)


def charuco(rng: np.random.Generator, figures: BoardFigures) -> None:
    """Add a view of a ChArUco board that OpenCV draws."""
    columns, rows, square, size, px = 5, 4, 0.04, 0.03, 224  # cells of 24 px, on whole pixels
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    drawn = cv2.aruco.CharucoBoard((columns, rows), square, size, dictionary).generateImage((columns * px, rows * px))
    paper = np.pad(np.where(drawn > 127, PAPER, INK).astype(np.uint8), px // 2, constant_values=PAPER)
    step = square / px
    x, y = -step * (columns * px / 2 + px / 2 - 0.5), step * (rows * px / 2 + px / 2 - 0.5)
    sheet = Sheet(np.dstack([paper] * 3), np.array([[step, 0, x], [0, -step, y], [0, 0, 1]]))
    R, t = pose_in_view(rng, sheet, (0.6, 1.5), 60)
    layout = charuco_layout("aruco_5x5_100", columns, rows, square, size, range(10), is_legacy=False)
    figures.take(processed(board_frame(sheet, R, t, rng), [board_image("board", layout)]).first, R, t)


def cube(rng: np.random.Generator, figures: BoardFigures) -> None:
    """Add a view of a cube."""
    numbers = rng.permutation(COUNT)[:5].tolist()
    R, t = cube_pose(rng, CUBE, (0.5, 2.0))
    markers = tuple(
        BundleMarker(PlacedMarker(FAMILY, number, SIZE), Pose(*place, np.zeros((6, 6)), 0.0))
        for number, place in zip(numbers, cube_places(CUBE), strict=True)
    )
    frame = cube_frame(rng, numbers, CUBE, SIZE, R, t)
    figures.take(processed(frame, [bundle_image("cube", markers)]).first, R, t)


def measured(rng: np.random.Generator, figures: BoardFigures) -> None:
    """Add what is measured of a cube."""
    names = [str(number) for number in rng.permutation(COUNT)[:5]]
    images = [marker_image(name, FAMILY, int(name), SIZE) for name in names]
    frames = []
    for _ in range(_MEASURED_FRAMES):
        R, t = cube_pose(rng, CUBE, (0.4, 0.8))
        result = processed(cube_frame(rng, [int(name) for name in names], CUBE, SIZE, R, t), images)
        frames.append({found.name: found.pose for found in result if found.pose is not None})
    (R_first, t_first), *others = cube_places(CUBE)
    figures.views += len(others)
    try:
        found = measure_bundle(frames, names)
    except TooFewPoints:
        return
    for name, (R, t) in zip(names[1:], others, strict=True):
        figures.found += 1
        figures.add(found.markers[name].place, R_first.T @ R, R_first.T @ (t - t_first))


STUDIES: dict[str, Callable[[np.random.Generator, BoardFigures], None]] = {
    each.__name__: each for each in (board, covered, other, charuco, cube, measured)
}


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=71)
    parser.add_argument("--views", type=int, default=100, help="of each study")
    parser.add_argument("--study", action="append", choices=STUDIES, help="several times for several; default: all")
    parser.add_argument("--json", type=Path, help="write the figures; those of other studies stay")
    arguments = parser.parse_args()
    document = {}
    if arguments.json and arguments.json.exists():
        document = json.loads(arguments.json.read_text(encoding="utf-8"))
    for index, (name, add) in enumerate(STUDIES.items()):
        if name in (arguments.study or STUDIES):
            figures = BoardFigures()
            for view in range(arguments.views // 10 if name == "measured" else arguments.views):
                add(np.random.default_rng([arguments.seed, index, view]), figures)
            document[name] = {"seed": arguments.seed, **figures.row()}
            print(name, "  ".join(f"{key} {value}" for key, value in document[name].items()), flush=True)
            if arguments.json:
                arguments.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
