# SPDX-License-Identifier: Apache-2.0
"""Names of distortion models in drivers and calibration tools -> a model and its coefficients."""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass

from imgu_ros.errors import EncodingError
from imgu_ros.vision.camera.distortion_model import COEFFICIENTS, DistortionModel


@dataclass(frozen=True, slots=True)
class Lens:
    """A lens as it was named.

    Attributes
    ----------
    model : the distortion model
    coefficients : as many as the model has or fewer, in its order
    remark : what was guessed; empty when nothing was
    """

    model: DistortionModel
    coefficients: tuple[float, ...]
    remark: str = ""


def named_lens(name: str, given: tuple[float, ...]) -> Lens:
    """Return the lens that a `distortion_model` and its D mean.

    Case, blanks, dashes and underscores of the name do not matter. No coefficients, or zeros alone, are no distortion
    under any name but a fisheye's, whose projection bends without them. Zeros at the end of D change nothing in any
    model: drivers pad it to a fixed length.

    Raises
    ------
    EncodingError
        If the model is unknown or not computed, or D has another number of coefficients than the model.

    Examples
    --------
    >>> named_lens("Brown Conrady", (0.1, 0.0, 0.0, 0.0, 0.0)).model
    <DistortionModel.PLUMB_BOB: 'plumb_bob'>
    >>> named_lens("none", ()).coefficients
    ()
    """
    # The name comes from outside: of an endless one the start counts.
    key = re.sub(r"[^a-z0-9]", "", name[:80].lower())
    shown = repr(name[:40])
    count = len(given)
    while count and given[count - 1] == 0:
        count -= 1
    if key in _NO_PERSPECTIVE:
        raise EncodingError(f"distortion_model {shown} is no perspective camera's; {_NEED}")
    if key in _FISHEYE:
        if count > COEFFICIENTS[DistortionModel.EQUIDISTANT]:
            raise EncodingError(f"D has {count} coefficients for {shown}; need at most 4 (k1 k2 k3 k4)")
        return Lens(DistortionModel.EQUIDISTANT, given[:count])
    if not count:
        return Lens(DistortionModel.PLUMB_BOB, ())
    if key in _UNDISTORTED:
        raise EncodingError(f"distortion_model {shown} is no distortion, but D is {listed(given)}; {_NEED}")
    if key in _OTHER:
        raise EncodingError(f"distortion_model {shown} {_OTHER[key]}; {_NEED}")
    if key not in _OF_OPENCV:
        near = difflib.get_close_matches(key, sorted(_OF_OPENCV | _FISHEYE - {""}), n=1, cutoff=0.75)
        hint = f" (did you mean {_SPELLED.get(near[0], near[0])!r}?)" if near else ""
        raise EncodingError(f"distortion_model {shown} is unknown{hint} and D is {listed(given)}; {_NEED}")
    return _of_opencv(key, shown, given, count)


def _of_opencv(key: str, shown: str, given: tuple[float, ...], count: int) -> Lens:
    """Return the lens of OpenCV's coefficients, of which the first `count` matter."""
    # The order is the same in all lengths, but what stands at the third place is known from the fourth on alone.
    length = next((n for n in _LENGTHS if n >= count), None)
    if length is None or length > len(given):
        raise EncodingError(f"D has {len(given)} coefficients for {shown}; need {_LENGTHS_NEEDED}")
    if key in _THIN_PRISM and len(given) < COEFFICIENTS[DistortionModel.THIN_PRISM]:
        raise EncodingError(f"D has {len(given)} coefficients for {shown}; need 12 (k1 k2 p1 p2 k3 to k6 s1 to s4)")
    least = 5 if key in _BROWN or not key else 8
    model = next(m for m in _MODELS if COEFFICIENTS[m] >= max(least, length))
    remark = ""
    if not key:
        remark = f"distortion_model is empty: D of {len(given)} coefficients is read as {model}"
    elif key in _BROWN and length > COEFFICIENTS[DistortionModel.PLUMB_BOB]:
        remark = f"distortion_model {shown} with {count} coefficients (it has 5): D is read as {_MESSAGE_NAMES[model]}"
    return Lens(model, given[:count], remark)


def message_name(model: DistortionModel) -> str:
    """Return the name of a model in sensor_msgs/CameraInfo."""
    return _MESSAGE_NAMES.get(model, str(model))


def listed(given: tuple[float, ...]) -> str:
    """Return the first numbers for people."""
    return "[" + ", ".join(f"{value:g}" for value in given[:14]) + (", ...]" if len(given) > 14 else "]")


_MESSAGE_NAMES = {
    DistortionModel.RATIONAL_POLYNOMIAL: "rational_polynomial",
    DistortionModel.THIN_PRISM: "rational_polynomial",
    DistortionModel.TILTED: "rational_polynomial",
}
_NEED = "need plumb_bob, rational_polynomial or equidistant"
#: Numbers of coefficients with one meaning in OpenCV's order; of 3 the last may be p1 or k3.
_LENGTHS = (1, 2, 4, 5, 8, 12, 14)
_LENGTHS_NEEDED = "4, 5, 8, 12 or 14"
_MODELS = (
    DistortionModel.PLUMB_BOB,
    DistortionModel.RATIONAL_POLYNOMIAL,
    DistortionModel.THIN_PRISM,
    DistortionModel.TILTED,
)
_BROWN = frozenset(
    ("plumbbob", "radtan", "radialtangential", "pinholeradtan", "brownconrady", "brown", "brownconrady5", "opencv")
)
_RATIONAL = frozenset(("rationalpolynomial", "rational", "rationalpoly", "fullopencv"))
_THIN_PRISM = frozenset(("thinprism", "thinprismmodel", "rationalthinprism", "tilted", "tiltedmodel"))
_OF_OPENCV = _BROWN | _RATIONAL | _THIN_PRISM | {""}
_FISHEYE = frozenset(
    (
        "equidistant",
        "equi",
        "fisheye",
        "opencvfisheye",
        "pinholeequi",
        "kannalabrandt",
        "kannalabrandt4",
        "kb4",
        "kannalabrandt8",
        "kb8",
    )
)
#: A pinhole and nothing else.
_UNDISTORTED = frozenset(
    ("none", "null", "pinhole", "ideal", "perspective", "undistorted", "rectified", "nodistortion")
)
#: K of these is no pinhole's, whatever D says.
_NO_PERSPECTIVE = frozenset(
    (
        "equirectangular", "spherical", "panoramic", "panorama", "cylindrical", "orthographic", "stereographic",
        "equisolid", "equisolidangle", "ftheta", "fthetapolynomial", "fisheyepolynomial", "scaramuzza", "ocam",
    )
)  # fmt: skip
_NOT_COMPUTED = "is not computed"
_OTHER = {
    "inversebrownconrady": "leads from distorted points to ideal ones, which is not computed",
    "modifiedbrownconrady": "takes the tangential part of points that are bent already, which is not computed",
    **dict.fromkeys(
        (
            "ds", "doublesphere", "eucm", "extendedunified", "ucm", "unified", "mei", "omni", "omnidirectional", "cmei",
            "fov", "atan", "division", "fisheye62", "fisheye624", "thinprismfisheye",
        ),
        _NOT_COMPUTED,
    ),
}  # fmt: skip
_SPELLED = {
    "plumbbob": "plumb_bob",
    "rationalpolynomial": "rational_polynomial",
    "brownconrady": "brown_conrady",
    "kannalabrandt4": "kannala_brandt4",
    "thinprism": "thin_prism",
}
