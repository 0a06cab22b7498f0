# SPDX-License-Identifier: Apache-2.0
"""What calibration tools write -> `CameraDescription`: files of ROS, OpenCV, Kalibr, ORB-SLAM, and echoed messages.

- YAML of camera_calibration_parsers (`image_width`, `camera_matrix`, ...), with OpenCV's tags as well
  (cv::FileStorage), under its names of before version 3 too; `imgu calibrate` adds `calibration_covariance`, of fx, fy,
  cx, cy and the distortion coefficients, which ROS's reader passes over;
- a sensor_msgs/CameraInfo as `ros2 topic echo` and `rostopic echo` print it (`width`, `k` or `K`, ...), also as JSON;
- Kalibr's camchain (`cam0: {camera_model, intrinsics, ...}`); settings of ORB-SLAM and OpenVSLAM (`Camera.fx: ...`);
- the INI format of camera_calibration_parsers (`[image]`, `width`, ...).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

import yaml

from imgu_ros.config.parameters import DEFAULT_LIMITS, LimitsParameters
from imgu_ros.errors import FileError
from imgu_ros.files.yaml_tree import yaml_tree
from imgu_ros.messages.camera_reading import CameraDescription

#: Names, in lower case and without underscores, of what a YAML says.
_NAMES = {
    "K": ("cameramatrix", "k", "intrinsicmatrix", "mtx"),
    "D": ("distortioncoefficients", "d", "distcoeffs", "distortion", "dist"),
    "R": ("rectificationmatrix", "r"),
    "P": ("projectionmatrix", "p"),
    "width": ("imagewidth", "width"),
    "height": ("imageheight", "height"),
    "model": ("distortionmodel",),
    "covariance": ("calibrationcovariance",),
}
_INI_KEYS = {"camera matrix": "K", "distortion": "D", "rectification": "R", "projection": "P"}
_WANTED = "need a camera_info YAML or INI file, an echoed camera_info, or what OpenCV or Kalibr write"
#: Longer lists are no calibration.
_MOST_NUMBERS = 64
#: More pixels than any image has.
_MOST_PIXELS = 2**31


def described_camera(
    text: str, source: str, limits: LimitsParameters = DEFAULT_LIMITS
) -> tuple[CameraDescription, str]:
    """Return what a calibration says of its (first) camera, and the camera's name, empty when it has none.

    Parameters
    ----------
    text : of the file
    source : the file, for messages
    limits : `text_mb`

    Raises
    ------
    FileError
        If it is none of the formats, or a number in it is none.
    """
    if re.search(r"^[ \t]*\[[^\]\[,\n]*\][ \t\r]*$", text, re.MULTILINE) and re.search(
        r"^[ \t]*camera matrix[ \t\r]*$", text, re.MULTILINE
    ):
        return _of_ini(text, source)
    content = _yaml_content(text, source, limits)
    chain = next((value for key, value in content.items() if re.fullmatch(r"cam\d+", str(key))), None)
    if isinstance(chain, dict) and "intrinsics" in chain:
        return _of_kalibr(chain, source)
    dotted = next((name for name in ("Camera", "Camera1") if f"{name}.fx" in content), "")
    if dotted:
        return _of_orb_slam(content, dotted, source)
    return _of_yaml(content, source)


def _of_yaml(content: Mapping[str, Any], source: str) -> tuple[CameraDescription, str]:
    by_name = {re.sub("[_ ]", "", str(key)).lower(): value for key, value in content.items()}
    found = {what: next((by_name[name] for name in names if name in by_name), None) for what, names in _NAMES.items()}
    if found["K"] is None:
        raise FileError(f"{source}: no camera_matrix and no k; {_WANTED}")
    given = _numbers(found["D"], "distortion_coefficients", source) if found["D"] is not None else ()
    if found["model"] is not None:
        model = str(found["model"])
    else:
        # ROS's reader takes plumb_bob where the format has no model, or OpenCV's longer ones by their length.
        model = (
            "equidistant"
            if str(by_name.get("fisheyemodel")).lower() in ("1", "true", "yes", "on")
            else _model_of_length(len(given))
        )
    roi = by_name.get("roi")
    window = [_whole(roi.get(key), f"roi.{key}", source) for key in _ROI] if isinstance(roi, dict) else [0, 0, 0, 0]
    binning = [max(1, _whole(by_name.get(f"binning{axis}"), f"binning_{axis}", source)) for axis in "xy"]
    description = CameraDescription(
        source=source,
        K=_numbers(found["K"], "camera_matrix", source),
        D=given,
        R=() if found["R"] is None else _numbers(found["R"], "rectification_matrix", source),
        P=() if found["P"] is None else _numbers(found["P"], "projection_matrix", source),
        model=model,
        width=_whole(found["width"], "image_width", source),
        height=_whole(found["height"], "image_height", source),
        binning=(binning[0], binning[1]),
        roi=(window[0], window[1], window[2], window[3]),
        covariance=()
        if found["covariance"] is None
        else _numbers(found["covariance"], "calibration_covariance", source, _MOST_NUMBERS**2),
    )
    return description, str(content.get("camera_name") or "")


_ROI = ("x_offset", "y_offset", "width", "height")


def _of_kalibr(chain: Mapping[str, Any], source: str) -> tuple[CameraDescription, str]:
    camera_model = str(chain.get("camera_model") or "pinhole")
    intrinsics = _numbers(chain["intrinsics"], "intrinsics", source)
    if len(intrinsics) < 4:
        raise FileError(f"{source}: intrinsics: {len(intrinsics)} values; need fu fv pu pv")
    # Other models have more numbers before these; none of them is a pinhole with a lens before it.
    *others, fu, fv, pu, pv = intrinsics
    is_pinhole = camera_model == "pinhole"
    size = chain.get("resolution") or (0, 0)
    if not (isinstance(size, list | tuple) and len(size) == 2):
        raise FileError(f"{source}: resolution: {size!r}; need width and height")
    description = CameraDescription(
        source=source,
        K=(fu, 0.0, pu, 0.0, fv, pv, 0.0, 0.0, 1.0),
        D=(*others, *_numbers(chain.get("distortion_coeffs") or [], "distortion_coeffs", source)),
        model=str(chain.get("distortion_model") or "") if is_pinhole else camera_model,
        width=_whole(size[0], "resolution", source),
        height=_whole(size[1], "resolution", source),
    )
    return description, str(chain.get("rostopic") or "")


def _of_orb_slam(content: Mapping[str, Any], prefix: str, source: str) -> tuple[CameraDescription, str]:
    def said(*names: str) -> Any:
        keys = [f"{which}.{name}" for which in (prefix, "Camera") for name in names]
        return next((content[key] for key in keys if key in content), None)

    fx, fy, cx, cy = (_numbers([said(name)], f"{prefix}.{name}", source)[0] for name in ("fx", "fy", "cx", "cy"))
    kind = str(said("type", "model") or "PinHole")
    is_pinhole = kind.lower() in ("pinhole", "perspective", "rectified")
    names = ("k1", "k2", "p1", "p2", "k3") if is_pinhole else ("k1", "k2", "k3", "k4")
    given = [said(name) for name in names]
    description = CameraDescription(
        source=source,
        K=(fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0),
        D=_numbers([0 if value is None else value for value in given], f"{prefix}.k1", source),
        model="plumb_bob" if is_pinhole else kind,
        width=_whole(said("width", "cols"), f"{prefix}.width", source),
        height=_whole(said("height", "rows"), f"{prefix}.height", source),
    )
    return description, str(said("name") or "")


def _of_ini(text: str, source: str) -> tuple[CameraDescription, str]:
    """Read lines of keys, each followed by lines of numbers, of the first camera."""
    numbers: dict[str, list[float]] = {}
    key, name, section = "", "", ""
    for line in re.sub(r"[#;].*", "", text).splitlines():
        words = line.strip()
        if not words:
            continue
        if words.startswith("["):
            section = words.strip("[] ")
            if name and "K" in numbers and section not in ("image", "externals", name):
                break
            key = ""
        elif words.lower() in ("width", "height", *_INI_KEYS):
            key = _INI_KEYS.get(words.lower(), words.lower())
            name = name or (section if key not in ("width", "height") else "")
            numbers[key] = []
        elif key:
            numbers[key] += _numbers(words.split(), key, source)
    given = tuple(numbers.get("D", ()))
    sizes = [_whole((numbers.get(key) or [0])[0], f"image_{key}", source) for key in ("width", "height")]
    description = CameraDescription(
        source=source,
        K=tuple(numbers["K"]),
        D=given,
        R=tuple(numbers.get("R", ())),
        P=tuple(numbers.get("P", ())),
        model=_model_of_length(len(given)),
        width=sizes[0],
        height=sizes[1],
    )
    return description, name


def _model_of_length(count: int) -> str:
    return "plumb_bob" if count <= 5 else "rational_polynomial"


def _yaml_content(text: str, source: str, limits: LimitsParameters) -> Mapping[str, Any]:
    # cv::FileStorage of before 4.x writes "%YAML:1.0", which is no directive; echoed messages end with "---".
    text = re.sub(r"\A\ufeff?%YAML[^\n]*\n", "", text)
    try:
        content = yaml_tree(text, limits)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = "" if mark is None else f" in line {mark.line + 1}"
        raise FileError(f"{source}: no YAML{where} ({error.problem}); {_WANTED}") from None
    except (yaml.YAMLError, ValueError) as error:
        raise FileError(f"{source}: {' '.join(str(error).split())[:200]}; {_WANTED}") from None
    if not isinstance(content, dict):
        held = {str: "plain text or XML", type(None): "nothing"}.get(type(content), type(content).__name__)
        raise FileError(f"{source}: holds {held}; {_WANTED}")
    return content


def _numbers(entry: Any, name: str, source: str, most: int = _MOST_NUMBERS) -> tuple[float, ...]:
    """Return the numbers of a list, of a list of rows, or of a matrix with `data`."""
    data = entry.get("data") if isinstance(entry, dict) else entry
    if not isinstance(data, list | tuple):
        raise FileError(f"{source}: {name}: {str(data)[:80]}; need a list of numbers")
    flat = [value for row in data for value in (row if isinstance(row, list) else [row])]
    if len(flat) > most:
        raise FileError(f"{source}: {name}: {len(flat)} values; need those of one camera")
    try:
        return tuple(_number(value) for value in flat)
    except (TypeError, ValueError, OverflowError):
        raise FileError(f"{source}: {name}: {str(data)[:80]}; need numbers") from None


def _number(value: Any) -> float:
    """Return a number as YAML and C++ write it (`1e-05`, `.Nan`)."""
    if isinstance(value, str) and value.lower().lstrip("+-") in (".nan", ".inf"):
        value = value.replace(".", "")
    return float(value)


def _whole(value: Any, name: str, source: str) -> int:
    """Return a number of pixels; 0 when it is not said."""
    if value is None:
        return 0
    try:
        number = _number(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not (math.isfinite(number) and 0 <= number < _MOST_PIXELS and number == int(number)):
        raise FileError(f"{source}: {name}: {str(value)[:80]!r}; need a whole number of pixels")
    return int(number)
