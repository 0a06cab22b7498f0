# SPDX-License-Identifier: Apache-2.0
"""The share of a target that looks as it should, against shares known by construction."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import NoConsensus
from imgu_ros.image.frame_image import FrameImage, develop
from imgu_ros.localizer import Localizer
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference.verification import COARSE, _supported, confirmed_share, require_confirmed
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.simulate.negatives import absent_frames
from imgu_ros.simulate.sequence import TYPICAL_LENSES, SimulatedFrame, Simulation, default_camera, simulate_sequence
from imgu_ros.types import Matrix3
from imgu_ros.vision.projective.transform import transform


def pictures_of(simulated: SimulatedFrame, covered: np.ndarray | None = None) -> FrameImage:
    """The frame's pictures, a convex part of it painted over by a texture of its own."""
    image = simulated.frame.image
    pixels = image.pixels.copy()
    if covered is not None:
        mask = np.zeros(pixels.shape, np.uint8)
        cv2.fillConvexPoly(mask, np.rint(covered).astype(np.int32), 1)
        noise = cv2.resize(np.random.default_rng(0).integers(0, 256, (60, 80), np.uint8), pixels.shape[::-1])
        pixels[mask > 0] = noise[mask > 0]
    p = Parameters()
    return develop(replace(image, pixels=pixels), p.raw, p.demosaic)


def part(target: Reference, H: Matrix3, share: float) -> np.ndarray:
    """The left part of a target, in the image."""
    width, height = target.size
    right = share * width - 0.5
    return transform(H, [[-0.5, -0.5], [right, -0.5], [right, height - 0.5], [-0.5, height - 0.5]])


def test_all_of_a_target_in_view(one_target_frames: tuple[SimulatedFrame, ...], targets: tuple[Reference, ...]) -> None:
    for simulated in one_target_frames[::4]:
        assert confirmed_share(pictures_of(simulated), targets[0], simulated.truths[0].H, None) > 0.85


@pytest.mark.parametrize("hidden", [0.25, 0.5, 0.75])
def test_a_known_part_hidden(
    one_target_frames: tuple[SimulatedFrame, ...], targets: tuple[Reference, ...], hidden: float
) -> None:
    simulated = one_target_frames[0]
    H = simulated.truths[0].H
    whole = confirmed_share(pictures_of(simulated), targets[0], H, None)
    pictures = pictures_of(simulated, part(targets[0], H, hidden))
    share = confirmed_share(pictures, targets[0], H, None)
    assert share == pytest.approx(whole * (1 - hidden), abs=0.07)
    if hidden > 0.7:
        with pytest.raises(NoConsensus, match="looks as it should"):
            require_confirmed(pictures, targets[0], H, None)
    else:
        require_confirmed(pictures, targets[0], H, None)


@pytest.mark.parametrize("shift", [(25, 0), (0, -40), (300, 200), (4000, 0)])
def test_another_place(
    one_target_frames: tuple[SimulatedFrame, ...], targets: tuple[Reference, ...], shift: tuple[float, float]
) -> None:
    simulated = one_target_frames[0]
    moved = np.array([[1, 0, shift[0]], [0, 1, shift[1]], [0, 0, 1]]) @ simulated.truths[0].H
    assert confirmed_share(pictures_of(simulated), targets[0], moved, None) < 0.1


def test_another_target(one_target_frames: tuple[SimulatedFrame, ...], targets: tuple[Reference, ...]) -> None:
    simulated = one_target_frames[0]
    for comparison in (COARSE,):
        share = confirmed_share(pictures_of(simulated), targets[1], simulated.truths[0].H, None, comparison)
        assert share < 0.2


@pytest.mark.parametrize("model", ["plumb_bob", "equidistant"])
def test_through_a_lens(target_images: tuple, targets: tuple[Reference, ...], model: str) -> None:
    camera = default_camera(640, 480, model, TYPICAL_LENSES[model])
    simulation = Simulation(width=640, height=480, frames=2, seed=3, camera=camera)
    for simulated in simulate_sequence(simulation, target_images[:1]):
        H = simulated.truths[0].H
        assert confirmed_share(pictures_of(simulated), targets[0], H, camera) > 0.85
        assert confirmed_share(pictures_of(simulated), targets[0], H, None) < 0.7


def test_a_part_in_view_and_a_darker_frame(
    one_target_frames: tuple[SimulatedFrame, ...], targets: tuple[Reference, ...]
) -> None:
    """What lies outside the frame does not count; brightness and contrast do not matter."""
    simulated = one_target_frames[0]
    image = simulated.frame.image
    pixels = np.ascontiguousarray(image.pixels[:, : image.pixels.shape[1] // 2 // 2 * 2] // 3 + 20)
    half = replace(simulated, frame=replace(simulated.frame, image=replace(image, pixels=pixels)))
    assert confirmed_share(pictures_of(half), targets[0], simulated.truths[0].H, None) > 0.8


def test_cells_that_are_alike_by_chance_do_not_count() -> None:
    """Such cells lie here and there; what is truly seen lies together, up to its borders."""
    rng = np.random.default_rng(1)
    counted = rng.uniform(size=(32, 40)) < 0.9
    shown = np.zeros((32, 40), bool)
    shown[:10] = counted[:10]
    by_chance = counted & ~shown & (rng.uniform(size=shown.shape) < 0.08)
    kept = _supported(shown | by_chance, counted)
    assert np.count_nonzero(kept & shown) >= 0.98 * np.count_nonzero(shown)
    assert np.count_nonzero(kept & by_chance) <= 0.25 * np.count_nonzero(by_chance)
    assert not (kept & ~(shown | by_chance)).any()
    assert (_supported(counted, counted) == counted).all()


def test_a_picture_that_shares_the_header_of_a_photograph_is_not_the_photograph(data_dir: Path) -> None:
    """Photographs have large parts in which some cells look alike by chance."""
    photograph = cv2.cvtColor(cv2.imread(str(data_dir / "mcmaster" / "5.tif")), cv2.COLOR_BGR2RGB)
    other = cv2.cvtColor(cv2.imread(str(data_dir / "mcmaster" / "1.tif")), cv2.COLOR_BGR2RGB)
    parameters = parameters_from({"tracking.enabled": False})
    chain = Localizer(parameters, prepare_references([TargetImage("photograph", photograph, 0.5)], parameters))
    for index, simulated in enumerate(absent_frames([other], photograph, (1280, 720), 45, seed=18)):
        if index % 3 == 2:  # those with the header
            assert not chain.process(simulated.frame).first.status.found, index
