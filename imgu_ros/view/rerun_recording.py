# SPDX-License-Identifier: Apache-2.0
"""The results of a replay as a recording of the Rerun viewer.

Pictures and cameras of the recording are in one branch of its tree of entities, `world/camera/image`; what the replay
found is in branches of its own, which the viewer hides and shows: `world/camera/image/results` over the pictures,
`world/results` in space, `plots` and `status`.
"""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
import rerun as rr

from imgu_ros.errors import FileError
from imgu_ros.file_access.atomic_files import file_errors, part_path
from imgu_ros.messages.annotations import INLIER_COLOR, STATUS_COLORS
from imgu_ros.report.samples import jpeg_of
from imgu_ros.result import Status
from imgu_ros.shown_text import shown
from imgu_ros.types import Floats
from imgu_ros.view.recorded_frames import ScreenFrame
from imgu_ros.view.rerun_layout import IMAGE, OVERLAY, PLOTS, SPACE, STATES, blueprint
from imgu_ros.view.results_folder import ReplayResults, SeenFrame, SeenTarget
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.rotation import quaternion

#: Longest side of a picture, px, and its quality: a frame takes about 100 kB.
_LONGEST_SIDE, _QUALITY = 1280, 80
#: Of lines and points over pictures; Rerun's negative radii are in points of the screen, whatever the zoom.
_LINE_RADIUS = -1.5
_KEYPOINT_COLOR = (190, 190, 190)
_PATH_COLOR = (0, 114, 178)
_ELLIPSOID_COLOR = (230, 159, 0)
#: Okabe & Ito 2008.
_CURVE_COLORS = ((0, 114, 178), (230, 159, 0), (0, 158, 115), (204, 121, 167), (86, 180, 233), (213, 94, 0))
_TARGET_COLOR = (120, 120, 120)
#: Sine of the angle of a ray with the target's plane, below which it says nothing of where it meets it.
_LEAST_SLANT = 0.02
_UNKNOWN_COLOR = (130, 130, 130)
#: Squared radius of the ellipsoid that holds 95 % of a normal distribution of three dimensions (its chi-square).
_RADIUS_95 = 7.815**0.5
#: Ellipsoids along the path are at most so many, and nine of ten are shorter than this share of the path's extent.
_MOST_ELLIPSOIDS, _SHOWN_SHARE = 100, 0.06
#: Of the camera's pyramid, as a share of the distance to the target.
_IMAGE_DISTANCE = 0.25


def write_rerun(
    path: Path,
    results: ReplayResults,
    frames: Iterable[SeenFrame],
    pictures: Iterator[ScreenFrame],
    on_progress: Callable[[int, int | None], None] = lambda done, total: None,
) -> None:
    """Write a Rerun recording (.rrd).

    Parameters
    ----------
    path : the file, replaced when it exists
    results : of the replay
    frames : of the replay
    pictures : of the same frames; may end early
    on_progress : called after each frame with the number of frames done and of all

    Raises
    ------
    FileError
        If the file cannot be written, or the pictures are not those of the frames.
    """
    part = part_path(path)
    with file_errors(path):
        part.write_bytes(b"")  # what is wrong with the place is said at once
    identity = uuid.uuid5(uuid.NAMESPACE_URL, os.path.abspath(results.folder))
    try:
        with rr.RecordingStream("imgu_ros", recording_id=identity) as stream:
            rr.set_log_time_enabled(False)  # of this process: says nothing of the replay
            rr.set_log_tick_enabled(False)
            stream.save(part, default_blueprint=blueprint(results))
            _Writer(stream, results).write(frames, pictures, on_progress)
            stream.flush()
            stream.disconnect()
        with file_errors(path):
            os.replace(part, path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


class _Writer:
    """Writes a replay frame by frame; the path as a whole at the end."""

    def __init__(self, stream: rr.RecordingStream, results: ReplayResults) -> None:
        self._stream = stream
        self._results = results
        self._main = results.targets[0] if results.targets else ""
        #: Positions of the camera in the frame of each target, and their covariances.
        self._ways: dict[str, list[tuple[int, Floats, Floats]]] = {name: [] for name in results.targets}
        self._states: dict[str, tuple[str, str]] = {}
        self._pinhole: tuple[object, ...] = ()
        self._drawn: set[str] = set()

    def write(
        self,
        frames: Iterable[SeenFrame],
        pictures: Iterator[ScreenFrame],
        on_progress: Callable[[int, int | None], None],
    ) -> None:
        log = self._stream.log
        log("world", rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
        for place, name in enumerate(self._results.targets):
            colors = [STATUS_COLORS[status] for status in Status]
            values = [status.value for status in Status]
            log(f"{STATES}/{name}", rr.StateConfiguration(values=values, colors=colors), static=True)
            color = _CURVE_COLORS[place % len(_CURVE_COLORS)]
            for plot in ("residual", "confirmed", "distance"):
                log(f"{PLOTS}/{plot}/{name}", rr.SeriesLines(colors=[color], names=[name], widths=[1.5]), static=True)
        for index, frame in enumerate(frames):
            self._stream.set_time("frame", sequence=index)
            self._stream.set_time("time", timestamp=np.datetime64(frame.stamp_ns, "ns"))
            picture = next(pictures, None)
            if picture is not None and picture.frame.stamp_ns != frame.stamp_ns:
                raise FileError(
                    f"recording: frame {index} is of {picture.frame.stamp_ns} ns, the replay's of {frame.stamp_ns} ns; "
                    "need the recording that was replayed"
                )
            self._write_picture(picture, frame)
            for target in frame.targets:
                self._write_target(index, target)
            on_progress(index + 1, self._results.frames)
        self._stream.reset_time()
        for name in self._results.targets:
            self._write_way(name)

    def _write_picture(self, seen: ScreenFrame | None, frame: SeenFrame) -> None:
        if seen is None:
            return
        scale = 1.0
        if seen.picture is None:
            self._stream.log(IMAGE, rr.Clear(recursive=False))
            self._pinhole = ()
        else:
            scale = min(1.0, _LONGEST_SIDE / max(seen.picture.shape))
            jpeg = jpeg_of(seen.picture, _LONGEST_SIDE, _QUALITY)
            self._stream.log(IMAGE, rr.EncodedImage(contents=jpeg, media_type="image/jpeg"))
            height, width = seen.picture.shape[:2]
            self._write_pinhole(seen.frame.camera, (width, height), scale, frame)
        self._write_overlay(scale, frame)
        self._write_targets(seen.frame.camera, frame)

    def _write_pinhole(self, camera: Camera | None, size: tuple[int, int], scale: float, frame: SeenFrame) -> None:
        """Give the camera's pyramid the colour of the first target's status: grey where its place is that of before."""
        if camera is None:
            return
        main = next((t for t in frame.targets if t.name == self._main), None)
        has_pose = main is not None and main.pose is not None
        color = STATUS_COLORS[main.status] if main is not None and has_pose else _UNKNOWN_COLOR
        distance = float(np.linalg.norm(main.pose.t)) if main is not None and main.pose is not None else None
        if self._pinhole == (size, color, id(camera)):
            return
        self._pinhole = (size, color, id(camera))
        K = camera.K.copy()
        K[:2, 2] += 0.5  # its pixels begin at integers, ours have their centres there
        K[:2] *= scale
        self._stream.log(
            IMAGE,
            rr.Pinhole(
                image_from_camera=K,
                resolution=[scale * side for side in size],
                camera_xyz=rr.ViewCoordinates.RDF,
                image_plane_distance=None if distance is None else _IMAGE_DISTANCE * distance,
                color=color,
            ),
        )

    def _write_targets(self, camera: Camera | None, frame: SeenFrame) -> None:
        """Draw each target once, where the rays of its outline meet its plane in the first frame with its pose."""
        for target in frame.targets:
            outline = frame.overlay.outlines.get(target.name)
            if camera is None or target.pose is None or outline is None or target.name in self._drawn:
                continue
            normalized, valid = camera.undistort(outline)
            rays = np.column_stack((normalized, np.ones(len(outline))))
            R, t = target.pose.R, target.pose.t
            slant = rays @ R[:, 2]
            if not valid.all() or np.abs(slant).min() < _LEAST_SLANT:
                continue
            corners = (rays * (R[:, 2] @ t / slant)[:, None] - t) @ R
            self._drawn.add(target.name)
            strip = rr.LineStrips3D([np.vstack((corners, corners[:1]))], colors=[_TARGET_COLOR])
            self._stream.log(f"{self._space_of(target.name)}/target", strip, static=True)

    def _space_of(self, name: str) -> str:
        """Return the entity of a target's frame: that of the first target is the world."""
        return f"{SPACE}/{name}" if name == self._main else f"around/{name}"

    def _write_overlay(self, scale: float, frame: SeenFrame) -> None:
        statuses = {target.name: target.status for target in frame.targets}
        for name in self._results.targets:
            outline, entity = frame.overlay.outlines.get(name), f"{OVERLAY}/{name}"
            if outline is None:
                self._stream.log(entity, rr.Clear(recursive=False))
                continue
            points = (np.vstack((outline, outline[:1])) + 0.5) * scale
            color = STATUS_COLORS[statuses.get(name, Status.DETECTED)]
            self._stream.log(entity, rr.LineStrips2D([points], colors=[color], radii=_LINE_RADIUS))
        overlay = frame.overlay
        for entity, places, color in (
            ("inliers", overlay.inliers, INLIER_COLOR),
            ("keypoints", overlay.keypoints, _KEYPOINT_COLOR),
        ):
            if places is not None:
                dots = rr.Points2D((places + 0.5) * scale, colors=[color], radii=_LINE_RADIUS)
                self._stream.log(f"{OVERLAY}/{entity}", dots)

    def _write_target(self, index: int, target: SeenTarget) -> None:
        if target.name not in self._ways:
            return
        log, name, pose = self._stream.log, target.name, target.pose
        state = (target.status.value, target.reason)
        before = self._states.get(name, ("", ""))
        if state[0] != before[0]:
            log(f"{STATES}/{name}", rr.StateChange(state=state[0]))
        if state != before:
            text = ": ".join(filter(None, (state[0], shown(target.reason))))
            log(f"log/{name}", rr.TextLog(text, level="INFO" if target.status.found else "WARN"))
        self._states[name] = state
        if target.rms_px is not None:
            log(f"{PLOTS}/residual/{name}", rr.Scalars(target.rms_px))
        if target.confirmed_share is not None:
            log(f"{PLOTS}/confirmed/{name}", rr.Scalars(target.confirmed_share))
        if pose is None:
            return
        log(f"{PLOTS}/distance/{name}", rr.Scalars(float(np.linalg.norm(pose.t))))
        camera = pose.inverse()
        self._ways[name].append((index, camera.t, camera.covariance[:3, :3]))
        if name == self._main:
            x_y_z_w = camera.transform.numbers()[3:]
            log("world/camera", rr.Transform3D(translation=camera.t, quaternion=rr.Quaternion(xyzw=x_y_z_w)))

    def _write_way(self, name: str) -> None:
        """Write the whole path and the ellipsoids along it."""
        way = self._ways[name]
        if not way:
            return
        numbers = np.array([number for number, _, _ in way])
        positions = np.array([position for _, position, _ in way])
        strips = np.split(positions, np.flatnonzero(np.diff(numbers) > 1) + 1)
        log, entity = self._stream.log, self._space_of(name)
        log(f"{entity}/path", rr.LineStrips3D(strips, colors=[_PATH_COLOR]), static=True)
        if entity.startswith("around"):
            log(entity, rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
        chosen = np.unique(np.linspace(0, len(way) - 1, min(len(way), _MOST_ELLIPSOIDS)).astype(int))
        axes = [np.linalg.eigh(way[place][2]) for place in chosen]
        half_sizes = _RADIUS_95 * np.sqrt(np.maximum([values for values, _ in axes], 0))
        extent = float(np.ptp(positions, axis=0).max(initial=0)) or float(np.linalg.norm(positions[0]))
        times = _magnification(extent, float(np.percentile(half_sizes.max(axis=1), 90)))
        ellipsoids = rr.Ellipsoids3D(
            centers=positions[chosen],
            half_sizes=times * half_sizes,
            quaternions=[rr.Quaternion(xyzw=_quaternion(vectors)) for _, vectors in axes],
            colors=[_ELLIPSOID_COLOR],
        )
        log(f"{entity}/ellipsoids_95_percent_x{times:g}", ellipsoids, static=True)


def _magnification(extent: float, size: float) -> float:
    """Return the power of ten by which ellipsoids of such a size are seen on a path and do not hide it, at least 1."""
    if not size > 0 or not extent > 0:
        return 1.0
    return float(max(1.0, 10.0 ** np.floor(np.log10(_SHOWN_SHARE * extent / size))))


def _quaternion(axes: Floats) -> Floats:
    """Return x y z w of a rotation to principal axes, whose signs mean nothing."""
    return quaternion(axes * np.sign(np.linalg.det(axes)))
