# SPDX-License-Identifier: Apache-2.0
"""Rows of benchmarks/foreign_frames.py: what each shows, made of a seed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from foreign_hand import hand
from foreign_prints import dots, label, photograph, photographs, text_page
from foreign_scenes import (
    HEIGHT,
    RATE_HZ,
    TARGET_WIDTH_M,
    WIDTH,
    BayerSensor,
    CameraPath,
    RayOptics,
    RoomLamp,
    RoomScene,
    RoomShape,
    homography,
    linear,
    orbit,
    placed,
    rotation,
)

from imgu_ros.types import Floats, Image

#: Of a take: corners stay inside the frame so long, and there are so many hands.
FRAMES = 24
_FEWEST_PHOTOGRAPHS = 5
PATTERNS = ("rggb", "grbg", "gbrg", "bggr")


@dataclass(frozen=True)
class ForeignRow:
    """A row.

    Attributes
    ----------
    print : photograph, text or label
    speed_px : of the target's middle, a frame
    width_px : of the target at most; smaller where its corners would leave the frame
    axes : semi-axes of the ellipse round which its middle goes, px
    side : samples of a pixel are side x side
    """

    name: str
    title: str
    print: str = "photograph"
    speed_px: float = 6.0
    width_px: float = 340.0
    axes: tuple[float, float] = (100.0, 50.0)
    side: int = 6
    exposure_s: float = 0.0
    row_time_s: float = 0.0
    lens_radius_m: float = 0.0
    distortion: tuple[float, ...] = (0.0,) * 5
    saturated: tuple[float, float] | None = None
    film: bool = False
    hand: bool = False
    tracking: bool = True


ROWS = (
    ForeignRow("photograph", "photograph, clean"),
    ForeignRow("text", "text page, 39 px a frame", "text", 39.0, 330.0, (125.0, 85.0)),
    ForeignRow("label", "label with flat areas, 35 px a frame", "label", 35.0, 300.0, (130.0, 85.0)),
    ForeignRow(
        "blurred", "depth of field and motion blur", speed_px=10.0, exposure_s=0.012, lens_radius_m=0.004, side=8
    ),
    ForeignRow("film", "8 bits through a film's curve", film=True),
    ForeignRow("saturated", "1 to 3 % of the pixels saturated", saturated=(0.01, 0.03)),
    ForeignRow(
        "lens",
        "lens, plumb_bob",
        axes=(130.0, 75.0),
        speed_px=12.0,
        distortion=(-0.28, 0.09, 0.0008, -0.0006, -0.01),
    ),
    ForeignRow(
        "rolling", "rolling shutter, 30 us a row, 25 px a frame", speed_px=25.0, row_time_s=30e-6, axes=(120.0, 60.0)
    ),
    ForeignRow(
        "hand", "label under a hand, detection alone", "label", 35.0, 340.0, (90.0, 50.0), hand=True, tracking=False
    ),
)


@dataclass(frozen=True, eq=False)
class ForeignTake:
    """A row of one seed: everything that its frames are rendered from.

    Attributes
    ----------
    room : with the target
    hands : before it, of each frame; empty: none
    covered : share of the target behind the hand, of each frame; empty: none
    saturated : share of the first frame's pixels that are saturated; None: none
    """

    row: ForeignRow
    seed: int
    target: Image
    optics: RayOptics
    sensor: BayerSensor
    path: CameraPath
    room: RoomScene
    hands: Sequence[Sequence[RoomShape]] = ()
    covered: Sequence[float] = ()
    saturated: float | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the target's picture."""
        return (self.target.shape[1], self.target.shape[0])

    def scene(self, index: int) -> RoomScene:
        """Return what a frame shows."""
        if not self.hands:
            return self.room
        return replace(self.room, shapes=[*self.room.shapes, *self.hands[index]])

    def with_dots(self) -> ForeignTake:
        """Return the same with the test print in the target's place, and no hand."""
        print_ = dots()
        target = replace(self.room.shapes[0], to_world=_target_place(print_), picture=linear(print_))
        return replace(self, target=print_, room=replace(self.room, shapes=[target, *self.room.shapes[1:]]), hands=())


def take(row: ForeignRow, seed: int) -> ForeignTake:
    """Return a row's take: another seed has another picture, path, room, lamp and sensor."""
    rng = np.random.default_rng([seed, *row.name.encode()])
    files = photographs()
    if len(files) < _FEWEST_PHOTOGRAPHS:
        raise SystemExit("photographs: too few; set IMGU_DATA to a folder with kodak/*.png or mcmaster/*.tif")
    order = rng.permutation(len(files))
    target = {"photograph": lambda _: photograph(files[order[0]]), "text": text_page, "label": label}[row.print](rng)
    focal = rng.uniform(590, 610)
    optics = RayOptics(
        focal,
        focal * rng.uniform(0.998, 1.002),
        (WIDTH - 1) / 2 + rng.normal(0, 3),
        (HEIGHT - 1) / 2 + rng.normal(0, 3),
        distortion=tuple(float(d * rng.uniform(0.8, 1.1)) for d in row.distortion),
        exposure_s=row.exposure_s,
        row_time_s=row.row_time_s,
    )
    gains = (0.5 * rng.uniform(0.9, 1.1), 1.0, 0.65 * rng.uniform(0.9, 1.1))
    sensor = BayerSensor(pattern=PATTERNS[seed % 4], gains=gains)
    width_px, state = row.width_px, rng.bit_generator.state
    while True:
        rng.bit_generator.state = state
        path = orbit(rng, optics, width_px, row.speed_px, row.axes)
        if _inside(optics, path, (target.shape[1], target.shape[0])):
            break
        width_px *= 0.97
    if row.lens_radius_m:
        focus = optics.fx * TARGET_WIDTH_M / width_px * rng.uniform(1.12, 1.3)
        optics = replace(optics, lens_radius_m=row.lens_radius_m, focus_m=focus)
    room = _room(rng, target, [photograph(files[i]) for i in order[1:_FEWEST_PHOTOGRAPHS]])
    saturated = float(rng.uniform(*row.saturated)) if row.saturated else None
    made = ForeignTake(row, seed, target, optics, sensor, path, room, saturated=saturated)
    if row.hand:
        hands = [hand(rng, target.shape[0] / target.shape[1], path(index / RATE_HZ)) for index in range(FRAMES)]
        made = replace(made, hands=[shapes for shapes, _ in hands], covered=[share for _, share in hands])
    return made


def _inside(optics: RayOptics, path: CameraPath, size: tuple[int, int]) -> bool:
    w, h = size
    corners = np.array([[-0.5, -0.5, 1], [w - 0.5, -0.5, 1], [w - 0.5, h - 0.5, 1], [-0.5, h - 0.5, 1]])
    for index in range(FRAMES):
        xyw = corners @ homography(optics.K, *path(index / RATE_HZ), size).T
        xy = xyw[:, :2] / xyw[:, 2:]
        if (xy < 3).any() or (xy > (optics.width - 4, optics.height - 4)).any():
            return False
    return True


def _room(rng: np.random.Generator, target: Image, others: Sequence[Image]) -> RoomScene:
    """Return a target in a room: a wall with other pictures and boxes behind it, a lamp and a wide sky before it."""
    shapes = [RoomShape("rectangle", _target_place(target), picture=linear(target))]
    wall = rng.uniform(0.25, 0.5)
    shapes.append(RoomShape("rectangle", placed((0, 0, wall), (8, 8, 2)), tuple(rng.uniform(0.25, 0.6, 3))))
    for index, picture in enumerate(others):
        width = rng.uniform(0.25, 0.4)
        centre = ((-1, 1)[index % 2] * rng.uniform(0.2, 0.55), rng.uniform(-0.4, 0.4), wall - 0.01 - 0.002 * index)
        size = (width, width * picture.shape[0] / picture.shape[1], 2)
        place = placed(centre, size, rotation(0, 0, rng.normal(0, 0.15)))
        shapes.append(RoomShape("rectangle", place, picture=linear(picture)))
    for _ in range(4):
        angle, radius = rng.uniform(0, 2 * math.pi), rng.uniform(0.24, 0.42)
        centre = (radius * math.cos(angle), radius * math.sin(angle), rng.uniform(0.14, wall - 0.05))
        place = placed(centre, rng.uniform(0.05, 0.16, 3), rotation(*rng.uniform(0, 3, 3)))
        shapes.append(RoomShape("cube", place, tuple(rng.uniform(0.1, 0.8, 3))))
    lamp = (rng.choice((-1, 1)) * rng.uniform(0.6, 1.2), -rng.uniform(0.5, 1.2), -rng.uniform(1.2, 2.0))
    warm = rng.uniform(0.75, 1.0)
    radiance = 15.0 * math.hypot(*lamp) ** 2
    sky = tuple(float(v) for v in rng.uniform(0.04, 0.09) * np.array((1.0, 1.05, 1.15)))
    return RoomScene(shapes, RoomLamp(lamp, 0.15, (radiance, radiance * (1 + warm) / 2, radiance * warm)), sky)


def _target_place(target: Image) -> Floats:
    return placed((0, 0, 0), (TARGET_WIDTH_M, TARGET_WIDTH_M * target.shape[0] / target.shape[1], 2))
