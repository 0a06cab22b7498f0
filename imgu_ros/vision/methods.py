# SPDX-License-Identifier: Apache-2.0
"""The methods that users choose by name: detectors, descriptors, robust estimators; one row each.

A row says where a method is, which parameters it takes, and what the pipeline has to know of it. To add one, write its
file and its row; the choices of the user's parameter, their checks and their documentation follow from the table. A
package of a user's own adds a row at run time, before the parameters are read: `register_detector`,
`register_descriptor`, `register_estimator`.

Files are named, not imported: a command that only lists the choices does not wait for NumPy and OpenCV.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any, Self, TypeVar

from imgu_ros.errors import ShapeError


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Method:
    """What all rows have in common.

    Attributes
    ----------
    name : as users write it
    make : the method's function; of a method with parameters, what makes that function (or an object that is called
        like one) of them. The object itself, or where it is: `keypoints.fast:fast_detector`, within `imgu_ros.vision`
    parameters : the method's own frozen dataclass, or where it is; None: it takes none
    settings : by field of that dataclass, the user's parameter that sets it; the other fields keep their defaults
    """

    name: str
    make: str | Callable[..., Any]
    parameters: str | type | None = None
    settings: Mapping[str, str] | None = None

    def parameters_from(self, value_of: Callable[[str], Any]) -> Any:
        """Return the method's own parameters; `value_of` gives the value of a user's parameter by its full name."""
        if self.parameters is None:
            return None
        return _loaded(self.parameters)(**{field: value_of(name) for field, name in (self.settings or {}).items()})

    def made(self, parameters: Any = None) -> Any:
        """Return the function (or object) that does it; `parameters`: the method's own, None: the defaults."""
        make = _loaded(self.make)
        if self.parameters is None:
            return make
        return make(_loaded(self.parameters)() if parameters is None else parameters)

    def bound(self, parameters: Any = None) -> Self:
        """Return the row with its method made, once, of `parameters`: it is used again and again as it is."""
        return replace(self, make=self.made(parameters), parameters=None, settings=None)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DetectorMethod(Method):
    """A keypoint detector: a function of an image, (H, W) uint8, and the largest number of corners; gives `Corners`.

    Attributes
    ----------
    finds_every_scale : looks for structures of every size on level 0 by itself; else it is asked level by level
    """

    finds_every_scale: bool = False


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DescriptorMethod(Method):
    """A descriptor: a function of an image, (H, W) uint8, and `Corners` on it; gives `Described`.

    Attributes
    ----------
    columns : bytes or numbers in a row
    is_binary : rows are bits, uint8; else numbers, float32
    metrics : by which its rows can be compared, the one that `auto` stands for first
    nature : what its rows are, for the message that refuses another metric
    detects : also finds the keypoints that it describes: `make` gives a `FeatureExtractor`, and users choose the same
        name as `keypoints.detector`
    """

    columns: int
    is_binary: bool
    metrics: tuple[str, ...]
    nature: str
    detects: bool = False


_BITS = "is binary"
_GRADIENTS = "is a histogram of gradients"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class EstimatorMethod(Method):
    """A robust estimator of homographies; `make` gives a `HomographyEstimator`."""


DETECTORS: dict[str, DetectorMethod] = {
    row.name: row
    for row in (
        DetectorMethod(
            name="fast",
            make="keypoints.fast:fast_detector",
            parameters="keypoints.fast:FastParameters",
            settings={"arc": "keypoints.fast_arc"},
        ),
        DetectorMethod(name="harris", make="keypoints.harris:detect_harris"),
        DetectorMethod(name="moravec", make="keypoints.moravec:detect_moravec"),
        DetectorMethod(name="dog", make="keypoints.dog:detect_dog", finds_every_scale=True),
        DetectorMethod(name="mser", make="keypoints.mser:detect_mser", finds_every_scale=True),
        DetectorMethod(name="orb", make="keypoints.orb:detect_orb"),
    )
}

DESCRIPTORS: dict[str, DescriptorMethod] = {
    row.name: row
    for row in (
        DescriptorMethod(
            name="orb",
            make="descriptors.orb:describe_orb",
            columns=32,
            is_binary=True,
            metrics=("hamming",),
            nature=_BITS,
        ),
        DescriptorMethod(
            name="sift",
            make="descriptors.sift:describe_sift",
            columns=128,
            is_binary=False,
            metrics=("euclidean", "cosine"),
            nature=_GRADIENTS,
        ),
        DescriptorMethod(
            name="rootsift",
            make="descriptors.sift:describe_rootsift",
            columns=128,
            is_binary=False,
            metrics=("euclidean", "cosine"),
            nature=_GRADIENTS,
        ),
        DescriptorMethod(
            name="brief",
            make="descriptors.brief:describe_brief",
            columns=32,
            is_binary=True,
            metrics=("hamming",),
            nature=_BITS,
        ),
        DescriptorMethod(
            name="patch",
            make="descriptors.patch:describe_patch",
            columns=169,
            is_binary=False,
            metrics=("ncc", "zmssd", "ssd"),
            nature="is a patch of grey values",
        ),
    )
}


_CONSENSUS = {name: f"homography.{name}" for name in ("confidence", "max_iterations", "min_inliers")}
_RANSAC = {name: f"homography.{name}" for name in ("sampler", "score")} | _CONSENSUS

ESTIMATORS: dict[str, EstimatorMethod] = {
    row.name: row
    for row in (
        EstimatorMethod(
            name="ransac",
            make="projective.robust:ransac_estimator",
            parameters="projective.robust:RansacParameters",
            settings=_RANSAC,
        ),
        EstimatorMethod(
            name="usac_then_ransac",
            make="projective.robust:usac_then_ransac_estimator",
            parameters="projective.robust:RansacParameters",
            settings=_RANSAC,
        ),
        EstimatorMethod(
            name="usac_magsac",
            make="projective.robust:usac_magsac_estimator",
            parameters="projective.robust:UsacParameters",
            settings=_CONSENSUS,
        ),
    )
}


def detector_names() -> tuple[str, ...]:
    """Return the choices of `keypoints.detector`: the detectors, and the descriptors that detect."""
    return (*DETECTORS, *(name for name, row in DESCRIPTORS.items() if row.detects))


def descriptor_names() -> tuple[str, ...]:
    """Return the choices of `descriptor.kind`."""
    return tuple(DESCRIPTORS)


def estimator_names() -> tuple[str, ...]:
    """Return the choices of `homography.estimator`."""
    return tuple(ESTIMATORS)


def register_detector(row: DetectorMethod) -> None:
    """Add the `row` of a detector; see `register_descriptor` for one that describes, too.

    Raises
    ------
    ShapeError
        If the name is taken.
    """
    _register(DETECTORS, row, detector_names())


def register_descriptor(row: DescriptorMethod) -> None:
    """Add the `row` of a descriptor.

    Raises
    ------
    ShapeError
        If the name is taken; that of one that detects, by a detector.
    """
    _register(DESCRIPTORS, row, detector_names() if row.detects else descriptor_names())


def register_estimator(row: EstimatorMethod) -> None:
    """Add the `row` of a robust estimator of homographies.

    Raises
    ------
    ShapeError
        If the name is taken.
    """
    _register(ESTIMATORS, row, estimator_names())


Row = TypeVar("Row", bound=Method)


def method_named(table: Mapping[str, Row], name: object, what: str) -> Row:
    """Return the row of a `name` in a `table`; `what` is what the error calls it.

    Raises
    ------
    ShapeError
        If there is none; the message lists those that there are.

    Examples
    --------
    >>> method_named(DETECTORS, "dog", "detector").finds_every_scale
    True
    """
    row = table.get(name) if isinstance(name, str) else None
    if row is None:
        from imgu_ros.arguments import shown_value

        raise ShapeError(f"{what}: {shown_value(name)}; need one of {', '.join(table)}")
    return row


def _register(table: dict[str, Row], row: Row, taken: tuple[str, ...]) -> None:
    if row.name in taken:
        raise ShapeError(f"{row.name}: already registered; need another name")
    table[row.name] = row


def _loaded(where: Any) -> Any:
    """Return an object, or what `module:name` within `imgu_ros.vision` names."""
    if not isinstance(where, str):
        return where
    module, _, name = where.partition(":")
    return getattr(import_module(f"imgu_ros.vision.{module}"), name)
