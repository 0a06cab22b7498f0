# SPDX-License-Identifier: Apache-2.0
"""Frames under a condition, with exact truth: a smooth sequence, or single frames that have nothing to do with another.

The truth is the geometry that the frames were made with: it depends on no estimator. The same condition, size and
seed give the same frames.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from imgu_ros.frame import Frame
from imgu_ros.reference.templates import TargetImage
from imgu_ros.simulate.capture import check_capture, views_of
from imgu_ros.simulate.conditions import Condition, SceneContent
from imgu_ros.simulate.disturbances import (
    TargetField,
    as_mosaic,
    cover_texture,
    covered,
    defocused,
    electrons_for_snr,
    flicker,
    highlighted,
    motion_blurred,
    vignetting,
)
from imgu_ros.simulate.exposure import WHITE, take_picture
from imgu_ros.simulate.geometry import image_from_template
from imgu_ros.simulate.levels import Levels
from imgu_ros.simulate.pictures import look_alike, repeated_picture
from imgu_ros.simulate.placing import camera_before_target
from imgu_ros.simulate.render import Renderer
from imgu_ros.simulate.scene import Scene, arrange_scene, size_of, template_matrix
from imgu_ros.simulate.sequence import TYPICAL_LENSES, SimulatedFrame, default_camera
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.simulate.truth import Truth, points_in_image, target_grid
from imgu_ros.types import Image
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
from imgu_ros.vision.formation.sensor import Sensor

TARGET, ALIKE = "poster", "alike"
WIDTH_M = 0.5
#: Frames in which a sequence goes once through its motion.
LAP_FRAMES = 120
_COPY = "copy"
_RATE_HZ = 30.0
_START_NS = 1_700_000_000_000_000_000
#: Gains of exposure steps, each for three frames: from one to the next the light doubles or halves.
_STEPS = (1.0, 2.0, 1.0, 0.5)
_STEP_FRAMES = 3
_SMOOTH_PROGRESS = 0.01
_BAYER = PixelLayout(ColorModel.BAYER, BayerPattern.RGGB)


@dataclass(frozen=True, slots=True)
class Trial:
    """Frames to be made.

    Attributes
    ----------
    condition : what happens
    width, height : of the frames, px, even
    frames : how many; a sequence goes through the whole motion in `LAP_FRAMES`, then again
    seed : of pictures, path and noise
    unrelated : single frames, each from anywhere on a path of its own, instead of a sequence
    """

    condition: Condition
    width: int = 1280
    height: int = 720
    frames: int = 120
    seed: int = 0
    unrelated: bool = False


def known_targets(trial: Trial) -> tuple[TargetImage, ...]:
    """Return the targets that an estimator is given, all `WIDTH_M` wide."""
    show, seed = trial.condition.show, trial.seed
    picture = _picture(show is SceneContent.REPEATED, seed)
    target = TargetImage(TARGET, picture, WIDTH_M)
    if show is SceneContent.LOOK_ALIKES:
        return target, TargetImage(ALIKE, look_alike(picture, seed + 500), WIDTH_M)
    return (target,)


def trial_frames(trial: Trial) -> Iterator[SimulatedFrame]:
    """Yield the frames, in order, each with the truths of the known targets in view.

    With two copies a frame has two truths of the same name.
    """
    for batch in trial_batches(trial, 1, workers=1):
        yield from batch


def trial_batches(trial: Trial, size: int = 24, *, workers: int = 2) -> Iterator[list[SimulatedFrame]]:
    """Yield the frames as `trial_frames` does, in lists; no frame is made while the caller is busy with a list.

    Parameters
    ----------
    trial : which frames
    size : frames in a list; the last may be shorter
    workers : threads that make a list
    """
    stage = _Stage(trial)
    with ThreadPoolExecutor(workers) as pool:
        for first in range(0, trial.frames, size):
            yield list(pool.map(stage.frame, range(first, min(first + size, trial.frames))))


class _Stage:
    """Scene, camera and light of a trial."""

    def __init__(self, trial: Trial) -> None:
        self._trial = trial
        c = trial.condition
        self._capture = replace(c.capture, row_time_s=c.readout / _RATE_HZ / trial.height)
        check_capture(self._capture, trial.height, _RATE_HZ)
        lens = c.lens or "plumb_bob"
        self._camera = default_camera(trial.width, trial.height, lens, TYPICAL_LENSES[c.lens] if c.lens else ())
        self._scene = _scene(trial)
        # Blur mixes neighbouring sites of different colours: all colours are needed everywhere.
        self._in_color = bool(c.blur_px or c.defocus_px)
        layout = PixelLayout(ColorModel.RGB) if self._in_color else _BAYER
        self._renderer = Renderer(self._scene, self._camera, layout)
        self._sensor = _sensor(c, self._scene.targets[0])
        size = size_of(self._scene.targets[0])
        self._field = TargetField(size, trial.seed) if c.occluded or c.specular else None
        self._cover = procedural_texture(1280, 960, trial.seed + 9000) if c.occluded else None
        self._shade = vignetting((trial.width, trial.height), c.vignetting) if c.vignetting else None

    def frame(self, index: int) -> SimulatedFrame:
        """Make one frame."""
        trial = self._trial
        # Everything that differs from frame to frame is a function of this.
        seed, progress = _anywhere(trial.seed, index) if trial.unrelated else (trial.seed, index / (LAP_FRAMES - 1))

        def pose_at(seconds: float) -> RigidTransform:
            p = progress + seconds * _RATE_HZ / (LAP_FRAMES - 1)
            return camera_before_target(p, trial.condition.placing, self._camera, self._scene, seed)

        pose = pose_at(0.0)
        exposure = WHITE * self._capture.brightness(index % LAP_FRAMES, LAP_FRAMES)
        light = self._light(index, progress, pose, pose_at, exposure)
        step = self._step(index)
        rng = np.random.default_rng([trial.seed, index, 0x7121])
        pixels, factor = take_picture(light * np.float32(step), _BAYER, self._capture, self._sensor, rng)
        pixels.flags.writeable = False
        stamp = _START_NS + round(index * 1e9 / _RATE_HZ)
        frame = Frame(RawImage(pixels, _BAYER), stamp, "camera_optical_frame", self._camera)
        return SimulatedFrame(frame, self._truths(pose, stamp), exposure * step * factor)

    def _light(
        self,
        index: int,
        progress: float,
        pose: RigidTransform,
        pose_at: Callable[[float], RigidTransform],
        exposure: float,
    ) -> Image:
        c, trial = self._trial.condition, self._trial
        if self._capture.is_ideal:
            light = self._renderer.radiance(pose)
        else:
            smooth_s = _SMOOTH_PROGRESS * (LAP_FRAMES - 1) / _RATE_HZ
            views = views_of(self._capture, pose_at, smooth_s, self._camera, self._scene)
            light = self._renderer.mean_radiance(views)
        light *= np.float32(exposure)
        phase = 2 * math.pi * (progress + 0.618 * index * trial.unrelated)
        if self._field is not None:
            light = self._with_field(light, pose, phase, exposure)
        if c.blur_px:
            light = motion_blurred(light, c.blur_px, 2 * phase)
        if c.defocus_px:
            light = defocused(light, c.defocus_px)
        if self._shade is not None:
            light = light * (self._shade if light.ndim == 2 else self._shade[:, :, None])
        if c.flicker:
            light = light * flicker(trial.height, c.flicker, 2.4 * index)
        return as_mosaic(light, BayerPattern.RGGB)

    def _step(self, index: int) -> float:
        """Return the factor of the light by exposure steps."""
        if not self._trial.condition.exposure_steps:
            return 1.0
        steps = _STEPS if not self._trial.unrelated else (0.5, 2.0)
        return steps[index // _STEP_FRAMES % len(steps)]

    def _with_field(self, light: Image, pose: RigidTransform, phase: float, exposure: float) -> Image:
        c, target, size = self._trial.condition, self._scene.targets[0], (self._trial.width, self._trial.height)
        assert self._field is not None
        H = image_from_template(self._camera.K, pose.after(self._scene.poses[0]), template_matrix(target))
        field = self._field.in_image(self._field.above(c.occluded or c.specular, phase), H, size)
        if self._cover is None:
            return highlighted(light, field)
        cover = cover_texture(self._cover, size, phase) * np.float32(exposure)
        return covered(light, field, cover if self._in_color else as_mosaic(cover, BayerPattern.RGGB))

    def _truths(self, pose: RigidTransform, stamp: int) -> tuple[Truth, ...]:
        if self._trial.condition.show is SceneContent.ABSENT:
            return ()
        truths = []
        size = self._camera.width, self._camera.height
        for target, scene_from_target in zip(self._scene.targets, self._scene.poses, strict=True):
            camera_from_target = pose.after(scene_from_target)
            H = image_from_template(self._camera.K, camera_from_target, template_matrix(target))
            if points_in_image(H, target_grid(size_of(target), 9), size, self._camera).any():
                name = TARGET if target.name == _COPY else target.name
                truths.append(Truth(stamp, name, H, camera_from_target))
        return tuple(truths)


def _scene(trial: Trial) -> Scene:
    known, show = known_targets(trial), trial.condition.show
    if show is SceneContent.TWO_COPIES:
        return arrange_scene((known[0], replace(known[0], name=_COPY)), trial.seed)
    if show is SceneContent.ABSENT:
        return arrange_scene((TargetImage(ALIKE, look_alike(known[0].pixels, trial.seed + 500), WIDTH_M),), trial.seed)
    return arrange_scene(known, trial.seed)


def _sensor(condition: Condition, target: TargetImage) -> Sensor:
    if condition.snr is None:
        return Sensor()
    levels = Levels(target.pixels)
    mean = float(np.mean([levels.plane(0, color).mean() for color in "rggb"])) * WHITE
    return Sensor(full_well_e=electrons_for_snr(condition.snr, Sensor().read_noise_e) / mean)


def _anywhere(seed: int, index: int) -> tuple[int, float]:
    """Return a path and a place on it, for one single frame."""
    rng = np.random.default_rng([seed, index, 0xA11])
    return int(rng.integers(1 << 31)), float(rng.random())


@lru_cache(maxsize=8)
def _picture(repeated: bool, seed: int) -> Image:
    picture = repeated_picture(seed=seed) if repeated else procedural_texture(seed=seed)
    picture.flags.writeable = False
    return picture
