"""Camera calibration files, in the YAML format of ROS's camera_calibration_parsers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from imgu_ros.errors import FileError, ShapeError
from imgu_ros.files.text_files import write_text
from imgu_ros.types import Floats
from imgu_ros.vision.camera.intrinsics import Camera, DistortionModel, make_camera

_MAX_BYTES = 2**20
#: OpenCV's name for the model that ROS calls equidistant.
_MODEL_NAMES = {"fisheye": DistortionModel.EQUIDISTANT}


def read_camera_info(path: Path | str) -> Camera:
    """Read the intrinsics from a camera_info YAML file.

    Raises
    ------
    FileError
        If the file is missing, no such YAML, or describes no calibrated camera.
    """
    path = Path(path)
    content = _content(path)
    K = _matrix(path, content, "camera_matrix", 9).reshape(3, 3)
    distortion = _matrix(path, content, "distortion_coefficients", None)
    model = str(content.get("distortion_model") or DistortionModel.PLUMB_BOB)
    width, height = (_size(path, content, name) for name in ("image_width", "image_height"))
    if not K.any():
        raise FileError(f"{path}: camera_matrix is all zero, which means not calibrated; need a calibrated camera")
    try:
        return make_camera(K, distortion, _MODEL_NAMES.get(model, model), width, height)
    except ShapeError as error:
        raise FileError(f"{path}: {error}") from None


def read_camera_name(path: Path | str) -> str:
    """Return the camera's name in a camera_info YAML file; empty when it has none. FileError as `read_camera_info`."""
    return str(_content(Path(path)).get("camera_name") or "")


def write_camera_info(path: Path | str, camera: Camera, name: str = "camera") -> None:
    """Write intrinsics as a camera_info YAML file that ROS's drivers and `read_camera_info` read; floats round-trip.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    write_text(Path(path), camera_info_text(camera, name))


def camera_info_text(camera: Camera, name: str = "camera") -> str:
    """Return the YAML text for a camera: rectification the identity, projection K (a single camera)."""
    projection = np.hstack((camera.K, np.zeros((3, 1))))
    content = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": name,
        "camera_matrix": _rows(camera.K),
        "distortion_model": str(camera.model),
        "distortion_coefficients": _rows(camera.distortion[None]),
        "rectification_matrix": _rows(np.eye(3)),
        "projection_matrix": _rows(projection),
    }
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120)


def _content(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise FileError(f"{path}: {path.stat().st_size} bytes; need a camera_info YAML file")
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FileError(f"{path}: {error.strerror}; need a camera_info YAML file") from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = "" if mark is None else f" in line {mark.line + 1}"
        raise FileError(f"{path}: no YAML{where} ({error.problem}); need a camera_info YAML file") from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise FileError(f"{path}: {' '.join(str(error).split())[:200]}; need a camera_info YAML file") from None
    if not isinstance(content, dict):
        raise FileError(f"{path}: holds {type(content).__name__}; need image_width, camera_matrix and so on")
    return content


def _matrix(path: Path, content: dict[str, Any], name: str, count: int | None) -> Floats:
    entry = content.get(name)
    data = entry.get("data") if isinstance(entry, dict) else None
    if not isinstance(data, list):
        raise FileError(f"{path}: no {name} with data; need a camera_info YAML file")
    try:
        values = np.asarray(data, dtype=np.float64)
    except (TypeError, ValueError):
        raise FileError(f"{path}: {name}: {str(data)[:80]}; need numbers") from None
    if values.ndim != 1 or (count is not None and len(values) != count):
        raise FileError(f"{path}: {name}: {values.size} values; need {count or 'a list'}")
    return values


def _size(path: Path, content: dict[str, Any], name: str) -> int:
    value = content.get(name)
    if type(value) is not int or value <= 0:
        raise FileError(f"{path}: {name}: {value!r}; need a positive integer")
    return value


def _rows(matrix: Floats) -> dict[str, object]:
    rows, columns = matrix.shape
    return {"rows": rows, "cols": columns, "data": [float(value) for value in matrix.ravel()]}
