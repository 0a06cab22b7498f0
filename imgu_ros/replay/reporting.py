# SPDX-License-Identifier: Apache-2.0
"""The last step of a replay: `report.html`, then `summary.json`, which marks the results as complete."""

from __future__ import annotations

from collections.abc import Sequence

from imgu_ros.config.values import parameter_values
from imgu_ros.replay.result_files import FRAMES, REPORT, SUMMARY, replay_contents
from imgu_ros.replay.statistics import FinishedReplay
from imgu_ros.report.accuracy import TruthComparison
from imgu_ros.report.html import write_report
from imgu_ros.report.samples import AnnotatedFrame
from imgu_ros.report.summary import (
    Summary,
    input_rate_hz,
    percentiles,
    stage_percentiles,
    target_summaries,
    write_summary,
)
from imgu_ros.report.table import FrameTable, read_frame_table
from imgu_ros.report.versions import versions


def write_summary_and_report(replayed: FinishedReplay, samples: Sequence[AnnotatedFrame]) -> Summary:
    """Write both files; the summary's warnings may be more than were known.

    Raises
    ------
    FileError
        If frames.csv cannot be read, or a file cannot be written.
    """
    statistics, warnings = replayed.statistics, list(replayed.warnings)
    comparison = None
    if replayed.truths and statistics.layout:
        comparison = TruthComparison(replayed.truths, replayed.sizes, statistics.image_size, statistics.camera)
    out = replayed.folder.path
    table = read_frame_table(out / FRAMES, comparison)
    if comparison is not None and not comparison.compared:
        names = ", ".join(sorted({truth.target for truth in replayed.truths}))
        warnings.append(
            f"{replayed.source.truth}: has no stamp and target of this bag (its targets: {names}); no errors known"
        )
    summary = _summary(table, replayed, tuple(warnings))
    write_report(out / REPORT, table, summary, samples, replayed.cards)
    replayed.folder.sync(replay_contents(sorted(replayed.sizes)).files)
    write_summary(out / SUMMARY, summary)
    return summary


def _summary(table: FrameTable, replayed: FinishedReplay, warnings: tuple[str, ...]) -> Summary:
    statistics = replayed.statistics
    return Summary(
        frames=statistics.frames,
        rejected=statistics.rejected,
        rate_in_hz=input_rate_hz(table),
        targets=target_summaries(table),
        reasons=tuple(statistics.reasons.counted()),
        warnings=warnings,
        source=replayed.source,
        frames_per_s=statistics.frames / max(statistics.seconds, 1e-9),
        seconds=statistics.seconds,
        total_ms=percentiles(table.total_ms[table.frame_rows]),
        stage_ms=stage_percentiles(table),
        versions=versions(),
        seed=replayed.parameters.seed,
        parameters=parameter_values(replayed.parameters),
        calibration=statistics.calibration,
        command=replayed.command,
        date=replayed.date,
    )
