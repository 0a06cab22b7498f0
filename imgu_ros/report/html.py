# SPDX-License-Identifier: Apache-2.0
"""`report.html`: one self-contained page about a replay, which runs no script but its own and asks no network."""

from __future__ import annotations

import base64
import hashlib
import math
import re
from collections.abc import Iterator, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup

from imgu_ros.check.verdict import DEPENDABLE
from imgu_ros.config.parameters import declarations
from imgu_ros.file_access.text_files import write_text
from imgu_ros.messages.annotations import STATUS_COLORS
from imgu_ros.report.curves import Curves, curves_of
from imgu_ros.report.digits import figures
from imgu_ros.report.samples import AnnotatedFrame
from imgu_ros.report.summary import Summary
from imgu_ros.report.table import FrameTable
from imgu_ros.report.target_cards import TargetCard
from imgu_ros.report.trajectory import path_views
from imgu_ros.result import Status
from imgu_ros.shown_text import shown
from imgu_ros.types import Floats

#: Digits of a number in a curve, and decimals of seconds.
_DIGITS, _DECIMALS = 4, 4
#: The page's scripts, in order: the library of plots, and what is this page's own.
_SCRIPTS = ("uPlot.iife.min.js", "report.js")
_STYLES = ("uPlot.min.css", "report.css")


_NUMBERS = re.compile(r"\s*\([^()]*\d[^()]*\)$")


def write_report(
    path: Path,
    table: FrameTable,
    summary: Summary,
    samples: Sequence[AnnotatedFrame],
    cards: Sequence[TargetCard] = (),
) -> None:
    """Write the report.

    Parameters
    ----------
    path : the HTML file, replaced when it exists
    table, summary, samples, cards : of one replay

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    environment = page_environment()
    environment.filters["figures"] = figures
    environment.filters["jpeg_uri"] = lambda jpeg: data_uri("image/jpeg", jpeg)
    defaults = {known.name: known.default for known in declarations()}
    curves = curves_of(table)
    truths = curves.true_paths or (None,) * len(curves.targets)
    scripts = [_file(name) for name in _SCRIPTS]
    page = environment.get_template("report.html.j2").render(
        summary=summary,
        cards=cards,
        dependable=DEPENDABLE,
        found={target.name: target for target in summary.targets},
        curves=curves,
        views=[
            view
            for target, (way, truth) in enumerate(zip(curves.paths, truths, strict=True))
            for view in path_views(target, way, truth)
        ],
        samples=samples,
        data=page_data(curves, samples),
        statuses=[(status.value, _hex(status)) for status in Status],
        changed={name: value for name, value in summary.parameters.items() if value != defaults.get(name)},
        scripts=[Markup(script) for script in scripts],
        hashes=Markup(" ".join(f"'sha256-{_sha256(script)}'" for script in scripts)),
        licence=Markup(_file("uPlot.LICENSE")),
        styles=Markup("\n".join(_file(name) for name in _STYLES)),
    )
    write_text(path, page)


def page_environment() -> jinja2.Environment:
    """Return what fills in the pages of `templates/`: text from outside is escaped, and acts on nothing."""
    return jinja2.Environment(
        loader=jinja2.PackageLoader("imgu_ros.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=lambda value: shown(value) if type(value) is str else value,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def page_data(curves: Curves, samples: Sequence[AnnotatedFrame]) -> dict[str, Any]:
    """Return what the page's script works on, for JSON; text from outside is `shown`."""
    return {
        "targets": [shown(name) for name in curves.targets],
        "bin": curves.bin_frames,
        "x": [round(value, _DECIMALS) for value in curves.x.tolist()],
        "xName": curves.x_name,
        "frame": curves.frame.tolist(),
        "plots": [
            {
                "title": plot.title,
                "unit": plot.unit,
                "curves": [
                    {
                        "target": curve.target,
                        "label": curve.label,
                        "predicted": curve.is_predicted,
                        "values": list(_numbers(curve.values)),
                    }
                    for curve in plot.curves
                ],
            }
            for plot in curves.plots
        ],
        "statuses": [{"name": status.value, "color": _hex(status)} for status in Status],
        "runs": [[[run.first, run.last, run.status, run.reason] for run in runs] for runs in curves.runs],
        # The numbers at the end of a text are those of the first frame with it.
        "reasons": [shown(_NUMBERS.sub("", reason)) for reason in curves.reasons],
        "paths": [[list(_numbers(column)) for column in path.T] for path in curves.paths],
        "samples": [
            {"frame": sample.index, "jpeg": base64.b64encode(sample.jpeg).decode("ascii")} for sample in samples
        ],
    }


def _numbers(values: Floats) -> Iterator[float | int | None]:
    """Yield numbers with few digits, and None where there is none."""
    for value in np.asarray(values, np.float64).tolist():
        if not math.isfinite(value):
            yield None
            continue
        rounded = float(f"{value:.{_DIGITS}g}")
        yield int(rounded) if rounded.is_integer() and abs(rounded) < 1e9 else rounded


def data_uri(media_type: str, data: bytes) -> Markup:
    """Return a data URI, which is not shortened."""
    # Ours, and not to be shortened.
    return Markup(f"data:{media_type};base64,{base64.b64encode(data).decode('ascii')}")


def _file(name: str) -> str:
    """Return a file of `templates/` that goes into the page as it is."""
    return (resources.files("imgu_ros.report") / "templates" / name).read_text(encoding="utf-8")


def _sha256(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")


def _hex(status: Status) -> str:
    return "#{:02x}{:02x}{:02x}".format(*STATUS_COLORS[status])
