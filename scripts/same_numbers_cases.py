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
    options : of `imgu replay` besides the recording's own parameter file; or a whole command line, in which `{out}` is
        the folder for results and `{in}` that with recordings and pictures
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
        return ["replay", str(bag), "--out", str(out), *parameters, *self.options.split()]


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
    Case("targets", "targets", f"-p publish_tf:=true {_MAP}", is_quick=True),
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
    Case("guided", "bayer8", f"{_SEARCHED} -p matching.guided:=true"),
    *_choices("bayer8", "demosaic.method", "edge_aware malvar hamilton_adams menon residual"),
    *_choices("bayer8", "pyramid.kind", "fine laplacian", _NO_TRACK),
    *_choices("mono8", "pyramid.kernel", "discrete recursive", _NO_TRACK),
    *_choices("mono8", "keypoints.detector", "fast harris moravec dog mser", _NO_TRACK),
    *_choices("mono8", "descriptor.kind", "sift rootsift brief patch", _NO_TRACK),
    *_choices("mono8", "matching.metric", "euclidean cosine", _NO_TRACK, "descriptor.kind:=sift"),
    *_choices("mono8", "matching.metric", "hamming", _NO_TRACK, "descriptor.kind:=brief"),
    *_choices("mono8", "matching.metric", "ssd zmssd ncc", _NO_TRACK, "descriptor.kind:=patch"),
    *_choices("mono8", "homography.sampler", "uniform", _NO_TRACK),
    *_choices("mono8", "homography.score", "biweight", _NO_TRACK),
    *_choices("mono8", "homography.error", "algebraic transfer symmetric reprojection", _NO_TRACK, _NO_ALIGNMENT),
    *_choices("mono8", "homography.refine", "none steepest_descent gauss_newton", _NO_TRACK, _NO_ALIGNMENT),
    *_choices("mono8", "preprocess.equalisation", "global clahe"),
    *_choices("mono8", "preprocess.edges", "strength", _NO_TRACK),
    *_choices("mono8", "preprocess.derivative", "scharr gaussian", _NO_TRACK, "preprocess.edges:=strength"),
    *_choices("mono8", "preprocess.threshold", "fixed otsu", _NO_TRACK),
    Case("preprocess", "mono8", "-p preprocess.smoothing_px:=1.0 -p preprocess.contrast:=1.3 -p preprocess.gamma:=0.7 "
         "-p preprocess.brightness:=-10.0"),
    Case("match", "mono8", "match {in}/picture0.png {in}/mono8.png --json {out}/match.json --draw {out}/drawn.png "
         "--warp {out}/warped.png -p raw.transfer:=linear", is_quick=True),
    Case("demosaic", "bayer8", "demosaic {in}/bayer8.png {out}/colour.png --pattern rggb --method menon --gains 2,1,1"),
    Case("filter_kernel", "rgb8", "filter {in}/rgb8.png {out}/kernel.png --method kernel --kernel '0 1 2;0 3 0;1 0 1'"),
    *(Case(f"filter_{method}", "rgb8", f"filter {{in}}/rgb8.png {{out}}/filtered.png --method {method}")
      for method in ("mean", "gaussian", "detail", "strength", "direction", "edges", "canny")),
    Case("warp", "rgb8", "warp {in}/rgb8.png {out}/warped.png --rotate 30 --scale 0.7 --whole --interpolation cubic"),
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
        return [
            Recorded(connection.topic, time_ns, _STORE.deserialize_cdr(data, connection.msgtype))
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
