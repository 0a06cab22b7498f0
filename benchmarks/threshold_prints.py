# SPDX-License-Identifier: Apache-2.0
"""Trials of `benchmarks/thresholds.py` on drawn prints: nothing of the package's simulation is in their frames."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import cv2
import numpy as np
from print_drawing import Print, prints
from print_judging import FOUND_PX, NEES_95, corner_rms, squared_error
from print_views import RAW_PARAMETERS, View, views

from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.frame import Frame
from imgu_ros.localizer import Localizer
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references

#: Fine print, lines, tones, and areas without texture.
_KINDS = ("text_page", "table", "street_map", "photograph", "logo", "score_sheet", "price_label", "halftone")
#: Standard deviations of what the blurred frames are blurred by, px along x and y.
_BLUR_PX = (2.0, 0.7)


def samples(quick: bool) -> Callable[[], dict[str, float]]:
    """Accuracy and honesty on raw samples: tracked prints, as they are and in frames blurred more along x than y."""
    kinds, seeds, count = (_KINDS[:2], (21,), 4) if quick else (_KINDS, (21, 22), 10)
    clips = [(shown, [*views(shown, seed, count, "tracking")]) for seed in seeds for shown in prints(seed, kinds)]
    blurred = [(shown, [_blurred(view, index) for index, view in enumerate(clip)]) for shown, clip in clips[::3]]
    parameters = parameters_from(RAW_PARAMETERS, Parameters())

    def run() -> dict[str, float]:
        return _figures("", clips, parameters) | _figures("blurred_", blurred, parameters)

    return run


def _blurred(view: View, index: int) -> View:
    """Return a view through a wide point spread, each site by those of its colour; its noise is drawn again."""
    raw = view.frame.image
    pixels = raw.pixels.astype(np.float32)
    noise = np.random.default_rng(index)
    for y, x in ((0, 0), (0, 1), (1, 0), (1, 1)):
        # A site of the same colour is two px away.
        part = cv2.GaussianBlur(pixels[y::2, x::2], (0, 0), _BLUR_PX[0] / 2, sigmaY=_BLUR_PX[1] / 2)
        pixels[y::2, x::2] = part + noise.normal(0, 0.05 * np.sqrt(np.maximum(part, 1)))
    limit = np.iinfo(raw.pixels.dtype).max
    seen = np.clip(np.rint(pixels), 0, limit).astype(raw.pixels.dtype)
    frame = Frame(type(raw)(seen, raw.layout), view.frame.stamp_ns, view.frame.frame_id, view.frame.camera)
    return View(**{**{name: getattr(view, name) for name in view.__dataclass_fields__}, "frame": frame})


def _figures(prefix: str, clips: Sequence[tuple[Print, Sequence[View]]], parameters: Parameters) -> dict[str, float]:
    """Return figures of all frames but the first of each clip, which is for detection."""
    corner_px, squares, frames, seconds = [], [], 0, 0.0
    for shown, clip in clips:
        target = TargetImage(shown.name, shown.pixels, shown.width_m)
        localizer = Localizer(parameters, prepare_references([target], parameters))
        localizer.prepare()
        for index, view in enumerate(clip):
            start = time.thread_time()
            result = localizer.process(view.frame).first
            if not index:
                continue
            frames, seconds = frames + 1, seconds + time.thread_time() - start
            if result.homography is None or result.pose is None:
                continue
            corner = corner_rms(result.homography.H, view.H, shown)
            if corner <= FOUND_PX:
                pose = result.pose
                corner_px.append(corner)
                squares.append(squared_error(pose.R, pose.t, pose.covariance, view.R, view.t))
    nees = np.array(squares)
    figures = {
        "found": len(corner_px) / frames,
        "corner_px": float(np.median(corner_px)),
        "corner_95_px": float(np.percentile(corner_px, 95)),
        "inside": float((nees < NEES_95).mean()),
        "median_nees": float(np.median(nees)),
    }
    return {f"{prefix}{name}": value for name, value in figures.items()} | (
        {} if prefix else {"cpu_ms": 1e3 * seconds / frames}
    )
