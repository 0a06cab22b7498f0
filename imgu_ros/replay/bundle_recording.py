# SPDX-License-Identifier: Apache-2.0
"""Where markers are on a rigid thing, by a recording of it: what `imgu make --measure` works from."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path

import numpy as np

from imgu_ros.bags.prefetch import Prefetch
from imgu_ros.bags.reading import open_bag
from imgu_ros.config.components import DevelopmentParameters, RecordedFramesParameters
from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import BagError, TooFewPoints
from imgu_ros.localizer import Localizer
from imgu_ros.pose.bundle_measurement import FEWEST_FRAMES, MeasuredBundle, measure_bundle
from imgu_ros.reference.marker import marker_image
from imgu_ros.reference.marker_layout import PlacedMarker
from imgu_ros.reference_kinds import make_references
from imgu_ros.replay.frame_source import FrameSource, ReadFrame, read_ahead, size_of
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.rotation import log_so3

#: A frame tells something new when a marker has moved by this share of its distance, or turned by so many rad: a camera
#: at rest repeats its errors.
_MOVED, _TURNED = 0.01, 0.01


def measure_recording(
    bags: Sequence[Path],
    markers: Sequence[PlacedMarker],
    parameters: Parameters,
    on_progress: Callable[[int, int | None], None] = lambda done, total: None,
    on_warning: Callable[[str], None] = lambda text: None,
) -> MeasuredBundle:
    """Return the places of markers on a thing relative to the first, by a recording.

    Parameters
    ----------
    bags : the parts of one recording
    markers : with their sizes, m; the origin first
    parameters : all parameters
    on_progress : called after each frame with the number of frames done and, when it is known, of all
    on_warning : called once for each warning

    Raises
    ------
    BagError, FileError, ParameterError
        If the recording cannot be read.
    TooFewPoints
        If it does not show the markers together, see `measure_bundle`; if it has no calibration.
    NotConverged
        If the adjustment does not settle.
    """
    images = [marker_image(str(marker), marker.family, marker.number, marker.size) for marker in markers]
    frames: list[Mapping[str, Pose]] = []
    said: set[str] = set()
    is_calibrated, count = False, 0
    with ExitStack() as stack:
        bag = stack.enter_context(open_bag(bags, limits=parameters.limits))
        source = FrameSource(bag, RecordedFramesParameters.of(parameters))
        developed = read_ahead(bag, source, DevelopmentParameters.of(parameters))
        ahead = stack.enter_context(closing(Prefetch(developed, size_of)))
        localizer = Localizer(parameters, make_references(images, parameters))
        for read in _readable(ahead):
            count += 1
            is_calibrated = is_calibrated or read.frame.camera is not None
            result = localizer.process(read.frame, development=read.development)
            poses = {found.name: found.pose for found in result if found.pose is not None}
            if len(poses) > 1 and (not frames or _is_new(poses, frames[-1])):
                frames.append(poses)
            on_progress(count, source.image_topic.count or None)
        for text in (*bag.warnings, *source.warnings):
            if text not in said:
                said.add(text)
                on_warning(text)
    if not count:
        raise BagError(f"{source.image_topic.name}: no image in the bag can be read; need a recording of the markers")
    if not is_calibrated:
        raise TooFewPoints("measurement: no frame has a calibration; need camera_info, or -p camera.info_file:=FILE")
    if len(frames) < FEWEST_FRAMES:
        raise TooFewPoints(
            f"measurement: {len(frames)} of {count} frames show two markers with poses, from different sides; need at "
            f"least {FEWEST_FRAMES}, and tens for a good result"
        )
    return measure_bundle(frames, [image.name for image in images])


def _readable(frames: Prefetch[ReadFrame]) -> Iterator[ReadFrame]:
    return (read for read in frames if read.development is not None)


def _is_new(poses: Mapping[str, Pose], before: Mapping[str, Pose]) -> bool:
    """Whether other markers are seen than in the frame that was used last, or from elsewhere."""
    if poses.keys() - before.keys():
        return True
    return any(
        np.linalg.norm(pose.t - before[name].t) > _MOVED * np.linalg.norm(pose.t)
        or np.linalg.norm(log_so3(pose.R @ before[name].R.T)) > _TURNED
        for name, pose in poses.items()
    )


def connections(measured: MeasuredBundle) -> Iterator[tuple[str, str, int]]:
    """Yield each two markers, and in how many frames they were seen together."""
    for first, second in itertools.combinations(measured.markers, 2):
        yield first, second, measured.markers[first].together.get(second, 0)
