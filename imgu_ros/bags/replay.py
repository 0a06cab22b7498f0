"""Run the chain over a recorded bag, offline: frames.csv, poses, a results bag, a summary and a report."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from itertools import chain as chained
from pathlib import Path

from imgu_ros.bags.background import Background
from imgu_ros.bags.frame_source import FrameSource
from imgu_ros.bags.output_folder import check_output_folder, prepare_output_folder
from imgu_ros.bags.prefetch import Prefetch
from imgu_ros.bags.read_ahead import ReadFrame, read_ahead, size_of
from imgu_ros.bags.reading import open_bag
from imgu_ros.bags.reasons import Reasons
from imgu_ros.bags.result_files import ResultFiles, Written
from imgu_ros.bags.results_bag import checked_record
from imgu_ros.bags.switching import quick_thread_switches
from imgu_ros.codec.results import needs_keypoints
from imgu_ros.errors import BagError, ParameterError
from imgu_ros.files.target_images import load_target_images
from imgu_ros.parameter_values import parameter_values
from imgu_ros.params import Parameters
from imgu_ros.perception.chain import Chain
from imgu_ros.perception.frame import Frame
from imgu_ros.perception.result import Result, Status, TargetResult
from imgu_ros.perception.targets import Target, prepare_targets
from imgu_ros.report.accuracy import TruthComparison
from imgu_ros.report.html import write_report
from imgu_ros.report.samples import Sample
from imgu_ros.report.summary import (
    Source,
    Summary,
    input_rate_hz,
    percentiles,
    stage_percentiles,
    target_summaries,
    write_summary,
)
from imgu_ros.report.table import FrameTable, read_frame_table
from imgu_ros.report.versions import versions
from imgu_ros.simulate.truth import Truth, read_truth

#: Of pictures that are read and developed and wait for the chain.
_AHEAD_BYTES = 16_000_000


def replay(
    bags: Sequence[Path],
    out: Path,
    parameters: Parameters,
    *,
    truth: Path | None = None,
    record: Sequence[str] = (),
    overwrite: bool = False,
    on_progress: Callable[[int, int | None], None] = lambda done, total: None,
    on_warning: Callable[[str], None] = lambda text: None,
) -> Summary:
    """Run the chain over one image topic of a bag and write the results into `out`.

    The same bag, parameters and seed give the same files, but for times. Memory does not depend on the length of the
    bag until the report is drawn, which takes about 250 bytes a frame and target.

    Parameters
    ----------
    bags : paths of one recording
    out : folder for the results; see `docs/interfaces.md` for what is written
    parameters : all parameters; `targets.images` must name at least one
    truth : truth file; the report then tells the errors
    record : outputs to write into the results bag beside those that always are
    overwrite : replace the results of an earlier replay in `out`
    on_progress : called after each frame with the number of frames done and, when it is known, of all
    on_warning : called once for each thing the user should know

    Raises
    ------
    ParameterError, ShapeError, FileError
        If parameters, targets, the truth file or the output folder are unusable.
    BagError
        If the bag cannot be read, has no image topic, or not one frame in it could be decoded.
    """
    checked_record(record)
    truths = () if truth is None else read_truth(truth)
    check_output_folder(out, overwrite=overwrite, inputs=bags)
    warnings = _Warnings(on_warning)
    with open_bag(bags) as bag:
        if not parameters.targets.images:
            raise ParameterError("targets.images: none; need at least one target's picture, -p targets.images:=[FILE]")
        targets = prepare_targets(load_target_images(parameters.targets), parameters)
        warnings.add(bag.warnings)
        source = FrameSource(bag, parameters)
        warnings.add(bag.warnings, source.warnings)
        with closing(Prefetch(read_ahead(bag, source, parameters), size_of, _AHEAD_BYTES)) as ahead:
            frames = iter(ahead)
            first = next(frames, None)
            if first is None:
                warnings.add(bag.warnings, source.warnings)
                raise BagError(f"{source.image_topic.name}: no image in the bag can be read; need at least one")
            warnings.add(first.warnings)
            prepare_output_folder(out, overwrite=overwrite, inputs=bags)
            run = _Run(source.image_topic.count, targets, parameters, out, tuple(record), warnings, on_progress)
            seen = run.over(chained([first], frames))
        warnings.add(bag.warnings, source.warnings)
    described = Source(
        bags=tuple(str(path) for path in bags),
        truth="" if truth is None else str(truth),
        image_topic=source.image_topic.name,
        camera_info_topic="" if source.camera_info_topic is None else source.camera_info_topic.name,
        image_size=seen.image_size_text,
        layout=seen.layout_text,
    )
    return _reported(out, seen, described, truths, targets, parameters, warnings)


@dataclass(slots=True, eq=False)
class _Seen:
    """What is remembered of the frames that passed: nothing that grows with their number."""

    frames: int = 0
    rejected: int = 0
    first_reason: str = ""
    first: Frame | None = None
    seconds: float = 0.0
    reasons: Reasons = field(default_factory=Reasons)
    samples: tuple[Sample, ...] = ()

    @property
    def image_size(self) -> tuple[int, int]:
        return (0, 0) if self.first is None else (self.first.image.pixels.shape[1], self.first.image.pixels.shape[0])

    @property
    def image_size_text(self) -> str:
        return "" if self.first is None else f"{self.image_size[0]} x {self.image_size[1]}"

    @property
    def layout_text(self) -> str:
        if self.first is None:
            return ""
        image = self.first.image
        pattern = f" {image.layout.pattern.value}" if image.layout.pattern else ""
        return f"{image.layout.color.value}{pattern} {image.pixels.dtype.name}"


class _Warnings:
    """Passes on each warning once, and keeps all in order."""

    def __init__(self, on_warning: Callable[[str], None]) -> None:
        self._on_warning = on_warning
        self._said: dict[str, None] = {}

    def add(self, *groups: Sequence[str]) -> None:
        for text in chained(*groups):
            if text not in self._said:
                self._said[text] = None
                self._on_warning(text)

    def listed(self) -> tuple[str, ...]:
        return tuple(self._said)


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """One pass over the frames.

    Three threads work at once, each on another frame: one reads and develops, this one runs the chain, one writes.
    """

    total: int
    targets: tuple[Target, ...]
    parameters: Parameters
    out: Path
    record: tuple[str, ...]
    warnings: _Warnings
    on_progress: Callable[[int, int | None], None]

    def over(self, frames: Iterator[ReadFrame]) -> _Seen:
        seen = _Seen()
        names = [target.name for target in self.targets]
        worker = Chain(self.parameters, self.targets)
        with_keypoints = needs_keypoints(self.record)
        start = time.monotonic()
        with ExitStack() as stack:
            stack.enter_context(quick_thread_switches())
            files = stack.enter_context(ResultFiles(self.out, self.parameters, names, self.record, self.total))
            behind = stack.enter_context(Background(files.write))
            for read in frames:
                result = (
                    _rejected(read, names)
                    if read.development is None
                    else worker.process(read.frame, with_keypoints, read.development)
                )
                behind.put(Written(result, read.time_ns))
                self._remember(seen, result)
                self.on_progress(seen.frames, self.total or None)
                self.warnings.add(read.warnings)
        seen.samples = files.samples.chosen()
        seen.seconds = time.monotonic() - start
        return seen

    def _remember(self, seen: _Seen, result: Result) -> None:
        seen.frames += 1
        if result.reason:
            seen.rejected += 1
            seen.first_reason = seen.first_reason or result.reason
            if seen.reasons.add(Status.REJECTED.value, result.reason):
                self.warnings.add([f"rejected: {result.reason}"])
            return
        if seen.first is None:
            seen.first = result.frame
        for target in result.targets:
            if target.reason:
                status = target.pose_status if target.status.found else target.status
                seen.reasons.add(status.value, target.reason)


def _rejected(read: ReadFrame, names: Sequence[str]) -> Result:
    targets = [TargetResult(name, i, Status.REJECTED, reason=read.reason) for i, name in enumerate(names)]
    return Result(read.frame, tuple(targets), reason=read.reason)


def _reported(
    out: Path,
    seen: _Seen,
    source: Source,
    truths: Sequence[Truth],
    targets: Sequence[Target],
    parameters: Parameters,
    warnings: _Warnings,
) -> Summary:
    comparison = None
    if truths and seen.first is not None:
        sizes = {target.name: target.size for target in targets}
        comparison = TruthComparison(truths, sizes, seen.image_size, seen.first.camera)
    table = read_frame_table(out / "frames.csv", comparison)
    if comparison is not None and not comparison.compared:
        names = ", ".join(sorted({truth.target for truth in truths}))
        warnings.add([f"{source.truth}: has no stamp and target of this bag (its targets: {names}); no errors known"])
    summary = _summary(table, seen, source, parameters, warnings)
    write_summary(out / "summary.json", summary)
    write_report(out / "report.html", table, summary, seen.samples)
    if seen.rejected == seen.frames:
        raise BagError(f"{source.image_topic}: not one of {seen.frames} frames could be read: {seen.first_reason}")
    return summary


def _summary(table: FrameTable, seen: _Seen, source: Source, parameters: Parameters, warnings: _Warnings) -> Summary:
    return Summary(
        frames=seen.frames,
        rejected=seen.rejected,
        rate_in_hz=input_rate_hz(table),
        targets=target_summaries(table),
        reasons=tuple(seen.reasons.counted()),
        warnings=warnings.listed(),
        source=source,
        frames_per_s=seen.frames / max(seen.seconds, 1e-9),
        seconds=seen.seconds,
        total_ms=percentiles(table.total_ms[table.frame_rows]),
        stage_ms=stage_percentiles(table),
        versions=versions(),
        seed=parameters.seed,
        parameters=parameter_values(parameters),
    )
