# SPDX-License-Identifier: Apache-2.0
"""A simulated sequence: raw frames with their exact truth, without any bag."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from imgu_ros.arguments import shown_value
from imgu_ros.errors import ParameterError
from imgu_ros.frame import Frame
from imgu_ros.reference.templates import TargetImage
from imgu_ros.simulate.capture import Capture, check_capture, views_of
from imgu_ros.simulate.exposure import WHITE, take_picture
from imgu_ros.simulate.geometry import image_from_template
from imgu_ros.simulate.path import CameraMotion, camera_from_scene_at
from imgu_ros.simulate.render import Renderer
from imgu_ros.simulate.scene import Scene, arrange_scene, size_of, template_matrix
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.simulate.truth import Truth, points_in_image, target_grid
from imgu_ros.vision.camera.angle_of_view import intrinsic_matrix
from imgu_ros.vision.camera.intrinsics import Camera, DistortionModel, make_camera
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
from imgu_ros.vision.formation.sensor import Sensor

#: Every frame leaves its truth in memory, and takes 25 bytes a pixel while it is made, up to four at once.
_MOST_FRAMES, _MOST_PIXELS = 1_000_000, 2**26
#: Part of the motion over which the path is well described by one cubic.
_SMOOTH_PROGRESS = 0.01
#: A plausible lens for each model.
TYPICAL_LENSES: dict[DistortionModel, tuple[float, ...]] = {
    DistortionModel.PLUMB_BOB: (-0.26, 0.09, 0.0008, -0.0005, -0.01),
    DistortionModel.RATIONAL_POLYNOMIAL: (0.35, 0.08, 0.0006, -0.0004, 0.01, 0.62, 0.16, 0.01),
    DistortionModel.EQUIDISTANT: (-0.03, 0.008, -0.004, 0.001),
    DistortionModel.THIN_PRISM: (0.35, 0.08, 0.0006, -0.0004, 0.01, 0.62, 0.16, 0.01, 0.002, -0.001, 0.0015, 0.0005),
    DistortionModel.TILTED: (-0.26, 0.09, 0.0008, -0.0005, -0.01, 0, 0, 0, 0, 0, 0, 0, 0.02, -0.015),
}


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """What to simulate.

    Attributes
    ----------
    width, height : image size, px, at least 32; even for Bayer
    frames : number of frames; one sequence goes once through the whole motion, however many frames it has
    rate_hz : frames a second
    seed : of texture, path and noise; the same seed gives the same frames
    layout : what a pixel measures: Bayer with a pattern, mono, RGB or BGR
    sensor : noise and bit depth; None: no noise, 16 bits
    motion : ranges of the camera's path
    camera : intrinsics; None: 61 degrees wide, without distortion
    capture : shutter, aperture, colour filters, exposure; by default an instant seen through a pinhole
    start_ns : stamp of the first frame
    frame_id : the camera's optical frame
    """

    width: int = 1280
    height: int = 720
    frames: int = 60
    rate_hz: float = 15.0
    seed: int = 0
    layout: PixelLayout = field(default_factory=lambda: PixelLayout(ColorModel.BAYER, BayerPattern.RGGB))
    sensor: Sensor | None = field(default_factory=Sensor)
    motion: CameraMotion = field(default_factory=CameraMotion)
    camera: Camera | None = None
    capture: Capture = field(default_factory=Capture)
    start_ns: int = 1_700_000_000_000_000_000
    frame_id: str = "camera_optical_frame"


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedFrame:
    """One frame and its truth.

    Attributes
    ----------
    frame : what the camera delivers
    truths : of every target of which it shows a part
    exposure : signal of a white surface in a pixel of sensitivity 1, 1 saturates
    """

    frame: Frame
    truths: tuple[Truth, ...]
    exposure: float


def simulate_sequence(
    simulation: Simulation | None = None,
    targets: Sequence[TargetImage] | None = None,
    *,
    workers: int = 1,
) -> Iterator[SimulatedFrame]:
    """Yield the frames of a sequence, in order of time.

    Parameters
    ----------
    simulation : what to simulate; None: 60 frames of 1280x720, Bayer RGGB, 8 bits
    targets : printed images before the camera, their widths known; None: `default_targets(1, seed)`
    workers : threads; more than 1 make frames ahead while the caller is busy, which spoils the timing of its work

    Raises
    ------
    ParameterError
        If the simulation is impossible; at the first frame.
    ShapeError
        If a target is not a picture, or the camera's lens cannot be inverted.
    """
    simulation = simulation or Simulation()
    check_simulation(simulation)
    camera = camera_of(simulation)
    scene = arrange_scene(targets if targets is not None else default_targets(1, simulation.seed), simulation.seed)
    renderer = Renderer(scene, camera, simulation.layout)
    if workers <= 1:
        for index in range(simulation.frames):
            yield _frame(index, simulation, scene, camera, renderer)
        return
    with ThreadPoolExecutor(workers) as pool:
        pending: deque[Future[SimulatedFrame]] = deque()
        try:
            for index in range(simulation.frames):
                pending.append(pool.submit(_frame, index, simulation, scene, camera, renderer))
                if len(pending) > workers:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            for future in pending:
                future.cancel()


def default_targets(count: int = 1, seed: int = 0, width_m: float = 0.5) -> tuple[TargetImage, ...]:
    """Return `count` procedural pictures of 1280x960 px, named poster, poster_2, ..."""
    return tuple(
        TargetImage("poster" if i == 0 else f"poster_{i + 1}", procedural_texture(seed=seed + 1000 * i), width_m)
        for i in range(count)
    )


def default_camera(
    width: int,
    height: int,
    model: DistortionModel | str = DistortionModel.PLUMB_BOB,
    distortion: ArrayLike = (),
    view_rad: float | None = None,
) -> Camera:
    """Return a camera `view_rad` wide (61 degrees when None), its principal point a little off the centre."""
    f = 0.85 * width if view_rad is None else intrinsic_matrix(width, height, view_rad)[0, 0]
    K = np.array([[f, 0, (width - 1) / 2 + 0.0035 * width], [0, f, (height - 1) / 2 - 0.004 * height], [0, 0, 1]])
    return make_camera(K, distortion, model, width, height)


def camera_of(simulation: Simulation) -> Camera:
    """Return the simulation's camera, the default one when it has none."""
    return simulation.camera or default_camera(simulation.width, simulation.height)


def stamp_ns(simulation: Simulation, index: int) -> int:
    """Return the stamp of frame `index`."""
    return simulation.start_ns + round(index * 1e9 / simulation.rate_hz)


def _frame(index: int, simulation: Simulation, scene: Scene, camera: Camera, renderer: Renderer) -> SimulatedFrame:
    stamp = stamp_ns(simulation, index)
    steps = max(simulation.frames - 1, 1)

    def pose_at(seconds: float) -> RigidTransform:
        progress = index / steps + seconds * simulation.rate_hz / steps
        return camera_from_scene_at(progress, simulation.motion, camera, scene.radius_m, simulation.seed)

    camera_from_scene, capture = pose_at(0.0), simulation.capture
    if capture.is_ideal:
        radiance = renderer.radiance(camera_from_scene)
    else:
        smooth_s = _SMOOTH_PROGRESS * steps / simulation.rate_hz
        radiance = renderer.mean_radiance(views_of(capture, pose_at, smooth_s, camera, scene))
    exposure = WHITE * capture.brightness(index, simulation.frames)
    rng = np.random.default_rng([simulation.seed, index, 0x5E45])
    light = radiance * np.float32(exposure)
    pixels, factor = take_picture(light, simulation.layout, capture, simulation.sensor, rng)
    pixels.flags.writeable = False
    frame = Frame(RawImage(pixels, simulation.layout), stamp, simulation.frame_id, camera)
    size = camera.width, camera.height
    truths = []
    for target, pose in zip(scene.targets, scene.poses, strict=True):
        camera_from_target = camera_from_scene.after(pose)
        H = image_from_template(camera.K, camera_from_target, template_matrix(target))
        if points_in_image(H, target_grid(size_of(target), 9), size, camera).any():
            truths.append(Truth(stamp, target.name, H, camera_from_target))
    return SimulatedFrame(frame, tuple(truths), exposure * factor)


def check_simulation(simulation: Simulation) -> None:
    """Raise ParameterError when size, frames, rate, capture or camera are impossible."""
    width, height = simulation.width, simulation.height
    if not (32 <= width <= 16384 and 32 <= height <= 16384):
        raise ParameterError(f"size: {width}x{height}; need 32x32 to 16384x16384")
    if width * height > _MOST_PIXELS:
        raise ParameterError(f"size: {width}x{height}: {width * height} px; need at most {_MOST_PIXELS}")
    if simulation.layout.color is ColorModel.BAYER and (width % 2 or height % 2):
        raise ParameterError(f"size: {width}x{height}; need even numbers for a Bayer pattern")
    if not 1 <= simulation.frames <= _MOST_FRAMES:
        raise ParameterError(f"frames: {shown_value(simulation.frames)}; need 1 to {_MOST_FRAMES}")
    if not (math.isfinite(simulation.rate_hz) and 1e-3 <= simulation.rate_hz <= 1e5):
        raise ParameterError(f"rate: {simulation.rate_hz:g} Hz; need 0.001 to 100000 Hz")
    check_capture(simulation.capture, height, simulation.rate_hz)
    if simulation.layout.pattern is None and simulation.capture.sensitivities != (1.0, 1.0, 1.0):
        got = ", ".join(f"{value:g}" for value in simulation.capture.sensitivities)
        raise ParameterError(f"sensitivities: {got} of {simulation.layout.color} pixels; need a Bayer pattern")
    camera = simulation.camera
    if camera is not None and (camera.width, camera.height) != (width, height):
        raise ParameterError(f"camera: {camera.width}x{camera.height}; need the image size, {width}x{height}")
