# SPDX-License-Identifier: Apache-2.0
"""Every parameter of the package, declared once.

ROS descriptors, parameter files, `imgu params`, `--help` and the reference page are derived from these dataclasses.
A group of parameters is a frozen dataclass, and the first line of its docstring is its heading; a parameter is a field
made by `parameter`. Its full name joins the names of group and field by a dot (`homography.threshold_px`). `values`
converts what users give, `checks` says which values go together, `components` which component takes which.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from functools import cache
from inspect import getdoc
from typing import Any, cast, get_args, get_type_hints

from imgu_ros.errors import ParameterError, nearest_name
from imgu_ros.vision.methods import descriptor_names, detector_names, estimator_names

#: What a parameter can hold: the types that ROS 2 parameters have in common with Python.
ParameterValue = bool | int | float | str | tuple[str, ...] | tuple[float, ...] | tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Declaration:
    """The declaration of one parameter.

    Attributes
    ----------
    name : full name
    type_name : of ROS: `bool`, `integer`, `double`, `string`, `string_array`, `double_array`, `integer_array`
    default, description, unit : as declared
    bounds : smallest and largest value, of every element of a list; None: any finite number
    choices : the accepted values; empty: any
    read_only : fixed while the node runs
    is_frame : the value is a frame's name or its prefix, and loses leading slashes, which tf2 refuses
    basic : rank among the few to start with, from 1; 0: not one of them
    """

    name: str
    type_name: str
    default: ParameterValue
    description: str
    unit: str
    bounds: tuple[float, float] | None
    choices_of: Callable[[], tuple[str, ...]]
    read_only: bool
    is_frame: bool
    basic: int

    @property
    def group(self) -> str:
        """The name of its group; empty: it is in none."""
        return self.name.rpartition(".")[0]

    @property
    def range_text(self) -> str:
        """The bounds in words, "0.1 to 100"; empty: there are none."""
        return "" if self.bounds is None else " to ".join(f"{bound:.16g}" for bound in self.bounds)

    @property
    def choices(self) -> tuple[str, ...]:
        """What it may be; empty: any value. Those of a method grow with what is registered (`vision.methods`)."""
        return self.choices_of()


def parameter(
    default: Any,
    description: str,
    *,
    unit: str = "",
    bounds: tuple[float, float] | None = None,
    choices: tuple[str, ...] | Callable[[], tuple[str, ...]] = (),
    read_only: bool = False,
    is_frame: bool = False,
    basic: int = 0,
) -> Any:
    """Declare one parameter as a dataclass field; see `Declaration` for the meanings."""
    metadata = {
        "description": description,
        "unit": unit,
        "bounds": bounds,
        "choices_of": choices if callable(choices) else lambda: choices,
        "read_only": read_only,
        "is_frame": is_frame,
        "basic": basic,
    }
    return field(default=default, metadata=metadata)


@dataclass(frozen=True, slots=True)
class TargetsParameters:
    """Targets, their sizes and places."""

    images: tuple[str, ...] = parameter(
        (),
        "The targets, such as `[poster.png, tag36h11:7, board.yaml]`: image files (`~` and `$VARIABLES` are expanded; "
        "relative to the working directory), fiducial markers by family and id (`tag16h5`, `tag25h9`, `tag36h10`, "
        "`tag36h11`, `aruco_4x4_50` ... `aruco_7x7_1000`, `aruco_original`, `aruco_mip_36h12`; `tag36h11:*`: each id "
        "that is seen), and board files, which say where several markers are on one thing.",
        basic=1,
    )
    widths_m: tuple[float, ...] = parameter(
        (),
        "Printed width of each target between its outer edges, of a marker those of its black square, such as "
        "`[0.594]`; 0 or missing: unknown, and no metric pose; of a board: as its file says, another width scales it.",
        unit="m",
        bounds=(0.0, 1e4),
        basic=2,
    )
    names: tuple[str, ...] = parameter(
        (), "Name of each target in topics and files; default: the file name without its extension, or `tag36h11_7`."
    )
    poses: tuple[float, ...] = parameter(
        (),
        "Pose of each target in the map, seven numbers per target: x y z (m) qx qy qz qw; for `map/odom` and /tf, and "
        "to tell by other targets which of its poses an ambiguous one has.",
    )


@dataclass(frozen=True, slots=True)
class CompressedParameters:
    """Compressed image topics."""

    format: str = parameter(
        "jpeg", "Format of `<image topic>/compressed`; 16-bit images are always `png`.", choices=("jpeg", "png")
    )
    jpeg_quality: int = parameter(95, "JPEG quality; higher is better and larger.", bounds=(1, 100))
    png_level: int = parameter(3, "PNG compression level; higher is smaller and slower.", bounds=(0, 9))


@dataclass(frozen=True, slots=True)
class CameraParameters:
    """Camera calibration."""

    info_file: str = parameter(
        "",
        "Calibration file (of `imgu calibrate`, ROS, OpenCV or Kalibr), used instead of camera_info, also when there "
        "is none; `~` and `$VARIABLES` are expanded.",
        basic=3,
    )
    rectified: bool = parameter(
        False, "The input is rectified: use P[:3, :3] of camera_info and no distortion.", basic=4
    )
    covariance: tuple[float, ...] = parameter(
        (),
        "Covariance matrix of fx, fy, cx, cy and the distortion coefficients, row by row, propagated into every pose; "
        "empty: that of the calibration file, else the calibration counts as exact.",
    )
    row_time_us: float = parameter(
        0.0,
        "Rolling shutter: time from the exposure of one row to that of the next, top row first; 0: global shutter. "
        "Poses of tracked targets then are those at the time of the middle row, which a frame's stamp is taken to be; "
        "a detected one, of which no earlier frame tells how it moves, has a covariance that says so.",
        unit="us",
        bounds=(0.0, 1000.0),
    )


@dataclass(frozen=True, slots=True)
class FramesParameters:
    """Coordinate frames of the outputs."""

    camera: str = parameter(
        "", "Optical frame of the camera in all outputs; empty: the frame_id of the images.", is_frame=True
    )
    map: str = parameter("map", "Frame in which `targets.poses` are given.", is_frame=True)
    target_prefix: str = parameter(
        "", "Prefix of a target's name that makes its frame in /tf and in odometry.", is_frame=True
    )


@dataclass(frozen=True, slots=True)
class TfParameters:
    """Connection to the robot's tree of frames."""

    root_frame: str = parameter(
        "",
        "Root of the robot's tree, child of the map when `targets.poses` are given; empty: the camera's frame.",
        is_frame=True,
    )


@dataclass(frozen=True, slots=True)
class PathParameters:
    """Path topics."""

    max_length: int = parameter(1000, "Maximum number of poses in a path; the oldest are dropped.", bounds=(1, 100_000))


@dataclass(frozen=True, slots=True)
class DemosaicParameters:
    """Demosaicking of Bayer images."""

    method: str = parameter(
        "bilinear",
        "Demosaicking method, from fastest to most accurate.",
        choices=("bilinear", "edge_aware", "malvar", "hamilton_adams", "menon", "residual"),
    )


@dataclass(frozen=True, slots=True)
class RawParameters:
    """Input pixels: encoding, levels, colours and bands."""

    encoding: str = parameter(
        "",
        "Encoding of the pixels (`bayer_rggb8`, ...) when messages declare a wrong one, such as `mono8` for a mosaic; "
        "empty: as messages declare.",
        basic=5,
    )
    black_level: float = parameter(0.0, "Black level, a raw value.", bounds=(0.0, 65535.0))
    white_level: float = parameter(
        0.0, "White level (full scale), a raw value; 0: from `raw.significant_bits`.", bounds=(0.0, 65535.0)
    )
    significant_bits: int = parameter(
        0,
        "Significant bits of 16-bit data (10, 12, ...), right-aligned; 0: estimated from percentiles of every frame.",
        bounds=(0, 16),
    )
    gains: tuple[float, ...] = parameter(
        (1.0, 1.0, 1.0), "White-balance gains of red, green and blue.", bounds=(0.01, 100.0)
    )
    grey_weights: tuple[float, ...] = parameter(
        (0.299, 0.587, 0.114),
        "Weights of red, green and blue in the grey image of colour frames and colour targets; only their ratio "
        "matters.",
        bounds=(0.0, 1e6),
    )
    transfer: str = parameter(
        "auto",
        "Transfer function of the input: `linear` (sensor data), `srgb` (images for display), `auto`: sRGB for colour "
        "images, linear for all others, and for raw ones the curve that the first tracked frames show. Targets are "
        "converted to match.",
        choices=("auto", "linear", "srgb"),
    )
    bands: tuple[int, ...] = parameter(
        (), "Bands of an N-band image that form the grey image; empty: all.", bounds=(0, 9998)
    )
    band_mode: str = parameter(
        "mean",
        "Combination of the bands to grey: `mean`; `weighted` mean; first `principal_component` of the frame; "
        "`spectral_angle`: similarity to `raw.reference_spectrum`, bright where similar.",
        choices=("mean", "weighted", "principal_component", "spectral_angle"),
    )
    band_weights: tuple[float, ...] = parameter(
        (), "Weight of each band (of each of `raw.bands`, if given), for `weighted`.", bounds=(0.0, 1e6)
    )
    reference_spectrum: tuple[float, ...] = parameter(
        (),
        "Reference spectrum above the black level, one value for each band (of each of `raw.bands`, if given), for "
        "`spectral_angle`.",
    )


@dataclass(frozen=True, slots=True)
class PreprocessParameters:
    """Preprocessing of the grey image before detection."""

    smoothing_px: float = parameter(
        0.0, "Standard deviation of a Gaussian smoothing; 0: no smoothing.", unit="px", bounds=(0.0, 20.0)
    )
    contrast: float = parameter(1.0, "Factor applied to the grey values, clamped to 0 ... 255.", bounds=(0.01, 100.0))
    brightness: float = parameter(0.0, "Offset added to the grey values, clamped to 0 ... 255.", bounds=(-255.0, 255.0))
    gamma: float = parameter(
        1.0, "Exponent of the grey values; below 1 brightens, above 1 darkens.", bounds=(0.1, 10.0)
    )
    equalisation: str = parameter(
        "none",
        "Histogram equalisation: `global`, or `clahe` (tile by tile with limited contrast).",
        choices=("none", "global", "clahe"),
    )
    edges: str = parameter(
        "none",
        "`strength`: detect keypoints on the gradient magnitude of every pyramid level instead of on grey values.",
        choices=("none", "strength"),
    )
    derivative: str = parameter(
        "sobel", "Gradient operator of `preprocess.edges`.", choices=("sobel", "scharr", "gaussian")
    )
    threshold: str = parameter(
        "none",
        "Binarise the image: `otsu`, or `fixed`: frames at `preprocess.threshold_value`, targets by Otsu's method.",
        choices=("none", "fixed", "otsu"),
    )
    threshold_value: float = parameter(
        128.0, "Smallest grey value of a white pixel in frames, for `fixed`.", bounds=(0.0, 255.0)
    )
    threshold_bins: int = parameter(256, "Number of histogram bins of Otsu's method.", bounds=(2, 256))


@dataclass(frozen=True, slots=True)
class PyramidParameters:
    """Image pyramid for detection."""

    kind: str = parameter(
        "coarse",
        "`coarse`: one level per octave; `fine`: several per octave; `laplacian`: one band-pass level per octave.",
        choices=("coarse", "fine", "laplacian"),
    )
    kernel: str = parameter(
        "sampled",
        "Gaussian kernel of the pyramid and of `preprocess.smoothing_px`.",
        choices=("sampled", "discrete", "recursive"),
    )
    levels: int = parameter(8, "Maximum number of levels; small images have fewer.", bounds=(1, 32))
    scales_per_octave: int = parameter(3, "Levels per octave when `pyramid.kind` is `fine`.", bounds=(1, 8))
    max_side_px: int = parameter(
        800,
        "Maximum length of the longer side of level 0; larger images are reduced to 1/2, 1/3, ... before detection.",
        unit="px",
        bounds=(64, 16384),
    )


@dataclass(frozen=True, slots=True)
class KeypointsParameters:
    """Keypoint detection."""

    detector: str = parameter("orb", "Keypoint detector.", choices=detector_names)
    max_count: int = parameter(
        600, "Maximum number of keypoints per frame, spread over image and levels.", bounds=(8, 100_000)
    )
    fast_arc: int = parameter(
        9,
        "Minimum number of contiguous pixels, of 16 on the ring, of a corner when `keypoints.detector` is `fast`.",
        bounds=(9, 12),
    )


@dataclass(frozen=True, slots=True)
class DescriptorParameters:
    """Keypoint description."""

    kind: str = parameter("orb", "Keypoint descriptor.", choices=descriptor_names)


@dataclass(frozen=True, slots=True)
class MatchingParameters:
    """Descriptor matching."""

    metric: str = parameter(
        "auto",
        "Descriptor distance; `auto`: `hamming` for `orb` and `brief`, `euclidean` for `sift` and `rootsift`, `ncc` "
        "for `patch`.",
        choices=("auto", "euclidean", "cosine", "hamming", "ssd", "zmssd", "ncc"),
    )
    ratio: float = parameter(
        0.85,
        "Ratio test: accept a match when best / second-best distance is below this; 1 accepts all.",
        bounds=(0.1, 1.0),
    )
    mutual: bool = parameter(True, "Mutual check: accept a match only when each is the nearest of the other.")
    guided: bool = parameter(
        False,
        "Guided matching: match again near the positions predicted by the first homography, until the matches are "
        "stable.",
    )


@dataclass(frozen=True, slots=True)
class HomographyParameters:
    """Robust estimation of the homography."""

    estimator: str = parameter(
        "ransac",
        "Robust estimator: `ransac` of this package; OpenCV's `usac_magsac`; `usac_then_ransac`: OpenCV's USAC, and "
        "`ransac` where its answer may be chance. Best with OpenCV 5: USAC of OpenCV 4.6 has crashed.",
        choices=estimator_names,
    )
    sampler: str = parameter("prosac", "Sampling of minimal sets.", choices=("uniform", "prosac"))
    score: str = parameter(
        "truncated",
        "Score of a hypothesis: `truncated` squared distances, or `biweight`, a wider loss in both images (slower).",
        choices=("truncated", "biweight"),
    )
    threshold_px: float = parameter(
        3.0, "Maximum distance of an inlier, in pixels of level 0 of the pyramid.", unit="px", bounds=(0.1, 100.0)
    )
    confidence: float = parameter(
        0.9999, "Required probability that at least one sample is free of outliers.", bounds=(0.5, 0.9999999)
    )
    max_iterations: int = parameter(1000, "Maximum number of samples.", bounds=(1, 1_000_000))
    min_inliers: int = parameter(8, "Minimum number of inliers to accept a target.", bounds=(4, 100_000))
    error: str = parameter(
        "sampson",
        "Error measure minimised over the inliers.",
        choices=("algebraic", "transfer", "symmetric", "sampson", "reprojection"),
    )
    refine: str = parameter(
        "levenberg_marquardt",
        "Minimiser of `homography.error`; `none`, and the error `algebraic`, keep the linear estimate.",
        choices=("none", "steepest_descent", "gauss_newton", "levenberg_marquardt"),
    )


@dataclass(frozen=True, slots=True)
class SearchParameters:
    """Thorough search when no target is found."""

    thorough: bool = parameter(
        True,
        "When no target is found in a frame, search again: for a close target, then with more pixels, scales and "
        "keypoints, and for oblique views.",
    )
    max_side_px: int = parameter(
        1920, "Maximum length of the longer side of level 0 in a thorough search.", unit="px", bounds=(64, 16384)
    )
    max_count: int = parameter(2000, "Maximum number of keypoints per frame in a thorough search.", bounds=(8, 100_000))


@dataclass(frozen=True, slots=True)
class RefinementParameters:
    """Refinement by patch alignment."""

    enabled: bool = parameter(
        True, "After detection, align patches of the target with the full-resolution image; markers always are."
    )
    max_points: int = parameter(150, "Maximum number of patches aligned per target.", bounds=(16, 5000))
    window_px: int = parameter(11, "Side length of a patch.", unit="px", bounds=(7, 63))


@dataclass(frozen=True, slots=True)
class TrackingParameters:
    """Tracking from frame to frame."""

    enabled: bool = parameter(
        True, "Track targets from frame to frame by patch alignment; detect those without a track."
    )
    search_every: int = parameter(
        5, "While a target is tracked, search for missing ones in every n-th frame.", bounds=(1, 1000)
    )


@dataclass(frozen=True, slots=True)
class PoseParameters:
    """Pose from the homography."""

    ambiguity_ratio: float = parameter(
        0.8,
        "The pose is ambiguous when best / second-best reprojection error of the two planar solutions exceeds this.",
        bounds=(0.0, 1.0),
    )


@dataclass(frozen=True, slots=True)
class LimitsParameters:
    """Limits of what reading a file or a message may cost.

    Every decoder takes this group; the defaults suit a machine with 8 GB. A refusal names the limit: "needs 6144 MB;
    need at most 1000 (limits.picture_mb)".
    """

    picture_mb: int = parameter(
        1000, "Maximum memory for decoding one image or preparing one target.", unit="MB", bounds=(1, 1_000_000)
    )
    picture_megapixels: int = parameter(
        2000,
        "Maximum number of pixels processed while one image is decoded, which bounds the time; every scan of a "
        "progressive JPEG and every part of a file counts.",
        unit="10^6 px",
        bounds=(1, 1_000_000),
    )
    message_mb: int = parameter(
        256, "Maximum size of one message and of one chunk of a bag, decompressed.", unit="MB", bounds=(1, 1_000_000)
    )
    temporary_mb: int = parameter(
        50_000,
        "Maximum total size of temporary copies of a bag's compressed files; free disk space limits it too.",
        unit="MB",
        bounds=(1, 1_000_000_000),
    )
    expansion: int = parameter(
        1000,
        "Maximum ratio of decompressed to compressed size, beyond the first 1000 MB of a file (chunks and messages: "
        "2000 MB, and 100,000 messages, each counted as 2000 bytes).",
        bounds=(1, 1_000_000),
    )
    schema_fields: int = parameter(
        10_000,
        "Maximum number of fields of a message type that a bag defines, with those of its nested types.",
        bounds=(1, 10_000_000),
    )
    text_mb: int = parameter(
        4, "Maximum size of a YAML file, with its aliases expanded.", unit="MB", bounds=(1, 10_000)
    )


DEFAULT_LIMITS = LimitsParameters()


@dataclass(frozen=True, slots=True)
class Parameters:
    """All parameters; those outside of groups concern input, output and the node as a whole."""

    reference: str = parameter(
        "target", "What poses refer to: known planar targets.", choices=("target",), read_only=True
    )
    image_transport: str = parameter(
        "raw",
        "Live input: `raw` (sensor_msgs/Image) or `compressed` (sensor_msgs/CompressedImage).",
        choices=("raw", "compressed"),
        read_only=True,
        basic=6,
    )
    image_topic: str = parameter(
        "",
        "Replay: the image topic; empty: the first one that can be read. Live: remap `image_raw`.",
        read_only=True,
        basic=7,
    )
    camera_info_topic: str = parameter(
        "", "Replay: the camera_info topic; empty: the one beside the image topic.", read_only=True
    )
    autostart: bool = parameter(True, "Configure and activate the node at start.", read_only=True)
    publish_tf: bool = parameter(
        False,
        "Publish camera -> target on /tf, and map -> `tf.root_frame` with `targets.poses`; needs tf2_msgs.",
        read_only=True,
        basic=8,
    )
    seed: int = parameter(0, "Seed of the random number generators.", bounds=(0, 2**53))
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


def basic_declarations() -> tuple[Declaration, ...]:
    """Return the few parameters to start with, the most important first."""
    return tuple(sorted((known for known in declarations() if known.basic), key=lambda known: known.basic))


@cache
def group_headings() -> dict[str, str]:
    """Return a heading for each group, by its name, in the order of declaration; that of "" is for those in none."""
    headings = {"": "Input, output and the node"}
    for name, hint in get_type_hints(Parameters).items():
        if is_dataclass(hint):
            headings[name] = (getdoc(hint) or "").partition("\n")[0].rstrip(".")
    return headings


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
    hint = f"nearest known: {near}" if near else "`imgu params --all` lists the parameters"
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
