# SPDX-License-Identifier: Apache-2.0
"""Pictures of what goes into each public function of the vision library and what comes out.

    python docs/function_pictures.py [NAME...]

Each function is called with the example that its test has (test/vision/<room>/calls*.py), and with a picture to look at
where it takes one. Written to docs/reference/images/<chapter>.<function>.png.
"""

from __future__ import annotations

import argparse
import dataclasses
import enum
import importlib.util
import inspect
import sys
import textwrap
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import PIL.Image
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from imgu_ros.errors import ImguError
from imgu_ros.simulate.texture import procedural_texture

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS))
IMAGES = DOCS / "reference" / "images"
#: Width and height of the picture that functions of pictures get, px: even, for mosaics.
SIDES = (96, 72)
#: Smaller arrays are shown as numbers.
FEWEST_PX = 12
MOST_PANELS = 5
COLOURS = 32

Calls = dict[Callable[..., Any], Callable[[np.random.Generator], dict[str, Any]]]


@dataclass(frozen=True)
class Panel:
    """One thing to show: a picture, points, a curve, a matrix."""

    title: str
    kind: str
    data: np.ndarray


def example_calls(chapter: str) -> Calls:
    """Return the example call of each public function of a chapter."""
    calls: Calls = {}
    folder = DOCS.parent / "test" / "vision" / chapter
    for path in sorted(folder.glob("calls*.py")):
        spec = importlib.util.spec_from_file_location(f"example_{chapter}_{path.stem}", path)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        calls |= module.CALLS
    return calls


def draw(function: Callable[..., Any], make: Callable[[np.random.Generator], dict[str, Any]], path: Path) -> None:
    """Call a function with an example and draw what went in and came out."""
    arguments, given, got, answer = looked_at(function, make)
    background = next((panel for panel in given if panel.kind == "image"), None)
    shown = [*given[: MOST_PANELS - 1 - bool(got[1:])], *got][:MOST_PANELS]
    said = [text for name, value in arguments.items() for text in words(name, value)]
    figure = Figure(
        figsize=(1.75 * max(len(shown), 2), 1.95 + 0.16 * bool(said or answer)), dpi=80, layout="constrained"
    )
    canvas = FigureCanvasAgg(figure)
    if shown:
        for axes, panel in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
            _draw_panel(axes, panel, background if any(panel is each for each in got) else None)
    lines = [", ".join(said), ("result: " if answer else "") + ", ".join(answer)]
    text = "\n".join(part for line in lines if line for part in textwrap.wrap(line, 34 * max(len(shown), 2))[:3])
    (figure.supxlabel if shown else figure.suptitle)(text, fontsize=7, family="monospace")
    canvas.draw()
    page = PIL.Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    page.quantize(COLOURS, dither=PIL.Image.Dither.NONE).save(path, optimize=True)


def looked_at(
    function: Callable[..., Any], make: Callable[[np.random.Generator], dict[str, Any]]
) -> tuple[dict[str, Any], list[Panel], list[Panel], list[str]]:
    """Return arguments of an example call, what of them and of the result can be shown, and the result in words."""
    arguments, result = called(function, make)
    given = [panel for name, value in arguments.items() for panel in panels(name, value)]
    return arguments, given, list(panels("result", result)), list(words("result", result))


def has_picture(name: str, function: Callable[..., Any], calls: Calls) -> bool:
    """Whether there is something to see: not of numbers alone, nor of what the pipeline calls unchecked."""
    if name.endswith("unchecked"):
        return False
    _, given, got, _ = looked_at(function, calls[function])
    return bool(given or got)


def called(function: Callable[..., Any], make: Callable[[np.random.Generator], dict[str, Any]]) -> tuple[dict, Any]:
    """Return arguments that a function takes, with large pictures if it takes these, and its result."""
    for enlarge in (True, False):
        arguments = make(np.random.default_rng(3))
        if enlarge:
            arguments = {name: enlarged(function, name, value) for name, value in arguments.items()}
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                result = function(**arguments)
                return arguments, list(islice(result, 8)) if inspect.isgenerator(result) else result
        except (ImguError, ValueError, IndexError, OverflowError):
            if not enlarge:
                raise
    raise AssertionError(function)


def enlarged(function: Callable[..., Any], name: str, value: Any) -> Any:
    """Return a picture to look at instead of a small one or noise, of the same kind; anything else as it is."""
    if name == "size" and isinstance(value, tuple):
        return SIDES
    annotation = str(inspect.signature(function).parameters[name].annotation)
    if not isinstance(value, np.ndarray) or value.ndim not in (2, 3):
        return value
    if "Image" not in annotation and "Mask" not in annotation:
        return value
    rgb = procedural_texture(*SIDES, seed=6).astype(float)
    if min(value.shape[:2]) >= FEWEST_PX:
        rgb = cv2.resize(rgb, value.shape[1::-1], interpolation=cv2.INTER_AREA)
    picture = rgb.mean(axis=2) if value.ndim == 2 else np.dstack([rgb[..., k % 3] for k in range(value.shape[2])])
    if value.dtype == bool:
        return picture > 100
    if np.issubdtype(value.dtype, np.integer):
        full = 255 if value.dtype == np.uint8 else float(value.max(initial=255))
        return (picture * full / 255).astype(value.dtype)
    return (picture / 255).astype(value.dtype)


def panels(name: str, value: Any, depth: int = 0) -> Iterator[Panel]:
    """Yield what of a value can be shown as a picture."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.size:
        if value.ndim == 3 and min(value.shape[:2]) >= FEWEST_PX:
            yield Panel(name, "image", value if value.shape[2] in (3, 4) else value[..., 0])
        elif value.ndim == 2 and (min(value.shape) >= FEWEST_PX or value.shape[1] > 2 * FEWEST_PX):
            yield Panel(name, "image", value)
        elif value.ndim == 2 and value.shape[1] == 2 and len(value) > 2 and value.dtype.kind == "f":
            yield Panel(name, "points", value)
        elif value.ndim == 2:
            yield Panel(name, "matrix", value)
        elif value.ndim == 1 and len(value) > 4:
            yield Panel(name, "curve", value)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type) and depth < 2:
        for field in dataclasses.fields(value):
            yield from panels(_joined(name, field.name), getattr(value, field.name, None), depth + 1)
    elif isinstance(value, (list, tuple)) and depth < 2:
        for index, each in enumerate(value[:4]):
            yield from panels(f"{name}[{index}]", each, depth + 1)


def words(name: str, value: Any, depth: int = 0) -> Iterator[str]:
    """Yield what of a value is said in words: numbers, names, short vectors."""
    if isinstance(value, enum.Enum):
        yield f"{name}={value.value}"
    elif isinstance(value, (bool, np.bool_, str)) or value is None:
        yield f"{name}={value}"
    elif isinstance(value, (int, float, np.integer, np.floating)):
        yield f"{name}={value:.4g}"
    elif isinstance(value, np.ndarray) and value.ndim <= 1 and 0 < value.size <= 4 and value.dtype.kind in "biuf":
        yield f"{name}={np.array2string(value, precision=3, separator=',')}"
    elif dataclasses.is_dataclass(value) and not isinstance(value, type) and depth < 1:
        for field in dataclasses.fields(value):
            yield from words(_joined(name, field.name), getattr(value, field.name, None), depth + 1)
    elif isinstance(value, (list, tuple)) and len(value) <= 4 and depth < 1:
        for index, each in enumerate(value):
            yield from words(f"{name}[{index}]", each, depth + 1)
    elif isinstance(value, np.dtype):
        yield f"{name}={value}"


def _joined(name: str, field: str) -> str:
    return field if name == "result" else f"{name}.{field}"


def _draw_panel(axes: Axes, panel: Panel, background: Panel | None) -> None:
    axes.set_title(panel.title, fontsize=7)
    axes.tick_params(labelsize=5, length=2)
    data = panel.data
    if panel.kind == "image":
        _draw_image(axes, data)
    elif panel.kind == "points":
        size = None if background is None else np.array(background.data.shape[1::-1])
        if background is not None and (data >= -1).all() and (data <= size).all():
            _draw_image(axes, background.data, alpha=0.5)
        else:
            axes.set_aspect("equal", "datalim")
            axes.invert_yaxis()
        axes.plot(data[:, 0], data[:, 1], "o", color="tab:red", markersize=2.5)
    elif panel.kind == "curve":
        axes.plot(data, "." if len(data) < 12 else "-", color="tab:blue", linewidth=1, markersize=3)
    else:
        shown = data[:8, :8].astype(float)
        axes.imshow(shown, cmap="coolwarm", vmin=-np.abs(shown).max(), vmax=np.abs(shown).max(), alpha=0.5)
        axes.set_axis_off()
        if shown.size <= 40:
            for (row, column), number in np.ndenumerate(shown):
                axes.text(column, row, f"{number:.2g}", ha="center", va="center", fontsize=4.5)


def _draw_image(axes: Axes, data: np.ndarray, alpha: float = 1.0) -> None:
    if data.ndim == 3:
        data = data[..., :3] / (1.0 if data.dtype.kind == "f" else float(max(data.max(), 1)))
        data = np.clip(data, 0, 1)
    axes.imshow(data.astype(float) if data.ndim == 2 else data, cmap="gray", interpolation="nearest", alpha=alpha)
    axes.set_axis_off()


def main() -> None:
    """Draw the pictures of all functions, or of those that are named."""
    from make_reference import CHAPTERS, functions_of

    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="functions; default: all")
    names = set(parser.parse_args().names)
    for chapter in CHAPTERS:
        calls = example_calls(chapter)
        for name, function in functions_of(chapter):
            if (not names or name in names) and has_picture(name, function, calls):
                draw(function, calls[function], IMAGES / f"{chapter}.{name}.png")


if __name__ == "__main__":
    main()
