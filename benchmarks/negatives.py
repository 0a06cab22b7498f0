# SPDX-License-Identifier: Apache-2.0
"""Is a pose published of a target that is not in view? Frames without it, other prints, and others in its place.

    python benchmarks/negatives.py                      # a few hundred frames of each sort
    python benchmarks/negatives.py --frames 10000 --json negatives.json --seed 5

Six targets are known at once: a photograph, a page, a label, a logo, a tag and a board of tags (`negative_scenes.py`).

- absent: scenes without any of them. other: one to three other prints before a scene, of the same kinds.
- replaced: a target is tracked, then another print of its kind, of the same shape, lies exactly where it was; the
  camera goes on as before. removed: it is taken away.
- sibling: a print that differs from the target in a rectangle of 3 to 30 % of its area, and nowhere else, tracking on;
  the target is never in view. The part that differs could as well be a part that is covered.
- shown: the target itself, in the sequences of `replaced` before that: poses, and those whose corners are off by more
  than 10 px (rms).

Whatever is published in a frame of the others is wrong. A frame counts once, however many targets are known.
"""

from __future__ import annotations

import argparse
import json
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import negative_scenes as scenes
import numpy as np
from negative_scenes import SHEETS, Floats, Look
from print_canvas import Pixels

from imgu_ros.bench.machine import this_machine
from imgu_ros.cli.options import add_parameter_options, parameters_of
from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.frame import Frame
from imgu_ros.localizer import Localizer
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.result import ReferenceResult

#: Frames of one group of targets: then others are drawn.
_GROUP = 120
#: Frames of a sequence with the target, and after it.
_BEFORE, _AFTER = 5, 10
SORTS = ("absent", "other", "replaced", "removed", "sibling")
WRONG_PX = 10.0
_PERIOD_NS = 33_000_000


@dataclass(frozen=True)
class Published:
    """A pose or homography that went out of a target that was not there: `sort` and `seed` give the frame again."""

    sort: str
    seed: int
    index: int
    target: str
    status: str
    pose_status: str
    confirmed_share: float | None


@dataclass(frozen=True)
class Shown:
    """A frame with a target: what became of it, and the error of its corners, px."""

    target: str
    index: int
    status: str
    is_pose: bool
    corner_px: float | None


@dataclass(frozen=True, eq=False)
class Known:
    """A group of known targets, and the localizer that knows them."""

    sheets: dict[str, Pixels]
    localizer: Localizer


def known_targets(rng: np.random.Generator, parameters: Parameters) -> Known:
    """Draw a target of each kind."""
    sheets = {kind: draw(rng) for kind, draw in SHEETS.items()}
    images = [TargetImage(kind, sheet, sheet.shape[1] / max(sheet.shape[:2])) for kind, sheet in sheets.items()]
    localizer = Localizer(parameters, prepare_references(images, parameters))
    localizer.prepare()
    return Known(sheets, localizer)


def absent(rng: np.random.Generator, known: Known, count: int) -> Iterator[tuple[str, Frame, None]]:
    """Yield scenes."""
    for index in range(count):
        yield "", scenes.exposed(scenes.scene(rng), Look.drawn(rng), rng, index * 10**9), None


def other(rng: np.random.Generator, known: Known, count: int) -> Iterator[tuple[str, Frame, None]]:
    """Yield other prints before scenes."""
    for index in range(count):
        image = scenes.scene(rng)
        for _ in range(int(rng.integers(1, 4))):
            kind = str(rng.choice(list(SHEETS)))
            sheet = scenes.photo(rng, of_targets=False) if kind == "photo" else SHEETS[kind](rng)
            scenes.put(image, sheet, scenes.placed(rng, sheet, (130, 560))[0])
        yield "", scenes.exposed(image, Look.drawn(rng), rng, index * 10**9), None


def in_place(
    rng: np.random.Generator, known: Known, count: int, sort: str
) -> Iterator[tuple[str, Frame, Floats | None]]:
    """Yield sequences in which a target is replaced or removed, or its sibling is in view all the time."""
    start = 10**9
    for number in range(math.ceil(count / _AFTER)):
        kind = list(known.sheets)[number % len(known.sheets)]
        sheet, ground, look = known.sheets[kind], scenes.scene(rng), Look.drawn(rng)
        before = 0 if sort == "sibling" else _BEFORE
        if sort == "sibling":
            instead = scenes.sibling(rng, sheet, rng.uniform(0.03, 0.3))
        else:
            instead = scenes.photo(rng, of_targets=False) if kind == "photo" else SHEETS[kind](rng)
            instead = cv2.resize(instead, sheet.shape[1::-1], interpolation=cv2.INTER_AREA)
        start += 10 * 10**9
        for step, H in enumerate(_path(rng, sheet, before + _AFTER)):
            image = ground.copy()
            if step < before or sort != "removed":
                scenes.put(image, sheet if step < before else instead, H)
            stamp_ns = start + step * _PERIOD_NS
            yield kind, scenes.exposed(image, look, rng, stamp_ns), H if step < before else None


def _path(rng: np.random.Generator, sheet: Pixels, count: int) -> list[Floats]:
    """Return where a sheet is in each frame of a smooth motion; it stays in view."""
    while True:
        _, place = scenes.placed(rng, sheet, (180, 420), 40)
        turn, move = rng.uniform(-0.04, 0.04, 3), rng.uniform(-0.02, 0.02, 3)
        turn[2] *= 3
        made = []
        for step in range(count):
            R = scenes.rotation(tuple(turn * step)) @ place[:, :3]
            made.append(scenes.homography(sheet, np.column_stack((R, place[:, 3] + move * step * place[2, 3] / 2))))
        if all(scenes.in_view(sheet, H) for H in made):
            return made


def measured(sort: str, frames: int, seed: int, parameters: Parameters) -> tuple[int, list[Published], list[Shown]]:
    """Return the frames without a target, and what was published of one, and the frames with one."""
    published: list[Published] = []
    shown: list[Shown] = []
    count = 0
    cv2.setNumThreads(1)
    if sort in ("absent", "other"):
        parameters = parameters_from({"tracking.enabled": False}, parameters)
    for group in range(math.ceil(frames / _GROUP)):
        rng = np.random.default_rng([seed, SORTS.index(sort), group])
        known = known_targets(rng, parameters)
        wanted = min(_GROUP, frames - group * _GROUP)
        if sort in ("absent", "other"):
            views = (absent if sort == "absent" else other)(rng, known, wanted)
        else:
            views = in_place(rng, known, wanted, sort)
        for index, (kind, frame, H) in enumerate(views):
            results = known.localizer.process(frame)
            found = [each for each in results if each.homography is not None]
            if H is None:
                count += 1
            else:
                own = results.references[kind]
                shown.append(Shown(kind, index, own.status.value, own.pose is not None, _error(own, known, H)))
                found = [each for each in found if each.name != kind]
            published += [_published(each, sort, group, index) for each in found]
    return count, published, shown


def _published(result: ReferenceResult, sort: str, group: int, index: int) -> Published:
    return Published(
        sort, group, index, result.name, result.status.value, result.pose_status.value, result.confirmed_share
    )


def _error(result: ReferenceResult, known: Known, H: Floats) -> float | None:
    if result.homography is None:
        return None
    sheet = known.sheets[result.name]
    away = scenes.corners(sheet, result.homography.H) - scenes.corners(sheet, H)
    return float(np.sqrt((away**2).sum(axis=1).mean()))


def main() -> None:
    """Measure, print, and store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=240, help="of each sort (default 240)")
    parser.add_argument("--sorts", nargs="+", choices=SORTS, default=SORTS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="file for the figures")
    add_parameter_options(parser)
    arguments = parser.parse_args()
    parameters = parameters_of(arguments, {})
    rows, wrong = {}, []
    for sort in arguments.sorts:
        count, published, shown = measured(sort, arguments.frames, arguments.seed, parameters)
        poses = [each for each in published if each.pose_status == "metric"]
        row: dict[str, object] = {"frames": count, "poses": len(poses), "homographies": len(published)}
        row["targets"] = dict(Counter(each.target for each in poses))
        if shown:
            errors = [each.corner_px for each in shown if each.is_pose and each.corner_px is not None]
            row["shown"] = {
                "frames": len(shown), "poses": len(errors), "wrong": sum(error > WRONG_PX for error in errors),
            }  # fmt: skip
        rows[sort] = row
        wrong += published
        print(f"{sort:10s} {row}", flush=True)
    if arguments.json:
        figures = {"machine": asdict(this_machine()), "seed": arguments.seed, "sorts": rows}
        figures["published"] = [asdict(each) for each in wrong]
        arguments.json.write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
