# SPDX-License-Identifier: Apache-2.0
"""What `imgu bench` measures: suites of runs, from the table of a minute or two to everything."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np

from imgu_ros.arguments import shown_value
from imgu_ros.bench.figures import Figures, figures
from imgu_ros.bench.measuring import MeasurementPlan, measure, measure_in_turn
from imgu_ros.bench.memory import PeakMemory, peak_memory, resident_mb
from imgu_ros.bench.recipes import DETECTION, METHODS, ORB, SIFT, TRACKING, check_method, make_method
from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import ParameterError
from imgu_ros.reference.templates import TargetImage
from imgu_ros.simulate.conditions import CONDITIONS, PLAIN, Condition
from imgu_ros.simulate.negatives import absent_frames
from imgu_ros.simulate.sequence import SimulatedFrame, Simulation, simulate_sequence
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.simulate.trials import LAP_FRAMES, WIDTH_M, Trial, known_targets, trial_batches
from imgu_ros.types import Choice, Image

_MOST = 1_000_000
SEQUENCE, SINGLE, ABSENT = "sequence", "single", "absent"
IN_VIEW = 3
KNOWN = (IN_VIEW, 100)
_BATCH = 24
_RESOLUTIONS = ((320, 240), (640, 480), (1280, 720), (1920, 1080), (2560, 1440), (3840, 2160))
_RESOLUTION_FRAMES = 12


class Suite(Choice):
    """Names of the suites."""

    TABLE = "table"
    TRACKING = "tracking"
    DETECTION = "detection"
    ROBUSTNESS = "robustness"
    NEGATIVES = "negatives"
    TARGETS = "targets"
    RESOLUTION = "resolution"
    LENGTH = "length"
    ALL = "all"


@dataclass(frozen=True, slots=True, eq=False)
class Options:
    """What is measured, and how thoroughly.

    Attributes
    ----------
    sizes : width, height of the frames, px, even
    frames : of every sequence, and as many single frames
    seeds : one run for each: pictures, paths and noise differ
    conditions : rows of the robustness table
    methods : who is measured, of those that a suite compares
    sift_every : SIFT sees every n-th frame of a sequence only: it takes most of the time
    negatives : frames without a target
    photographs : what those frames show, (H, W, 3) uint8 RGB
    length_frames : frames over which memory is to stay flat
    parameters : the pipeline's
    """

    sizes: tuple[tuple[int, int], ...] = ((640, 480), (1280, 720), (1920, 1080))
    frames: int = LAP_FRAMES
    seeds: tuple[int, ...] = (0,)
    conditions: tuple[Condition, ...] = CONDITIONS
    methods: tuple[str, ...] = tuple(METHODS)
    sift_every: int = 4
    negatives: int = 500
    photographs: tuple[Image, ...] = ()
    length_frames: int = 2000
    parameters: Parameters = field(default_factory=Parameters)


@dataclass(frozen=True, slots=True)
class Growth:
    """Memory over a long sequence, MB: median over the 10th to 15th percent of the frames and over the last five."""

    size: str
    frames: int
    early_mb: float
    late_mb: float


#: What a suite yields, one after the other, as it is measured.
Row = Figures | PeakMemory | Growth


def run_suite(suite: Suite | str, options: Options) -> Iterator[Row]:
    """Measure a suite; every row is yielded as soon as it is known.

    Raises
    ------
    ParameterError
        If the options are impossible.
    """
    check_options(options)
    yield from _SUITES[Suite(suite)](options)


def check_options(options: Options) -> None:
    """Raise ParameterError when the options are impossible."""
    for width, height in options.sizes:
        if not (64 <= width <= 16384 and 64 <= height <= 16384) or width % 2 or height % 2:
            raise ParameterError(f"size: {width}x{height}; need even numbers from 64 to 16384")
    for name, count in (
        ("frames", options.frames),
        ("SIFT's every n-th frame", options.sift_every),
        ("negatives", options.negatives),
        ("frames of the long sequence", options.length_frames),
    ):
        if not 1 <= count <= _MOST:
            raise ParameterError(f"{name}: {shown_value(count)}; need 1 to {_MOST}")
    for name in options.methods:
        check_method(name)
    if not (options.sizes and options.seeds and options.conditions and options.methods):
        raise ParameterError("sizes, seeds, conditions, methods: one is empty; need at least one of each")
    if min(options.seeds) < 0:
        raise ParameterError(f"seed: {min(options.seeds)}; need 0 or more")


def _table(options: Options) -> Iterator[Row]:
    yield from _run(PLAIN, options.sizes, False, (TRACKING, DETECTION, ORB, SIFT), options)
    for size in options.sizes:
        for name in options.methods:
            yield peak_memory(name, *size)


def _tracking(options: Options) -> Iterator[Row]:
    for size in options.sizes:
        for condition in options.conditions:
            yield from _run(condition, (size,), False, (TRACKING, ORB, SIFT), options)


def _detection(options: Options) -> Iterator[Row]:
    for size in options.sizes:
        for condition in options.conditions:
            yield from _run(condition, (size,), True, (DETECTION, ORB, SIFT), options)


def _run(
    condition: Condition,
    sizes: Sequence[tuple[int, int]],
    unrelated: bool,
    names: Sequence[str],
    options: Options,
) -> Iterator[Figures]:
    """Yield the figures of each size; the sizes are measured in turn, so that their times can be compared."""
    names = [name for name in names if name in options.methods]
    if not names:
        return
    # Of single frames none leads to another: SIFT's share is to be of all of them.
    every = {} if unrelated else {SIFT: options.sift_every}
    runs = []
    for seed in options.seeds:
        shows = []
        for size in sizes:
            trial = Trial(condition, *size, options.frames, seed, unrelated)
            targets = known_targets(trial)
            methods = [make_method(name, targets, options.parameters) for name in names]
            shows.append(MeasurementPlan(methods, trial_batches(trial, _BATCH), targets, every))
        runs.append(measure_in_turn(shows))
    for number, size in enumerate(sizes):
        for name in names:
            of_size = [run[number] for run in runs]
            yield figures(condition.name, SINGLE if unrelated else SEQUENCE, _text(size), name, of_size)


def _negatives(options: Options) -> Iterator[Row]:
    # Without photographs of the user's, textures that are none of the targets: much of nature's statistics.
    photographs = options.photographs or tuple(procedural_texture(800, 600, 4000 + i) for i in range(8))
    names = [name for name in (TRACKING, DETECTION, ORB) if name in options.methods]
    for size in options.sizes if names else ():
        runs = []
        for seed in options.seeds:
            targets = known_targets(Trial(PLAIN, seed=seed))
            methods = [make_method(name, targets, options.parameters) for name in names]
            frames = absent_frames(photographs, targets[0].pixels, size, options.negatives, seed)
            runs.append(measure(MeasurementPlan(methods, _batches(frames), targets)))
        for name in names:
            yield figures("photographs" if options.photographs else "textures", ABSENT, _text(size), name, runs)


def _targets(options: Options) -> Iterator[Row]:
    pictures = [
        TargetImage(f"target_{i}", procedural_texture(800, 600, 100 * (1 + options.seeds[0]) + i), WIDTH_M)
        for i in range(max(KNOWN))
    ]
    in_view = pictures[:: len(pictures) // IN_VIEW][:IN_VIEW]
    rest = [p for p in pictures if not any(p is q for q in in_view)]
    for size in options.sizes:
        for known in KNOWN:
            # Those in view lie anywhere in the list.
            targets = [*rest[: known - IN_VIEW], *in_view]
            order = np.random.default_rng(known).permutation(known)
            targets = [targets[i] for i in order]
            # A recipe with a hundred targets takes a hundred times the matching: nobody waits for that.
            names = [TRACKING, DETECTION, *([ORB] if known == IN_VIEW else [])]
            names = [name for name in names if name in options.methods]
            if not names:
                return
            methods = [make_method(name, targets, options.parameters) for name in names]
            simulation = Simulation(*size, max(options.frames, LAP_FRAMES), 30.0, options.seeds[0])
            frames = islice(simulate_sequence(simulation, in_view), options.frames)
            measured = measure(MeasurementPlan(methods, _batches(frames), targets))
            for name in names:
                yield figures(f"known-{known}", SEQUENCE, _text(size), name, [measured])


def _resolution(options: Options) -> Iterator[Row]:
    short = replace(options, frames=min(options.frames, _RESOLUTION_FRAMES))
    yield from _run(PLAIN, _RESOLUTIONS, False, (TRACKING, DETECTION, ORB), short)


def _length(options: Options) -> Iterator[Row]:
    for size in options.sizes:
        trial = Trial(PLAIN, *size, min(LAP_FRAMES, options.length_frames), options.seeds[0])
        lap = [simulated for batch in trial_batches(trial, _BATCH) for simulated in batch]
        method = make_method(TRACKING, known_targets(trial), options.parameters)
        period = lap[-1].frame.stamp_ns - lap[0].frame.stamp_ns + 33_333_333
        sizes_mb = []
        for index in range(options.length_frames):
            rounds, place = divmod(index, len(lap))
            frame = lap[place].frame
            method.answer(replace(frame, stamp_ns=frame.stamp_ns + rounds * period))
            sizes_mb.append(resident_mb())
        n = len(sizes_mb)
        early, late = sizes_mb[n // 10 : max(n * 15 // 100, n // 10 + 1)], sizes_mb[-max(n // 20, 1) :]
        yield Growth(_text(size), n, float(np.median(early)), float(np.median(late)))


def _several(*names: Suite) -> Callable[[Options], Iterator[Row]]:
    def run(options: Options) -> Iterator[Row]:
        for name in names:
            yield from _SUITES[name](options)

    return run


_SUITES: dict[Suite, Callable[[Options], Iterator[Row]]] = {
    Suite.TABLE: _table,
    Suite.TRACKING: _tracking,
    Suite.DETECTION: _detection,
    Suite.ROBUSTNESS: _several(Suite.TRACKING, Suite.DETECTION),
    Suite.NEGATIVES: _negatives,
    Suite.TARGETS: _targets,
    Suite.RESOLUTION: _resolution,
    Suite.LENGTH: _length,
    Suite.ALL: _several(Suite.TABLE, Suite.ROBUSTNESS, Suite.NEGATIVES, Suite.TARGETS, Suite.RESOLUTION, Suite.LENGTH),
}


def _batches(frames: Iterable[SimulatedFrame]) -> Iterator[list[SimulatedFrame]]:
    source = iter(frames)
    while batch := list(islice(source, _BATCH)):
        yield batch


def _text(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"
