# SPDX-License-Identifier: Apache-2.0
"""Forty and more kinds of prints in simulated views, judged by exact truth, beside recipes of SIFT and ORB.

    python benchmarks/printed_targets.py                 # one seed, every kind: twelve minutes of processor time
    python benchmarks/printed_targets.py --seeds 11 12 --kinds poster playing_card --records records.json
    python benchmarks/printed_targets.py --full --json printed_targets.json --markdown page.md --plot plot.png
    python benchmarks/printed_targets.py --negatives 10000

Prints (`print_drawing.py`) and views (`print_views.py`) are drawn by the benchmark itself: nothing of the package's
simulation is in them. Each print gets 24 views in each of two modes: `tracking`, one path with 15 degrees of roll a
frame, and `detection`, independent views with tracking off. Seeds and prints that a change was tuned with are no
evidence for it: take other ones.

- published: poses that go out as unambiguous (`metric`). right, wrong: of those, the rms distance of the four outer
  corners from their true places is at most 10 px, or more. Corners outside the frame count too.
- copies: of the wrong ones, those where the print looks the same as where it is (a symmetry or a period of it).
- flipped: of the right ones, those whose rotation is off by more than 10 degrees: the other planar solution.
- unpublished: a homography without a pose, right / wrong by the same 10 px; of a print that looks the same when it is
  turned and is said to be ambiguous, right when one of the ways that are said is. Reasons are counted with the others.
- p50 px, NEES p50, inside: of the right poses, the median rms corner error, the median squared error of the
  pose in units of its covariance (5.35 is exact), and the share inside the 95 % ellipsoid.
- SIFT, ORB: answers within 10 px / further off, of all frames: cv2 demosaicking, 1000 features, ratio test of 0.75,
  findHomography with RANSAC at 3 px; an answer has 10 inliers or more.
- siblings: both are targets, a view shows one of them: its own pose, the right ones of these, its sibling's pose, and
  both within 10 px of each other.
- negatives: no print is in view, or one of another kind; or the sibling of a print, which alone is a target.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import zlib
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from print_drawing import KINDS, Print, prints
from print_judging import FOUND_PX, RECIPES, Recipe, corner_rms, is_copy, rotation_vector, squared_error
from print_report import markdown_page, summary, write_plot
from print_views import MODES, RAW_PARAMETERS, View, corners_of, developed, empty_views, mapped, views

from imgu_ros.bench.machine import this_machine
from imgu_ros.cli.options import add_parameter_options, parameters_of
from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import ImguError
from imgu_ros.localizer import Localizer
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.result import PoseStatus, ReferenceResult

FULL_SEEDS, FULL_NEGATIVES = (1, 2, 3, 4, 5), 2000


@dataclass(frozen=True)
class Settings:
    """What every print is measured with."""

    parameters: Parameters
    frames: int
    negatives: int
    recipes: bool


@dataclass(frozen=True)
class Outcome:
    """What became of one view.

    Attributes
    ----------
    group, kind, seed, mode, index : which view
    status, pose_status, reason : as the pipeline says
    corner_px : rms error of the homography's corners; None: none found
    nees, rotation_deg : of the pose; None: none published
    copy : the print looks the same at that wrong place
    points, rms_px, confirmed_share : correspondences that agree, their residual, and the share that was confirmed
    origin : of a wrong homography, what began it: `detection`, or `tracking` where a right track went astray
    visible, tilt_deg : of the view
    recipes_px : corner error of each recipe; None: no answer
    """

    group: str
    kind: str
    seed: int
    mode: str
    index: int
    status: str
    pose_status: str
    reason: str
    corner_px: float | None
    nees: float | None
    rotation_deg: float | None
    copy: bool
    points: int
    rms_px: float | None
    confirmed_share: float | None
    origin: str
    visible: float
    tilt_deg: float
    recipes_px: dict[str, float | None]


@dataclass(frozen=True)
class SiblingOutcome:
    """What became of one view of a print whose sibling is a target too; `own` and `other`: published poses.

    `right`: the own pose is right; `same_place`: both are published, their corners within 10 px of each other.
    """

    kind: str
    seed: int
    mode: str
    shown: str
    index: int
    own: bool
    right: bool
    other: bool
    same_place: bool


@dataclass(frozen=True)
class NegativeOutcome:
    """Frames without one print: `empty` of any, with `another` or its `sibling`; how many gave poses, homographies."""

    kind: str
    group: str
    seed: int
    sort: str
    frames: int
    poses: int
    homographies: int


@dataclass(frozen=True)
class Measured:
    """All of one print."""

    outcomes: list[Outcome]
    siblings: list[SiblingOutcome]
    negatives: list[NegativeOutcome]


def measured(kind: str, seed: int, settings: Settings) -> Measured:
    """Measure one print of a kind."""
    cv2.setNumThreads(1)
    (shown,) = prints(seed, [kind])
    outcomes = [outcome for mode in MODES for outcome in _own_views(shown, seed, mode, settings)]
    siblings = [
        outcome
        for mode in MODES
        for other in shown.siblings
        for pair in ((shown, other), (other, shown))
        for outcome in _sibling_views(*pair, seed, mode, settings)
    ]
    return Measured(outcomes, siblings, _negatives(shown, seed, settings))


def _localizer(known: Sequence[Print], mode: str, settings: Settings) -> Localizer:
    """Return a localizer that knows prints.

    Raises
    ------
    ImguError
        If one of them cannot serve as a target.
    """
    parameters = settings.parameters
    if mode == "detection":
        parameters = parameters_from({"tracking.enabled": False}, parameters)
    images = [TargetImage(each.name, each.pixels, each.width_m) for each in known]
    localizer = Localizer(parameters, prepare_references(images, parameters))
    localizer.prepare()
    return localizer


def _own_views(shown: Print, seed: int, mode: str, settings: Settings) -> Iterator[Outcome]:
    try:
        localizer = _localizer([shown], mode, settings)
    except ImguError as error:
        localizer, refused = None, f"not accepted as a target: {error}"
    recipes = {name: Recipe.of(name, shown) for name in RECIPES} if settings.recipes else {}
    origin = ""
    for index, view in enumerate(views(shown, seed, settings.frames, mode)):
        outcome = Outcome(
            shown.group, shown.kind, seed, mode, index, "", "", "", None, None, None, False, 0, None, None, "",
            view.visible, view.tilt_deg, _by_recipes(recipes, view, shown),
        )  # fmt: skip
        if localizer is None:
            yield replace(outcome, status="refused", reason=refused)
            continue
        outcome = judged(outcome, localizer.process(view.frame).first, view, shown)
        if outcome.corner_px is None or outcome.corner_px <= FOUND_PX:
            origin = ""
        elif outcome.status == "detected":
            origin = "detection"
        else:
            origin = origin or "tracking"
        yield replace(outcome, origin=origin)


def judged(outcome: Outcome, result: ReferenceResult, view: View, shown: Print) -> Outcome:
    """Return an outcome with what the pipeline said, compared with the truth."""
    outcome = replace(
        outcome, status=result.status.value, pose_status=result.pose_status.value, reason=result.reason,
        confirmed_share=result.confirmed_share,
    )  # fmt: skip
    if result.homography is None:
        return outcome
    H = result.homography.H
    if result.pose is None:
        H = min((H @ S for S in (np.eye(3), *result.alike)), key=lambda each: corner_rms(each, view.H, shown))
    corner_px = corner_rms(H, view.H, shown)
    outcome = replace(
        outcome,
        corner_px=corner_px,
        copy=corner_px > FOUND_PX and is_copy(H, view.H, shown),
        points=int(result.homography.inliers.sum()),
        rms_px=result.homography.rms_px,
    )
    if result.pose is None:
        return outcome
    pose = result.pose
    return replace(
        outcome,
        nees=squared_error(pose.R, pose.t, pose.covariance, view.R, view.t),
        rotation_deg=math.degrees(float(np.linalg.norm(rotation_vector(view.R @ pose.R.T)))),
    )


def _by_recipes(recipes: dict[str, Recipe], view: View, shown: Print) -> dict[str, float | None]:
    if not recipes:
        return {}
    grey = cv2.cvtColor(developed(view.frame), cv2.COLOR_RGB2GRAY)
    found = {name: recipe.homography(grey) for name, recipe in recipes.items()}
    return {name: None if H is None else corner_rms(H, view.H, shown) for name, H in found.items()}


def _sibling_views(shown: Print, other: Print, seed: int, mode: str, settings: Settings) -> Iterator[SiblingOutcome]:
    try:
        # In the order of their names, whichever is shown.
        localizer = _localizer(sorted((shown, other), key=lambda each: each.name), mode, settings)
    except ImguError:
        return
    for index, view in enumerate(views(shown, seed + 1, settings.frames // 2, mode)):
        results = localizer.process(view.frame).references
        own, wrong = (results[each.name] for each in (shown, other))
        at_one_place = False
        if own.pose is not None and wrong.pose is not None:
            a, b = (mapped(each.homography.H, corners_of(shown)) for each in (own, wrong))
            at_one_place = float(np.sqrt(((a - b) ** 2).sum(axis=1).mean())) <= FOUND_PX
        right = own.pose is not None and corner_rms(own.homography.H, view.H, shown) <= FOUND_PX
        yield SiblingOutcome(
            shown.kind, seed, mode, shown.name, index, own.pose is not None, right, wrong.pose is not None, at_one_place
        )


def _negatives(shown: Print, seed: int, settings: Settings) -> list[NegativeOutcome]:
    if settings.negatives == 0:
        return []
    try:
        localizer = _localizer([shown], "detection", settings)
    except ImguError:
        return []
    own_seed = zlib.crc32(f"{shown.kind} {seed}".encode())
    rng = np.random.default_rng(own_seed)
    sorts = [
        ("empty", empty_views(own_seed, settings.negatives)),
        ("another", _other_views(shown, seed, rng, settings.negatives)),
        *(("sibling", views(other, own_seed, settings.frames, "detection")) for other in shown.siblings),
    ]
    made = []
    for sort, frames in sorts:
        results = [localizer.process(view.frame).first for view in frames]
        poses = sum(r.pose_status is PoseStatus.METRIC for r in results)
        homographies = sum(r.homography is not None for r in results)
        made.append(NegativeOutcome(shown.kind, shown.group, seed, sort, len(results), poses, homographies))
    return made


def _other_views(shown: Print, seed: int, rng: np.random.Generator, count: int) -> Iterator[View]:
    """Yield views of prints of other kinds, a few of each, and of the same kind drawn by another seed."""
    few = 4
    for first in range(0, count, few):
        kind = str(rng.choice(KINDS))
        # A print of the same kind is another one when its seed is.
        (other,) = prints(seed + 1000 + int(rng.integers(1000)), [kind])
        if np.array_equal(other.pixels, shown.pixels):
            continue
        yield from views(other, int(rng.integers(1 << 30)), min(few, count - first), "detection")


def run(kinds: Sequence[str], seeds: Sequence[int], settings: Settings, jobs: int) -> Measured:
    """Measure the kinds of all seeds in several processes, printing what is done."""
    tasks = [(kind, seed) for seed in seeds for kind in kinds]
    everything = Measured([], [], [])
    with ProcessPoolExecutor(jobs) as pool:
        waiting = [pool.submit(measured, kind, seed, settings) for kind, seed in tasks]
        for (kind, seed), done in zip(tasks, waiting, strict=True):
            one = done.result()
            for name in ("outcomes", "siblings", "negatives"):
                getattr(everything, name).extend(getattr(one, name))
            right = sum(o.nees is not None and o.corner_px <= FOUND_PX for o in one.outcomes)
            wrong = sum(o.nees is not None and o.corner_px > FOUND_PX for o in one.outcomes)
            poses = sum(n.poses for n in one.negatives)
            print(
                f"{kind:18} {seed:4}: {right:3} right, {wrong:3} wrong of {len(one.outcomes)}; {poses} of none",
                flush=True,
            )
    return everything


def main() -> None:
    """Measure, print, and store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", help="of prints and views (default 1; --full: 1 to 5)")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS, metavar="KIND", help="(default all)")
    parser.add_argument("--frames", type=int, default=24, help="of each print and mode (default 24)")
    parser.add_argument("--negatives", type=int, help="frames of each sort in all (default 192; --full: 2000)")
    parser.add_argument("--no-recipes", action="store_true", help="without SIFT and ORB")
    parser.add_argument("--full", action="store_true", help="five seeds and more negatives")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes (default one a core)")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--records", type=Path, help="write what became of every view to this file")
    parser.add_argument("--markdown", type=Path, help="write a page with the tables to this file")
    parser.add_argument("--plot", type=Path, help="draw the figures into this PNG file")
    add_parameter_options(parser)
    arguments = parser.parse_args()
    seeds = arguments.seeds or (FULL_SEEDS if arguments.full else (1,))
    negatives = arguments.negatives
    if negatives is None:
        negatives = FULL_NEGATIVES if arguments.full else 192
    settings = Settings(
        parameters_of(arguments, RAW_PARAMETERS),
        arguments.frames,
        math.ceil(negatives / (len(arguments.kinds) * len(seeds))),
        not arguments.no_recipes,
    )
    machine = this_machine()
    everything = run(arguments.kinds, seeds, settings, arguments.jobs)
    figures = {"machine": asdict(machine), "seeds": list(seeds), "frames": settings.frames}
    figures |= summary(everything.outcomes, everything.siblings, everything.negatives)
    page = markdown_page(figures, __doc__ or "")
    print(page.partition("\n| class")[2] and "| class" + page.partition("\n| class")[2])
    for path, text in (
        (arguments.json, json.dumps(figures, indent=1)),
        (arguments.records, json.dumps(asdict(everything))),
        (arguments.markdown, page),
    ):
        if path:
            path.write_text(text.rstrip("\n") + "\n", encoding="utf-8")
    if arguments.plot:
        write_plot(arguments.plot, figures)


if __name__ == "__main__":
    main()
