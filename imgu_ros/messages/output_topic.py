# SPDX-License-Identifier: Apache-2.0
"""Type of a row in the table of outputs, and input of its function; the table is in `messages/results.py`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum, auto
from functools import cached_property
from typing import Any

from imgu_ros.config.components import OutputParameters
from imgu_ros.errors import EstimationError
from imgu_ros.messages.factory import MessageFactory
from imgu_ros.messages.header import Header
from imgu_ros.pose.map_pose import camera_in_map
from imgu_ros.result import ReferenceResult, Result
from imgu_ros.types import Image
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.pose_fusion import FusedPose
from imgu_ros.vision.camera.rigid import RigidTransform


class Scope(Enum):
    """How often a row of the table gives a topic.

    FRAME: once. LEVEL: once for each level of the pyramid, appended to the row's name. TARGET: once for each target,
    under `targets/<name>/`, and for the first target without that prefix too. MAP: once, when `targets.poses` is given.
    """

    FRAME = auto()
    LEVEL = auto()
    TARGET = auto()
    MAP = auto()


class Recording(Enum):
    """Whether the results bag of a replay has a topic: always, or when it is asked for."""

    ALWAYS = auto()
    ON_REQUEST = auto()


@dataclass(frozen=True, slots=True)
class OutputTopic:
    """One row of the table of outputs.

    Attributes
    ----------
    name : of the topic, without the prefix of a target and the number of a level
    type_name : "package/msg/Name"
    message : makes the message; None when the frame has nothing for the topic
    scope : see there
    recording : see there
    state : makes what the topic remembers between frames, one object for each of its targets, which `message` gets as
        `OutputContext.state`; `ResultConverter.reset` drops it
    needs_keypoints : whether it can only be made when keypoints are detected in every frame
    is_optional : whether a live node does without it where the package of its message is not installed
    """

    name: str
    type_name: str
    message: Callable[[OutputContext], Any | None]
    scope: Scope = Scope.FRAME
    recording: Recording = Recording.ON_REQUEST
    state: Callable[[MessageFactory], Any] | None = None
    needs_keypoints: bool = False
    is_optional: bool = False


class ConvertedFrame:
    """A frame's result on its way to messages, with what several topics share.

    Parameters
    ----------
    make : makes messages
    result : of the frame
    parameters : those of the outputs
    places : of the targets, `map_from_target`, by name; empty without a map
    draw : draws a result over its image

    Attributes
    ----------
    result : as given, its frame_id replaced by `frames.camera` when that is set
    header : of the input, which every output carries
    map_problem : why the camera has no place in the map, once `fused` was asked for; empty when nothing is wrong
    """

    def __init__(
        self,
        make: MessageFactory,
        result: Result,
        parameters: OutputParameters,
        places: Mapping[str, RigidTransform],
        draw: Callable[[Result], Image],
    ) -> None:
        self.make, self.result, self.parameters = make, result, parameters
        self.header = Header(result.frame.stamp_ns, result.frame.frame_id)
        self.map_problem = ""
        self._places = places
        self._draw = draw

    @cached_property
    def drawn(self) -> Image:
        """The image with the result drawn over it, (H, W, 3) RGB."""
        return self._draw(self.result)

    @cached_property
    def fused(self) -> FusedPose | None:
        """`map_from_camera`, by all targets with a pose; None without one, or when they contradict each other."""
        if not self._places:
            return None
        try:
            return camera_in_map(self.result, self._places)
        except EstimationError as error:
            self.map_problem = f"targets.poses: {error}"
            return None

    @cached_property
    def camera_from_map(self) -> Pose | None:
        """The inverse of `fused`, with its covariance."""
        return None if self.fused is None else self.fused.pose.inverse()


@dataclass(frozen=True, slots=True, eq=False)
class OutputContext:
    """Input of a function of the table.

    Attributes
    ----------
    frame : the frame
    target : for rows of scope TARGET
    level : of the pyramid, for rows of scope LEVEL
    state : what the row's `state` has made, kept from frame to frame; None for rows without
    """

    frame: ConvertedFrame
    target: ReferenceResult | None = None
    level: int = 0
    state: Any = None

    @property
    def found(self) -> ReferenceResult:
        """The target; RuntimeError in a row of another scope."""
        if self.target is None:
            raise RuntimeError("output: no target; need a row of scope TARGET")
        return self.target

    @property
    def target_frame(self) -> str:
        """Name of the target's coordinate frame."""
        return self.frame.parameters.frames.target_prefix + self.found.name
