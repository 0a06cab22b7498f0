# SPDX-License-Identifier: Apache-2.0
"""Frames and matches with known truth on which `thresholds.py` compares values of a constant.

A trial prepares its data once and returns a function that runs the package on them and returns its figures. The same
data serve every value, so that two values are compared frame by frame.
"""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from types import FrameType

import numpy as np

from imgu_ros.config.components import DevelopmentParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import EstimationError
from imgu_ros.frame import Frame
from imgu_ros.image.frame_image import FrameImage, develop_frame
from imgu_ros.image_files.images import read_image
from imgu_ros.localizer import Localizer
from imgu_ros.reference import verification
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.result import ReferenceResult, Status
from imgu_ros.simulate.chessboard import random_chessboard_view
from imgu_ros.simulate.conditions import PLAIN, Condition, condition_named
from imgu_ros.simulate.exposure import WHITE
from imgu_ros.simulate.geometry import image_from_template, rotation_about
from imgu_ros.simulate.path import CameraMotion
from imgu_ros.simulate.pictures import look_alike
from imgu_ros.simulate.placing import Placing, camera_before_target
from imgu_ros.simulate.plane_matches import KINDS, PlaneMatches, plane_matches
from imgu_ros.simulate.render import Renderer
from imgu_ros.simulate.scene import arrange_scene, size_of, template_matrix
from imgu_ros.simulate.sequence import SimulatedFrame, default_camera
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.simulate.trials import TARGET, Trial, known_targets, trial_frames
from imgu_ros.simulate.truth import NEES_95, Truth, corner_error, normalised_squared_error
from imgu_ros.types import Floats, Mask
from imgu_ros.vision.camera.calibration import calibrate
from imgu_ros.vision.camera.chessboard import Chessboard
from imgu_ros.vision.camera.planar_pose import planar_poses
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.rotation import log_so3
from imgu_ros.vision.formation.cfa import BayerPattern
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage
from imgu_ros.vision.formation.sensor import Sensor, expose
from imgu_ros.vision.projective.estimate import estimate_homography
from imgu_ros.vision.projective.homography import HomographyEstimate
from imgu_ros.vision.projective.transform import transform

#: Figures of one run by name: shares of 0 to 1, px, or counts.
Figures = dict[str, float]
#: Runs the package on a trial's data.
Run = Callable[[], Figures]

SIZE = (1280, 720)
#: An answer farther from the truth than this, px at the corners, is wrong.
WRONG_PX = 10.0
_BAYER = PixelLayout(ColorModel.BAYER, BayerPattern.RGGB)
_PERIOD_NS = 33_333_333


def data_folder() -> Path:
    """Return the folder of real images: `$IMGU_DATA`, or `../shared/data`; it need not exist."""
    return Path(os.environ.get("IMGU_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data")


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """Frames that are worked on in order.

    Attributes
    ----------
    name : what it shows
    targets : known to the localiser
    frames : with their truths
    related : the frames follow each other in time: the first is for detection and is not counted. Otherwise every
        frame is worked on alone.
    """

    name: str
    targets: tuple[TargetImage, ...]
    frames: Sequence[SimulatedFrame]
    related: bool = True


# --- running clips


def python_calls(function: Callable[[], object]) -> int:
    """Return how many Python functions a call enters, counting itself: unlike time, the same on every machine."""
    count = 0

    def counting(frame: FrameType, event: str, argument: object) -> None:
        nonlocal count
        del frame, argument
        count += event == "call"

    sys.setprofile(counting)
    try:
        function()
    finally:
        sys.setprofile(None)
    return count


class Ran:
    """What became of the frames of several clips."""

    def __init__(self) -> None:
        self.frames = self.found = self.tracked = self.wrong = self.calls = 0
        self.seconds = 0.0
        self.corner_px: list[float] = []
        self.nees: list[float] = []

    def add(self, clip: Clip, simulated: SimulatedFrame, results: Sequence[ReferenceResult]) -> None:
        """Count one frame of a clip."""
        for result in results:
            truths = [truth for truth in simulated.truths if truth.target == result.name]
            self.frames += bool(truths)
            if not result.status.found or result.homography is None:
                continue
            errors = [_corner_px(result, truth, clip, simulated) for truth in truths]
            if not errors or min(errors) > WRONG_PX:
                self.wrong += 1
                continue
            self.found += 1
            self.tracked += result.status is Status.TRACKED
            self.corner_px.append(min(errors))
            true = truths[int(np.argmin(errors))].pose
            if result.pose is not None and true is not None:
                squared = normalised_squared_error(true, result.pose.transform, result.pose.covariance)
                self.nees.append(math.inf if squared is None else squared)

    def figures(self, *names: str) -> Figures:
        """Return figures of those names."""
        corner, nees, frames = np.array(self.corner_px), np.array(self.nees), max(self.frames, 1)
        every = {
            "found": self.found / frames,
            "tracked": self.tracked / frames,
            "wrong": float(self.wrong),
            "corner_px": float(np.median(corner)) if len(corner) else math.nan,
            "corner_95_px": float(np.percentile(corner, 95)) if len(corner) else math.nan,
            "inside": float((nees < NEES_95).mean()) if len(nees) else math.nan,
            "median_nees": float(np.median(nees)) if len(nees) else math.nan,
            "calls": self.calls / frames,
            "cpu_ms": 1e3 * self.seconds / frames,
        }
        return {name: every[name] for name in names}


def run_clips(clips: Sequence[Clip], parameters: Parameters) -> Ran:
    """Show clips to localisers that are new for each."""
    ran = Ran()
    known: dict[tuple[int, ...], Localizer] = {}
    for clip in clips:
        key = tuple(id(target.pixels) for target in clip.targets)
        if key not in known:
            known[key] = Localizer(parameters, prepare_references(clip.targets, parameters))
            known[key].prepare()
        localizer = known[key]
        localizer.reset()
        for index, simulated in enumerate(clip.frames):
            if not clip.related:
                localizer.reset()
            results: list[ReferenceResult] = []
            start = time.thread_time()
            calls = python_calls(lambda: results.extend(localizer.process(simulated.frame)))  # noqa: B023
            if index or not clip.related:
                ran.seconds += time.thread_time() - start
                ran.calls += calls
                ran.add(clip, simulated, results)
    return ran


def _corner_px(result: ReferenceResult, truth: Truth, clip: Clip, simulated: SimulatedFrame) -> float:
    sizes = {target.name: size_of(target) for target in clip.targets}
    assert result.homography is not None
    height, width = simulated.frame.image.pixels.shape[:2]
    return corner_error(result.homography.H, truth.H, sizes[truth.target], (width, height), simulated.frame.camera)


# --- frames


@lru_cache(maxsize=64)
def clip_of(name: str, frames: int, seed: int = 0, unrelated: bool = False, readout: float = 0.0) -> Clip:
    """Return a clip under a named condition; `readout` overrides the condition's rolling shutter."""
    condition = condition_named(name)
    if readout:
        condition = replace(condition, name=f"readout-{readout:g}", readout=readout)
    return _clip(condition, frames, seed, unrelated)


def _clip(condition: Condition, frames: int, seed: int, unrelated: bool) -> Clip:
    trial = Trial(condition, *SIZE, frames, seed, unrelated)
    return Clip(condition.name, known_targets(trial), tuple(trial_frames(trial)), not unrelated)


def fast_clip(frames: int, turns: float, seed: int) -> Clip:
    """Return a clip in which the target rolls and drifts several times as fast as under `plain`."""
    motion = CameraMotion(turns=turns)
    return _clip(replace(PLAIN, name=f"fast-{turns:g}", placing=Placing(motion=motion)), frames, seed, False)


def thinned(clip: Clip, kept: Sequence[int]) -> Clip:
    """Return a clip of which only the frames of those numbers have arrived."""
    return replace(clip, frames=[clip.frames[index] for index in kept if index < len(clip.frames)])


@lru_cache(maxsize=16)
def _renderer(seed: int) -> tuple[TargetImage, Renderer]:
    target = TargetImage(TARGET, procedural_texture(seed=seed), 0.5)
    return target, Renderer(arrange_scene([target]), default_camera(*SIZE), _BAYER)


def rendered(renderer: Renderer, pose: RigidTransform, index: int, seed: int) -> SimulatedFrame:
    """Return one frame with sensor noise, seen from `pose`, camera_from_scene."""
    target, scene_from_target = renderer.scene.targets[0], renderer.scene.poses[0]
    pixels = expose(renderer.radiance(pose) * np.float32(WHITE), Sensor(), np.random.default_rng([seed, index, 0x7157]))
    camera, stamp = default_camera(*SIZE), index * _PERIOD_NS
    camera_from_target = pose.after(scene_from_target)
    H = image_from_template(camera.K, camera_from_target, template_matrix(target))
    frame = Frame(RawImage(pixels, _BAYER), stamp, "camera", camera)
    return SimulatedFrame(frame, (Truth(stamp, target.name, H, camera_from_target),), WHITE)


def shaken_clip(shake_px: float, frames: int, seed: int, every: int = 1) -> Clip:
    """Return a clip in which the camera is turned by some px at random in every frame, or in every n-th."""
    target, renderer = _renderer(seed)
    camera, rng = default_camera(*SIZE), np.random.default_rng([seed, round(shake_px), 0x54A])
    shown = []
    R = np.eye(3)
    for index in range(frames):
        if index % every == 0:
            angle, size = rng.uniform(0, 2 * math.pi), shake_px / camera.K[0, 0] / 2
            R = rotation_about(np.array([math.cos(angle), math.sin(angle), 0.0]), size)
        pose = camera_before_target(index / 119, Placing(width_share=0.4), camera, renderer.scene, seed)
        shown.append(rendered(renderer, RigidTransform(R @ pose.R, R @ pose.t), index, seed))
    return Clip(f"shaken-{shake_px:g}", (target,), shown)


def replaced_clip(frames: int, seed: int) -> Clip:
    """Return a clip in which, after three frames, a picture that has the upper 30 % of the target takes its place."""
    target, renderer = _renderer(seed)
    alike = replace(target, pixels=look_alike(target.pixels, seed + 500))
    other = Renderer(arrange_scene([alike]), default_camera(*SIZE), _BAYER)
    shown = []
    for index in range(frames):
        pose = camera_before_target(index / 119, Placing(width_share=0.4), default_camera(*SIZE), renderer.scene, seed)
        there = index < 3
        simulated = rendered(renderer if there else other, pose, index, seed)
        shown.append(simulated if there else replace(simulated, truths=()))
    return Clip("replaced", (target,), shown)


def photograph_clip(path: Path, frames: int, seed: int, width_share: float | None) -> Clip:
    """Return unrelated views of a real photograph."""
    target = TargetImage(path.stem, read_image(path), 0.5)
    renderer = Renderer(arrange_scene([target]), default_camera(*SIZE), _BAYER)
    shown = []
    for index in range(frames):
        placing, path_seed = Placing(width_share=width_share), seed + 1000 * index
        pose = camera_before_target(index / frames, placing, default_camera(*SIZE), renderer.scene, path_seed)
        shown.append(rendered(renderer, pose, index, seed))
    return Clip(path.stem, (target,), shown, related=False)


def photographs() -> list[Path]:
    """Return the real photographs; without the data none."""
    return sorted((data_folder() / "kodak").glob("*.png"))


# --- tracking

_TRACKING = (
    "plain", "occlusion-40", "occlusion-60", "outside-50", "noise-snr-10", "rolling-shutter", "size-10", "tilt-60",
    "plumb-bob",
)  # fmt: skip
_BLURRED = ("blur-5", "blur-10", "blur-15", "defocus-4", "defocus-8")
#: Frames that arrive where some are dropped.
_UNEVEN = (0, 1, 2, 4, 5, 6, 9, 10, 11, 12, 16, 17, 19, 22, 23, 24, 29, 30)


def _tracking_parameters() -> Parameters:
    # The share of frames that the tracker holds is measured, so that a search need not be thorough.
    return parameters_from({"search.thorough": False}, Parameters())


def tracking(quick: bool) -> Run:
    """Sequences under conditions that keep or break a track, and some in which another picture replaces the target."""
    names, frames = (_TRACKING[:3], 4) if quick else (_TRACKING, 10)
    clips = [clip_of(name, frames) for name in names]
    clips += [replaced_clip(4 if quick else 7, seed) for seed in range(1 if quick else 5)]
    return lambda: run_clips(clips, _tracking_parameters()).figures("tracked", "wrong", "corner_px", "calls", "cpu_ms")


def blur(quick: bool) -> Run:
    """Sequences with motion blur or out of focus."""
    names, frames = (("blur-10", "defocus-8"), 4) if quick else (_BLURRED, 10)
    clips = [clip_of(name, frames, seed) for name in names for seed in ((0,) if quick else (0, 1))]
    return lambda: run_clips(clips, _tracking_parameters()).figures(
        "tracked", "wrong", "corner_px", "corner_95_px", "calls"
    )


def reach(quick: bool) -> Run:
    """Sequences of a shaken camera, fast motion and dropped frames: share of frames that the tracker reaches."""
    frames = 4 if quick else 10
    shakes = (4.0, 60.0) if quick else (2.0, 8.0, 20.0, 40.0, 80.0, 160.0)
    shaken = [shaken_clip(shake, frames, seed) for seed, shake in enumerate(shakes)]
    thrown = [] if quick else [shaken_clip(60.0, frames, 7, every=4), shaken_clip(200.0, frames, 8, every=4)]
    uneven = [thinned(fast_clip(8 if quick else 31, 3.0, seed), _UNEVEN) for seed in ((0,) if quick else (0, 1, 2))]

    def run() -> Figures:
        figures: Figures = {}
        for name, clips in (("shaken", shaken), ("thrown", thrown), ("uneven", uneven)):
            if not clips:
                continue
            ran = run_clips(clips, _tracking_parameters())
            figures |= {f"{name}_{key}": value for key, value in ran.figures("tracked", "wrong", "calls").items()}
        return figures

    return run


# --- detection

_DETECTION = (
    "plain", "size-10", "size-200", "size-300", "tilt-60", "tilt-70", "outside-50", "occlusion-60", "blur-10",
    "defocus-8", "repeated-texture", "equidistant",
)  # fmt: skip
_ABSENT = ("no-target", "look-alikes")


def detection(quick: bool) -> Run:
    """Single frames of targets that are small, near, steep, hidden, blurred, or not there."""
    frames = 1 if quick else 4
    clips = [clip_of(name, frames, 0, True) for name in (_DETECTION[1:4:2] if quick else _DETECTION)]
    absent_names, seeds = (_ABSENT[:1], (0,)) if quick else (_ABSENT, (0, 1))
    absent = [clip_of(name, frames, seed, True) for name in absent_names for seed in seeds]
    photos = [] if quick else photographs()[::8]
    clips += [photograph_clip(path, frames, seed, (0.12, 0.5)[seed % 2]) for seed, path in enumerate(photos)]
    parameters = parameters_from({"tracking.enabled": False}, Parameters())

    def run() -> Figures:
        figures = run_clips(clips, parameters).figures("found", "wrong", "corner_px", "calls", "cpu_ms")
        figures["absent_wrong"] = run_clips(absent, parameters).figures("wrong")["wrong"]
        return figures

    return run


def many(quick: bool) -> Run:
    """Frames of one of many known targets, which the index must name."""
    count, shown = (8, 2) if quick else (40, 16)
    targets = tuple(
        TargetImage(f"picture_{seed}", procedural_texture(640, 480, seed=seed), 0.5) for seed in range(count)
    )
    clips = []
    for index in range(shown):
        chosen = targets[index * count // shown]
        renderer = Renderer(arrange_scene([chosen]), default_camera(*SIZE), _BAYER)
        placing = Placing(width_share=(0.1, 0.2, 0.4)[index % 3], tilt_rad=math.radians((10, 45)[index % 2]))
        pose = camera_before_target(index / shown, placing, default_camera(*SIZE), renderer.scene, index)
        clips.append(Clip(chosen.name, targets, [rendered(renderer, pose, index, index)], related=False))
    parameters = parameters_from({"tracking.enabled": False, "search.thorough": False}, Parameters())
    return lambda: run_clips(clips, parameters).figures("found", "wrong", "calls", "cpu_ms")


# --- comparing the whole of a target with the frame


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """A frame, and a target at its true place, or where a picture that shares a part of it makes it seem to be."""

    simulated: SimulatedFrame
    target: TargetImage
    H: Floats


def _true_places(names: Sequence[str], frames: int, seeds: Sequence[int]) -> Iterator[Compared]:
    for name in names:
        for seed in seeds:
            clip = clip_of(name, frames, seed, True)
            for simulated in clip.frames:
                yield Compared(simulated, clip.targets[0], simulated.truths[0].H)


def _shared_places(frames: int, seeds: Sequence[int]) -> Iterator[Compared]:
    """Yield look-alikes, which have the upper 30 % of the target: where they stand, the target seems to stand."""
    for seed in seeds:
        target = TargetImage(TARGET, procedural_texture(seed=seed), 0.5)
        alike = TargetImage(TARGET, look_alike(target.pixels, seed + 500), 0.5)
        renderer = Renderer(arrange_scene([alike]), default_camera(*SIZE), _BAYER)
        for index in range(frames):
            pose = camera_before_target(index / frames, Placing(), default_camera(*SIZE), renderer.scene, seed + index)
            simulated = rendered(renderer, pose, index, seed)
            yield Compared(simulated, target, simulated.truths[0].H)


def confirmation(quick: bool) -> Run:
    """Share of poses that are confirmed: of hidden and blurred targets, moved, and of pictures that share a part."""
    frames, seeds = (2, (0,)) if quick else (8, (0, 1, 2))
    groups = {
        "hidden": list(_true_places(("occlusion-60",), frames, seeds)),
        "blurred": list(_true_places(("blur-10", "defocus-8"), frames, seeds)),
        "shared": list(_shared_places(frames, seeds)),
    }
    rng = np.random.default_rng(0xC0F)
    groups["moved"] = [replace(case, H=_moved(case, rng)) for case in groups["blurred"]]
    parameters = Parameters()
    prepared = {
        id(c.target.pixels): prepare_references([c.target], parameters)[0] for group in groups.values() for c in group
    }
    pictures = {id(c): _pictures(c.simulated.frame, parameters) for group in groups.values() for c in group}

    def run() -> Figures:
        figures: Figures = {}
        for reference in prepared.values():
            for octaves in reference.templates.values():
                for octave in octaves:
                    octave.__dict__.pop("cells", None)  # they depend on two of the constants
        for name, group in groups.items():
            found = [verification.evidence(pictures[id(c)], prepared[id(c.target.pixels)], c.H, None) for c in group]
            shares = [0.0 if each is None else each.share for each in found]
            figures[f"{name}_confirmed"] = float(np.mean([each is not None and each.is_confirming for each in found]))
            is_right = name in ("hidden", "blurred")
            figures[f"{name}_{'least' if is_right else 'most'}"] = min(shares) if is_right else max(shares)
            figures[f"{name}_median"] = float(np.median(shares))
        return figures

    return run


def _moved(case: Compared, rng: np.random.Generator) -> Floats:
    """Return the case's homography moved by 12 to 40 px."""
    angle, px = rng.uniform(0, 2 * math.pi), rng.uniform(12, 40)
    shift = np.array([[1, 0, px * math.cos(angle)], [0, 1, px * math.sin(angle)], [0, 0, 1]])
    return np.asarray(shift @ case.H)


def _pictures(frame: Frame, parameters: Parameters) -> FrameImage:
    development = develop_frame(frame, DevelopmentParameters.of(parameters))
    assert development.image is not None, development.reason
    return development.image


# --- covariance


def covariance(quick: bool) -> Run:
    """Share of poses inside the 95 % ellipsoid: global shutter, rolling shutters of three speeds, blur and noise."""
    frames, seeds = (3, (0,)) if quick else (10, (0, 1, 2, 3))
    groups = {"plain": [clip_of("plain", frames, seed, True) for seed in seeds]}
    for readout in (0.2,) if quick else (0.05, 0.1, 0.2):
        groups[f"shutter_{readout:g}"] = [clip_of("plain", frames, seed, True, readout) for seed in seeds[:2]]
    if not quick:
        groups["noise"] = [clip_of("noise-snr-10", frames, seed, True) for seed in seeds[:2]]
        groups["blur"] = [clip_of("blur-5", frames, seed, True) for seed in seeds[:2]]
    parameters = parameters_from({"tracking.enabled": False}, Parameters())

    def run() -> Figures:
        figures: Figures = {}
        for name, clips in groups.items():
            ran = run_clips(clips, parameters)
            figures |= {f"{name}_{key}": value for key, value in ran.figures("inside", "median_nees").items()}
            if name == "plain":
                figures["plain_corner_px"] = ran.figures("corner_px")["corner_px"]
        return figures

    return run


def ambiguity(quick: bool) -> Run:
    """Poses from noisy points of a plane: how often the true one of the two planar poses is not among the solutions."""
    count, camera = 100 if quick else 1500, default_camera(*SIZE)
    rng = np.random.default_rng(5)
    grid = np.stack(np.meshgrid(np.linspace(-0.25, 0.25, 5), np.linspace(-0.18, 0.18, 4)), axis=-1).reshape(-1, 2)
    points = np.column_stack((grid, np.zeros(len(grid))))
    cases = []
    for _ in range(count):
        tilt, azimuth = math.radians(rng.uniform(5, 60)), rng.uniform(0, 2 * math.pi)
        R = rotation_about(np.array([math.cos(azimuth), math.sin(azimuth), 0.0]), tilt) @ np.diag([1.0, -1.0, -1.0])
        truth = RigidTransform(R, np.array([0.0, 0.0, math.exp(rng.uniform(math.log(0.8), math.log(12.0)))]))
        seen = points @ truth.R.T + truth.t
        pixels = seen[:, :2] / seen[:, 2:] @ camera.K[:2, :2].T + camera.K[:2, 2]
        cases.append((truth, pixels + rng.normal(0, 0.5, pixels.shape)))

    def run() -> Figures:
        missed = two = 0
        for truth, pixels in cases:
            try:
                solutions = planar_poses(grid, pixels, camera).solutions
            except EstimationError:
                continue
            two += len(solutions) > 1
            # Within a third of a turn from one solution to the other: twice the tilt.
            tilt = math.acos(min(1.0, abs(float(truth.R[2, 2]))))
            nearest = min(float(np.linalg.norm(log_so3(truth.R @ pose.R.T))) for pose in solutions)
            missed += nearest > max(tilt, math.radians(3))
        return {"true_pose_missing": missed / count, "two_solutions": two / count}

    return run


# --- consensus


def consensus(quick: bool) -> Run:
    """Robust homographies of matches of which 40 or 80 % are wrong, with truth, and of labelled real ones."""
    seeds = range(1 if quick else 2)
    shares, scales = ((0.8,), (0.4,)) if quick else ((0.4, 0.8), (1.0, 0.2, 0.05))
    made = [
        (plane_matches(kind, share, scale, seed), seed)
        for kind in KINDS[: 2 if quick else None]
        for share in shares
        for scale in scales
        for seed in seeds
    ]
    real = [] if quick else list(_labelled_matches())

    def run() -> Figures:
        recall, corner, nees, failed = [], [], [], 0
        for score in ("biweight", "truncated"):
            for matches, seed in made:
                try:
                    found = estimate_homography(matches.src, matches.dst, seed, score=score)
                except EstimationError:
                    failed += 1
                    continue
                recall.append(float(found.inliers[matches.true].mean()))
                corner.append(matches.corner_error(found.H))
                nees.append(matches.nees(found))
        figures = {
            "failed": failed / (2 * len(made)),
            "recall": float(np.mean(recall)),
            "corner_px": float(np.median(corner)),
            "corner_95_px": float(np.percentile(corner, 95)),
            "median_nees": float(np.median(nees)),
        }
        if real:
            figures["real_found"] = float(np.mean([_real_rmse(*pair) <= 5.0 for pair in real]))
        return figures

    return run


def _labelled_matches() -> Iterator[tuple[Floats, Floats, Mask]]:
    """Yield tentative matches of real pictures, shuffled, and which are labelled as right."""
    for folder, columns in (("homogr", [0, 1, 3, 4]), ("evd", [0, 1, 2, 3])):
        for path in sorted((data_folder() / "homography" / folder).glob("*_pts.txt")):
            cells = [line.split() for line in path.read_text().splitlines()]
            rows = np.array([[float(row[c]) for c in (*columns, -1)] for row in cells])
            rows = np.random.default_rng(0).permutation(rows)
            yield rows[:, :2], rows[:, 2:4], rows[:, 4] == 1


def _real_rmse(src: Floats, dst: Floats, labelled: Mask) -> float:
    try:
        H = estimate_homography(src, dst, 0).H
    except EstimationError:
        return math.inf
    mapped = src[labelled] @ H[:, :2].T + H[:, 2]
    away = mapped[:, :2] / mapped[:, 2:] - dst[labelled]
    return float(np.sqrt((away**2).sum(axis=1).mean()))


def lines(quick: bool) -> Run:
    """Matches on a line, which determine no plane, and narrow planes, which do: share that is accepted of each."""
    runs = 3 if quick else 30
    on_line: list[PlaneMatches] = []
    off_line: list[PlaneMatches] = []
    narrow: list[PlaneMatches] = []
    for seed in range(runs):
        rng = np.random.default_rng([seed, 0x11E])
        made = plane_matches("uniform", 0.0, 0.4, seed)
        along = np.column_stack((np.linspace(0, 1000, 12 + seed % 20), np.full(12 + seed % 20, 400.0)))
        wrong = rng.uniform(0, 1000, (2, 4 + seed % 12, 2))
        on_line.append(_with_wrong(made.H, along, wrong, rng))
        off_line.append(_with_wrong(made.H, np.vstack((along, rng.uniform(0, 1000, (3 + seed % 8, 2)))), wrong, rng))
        aspect = math.exp(rng.uniform(math.log(0.005), math.log(0.1)))
        strip = rng.uniform(0, 1, (60, 2)) * (1000, 1000 * aspect)
        narrow.append(_with_wrong(made.H, strip, rng.uniform(0, 1000, (2, 20, 2)), rng))

    def run() -> Figures:
        figures: Figures = {}
        for name, cases in (("line", on_line), ("off_line", off_line), ("narrow", narrow)):
            nees = []
            for seed, matches in enumerate(cases):
                try:
                    nees.append(matches.nees(estimate_homography(matches.src, matches.dst, seed)))
                except EstimationError:
                    continue
            figures[f"{name}_accepted"] = len(nees) / len(cases)
            # 95 % of chi-squared with the 8 degrees of freedom of a homography.
            figures[f"{name}_inside"] = float((np.array(nees) < 15.51).mean()) if nees else math.nan
        return figures

    return run


def _with_wrong(H: Floats, src: Floats, wrong: Floats, rng: np.random.Generator) -> PlaneMatches:
    """Return matches of points with their images under H, 1 px of noise, and wrong ones, (2, N, 2)."""
    src = src + rng.normal(0, 0.5, src.shape)
    dst = transform(H, src) + rng.normal(0, 1.0, src.shape)
    order = rng.permutation(len(src) + wrong.shape[1])
    return PlaneMatches(H, np.vstack((src, wrong[0]))[order], np.vstack((dst, wrong[1]))[order], order < len(src))


def prosac(quick: bool) -> Run:
    """Sorted matches, the best of which agree with another plane than the most: share in which the most win."""
    cases = []
    for seed in range(6 if quick else 40):
        rng = np.random.default_rng([seed, 0x9A5])
        most, other = plane_matches("uniform", 0.5, 0.4, seed), plane_matches("uniform", 0.0, 0.2, seed + 1000)
        first = rng.permutation(len(other.src))[: 5 + seed % 16]
        order = np.argsort(rng.normal(0, 1, len(most.src)) - most.true)
        src, dst = np.vstack((other.src[first], most.src[order])), np.vstack((other.dst[first], most.dst[order]))
        cases.append((most, src, dst))

    def run() -> Figures:
        right = calls = 0
        for seed, (most, src, dst) in enumerate(cases):
            found: list[HomographyEstimate] = []
            calls += python_calls(lambda: found.extend(_by_prosac(src, dst, seed)))  # noqa: B023
            right += bool(found) and most.corner_error(found[0].H) < WRONG_PX
        return {"most_win": right / len(cases), "calls": calls / len(cases)}

    return run


def _by_prosac(src: Floats, dst: Floats, seed: int) -> Iterator[HomographyEstimate]:
    try:
        yield estimate_homography(src, dst, seed, sampler="prosac", score="truncated")
    except EstimationError:
        return


def chance(quick: bool) -> Run:
    """Random pairs: share that is taken for a plane, over the share that is asked for (at most 1 is wanted)."""
    asked, runs = 0.1, 4 if quick else 8
    cases = [
        (count, extent, threshold, seed)
        for count in ((12, 50) if quick else (8, 12, 20, 50))
        for extent in ((640, 480), (3000, 60))
        for threshold in (1.0, 3.0, 10.0)
        for seed in range(runs)
    ]

    def run() -> Figures:
        accepted = {"biweight": 0, "truncated": 0}
        for score in accepted:
            for count, extent, threshold, seed in cases:
                rng = np.random.default_rng((seed, count))
                src, dst = rng.uniform(0, 1, (2, count, 2)) * extent
                try:
                    estimate_homography(
                        src, dst, rng, threshold_px=threshold, score=score, max_by_chance=asked, max_iterations=500
                    )
                except EstimationError:
                    continue
                accepted[score] += 1
        return {f"{score}_accepted_over_asked": n / len(cases) / asked for score, n in accepted.items()}

    return run


# --- calibration


def calibration(quick: bool) -> Run:
    """Sequences with right and wrong focal lengths: frames until the warning, false ones, and honesty of the poses."""
    frames, seeds = (12, (3,)) if quick else (30, (3, 4, 5))
    sequences = []
    for seed in seeds:
        target, renderer = _renderer(seed)
        rng = np.random.default_rng([seed, 0xCA1])
        tilt = math.radians(rng.uniform(20, 55))
        placing = Placing(tilt_rad=tilt, width_share=float(rng.uniform(0.25, 0.5)))
        shown = []
        for index in range(frames):
            pose = camera_before_target(index / 119, placing, default_camera(*SIZE), renderer.scene, seed)
            shown.append(rendered(renderer, pose, index, seed))
        sequences.append((target, shown))

    def run() -> Figures:
        figures: Figures = {}
        for error in (0.0, 0.01, 0.03):
            after, squared = [], []
            for target, shown in sequences:
                parameters = Parameters()
                localizer = Localizer(parameters, prepare_references([target], parameters))
                warned = frames
                for index, simulated in enumerate(shown):
                    result = localizer.process(_with_focal_error(simulated.frame, error))
                    if result.calibration is not None and result.calibration.warning:
                        warned = min(warned, index)
                    pose, true = result.first.pose, simulated.truths[0].pose
                    if pose is not None and true is not None:
                        squared.append(normalised_squared_error(true, pose.transform, pose.covariance) or math.inf)
                after.append(warned)
            key = f"{100 * error:g}_percent"
            figures[f"{key}_warned"] = float(np.mean([count < frames for count in after]))
            figures[f"{key}_frames_until"] = float(np.mean(after))
            figures[f"{key}_inside"] = float((np.array(squared) < NEES_95).mean())
        return figures

    return run


def _with_focal_error(frame: Frame, share: float) -> Frame:
    assert frame.camera is not None
    K = frame.camera.K.copy()
    K[(0, 1), (0, 1)] *= 1 + share
    return replace(frame, camera=replace(frame.camera, K=K))


def boards(quick: bool) -> Run:
    """Views of a chessboard of which two are wrong by 0.3 to 5 px: shares of these and of the others left out."""
    runs, board, camera = 2 if quick else 20, Chessboard(9, 6, 0.025), default_camera(*SIZE)
    cases = []
    for seed in range(runs):
        rng = np.random.default_rng([seed, 0xB0A])
        views = [random_chessboard_view(board, camera, rng).corners for _ in range(15)]
        views = [view + rng.normal(0, 0.1, view.shape) for view in views]
        for wrong in (3, 8):
            size = math.exp(rng.uniform(math.log(0.3), math.log(5.0)))
            views[wrong] = views[wrong] + rng.normal(0, size, views[wrong].shape)
        cases.append(views)

    def run() -> Figures:
        wrong_left, right_left, focal = 0, 0, []
        for views in cases:
            found = calibrate(board.corners(), views, *SIZE, "plumb_bob")
            used = {view.index for view in found.views}
            wrong_left += len({3, 8} - used)
            right_left += len(set(range(15)) - {3, 8} - used)
            focal.append(abs(found.camera.K[0, 0] / camera.K[0, 0] - 1))
        return {
            "wrong_left_out": wrong_left / (2 * runs),
            "right_left_out": right_left / (13 * runs),
            "focal_error_percent": 100 * float(np.median(focal)),
        }

    return run
