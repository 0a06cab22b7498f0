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
from imgu_ros.errors import NoConsensus, NotConfirmed
from imgu_ros.image.frame_image import FrameImage, develop
from imgu_ros.localizer import Localizer
from imgu_ros.reference.reference import Reference
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference.verification import confirmed_share, evidence, require_confirmed
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.simulate.negatives import absent_frames
from imgu_ros.simulate.sequence import TYPICAL_LENSES, SimulatedFrame, Simulation, default_camera, simulate_sequence
from imgu_ros.types import Matrix3
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
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
    assert confirmed_share(pictures_of(simulated), targets[0], moved, None) < 0.2


def test_another_target(one_target_frames: tuple[SimulatedFrame, ...], targets: tuple[Reference, ...]) -> None:
    simulated = one_target_frames[0]
    assert confirmed_share(pictures_of(simulated), targets[1], simulated.truths[0].H, None) < 0.1


@pytest.mark.parametrize("model", ["plumb_bob", "equidistant"])
def test_through_a_lens(target_images: tuple, targets: tuple[Reference, ...], model: str) -> None:
    camera = default_camera(640, 480, model, TYPICAL_LENSES[model])
    simulation = Simulation(width=640, height=480, frames=2, seed=3, camera=camera)
    for simulated in simulate_sequence(simulation, target_images[:1]):
        H = simulated.truths[0].H
        assert confirmed_share(pictures_of(simulated), targets[0], H, camera) > 0.85
        with pytest.raises(NotConfirmed):
            require_confirmed(pictures_of(simulated), targets[0], H, None)


def test_a_part_in_view_and_a_darker_frame(
    one_target_frames: tuple[SimulatedFrame, ...], targets: tuple[Reference, ...]
) -> None:
    """What lies outside the frame does not count; brightness and contrast do not matter."""
    simulated = one_target_frames[0]
    image = simulated.frame.image
    pixels = np.ascontiguousarray(image.pixels[:, : image.pixels.shape[1] // 2 // 2 * 2] // 3 + 20)
    half = replace(simulated, frame=replace(simulated.frame, image=replace(image, pixels=pixels)))
    assert confirmed_share(pictures_of(half), targets[0], simulated.truths[0].H, None) > 0.8


@pytest.mark.parametrize(("hidden", "scatter"), [(0.3, 0.25), (0.6, 0.25)])
def test_an_occluder_covers_connected_cells(
    one_target_frames: tuple[SimulatedFrame, ...], targets: tuple[Reference, ...], hidden: float, scatter: float
) -> None:
    simulated = one_target_frames[0]
    H = simulated.truths[0].H
    found = evidence(pictures_of(simulated, part(targets[0], H, hidden)), targets[0], H, None)
    assert found is not None and found.is_covered and found.is_confirming
    assert found.scatter < scatter


def test_a_picture_that_shares_the_header_of_a_photograph_is_not_the_photograph(data_dir: Path) -> None:
    """Photographs have large parts in which some cells look alike by chance."""
    photograph = cv2.cvtColor(cv2.imread(str(data_dir / "mcmaster" / "5.tif")), cv2.COLOR_BGR2RGB)
    other = cv2.cvtColor(cv2.imread(str(data_dir / "mcmaster" / "1.tif")), cv2.COLOR_BGR2RGB)
    parameters = parameters_from({"tracking.enabled": False})
    chain = Localizer(parameters, prepare_references([TargetImage("photograph", photograph, 0.5)], parameters))
    for index, simulated in enumerate(absent_frames([other], photograph, (1280, 720), 45, seed=18)):
        if index % 3 == 2:  # those with the header
            assert not chain.process(simulated.frame).first.status.found, index


def sheet(number: str, dull: bool = False) -> np.ndarray:
    """A page of words with a large number on it; dull: all of it in two greys that differ little."""
    rng = np.random.default_rng(5)
    image = np.full((480, 640), 235, np.uint8)
    for row in range(12):
        word = "".join(rng.choice(list("abdefghkmnprst "), 24))
        cv2.putText(image, word, (20, 40 + 36 * row), cv2.FONT_HERSHEY_SIMPLEX, 0.9, 30, 2, cv2.LINE_AA)
    cv2.rectangle(image, (220, 150), (430, 330), 235, -1)
    cv2.putText(image, number, (228, 280), cv2.FONT_HERSHEY_SIMPLEX, 3.2, 30, 12, cv2.LINE_AA)
    if dull:
        image = np.uint8(90 + np.float32(image) * (26 / 235))
    return image


def seen(image: np.ndarray, seed: int = 0) -> tuple[FrameImage, Matrix3]:
    """A mosaic, linear in the light and with noise, that shows a sheet over a plain wall, and where."""
    H = np.array([[0.62, -0.11, 120.0], [0.09, 0.6, 60.0], [0.00012, 0.00005, 1.0]])
    scene = cv2.warpPerspective(image, H, (640, 480), flags=cv2.INTER_AREA, borderValue=128)
    light = 255 * (cv2.GaussianBlur(scene, (0, 0), 0.7).astype(np.float32) / 255) ** 2.2
    noisy = light + np.random.default_rng(seed).normal(0, 1.2, light.shape)
    raw = RawImage(np.clip(np.rint(noisy), 0, 255).astype(np.uint8), PixelLayout(ColorModel.BAYER, BayerPattern.RGGB))
    p = Parameters()
    return develop(raw, p.raw, p.demosaic), H


def known(image: np.ndarray) -> Reference:
    pixels = np.repeat(image[..., None], 3, axis=2)
    return prepare_references([TargetImage("sheet", pixels, 0.3)], Parameters())[0]


def test_another_number_on_the_same_page_is_another_print() -> None:
    frame, H = seen(sheet("473"))
    assert confirmed_share(frame, known(sheet("473")), H, None) > 0.95
    with pytest.raises(NotConfirmed, match="the rest is another print"):
        require_confirmed(frame, known(sheet("128")), H, None)


def test_a_sticker_of_another_tone_over_the_number_is_an_occluder() -> None:
    covered = sheet("473")
    cv2.ellipse(covered, (330, 235), (120, 90), 20, 0, 360, 150, -1, cv2.LINE_AA)
    frame, H = seen(covered)
    found = require_confirmed(frame, known(sheet("473")), H, None)
    assert found.share < 0.95 and not found.is_another_print


def test_a_dull_print_is_confirmed() -> None:
    """Its cells have less contrast than those of prints that are black on white."""
    frame, H = seen(sheet("473", dull=True))
    assert confirmed_share(frame, known(sheet("473", dull=True)), H, None) > 0.9
    moved = np.array([[1, 0, 14.0], [0, 1, 9.0], [0, 0, 1]]) @ H
    assert confirmed_share(frame, known(sheet("473", dull=True)), moved, None) < 0.2


def test_a_bar_that_is_darker_in_the_frame_is_no_other_print() -> None:
    """A colour that is as light as the paper in the picture, and darker to a camera without white balance."""
    pale, dark = sheet("473"), sheet("473")
    for image, tone in ((pale, 232), (dark, 160)):
        for y in (60, 400):
            cv2.rectangle(image, (60, y), (420, y + 36), tone, -1)
    frame, H = seen(dark)
    found = require_confirmed(frame, known(pale), H, None)
    assert found.share < 0.95 and not found.is_another_print


def screened() -> np.ndarray:
    """A print of black dots on paper, 5 px apart, whose sizes show a picture: finer than what is compared."""
    rng = np.random.default_rng(8)
    tone = cv2.GaussianBlur(rng.random((640, 800)).astype(np.float32), (0, 0), 14)
    tone = cv2.normalize(tone, None, 0.25, 0.8, cv2.NORM_MINMAX)
    for _ in range(14):
        cv2.circle(tone, tuple(int(x) for x in rng.uniform((60, 60), (740, 580))), int(rng.uniform(15, 60)), 0.15, -1)
    y, x = np.mgrid[:640, :800]
    screen = 0.5 + 0.25 * (np.cos(2 * np.pi * (x + y) / 7.1) + np.cos(2 * np.pi * (x - y) / 7.1))
    return np.where(screen > tone, 235, 30).astype(np.uint8)


@pytest.mark.parametrize("scale", [0.32, 0.4, 0.47, 0.55])
def test_a_screen_of_dots_does_not_alias(scale: float) -> None:
    """Where dots are about as far apart as the samples, a picture and its frame show different moire patterns."""
    image = screened()
    # Rendered from a reduction by area, as by a lens: the frame itself has no other patterns than a camera's.
    fine = np.array([[4 * scale, -0.4 * scale, 300.0], [0.3 * scale, 4 * scale, 120.0], [0, 0, 1]])
    scene = cv2.warpPerspective(image, fine, (2560, 1920), flags=cv2.INTER_AREA, borderValue=128)
    light = 255 * (scene.astype(np.float32) / 255) ** 2.2
    light = cv2.resize(cv2.GaussianBlur(light, (0, 0), 2), (640, 480), interpolation=cv2.INTER_AREA)
    noisy = light + np.random.default_rng(1).normal(0, 1.0, light.shape)
    raw = RawImage(np.clip(np.rint(noisy), 0, 255).astype(np.uint8), PixelLayout(ColorModel.BAYER, BayerPattern.RGGB))
    p = Parameters()
    frame = develop(raw, p.raw, p.demosaic)
    H = np.array([[0.25, 0, -0.375], [0, 0.25, -0.375], [0, 0, 1]]) @ fine
    assert require_confirmed(frame, known(image), H, None).share > 0.9
    away = np.array([[1, 0, 9.0], [0, 1, 6.0], [0, 0, 1]]) @ H
    with pytest.raises(NotConfirmed):
        require_confirmed(frame, known(image), away, None)
