# SPDX-License-Identifier: Apache-2.0
"""A recording of two posters, and the results of its replay."""

from __future__ import annotations

from pathlib import Path

import pytest

from imgu_ros.config.files import read_parameter_file
from imgu_ros.config.values import parameters_from
from imgu_ros.replay.recording import record_simulation
from imgu_ros.replay.replay import replay
from imgu_ros.simulate.sequence import Simulation, default_targets


@pytest.fixture(scope="session")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Folders of the recording and of the results; tests do not change them."""
    root = tmp_path_factory.mktemp("view")
    recording, results = root / "recording", root / "results"
    record_simulation(recording, Simulation(width=480, height=360, frames=8), targets=default_targets(2, 0))
    parameters = parameters_from(read_parameter_file(recording / "params.yaml"))
    replay([recording], results, parameters, record=["keypoints"])
    return recording, results
