# SPDX-License-Identifier: Apache-2.0
"""A short simulated sequence that the tests of the pipeline share."""

from __future__ import annotations

import sys
from itertools import islice
from pathlib import Path

import pytest

from imgu_ros.config.parameters import Parameters
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.simulate.sequence import SimulatedFrame, Simulation, default_targets, simulate_sequence

if (HERE := str(Path(__file__).parent)) not in sys.path:  # `marker_scenes`
    sys.path.append(HERE)
WIDTH, HEIGHT = 640, 480


@pytest.fixture(scope="session")
def target_images() -> tuple[TargetImage, ...]:
    """Two targets, 0.5 m wide, side by side."""
    return default_targets(2, seed=3)


@pytest.fixture(scope="session")
def targets(target_images: tuple[TargetImage, ...]) -> tuple[Reference, ...]:
    """The targets, prepared with default parameters."""
    return prepare_references(target_images, Parameters())


@pytest.fixture(scope="session")
def one_target_frames(target_images: tuple[TargetImage, ...]) -> tuple[SimulatedFrame, ...]:
    """Twelve successive Bayer frames of the first target, out of a smooth sequence of sixty."""
    sequence = simulate_sequence(Simulation(width=WIDTH, height=HEIGHT, frames=60, seed=3), target_images[:1])
    return tuple(islice(sequence, 12))


@pytest.fixture(scope="session")
def two_target_frames(target_images: tuple[TargetImage, ...]) -> tuple[SimulatedFrame, ...]:
    """Six Bayer frames of both targets."""
    return tuple(simulate_sequence(Simulation(width=1280, height=720, frames=6, seed=4), target_images))
