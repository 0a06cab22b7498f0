# SPDX-License-Identifier: Apache-2.0
"""The report in Chromium: what a click, a drag and the slider do; nothing is asked of a network, nothing complains."""

from __future__ import annotations

import base64
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from imgu_ros.files.frames_csv import FramesWriter
from imgu_ros.report.html import write_report
from imgu_ros.report.samples import AnnotatedFrame, jpeg_of
from imgu_ros.report.summary import Source, Summary, input_rate_hz, percentiles, stage_percentiles, target_summaries
from imgu_ros.report.table import FrameTable, read_frame_table
from imgu_ros.result import Result, Status

if TYPE_CHECKING:
    from chromium import Chromium

FRAMES = 40
#: Every other frame has a picture, of a colour of its own.
PICTURED = range(0, FRAMES, 2)
EVIL = "<img src=x onerror=alert(1)></script><script>document.title = 'changed'</script>"


def picture(frame: int) -> bytes:
    return jpeg_of(np.full((120, 160, 3), (6 * frame, 255 - 6 * frame, 40), np.uint8), 640, 90)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory, make_result: Callable[..., Result]) -> Path:
    folder = tmp_path_factory.mktemp("report")
    with FramesWriter(folder / "frames.csv") as writer:
        for index in range(FRAMES):
            lost: dict[str, Any] = {"status": Status.LOST, "reason": EVIL} if 10 <= index < 14 else {}
            writer.write(make_result(index, names=("poster", EVIL), **lost))
    table = read_frame_table(folder / "frames.csv")
    samples = [AnnotatedFrame(index, 0, "", picture(index)) for index in PICTURED]
    write_report(folder / "report.html", table, summary_of(table), samples)
    return folder / "report.html"


def summary_of(table: FrameTable) -> Summary:
    return Summary(
        FRAMES, 0, input_rate_hz(table), target_summaries(table), (), (EVIL,),
        Source((EVIL,), "", "/image", "", "", "160 x 120", "bayer rggb uint8"), 1.0, 1.0, percentiles(table.total_ms),
        stage_percentiles(table), {}, 0, {}, command=EVIL,
    )  # fmt: skip


def shown_frame(browser: Chromium) -> int:
    """Return the number of the frame whose picture is seen, by the picture's bytes."""
    uri = browser.value("document.getElementById('picture').src")
    data = base64.b64decode(uri.removeprefix("data:image/jpeg;base64,"))
    (frame,) = [index for index in PICTURED if picture(index) == data]
    return frame


def selected(browser: Chromium) -> str:
    return browser.value("document.getElementById('selected').textContent")


def place_of(browser: Chromium, plot: str, share: float) -> tuple[float, float]:
    """Scroll a plot into view and return a place in it: share of its width, middle of its height."""
    browser.value(f"document.getElementById('{plot}').scrollIntoView({{block: 'center'}})")
    box = browser.value(
        f"(() => {{ const b = document.querySelector('#{plot} .u-over').getBoundingClientRect();"
        "return [b.left, b.top, b.width, b.height]; })()"
    )
    return box[0] + share * box[2], box[1] + box[3] / 2


@pytest.mark.parametrize("width", [1400, 390])
def test_a_click_shows_that_frame(page: Path, chromium: Chromium, width: int) -> None:
    chromium.open(page.as_uri(), width=width, is_phone=width < 500)
    assert chromium.value("document.documentElement.scrollWidth") <= width
    assert shown_frame(chromium) == 0
    for plot, frame in (("plot-0", 30), ("strip", 12), ("plot-2", 38)):
        chromium.click(*place_of(chromium, plot, frame / (FRAMES - 1)))
        assert selected(chromium).startswith(f"Frame {frame},")
        assert shown_frame(chromium) == frame
        # The picture stays in sight beside the curves.
        top, bottom = chromium.value(
            "(() => { const b = document.getElementById('picture').getBoundingClientRect();"
            "return [b.top, b.bottom]; })()"
        )
        assert top >= -1 and bottom <= 901
    chromium.click(*place_of(chromium, "strip", 12.0 / (FRAMES - 1)))
    readout = chromium.value("document.getElementById('readout').textContent")
    assert "lost" in readout and EVIL in readout
    # Frame 13 has no picture: the nearest is shown, and said.
    chromium.click(*place_of(chromium, "plot-0", 13 / (FRAMES - 1)))
    assert selected(chromium).startswith("Frame 13,")
    assert shown_frame(chromium) in (12, 14)
    assert "the nearest" in chromium.value("document.getElementById('pictured').textContent")
    assert chromium.value("document.title").startswith("imgu replay: ")
    assert chromium.complaints() == []
    assert chromium.requests() == [page.as_uri()]


def test_hover_drag_double_click_and_buttons(page: Path, chromium: Chromium) -> None:
    chromium.open(page.as_uri())
    legend = "document.querySelector('#plot-0 .u-legend').textContent"
    x, y = place_of(chromium, "plot-0", 0.5)
    before = chromium.value(legend)
    chromium.move(x, y)
    assert chromium.value(legend) != before
    whole = chromium.screenshot()
    chromium.drag(x - 100, y, x + 100, y)
    axis = "document.querySelector('#plot-0 canvas').toDataURL()"
    other = "document.querySelector('#plot-1 canvas').toDataURL()"
    chromium.value("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    zoomed = [chromium.value(axis), chromium.value(other)]
    assert not np.array_equal(chromium.screenshot(), whole)
    assert selected(chromium).startswith("Frame 0,"), "a drag is no click"
    for button in ("closer", "wider", "whole"):
        chromium.value(f"document.getElementById('{button}').click()")
        chromium.value("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        now = [chromium.value(axis), chromium.value(other)]
        assert now[0] != zoomed[0] and now[1] != zoomed[1], "all plots zoom together"
        zoomed = now
    assert chromium.complaints() == []


def test_slider_buttons_play_and_path(page: Path, chromium: Chromium) -> None:
    chromium.open(page.as_uri())
    chromium.value(
        "(() => { const s = document.getElementById('slider'); s.value = 7; s.dispatchEvent(new Event('input')); })()"
    )
    assert shown_frame(chromium) == PICTURED[7]
    assert selected(chromium).startswith(f"Frame {PICTURED[7]},")
    chromium.value("document.getElementById('after').click()")
    assert shown_frame(chromium) == PICTURED[8]
    chromium.value("document.getElementById('before').click(), document.getElementById('before').click()")
    assert shown_frame(chromium) == PICTURED[6]
    chromium.value("document.getElementById('play').click()")
    chromium.wait(f"Number(document.getElementById('slider').value) > 8 || {PICTURED[6]} === -1", 10)
    chromium.value("document.getElementById('play').click()")
    assert chromium.value("document.getElementById('play').textContent") == "Play"
    # The path goes to the right with the frame: near its end is the last frame.
    x, y = chromium.value(
        "(() => { const p = document.querySelector('.paths .estimate'); p.scrollIntoView({block: 'center'});"
        "const e = p.getPointAtLength(p.getTotalLength()).matrixTransform(p.getScreenCTM()); return [e.x, e.y]; })()"
    )
    chromium.click(x, y)
    assert selected(chromium).startswith(f"Frame {FRAMES - 1},")
    dot = chromium.value(
        "(() => { const b = document.querySelector('.paths .here').getBoundingClientRect();"
        "return [b.left + b.width / 2, b.top + b.height / 2]; })()"
    )
    assert np.allclose(dot, (x, y), atol=2)
    assert chromium.complaints() == []


@pytest.mark.parametrize("frames", [1, 4500])
def test_one_frame_and_more_than_there_are_points(
    make_result: Callable[..., Result], chromium: Chromium, tmp_path: Path, frames: int
) -> None:
    with FramesWriter(tmp_path / "frames.csv") as writer:
        results = [make_result(index, status=Status.LOST if index else Status.DETECTED) for index in range(2)]
        for index in range(frames):
            is_lost = abs(index - 2250) < 15
            frame = replace(results[is_lost].frame, stamp_ns=10**18 + index * 10**7)
            writer.write(replace(results[is_lost], frame=frame))
    table = read_frame_table(tmp_path / "frames.csv")
    write_report(tmp_path / "report.html", table, summary_of(table), [AnnotatedFrame(0, 0, "", picture(0))])
    chromium.open((tmp_path / "report.html").as_uri())
    chromium.click(*place_of(chromium, "plot-0", 0.5))
    if frames > 1:
        assert selected(chromium).startswith("Frames 22")
        assert "lost" in chromium.value("document.getElementById('readout').textContent")
    assert shown_frame(chromium) == 0
    assert chromium.complaints() == []


def test_dark_and_without_scripts(page: Path, chromium: Chromium) -> None:
    chromium.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "dark"}])
    chromium.open(page.as_uri())
    assert chromium.screenshot()[5, 5].max() < 60
    chromium.call("Emulation.setScriptExecutionDisabled", value=True)
    chromium.open(page.as_uri())
    assert chromium.screenshot(whole=True).shape[0] > 1000
    assert chromium.complaints() == []


def test_policy_stops_other_scripts_and_the_network(page: Path, chromium: Chromium, tmp_path: Path) -> None:
    """Whatever comes into the page: the policy runs no script but the page's own, and lets nothing be fetched."""
    text = page.read_text().replace(
        "<main>", "<main><script>document.title = 'changed'</script><img src='http://127.0.0.1:9/x.png'>"
    )
    (tmp_path / "changed.html").write_text(text)
    chromium.open((tmp_path / "changed.html").as_uri())
    assert chromium.value("document.title").startswith("imgu replay: ")
    said = " ".join(chromium.complaints())
    assert "script-src" in said and "img-src" in said
    failed = [event for event in chromium.events if event["method"] == "Network.loadingFailed"]
    assert all(event["params"].get("blockedReason") == "csp" for event in failed)
