# SPDX-License-Identifier: Apache-2.0
"""The recordings and cases of `scripts/same_numbers`: tables, and what makes bags of them with rosbags alone.

A case is a row of `CASES`: its name, the recording, options of `imgu replay`. A recording is a row of `SIMULATED`, made
by `imgu simulate` of the older tree, or a row of `CHANGED`, made from a simulated one.
"""

from __future__ import annotations

import copy
import shlex
import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

IMAGE, CAMERA_INFO = "/camera/image_raw", "/camera/camera_info"
#: Values of --template: pictures that `make_template` draws.
_ONE, _FIVE = "--template {0}", "--template {0} --template {1} --template {2} --template {3} --template {4}"
_SMALL = "--size 320x240 --frames 12"

#: Name and options of `imgu simulate`.
SIMULATED = {
    "bayer8": f"{_SMALL} --seed 1 {_ONE}",
    "bayer16": f"{_SMALL} --seed 2 {_ONE} --bits 12 --pattern grbg --black-level 64",
    "mono8": f"{_SMALL} --seed 3 {_ONE} --encoding mono8",
    "mono16": f"{_SMALL} --seed 4 {_ONE} --encoding mono16 --bits 16 --big-endian",
    "rgb8": f"{_SMALL} --seed 5 {_ONE} --encoding rgb8",
    "bgr8": f"{_SMALL} --seed 6 {_ONE} --encoding bgr8 --row-padding 24",
    "plumb_bob": f"{_SMALL} --seed 7 {_ONE} --distortion plumb_bob",
    "rational": f"{_SMALL} --seed 8 {_ONE} --distortion rational_polynomial",
    "fisheye": f"{_SMALL} --seed 9 {_ONE} --distortion equidistant --encoding mono8",
    "rgb16": f"{_SMALL} --seed 12 {_ONE} --encoding rgb16 --bits 14",
    "bayer16_big_endian": f"{_SMALL} --seed 13 {_ONE} --bits 10 --pattern bggr --big-endian --row-padding 6",
    "gbrg": f"{_SMALL} --seed 14 {_ONE} --pattern gbrg --ev=0,-2,1 --exposure-ms 3",
    "thin_prism": f"{_SMALL} --seed 15 {_ONE} --distortion thin_prism --encoding mono8",
    "tilted": f"{_SMALL} --seed 16 {_ONE} --distortion tilted --encoding mono8",
    "targets": f"--size 480x360 --frames 10 --seed 10 {_FIVE} --storage sqlite3",
    "large": f"--size 1000x640 --frames 6 --seed 11 {_ONE} --compression zstd",
}


@dataclass(slots=True)
class Recorded:
    """One message of a recording."""

    topic: str
    time_ns: int
    message: Any


Recording = list[Recorded]


def _images(recording: Recording) -> list[Recorded]:
    return [recorded for recorded in recording if recorded.topic == IMAGE]


def _pixels(message: Any) -> np.ndarray:
    """Return the pixels of an 8-bit message, (H, W) or (H, W, 3)."""
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    if message.encoding in ("rgb8", "bgr8"):
        return rows[:, : 3 * message.width].reshape(message.height, message.width, 3)
    return rows[:, : message.width]


def _set_pixels(message: Any, pixels: np.ndarray, encoding: str) -> None:
    message.encoding = encoding
    # Of planes, pixels have more rows than the picture.
    message.step = pixels.nbytes // pixels.shape[0]
    message.is_bigendian = 0
    message.data = np.ascontiguousarray(pixels).reshape(-1).view(np.uint8)


def encoded(encoding: str, convert: Callable[[np.ndarray], np.ndarray]) -> Callable[[Recording], Recording]:
    """Return a change that gives images another encoding."""

    def change(recording: Recording) -> Recording:
        for recorded in _images(recording):
            _set_pixels(recorded.message, convert(_pixels(recorded.message)), encoding)
        return recording

    return change


def compressed(suffix: str, form: str) -> Callable[[Recording], Recording]:
    """Return a change that makes CompressedImage messages of rgb8 images."""

    def change(recording: Recording) -> Recording:
        for recorded in _images(recording):
            data = cv2.imencode(suffix, cv2.cvtColor(_pixels(recorded.message), cv2.COLOR_RGB2BGR))[1].reshape(-1)
            recorded.message = make(
                "sensor_msgs/msg/CompressedImage", header=recorded.message.header, format=form, data=data
            )
            recorded.topic += "/compressed"
        return recording

    return change


def compressed16(recording: Recording) -> Recording:
    """Make CompressedImage messages of 16 bits of mono8 images, as PNG."""
    for recorded in _images(recording):
        data = cv2.imencode(".png", _pixels(recorded.message).astype(np.uint16) * 200)[1].reshape(-1)
        header, form = recorded.message.header, "mono16; png compressed "
        recorded.message = make("sensor_msgs/msg/CompressedImage", header=header, format=form, data=data)
        recorded.topic += "/compressed"
    return recording


def yuyv(rgb: np.ndarray, luma_first: bool) -> np.ndarray:
    """Return (H, W, 2) 4:2:2 YUV of (H, W, 3) RGB."""
    yuv = cv2.cvtColor(rgb, cv2.COLOR_RGB2YUV)
    chroma = yuv[..., 1].copy()
    chroma[:, 1::2] = yuv[:, ::2, 2]
    return np.stack([yuv[..., 0], chroma] if luma_first else [chroma, yuv[..., 0]], -1)


def without_camera_info(recording: Recording) -> Recording:
    """Leave camera_info out."""
    return [recorded for recorded in recording if recorded.topic != CAMERA_INFO]


def unreadable(recording: Recording) -> Recording:
    """Let some images be noise, black, cut, or of an encoding that does not exist."""
    images = _images(recording)
    shape = images[0].message.data.shape
    images[3].message.data = np.random.default_rng(1).integers(0, 256, shape, np.uint8)
    images[4].message.data = np.zeros(shape, np.uint8)
    images[6].message.data = images[6].message.data[:1000]
    images[8].message.encoding = "hexagonal8"
    images[10].message.width = 0
    return recording


def noise(recording: Recording) -> Recording:
    """Replace every second image by noise."""
    rng = np.random.default_rng(2)
    for recorded in _images(recording)[1::2]:
        recorded.message.data = rng.integers(0, 256, recorded.message.data.shape, np.uint8)
    return recording


def restamped(recording: Recording) -> Recording:
    """Let stamps jump back, repeat, jump ahead, and be zero."""
    stamps = sorted({_stamp_ns(recorded) for recorded in recording})
    new = dict(zip(stamps, stamps, strict=True))
    for number, stamp_ns in {4: stamps[0], 5: stamps[1], 7: new[stamps[6]], 8: stamps[8] + 10**10, 9: 0, 10: 0}.items():
        new[stamps[number]] = stamp_ns
    for recorded in recording:
        _set_stamp(recorded, new[_stamp_ns(recorded)])
    return recording


def two_cameras(recording: Recording) -> Recording:
    """Let a second camera with another focal length and frame_id publish on the same topics."""
    both: Recording = []
    for recorded in recording:
        other = copy.deepcopy(recorded)
        other.message.header.frame_id = "right"
        if other.topic == CAMERA_INFO:
            other.message.k[[0, 4]] *= 1.1
            other.message.p[[0, 5]] *= 1.1
        both += [recorded, other]
    return both


def recalibrated(recording: Recording) -> Recording:
    """Let the camera change its focal length, lose its calibration, and get a useless one."""
    infos = [recorded for recorded in recording if recorded.topic == CAMERA_INFO]
    for recorded in infos[4:7]:
        recorded.message.k[[0, 4]] *= 1.05
    for recorded in infos[7:9]:
        recorded.message.k[:] = 0.0
    for recorded in infos[9:11]:
        recorded.message.distortion_model = "barrel"
        recorded.message.d = np.array([0.1, 0.2])
    return recording


def windowed(recording: Recording) -> Recording:
    """Say that images are a window of a sensor of 720 x 540 px, binned 2 x 2."""
    for recorded in recording:
        message = recorded.message
        if recorded.topic == CAMERA_INFO:
            message.width, message.height, message.binning_x, message.binning_y = 720, 540, 2, 2
            roi = message.roi
            roi.x_offset, roi.y_offset, roi.width, roi.height = 40, 30, 640, 480
            message.k[:] = np.array([[2, 0, 40.5], [0, 2, 30.5], [0, 0, 1]]).dot(message.k.reshape(3, 3)).reshape(-1)
    return recording


def rectified(recording: Recording) -> Recording:
    """Let P alone be right for the images."""
    for recorded in recording:
        if recorded.topic == CAMERA_INFO:
            recorded.message.p[:] = np.pad(recorded.message.k.reshape(3, 3), ((0, 0), (0, 1))).reshape(-1)
            recorded.message.k[[0, 4]] *= 1.3
    return recording


def two_topics(recording: Recording) -> Recording:
    """Let a second topic carry images upside down, and a thermal camera's."""
    both: Recording = []
    for recorded in recording:
        both.append(recorded)
        if recorded.topic == IMAGE:
            other, thermal = copy.deepcopy(recorded), copy.deepcopy(recorded)
            other.topic, thermal.topic = "/rear/image_raw", "/thermal/image_raw"
            other.message.data = other.message.data[::-1].copy()
            _set_pixels(thermal.message, _pixels(thermal.message).astype(np.uint16) * 20, "16UC1")
            both += [other, thermal]
    return both


def mislabelled(recording: Recording) -> Recording:
    """Call mosaics mono8, and give their frame a long name with strange characters."""
    for recorded in recording:
        recorded.message.header.frame_id = "=camera\t\u202e" + "x" * 2000
        if recorded.topic == IMAGE:
            recorded.message.encoding = "mono8"
    return recording


def long(recording: Recording) -> Recording:
    """Play the recording forwards and backwards until it has 520 images."""
    images, infos = _images(recording), [recorded for recorded in recording if recorded.topic == CAMERA_INFO]
    played: Recording = []
    for number in range(520):
        index = number % (2 * len(images) - 2)
        index = min(index, 2 * len(images) - 2 - index)
        for recorded in (infos[index], images[index]):
            again = copy.deepcopy(recorded)
            again.time_ns = images[0].time_ns + number * 40_000_000
            _set_stamp(again, again.time_ns)
            played.append(again)
    return played


def planes(rgb: np.ndarray) -> np.ndarray:
    """Return (H * 3 / 2, W) YUV 4:2:0 with interleaved chroma."""
    i420 = cv2.cvtColor(rgb, cv2.COLOR_RGB2YUV_I420)
    height = rgb.shape[0]
    u, v = i420[height : height * 5 // 4].reshape(-1), i420[height * 5 // 4 :].reshape(-1)
    return np.concatenate([i420[:height].reshape(-1), np.column_stack([u, v]).reshape(-1)]).reshape(i420.shape)


def _stamp_ns(recorded: Recorded) -> int:
    stamp = recorded.message.header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _set_stamp(recorded: Recorded, stamp_ns: int) -> None:
    recorded.message.header.stamp.sec, recorded.message.header.stamp.nanosec = divmod(stamp_ns, 10**9)


@dataclass(frozen=True, slots=True)
class Changed:
    """A recording made from another: what changes its messages, and how it is written."""

    base: str
    change: Callable[[Recording], Recording] = lambda recording: recording
    storage: str = "mcap"


_STORE = get_typestore(Stores.ROS2_JAZZY)
_ROS1 = get_typestore(Stores.ROS1_NOETIC)

CHANGED = {
    "rgba8": Changed("rgb8", encoded("rgba8", lambda rgb: cv2.cvtColor(rgb, cv2.COLOR_RGB2RGBA))),
    "uyvy": Changed("rgb8", encoded("yuv422", lambda rgb: yuyv(rgb, False))),
    "yuyv": Changed("rgb8", encoded("yuv422_yuy2", lambda rgb: yuyv(rgb, True))),
    "32FC1": Changed("mono8", encoded("32FC1", lambda grey: (grey / 255).astype(np.float32))),
    "8UC5": Changed("rgb8", encoded("8UC5", lambda rgb: np.dstack([rgb, rgb[..., :2]]))),
    "bgra8": Changed("rgb8", encoded("bgra8", lambda rgb: cv2.cvtColor(rgb, cv2.COLOR_RGB2BGRA))),
    "argb8": Changed("rgb8", encoded("argb8", lambda rgb: np.dstack([rgb[..., :1] * 0, rgb]))),
    "bgr16": Changed("rgb8", encoded("bgr16", lambda rgb: rgb[..., ::-1].astype(np.uint16) * 257)),
    "rgba16": Changed(
        "rgb8", encoded("rgba16", lambda rgb: cv2.cvtColor(rgb.astype(np.uint16) * 16, cv2.COLOR_RGB2RGBA))
    ),
    "nv12": Changed("rgb8", encoded("nv12", planes)),
    "16UC1": Changed("mono8", encoded("16UC1", lambda grey: grey.astype(np.uint16) * 100 + 500)),
    "64FC3": Changed("rgb8", encoded("64FC3", lambda rgb: rgb / 3.0)),
    "png16": Changed("mono8", compressed16),
    "recalibrated": Changed("bayer8", recalibrated),
    "windowed": Changed("bayer8", windowed),
    "rectified": Changed("bayer8", rectified),
    "two_topics": Changed("mono8", two_topics),
    "mislabelled": Changed("bayer8", mislabelled),
    "long": Changed("mono8", long),
    "jpeg": Changed("rgb8", compressed(".jpg", "rgb8; jpeg compressed bgr8")),
    "png": Changed("rgb8", compressed(".png", "rgb8; png compressed bgr8")),
    "uncalibrated": Changed("bayer8", without_camera_info),
    "unreadable": Changed("bayer8", unreadable),
    "noise": Changed("mono8", noise),
    "restamped": Changed("bayer8", restamped),
    "two_cameras": Changed("bayer8", two_cameras),
    "rosbag1": Changed("bayer8", storage="rosbag1"),
    "zstd_file": Changed("bayer8", storage="zstd file"),
    "zstd_message": Changed("bayer8", storage="zstd message"),
}


@dataclass(frozen=True, slots=True)
class Case:
    """One run of `imgu replay`, or of another command.

    Attributes
    ----------
    name : of the case
    recording : that it needs
    options : of `imgu replay` besides the recording's own parameter file; or a whole command line. `{out}` is the
        folder for results and `{in}` that with recordings and pictures
    is_quick : belongs to `--quick`
    """

    name: str
    recording: str
    options: str = ""
    is_quick: bool = False

    def command(self, recordings: Path, out: Path) -> list[str]:
        """Return the arguments of `imgu`, which reads from `recordings` and writes into `out`."""
        if self.options[:1].isalpha():
            return [part.format(out=out, **{"in": recordings}) for part in shlex.split(self.options)]
        bag = recordings / self.recording
        bag = bag if bag.exists() else bag.with_suffix(".bag")
        parameters = ["--params-file", str(recordings / f"{self.recording}.yaml")]
        options = [part.format(out=out, **{"in": recordings}) for part in self.options.split()]
        return ["replay", str(bag), "--out", str(out), *parameters, *options]


def _choices(recording: str, parameter: str, values: str, *more: str) -> list[Case]:
    """Return a case for each value of a parameter."""
    options = " ".join(f"-p {option}" for option in more)
    return [Case(f"{parameter}={value}", recording, f"-p {parameter}:={value} {options}") for value in values.split()]


_TOPICS = "--record keypoints matches path image_color image_mono debug_image"
_NO_TRACK, _NO_ALIGNMENT = "tracking.enabled:=false", "refinement.enabled:=false"
_SEARCHED = f"-p {_NO_TRACK}"
#: Poses in the map of five targets on one plane, x and y apart.
_MAP = (
    "-p targets.poses:=["
    + ",".join(f"{x},{y},0.0,0.0,0.0,0.0,1.0" for x, y in ((0.0, 0.0), (0.6, 0.0), (1.2, 0.0), (0.0, 0.6), (0.6, 0.6)))
    + "]"
)
_FRAMES = "-p frames.camera:=eye -p frames.map:=world -p frames.target_prefix:=print_ -p tf.root_frame:=base"
_FRAMES += " -p path.max_length:=4"
#: Variances of fx, fy, cx, cy and five coefficients of distortion, without correlations.
_COVARIANCE = str(np.diag([4.0, 4.0, 1.0, 1.0, 1e-4, 1e-4, 1e-6, 1e-6, 1e-4]).reshape(-1).tolist()).replace(" ", "")
#: As `imgu calibrate` writes it: of the camera that `imgu simulate` has by default.
_CAMERA_FILE = """image_width: 320
image_height: 240
camera_name: camera
camera_matrix: {rows: 3, cols: 3, data: [270.0, 0.0, 159.5, 0.0, 270.0, 119.5, 0.0, 0.0, 1.0]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0.01, -0.01, 0.0, 0.0, 0.0]}
rectification_matrix: {rows: 3, cols: 3, data: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]}
projection_matrix: {rows: 3, cols: 4, data: [270.0, 0.0, 159.5, 0.0, 0.0, 270.0, 119.5, 0.0, 0.0, 0.0, 1.0, 0.0]}
calibration_covariance: {rows: 4, cols: 4, data: [1.0, 0.9, 0, 0, 0.9, 1.0, 0, 0, 0, 0, 0.3, 0, 0, 0, 0, 0.3]}
"""

# fmt: off
CASES = (
    Case("bayer8", "bayer8", _TOPICS, is_quick=True),
    Case("bayer16", "bayer16", "-p raw.significant_bits:=12 -p raw.black_level:=64.0", is_quick=True),
    Case("bayer16_percentiles", "bayer16"),
    Case("mono8", "mono8", is_quick=True),
    Case("mono16_big_endian", "mono16"),
    Case("rgb8", "rgb8", is_quick=True),
    Case("bgr8_padded", "bgr8"),
    Case("rgba8", "rgba8"),
    Case("uyvy", "uyvy"),
    Case("yuyv", "yuyv"),
    Case("bgra8", "bgra8"),
    Case("argb8", "argb8", "-p raw.gains:=[1.2,1.0,0.8]"),
    Case("rgb16", "rgb16", "-p raw.white_level:=16000.0 -p raw.black_level:=5.0"),
    Case("bgr16", "bgr16"),
    Case("rgba16", "rgba16"),
    Case("bayer16_big_endian", "bayer16_big_endian", "-p demosaic.method:=malvar --record image_color"),
    Case("gbrg", "gbrg", "-p demosaic.method:=menon --record image_color"),
    Case("nv12", "nv12"),
    Case("16UC1", "16UC1"),
    Case("64FC3", "64FC3"),
    Case("png16", "png16"),
    Case("mislabelled", "mislabelled", "-p raw.encoding:=bayer_rggb8"),
    Case("32FC1", "32FC1"),
    Case("8UC5", "8UC5"),
    Case("8UC5_of_bands", "8UC5", "-p raw.band_mode:=weighted -p raw.bands:=[0,4] -p raw.band_weights:=[1.0,2.0]"),
    Case("8UC5_spectrum", "8UC5", "-p raw.band_mode:=spectral_angle -p raw.reference_spectrum:=[9.0,6.0,3.0,1.0,1.0]"),
    *_choices("8UC5", "raw.band_mode", "principal_component"),
    *_choices("rgb8", "raw.transfer", "linear srgb"),
    Case("grey_weights", "bayer8", "-p raw.grey_weights:=[1.0,0.0,0.5] -p raw.gains:=[2.0,1.0,1.5]"),
    Case("jpeg", "jpeg", is_quick=True),
    Case("png", "png"),
    Case("plumb_bob", "plumb_bob", is_quick=True),
    Case("rational", "rational"),
    Case("fisheye", "fisheye", is_quick=True),
    Case("thin_prism", "thin_prism"),
    Case("tilted", "tilted"),
    Case("recalibrated", "recalibrated"),
    Case("windowed", "windowed"),
    Case("rectified", "rectified", "-p camera.rectified:=true"),
    Case("camera_file", "uncalibrated", "-p camera.info_file:={in}/camera.yaml", is_quick=True),
    Case("row_time", "plumb_bob", "-p camera.row_time_us:=20 --truth {in}/plumb_bob/truth.csv"),
    Case("camera_covariance", "plumb_bob", f"-p camera.covariance:={_COVARIANCE} --truth {{in}}/plumb_bob/truth.csv"),
    Case("two_topics", "two_topics", "-p image_topic:=/rear/image_raw -p camera_info_topic:=/camera/camera_info"),
    Case("topic_chosen", "two_topics"),
    Case("long", "long", "-p seed:=7"),
    Case("targets", "targets", f"-p publish_tf:=true {_MAP} {_FRAMES} --record path", is_quick=True),
    Case("target_files", "targets", "-p targets.images:=[{in}/picture0.jpg,{in}/picture1.tif,{in}/picture2.ppm,"
         "{in}/picture3.bmp,{in}/picture4.png] -p targets.names:=[a,b,c,d,e] -p tracking.search_every:=2"),
    Case("targets_searched", "targets", f"{_SEARCHED} -p search.thorough:=false"),
    Case("large", "large", is_quick=True),
    Case("large_searched", "large", _SEARCHED),
    Case("uncalibrated", "uncalibrated", is_quick=True),
    Case("no_size", "bayer8", "-p targets.widths_m:=[0.0]", is_quick=True),
    Case("unreadable", "unreadable", is_quick=True),
    Case("degenerate", "noise", f"{_SEARCHED} -p homography.threshold_px:=60.0 -p homography.min_inliers:=4 "
         "-p matching.ratio:=1.0 -p matching.mutual:=false -p refinement.enabled:=false"),
    Case("restamped", "restamped", is_quick=True),
    Case("two_cameras", "two_cameras", is_quick=True),
    Case("rosbag1", "rosbag1"),
    Case("zstd_file", "zstd_file"),
    Case("zstd_message", "zstd_message"),
    Case("not_refined", "bayer8", "-p refinement.enabled:=false", is_quick=True),
    Case("not_refined_searched", "bayer8", f"{_SEARCHED} -p refinement.enabled:=false"),
    Case("numbers_tracked", "gbrg", "-p refinement.max_points:=60 -p refinement.window_px:=9 "
         "-p pose.ambiguity_ratio:=0.5 -p tracking.search_every:=1 --truth {in}/gbrg/truth.csv"),
    Case("numbers_searched", "large", f"{_SEARCHED} -p pyramid.levels:=4 -p pyramid.kind:=fine "
         "-p pyramid.max_side_px:=500 -p pyramid.scales_per_octave:=2 -p keypoints.max_count:=300 "
         "-p keypoints.detector:=fast -p keypoints.fast_arc:=10 -p matching.ratio:=0.95 -p matching.mutual:=false "
         "-p homography.threshold_px:=2.0 -p homography.confidence:=0.99 -p homography.max_iterations:=200 "
         "-p homography.min_inliers:=12 -p search.max_side_px:=700 -p search.max_count:=900 -p seed:=5"),
    Case("guided_distorted", "plumb_bob", f"{_SEARCHED} -p matching.guided:=true -p refinement.enabled:=false"),
    Case("guided", "bayer8", f"{_SEARCHED} -p matching.guided:=true"),
    *_choices("bayer8", "demosaic.method", "edge_aware malvar hamilton_adams menon residual"),
    *_choices("bayer8", "pyramid.kind", "fine laplacian", _NO_TRACK),
    *_choices("mono8", "pyramid.kernel", "discrete recursive", _NO_TRACK),
    *_choices("mono8", "keypoints.detector", "fast harris moravec dog mser", _NO_TRACK),
    *_choices("mono8", "descriptor.kind", "sift rootsift brief patch", _NO_TRACK),
    *_choices("mono8", "matching.metric", "euclidean cosine", _NO_TRACK, "descriptor.kind:=sift"),
    *_choices("mono8", "matching.metric", "hamming", _NO_TRACK, "descriptor.kind:=brief"),
    *_choices("mono8", "matching.metric", "ssd zmssd ncc", _NO_TRACK, "descriptor.kind:=patch"),
    *_choices("mono8", "homography.estimator", "usac_magsac usac_then_ransac", _NO_TRACK),
    *_choices("mono8", "homography.sampler", "uniform", _NO_TRACK),
    *_choices("mono8", "homography.score", "biweight", _NO_TRACK),
    *_choices("mono8", "homography.error", "algebraic transfer symmetric reprojection", _NO_TRACK, _NO_ALIGNMENT),
    *_choices("mono8", "homography.refine", "none steepest_descent gauss_newton", _NO_TRACK, _NO_ALIGNMENT),
    *_choices("mono8", "preprocess.equalisation", "global clahe"),
    *_choices("mono8", "preprocess.edges", "strength", _NO_TRACK),
    *_choices("mono8", "preprocess.derivative", "scharr gaussian", _NO_TRACK, "preprocess.edges:=strength"),
    *_choices("mono8", "preprocess.threshold", "fixed otsu", _NO_TRACK, "preprocess.threshold_value:=100.0",
              "preprocess.threshold_bins:=64"),
    Case("preprocess", "mono8", "-p preprocess.smoothing_px:=1.0 -p preprocess.contrast:=1.3 -p preprocess.gamma:=0.7 "
         "-p preprocess.brightness:=-10.0"),
    Case("match", "mono8", "match {in}/picture0.png {in}/mono8.png --json {out}/match.json --draw {out}/drawn.png "
         "--warp {out}/warped.png -p raw.transfer:=linear", is_quick=True),
    Case("demosaic", "bayer8", "demosaic {in}/bayer8.png {out}/colour.png --pattern rggb --method menon --gains 2,1,1"),
    Case("filter_kernel", "rgb8", "filter {in}/rgb8.png {out}/kernel.png --method kernel --kernel '0 1 2;0 3 0;1 0 1'"),
    *(Case(f"filter_{method}", "rgb8", f"filter {{in}}/rgb8.png {{out}}/filtered.png --method {method}")
      for method in ("mean", "gaussian", "detail", "strength", "direction", "edges", "canny")),
    Case("warp", "rgb8", "warp {in}/rgb8.png {out}/warped.png --rotate 30 --scale 0.7 --whole --interpolation cubic"),
    Case("check", "rgb8", "check {in}/rgb8.png tag36h11:7 --width-m 0.5 --json {out}/check.json "
         "-p search.thorough:=false"),
    Case("make", "rgb8", "make {in}/rgb8.png --width-m 0.5 --out {out}/print.pdf"),
    Case("calibrate", "chessboard", "calibrate {in}/chessboard --board 7x5 --square 0.025 --out {out}/camera.yaml "
         "--json {out}/calibration.json", is_quick=True),
    Case("simulate", "mono8", "simulate --out {out} --size 160x120 --frames 3 --seed 5 --exposure-ms 4 "
         "--row-time-us 30 --defocus-px 2 --ev=-1,0 --distortion tilted --template {in}/picture0.png"),
    Case("simulate_thin_lens", "mono8", "simulate --out {out} --size 160x120 --frames 2 --bits 10 --pattern gbrg "
         "--f-number 2.8 --distortion thin_prism --view-deg 70 --storage sqlite3 --template {in}/picture2.png"),
)
# fmt: on


def make_template(number: int, path: Path) -> None:
    """Write a picture of random discs and rectangles, 360 x 270 px."""
    rng = np.random.default_rng(100 + number)
    picture = np.full((270, 360, 3), 200, np.uint8)
    for _ in range(160):
        x, y, size = (int(v) for v in rng.integers((0, 0, 4), (360, 270, 30)))
        colour = [int(v) for v in rng.integers(0, 256, 3)]
        if rng.random() < 0.5:
            cv2.circle(picture, (x, y), size, colour, -1, cv2.LINE_AA)
        else:
            cv2.rectangle(picture, (x, y), (x + 2 * size, y + size), colour, -1)
    cv2.imwrite(str(path), picture)


def make_recordings(
    names: Iterable[str], folder: Path, simulate: Callable[[list[tuple[list[str], Path]]], None]
) -> None:
    """Make those of the recordings with these names that `folder` lacks.

    NAME is the bag, NAME.yaml its parameter file, and NAME.png its first image where that has 8 bits.

    Parameters
    ----------
    names : of `SIMULATED` or `CHANGED`, or `chessboard`
    folder : where
    simulate : runs command lines of `imgu`; takes their arguments, each with a folder
    """
    folder.mkdir(parents=True, exist_ok=True)
    # The parameter file is written last, and marks a complete recording.
    missing = {name for name in names if not (folder / f"{name}.yaml").exists()}
    if not missing:
        return
    templates = [folder / f"picture{number}.png" for number in range(5)]
    for number, path in enumerate(templates):
        make_template(number, path)
    for path, suffix in zip(templates, (".jpg", ".tif", ".ppm", ".bmp"), strict=False):
        cv2.imwrite(str(path.with_suffix(suffix)), cv2.imread(str(path)))
    (folder / "camera.yaml").write_text(_CAMERA_FILE)
    bases = {CHANGED[name].base if name in CHANGED else name for name in missing} & set(SIMULATED)
    bases = {name for name in bases if not (folder / f"{name}.yaml").exists()}
    simulate(
        [
            (["simulate", "--out", str(folder / name), *SIMULATED[name].format(*templates).split()], folder / name)
            for name in sorted(bases)
        ]
    )
    for name in sorted(bases):
        parameters = folder / name / "params.yaml"
        if not parameters.is_file():
            raise SystemExit(f"same_numbers: error: recording {name}: {(folder / f'{name}.log').read_text().strip()}")
        message = _images(_read(folder / name))[0].message
        if message.encoding.endswith("8"):
            pixels = _pixels(message)
            cv2.imwrite(str(folder / f"{name}.png"), pixels[..., ::-1] if message.encoding == "rgb8" else pixels)
        (folder / f"{name}.yaml").write_text(parameters.read_text())
    for name in sorted(missing & set(CHANGED)):
        changed = CHANGED[name]
        shutil.rmtree(folder / name, ignore_errors=True)
        write_bag(changed.change(_read(folder / changed.base)), folder / name, changed.storage)
        (folder / f"{name}.yaml").write_text((folder / f"{changed.base}.yaml").read_text())
    if "chessboard" in missing:
        make_chessboards(folder / "chessboard")
        (folder / "chessboard.yaml").write_text("")


def make_chessboards(folder: Path) -> None:
    """Write 10 views of a chessboard with 7 x 5 inner corners as pictures of 320 x 240 px."""
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng(3)
    squares = np.add.outer(np.arange(6), np.arange(8)) % 2
    board = np.pad(np.kron(squares, np.ones((40, 40))) * 220 + 15, 40, constant_values=235).astype(np.uint8)
    K = np.array([[300.0, 0, 159.5], [0, 300, 119.5], [0, 0, 1]])
    board_from_px = np.array([[0.025 / 40, 0, -0.125], [0, 0.025 / 40, -0.1], [0, 0, 1]])
    for number in range(10):
        R = cv2.Rodrigues(rng.uniform(-0.5, 0.5, 3))[0]
        t = np.array([*rng.uniform(-0.03, 0.03, 2), rng.uniform(0.3, 0.42)])
        H = K @ np.column_stack([R[:, :2], t]) @ board_from_px
        # Drawn at four times the size and reduced, so that edges are smooth.
        large = np.array([[4.0, 0, 1.5], [0, 4, 1.5], [0, 0, 1]]) @ H
        view = cv2.warpPerspective(board, large, (1280, 960), flags=cv2.INTER_LINEAR, borderValue=235)
        cv2.imwrite(str(folder / f"view{number}.png"), cv2.resize(view, (320, 240), interpolation=cv2.INTER_AREA))


def make(type_name: str, **values: Any) -> Any:
    """Make a message."""
    return _STORE.types[type_name](**values)


def _read(folder: Path) -> Recording:
    with AnyReader([folder]) as reader:
        # Arrays of a copy can be written to.
        return [
            Recorded(connection.topic, time_ns, copy.deepcopy(_STORE.deserialize_cdr(data, connection.msgtype)))
            for connection, time_ns, data in reader.messages()
        ]


def write_bag(recording: Recording, folder: Path, storage: str) -> Path:
    """Write a bag; `storage` is mcap, sqlite3, rosbag1, `zstd file` or `zstd message`."""
    if storage == "rosbag1":
        return _write_rosbag1(recording, folder)
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    writer = Writer(folder, version=9, storage_plugin=plugin)
    if storage.startswith("zstd"):
        mode = CompressionMode.FILE if storage == "zstd file" else CompressionMode.MESSAGE
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for recorded in recording:
            name = recorded.message.__msgtype__
            if recorded.topic not in connections:
                connections[recorded.topic] = writer.add_connection(recorded.topic, name, typestore=_STORE)
            writer.write(connections[recorded.topic], recorded.time_ns, _STORE.serialize_cdr(recorded.message, name))
    return folder


def _write_rosbag1(recording: Recording, folder: Path) -> Path:
    path = folder.parent / f"{folder.name}.bag"
    with Rosbag1Writer(path) as writer:
        connections = {}
        for number, recorded in enumerate(recording):
            name = recorded.message.__msgtype__
            message = recorded.message
            message.header = _ROS1.types["std_msgs/msg/Header"](number, message.header.stamp, message.header.frame_id)
            if name.endswith("CameraInfo"):
                values = {key.upper() if len(key) == 1 else key: v for key, v in vars(message).items()}
                message = _ROS1.types[name](**{k: v for k, v in values.items() if not k.startswith("__")})
            if recorded.topic not in connections:
                connections[recorded.topic] = writer.add_connection(recorded.topic, name, typestore=_ROS1)
            writer.write(connections[recorded.topic], recorded.time_ns, _ROS1.serialize_ros1(message, name))
    return path
