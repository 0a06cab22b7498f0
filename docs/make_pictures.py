# SPDX-License-Identifier: Apache-2.0
"""Make the pictures of the README: python docs/make_pictures.py."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from imgu_ros.config.parameters import Parameters
from imgu_ros.image_files.images import write_image
from imgu_ros.localizer import Localizer
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.report.overlay import draw_result
from imgu_ros.simulate.sequence import Simulation, default_targets, simulate_sequence

_SHOWN = (4, 24, 44)
_WIDTH = 480


def main() -> None:
    """Draw the raw mosaic and the pose found in it, for three frames of the demo."""
    targets = default_targets()
    chain = Localizer(Parameters(), prepare_references(targets, Parameters()))
    columns = []
    for index, simulated in enumerate(islice(simulate_sequence(Simulation(), targets), max(_SHOWN) + 1)):
        result = chain.process(simulated.frame)
        if index in _SHOWN:
            raw = cv2.cvtColor(np.ascontiguousarray(simulated.frame.image.pixels), cv2.COLOR_GRAY2RGB)
            columns.append(np.vstack([_reduced(raw), _reduced(draw_result(result))]))
    write_image(Path(__file__).parent / "images" / "demo.jpg", np.hstack(columns))


def _reduced(picture: np.ndarray) -> np.ndarray:
    height = round(picture.shape[0] * _WIDTH / picture.shape[1])
    return cv2.resize(picture, (_WIDTH, height), interpolation=cv2.INTER_AREA)


if __name__ == "__main__":
    main()
