"""Every parameter of the package, declared once.

ROS descriptors, parameter files, `imgu params`, `--help` and the reference page are derived from these dataclasses.
A group of parameters is a frozen dataclass; a parameter is a field made by `parameter`. Its full name joins the
groups' names by dots (`homography.threshold_px`).
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass, replace
from functools import cache
from typing import Any, cast, get_args, get_type_hints

from imgu_ros.errors import ParameterError

#: What a parameter can hold: the types that ROS 2 parameters have in common with Python.
ParameterValue = bool | int | float | str | tuple[str, ...] | tuple[float, ...] | tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Declaration:
    """One parameter, as the rest of the world needs to know it.

    `minimum` and `maximum` are inclusive and hold for every element of a list. `type_name` is ROS's
    (`bool`, `integer`, `double`, `string`, `string_array`, `double_array`, `integer_array`).
    """

    name: str
    type_name: str
    default: ParameterValue
    description: str
    unit: str
    minimum: float | None
    maximum: float | None
    choices: tuple[str, ...]
    read_only: bool


def parameter(
    default: Any,
    description: str,
    *,
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    choices: tuple[str, ...] = (),
    read_only: bool = False,
) -> Any:
    """Declare one parameter as a dataclass field; see `Declaration` for the meanings."""
    metadata = {
        "description": description,
        "unit": unit,
        "minimum": minimum,
        "maximum": maximum,
        "choices": choices,
        "read_only": read_only,
    }
    return field(default=default, metadata=metadata)


@dataclass(frozen=True, slots=True)
class TargetsParameters:
    images: tuple[str, ...] = parameter((), "Image files of the known flat targets; `~` and `$VARIABLES` are expanded.")
    widths_m: tuple[float, ...] = parameter(
        (),
        "Printed width of each target, outer edge to outer edge; 0 or missing: unknown, no metric pose.",
        unit="m",
        minimum=0.0,
        maximum=1e4,
    )
    names: tuple[str, ...] = parameter((), "Name of each target in topics and files; default: the file's stem.")
    poses: tuple[float, ...] = parameter(
        (), "Pose of each target in the map, seven numbers a target: x y z (m) qx qy qz qw; for `publish_tf`."
    )


@dataclass(frozen=True, slots=True)
class CameraParameters:
    rectified: bool = parameter(False, "The image is rectified: use P[:3, :3] of camera_info and no distortion.")


@dataclass(frozen=True, slots=True)
class FramesParameters:
    map: str = parameter("map", "Frame in which `targets.poses` are given.")
    target_prefix: str = parameter("", "Put before a target's name to make its frame in /tf and in odometry.")


@dataclass(frozen=True, slots=True)
class TfParameters:
    root_frame: str = parameter(
        "", "Root of the robot's tree, child of the map when `targets.poses` are given; empty: the camera's frame."
    )


@dataclass(frozen=True, slots=True)
class PathParameters:
    max_length: int = parameter(1000, "Most poses kept in a path; the oldest go first.", minimum=1, maximum=100_000)


@dataclass(frozen=True, slots=True)
class DemosaicParameters:
    method: str = parameter(
        "bilinear",
        "Demosaicking method, from fast to good.",
        choices=("bilinear", "edge_aware", "malvar", "hamilton_adams", "menon", "residual"),
    )


@dataclass(frozen=True, slots=True)
class RawParameters:
    black_level: float = parameter(0.0, "Raw value of no light.", minimum=0.0, maximum=65535.0)
    white_level: float = parameter(
        0.0, "Raw value of full scale; 0: from `raw.significant_bits`.", minimum=0.0, maximum=65535.0
    )
    significant_bits: int = parameter(
        0,
        "Bits that carry the signal in 16-bit data (10, 12, ...), right-aligned; 0: from the data, by percentiles in "
        "every frame.",
        minimum=0,
        maximum=16,
    )
    gains: tuple[float, ...] = parameter(
        (1.0, 1.0, 1.0), "White-balance gains of red, green and blue.", minimum=0.01, maximum=100.0
    )
    bands: tuple[int, ...] = parameter(
        (), "Bands of an N-band image that make the grey image; empty: all.", minimum=0, maximum=9998
    )
    band_mode: str = parameter(
        "mean",
        "How the bands of a pixel become one grey value: their `mean`; `weighted` mean; first `principal_component` of "
        "the frame; `spectral_angle`: bright where the spectrum is like `raw.reference_spectrum`.",
        choices=("mean", "weighted", "principal_component", "spectral_angle"),
    )
    band_weights: tuple[float, ...] = parameter(
        (), "Weight of each band (each of `raw.bands`, if given), for `weighted`.", minimum=0.0, maximum=1e6
    )
    reference_spectrum: tuple[float, ...] = parameter(
        (),
        "Spectrum that is sought, above the black level: a value for each band (each of `raw.bands`, if given), for "
        "`spectral_angle`.",
    )


@dataclass(frozen=True, slots=True)
class PreprocessParameters:
    smoothing_px: float = parameter(
        0.0, "Sigma of a Gaussian that smooths the grey picture; 0: none.", unit="px", minimum=0.0, maximum=20.0
    )
    contrast: float = parameter(1.0, "Factor of the grey values, clamped to 0 ... 255.", minimum=0.01, maximum=100.0)
    brightness: float = parameter(0.0, "Added to the grey values, clamped to 0 ... 255.", minimum=-255.0, maximum=255.0)
    gamma: float = parameter(
        1.0, "Exponent of the grey values; below 1: brighter, above: darker.", minimum=0.1, maximum=10.0
    )
    equalisation: str = parameter(
        "none",
        "Spread the grey values evenly: over the whole picture, or tile by tile with limited contrast.",
        choices=("none", "global", "clahe"),
    )
    edges: str = parameter(
        "none",
        "Seek keypoints on the gradient's length, on every level of the pyramid, instead of on grey values.",
        choices=("none", "strength"),
    )
    threshold: str = parameter(
        "none",
        "Make the picture black and white: where Otsu's method says, or frames at `preprocess.threshold_value`.",
        choices=("none", "fixed", "otsu"),
    )
    threshold_value: float = parameter(
        128.0, "Grey value from which on a pixel of a frame is white, for `fixed`.", minimum=0.0, maximum=255.0
    )


@dataclass(frozen=True, slots=True)
class PyramidParameters:
    kind: str = parameter(
        "fine",
        "`coarse`: octaves; `fine`: several scales in every octave; `laplacian`: octaves, as bands of detail.",
        choices=("coarse", "fine", "laplacian"),
    )
    kernel: str = parameter(
        "sampled",
        "Gaussian kernel that smooths before subsampling, and for `preprocess.smoothing_px`.",
        choices=("sampled", "discrete", "recursive"),
    )
    levels: int = parameter(8, "Most levels; fewer when the image gets too small.", minimum=1, maximum=32)
    scales_per_octave: int = parameter(3, "Levels in an octave when `pyramid.kind` is `fine`.", minimum=1, maximum=8)
    max_side_px: int = parameter(
        1280,
        "Longest side of level 0: a larger image is reduced by halves before features are sought.",
        unit="px",
        minimum=64,
        maximum=16384,
    )


@dataclass(frozen=True, slots=True)
class KeypointsParameters:
    detector: str = parameter("orb", "Keypoint detector.", choices=("fast", "harris", "moravec", "dog", "mser", "orb"))
    max_count: int = parameter(
        1000, "Most keypoints in a frame, spread over image and levels.", minimum=8, maximum=100_000
    )
    fast_arc: int = parameter(
        9,
        "Contiguous pixels, of 16 on a ring, that make a corner when `keypoints.detector` is `fast`.",
        minimum=9,
        maximum=12,
    )


@dataclass(frozen=True, slots=True)
class DescriptorParameters:
    kind: str = parameter("orb", "Descriptor.", choices=("orb", "sift", "rootsift", "brief", "patch"))


@dataclass(frozen=True, slots=True)
class MatchingParameters:
    metric: str = parameter(
        "auto",
        "Distance between descriptors; `auto`: `hamming` for `orb` and `brief`, `euclidean` for `sift` and `rootsift`, "
        "`ncc` for `patch`.",
        choices=("auto", "euclidean", "cosine", "hamming", "ssd", "zmssd", "ncc"),
    )
    ratio: float = parameter(
        0.85, "Keep a match when best / second-best distance is below this; 1 keeps all.", minimum=0.1, maximum=1.0
    )
    mutual: bool = parameter(True, "Keep a match only when each is the other's nearest.")
    guided: bool = parameter(
        False, "After a first homography, seek matches again where it predicts them, until they stay the same."
    )


@dataclass(frozen=True, slots=True)
class HomographyParameters:
    sampler: str = parameter("prosac", "How minimal samples are drawn.", choices=("uniform", "prosac"))
    score: str = parameter(
        "truncated",
        "What the search minimises: squared distances up to the threshold, or a wider loss in both images (slower).",
        choices=("truncated", "biweight"),
    )
    threshold_px: float = parameter(
        3.0, "Largest distance of an inlier, in pixels of the full image.", unit="px", minimum=0.1, maximum=100.0
    )
    confidence: float = parameter(
        0.9999, "Wanted probability that one sample was free of outliers.", minimum=0.5, maximum=0.9999999
    )
    max_iterations: int = parameter(2000, "Most samples drawn.", minimum=1, maximum=1_000_000)
    min_inliers: int = parameter(12, "Fewest inliers with which a target counts as found.", minimum=4, maximum=100_000)
    error: str = parameter(
        "sampson",
        "Error that the refinement minimises.",
        choices=("algebraic", "transfer", "symmetric", "sampson", "reprojection"),
    )
    refine: str = parameter(
        "levenberg_marquardt",
        "How the inliers' error is minimised.",
        choices=("none", "steepest_descent", "gauss_newton", "levenberg_marquardt"),
    )


@dataclass(frozen=True, slots=True)
class RefinementParameters:
    enabled: bool = parameter(True, "Align patches of the target with the full-resolution image after detection.")
    max_points: int = parameter(250, "Most patches aligned for each target.", minimum=16, maximum=5000)
    window_px: int = parameter(15, "Side of an aligned patch.", unit="px", minimum=7, maximum=63)


@dataclass(frozen=True, slots=True)
class TrackingParameters:
    enabled: bool = parameter(
        True, "Follow a target from frame to frame by alignment, and detect it only when that fails."
    )
    search_every: int = parameter(
        5, "While one target is tracked, look for the missing ones in every n-th frame.", minimum=1, maximum=1000
    )


@dataclass(frozen=True, slots=True)
class PoseParameters:
    ambiguity_ratio: float = parameter(
        0.8,
        "The pose is ambiguous when best / second-best reprojection error of the two planar solutions exceeds this.",
        minimum=0.0,
        maximum=1.0,
    )


@dataclass(frozen=True, slots=True)
class Parameters:
    """All parameters. The defaults serve most people: set `targets.images` and `targets.widths_m`."""

    reference: str = parameter(
        "target", "What poses refer to: known printed images.", choices=("target",), read_only=True
    )
    image_transport: str = parameter(
        "raw", "Live input: `raw` (sensor_msgs/Image) or `compressed`.", choices=("raw", "compressed"), read_only=True
    )
    image_topic: str = parameter(
        "", "Replay: the image topic; empty: the first that the chain can read.", read_only=True
    )
    camera_info_topic: str = parameter(
        "", "Replay: the camera_info topic; empty: beside the image topic.", read_only=True
    )
    autostart: bool = parameter(True, "Configure and activate the node at start.", read_only=True)
    publish_tf: bool = parameter(False, "Publish camera -> target on /tf (needs tf2_msgs).", read_only=True)
    seed: int = parameter(0, "Seed of every random draw.", minimum=0, maximum=2**53)
    targets: TargetsParameters = field(default_factory=TargetsParameters)
    camera: CameraParameters = field(default_factory=CameraParameters)
    frames: FramesParameters = field(default_factory=FramesParameters)
    tf: TfParameters = field(default_factory=TfParameters)
    path: PathParameters = field(default_factory=PathParameters)
    demosaic: DemosaicParameters = field(default_factory=DemosaicParameters)
    raw: RawParameters = field(default_factory=RawParameters)
    preprocess: PreprocessParameters = field(default_factory=PreprocessParameters)
    pyramid: PyramidParameters = field(default_factory=PyramidParameters)
    keypoints: KeypointsParameters = field(default_factory=KeypointsParameters)
    descriptor: DescriptorParameters = field(default_factory=DescriptorParameters)
    matching: MatchingParameters = field(default_factory=MatchingParameters)
    homography: HomographyParameters = field(default_factory=HomographyParameters)
    refinement: RefinementParameters = field(default_factory=RefinementParameters)
    tracking: TrackingParameters = field(default_factory=TrackingParameters)
    pose: PoseParameters = field(default_factory=PoseParameters)


#: Names that the interfaces reserve and that no released chain fulfils yet: refused with the reason.
RESERVED_CHOICES = {("reference", "keyframe"), ("reference", "rotation")}

#: ROS's integers have 64 bits.
_LARGEST_INTEGER = 2**63 - 1
_SHOWN_CHARACTERS = 80

_TYPE_NAMES: dict[Any, str] = {
    bool: "bool",
    int: "integer",
    float: "double",
    str: "string",
    tuple[str, ...]: "string_array",
    tuple[float, ...]: "double_array",
    tuple[int, ...]: "integer_array",
}


@cache
def declarations() -> tuple[Declaration, ...]:
    """Return every parameter, in the order of declaration."""
    return tuple(_declarations(Parameters, ""))


def declaration(name: str) -> Declaration:
    """Return the parameter called `name`.

    Raises
    ------
    ParameterError
        If there is none; the message names the nearest known one.
    """
    for known in declarations():
        if known.name == name:
            return known
    nearest = difflib.get_close_matches(str(name), [d.name for d in declarations()], n=1, cutoff=0.0)
    raise ParameterError(f"{name}: unknown parameter; nearest known: {nearest[0]}")


def checked_value(name: str, value: object) -> ParameterValue:
    """Return `value` in the declared type of the parameter `name`.

    An integer serves as a double, and a list or array as an array; nothing else is converted.

    Raises
    ------
    ParameterError
        If the name is unknown, or the value has another type or lies outside its range or choices.
    """
    known = declaration(name)
    if known.type_name.endswith("_array"):
        element = known.type_name.removesuffix("_array")
        if not _is_list(value):
            raise ParameterError(f"{name}: {_shown(value)} ({type(value).__name__}); need a list of {element}s")
        items = list(cast("Iterable[object]", value))
        return tuple(_checked_scalar(f"{name}[{i}]", item, element, known) for i, item in enumerate(items))
    return cast(ParameterValue, _checked_scalar(name, value, known.type_name, known))


def parameters_from(values: Mapping[str, object], base: Parameters | None = None) -> Parameters:
    """Return `base` (the defaults when None) with the named values replaced, all checked, one by one and together.

    Raises
    ------
    ParameterError
        As `checked_value`; and if parallel lists disagree.
    """
    result = base or Parameters()
    for name, value in values.items():
        checked = checked_value(name, value)
        result = _replaced(result, name.split("."), checked)
    _check_together(result)
    return result


def parameter_values(parameters: Parameters) -> dict[str, ParameterValue]:
    """Return every parameter's value by its full name, in the order of declaration."""
    values: dict[str, ParameterValue] = {}
    for known in declarations():
        value: Any = parameters
        for part in known.name.split("."):
            value = getattr(value, part)
        values[known.name] = value
    return values


def _declarations(group: type, prefix: str) -> Iterator[Declaration]:
    hints = get_type_hints(group)
    for item in fields(group):
        hint = hints[item.name]
        if is_dataclass(hint):
            yield from _declarations(cast(type, hint), f"{prefix}{item.name}.")
        else:
            yield _declaration(item, hint, prefix)


def _declaration(item: Field[Any], hint: Any, prefix: str) -> Declaration:
    if item.default is MISSING or "description" not in item.metadata or hint not in _TYPE_NAMES:
        raise TypeError(
            f"{prefix}{item.name}: declare it with parameter() and a ROS type, not {get_args(hint) or hint}"
        )
    return Declaration(name=f"{prefix}{item.name}", type_name=_TYPE_NAMES[hint], default=item.default, **item.metadata)


def _checked_scalar(name: str, value: object, type_name: str, known: Declaration) -> Any:
    expected = {"bool": bool, "integer": int, "double": float, "string": str}[type_name]
    if isinstance(value, str):  # an enumeration's member
        value = str.__str__(value)
    elif getattr(value, "ndim", None) == 0 and hasattr(value, "item"):  # a numpy scalar
        value = value.item()
    if type_name == "double" and type(value) is int and abs(value) <= _LARGEST_INTEGER:
        value = float(value)
    if type(value) is not expected:
        raise ParameterError(f"{name}: {_shown(value)} ({type(value).__name__}); need {_article(type_name)}")
    if known.choices and value not in known.choices:
        if (known.name, value) in RESERVED_CHOICES:
            raise ParameterError(
                f"{name}: {value!r} is reserved and not available in this version; need {_listed(known.choices)}"
            )
        near = difflib.get_close_matches(str(value), known.choices, n=1)
        raise ParameterError(
            f"{name}: {_shown(value)}; need {_listed(known.choices)}" + (f" (nearest: {near[0]})" if near else "")
        )
    if isinstance(value, int | float) and not isinstance(value, bool):
        low = -math.inf if known.minimum is None else known.minimum
        high = math.inf if known.maximum is None else known.maximum
        if not low <= value <= high or value in (-math.inf, math.inf):
            raise ParameterError(f"{name}: {_shown(value)}; need {_range(known)}")
    return value


def _is_list(value: object) -> bool:
    if isinstance(value, str | bytes | bytearray | Mapping) or getattr(value, "ndim", 1) == 0:
        return False
    return hasattr(value, "__len__") and hasattr(value, "__getitem__")


def _shown(value: object) -> str:
    """Return a value for a message: on one line, and not endless."""
    if isinstance(value, int) and abs(value) > _LARGEST_INTEGER:
        return f"an integer of {value.bit_length()} bits"
    text = " ".join(repr(value).split())
    return text if len(text) <= _SHOWN_CHARACTERS else text[:_SHOWN_CHARACTERS] + "..."


def _range(known: Declaration) -> str:
    if known.minimum is None or known.maximum is None:
        limits = [
            f"{word} {_number(limit)}"
            for word, limit in (("at least", known.minimum), ("at most", known.maximum))
            if limit is not None
        ]
        text = limits[0] if limits else "a finite number"
    else:
        text = f"{_number(known.minimum)} to {_number(known.maximum)}"
    return f"{text} {known.unit}" if known.unit else text


def _number(limit: float) -> str:
    return str(limit) if isinstance(limit, int) else f"{limit:.15g}"


def _article(type_name: str) -> str:
    return {"bool": "true or false", "integer": "an integer", "double": "a number", "string": "a string"}[type_name]


def _listed(choices: tuple[str, ...]) -> str:
    return " or ".join(repr(c) for c in choices) if len(choices) < 3 else "one of " + ", ".join(choices)


def _replaced(group: Any, path: list[str], value: ParameterValue) -> Any:
    if len(path) > 1:
        return replace(group, **{path[0]: _replaced(getattr(group, path[0]), path[1:], value)})
    return replace(group, **{path[0]: value})


def _check_together(parameters: Parameters) -> None:
    targets = parameters.targets
    count = len(targets.images)
    for name, values, each in (
        ("widths_m", targets.widths_m, 1),
        ("names", targets.names, 1),
        ("poses", targets.poses, 7),
    ):
        if len(values) not in (0, count * each):
            need = f"none, or {count * each}: {'one' if each == 1 else 'seven'} for each of targets.images"
            raise ParameterError(f"targets.{name}: {len(values)} values; need {need}")
    if len(parameters.raw.gains) != 3:
        raise ParameterError(f"raw.gains: {len(parameters.raw.gains)} values; need 3 (red, green, blue)")
    black, white = parameters.raw.black_level, parameters.raw.white_level
    if 0 < white <= black:
        raise ParameterError(f"raw.white_level: {white:g}; need more than raw.black_level ({black:g})")
    _check_bands(parameters.raw)
    preprocess = parameters.preprocess
    if preprocess.edges != "none" and preprocess.threshold != "none":
        raise ParameterError(
            f"preprocess.threshold: {preprocess.threshold!r} leaves steps of one height to preprocess.edges "
            f"{preprocess.edges!r}, and nothing to tell places apart; need one of the two"
        )
    if parameters.keypoints.detector == "dog":
        # It builds its own scale space, of level 0 alone.
        for name, value, wrong in (
            ("pyramid.kind", parameters.pyramid.kind, "laplacian"),
            ("preprocess.edges", parameters.preprocess.edges, "strength"),
        ):
            if value == wrong:
                raise ParameterError(
                    f"{name}: {wrong!r} changes every level, and keypoints.detector 'dog' sees the finest one only; "
                    f"need another detector, or another value"
                )


def _check_bands(raw: RawParameters) -> None:
    """Refuse a band mode whose weights or reference are missing, or do not go with the chosen bands."""
    name, values = {
        "weighted": ("raw.band_weights", raw.band_weights),
        "spectral_angle": ("raw.reference_spectrum", raw.reference_spectrum),
    }.get(raw.band_mode, ("", ()))
    if not name:
        return
    if not values:
        raise ParameterError(f"{name}: none; need one value for each band when raw.band_mode is {raw.band_mode!r}")
    if raw.bands and len(values) != len(raw.bands):
        raise ParameterError(f"{name}: {len(values)} values; need {len(raw.bands)}, one for each of raw.bands")
    if not any(values):
        raise ParameterError(f"{name}: all 0; need at least one other value")
    if raw.band_mode == "spectral_angle" and len(values) < 2:
        raise ParameterError(f"{name}: 1 value; need 2 or more for an angle between spectra")
