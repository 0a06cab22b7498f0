# SPDX-License-Identifier: Apache-2.0
"""Frames of benchmarks/foreign_frames.py: rendered, kept in a folder, and read from there."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from foreign_rows import ForeignTake
from foreign_scenes import RATE_HZ, TARGET_WIDTH_M, exposed, film, homography, mosaic

from imgu_ros.types import Floats, Image

#: Frames of another revision are rendered anew: to be raised with every change of what is rendered.
REVISION = 1
#: Frame at whose time the test print is rendered; its seed; samples on a side of a pixel. Through a lens and a long
#: exposure a sample is dark or bright by chance all over the blurred edge.
DOTS_INDEX, _DOTS_SEED = 5, 99
_DOTS_SIDE, _BLURRED_DOTS_SIDE = 8, 20
#: The brightest thousandth of a frame's pixels fills so much of the well, where nothing is to be saturated.
_BRIGHT = 0.85
#: From the print, as the world has it, to the package's target: x right, y up, z out of the print.
_WORLD_FROM_TARGET = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class ForeignFrame:
    """A frame and its truth.

    Attributes
    ----------
    pixels : (H, W) as published
    H : H_image_template in ideal pixels, of the middle row's exposure
    R, t : camera_from_target
    saturated : share of pixels
    covered : share of the target behind the hand
    """

    pixels: Image
    stamp_ns: int
    H: Floats
    R: Floats
    t: Floats
    saturated: float
    covered: float


@dataclass(eq=False)
class FrameStore:
    """The frames of a take in a folder of its own, rendered when they are not there.

    Attributes
    ----------
    take : what is rendered
    folder : of all takes
    """

    take: ForeignTake
    folder: Path
    _own: Path = field(init=False)

    def __post_init__(self) -> None:
        """Make the folder."""
        self._own = self.folder / self.take.row.name / str(self.take.seed)
        self._own.mkdir(parents=True, exist_ok=True)

    def frame(self, index: int) -> ForeignFrame:
        """Return a frame."""
        stored = self._stored(f"frame_{index:03}", lambda: self._render(index))
        published = "mosaic_8bit" if self.take.row.film else "mosaic"
        return ForeignFrame(
            stored[published],
            int(stored["stamp_ns"]),
            stored["H_image_template"],
            stored["R_camera_from_target"],
            stored["t_camera_from_target"],
            float((stored["mosaic"] >= self.take.sensor.white).mean()),
            float(stored["covered"]),
        )

    def dots(self) -> tuple[ForeignTake, Floats]:
        """Return the take with the test print, and its light at the time of frame `DOTS_INDEX`."""
        shown = self.take.with_dots()

        def render() -> dict[str, Any]:
            side = _BLURRED_DOTS_SIDE if shown.optics.lens_radius_m else _DOTS_SIDE
            light = _renderer(shown, 0).light(shown.optics, shown.path, DOTS_INDEX / RATE_HZ, side, _DOTS_SEED)
            return {"light": light.astype(np.float32)}

        return shown, self._stored("dots", render)["light"]

    def _stored(self, name: str, render: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        path = self._own / f"{name}.npz"
        if path.exists():
            with np.load(path) as file:
                if int(file.get("revision", 0)) == REVISION:
                    return dict(file)
        made = render() | {"revision": REVISION}
        np.savez_compressed(path, **made)
        return made

    def _render(self, index: int) -> dict[str, Any]:
        take = self.take
        exposure = self._exposure
        light = self._light(index)
        raw = exposed(mosaic(light, take.sensor) * exposure, take.sensor, np.random.default_rng([take.seed, index, 7]))
        R, t = take.path(index / RATE_HZ)
        made = {
            "mosaic": raw,
            "K": take.optics.K,
            "dist": np.array(take.optics.distortion),
            "H_image_template": homography(take.optics.K, R, t, take.size),
            "R_camera_from_target": R @ _WORLD_FROM_TARGET,
            "t_camera_from_target": t,
            "width_m": TARGET_WIDTH_M,
            "stamp_ns": 10**9 + round(index * 1e9 / RATE_HZ),
            "exposure_s": take.optics.exposure_s,
            "row_time_us": take.optics.row_time_s * 1e6,
            "black_level": take.sensor.black,
            "white_level": take.sensor.white,
            "pattern": take.sensor.pattern,
            "channel_gains": np.array(take.sensor.gains),
            "full_well_e": take.sensor.full_well_e,
            "read_noise_e": take.sensor.read_noise_e,
            "covered": take.covered[index] if take.covered else 0.0,
        }
        if take.row.film:
            made["mosaic_8bit"] = film(raw, take.sensor)
        return made

    @cached_property
    def _exposure(self) -> float:
        """What turns light into shares of the well: the same in all frames; the first frame decides."""
        path = self._own / "take.json"
        if path.exists():
            kept = json.loads(path.read_text())
            if kept["revision"] == REVISION:
                return float(kept["exposure"])
        signal = mosaic(self._light(0), self.take.sensor)
        if self.take.saturated is None:
            exposure = _BRIGHT / float(np.quantile(signal, 0.999))
        else:
            exposure = 1 / float(np.quantile(signal, 1 - self.take.saturated))
        path.write_text(json.dumps({"revision": REVISION, "exposure": exposure}) + "\n")
        cv2.imwrite(str(self._own / "target.png"), self.take.target[..., ::-1])
        return exposure

    def _light(self, index: int) -> Floats:
        take = self.take
        if index not in self._lights:
            self._lights.clear()
            seed = 1000 * take.seed + index
            self._lights[index] = self._room(index).light(take.optics, take.path, index / RATE_HZ, take.row.side, seed)
        return self._lights[index]

    def _room(self, index: int) -> Any:
        number = index if self.take.hands else 0
        if number not in self._rooms:
            self._rooms.clear()
            self._rooms[number] = _renderer(self.take, number)
        return self._rooms[number]

    @cached_property
    def _rooms(self) -> dict[int, Any]:
        return {}

    @cached_property
    def _lights(self) -> dict[int, Floats]:
        return {}


def _renderer(take: ForeignTake, index: int) -> Any:
    """Return a renderer; only here Mitsuba is needed: frames that are kept are judged without it."""
    try:
        from foreign_renderer import ForeignRenderer
    except ImportError as error:
        raise SystemExit(
            f"Mitsuba: {error}; need the optional dependency `foreign` and LLVM, or frames in --cache"
        ) from None
    return ForeignRenderer(take.scene(index))
