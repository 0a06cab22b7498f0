# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of the perception node: figures, and why no poses come out, in /diagnostics and in the log."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from imgu_ros.messages.diagnostics import HealthEntry, HealthLevel
from imgu_ros.result import Result
from imgu_ros.ros.causes import Cause, CauseKind, CauseLog, ClockWatch, other_clock
from imgu_ros.ros.image_input import ImageInput
from imgu_ros.ros.input_causes import camera_info_causes, header_causes, image_causes, publisher_causes
from imgu_ros.ros.localizer_worker import LocalizerWorker
from imgu_ros.ros.managed_node import NodeState
from imgu_ros.ros.middleware import full_memory
from imgu_ros.ros.reach import domain_text

#: A target may be out of view, and camera_info missing, for so long without a message.
_PATIENCE_S = 1.5
_LOOK_S = 0.5

_OF_INPUT = frozenset(
    (
        CauseKind.NO_PUBLISHER,
        CauseKind.WRONG_TYPE,
        CauseKind.QOS,
        CauseKind.HELD_UP,
        CauseKind.LOST,
        CauseKind.SILENT,
        CauseKind.REJECTED,
        CauseKind.UNPAIRED,
        CauseKind.CLOCK,
        CauseKind.PUBLISHERS,
        CauseKind.FRAME_ID,
        CauseKind.STAMPS,
    )
)
_OF_CAMERA = frozenset((CauseKind.UNCALIBRATED, CauseKind.UNPAIRED))


@dataclass(frozen=True, slots=True)
class PerceptionState:
    """State of the perception node.

    Attributes
    ----------
    node : what every node has
    misfits : subscribers that cannot be served because their QoS is incompatible
    stopped_clock : that the node's clock stands still; None when it runs
    frames : what keeps poses from the map or from /tf; empty when nothing does
    """

    node: NodeState
    misfits: tuple[Cause, ...] = ()
    stopped_clock: Cause | None = None
    frames: str = ""


class Explainer:
    """Checks twice a second what keeps poses from being published, and logs each cause once.

    Parameters
    ----------
    node : logs, and gives the graph
    source, worker : of the node
    state : returns the node's state; whether its clock stands still is found here
    """

    def __init__(
        self, node: Node, source: ImageInput, worker: LocalizerWorker, state: Callable[[Cause | None], PerceptionState]
    ) -> None:
        self._node, self._source, self._worker, self._state = node, source, worker, state
        self._log = CauseLog()
        self._clock = ClockWatch(node)
        # The machine's time: with use_sim_time a timer would stand still until /clock comes.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(_LOOK_S, self._look, clock=steady)

    def begin(self) -> None:
        """Log every cause again: the node was activated."""
        self._log.clear()

    def _look(self) -> None:
        now = time.monotonic()
        state = self._state(self._clock.cause(now))
        found = self._causes(state) if state.node.listened or state.misfits else _memory_causes()
        for cause in self._log.news(found, now):
            self._node.get_logger().warning(cause.text)

    def health(self) -> list[HealthEntry]:
        """Return the entries of /diagnostics."""
        state = self._state(self._clock.cause(time.monotonic()))
        return health(state, self._causes(state), self._source, self._worker)

    def _causes(self, state: PerceptionState) -> list[Cause]:
        return [*causes(state, self._node, self._source, self._worker), *_memory_causes()]


def health(
    state: PerceptionState, found: Sequence[Cause], source: ImageInput, worker: LocalizerWorker
) -> list[HealthEntry]:
    """Return the entries of /diagnostics.

    Parameters
    ----------
    state : what the node knows about itself
    found : why no poses come out, see `causes`
    source, worker : their figures
    """
    now, prefix = time.monotonic(), state.node.name
    return [
        _output(f"{prefix}: output", state, found, worker, now),
        _input(f"{prefix}: input", found, source, worker, now),
        _camera(f"{prefix}: camera", found, worker),
        _targets(f"{prefix}: targets", worker),
    ]


def causes(state: PerceptionState, node: Node, source: ImageInput, worker: LocalizerWorker) -> list[Cause]:
    """Return why no poses are published, causes near the input first; empty when poses are published.

    The graph is queried: call it a few times a second at most.
    """
    now = time.monotonic()
    if state.node.lifecycle != "active":
        return [Cause(CauseKind.LIFECYCLE, f"lifecycle state: {state.node.lifecycle}; need active")]
    if state.node.paused:
        return [Cause(CauseKind.PAUSED, "paused: call ~/pause with false to go on")]
    misfits = list(state.misfits)
    if not state.node.listened:
        return misfits or [Cause(CauseKind.IDLE, f"idle: no subscribers in {domain_text(node)}")]
    on_the_way = list(image_causes(node, source, now))
    stopped = [] if state.stopped_clock is None else [state.stopped_clock]
    long = worker.long_frame()
    held_up = [] if long is None else [Cause(CauseKind.HELD_UP, long.text, case="frame")]
    if on_the_way and on_the_way[0].kind not in (CauseKind.LOST, CauseKind.HELD_UP):
        # A player that has not started sends neither images nor time.
        return [*held_up, *stopped, *on_the_way, *misfits]
    frames = [Cause(CauseKind.FRAMES, state.frames)] if state.frames else []
    return [
        *held_up,
        *_of_frames(node, source, worker, now),
        *frames,
        *on_the_way,
        *stopped,
        *misfits,
        *publisher_causes(node, source),
        *header_causes(source, "" if worker.parameters is None else worker.parameters.frames.camera),
        *other_clock(node, worker.age),
        *(Cause(CauseKind.SIZE, text, case=name) for name, text in list(worker.sizes.warnings.items())),
    ]


def _of_frames(node: Node, source: ImageInput, worker: LocalizerWorker, now: float) -> Iterator[Cause]:
    if worker.figures.rejection:
        yield Cause(CauseKind.REJECTED, f"frame rejected: {worker.figures.rejection}")
        return
    if not worker.targets:
        yield Cause(CauseKind.NO_TARGETS, "no targets: set targets.images")
        return
    last = worker.last
    if last is None:
        yield Cause(CauseKind.WAITING, f"waiting for images on {source.topics.image} ({domain_text(node)})")
        return
    if not any(target.status.found for target in last):
        yield from _not_seen(last, source, worker, now)
    elif all(target.pose is None for target in last) and last.frame.camera is not None:
        first = next(target for target in last if target.status.found)
        yield Cause(CauseKind.NO_POSE, f"{first.name}: {first.reason}")
    if last.frame.camera is None and source.open_s(now) > _PATIENCE_S:
        yield from _uncalibrated(last, node, source, now)
    else:
        yield from camera_info_causes(node, source, now)


def _not_seen(last: Result, source: ImageInput, worker: LocalizerWorker, now: float) -> Iterator[Cause]:
    failures = worker.failures
    unseen_s = source.open_s(now) if failures.found_s is None else now - failures.found_s
    if min(unseen_s, source.open_s(now)) < _PATIENCE_S or worker.parameters is None:
        return
    # Of the targets not found, the one with the most inliers.
    most = failures.most_inliers
    name = max(most, key=lambda key: most[key], default=last.first.name)
    reason = last.references.get(name, last.first).reason
    yield Cause(
        CauseKind.NOT_SEEN,
        f"target not seen: {name}: best so far {most.get(name, 0)} inliers, "
        f"need {worker.parameters.homography.min_inliers}; last frame: {reason}",
    )


def unusable_camera_info(reason: str, topic: str) -> str:
    """Return the line that says why a camera_info cannot be used; `topic` is empty when it comes from a file."""
    said = f"uncalibrated: {reason}{f', on {topic}' if topic else ''}; homographies, no poses"
    return f"{said}; correct it, or calibrate the camera (imgu calibrate) and set camera.info_file"


def _uncalibrated(last: Result, node: Node, source: ImageInput, now: float) -> Iterator[Cause]:
    reason = last.frame.camera_reason
    if reason:
        yield Cause(CauseKind.UNCALIBRATED, unusable_camera_info(reason, source.camera_info_topic), is_logged=True)
        return
    for cause in camera_info_causes(node, source, now):
        yield Cause(cause.kind, f"uncalibrated: {cause.text}; homographies, no poses")


def _output(
    name: str, state: PerceptionState, found: Sequence[Cause], worker: LocalizerWorker, now: float
) -> HealthEntry:
    idle = all(cause.kind in (CauseKind.IDLE, CauseKind.PAUSED, CauseKind.LIFECYCLE) for cause in found)
    level = HealthLevel.OK if idle else HealthLevel.WARN
    reason = "; ".join(cause.text for cause in found)
    values: dict[str, object] = {
        "lifecycle_state": state.node.lifecycle,
        **worker.figures.values(now),
        "subscribers_with_incompatible_qos": len(state.misfits),
        "causes": " ".join(cause.kind for cause in found),
    }
    ages = worker.age.percentiles_ms()
    values |= dict(zip(("age_p50_ms", "age_p95_ms", "age_max_ms"), ages, strict=False))
    if worker.last is not None:
        values |= {f"target.{target.name}": target.status.value for target in worker.last}
        values |= {f"time.{stage.value}_ms": ns / 1e6 for stage, ns in (worker.last.times_ns or {}).items()}
    return HealthEntry(name, level, reason or "poses come out", values)


def _input(name: str, found: Sequence[Cause], source: ImageInput, worker: LocalizerWorker, now: float) -> HealthEntry:
    counters = source.counters
    values: dict[str, object] = {
        "image_topic": source.topics.image,
        "camera_info_topic": source.camera_info_topic,
        "rate_hz": source.arrivals.rate_hz(now),
        "frames": source.arrivals.count,
        "lost": counters.lost,
        "skipped": source.queue.skipped,
        "rejected": worker.figures.rejected + source.unread,
        "unreadable": source.unread,
        "unknown_encodings": worker.unknown_encodings,
        "camera_info_rate_hz": source.infos.rate_hz(now),
        "unmatched_camera_info": source.unmatched,
        "publishers_with_incompatible_qos": counters.incompatible,
    }
    if not source.is_open:
        return HealthEntry(name, HealthLevel.OK, "not subscribed", values)
    reason = "; ".join(cause.text for cause in found if cause.kind in _OF_INPUT)
    return HealthEntry(name, HealthLevel.WARN if reason else HealthLevel.OK, reason or "images come in", values)


def _camera(name: str, found: Sequence[Cause], worker: LocalizerWorker) -> HealthEntry:
    last = worker.last
    if last is None:
        return HealthEntry(name, HealthLevel.OK, "no frame yet", {})
    of_camera = [cause.text for cause in found if cause.kind in _OF_CAMERA]
    reason = "; ".join((*filter(None, [worker.reading_problem]), *of_camera))
    camera = last.frame.camera
    if camera is None:
        said = last.frame.camera_reason or "no camera_info"
        return HealthEntry(name, HealthLevel.WARN, reason or f"uncalibrated: {said}", {})
    reason = "; ".join((*filter(None, [reason]), *last.camera_remarks))
    values: dict[str, object] = {
        "frame_id": last.frame.frame_id,
        "size": f"{camera.width} x {camera.height}",
        "fx": float(camera.K[0, 0]),
        "fy": float(camera.K[1, 1]),
        "cx": float(camera.K[0, 2]),
        "cy": float(camera.K[1, 2]),
        "distortion_model": str(camera.model),
        "info_file": worker.info_file,
    }
    if last.calibration is not None:
        values |= {
            "calibration_views": last.calibration.views,
            "calibration_chi_squared": last.calibration.chi_squared,
            "focal_error_percent": last.calibration.focal_percent,
            "focal_error_sigma_percent": last.calibration.focal_sigma_percent,
        }
    return HealthEntry(name, HealthLevel.WARN if reason else HealthLevel.OK, reason or "calibrated", values)


def _targets(name: str, worker: LocalizerWorker) -> HealthEntry:
    poor = dict(worker.poor_targets)
    level = HealthLevel.WARN if poor else HealthLevel.OK
    return HealthEntry(name, level, "; ".join(poor.values()) or "nothing to say", {"targets": len(worker.targets)})


def _memory_causes() -> list[Cause]:
    full = full_memory()
    return [Cause(CauseKind.MEMORY, full)] if full else []
