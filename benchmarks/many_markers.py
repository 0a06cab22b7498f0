# SPDX-License-Identifier: Apache-2.0
"""Forty tags in one view of 1280x720, in every frame of a moving sequence: what becomes of each that is wholly in view.

    python benchmarks/many_markers.py --seeds 5 6

Tags of tag36h11, 50 mm, on a sheet of 0.64 x 0.40 m, in simulated frames with exact truth. Counted are: metric,
ambiguous (two poses fit alike, as of any small tag seen from its front), lost, and, of those found, wrong ones, whose
corners are off by more than a px (rms). ms: processor time of a frame.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter

import cv2
import numpy as np
from numpy.typing import NDArray

from imgu_ros.config.parameters import Parameters
from imgu_ros.localizer import Localizer
from imgu_ros.reference.marker import marker_image
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.simulate.sequence import Simulation, simulate_sequence

COLUMNS, ROWS, SIZE_M = 8, 5, 0.05
WIDTH, HEIGHT = 1280, 720
#: Sides of a tag's place on the sheet and of its black square, px of the sheet.
_PITCH_PX, _TAG_PX = 160, 100
_WRONG_PX = 1.0


def sheet_of(pictures: list[NDArray[np.uint8]]) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Return a sheet with tags, and the corners of their black squares, (N, 4, 2) px of the sheet."""
    sheet = np.full((ROWS * _PITCH_PX, COLUMNS * _PITCH_PX), 255, np.uint8)
    corners = []
    for index, picture in enumerate(pictures):
        row, column = divmod(index, COLUMNS)
        side = _TAG_PX * 10 // 8  # with a cell of white about the eight of the tag
        left, top = (each * _PITCH_PX + (_PITCH_PX - side) // 2 for each in (column, row))
        sheet[top : top + side, left : left + side] = cv2.resize(picture, (side, side), interpolation=cv2.INTER_AREA)
        square = np.array([[1, 1], [9, 1], [9, 9], [1, 9]]) * side / 10
        corners.append(square + (left - 0.5, top - 0.5))
    return sheet, np.array(corners)


def measured(seed: int, frames: int) -> tuple[Counter[str], float]:
    """Return what became of the tags in view, and the median time of a frame, ms."""
    tags = [marker_image(f"tag_{index}", "tag36h11", index, SIZE_M) for index in range(COLUMNS * ROWS)]
    sheet, corners = sheet_of([np.asarray(tag.pixels, np.uint8) for tag in tags])
    shown = TargetImage("sheet", sheet, SIZE_M * COLUMNS * _PITCH_PX / _TAG_PX)
    localizer = Localizer(Parameters(), prepare_references(tags, Parameters()))
    counts, times = Counter[str](), []
    for simulated in simulate_sequence(Simulation(WIDTH, HEIGHT, frames=frames, seed=seed), [shown]):
        start = time.process_time()
        result = localizer.process(simulated.frame)
        times.append(1000 * (time.process_time() - start))
        H = simulated.truths[0].H
        for each, square in zip(result, corners, strict=True):
            at = np.column_stack((square, np.ones(4))) @ H.T
            at = at[:, :2] / at[:, 2:]
            if not ((at > 3) & (at < (WIDTH - 4, HEIGHT - 4))).all():
                continue
            counts[each.pose_status.value or each.status.value] += 1
            if each.outline is not None:
                counts["wrong"] += bool(np.sqrt(((each.outline - at) ** 2).sum(axis=1).mean()) > _WRONG_PX)
    return counts, float(np.median(times))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0], help="of the path and the noise (default 0)")
    parser.add_argument("--frames", type=int, default=40)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    for seed in arguments.seeds:
        counts, ms = measured(seed, arguments.frames)
        in_view = sum(count for name, count in counts.items() if name != "wrong")
        print(f"seed {seed}: {in_view} tags in view: {dict(counts)}; {ms:.0f} ms")


if __name__ == "__main__":
    main()
