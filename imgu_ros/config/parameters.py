# SPDX-License-Identifier: Apache-2.0
"""Every parameter of the package, declared once.

ROS descriptors, parameter files, `imgu params`, `--help` and the reference page are derived from these dataclasses.
A group of parameters is a frozen dataclass; a parameter is a field made by `parameter`. Its full name joins the
groups' names by dots (`homography.threshold_px`). `parameter_values` makes them of values that people give, and
`parameter_checks` says which go together.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from functools import cache
from typing import Any, cast, get_args, get_type_hints

from imgu_ros.errors import ParameterError
from imgu_ros.nearest_name import nearest_name

#: What a parameter can hold: the types that ROS 2 parameters have in common with Python.
ParameterValue = bool | int | float | str | tuple[str, ...] | tuple[float, ...] | tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Declaration:
    """One parameter, as the rest of the world needs to know it.

    `minimum` and `maximum` are inclusive and hold for every element of a list. `type_name` is ROS's
    (`bool`, `integer`, `double`, `string`, `string_array`, `double_array`, `integer_array`). The value of one that
    `is_frame` names a frame, or begins its name, and loses leading slashes, which tf2 refuses.
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
    is_frame: bool


def parameter(
    default: Any,
    description: str,
    *,
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    choices: tuple[str, ...] = (),
    read_only: bool = False,
    is_frame: bool = False,
) -> Any:
    """Declare one parameter as a dataclass field; see `Declaration` for the meanings."""
    metadata = {
        "description": description,
        "unit": unit,
        "minimum": minimum,
        "maximum": maximum,
        "choices": choices,
        "read_only": read_only,
        "is_frame": is_frame,
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
        (), "Pose of each target in the map, seven numbers a target: x y z (m) qx qy qz qw; for `map/odom` and /tf."
    )


@dataclass(frozen=True, slots=True)
class CompressedParameters:
    format: str = parameter(
        "jpeg", "Format of `<picture>/compressed`; pictures of 16 bits are always `png`.", choices=("jpeg", "png")
    )
    jpeg_quality: int = parameter(95, "Quality of JPEG, from small to good.", minimum=1, maximum=100)
    png_level: int = parameter(3, "Effort of PNG, from fast to small.", minimum=0, maximum=9)


@dataclass(frozen=True, slots=True)
class CameraParameters:
    info_file: str = parameter(
        "",
        "Calibration file of the camera (of `imgu calibrate`, ROS, OpenCV or Kalibr), used instead of camera_info or "
        "for want of it; `~` and `$VARIABLES` are expanded.",
    )
    rectified: bool = parameter(False, "The image is rectified: use P[:3, :3] of camera_info and no distortion.")
    covariance: tuple[float, ...] = parameter(
        (),
        "Covariance of camera_info's fx, fy, cx, cy and distortion coefficients, row by row; it enters every pose's; "
        "empty: that of a calibration file, else they are exact.",
    )


@dataclass(frozen=True, slots=True)
class FramesParameters:
    camera: str = parameter(
        "", "Name of the camera's optical frame in all outputs; empty: the images' own frame_id.", is_frame=True
    )
    map: str = parameter("map", "Frame in which `targets.poses` are given.", is_frame=True)
    target_prefix: str = parameter(
        "", "Put before a target's name to make its frame in /tf and in odometry.", is_frame=True
    )


@dataclass(frozen=True, slots=True)
class TfParameters:
    root_frame: str = parameter(
        "",
        "Root of the robot's tree, child of the map when `targets.poses` are given; empty: the camera's frame.",
        is_frame=True,
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
    encoding: str = parameter(
        "",
        "What the pixels are (`bayer_rggb8`, ...) when messages claim a wrong encoding, such as `mono8` for a mosaic; "
        "empty: what messages say.",
    )
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
    grey_weights: tuple[float, ...] = parameter(
        (0.299, 0.587, 0.114),
        "Weights of red, green and blue in the grey picture of colour images and colour targets; their sum does not "
        "matter.",
        minimum=0.0,
        maximum=1e6,
    )
    transfer: str = parameter(
        "auto",
        "How grey values go with the light: `linear`, as raw ones do; `srgb`, as those of pictures to be looked at. "
        "`auto`: sRGB for colour images, linear for all others. Targets are compared accordingly.",
        choices=("auto", "linear", "srgb"),
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
    derivative: str = parameter(
        "sobel", "Operator of the gradient for `preprocess.edges`.", choices=("sobel", "scharr", "gaussian")
    )
    threshold: str = parameter(
        "none",
        "Make the picture black and white: where Otsu's method says, or frames at `preprocess.threshold_value`.",
        choices=("none", "fixed", "otsu"),
    )
    threshold_value: float = parameter(
        128.0, "Grey value from which on a pixel of a frame is white, for `fixed`.", minimum=0.0, maximum=255.0
    )
    threshold_bins: int = parameter(
        256, "Bins of the histogram between which `otsu` looks for its threshold.", minimum=2, maximum=256
    )


@dataclass(frozen=True, slots=True)
class PyramidParameters:
    kind: str = parameter(
        "coarse",
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
        800,
        "Longest side of level 0: a larger image is reduced, to a half, a third, ..., before features are sought.",
        unit="px",
        minimum=64,
        maximum=16384,
    )


@dataclass(frozen=True, slots=True)
class KeypointsParameters:
    detector: str = parameter("orb", "Keypoint detector.", choices=("fast", "harris", "moravec", "dog", "mser", "orb"))
    max_count: int = parameter(
        600, "Most keypoints in a frame, spread over image and levels.", minimum=8, maximum=100_000
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
        3.0,
        "Largest distance of an inlier, in pixels of level 0 of the pyramid.",
        unit="px",
        minimum=0.1,
        maximum=100.0,
    )
    confidence: float = parameter(
        0.9999, "Wanted probability that one sample was free of outliers.", minimum=0.5, maximum=0.9999999
    )
    max_iterations: int = parameter(1000, "Most samples drawn.", minimum=1, maximum=1_000_000)
    min_inliers: int = parameter(8, "Fewest inliers with which a target counts as found.", minimum=4, maximum=100_000)
    error: str = parameter(
        "sampson",
        "Error that the refinement minimises.",
        choices=("algebraic", "transfer", "symmetric", "sampson", "reprojection"),
    )
    refine: str = parameter(
        "levenberg_marquardt",
        "How the inliers' error is minimised; with `none`, or the error `algebraic`, the linear fit stays.",
        choices=("none", "steepest_descent", "gauss_newton", "levenberg_marquardt"),
    )


@dataclass(frozen=True, slots=True)
class SearchParameters:
    thorough: bool = parameter(
        True,
        "When no target was found in a frame, look again: for one that is near, then thoroughly, with more pixels, "
        "scales and keypoints, and for oblique views.",
    )
    max_side_px: int = parameter(
        1920, "Longest side of level 0 in a thorough search.", unit="px", minimum=64, maximum=16384
    )
    max_count: int = parameter(2000, "Most keypoints of a frame in a thorough search.", minimum=8, maximum=100_000)


@dataclass(frozen=True, slots=True)
class RefinementParameters:
    enabled: bool = parameter(True, "Align patches of the target with the full-resolution image after detection.")
    max_points: int = parameter(150, "Most patches aligned for each target.", minimum=16, maximum=5000)
    window_px: int = parameter(11, "Side of an aligned patch.", unit="px", minimum=7, maximum=63)


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
class LimitsParameters:
    """What reading may cost, whatever a file or a message claims; the defaults suit a machine with 8 GB.

    Every decoder takes this group. A refusal names the limit: "needs 6144 MB; need at most 1000 (limits.picture_mb)".
    """

    picture_mb: int = parameter(
        1000,
        "Memory that decoding one picture may take, or preparing one target.",
        unit="MB",
        minimum=1,
        maximum=1_000_000,
    )
    picture_megapixels: int = parameter(
        2000,
        "Pixels that the decoding of one picture may go over, every scan of a progressive JPEG and every part of a "
        "file counted: they take time.",
        unit="10^6 px",
        minimum=1,
        maximum=1_000_000,
    )
    message_mb: int = parameter(
        256, "Size of one message and of one chunk of a bag, decompressed.", unit="MB", minimum=1, maximum=1_000_000
    )
    temporary_mb: int = parameter(
        50_000,
        "Size of the temporary copies of a bag's compressed files, together; what the disk has free bounds it too.",
        unit="MB",
        minimum=1,
        maximum=1_000_000_000,
    )
    expansion: int = parameter(
        1000,
        "Bytes that a compressed byte may become, beyond the first 1000 MB of a file (chunks and messages: 2000 MB, "
        "and 100,000 messages, of which each counts as 2000 bytes).",
        minimum=1,
        maximum=1_000_000,
    )
    schema_fields: int = parameter(
        10_000, "Fields of a message type that a bag defines, with all that it contains.", minimum=1, maximum=10_000_000
    )
    text_mb: int = parameter(
        4, "Size of a YAML file, its aliases counted as often as they are used.", unit="MB", minimum=1, maximum=10_000
    )


DEFAULT_LIMITS = LimitsParameters()


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
    publish_tf: bool = parameter(
        False,
        "Publish camera -> target on /tf, and map -> `tf.root_frame` with `targets.poses`; needs tf2_msgs.",
        read_only=True,
    )
    seed: int = parameter(0, "Seed of every random draw.", minimum=0, maximum=2**53)
    targets: TargetsParameters = field(default_factory=TargetsParameters)
    camera: CameraParameters = field(default_factory=CameraParameters)
    compressed: CompressedParameters = field(default_factory=CompressedParameters)
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
    search: SearchParameters = field(default_factory=SearchParameters)
    refinement: RefinementParameters = field(default_factory=RefinementParameters)
    tracking: TrackingParameters = field(default_factory=TrackingParameters)
    pose: PoseParameters = field(default_factory=PoseParameters)
    limits: LimitsParameters = field(default_factory=LimitsParameters)


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
    near = nearest_name(name, [known.name for known in declarations()])
    hint = f"nearest known: {near}" if near else "`imgu params` lists those that there are"
    raise ParameterError(f"{name}: unknown parameter; {hint}")


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
