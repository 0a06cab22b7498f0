# SPDX-License-Identifier: Apache-2.0
"""Make the README's moving picture and the site's icon: python docs/make_pictures.py; needs the extra `test`."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from imgu_ros.config.parameters import Parameters
from imgu_ros.localizer import Localizer
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.report.overlay import draw_result
from imgu_ros.simulate.sequence import Simulation, default_targets, simulate_sequence

IMAGES = Path(__file__).parent / "images"
FRAMES = 60
RATE_HZ = 12
WIDTH = 880
#: Of the WebP encoder; 60 frames at this quality are below 2 MB.
QUALITY = 60


def main() -> None:
    """Write docs/images/demo.webp and favicon.png."""
    frames = [Image.fromarray(frame) for frame in animation(FRAMES)]
    frames[0].save(
        IMAGES / "demo.webp",
        save_all=True,
        append_images=frames[1:],
        duration=1000 // RATE_HZ,
        loop=0,
        quality=QUALITY,
        method=6,
    )
    cv2.imwrite(str(IMAGES / "favicon.png"), icon())


def animation(count: int) -> list[np.ndarray]:
    """Return frames of a simulated camera, the raw mosaic beside the pose that was found in it; (H, W, 3) uint8 RGB."""
    targets = default_targets()
    localizer = Localizer(Parameters(), prepare_references(targets, Parameters()))
    drawn = []
    for simulated in simulate_sequence(Simulation(frames=count), targets):
        result = localizer.process(simulated.frame)
        raw = cv2.cvtColor(np.ascontiguousarray(simulated.frame.image.pixels), cv2.COLOR_GRAY2RGB)
        drawn.append(np.hstack([_reduced(raw), _reduced(draw_result(result))]))
    return drawn


def icon() -> np.ndarray:
    """Return the site's icon: a plane seen at an angle; (64, 64, 4) uint8 BGRA."""
    picture = np.zeros((64, 64, 4), np.uint8)
    corners = np.array([[8, 16], [54, 6], [58, 50], [12, 58]], np.int32)
    cv2.fillPoly(picture, [corners], (136, 150, 0, 255), cv2.LINE_AA)
    for x, y in corners:
        cv2.circle(picture, (int(x), int(y)), 5, (80, 200, 255, 255), -1, cv2.LINE_AA)
    return picture


def _reduced(picture: np.ndarray) -> np.ndarray:
    height = round(picture.shape[0] * (WIDTH // 2) / picture.shape[1])
    return cv2.resize(picture, (WIDTH // 2, height), interpolation=cv2.INTER_AREA)


if __name__ == "__main__":
    main()
