# SPDX-License-Identifier: Apache-2.0
"""Which parameters each component takes: one frozen dataclass a component, of groups and single parameters.

A component receives its own class and never sees `Parameters`: what depends on a parameter follows from these classes.
`of` selects the values from the whole tree; two selections that are equal need no rebuilding. `names` lists the
parameters, for those who say what a command or a node reads.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Self

from imgu_ros.config.parameters import (
    CameraParameters,
    CompressedParameters,
    DemosaicParameters,
    DescriptorParameters,
    FramesParameters,
    HomographyParameters,
    KeypointsParameters,
    LimitsParameters,
    MatchingParameters,
    Parameters,
    PathParameters,
    PoseParameters,
    PreprocessParameters,
    PyramidParameters,
    RawParameters,
    RefinementParameters,
    SearchParameters,
    TargetsParameters,
    TfParameters,
    declarations,
)


class ComponentParameters:
    """Base of these classes: their fields have the names and the values of fields of `Parameters`."""

    __slots__ = ()

    @classmethod
    def of(cls, parameters: Parameters) -> Self:
        """Return the component's own values."""
        return cls(**{name: getattr(parameters, name) for name in cls._field_names()})

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the full names of all parameters that the component takes, in the order of declaration."""
        groups = set(cls._field_names())
        return tuple(known.name for known in declarations() if known.name.partition(".")[0] in groups)

    @classmethod
    def _field_names(cls) -> Iterator[str]:
        return (field.name for field in fields(cls))  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True)
class ReadingParameters(ComponentParameters):
    """How a message becomes a frame with its camera."""

    camera: CameraParameters
    raw: RawParameters
    limits: LimitsParameters


@dataclass(frozen=True, slots=True)
class RecordedFramesParameters(ReadingParameters):
    """How a replay takes frames from a recording: which topics, how they are read, the name of the camera's frame."""

    image_topic: str
    camera_info_topic: str
    frames: FramesParameters


@dataclass(frozen=True, slots=True)
class DevelopmentParameters(ComponentParameters):
    """How a raw frame becomes a grey and a colour image."""

    raw: RawParameters
    demosaic: DemosaicParameters


@dataclass(frozen=True, slots=True)
class FeatureParameters(ComponentParameters):
    """How keypoints are detected and described, in frames and in references."""

    preprocess: PreprocessParameters
    pyramid: PyramidParameters
    keypoints: KeypointsParameters
    descriptor: DescriptorParameters


@dataclass(frozen=True, slots=True)
class DetectionParameters(FeatureParameters):
    """How references are detected in a frame: features, matching, robust fit, refinement, search passes."""

    matching: MatchingParameters
    homography: HomographyParameters
    search: SearchParameters
    refinement: RefinementParameters
    seed: int


@dataclass(frozen=True, slots=True)
class ReferenceParameters(DetectionParameters):
    """How references are made and what poses they give: grey image, patches, features as the detection needs them."""

    raw: RawParameters
    pose: PoseParameters


@dataclass(frozen=True, slots=True)
class OutputParameters(ComponentParameters):
    """What results become: which topics there are, the names of frames, compression, paths, the map."""

    targets: TargetsParameters
    frames: FramesParameters
    tf: TfParameters
    path: PathParameters
    compressed: CompressedParameters
    pyramid: PyramidParameters
    publish_tf: bool
