"""What /diagnostics says about a perception node: figures, and the reason when nothing comes out."""

from __future__ import annotations

import time
from dataclasses import dataclass

from imgu_ros.codec.diagnostics import HealthEntry, Level
from imgu_ros.perception.result import PoseStatus, Result
from imgu_ros.ros.input import ImageInput
from imgu_ros.ros.worker import Worker


@dataclass(frozen=True, slots=True)
class NodeState:
    """What the node knows about itself.

    Attributes
    ----------
    name : fully qualified
    lifecycle : name of the state
    paused, listened : whether it is paused, and whether anybody listens to an output
    unmatched_subscribers : listeners that cannot be served, for their QoS does not fit
    """

    name: str
    lifecycle: str
    paused: bool
    listened: bool
    unmatched_subscribers: int


def health(state: NodeState, source: ImageInput, worker: Worker) -> list[HealthEntry]:
    """Return the entries of /diagnostics."""
    now, prefix = time.monotonic(), state.name
    return [
        _output(f"{prefix}: output", state, source, worker, now),
        _input(f"{prefix}: input", source, worker, now),
        _camera(f"{prefix}: camera", worker.last),
    ]


def why_nothing(state: NodeState, source: ImageInput, worker: Worker) -> str:
    """Return why no poses come out, the first cause on the way from the input on; empty when they do."""
    if state.lifecycle != "active":
        return f"lifecycle state: {state.lifecycle}"
    if state.paused:
        return "paused: call ~/pause with false to go on"
    if not state.listened:
        return "idle: no subscribers"
    silent = source.why_silent()
    if silent:
        return silent
    if worker.rejection:
        return f"frame rejected: {worker.rejection}"
    if not worker.targets:
        return "no targets: set targets.images"
    last = worker.last
    if last is None:
        return "waiting for the first frame"
    return _why_no_pose(last)


def _why_no_pose(result: Result) -> str:
    if result.reason:
        return f"frame rejected: {result.reason}"
    if any(target.pose is not None for target in result.targets):
        return ""
    first = result.targets[0]
    words = first.pose_status.value if first.status.found else first.status.value
    return f"{first.name}: {words}{': ' if first.reason else ''}{first.reason}"


def _output(name: str, state: NodeState, source: ImageInput, worker: Worker, now: float) -> HealthEntry:
    reason = why_nothing(state, source, worker)
    idle = state.lifecycle != "active" or state.paused or not state.listened
    level = Level.OK if idle or not reason else Level.WARN
    latencies = worker.latency.percentiles_ms()
    values: dict[str, object] = {
        "lifecycle_state": state.lifecycle,
        "rate_hz": worker.done.rate_hz(now),
        "frames": worker.done.count,
        **dict(zip(("latency_p50_ms", "latency_p95_ms", "latency_max_ms"), latencies, strict=False)),
        "subscribers_with_incompatible_qos": state.unmatched_subscribers,
    }
    if worker.last is not None:
        values |= {f"target.{target.name}": target.status.value for target in worker.last.targets}
        values |= {f"time.{stage.value}_ms": ns / 1e6 for stage, ns in (worker.last.times_ns or {}).items()}
    return HealthEntry(name, level, reason or "poses come out", values)


def _input(name: str, source: ImageInput, worker: Worker, now: float) -> HealthEntry:
    counters = source.counters
    values: dict[str, object] = {
        "image_topic": source.topics.image,
        "camera_info_topic": source.topics.camera_info,
        "rate_hz": source.arrivals.rate_hz(now),
        "frames": source.arrivals.count,
        "lost": counters.lost,
        "skipped": source.slot.skipped,
        "rejected": worker.rejected,
        "unknown_encodings": worker.unknown_encodings,
        "unmatched_camera_info": source.unmatched,
        "publishers_with_incompatible_qos": counters.incompatible,
    }
    if not source.is_open:
        return HealthEntry(name, Level.OK, "not subscribed", values)
    reason = source.why_silent() or worker.rejection
    return HealthEntry(name, Level.WARN if reason else Level.OK, reason or "images come in", values)


def _camera(name: str, last: Result | None) -> HealthEntry:
    if last is None:
        return HealthEntry(name, Level.OK, "no frame yet", {})
    camera = last.frame.camera
    if camera is None:
        return HealthEntry(name, Level.WARN, f"{PoseStatus.UNCALIBRATED}: no camera_info, or K is all zero", {})
    values: dict[str, object] = {
        "frame_id": last.frame.frame_id,
        "size": f"{camera.width} x {camera.height}",
        "fx": float(camera.K[0, 0]),
        "fy": float(camera.K[1, 1]),
        "cx": float(camera.K[0, 2]),
        "cy": float(camera.K[1, 2]),
        "distortion_model": str(camera.model),
    }
    return HealthEntry(name, Level.OK, "calibrated", values)
