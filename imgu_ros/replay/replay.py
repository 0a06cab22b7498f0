# SPDX-License-Identifier: Apache-2.0
"""Replay a recording through the pipeline, offline: frames.csv, poses, a results bag, a summary and a report."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import chain as chained
from pathlib import Path

from imgu_ros.bags.prefetch import Prefetch
from imgu_ros.bags.reading import open_bag
from imgu_ros.check.load_remarks import load_remarks
from imgu_ros.check.verdict import target_scores
from imgu_ros.config.components import DevelopmentParameters, OutputParameters, RecordedFramesParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import BagError, ParameterError
from imgu_ros.files.target_images import load_target_images
from imgu_ros.localizer import Localizer, rejected
from imgu_ros.messages.results import needs_keypoints
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.size_checks import SizeChecks
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.replay.frame_source import FrameSource, ReadFrame, read_ahead, size_of
from imgu_ros.replay.output_folder import check_output_folder, output_folder
from imgu_ros.replay.result_files import ReplayOutput, ResultItem, replay_contents
from imgu_ros.replay.result_sink import ResultSink, result_sink
from imgu_ros.replay.results_bag import checked_record
from imgu_ros.replay.statistics import FinishedReplay, ReplayStatistics
from imgu_ros.report.summary import Source, Summary
from imgu_ros.report.target_cards import MOST_CARDS, target_cards
from imgu_ros.simulate.truth import read_truth
from imgu_ros.stop_signals import HeldExitStack, held
from imgu_ros.threads import one_processor_left_over, quick_thread_switches

#: Bytes of images that are read and developed and wait for the localizer.
_AHEAD_BYTES = 16_000_000


def replay(
    bags: Sequence[Path],
    out: Path,
    parameters: Parameters,
    *,
    truth: Path | None = None,
    record: Sequence[str] = (),
    overwrite: bool = False,
    rate_hz: float = 0.0,
    check: bool = False,
    command: str = "",
    on_progress: Callable[[int, int | None], None] = lambda done, total: None,
    on_warning: Callable[[str], None] = lambda text: None,
) -> Summary:
    """Run the pipeline over one image topic of a bag and write the results into `out`.

    The same bag, parameters and seed give the same files, but for times. Memory does not depend on the length of the
    bag until the report is drawn, which takes about 250 bytes a frame and target.

    Parameters
    ----------
    bags : paths of one recording, see `open_bag`
    out : folder for the results; see `docs/interfaces.md` for what is written
    parameters : all parameters; `targets.images` must name at least one
    truth : truth file; the report then gives the errors
    record : outputs to write into the results bag beside those that always are
    overwrite : replace the files of an earlier replay in `out`; nothing else is ever removed
    rate_hz : pictures a second, where their names or Exif should not tell, see `open_bag`
    check : judge the targets as `imgu check` does, some seconds each, for the report
    command : that asks for this replay, for the report; empty: none
    on_progress : called after each frame with the number of frames done and, when it is known, of all
    on_warning : called once for each warning

    Raises
    ------
    ParameterError, ShapeError, FileError
        If parameters, targets, the truth file or the output folder are unusable.
    BagError
        If the bag cannot be read, has no image topic, or not one frame in it could be decoded.
    """
    recorded, date = checked_record(record), time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime())
    truths = () if truth is None else read_truth(truth)
    check_output_folder(out, replay_contents(()), overwrite=overwrite, inputs=bags)
    warnings = _UniqueWarnings(on_warning)
    with HeldExitStack() as stack:
        bag = stack.enter_context(open_bag(bags, limits=parameters.limits, rate_hz=rate_hz))
        if not parameters.targets.images:
            raise ParameterError(
                "targets.images: none; need at least one image file: --target FILE, or -p targets.images:=FILE"
            )
        images = load_target_images(parameters.targets, lambda text: warnings.add([text]), limits=parameters.limits)
        targets = prepare_references(images, parameters)
        remarks = load_remarks(targets, parameters.raw.transfer != "srgb")
        warnings.add(tuple(remarks.values()))
        warnings.add(bag.warnings)
        source = FrameSource(bag, RecordedFramesParameters.of(parameters))
        warnings.add(bag.warnings, source.warnings)
        developed = read_ahead(bag, source, DevelopmentParameters.of(parameters))
        ahead = stack.enter_context(closing(Prefetch(developed, size_of, _AHEAD_BYTES)))
        frames = iter(ahead)
        first = next(frames, None)
        if first is None:
            warnings.add(bag.warnings, source.warnings)
            raise BagError(f"{source.image_topic.name}: no image in the bag can be read; need at least one")
        warnings.add(first.warnings)
        total, names = source.image_topic.count, tuple(target.name for target in targets if len(target.names) == 1)
        ids = tuple(name for target in targets if len(target.names) > 1 for name in target.names)
        folder = stack.enter_context(
            output_folder(
                out,
                replay_contents((*names, *ids)),
                overwrite=overwrite,
                inputs=bags,
                on_warning=lambda text: warnings.add([text]),
            )
        )
        sink = stack.enter_context(
            result_sink(ReplayOutput(folder, OutputParameters.of(parameters), names, recorded, total, ids))
        )
        statistics = _ReplayRun(total, targets, parameters, recorded, warnings, on_progress).over(
            chained([first], frames), sink
        )
        warnings.add(bag.warnings, source.warnings, statistics.warnings())
        described = Source(
            bags=tuple(str(path) for path in bags),
            truth="" if truth is None else str(truth),
            image_topic=source.image_topic.name,
            camera_info_topic="" if source.camera_info_topic is None else source.camera_info_topic.name,
            camera_info_file=source.camera_info_file,
            image_size="{} x {}".format(*statistics.image_size) if statistics.layout else "",
            layout=statistics.layout,
            recording=tuple(os.path.abspath(path) for path in bags),
            rate_hz=rate_hz,
        )
        scores = target_scores(images[:MOST_CARDS], parameters) if check else {}
        cards = target_cards(images, parameters.targets.images, remarks, scores)
        sizes = {name: target.size for target in targets for name in target.names}
        summary = sink.report(
            FinishedReplay(
                folder, statistics, described, truths, sizes, parameters, warnings.listed(), cards, command, date
            )
        )
    warnings.add(summary.warnings)
    if statistics.rejected == statistics.frames:
        raise BagError(
            f"{described.image_topic}: not one of {statistics.frames} frames could be read: {statistics.first_reason}"
        )
    return summary


class _UniqueWarnings:
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
class _ReplayRun:
    """One pass over the frames.

    Three threads or processes work on different frames: one reads and develops, this one localizes, the sink writes.
    """

    total: int
    targets: tuple[Reference, ...]
    parameters: Parameters
    record: tuple[str, ...]
    warnings: _UniqueWarnings
    on_progress: Callable[[int, int | None], None]

    def over(self, frames: Iterator[ReadFrame], sink: ResultSink) -> ReplayStatistics:
        statistics = ReplayStatistics()
        worker, sizes = Localizer(self.parameters, self.targets), SizeChecks(self.targets)
        with_keypoints = needs_keypoints(self.record)
        start = time.monotonic()
        with quick_thread_switches(), one_processor_left_over():
            for read in frames:
                result = (
                    rejected(read.frame, self.targets, read.reason)
                    if read.development is None
                    else worker.process(read.frame, with_keypoints, read.development)
                )
                with held():  # a frame is written whole
                    sink.put(ResultItem(result, read.time_ns))
                self.warnings.add(sizes.add(result))
                if result.calibration is not None and result.calibration.warning:
                    self.warnings.add([result.calibration.warning])
                reason = statistics.add(result)
                if reason:
                    self.warnings.add([f"rejected: {reason}"])
                self.on_progress(statistics.frames, self.total or None)
                self.warnings.add(read.warnings)
        statistics.seconds = time.monotonic() - start
        return statistics
