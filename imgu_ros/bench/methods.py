# SPDX-License-Identifier: Apache-2.0
"""What is measured: something that is given a raw frame and says where the known targets are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from imgu_ros.config.parameters import Parameters
from imgu_ros.frame import Frame
from imgu_ros.localizer import Localizer
from imgu_ros.reference.templates import TargetImage
from imgu_ros.reference_kinds import prepare_references
from imgu_ros.types import Floats, Matrix3
from imgu_ros.vision.camera.rigid import RigidTransform


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """What a method says of one target in one frame.

    Attributes
    ----------
    target : its name
    H : (3, 3) H_image_template in ideal pixels, w > 0 at the target's centre; None: not found
    pose : camera_from_target; None: no pose
    covariance : (6, 6) of the pose; None: the method has none
    status : in the method's own words
    reason : why there is no H or no pose; empty when nothing is missing
    """

    target: str
    H: Matrix3 | None = None
    pose: RigidTransform | None = None
    covariance: Floats | None = None
    status: str = ""
    reason: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Answered:
    """All answers to one frame, in the order of the targets, and how long each stage took."""

    answers: tuple[Answer, ...]
    stages_ns: Mapping[str, int] = field(default_factory=dict)


class BenchmarkMethod(Protocol):
    """Finds known targets in raw frames."""

    @property
    def name(self) -> str:
        """What tables call it."""

    def reset(self) -> None:
        """Forget earlier frames."""

    def answer(self, frame: Frame) -> Answered:
        """Say where the targets are."""


class ChainMethod:
    """The package's own chain.

    Parameters
    ----------
    name : what tables call it
    parameters : of the pipeline
    targets : the known ones
    """

    def __init__(self, name: str, parameters: Parameters, targets: Sequence[TargetImage]) -> None:
        self.name = name
        self._chain = Localizer(parameters, prepare_references(targets, parameters))

    def reset(self) -> None:
        """Forget earlier frames."""
        self._chain.reset()

    def answer(self, frame: Frame) -> Answered:
        """Work on one frame."""
        result = self._chain.process(frame)
        answers = tuple(
            Answer(
                t.name,
                None if t.homography is None else t.homography.H,
                None if t.pose is None else t.pose.transform,
                None if t.pose is None else t.pose.covariance,
                t.status.value,
                t.reason,
            )
            for t in result
        )
        return Answered(answers, {stage.value: ns for stage, ns in (result.times_ns or {}).items()})
