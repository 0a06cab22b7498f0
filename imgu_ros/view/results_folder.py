# SPDX-License-Identifier: Apache-2.0
"""The results of a replay, read back from their folder: what was replayed, and what was found in every frame."""

from __future__ import annotations

import json
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from imgu_ros.bags.reading import open_bag
from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import EncodingError, FileError, ImguError, ParameterError
from imgu_ros.file_access.bounded_reading import file_bytes
from imgu_ros.files.frames_csv import C_COLUMNS, Q_COLUMNS, T_COLUMNS, read_rows
from imgu_ros.messages.annotations import decode_inliers
from imgu_ros.messages.features import decode_keypoints
from imgu_ros.messages.geometry import decode_outline
from imgu_ros.replay.result_files import FRAMES, RESULTS, SUMMARY
from imgu_ros.result import PoseStatus, Status
from imgu_ros.types import Points
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.rigid import rigid_transform

#: A summary of a hundred targets has 200 kB.
_MOST_SUMMARY_BYTES = 50_000_000
_OUTLINE = "geometry_msgs/msg/PolygonStamped"
_TYPES = {"/annotations": "foxglove_msgs/msg/ImageAnnotations", "/keypoints": "sensor_msgs/msg/PointCloud2"}
_NO_POINTS: Points = np.zeros((0, 2))
#: What frames are read and developed with: other parameters of another version may no longer exist.
_NEEDED_GROUPS = ("camera", "raw", "demosaic", "frames", "limits")


@dataclass(frozen=True, slots=True, eq=False)
class ReplayResults:
    """What a replay was of.

    Attributes
    ----------
    folder : of the results
    targets : names, that with the most poses first
    poses : number of poses of each, in the same order
    recording : what was replayed, absolute paths
    rate_hz : of the replay's pictures, where it was given; else 0
    image_topic, camera_info_topic : the latter empty when there was none
    parameters : those of reading and developing frames as in the replay, the others default
    frames : how many
    """

    folder: Path
    targets: tuple[str, ...]
    poses: tuple[int, ...]
    recording: tuple[Path, ...]
    rate_hz: float
    image_topic: str
    camera_info_topic: str
    parameters: Parameters
    frames: int


@dataclass(frozen=True, slots=True, eq=False)
class SeenTarget:
    """One target in one frame, as `frames.csv` has it; numbers are None where it has nothing."""

    name: str
    status: Status
    pose_status: PoseStatus
    reason: str
    rms_px: float | None
    confirmed_share: float | None
    pose: Pose | None


@dataclass(frozen=True, slots=True, eq=False)
class FrameOverlay:
    """What the results bag has to draw over a frame, raw px.

    Attributes
    ----------
    outlines : of each target that was found, by name
    inliers : points that agree with them
    keypoints : None: they were not recorded
    """

    outlines: Mapping[str, Points]
    inliers: Points
    keypoints: Points | None


@dataclass(frozen=True, slots=True, eq=False)
class SeenFrame:
    """One frame of a replay."""

    stamp_ns: int
    targets: tuple[SeenTarget, ...]
    overlay: FrameOverlay


def open_results(folder: Path) -> ReplayResults:
    """Read what a replay was of.

    Raises
    ------
    FileError
        If the folder holds no complete results.
    ParameterError
        If their parameters cannot be used.
    """
    path = folder / SUMMARY
    if not path.exists():
        raise FileError(f"{folder}: has no {SUMMARY}; need a folder that `imgu replay` has completed")
    try:
        summary = json.loads(file_bytes(path, "the summary of a replay", _MOST_SUMMARY_BYTES))
        source = summary["source"]
        counted = [(str(one["name"]), int(one["pose_status"][PoseStatus.METRIC.value])) for one in summary["targets"]]
        counted.sort(key=lambda one: -one[1])
        values = {
            str(name): value
            for name, value in summary["parameters"].items()
            if str(name).partition(".")[0] in _NEEDED_GROUPS
        }
        return ReplayResults(
            folder=folder,
            targets=tuple(name for name, _ in counted),
            poses=tuple(count for _, count in counted),
            recording=tuple(Path(each) for each in source["recording"]),
            rate_hz=float(source["rate_hz"]),
            image_topic=str(source["image_topic"]),
            camera_info_topic=str(source["camera_info_topic"]),
            parameters=parameters_from(
                values | {"image_topic": source["image_topic"], "camera_info_topic": source["camera_info_topic"]}
            ),
            frames=int(summary["frames"]),
        )
    except ParameterError as error:
        raise FileError(f"{path}: {error}") from None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        reason = " ".join(repr(error).split())[:80]
        raise FileError(f"{path}: {reason}; need what this version's `imgu replay` writes") from None


def seen_frames(results: ReplayResults) -> Generator[SeenFrame]:
    """Yield every frame of a replay, in order, in bounded memory.

    Raises
    ------
    FileError, BagError
        If frames.csv or the results bag cannot be read.
    """
    overlays = _overlays(results)
    for rows in _rows_of_frames(results.folder / FRAMES):
        overlay = next(overlays, FrameOverlay({}, _NO_POINTS, None))
        try:
            yield SeenFrame(int(rows[0]["stamp_ns"]), tuple(map(_seen, rows)), overlay)
        except (ValueError, ImguError) as error:
            reason = " ".join(str(error).split())[:80]
            raise FileError(f"{results.folder / FRAMES}: {reason}; need what a replay writes") from None


def _rows_of_frames(path: Path) -> Iterator[Sequence[Mapping[str, str]]]:
    """Yield the rows of each frame: one for each target."""
    rows: list[Mapping[str, str]] = []
    for row in read_rows(path):
        if rows and (row["stamp_ns"] != rows[0]["stamp_ns"] or any(row["target"] == each["target"] for each in rows)):
            yield rows
            rows = []
        rows.append(row)
    if rows:
        yield rows


def _seen(row: Mapping[str, str]) -> SeenTarget:
    pose = None
    if row["tx"]:
        transform = rigid_transform([float(row[name]) for name in (*T_COLUMNS, *Q_COLUMNS)])
        covariance = np.array([float(row[name]) for name in C_COLUMNS]).reshape(6, 6)
        pose = Pose(transform.R, transform.t, covariance, 0.0)
    return SeenTarget(
        row["target"],
        Status(row["status"]),
        PoseStatus(row["pose_status"]),
        row["reason"],
        _number(row["rms_px"]),
        _number(row["confirmed_share"]),
        pose,
    )


def _number(text: str) -> float | None:
    return float(text) if text else None


def _overlays(results: ReplayResults) -> Iterator[FrameOverlay]:
    """Yield what the results bag has of each frame: it has one status for every frame, before what is drawn."""
    outlines = {f"/targets/{name}/outline": name for name in results.targets}
    found: dict[str, Points] = {}
    inliers, keypoints = _NO_POINTS, None
    is_first = True
    with open_bag([results.folder / RESULTS], limits=results.parameters.limits) as bag:
        for message in bag.messages(["/status", "/annotations", "/keypoints", *outlines]):
            if message.topic == "/status":
                if not is_first:
                    yield FrameOverlay(found, inliers, keypoints)
                found, inliers, keypoints, is_first = {}, _NO_POINTS, None, False
            elif message.type_name != _TYPES.get(message.topic, _OUTLINE):
                continue  # of somebody else
            elif message.topic in outlines:
                outline = decode_outline(message.message)
                if len(outline) and np.isfinite(outline).all():
                    found[outlines[message.topic]] = outline
            elif message.topic == "/annotations":
                inliers = _finite(decode_inliers(message.message))
            else:
                keypoints = _keypoint_places(message.message)
    if not is_first:
        yield FrameOverlay(found, inliers, keypoints)


def _finite(points: Points) -> Points:
    return np.asarray(points[np.isfinite(points).all(axis=1)])


def _keypoint_places(message: Any) -> Points | None:
    try:
        keypoints, _ = decode_keypoints(message)
    except EncodingError:
        return None
    return _finite(keypoints.xy)
