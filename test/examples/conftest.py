# SPDX-License-Identifier: Apache-2.0
"""A target and simulated frames of it, for the worked examples of CONTRIBUTING.md."""

from __future__ import annotations

from itertools import islice

import pytest

from imgu_ros.config.parameters import Parameters
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.simulate.sequence import SimulatedFrame, Simulation, default_targets, simulate_sequence


@pytest.fixture(scope="session")
def target_images() -> tuple[TargetImage, ...]:
    """One target, 0.5 m wide."""
    return default_targets(1, seed=3)


@pytest.fixture(scope="session")
def targets(target_images: tuple[TargetImage, ...]) -> tuple[Reference, ...]:
    """The target, prepared with default parameters."""
    return prepare_references(target_images, Parameters())


@pytest.fixture(scope="session")
def one_target_frames(target_images: tuple[TargetImage, ...]) -> tuple[SimulatedFrame, ...]:
    """Two Bayer frames of the target."""
    return tuple(islice(simulate_sequence(Simulation(width=640, height=480, frames=60, seed=3), target_images), 2))
