# SPDX-License-Identifier: Apache-2.0
"""A check as one self-contained page, to be shown to whoever designs the print."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from imgu_ros.check.accuracy import TILT_DEG
from imgu_ros.check.finding import DEPENDABLE_SHARE
from imgu_ros.check.listing import camera_words, farthest, length, small_length
from imgu_ros.check.verdict import DEPENDABLE, SCORE_PX, TargetCheck
from imgu_ros.file_access.text_files import write_text
from imgu_ros.files.plot_style import plot_style
from imgu_ros.report.check_pictures import (
    detail_picture,
    far_picture,
    plain_picture,
    plot_accuracy,
    plot_found,
    telling_picture,
)
from imgu_ros.report.html import data_uri, page_environment
from imgu_ros.types import Image
from imgu_ros.vision.camera.intrinsics import Camera

#: Where a target is not found dependably at any size, it is shown this large, longer side, px.
_SHOWN_PX = 120.0
_DPI = 150


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture in the page: data URI and the words beside it."""

    uri: Markup
    title: str
    caption: str


@dataclass(frozen=True, slots=True)
class CheckedTarget:
    """What the page says of one target: `facts` are pairs of words, `rows` the table of expected errors."""

    check: TargetCheck
    facts: tuple[tuple[str, str], ...]
    pictures: tuple[Picture, ...]
    plots: tuple[Picture, ...]
    rows: tuple[tuple[str, ...], ...]


def write_check_page(path: Path, checks: Sequence[TargetCheck], camera: Camera, version: str) -> None:
    """Write the page.

    Parameters
    ----------
    path : the HTML file, replaced when it exists
    checks, camera : of one check
    version : of this package

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    page = (
        page_environment()
        .get_template("check.html.j2")
        .render(
            targets=[_target(check) for check in checks],
            camera=camera_words(camera),
            version=version,
            dependable=DEPENDABLE,
            share=round(100 * DEPENDABLE_SHARE),
            low=round(SCORE_PX[0]),
            high=round(SCORE_PX[1]),
            tilt=round(TILT_DEG),
        )
    )
    write_text(path, page)


def _target(check: TargetCheck) -> CheckedTarget:
    return CheckedTarget(
        check, tuple(_facts(check)), tuple(_pictures(check)), tuple(_plots(check)), tuple(_rows(check))
    )


def _facts(check: TargetCheck) -> Iterator[tuple[str, str]]:
    """Yield the same facts of every target, a dash where one has none."""
    smallest, far = check.smallest_width_px, farthest(check)
    large = "–" if check.curve is None else f"{check.curve.large_share:.0%}"
    yield "of large views found", large
    yield "found from a width of", "–" if smallest is None else f"{smallest:.0f} px"
    yield "so far away", "–" if far is None else length(far, check)
    known = [e for e in check.errors if e.position_m is not None and e.rotation_deg is not None]
    if known and smallest is not None:
        middle = known[len(known) // 2]
        error = small_length(float(middle.position_m or 0), middle.distance_m, check)
        yield "error of one frame", f"{error}, {middle.rotation_deg:.2g}° at {length(middle.distance_m, check)}"
    else:
        yield "error of one frame", "–"


def _pictures(check: TargetCheck) -> Iterator[Picture]:
    yield _png(plain_picture(check), "The target", "as the pipeline knows it")
    if check.traits is None:
        return
    yield _png(
        detail_picture(check), "Where its detail lies", "orange: detail that is seen; pale: nothing to hold on to"
    )
    copy = check.traits.closest
    if copy is not None:
        moved = f"turned by {round(copy.turn_deg)} degrees" if copy.turn_deg else "shifted by a period"
        caption = f"blue: all that tells it from itself {moved}; the less, the more often it is mistaken"
        yield _png(telling_picture(check, copy), "What tells which way round it is", caption)
    longer = None if check.curve is None else check.curve.smallest_px()
    shown = longer or _SHOWN_PX
    width = shown * check.width_of_longer
    words = "the smallest view in which it is found" if longer else "not found dependably at any size; here"
    yield _png(far_picture(check, shown), "As the camera sees it from afar", f"{words}: {width:.0f} px wide, enlarged")


def _plots(check: TargetCheck) -> Iterator[Picture]:
    if check.curve is None:
        return
    yield _plotted(plot_found(check), "How small it may be", "Simulated views of every size, tilt and roll.")
    accuracy = plot_accuracy(check)
    if accuracy is not None:
        caption = "One frame; without the errors of calibration and print. Dashed: as far as it is found."
        yield _plotted(accuracy, "How exact its pose will be", caption)


def _rows(check: TargetCheck) -> Iterator[tuple[str, ...]]:
    for e in check.errors:
        known = e.position_m is not None and e.rotation_deg is not None
        yield (
            length(e.distance_m, check),
            f"{e.seen_px * check.width_of_longer:.0f} px",
            small_length(float(e.position_m or 0), e.distance_m, check) if known else "no pose",
            f"{e.rotation_deg:.2g}°" if known else "–",
            f"{e.ambiguous_share:.0%}" if known else "–",
        )


def _png(picture: Image, title: str, caption: str) -> Picture:
    _, data = cv2.imencode(".png", np.ascontiguousarray(picture[:, :, ::-1]))
    return Picture(data_uri("image/png", data.tobytes()), title, caption)


def _plotted(figure: Figure, title: str, caption: str) -> Picture:
    buffer = io.BytesIO()
    # Little is gained by compressing lines on white for longer.
    compression: Any = {"compress_level": 3}
    with plot_style({}):
        figure.savefig(buffer, format="png", dpi=_DPI, metadata={"Software": None}, pil_kwargs=compression)
    return Picture(data_uri("image/png", buffer.getvalue()), title, caption)
