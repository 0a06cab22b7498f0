# SPDX-License-Identifier: Apache-2.0
"""Every valid combination of the pipeline's methods, and every change of one word from the default.

    python benchmarks/combinations.py --quick --markdown docs/one-word-changes.md
    python benchmarks/combinations.py --json combinations.json

Each frame is searched for the target anew (no tracking), with and without the alignment of patches that follows the
search (`refinement.enabled`). Frames are simulated: 8-bit Bayer, noise, the whole path: a full roll, 35 degrees of
tilt, distances from 1 to 2.4. Times are of the whole frame, alignment included, on one thread, in CPU time; each frame
goes through the default chain right after, and the ratio is the median over the frames. Without --quick: detector x
descriptor x metric x sampler x refinement x kernel, as far as they make sense.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # read when numpy is imported

import cv2
import numpy as np

from imgu_ros.config.parameters import declaration
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import ParameterError
from imgu_ros.localizer import Localizer
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.simulate.sequence import SimulatedFrame, Simulation, default_targets, simulate_sequence
from imgu_ros.simulate.truth import corner_error

SIZES = ((1280, 720), (640, 480))
AXES = (
    "keypoints.detector",
    "descriptor.kind",
    "matching.metric",
    "homography.sampler",
    "homography.refine",
    "pyramid.kernel",
)
SEED = 3
BASE: dict[str, object] = {"tracking.enabled": False}

#: One word away from the default, or two where a metric needs its descriptor; and when one would choose it.
CHANGES: tuple[tuple[str, str], ...] = (
    ("demosaic.method:=edge_aware", "sharper colour than bilinear at little cost"),
    ("demosaic.method:=malvar", "colour for people to look at, live"),
    ("demosaic.method:=hamilton_adams", "fine detail in colour, still quick"),
    ("demosaic.method:=menon", "the best colour of saturated, correlated scenes, offline"),
    ("demosaic.method:=residual", "the best colour of any scene, offline"),
    ("preprocess.equalisation:=global", "a metric that knows no contrast (`ssd`), or light that changes as a whole"),
    ("preprocess.equalisation:=clahe", "shadow and sun in one picture; infrared"),
    ("preprocess.edges:=strength", "contrast that turns round between picture and frame: infrared, back light"),
    ("preprocess.threshold:=otsu", "black and white targets in even light"),
    ("preprocess.threshold:=fixed", "as otsu, at a `preprocess.threshold_value` that fits; 128 is too bright here"),
    ("pyramid.kind:=fine", "scales in between: keypoints lie nearer to where they belong"),
    ("pyramid.kind:=laplacian", "slow changes of light across the picture"),
    ("pyramid.kernel:=discrete", "scale space by the book: its kernels can be composed exactly"),
    ("pyramid.kernel:=recursive", "strong `preprocess.smoothing_px`: its cost is the same at every width"),
    ("keypoints.detector:=fast", "corners of drawings and machines"),
    ("keypoints.detector:=harris", "the corners that are found again best, where time allows"),
    ("keypoints.detector:=moravec", "to compare with history"),
    ("keypoints.detector:=dog", "few corners: blobs of every size, placed to a fraction of a pixel"),
    ("keypoints.detector:=mser", "few corners: even regions, such as letters and signs"),
    ("descriptor.kind:=sift", "when ORB finds too little, and time allows"),
    ("descriptor.kind:=rootsift", "as SIFT, less swayed by single strong gradients"),
    ("descriptor.kind:=brief", "an upright camera: more is told apart when nothing turns"),
    ("descriptor.kind:=patch", "to see what is compared"),
    ("descriptor.kind:=sift matching.metric:=cosine", "as euclidean, with a milder ratio test"),
    ("descriptor.kind:=rootsift matching.metric:=cosine", "as euclidean, with a milder ratio test"),
    ("descriptor.kind:=patch matching.metric:=zmssd", "light that gets brighter, but has no more contrast"),
    ("descriptor.kind:=patch matching.metric:=ssd", "light that never changes, a target taken by the same camera"),
    ("descriptor.kind:=patch matching.metric:=ssd preprocess.equalisation:=global", "ssd in a new light"),
    ("matching.mutual:=false", "a target that repeats itself: more matches, more of them wrong"),
    ("matching.guided:=true", "more matches for the price of a second look"),
    ("homography.sampler:=uniform", "when the quotient of distances says nothing about a match"),
    ("homography.score:=biweight", "few or oblique matches"),
    ("homography.error:=algebraic", "speed: the linear fit of the inliers stays"),
    ("homography.error:=transfer", "an exact target picture: all noise is the frame's"),
    ("homography.error:=symmetric", "noise in both pictures alike"),
    ("homography.error:=reprojection", "the most likely homography by definition; Sampson's is nearly as good"),
    ("homography.refine:=none", "speed: the linear fit of the inliers stays"),
    ("homography.refine:=steepest_descent", "to compare: the slowest of the three"),
    ("homography.refine:=gauss_newton", "to compare: as good where the start is"),
    ("refinement.enabled:=false", "a target that is not as flat or not as printed as its picture says"),
)  # fmt: skip


@dataclass(frozen=True)
class Figures:
    """What a combination gave: frames found, corner errors of those found (px), and its time over the default's."""

    values: dict[str, object]
    size: str
    frames: int
    found: int
    search_px: list[float]
    aligned_px: list[float]
    ms: float
    ratio: float


@dataclass(frozen=True, eq=False)
class Scene:
    """Frames of one size with the target's picture, and the default chain."""

    frames: tuple[SimulatedFrame, ...]
    picture: tuple[TargetImage, ...]
    default: Localizer

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the frames."""
        height, width = self.frames[0].frame.image.pixels.shape[:2]
        return width, height


def make_scene(size: tuple[int, int], count: int) -> Scene:
    """Simulate `count` frames that go through the whole path."""
    picture = default_targets(1, SEED)
    simulation = Simulation(width=size[0], height=size[1], frames=count, seed=SEED)
    parameters = parameters_from(BASE)
    return Scene(
        tuple(simulate_sequence(simulation, picture)),
        picture,
        Localizer(parameters, prepare_references(picture, parameters)),
    )


def measured(scene: Scene, values: dict[str, object], targets: tuple[Reference, ...]) -> Figures:
    """Search every frame for the target, with and without alignment."""
    aligned = Localizer(parameters_from({**BASE, **values}), targets)
    plain = Localizer(parameters_from({**BASE, **values, "refinement.enabled": False}), targets)
    found, ms, ratios = [], [], []
    errors: tuple[list[float], list[float]] = ([], [])
    for simulated in scene.frames:
        mine, usual = (_cpu_ms(chain, simulated) for chain in (aligned, scene.default))
        ms.append(mine)
        ratios.append(mine / usual)
        for chain, listed in ((plain, errors[0]), (aligned, errors[1])):
            homography = chain.process(simulated.frame).first.homography
            if homography is not None:
                truth = next(t for t in simulated.truths if t.target == targets[0].name)
                listed.append(corner_error(homography.H, truth.H, targets[0].size, scene.size))
            if chain is plain:
                found.append(homography is not None)
    size = f"{scene.size[0]}x{scene.size[1]}"
    return Figures(values, size, len(found), sum(found), *errors, float(np.median(ms)), float(np.median(ratios)))


def _cpu_ms(chain: Localizer, simulated: SimulatedFrame) -> float:
    start = time.process_time_ns()
    chain.process(simulated.frame)
    return (time.process_time_ns() - start) / 1e6


def one_word_changes(counts: int) -> Iterator[Figures]:
    """Measure the default and each change on each size."""
    for size in SIZES:
        scene = make_scene(size, counts)
        for change in ("", *(text for text, _ in CHANGES)):
            values = dict(_assigned(word) for word in change.split())
            targets = prepare_references(scene.picture, parameters_from({**BASE, **values}))
            yield measured(scene, values, targets)


def _assigned(word: str) -> tuple[str, object]:
    name, _, value = word.partition(":=")
    return name, {"true": True, "false": False}.get(value, value)


def all_combinations(count: int) -> Iterator[Figures]:
    """Measure every valid combination on the smaller size; the target is prepared once for those that share it."""
    scene = make_scene(SIZES[1], count)
    prepared: dict[tuple[object, ...], tuple[Reference, ...]] = {}
    for chosen in itertools.product(*(declaration(name).choices for name in AXES)):
        values: dict[str, object] = dict(zip(AXES, chosen, strict=True))
        try:
            parameters = parameters_from({**BASE, **values})
        except ParameterError:
            continue
        if values["matching.metric"] == "auto":  # another name for one of the others
            continue
        key = tuple(values[name] for name in AXES if not name.startswith("homography."))
        if key not in prepared:
            prepared[key] = prepare_references(scene.picture, parameters)
        yield measured(scene, values, prepared[key])


def changes_table(figures: Sequence[Figures]) -> str:
    """Return the one-word changes as a table in Markdown, both sizes side by side."""
    sizes = list(dict.fromkeys(f.size for f in figures))
    head = (
        "| change | "
        + " | ".join(f"{s}: found | search, px | aligned, px | time" for s in sizes)
        + " | choose it for |"
    )
    lines = [head, "|---|" + "---:|---:|---:|---:|" * len(sizes) + "---|"]
    when = dict(CHANGES)
    for row in zip(*([f for f in figures if f.size == s] for s in sizes), strict=True):
        change = " ".join(f"{name}:={str(value).lower()}" for name, value in row[0].values.items())
        cells = " | ".join(_cells(f) for f in row)
        lines.append(f"| {f'`{change}`' if change else 'default'} | {cells} | {when.get(change, '')} |")
    return "\n".join(lines)


def _cells(f: Figures) -> str:
    aligned = "" if f.values.get("refinement.enabled") is False else _percentiles(f.aligned_px)
    return f"{f.found}/{f.frames} | {_percentiles(f.search_px)} | {aligned} | {f.ratio:.2f}"


def _percentiles(errors: Sequence[float]) -> str:
    if not errors:
        return ""
    return " / ".join(f"{np.percentile(errors, p):.2f}" for p in (50, 95))


def combinations_table(figures: Sequence[Figures]) -> str:
    """Return detector x descriptor x metric as a table in Markdown, with the range over the other axes."""
    lines = [
        "| detector | descriptor | metric | found | search p50, px | aligned p50, px | time |",
        "|---|" * 1 + "---|---|---:|---:|---:|---:|",
    ]
    groups: dict[tuple[object, ...], list[Figures]] = {}
    for f in figures:
        groups.setdefault(tuple(f.values[name] for name in AXES[:3]), []).append(f)
    for key, group in groups.items():
        cells = [
            _range([100 * f.found / f.frames for f in group], 0) + " %",
            _range([float(np.median(f.search_px)) for f in group if f.search_px], 2),
            _range([float(np.median(f.aligned_px)) for f in group if f.aligned_px], 3),
            _range([f.ratio for f in group], 2),
        ]
        lines.append(f"| {' | '.join(map(str, key))} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _range(numbers: Sequence[float], digits: int) -> str:
    return f"{min(numbers):.{digits}f} to {max(numbers):.{digits}f}" if numbers else ""


PAGE = """# One word away from the default

What changes when one parameter is set to another of its words: frames in which the target is found, corner error
(p50 / p95 over the frames found) of the search alone and after the alignment of patches, and CPU time over the
default's.

{table}

{count} simulated frames of each size, each searched anew: 8-bit Bayer with noise, a full roll, 35 degrees of tilt, a
zoom of 2.4; seed {seed}; OpenCV {opencv}, one thread. A tracked frame makes neither pyramid nor keypoints: of all
these, `demosaic.method` alone costs anything there. Alignment starts wherever the search ends and works on the picture
as it came: as long as the target is found, it hides most differences.

What makes no sense together is refused at start, with the reason: a metric that does not fit the descriptor; `dog` or
`mser` on bands (`pyramid.kind` `laplacian`), on edges or on a thresholded picture; edges of a thresholded picture.
Everything else goes with everything: the test suite runs every pair of choices, and `python benchmarks/combinations.py`
all {all} combinations of detector, descriptor, metric, sampler, refinement and kernel.

Made by `python benchmarks/combinations.py --quick --markdown docs/one-word-changes.md`.
"""


def main() -> None:
    """Print the table; write it as Markdown and JSON when asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="only changes of one word from the default")
    parser.add_argument("--frames", type=int, help="frames of each size; 12, or 3 for all combinations")
    parser.add_argument("--markdown", type=Path, help="write the page of the one-word changes to this file")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    arguments = parser.parse_args()
    if arguments.markdown and not arguments.quick:
        parser.error("--markdown: the page is of the one-word changes; need --quick")
    cv2.setNumThreads(1)
    count = arguments.frames or (12 if arguments.quick else 3)
    figures = []
    for f in one_word_changes(count) if arguments.quick else all_combinations(count):
        figures.append(f)
        words = " ".join(f"{name}:={value}" for name, value in f.values.items()) or "default"
        print(f"{f.size} {words}: {_cells(f)}", flush=True)
    text = changes_table(figures) if arguments.quick else combinations_table(figures)
    print(text)
    if arguments.markdown:
        page = PAGE.format(table=text, count=count, seed=SEED, opencv=cv2.__version__, all=_count_of_combinations())
        arguments.markdown.write_text(page, encoding="utf-8")
    if arguments.json:
        arguments.json.write_text(json.dumps([asdict(f) for f in figures], indent=1) + "\n", encoding="utf-8")


def _count_of_combinations() -> int:
    count = 0
    for chosen in itertools.product(*(declaration(name).choices for name in AXES)):
        try:
            parameters_from(dict(zip(AXES, chosen, strict=True)))
        except ParameterError:
            continue
        count += "auto" not in chosen
    return count


if __name__ == "__main__":
    main()
