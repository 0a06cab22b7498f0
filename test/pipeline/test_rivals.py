# SPDX-License-Identifier: Apache-2.0
"""Of two targets that share a part, the one that is shown is found, and never both."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imgu_ros.config.parameters import Parameters
from imgu_ros.localizer import Localizer
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.simulate.sequence import Simulation, simulate_sequence
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.simulate.truth import corner_error

SIZE = (640, 480)


def design(own: int, share: float) -> np.ndarray:
    """A picture of which `share` of the area is its own, the rest that of the design."""
    picture, other = procedural_texture(640, 480, 1), procedural_texture(640, 480, 100 + own)
    picture = picture.copy()
    side = np.sqrt(share)
    rows, columns = round(480 * side), round(640 * side)
    picture[200 : 200 + rows, 150 : 150 + columns] = other[200 : 200 + rows, 150 : 150 + columns]
    return picture


@pytest.mark.parametrize("share", [0.03, 0.2])
def test_the_one_that_is_shown_is_found(share: float) -> None:
    targets = [TargetImage(f"label_{own}", design(own, share), 0.3) for own in range(3)]
    localizer = Localizer(Parameters(), prepare_references(targets, Parameters()))
    simulation = Simulation(*SIZE, frames=30, seed=4)
    shown = replace(targets[1], width_m=0.3)
    for index, simulated in enumerate(simulate_sequence(simulation, [shown])):
        if index % 10 > 3:
            continue
        result = localizer.process(simulated.frame)
        found = [each for each in result if each.homography is not None]
        assert [each.name for each in found] == ["label_1"], index
        assert corner_error(found[0].homography.H, simulated.truths[0].H, SIZE, SIZE) < 1.0
        assert "label_" in result.references["label_0"].reason or index % 10


def test_a_target_that_replaces_another_of_its_design_takes_its_track() -> None:
    targets = [TargetImage(f"label_{own}", design(own, 0.2), 0.3) for own in range(2)]
    localizer = Localizer(Parameters(), prepare_references(targets, Parameters()))
    simulation = Simulation(*SIZE, frames=60, seed=4)
    sequences = [list(simulate_sequence(replace(simulation, frames=60), [target]))[:8] for target in targets]
    for index in range(8):
        shown = int(index >= 4)
        found = [each.name for each in localizer.process(sequences[shown][index].frame) if each.homography is not None]
        assert found == [f"label_{shown}"], index
