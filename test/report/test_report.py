# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np
import pytest

from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameter_values
from imgu_ros.errors import FileError
from imgu_ros.files.frames_csv import FramesWriter
from imgu_ros.report import samples as samples_module
from imgu_ros.report.accuracy import TruthComparison
from imgu_ros.report.digits import figures
from imgu_ros.report.html import write_report
from imgu_ros.report.plots import plot_errors, plot_precision, plot_status, plot_times, plot_trajectory
from imgu_ros.report.samples import Samples
from imgu_ros.report.summary import (
    Percentiles,
    Reason,
    Source,
    Summary,
    input_rate_hz,
    percentiles,
    stage_percentiles,
    target_summaries,
    write_summary,
)
from imgu_ros.report.table import FrameTable, read_frame_table
from imgu_ros.result import PoseStatus, Result, Status
from imgu_ros.simulate.truth import Truth

MakeResult = Callable[..., Result]


def table_of(results: list[Result], folder: Path, comparison: TruthComparison | None = None) -> FrameTable:
    with FramesWriter(folder / "frames.csv") as writer:
        for result in results:
            writer.write(result)
    return read_frame_table(folder / "frames.csv", comparison)


def summary_of(table: FrameTable, **changed: object) -> Summary:
    values: dict[str, object] = {
        "frames": len(table),
        "rejected": 0,
        "rate_in_hz": input_rate_hz(table),
        "targets": target_summaries(table),
        "reasons": (),
        "warnings": (),
        "source": Source(("a.bag",), "", "/image", "", "", "640 x 480", "mono uint8"),
        "frames_per_s": 12.5,
        "seconds": 1.0,
        "total_ms": percentiles(table.total_ms),
        "stage_ms": stage_percentiles(table),
        "versions": {"numpy": "1"},
        "seed": 0,
        "parameters": parameter_values(Parameters()),
    }
    return Summary(**{**values, **changed})  # type: ignore[arg-type]


def truth_of(results: list[Result]) -> TruthComparison:
    truths = [
        Truth(r.frame.stamp_ns, t.name, t.homography.H, t.pose.transform)
        for r in results
        for t in r
        if t.homography is not None and t.pose is not None
    ]
    names = {t.name: (400, 300) for t in results[0]}
    return TruthComparison(truths, names, (640, 480), results[0].frame.camera)


def test_table_holds_what_was_written(make_result: MakeResult, tmp_path: Path) -> None:
    results = [make_result(0), make_result(1, status=Status.LOST, reason="gone"), make_result(2)]
    table = table_of(results, tmp_path, truth_of(results))
    assert len(table) == 3
    assert table.targets == ("poster",)
    assert table.found.tolist() == [True, False, True]
    assert table.n_inliers[[0, 2]].tolist() == [30, 30]
    assert np.isnan(table.n_inliers[1])
    assert table.total_ms.tolist() == [40.0, 40.000001, 40.000002]
    pose = results[0].first.pose
    assert np.allclose(table.position[0], -pose.R.T @ pose.t)
    assert table.sigma_t[0] == pytest.approx(np.sqrt(3e-6))
    assert table.seconds.tolist() == [0, 0.05, 0.1]
    assert table.errors is not None
    assert np.nanmax(table.errors.corner_px) < 1e-6
    assert np.nanmax(table.errors.nees) < 1e-6


def test_summary_counts(make_result: MakeResult, tmp_path: Path) -> None:
    results = [make_result(i, names=("a", "b")) for i in range(3)]
    results += [make_result(3, names=("a", "b"), status=Status.LOST)]
    results += [make_result(4, names=("a", "b"), pose_status=PoseStatus.AMBIGUOUS)]
    table = table_of(results, tmp_path)
    for target, name in zip(target_summaries(table), "ab", strict=True):
        assert (target.name, target.frames, target.found) == (name, 5, 4)
        assert target.status["lost"] == 1
        assert target.pose_status == {"metric": 3, "ambiguous": 1, "uncalibrated": 0, "no_size": 0}
        assert target.corner_error_px is None
    assert input_rate_hz(table) == pytest.approx(20)
    assert stage_percentiles(table)["pose"].p50 == pytest.approx(8.000002)


def test_percentiles() -> None:
    assert percentiles(np.array([np.nan, np.nan])) is None
    assert percentiles(np.array([3.0, np.nan, 1.0, 2.0])) == Percentiles(3, 2.0, 2.0, pytest.approx(2.9), 3.0)


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [(None, 3, "–"), (0.0271, 2, "0.027"), (0.1, 2, "0.10"), (12.345, 3, "12.3"), (348.2, 3, "348"), (2000, 3, "2000"),
     (0, 3, "0.00"), (99.96, 3, "100"), (1e-7, 2, "1.0e-07"), (1000, 3, "1000")],
)  # fmt: skip
def test_figures(value: float | None, digits: int, text: str) -> None:
    assert figures(value, digits) == text


def test_samples_are_few_even_and_keep_the_first_misses(make_result: MakeResult) -> None:
    good, bad = make_result(size=(64, 48)), make_result(size=(64, 48), status=Status.LOST)
    samples = Samples()
    misses = {11, 12, 13, 57, 333, 900}
    for index in range(1000):
        samples.offer(index, bad if index in misses else good)
        assert len(samples._kept) < 12 + 3
    chosen = [sample.index for sample in samples.chosen()]
    assert {11, 57, 333} <= set(chosen)
    assert not {12, 13, 900} & set(chosen)
    even = [index for index in chosen if index not in misses]
    assert len(even) == 6
    assert even[0] == 0
    assert even[-1] > 750
    picture = cv2.imdecode(np.frombuffer(samples.chosen()[0].jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (48, 64, 3)


@pytest.mark.parametrize(("expected", "count"), [(3000, 3000), (3000, 100), (3000, 7000), (11, 11), (6, 6), (1, 1)])
def test_a_known_number_of_frames_needs_few_drawings(
    make_result: MakeResult, monkeypatch: pytest.MonkeyPatch, expected: int, count: int
) -> None:
    drawn: list[int] = []
    monkeypatch.setattr(samples_module, "jpeg_of", lambda *picture: drawn.append(1) or b"")
    samples, result = Samples(expected), make_result(0)
    for index in range(count):
        samples.offer(index, result)
    chosen = [sample.index for sample in samples.chosen()]
    assert chosen[0] == 0 and len(drawn) <= 20
    if expected == count:
        assert len(chosen) == min(6, count) and chosen[-1] >= 0.8 * (count - 1)
        assert len(drawn) <= 11


def test_large_samples_are_reduced(make_result: MakeResult) -> None:
    samples = Samples()
    samples.offer(0, make_result(size=(2400, 1600)))
    picture = cv2.imdecode(np.frombuffer(samples.chosen()[0].jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (640, 960, 3)


@pytest.mark.parametrize("with_truth", [False, True])
def test_report_is_one_self_contained_page(make_result: MakeResult, tmp_path: Path, with_truth: bool) -> None:
    results = [make_result(i, names=("a", "b")) for i in range(4)]
    results.append(make_result(4, names=("a", "b"), status=Status.LOST, reason="gone"))
    table = table_of(results, tmp_path, truth_of(results) if with_truth else None)
    evil = "<script>alert('x')</script> & more"
    summary = summary_of(table, warnings=(evil,), reasons=(Reason("lost", evil, 3),))
    samples = Samples()
    for index, result in enumerate(results):
        samples.offer(index, result)
    write_report(tmp_path / "report.html", table, summary, samples.chosen())
    page = (tmp_path / "report.html").read_text()
    assert "<script" not in page
    assert page.count("&lt;script&gt;") == 2
    assert not re.search(r"""(src|href)\s*=\s*["'](?!data:)""", page)
    assert page.count("data:image/jpeg;base64,") == 5
    assert "4 / 5" in page
    assert ("corner error" in page) is with_truth
    assert ("No truth file" in page) is not with_truth


def test_report_is_drawn_by_nobodys_settings(make_result: MakeResult, tmp_path: Path) -> None:
    results = [make_result(i) for i in range(4)]
    table = table_of(results, tmp_path, truth_of(results))
    write_report(tmp_path / "plain.html", table, summary_of(table), ())
    # As a file `matplotlibrc` in the current folder can have them; `text.usetex` starts latex.
    with mpl.rc_context({"text.usetex": True, "axes.facecolor": "red", "font.size": 40, "lines.linewidth": 9}):
        write_report(tmp_path / "set.html", table, summary_of(table), ())
        assert mpl.rcParams["font.size"] == 40
    assert (tmp_path / "set.html").read_bytes() == (tmp_path / "plain.html").read_bytes()


def test_report_of_nothing_but_rejected_frames(make_result: MakeResult, tmp_path: Path) -> None:
    results = [make_result(i, status=Status.REJECTED, reason="unreadable") for i in range(3)]
    table = table_of(results, tmp_path)
    write_report(tmp_path / "report.html", table, summary_of(table, rejected=3, total_ms=None), ())
    assert "0 / 3" in (tmp_path / "report.html").read_text()


def test_unwritable(make_result: MakeResult, tmp_path: Path) -> None:
    table = table_of([make_result(0, status=Status.LOST)], tmp_path)
    with pytest.raises(FileError, match="can be written"):
        write_report(tmp_path / "no" / "report.html", table, summary_of(table), ())
    with pytest.raises(FileError, match="can be written"):
        write_summary(tmp_path / "no" / "summary.json", summary_of(table))


def test_plots_of_one_frame_and_of_stamps_that_stand_still(make_result: MakeResult, tmp_path: Path) -> None:
    for results in ([make_result(0)], [make_result(0), make_result(0), make_result(0)]):
        table = table_of(results, tmp_path)
        for figure in (plot_status(table), plot_times(table), plot_precision(table), plot_trajectory(table, 0)):
            assert figure is not None
            figure.savefig(tmp_path / "f.png", dpi=40)
        assert plot_errors(table) is None


def test_not_a_frames_csv(tmp_path: Path) -> None:
    (tmp_path / "frames.csv").write_text("a,b\n1,2\n")
    with pytest.raises(FileError, match="need those of frames.csv"):
        read_frame_table(tmp_path / "frames.csv")
    with pytest.raises(FileError, match="need a frames.csv"):
        read_frame_table(tmp_path / "gone.csv")


def test_samples_of_line_cameras(make_result: MakeResult) -> None:
    for size in [(4000, 2), (2, 4000)]:
        samples = Samples()
        samples.offer(0, make_result(0, size=size, status=Status.LOST))
        picture = cv2.imdecode(np.frombuffer(samples.chosen()[0].jpeg, np.uint8), cv2.IMREAD_COLOR)
        assert max(picture.shape[:2]) == 960
