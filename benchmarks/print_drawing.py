# SPDX-License-Identifier: Apache-2.0
"""Forty and more kinds of prints, drawn by a seed: another seed gives other text, shapes, colours and layout.

    python benchmarks/print_drawing.py --seed 1 --out prints/      # each as a PNG, and all on contact sheets

`prints(seed)` returns them. Photographs in them are every second one of the open data (`$IMGU_DATA`); without it,
landscapes are drawn by noise.
"""

from __future__ import annotations

import argparse
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import print_documents
import print_shapes
import print_surfaces
from print_canvas import Pixels

#: Printed width, m.
WIDTH_M = 0.2
#: Siblings of each print of the class `sibling`.
_SIBLINGS = 1

Drawing = Callable[[np.random.Generator], Pixels]
SeriesDrawing = Callable[[np.random.Generator, np.random.Generator], Pixels]

#: Classes, each with its kinds.
DRAWINGS: dict[str, tuple[Drawing, ...]] = {
    "ordinary": (
        print_documents.price_label, print_documents.greeting_card, print_documents.poster, print_documents.qr_code,
        print_documents.data_matrix, print_documents.business_card, print_documents.book_cover,
        print_shapes.tag_board, print_surfaces.wood, print_surfaces.terrazzo, print_surfaces.carpet,
        print_surfaces.concrete, print_surfaces.asphalt, print_surfaces.street_map, print_surfaces.photograph,
        print_surfaces.halftone, print_surfaces.comic,
    ),
    "line-like": (
        print_documents.text_page, print_documents.two_column_page, print_documents.form, print_documents.table,
        print_documents.score_sheet, print_shapes.barcode, print_surfaces.brushed_surface,
        print_surfaces.circuit_board, print_surfaces.line_art,
    ),
    "symmetric or periodic": (
        print_shapes.rotational_2, print_shapes.rotational_3, print_shapes.rotational_4,
        print_shapes.mirror_symmetric, print_shapes.tiles, print_shapes.checker, print_shapes.dots,
        print_shapes.stripes, print_shapes.chessboard, print_shapes.charuco, print_shapes.circle_grid,
        print_shapes.landing_pad, print_shapes.playing_card, print_documents.keyboard,
    ),
    "poor": (print_shapes.logo, print_shapes.silhouette, print_shapes.flat_board, print_shapes.tag),
}  # fmt: skip
#: The kinds of the class `sibling`.
SERIES: tuple[SeriesDrawing, ...] = (
    print_documents.header_poster, print_documents.number_label, print_documents.month, print_documents.ticket,
)  # fmt: skip
SIBLING = "sibling"
KINDS = tuple(d.__name__ for drawings in (*DRAWINGS.values(), SERIES) for d in drawings)


@dataclass(frozen=True, eq=False)
class Print:
    """A print.

    Attributes
    ----------
    name : `KIND_SEED`, with a letter for siblings
    kind : what it is
    group : its class: ordinary, line-like, symmetric or periodic, sibling, poor
    pixels : (H, W, 3) RGB uint8, sRGB, whole paper
    width_m : printed width, outer edge to outer edge
    siblings : prints of the same design with other contents
    """

    name: str
    kind: str
    group: str
    pixels: Pixels
    width_m: float = WIDTH_M
    siblings: tuple[Print, ...] = ()


def prints(seed: int, kinds: Iterable[str] = KINDS) -> list[Print]:
    """Return one print of each kind; the same seed gives the same print, whatever other kinds are asked for."""
    wanted = set(kinds)
    unknown = wanted - set(KINDS)
    if unknown:
        raise ValueError(f"kinds: {', '.join(sorted(unknown))}; need some of {', '.join(KINDS)}")
    made = [
        Print(f"{draw.__name__}_{seed}", draw.__name__, group, _contiguous(draw(_generator(seed, draw.__name__))))
        for group, drawings in DRAWINGS.items()
        for draw in drawings
        if draw.__name__ in wanted
    ]
    return made + [_series(seed, draw) for draw in SERIES if draw.__name__ in wanted]


def _series(seed: int, draw: SeriesDrawing) -> Print:
    kind = draw.__name__
    images: list[Pixels] = []
    number = 0
    while len(images) < 1 + _SIBLINGS:
        image = _contiguous(draw(_generator(seed, kind), _generator(seed, kind, 1 + number)))
        number += 1
        # Two draws may be alike: the same month.
        if not any(np.array_equal(image, other) for other in images):
            images.append(image)
    names = [f"{kind}_{seed}{chr(ord('a') + index)}" for index in range(len(images))]
    first, *others = (Print(name, kind, SIBLING, image) for name, image in zip(names, images, strict=True))
    return Print(first.name, kind, SIBLING, first.pixels, siblings=tuple(others))


def _generator(seed: int, kind: str, number: int = 0) -> np.random.Generator:
    return np.random.default_rng([seed, number, zlib.crc32(kind.encode())])


def _contiguous(pixels: Pixels) -> Pixels:
    return np.ascontiguousarray(pixels, np.uint8)


def contact_sheets(shown: list[Print], columns: int = 6, rows: int = 3, side: int = 300) -> Iterable[Pixels]:
    """Yield sheets with several prints each, siblings behind each other."""
    images = [(p.name, p.pixels) for each in shown for p in (each, *each.siblings)]
    for first in range(0, len(images), columns * rows):
        sheet = np.full((rows * (side + 20), columns * side, 3), 128, np.uint8)
        for index, (name, pixels) in enumerate(images[first : first + columns * rows]):
            scale = (side - 8) / max(pixels.shape[:2])
            small = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            y, x = index // columns * (side + 20), index % columns * side
            sheet[y + 20 : y + 20 + small.shape[0], x : x + small.shape[1]] = small
            cv2.putText(sheet, name, (x + 4, y + 14), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1)
        yield sheet


def main() -> None:
    """Write prints as PNG files."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="+", default=KINDS, help="of prints (default all)")
    parser.add_argument("--out", type=Path, required=True, help="folder")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    shown = prints(arguments.seed, arguments.kinds)
    for each in (p for first in shown for p in (first, *first.siblings)):
        cv2.imwrite(str(arguments.out / f"{each.name}.png"), each.pixels[..., ::-1])
    for number, sheet in enumerate(contact_sheets(shown)):
        cv2.imwrite(str(arguments.out / f"sheet_{number}.png"), sheet[..., ::-1])


if __name__ == "__main__":
    main()
