# SPDX-License-Identifier: Apache-2.0
"""`report.html`: one self-contained page about a replay."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jinja2
from markupsafe import Markup

from imgu_ros.config.parameters import declarations
from imgu_ros.file_access.text_files import write_text
from imgu_ros.files.plot_style import plot_style
from imgu_ros.report import plots
from imgu_ros.report.digits import figures
from imgu_ros.report.samples import AnnotatedFrame
from imgu_ros.report.summary import Summary
from imgu_ros.report.table import FrameTable
from imgu_ros.shown_text import shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DPI = 150
_MOST_TRAJECTORIES = 6


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture in the page: data URI and the words beside it."""

    uri: Markup
    title: str
    caption: str


def write_report(path: Path, table: FrameTable, summary: Summary, samples: Sequence[AnnotatedFrame]) -> None:
    """Write the report.

    Parameters
    ----------
    path : the HTML file, replaced when it exists
    table, summary, samples : of one replay

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    environment = page_environment()
    environment.filters["figures"] = figures
    defaults = {known.name: known.default for known in declarations()}
    page = environment.get_template("report.html.j2").render(
        summary=summary,
        figures=list(_figures(table)),
        samples=[_sample_picture(sample, table) for sample in samples],
        changed={name: value for name, value in summary.parameters.items() if value != defaults.get(name)},
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


def _figures(table: FrameTable) -> Iterator[Picture]:
    if not len(table):
        return
    for index, name in enumerate(table.targets[:_MOST_TRAJECTORIES]):
        trajectory = plots.plot_trajectory(table, index)
        if trajectory is not None:
            title = "Trajectory" if len(table.targets) == 1 else f"Trajectory before {name}"
            yield plotted(
                trajectory, title, "The camera in the target's frame: x right, y up, z out of the printed face."
            )
    errors = plots.plot_errors(table)
    if errors is not None:
        caption = "Against the truth file. Dashed: the error that the estimate's own covariance predicts (1σ)."
        yield plotted(errors, "Errors over time", caption)
    else:
        precision = plots.plot_precision(table)
        if precision is not None:
            caption = "No truth file was given: this is what the estimates say of themselves, not their error."
            yield plotted(precision, "Precision over time", caption)
    yield plotted(plots.plot_status(table), "Status over time", "Each target's status; tentative matches and inliers.")
    times = plots.plot_times(table)
    if times is not None:
        yield plotted(times, "Stage times", "Time in the pipeline, without reading and writing.")


def plotted(figure: Figure, title: str, caption: str) -> Picture:
    """Return a figure as a picture of a page."""
    buffer = io.BytesIO()
    # Little is gained by compressing lines on white for longer.
    compression: Any = {"compress_level": 3}
    with plot_style({}):
        figure.savefig(buffer, format="png", dpi=_DPI, metadata={"Software": None}, pil_kwargs=compression)
    return Picture(data_uri("image/png", buffer.getvalue()), title, caption)


def _sample_picture(sample: AnnotatedFrame, table: FrameTable) -> Picture:
    seconds = (sample.stamp_ns - int(table.stamp_ns.min())) / 1e9 if len(table) else 0.0
    return Picture(data_uri("image/jpeg", sample.jpeg), f"frame {sample.index}, {seconds:.2f} s", sample.caption)


def data_uri(media_type: str, data: bytes) -> Markup:
    """Return a data URI, which is not shortened."""
    # Ours, and not to be shortened.
    return Markup(f"data:{media_type};base64,{base64.b64encode(data).decode('ascii')}")
