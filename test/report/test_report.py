# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameter_values
from imgu_ros.errors import FileError
from imgu_ros.files.frames_csv import FramesWriter
from imgu_ros.reference.templates import TargetImage
from imgu_ros.report import samples as samples_module
from imgu_ros.report.accuracy import TruthComparison
from imgu_ros.report.curves import curves_of
from imgu_ros.report.digits import figures
from imgu_ros.report.html import page_data, write_report
from imgu_ros.report.samples import AnnotatedFrame, Samples
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
from imgu_ros.report.target_cards import target_cards
from imgu_ros.report.trajectory import path_views
from imgu_ros.result import PoseStatus, Result, Stage, Status
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
    misses = {11, 12, 13, 57, 333, 901, 1001}
    for index in range(5000):
        samples.offer(index, bad if index in misses else good)
        assert len(samples._kept) < 96 + 8
    chosen = [sample.index for sample in samples.chosen()]
    assert {11, 57, 333, 901, 1001} <= set(chosen)
    assert not {12, 13} & set(chosen)
    even = [index for index in chosen if index not in misses]
    assert 48 <= len(even) < 96
    assert np.ptp(np.diff(even)) == 0
    assert even[0] == 0
    assert even[-1] > 4800
    picture = cv2.imdecode(np.frombuffer(samples.chosen()[0].jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (48, 64, 3)


@pytest.mark.parametrize("expected", [1, 6, 95, 96, 3000, 100_000])
@pytest.mark.parametrize("share", [0.03, 1, 2.5])
def test_a_known_number_of_frames_needs_few_drawings(
    make_result: MakeResult, monkeypatch: pytest.MonkeyPatch, expected: int, share: float
) -> None:
    drawn: list[int] = []
    monkeypatch.setattr(samples_module, "_sample", lambda index, result: drawn.append(index) or index_only(index))
    samples, result, count = Samples(expected), make_result(0), max(1, round(share * expected))
    for index in range(count):
        samples.offer(index, result)
    chosen = [sample.index for sample in samples.chosen()]
    assert chosen[0] == 0 and len(drawn) <= 190
    if share == 1:
        assert len(chosen) >= min(count, 48) and chosen[-1] >= 0.97 * (count - 1)
        assert len(drawn) <= 95


def index_only(index: int) -> AnnotatedFrame:
    return AnnotatedFrame(index, 0, "", b"")


def test_pictures_of_a_report_are_bounded(monkeypatch: pytest.MonkeyPatch, make_result: MakeResult) -> None:
    monkeypatch.setattr(samples_module, "jpeg_of", lambda *picture: bytes(100_000))
    samples = Samples(96)
    for index in range(96):
        samples.offer(index, make_result(0, status=Status.LOST if index in (31, 32) else Status.DETECTED))
    chosen = [sample.index for sample in samples.chosen()]
    assert 12 <= len(chosen) <= 24
    assert 31 in chosen


def test_large_samples_are_reduced(make_result: MakeResult) -> None:
    samples = Samples()
    samples.offer(0, make_result(size=(2400, 1600)))
    picture = cv2.imdecode(np.frombuffer(samples.chosen()[0].jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (427, 640, 3)


EVIL = "</script><script>alert('x')</script> & more \u2028\x1b[2J"


def page_of(
    make_result: MakeResult,
    folder: Path,
    *,
    with_truth: bool = False,
    name: str = "a",
    score: int | None = None,
    **changed: object,
) -> str:
    """Return the report of four frames with two targets, and of one without a find."""
    results = [make_result(i, names=("b", name)) for i in range(4)]
    results.append(make_result(4, names=("b", name), status=Status.LOST, reason=changed.pop("reason", "gone")))
    table = table_of(results, folder, truth_of(results) if with_truth else None)
    samples = Samples()
    for index, result in enumerate(results):
        samples.offer(index, result)
    image = TargetImage(name, np.full((60, 80, 3), 90, np.uint8), 0.2)
    cards = target_cards([image], [f"{name}.png"], {name: "few corners"}, {} if score is None else {name: score})
    write_report(folder / "report.html", table, summary_of(table, **changed), samples.chosen(), cards)
    return (folder / "report.html").read_text()


def parts_of(page: str) -> tuple[str, dict[str, Any], list[str]]:
    """Return the page without its scripts, the data in it, and the scripts."""
    found = re.findall(r"<script([^>]*)>(.*?)</script>", page, re.DOTALL)
    assert [attributes for attributes, _ in found] == [' type="application/json" id="data"', "", ""]
    visible = re.sub(r"<script[^>]*>.*?</script>", "", page, flags=re.DOTALL)
    return visible, json.loads(found[0][1]), [script for _, script in found[1:]]


@pytest.mark.parametrize("with_truth", [False, True])
def test_report_is_one_self_contained_page(make_result: MakeResult, tmp_path: Path, with_truth: bool) -> None:
    page = page_of(make_result, tmp_path, with_truth=with_truth, command="imgu replay a.bag", date="2030-01-02")
    visible, data, scripts = parts_of(page)
    assert not re.search(r"""(src|href)\s*=\s*["'](?!data:)""", visible)
    assert not re.search(r"url\(|@import|<link|<iframe|<object|<embed| on[a-z]+=", visible)
    policy = re.search('http-equiv="Content-Security-Policy" content="([^"]*)"', page)[1]
    digests = [base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts]
    own = " ".join(f"'sha256-{digest}'" for digest in digests)
    assert policy == (
        "default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
        f"script-src {own}; base-uri 'none'; form-action 'none'"
    )
    assert len(data["samples"]) == 5
    assert all(base64.b64decode(sample["jpeg"]).startswith(b"\xff\xd8") for sample in data["samples"])
    assert "4 / 5" in page and "imgu replay a.bag" in page and "2030-01-02" in page and "few corners" in page
    titles = {plot["title"] for plot in data["plots"]}
    assert {"Residual", "Distance", "Viewing angle", "Confirmed share"} - titles == {"Confirmed share"}
    assert ({"Corner error", "NEES", "Position error"} <= titles) is with_truth
    assert ({"Position, 1σ", "Rotation, 1σ"} <= titles) is not with_truth
    assert ("No truth file" in page) is not with_truth
    assert len(page) < 400_000


def test_scores_of_targets(make_result: MakeResult, tmp_path: Path) -> None:
    assert "imgu replay --check" in page_of(make_result, tmp_path)
    page = page_of(make_result, tmp_path, score=73)
    assert "score 73 of 100" in page and "dependable from 50 on" in page and "--check" not in page


def test_strings_of_strangers_act_on_nothing(make_result: MakeResult, tmp_path: Path) -> None:
    """Names, reasons, topics, the command: in the text of the page as in its data."""
    source = Source((EVIL,), EVIL, EVIL, EVIL, "", "640 x 480", EVIL)
    page = page_of(
        make_result, tmp_path, name=EVIL, reason=EVIL, command=EVIL, warnings=(EVIL,), source=source,
        reasons=(Reason("lost", EVIL, 3),), versions={EVIL: EVIL},
    )  # fmt: skip
    visible, data, _ = parts_of(page)
    # Two scripts and the data are all that there is, although the strings close a script and open another.
    assert "<script" not in visible and "alert('x')" not in page.replace("alert(&#39;x&#39;)", "")
    assert visible.count("&lt;/script&gt;&lt;script&gt;") > 10
    assert "\x1b" not in page and "\u2028" not in page
    shown_name = EVIL.replace("\u2028", "\\u2028").replace("\x1b", "\\x1b")
    assert data["targets"] == ["b", shown_name]
    assert data["reasons"] == ["", shown_name]


def test_data_of_the_page_are_those_of_the_table(make_result: MakeResult, tmp_path: Path) -> None:
    results = [make_result(i, names=("a", "b")) for i in range(6)]
    results[3] = make_result(3, names=("a", "b"), status=Status.LOST, reason="gone (7 of 8)")
    table = table_of(results, tmp_path, truth_of(results))
    curves = curves_of(table)
    assert curves.bin_frames == 1
    assert np.allclose(curves.x, np.arange(6) * 0.05)
    (distance,) = [plot for plot in curves.plots if plot.title == "Distance"]
    (angle,) = [plot for plot in curves.plots if plot.title == "Viewing angle"]
    for place, name in enumerate(("a", "b")):
        values = distance.curves[place].values
        assert np.isnan(values[3])
        for index in (0, 1, 2, 4, 5):
            pose = results[index].references[name].pose
            assert values[index] == pytest.approx(np.linalg.norm(pose.t))
            sight = pose.t / np.linalg.norm(pose.t)
            expected = np.degrees(np.arccos(-sight @ pose.R[:, 2]))
            assert angle.curves[place].values[index] == pytest.approx(expected)
        runs = [
            (run.first, run.last, list(Status)[run.status], curves.reasons[run.reason]) for run in curves.runs[place]
        ]
        assert runs == [
            (0, 2, Status.DETECTED, ""), (3, 3, Status.LOST, "gone (7 of 8)"), (4, 5, Status.DETECTED, "")
        ]  # fmt: skip


@pytest.mark.parametrize("frames", [4001, 20_000, 100_000])
def test_long_replays_keep_every_extreme(frames: int) -> None:
    """Curves have at most 4000 points; no peak, no dip and no loss of a single frame is left out."""
    rng = np.random.default_rng(frames)
    table = long_table(frames, rng)
    curves = curves_of(table)
    width = curves.bin_frames
    assert width > 1 and len(curves.x) <= 4000 and (np.diff(curves.x) > 0).all()
    (residual,) = [plot for plot in curves.plots if plot.title == "Residual"]
    drawn, values = residual.curves[0].values, table.rms_px
    for start in rng.integers(0, frames // width, 200) * width:
        one = values[start : start + width]
        pair = drawn[2 * (start // width) : 2 * (start // width) + 2]
        known = one[~np.isnan(one)]
        if not len(known):
            assert np.isnan(pair).all()
            continue
        assert sorted(pair) == [known.min(), known.max()]
        first_is_smaller = np.nanargmin(one) <= np.nanargmax(one)
        assert (pair[0] <= pair[1]) == first_is_smaller or pair[0] == pair[1]
    shown = np.zeros(len(curves.x), int)
    for run in curves.runs[0]:
        shown[run.first : run.last + 1] = run.status
    lost = list(Status).index(Status.LOST)
    assert set(np.flatnonzero(table.status == lost) // width) == set(np.flatnonzero(shown == lost) // 2)
    text = json.dumps(page_data(curves, ()), allow_nan=False)
    assert len(text) < 1_200_000


def long_table(frames: int, rng: np.random.Generator) -> FrameTable:
    """Return a table of one target: single frames lost, stretches of 50 frames lost, residuals with peaks."""
    status = np.full(frames, list(Status).index(Status.TRACKED))
    for start in rng.integers(0, frames, 40):
        status[start : start + rng.choice([1, 50])] = list(Status).index(Status.LOST)
    found = status == list(Status).index(Status.TRACKED)
    column = np.where(found, rng.gamma(1.0, 0.1, frames), np.nan)
    position = np.column_stack((column, column, 1 + column))
    zeros = np.zeros(frames, np.intp)
    return FrameTable(
        np.arange(frames) * 33_000_000, ("t",), zeros, np.arange(frames), status, zeros, zeros, ("",),
        column, column, column, column, column, column, position, column, column, column, column,
        np.tile(column[:, None], (1, len(Stage))), None,
    )  # fmt: skip


def test_many_targets_are_bounded(make_result: MakeResult, tmp_path: Path) -> None:
    names = tuple(f"t{i}" for i in range(30))
    results = [make_result(i, names=names) for i in range(3)]
    table = table_of(results, tmp_path)
    curves = curves_of(table)
    assert curves.targets == names[:8]
    write_report(tmp_path / "report.html", table, summary_of(table), ())
    assert "Drawn: the 8 of 30 targets" in (tmp_path / "report.html").read_text()


def test_same_results_give_the_same_page(make_result: MakeResult, tmp_path: Path) -> None:
    assert page_of(make_result, tmp_path) == page_of(make_result, tmp_path)


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


def test_one_frame_and_stamps_that_stand_still(make_result: MakeResult, tmp_path: Path) -> None:
    for results in ([make_result(0)], [make_result(0), make_result(0), make_result(0)]):
        table = table_of(results, tmp_path)
        curves = curves_of(table)
        assert curves.x.tolist() == list(range(len(results)))
        assert curves.x_name == "frame"
        assert len(list(path_views(0, curves.paths[0], None))) == 2
        write_report(tmp_path / "report.html", table, summary_of(table), ())


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e308, 0.0])
def test_paths_of_any_numbers(value: float) -> None:
    views = list(path_views(0, np.array([[value, 0.0, 1.0], [0.0, 0.5, 2.0], [np.nan] * 3, [1.0, 1.0, 1.0]]), None))
    assert len(views) == 2
    for view in views:
        assert view.estimate.count("M") == 2 and 2 <= len(view.ticks_y) <= 12
    assert list(path_views(0, np.full((3, 3), np.nan), None)) == []


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
        assert max(picture.shape[:2]) == 640
