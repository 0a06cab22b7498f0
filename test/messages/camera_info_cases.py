# SPDX-License-Identifier: Apache-2.0
"""camera_info messages as drivers fill them, each with the camera that really took the image and what is right.

What is right is known by construction: every case begins with a true camera, of which an image is rendered with OpenCV
alone; then it is written down as some driver does, well (`pose`) or not (`homography`: why), or the image itself is
spoiled (`rejected`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import cv2
import numpy as np

WIDTH_M = 0.4
TEXTURE = (640, 480)

NAN, INF = math.nan, math.inf
#: The target's width over its distance: of wide lenses it fills less of the image.
_MOST_ACROSS = 1.3


@dataclass(frozen=True)
class Truth:
    """The camera that took the image: of its own pixels, without any window or binning; `fisheye`: cv2.fisheye's D."""

    K: np.ndarray
    D: tuple[float, ...]
    fisheye: bool
    size: tuple[int, int]

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """Return x / z, y / z of pixels, (N, 2)."""
        points = np.ascontiguousarray(pixels, np.float64).reshape(-1, 1, 2)
        if self.fisheye:
            return cv2.fisheye.undistortPoints(points, self.K, np.array(self.D, np.float64)).reshape(-1, 2)
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
        if hasattr(cv2, "undistortPointsIter"):  # OpenCV 4
            return cv2.undistortPointsIter(points, self.K, np.array(self.D, np.float64), None, None, criteria).reshape(
                -1, 2
            )
        return cv2.undistortPoints(points, self.K, np.array(self.D, np.float64), criteria=criteria).reshape(-1, 2)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Return the pixels of points of the camera's frame, (N, 2)."""
        if self.fisheye:
            flat = points[None].astype(np.float64)
            return cv2.fisheye.projectPoints(flat, np.zeros(3), np.zeros(3), self.K, np.array(self.D, np.float64))[0][0]
        return cv2.projectPoints(points, np.zeros(3), np.zeros(3), self.K, np.array(self.D, np.float64))[0][:, 0]


@dataclass(frozen=True, eq=False)
class Case:
    """A message, the truth about its image, and what is right; `says`: a part of the reason."""

    name: str
    truth: Truth
    fields: dict[str, Any]
    outcome: str = "pose"
    says: str = ""
    remark: str = ""
    rectified: bool = False
    image: dict[str, Any] = field(default_factory=dict)

    @property
    def pose(self) -> tuple[np.ndarray, np.ndarray]:
        """R, t of camera_from_target: tilted, filling much of the image, wherever the lens's axis is."""
        width, height = self.truth.size
        centre = self.truth.rays(np.array([[width / 2, height / 2]]))[0]
        left, right = self.truth.rays(np.array([[0.2 * width, height / 2], [0.8 * width, height / 2]]))
        z = WIDTH_M / (min(right[0] - left[0], _MOST_ACROSS) if right[0] > left[0] else _MOST_ACROSS)
        R = cv2.Rodrigues(np.array([0.35, -0.4, 0.15]))[0] @ np.diag([1.0, -1.0, -1.0])
        return R, z * np.array([centre[0], centre[1], 1.0])


def rendered(case: Case, texture: np.ndarray) -> np.ndarray:
    """Return what the true camera sees, (H, W) uint8: each pixel the mean of four samples."""
    width, height = case.truth.size
    R, t = case.pose
    # Rays on a coarse grid; between, they are interpolated.
    knots_x, knots_y = np.arange(-4, width + 8, 4.0), np.arange(-4, height + 8, 4.0)
    grid = np.stack(np.meshgrid(knots_x, knots_y), axis=-1).reshape(-1, 2)
    rays = case.truth.rays(grid).astype(np.float32).reshape(len(knots_y), len(knots_x), 2)
    x = (np.arange(2 * width) + 0.5) / 2 - 0.5
    y = (np.arange(2 * height) + 0.5) / 2 - 0.5
    at = np.meshgrid((x + 4) / 4, (y + 4) / 4)
    dense = np.stack([_sampled(rays[..., axis], at) for axis in (0, 1)], axis=-1).astype(np.float64)
    # The plane z = 0 of the target.
    H = np.linalg.inv(np.column_stack((R[:, :2], t)))
    plane = np.dstack((dense, np.ones(dense.shape[:2]))) @ H.T
    with np.errstate(divide="ignore", invalid="ignore"):
        target = plane[..., :2] / plane[..., 2:]
    s = WIDTH_M / texture.shape[1]
    map_x = target[..., 0] / s + (texture.shape[1] - 1) / 2
    map_y = -target[..., 1] / s + (texture.shape[0] - 1) / 2
    maps = [np.nan_to_num(m, nan=-99.0).clip(-99, 9999).astype(np.float32) for m in (map_x, map_y)]
    fine = cv2.remap(texture, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT, borderValue=90)
    return cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA)


def _sampled(values: np.ndarray, at: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Interpolate linearly in float; cv2.remap would round the places to 1/32."""
    x, y = at
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    u, v = x - i, y - j
    top = values[j, i] * (1 - u) + values[j, i + 1] * u
    return top * (1 - v) + (values[j + 1, i] * (1 - u) + values[j + 1, i + 1] * u) * v


# ---------------------------------------------------------------------------------------------------------------------
# Lenses and their names

ZERO: tuple[float, ...] = (0.0,) * 5
BROWN = (-0.21, 0.07, 0.0008, -0.0005, -0.01)
AZURE_KINECT = (0.5076, -2.7177, 0.00092, -0.00029, 1.5917, 0.387, -2.5398, 1.5156)
RATIONAL = (0.35, 0.08, 0.0006, -0.0004, 0.01, 0.62, 0.16, 0.01)
PRISM = (*RATIONAL, 0.004, -0.002, 0.003, 0.001)
TILT = (*PRISM, 0.05, -0.03)
FISHEYE = (-0.03, 0.008, -0.004, 0.001)
FAINT = (1e-4,) * 8

NAMES_OF_NONE = (
    "", "none", "None", "NONE", "pinhole", "ideal", "radtan", "brown_conrady", "perspective", "Inverse Brown Conrady",
    "Modified Brown Conrady", "something_else", "rational_polynomial", "plumb_bob", "thin_prism", "opencv", "fov",
)  # fmt: skip
#: distortion_model, D as it is sent, D that is meant (cv2's order), a fisheye's, remark
LENSES: tuple[tuple[str, tuple[float, ...], tuple[float, ...], bool, str], ...] = (
    ("plumb_bob", BROWN, BROWN, False, ""),
    ("plumb_bob", BROWN[:4], BROWN[:4], False, ""),
    ("plumb_bob", (*BROWN, 0, 0, 0), BROWN, False, ""),
    ("plumb_bob", (-0.030605, 0.035201, -0.000138, -0.000146, -0.01204, 0.0, 0.0, 0.0),
     (-0.030605, 0.035201, -0.000138, -0.000146, -0.01204), False, ""),  # Orbbec
    ("plumb_bob", (*BROWN, *(0,) * 9), BROWN, False, ""),
    ("plumb_bob", RATIONAL, RATIONAL, False, "rational_polynomial"),
    ("plumb_bob", (), ZERO, False, ""),
    ("plumb_bob", (0,) * 14, ZERO, False, ""),
    ("plumb_bob", BROWN[:2], (*BROWN[:2], 0, 0), False, ""),
    ("Plumb Bob", BROWN, BROWN, False, ""),
    ("PLUMB_BOB", BROWN, BROWN, False, ""),
    ("plumb-bob", BROWN, BROWN, False, ""),
    ("radtan", BROWN[:4], BROWN[:4], False, ""),
    ("radial-tangential", BROWN[:4], BROWN[:4], False, ""),
    ("brown_conrady", BROWN, BROWN, False, ""),
    ("Brown Conrady", BROWN, BROWN, False, ""),
    ("rational_polynomial", AZURE_KINECT, AZURE_KINECT, False, ""),
    ("rational_polynomial", RATIONAL, RATIONAL, False, ""),
    ("rational_polynomial", (*RATIONAL, *(0,) * 6), RATIONAL, False, ""),  # OAK-D
    ("rational_polynomial", PRISM, PRISM, False, ""),
    ("rational_polynomial", TILT, TILT, False, ""),
    ("rational_polynomial", BROWN, BROWN, False, ""),
    ("Rational Polynomial", RATIONAL, RATIONAL, False, ""),
    ("thin_prism", PRISM, PRISM, False, ""),
    ("thin_prism", TILT, TILT, False, ""),
    ("rational_polynomial", (*FAINT, *(1e-5,) * 4), (*FAINT, *(1e-5,) * 4), False, ""),
    ("equidistant", FISHEYE, FISHEYE, True, ""),
    ("EQUIDISTANT", FISHEYE, FISHEYE, True, ""),
    ("fisheye", FISHEYE, FISHEYE, True, ""),
    ("fisheye", (0, 0, 0, 0), (0, 0, 0, 0), True, ""),
    ("fisheye", (0.02, 0, 0, 0, 0), (0.02, 0, 0, 0), True, ""),
    ("kannala_brandt4", FISHEYE, FISHEYE, True, ""),
    ("Kannala Brandt4", FISHEYE, FISHEYE, True, ""),  # librealsense
    ("kannala_brandt", FISHEYE[:2], (*FISHEYE[:2], 0, 0), True, ""),
    ("", BROWN, BROWN, False, "empty"),
    ("", RATIONAL, RATIONAL, False, "empty"),
    *((name, d, ZERO, False, "") for name in NAMES_OF_NONE for d in ((), (0,) * 5)),
)  # fmt: skip

#: distortion_model and D without a meaning, and what is said
NO_LENSES: tuple[tuple[str, tuple[float, ...], str], ...] = (
    ("something_else", (0.1, 0.2), "unknown"),
    ("plumb_bobb", BROWN, "did you mean 'plumb_bob'"),
    ("inverse_brown_conrady", BROWN, "distorted points"),
    ("Inverse Brown Conrady", (0.1, 0, 0, 0, 0), "distorted points"),
    ("Modified Brown Conrady", BROWN, "bent already"),
    ("Ftheta", BROWN, "no perspective"),
    ("ds", (-0.2, 0.6), "not computed"),
    ("double_sphere", (-0.2, 0.6), "not computed"),
    ("omni", (0.9, -0.2, 0.1, 0, 0), "not computed"),
    ("mei", (0.9, -0.2, 0.1, 0, 0), "not computed"),
    ("fov", (0.93,), "not computed"),
    ("equirectangular", (), "no perspective"),
    ("none", BROWN, "is no distortion, but D is"),
    ("pinhole", BROWN[:4], "is no distortion, but D is"),
    ("equidistant", (1e-4,) * 5, "need at most 4"),
    ("fisheye", RATIONAL, "need at most 4"),
    ("plumb_bob", (0.1, 0.01, 0.02), "need 4, 5, 8"),
    ("plumb_bob", (0.1,) * 6, "need 4, 5, 8"),
    ("plumb_bob", (0.01,) * 7, "need 4, 5, 8"),
    ("rational_polynomial", (0.01,) * 9, "need 4, 5, 8"),
    ("rational_polynomial", (0.01,) * 13, "need 4, 5, 8"),
    ("rational_polynomial", (0.01,) * 15, "need 4, 5, 8"),
    ("thin_prism", (1e-3,) * 4, "need 12"),
    ("thin_prism", RATIONAL, "need 12"),
    ("plumb_bob", (NAN, 0, 0, 0, 0), "finite"),
    ("rational_polynomial", (*RATIONAL[:7], INF), "finite"),
    ("", (NAN,) * 5, "finite"),
    ("plumb_bob", (-40.0, 0, 0, 0, 0), "folds the image"),
    ("plumb_bob", (1e300,) * 5, ""),
    ("plumb_bob", (NAN,) * 1000, "finite"),
    ("plumb_bob", (0.1,) * 1000, "1000 coefficients"),
    ("rational_polynomial", (*RATIONAL, 0, 0, 0, 0, 2.0, 0), "faces the lens"),
)

# ---------------------------------------------------------------------------------------------------------------------
# Cameras


@dataclass(frozen=True)
class Sensor:
    """A sensor and its lens at full resolution, and the part of it that is read."""

    size: tuple[int, int]
    K: np.ndarray
    binning: tuple[int, int] = (1, 1)
    window: tuple[int, int, int, int] | None = None

    def truth(self, D: tuple[float, ...], fisheye: bool) -> Truth:
        x, y, width, height = self.window or (0, 0, *self.size)
        bx, by = self.binning
        K = self.K.copy()
        # The centre of a binned pixel is the mean of those that it combines.
        K[0] = K[0] / bx
        K[1] = K[1] / by
        K[0, 2] = (self.K[0, 2] - x - (bx - 1) / 2) / bx
        K[1, 2] = (self.K[1, 2] - y - (by - 1) / 2) / by
        return Truth(K, D, fisheye, (width // bx, height // by))

    def fields(self, model: str, d: tuple[float, ...]) -> dict[str, Any]:
        """Return the message as sensor_msgs/CameraInfo wants it."""
        roi = {"x_offset": 0, "y_offset": 0, "width": 0, "height": 0, "do_rectify": False}
        if self.window is not None:
            roi |= dict(zip(("x_offset", "y_offset", "width", "height"), self.window, strict=True))
        return {
            "width": self.size[0],
            "height": self.size[1],
            "distortion_model": model,
            "d": np.array(d, np.float64),
            "k": self.K.ravel().copy(),
            "r": np.eye(3).ravel(),
            "p": np.column_stack((self.K, np.zeros(3))).ravel(),
            "binning_x": self.binning[0] if max(self.binning) > 1 else 0,
            "binning_y": self.binning[1] if max(self.binning) > 1 else 0,
            "roi": roi,
        }


def drawn_sensor(rng: np.random.Generator, plain: bool = False, largest: float = 1.4) -> Sensor:
    """Return a sensor whose images are small; a plain one has neither window nor binning."""
    kind = "plain" if plain else rng.choice(["plain", "plain", "binned", "window", "both"])
    width, height = ((480, 360), (512, 320), (360, 480), (400, 400))[rng.integers(4)]
    binning = (1, 1)
    if kind in ("binned", "both"):
        binning = ((2, 2), (4, 4), (2, 1), (3, 3))[rng.integers(4)]
        width, height = width * binning[0], height * binning[1]
    window = None
    size = (width, height)
    if kind in ("window", "both"):
        size = (int(width * rng.uniform(1.1, 1.8)), int(height * rng.uniform(1.1, 1.8)))
        window = (int(rng.integers(0, size[0] - width)), int(rng.integers(0, size[1] - height)), width, height)
    f = size[0] * rng.uniform(0.7, largest)
    cx = (size[0] - 1) / 2 + size[0] * rng.uniform(-0.05, 0.05)
    cy = (size[1] - 1) / 2 + size[1] * rng.uniform(-0.05, 0.05)
    K = np.array([[f, 0, cx], [0, f * rng.uniform(0.98, 1.02), cy], [0, 0, 1]])
    return Sensor(size, K, binning, window)


def _good(rng: np.random.Generator) -> Iterator[Case]:
    for index, (model, sent, meant, fisheye, remark) in enumerate(LENSES):
        sensor = drawn_sensor(rng)
        fields = sensor.fields(model, sent)
        kind = index % 5
        if kind == 1:  # P not filled, R neither: ZED
            fields |= {"p": np.zeros(12), "r": np.zeros(9)}
        elif kind == 2 and any(meant):  # getOptimalNewCameraMatrix
            fields["p"][[0, 5]] *= 0.85
        elif kind == 3:  # right camera of a stereo pair
            fields["p"][3] = -0.06 * fields["p"][0]
        elif kind == 4 and sensor.window is None:
            fields["roi"] |= {"width": sensor.size[0], "height": sensor.size[1]}
        yield Case(f"lens {index}: {model!r} {len(sent)}", sensor.truth(meant, fisheye), fields, remark=remark)


def _drawn(rng: np.random.Generator) -> Iterator[Case]:
    """Lenses of every strength, padded as it comes."""
    lenses = [lens for lens in LENSES if any(lens[2]) and lens[0] and not lens[4]]
    for index in range(40):
        model, sent, meant, fisheye, _ = lenses[rng.integers(len(lenses))]
        strength = rng.uniform(-0.4, 1.1)
        padded = (*sent, *(0.0,) * int(rng.integers(0, 3))) if not fisheye and len(sent) >= 4 else sent
        name = "".join(letter.upper() if rng.random() < 0.3 else letter for letter in model)
        sensor = drawn_sensor(rng)
        fields = sensor.fields(f" {name}" if rng.random() < 0.2 else name, tuple(strength * k for k in padded))
        if "thin" in model.lower():
            fields["d"] = np.array([strength * k for k in sent])
        yield Case(f"drawn {index}: {name}", sensor.truth(tuple(strength * k for k in meant), fisheye), fields)


def _unusual(rng: np.random.Generator) -> Iterator[Case]:
    """Right messages of cameras that are not the usual ones."""

    def case(name: str, size: tuple[int, int], K: list[float], D: tuple[float, ...] = ZERO, model: str = "plumb_bob",
             fisheye: bool = False, **more: Any) -> Case:  # fmt: skip
        fx, fy, cx, cy = K
        sensor = Sensor(size, np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), **more)
        return Case(name, sensor.truth(D, fisheye), sensor.fields(model, D))

    yield case("binned by 4: prosilica", (2448, 2050), [2348.02633, 2346.76611, 1173.59324, 994.74302],
               (-0.12297, 0.13763, -0.00083, -0.00303, -0.08479), binning=(4, 4))  # fmt: skip
    yield case("depth camera of which a part is read", (640, 576), [504.1, 504.3, 326.4, 341.2], AZURE_KINECT,
               "rational_polynomial")  # fmt: skip
    yield case("side camera of a car: the upper third is cut", (480, 222), [516, 516, 237, 62])
    yield case("telephoto of 600 mm on 1 inch", (480, 320), [21800, 21800, 240, 160])
    yield case("wide pinhole of a simulator", (480, 360), [100, 100, 239.5, 179.5])
    yield case("fields of interlaced video", (480, 180), [430, 215, 240, 88])
    yield case("window in the corner", (1600, 1200), [1500, 1500, 803, 590], window=(40, 30, 480, 360))
    yield case("circular fisheye", (480, 360), [110, 110, 240, 180], (0.01, 0, 0, 0), "equidistant", True)
    window = case("window at the origin, K of the window", (1280, 960), [450, 450, 238, 181],
                  window=(0, 0, 480, 360))  # fmt: skip
    yield window
    plain = drawn_sensor(rng, plain=True)
    fields = plain.fields("plumb_bob", BROWN)
    yield Case("ints for floats", plain.truth(BROWN, False), fields | {"binning_x": 1, "binning_y": 1})
    # Rectified images: P without distortion, whatever K and D say.
    for model, d in (("plumb_bob", BROWN), ("something_else", (0.3, 0.4)), ("equidistant", (0.1,) * 7)):
        sensor = drawn_sensor(rng)
        bent = sensor.fields(model, d)
        bent["k"] = bent["k"] * np.array([1.1, 1, 1.01, 1, 1.1, 0.99, 1, 1, 1])
        yield Case(f"rectified, {model}", sensor.truth(ZERO, False), bent, rectified=True)
    bent = drawn_sensor(rng, plain=True)
    yield Case("rectified, K is the identity", bent.truth(ZERO, False),
               bent.fields("", ()) | {"k": np.eye(3).ravel()}, rectified=True, remark="K and P disagree")  # fmt: skip
    for scale in (2.0, 1000.0, 0.5):
        other = bent.fields("plumb_bob", ())
        other["p"][[0, 2, 5, 6]] *= scale
        yield Case(f"P of another resolution: {scale}", bent.truth(ZERO, False), other, remark="K and P disagree")
    anamorphic = bent.fields("plumb_bob", ())
    anamorphic["k"][4] /= 2.2
    K = anamorphic["k"].reshape(3, 3)
    yield Case("fx twice fy", replace(bent.truth(ZERO, False), K=K), anamorphic | {"p": np.zeros(12)}, remark="square")
    # What is not used may be anything, and what float32 and products of matrices leave of zeros and ones is rounding.
    for letter in ("p", "r"):
        broken = plain.fields("plumb_bob", BROWN)
        broken[letter] = np.full(len(broken[letter]), NAN)
        yield Case(f"{letter.upper()} of NaN, not used", plain.truth(BROWN, False), broken,
                   remark="not finite; it is not used")  # fmt: skip
    unused = bent.fields("plumb_bob", (NAN,) * 5) | {"k": np.full(9, NAN)}
    yield Case("rectified, K and D of NaN", bent.truth(ZERO, False), unused, rectified=True, remark="not used")
    noise = np.array([0, 0, 0, 1e-5, 0, 0, 1e-9, -1e-12, -6e-8])
    rounded = plain.fields("plumb_bob", BROWN)
    yield Case("K with rounding", plain.truth(BROWN, False), rounded | {"k": rounded["k"] + noise})


#: Name, what it does to good fields, what is said; `s` is the sensor.
Fault = tuple[str, Callable[[dict[str, Any], Sensor], None], str]


def _scaled(*factors: float) -> Callable[[dict[str, Any], Sensor], None]:
    def change(f: dict[str, Any], _: Sensor) -> None:
        f["k"][[0, 4]] *= factors[0]
        f["k"][[2, 5]] *= factors[-1]

    return change


def _set(**values: Any) -> Callable[[dict[str, Any], Sensor], None]:
    def change(f: dict[str, Any], _: Sensor) -> None:
        f |= {name: np.array(value, np.float64) if name in "kdrp" else value for name, value in values.items()}

    return change


def _at(name: str, places: list[int], value: float) -> Callable[[dict[str, Any], Sensor], None]:
    def change(f: dict[str, Any], _: Sensor) -> None:
        f[name] = np.array(f[name])
        f[name][places] = value

    return change


def _sized(width: float, height: float) -> Callable[[dict[str, Any], Sensor], None]:
    return lambda f, s: f.update(width=int(s.size[0] * width), height=int(s.size[1] * height))


def _roi(x: int, y: int, width: float, height: float, less: int = 0) -> Callable[[dict[str, Any], Sensor], None]:
    def change(f: dict[str, Any], s: Sensor) -> None:
        f["roi"] = f["roi"] | {
            "x_offset": x, "y_offset": y, "width": int(s.size[0] * width) - less, "height": int(s.size[1] * height),
        }  # fmt: skip

    return change


PLAIN_FAULTS: tuple[Fault, ...] = (
    ("no size", _set(width=0, height=0), "width and height are 0 x 0"),
    ("no width", _set(width=0), "width and height are 0 x"),
    ("no height", _set(height=0), "x 0"),
    ("another resolution", _sized(2, 2), "need the same size"),
    ("half the resolution", _sized(0.5, 0.5), "need the same size"),
    ("another shape", _sized(1, 0.75), "need the same size"),
    ("one pixel too wide", lambda f, s: f.update(width=s.size[0] + 1), "need the same size"),
    ("turned", lambda f, s: f.update(width=s.size[1] + 8, height=s.size[0] + 8), "need the same size"),
    ("roi one pixel too small", _roi(0, 0, 1, 1, 1), "need the same size"),
    ("roi beside the sensor", _roi(200, 0, 1, 1), "need a window inside"),
    ("roi of 4e9", _roi(4_000_000_000, 0, 0.5, 0.5), "need a window inside"),
    ("roi of another image", _roi(10, 10, 0.5, 0.5), "need the same size"),
    ("binning of an image that is not binned", _set(binning_x=2, binning_y=2), "need the same size"),
    ("K all zero", _set(k=[0.0] * 9), "all zero"),
    ("K zero but for its 1", _set(k=[0.0] * 8 + [1.0]), "all zero"),
    ("K of NaN", _set(k=[NAN] * 9), "finite"),
    ("one NaN in K", _at("k", [5], NAN), "finite"),
    ("infinite K", _at("k", [0], INF), "finite"),
    ("K is the identity", _set(k=np.eye(3).ravel()), "K is the identity"),
    ("K is the identity, P too", _set(k=np.eye(3).ravel(), p=np.eye(3, 4).ravel()), "K is the identity"),
    ("no centre", _at("k", [2, 5], 0.0), "principal point at (0, 0)"),
    ("no centre along x", _at("k", [2], 0.0), "principal point"),
    ("centre far outside", _at("k", [2], 5000.0), "principal point"),
    ("negative centre", _at("k", [5], -200.0), "principal point"),
    ("centre of 1e300", _at("k", [2], 1e300), "principal point"),
    ("K of twice the resolution", _scaled(2, 2), "principal point"),
    ("K of half the resolution", _scaled(0.5, 0.5), "principal point"),
    ("K of 3/2 the resolution", _scaled(1.5, 1.5), "principal point"),
    ("K of 2/3 the resolution", _scaled(2 / 3, 2 / 3), "principal point"),
    ("focal length in metres", _at("k", [0, 4], 0.004), "in metres?"),
    ("focal length in millimetres", _at("k", [0, 4], 8.0), "in millimetres?"),
    ("K in metres", _scaled(1e-5, 1e-5), "fx"),
    ("focal length of 35 mm", _at("k", [0, 4], 35.0), "in millimetres?"),
    ("focal length of 1e6", _at("k", [0, 4], 1e6), "angle of view"),
    ("focal length of 1e-310", _at("k", [0, 4], 1e-310), ""),
    ("fy not filled", _at("k", [4], 0.0), "fy > 0"),
    ("fy of another unit", _at("k", [4], 0.5), "fy"),
    ("negative focal length", _at("k", [0], -500.0), "fx > 0"),
    ("K by columns", lambda f, s: f.update(k=f["k"].reshape(3, 3).T.ravel()), "fx > 0"),
    ("K without its 1", _at("k", [8], 0.0), "fx > 0"),
    ("K with values elsewhere", _at("k", [3], 3.0), "fx > 0"),
    ("K with more than rounding in its last row", _at("k", [6], 1e-4), "fx > 0"),
    ("K with more than rounding in its 1", _at("k", [8], 1.001), "fx > 0"),
)
RECTIFIED_FAULTS: tuple[Fault, ...] = (
    ("P all zero", _set(p=[0.0] * 12), "P is all zero"),
    ("P is the identity", _set(p=np.eye(3, 4).ravel()), "P[:3, :3] is the identity"),
    ("P of NaN", _set(p=[NAN] * 12), "finite"),
    ("one NaN in P", _at("p", [5], NAN), "finite"),
    (
        "P of half the resolution",
        lambda f, s: f.update(p=f["p"] * np.r_[np.full(8, 0.5), np.ones(4)]),
        "principal point",
    ),
    ("P without centre", _at("p", [2, 6], 0.0), "principal point"),
    ("rectified and no size", _set(width=0, height=0), "width and height"),
)


def _faulty(rng: np.random.Generator) -> Iterator[Case]:
    for faults, rectified in ((PLAIN_FAULTS, False), (RECTIFIED_FAULTS, True)):
        for name, change, says in faults:
            sensor = drawn_sensor(rng, plain=True)
            fields = sensor.fields("plumb_bob", ZERO)
            change(fields, sensor)
            yield Case(name, sensor.truth(ZERO, False), fields, "homography", says, rectified=rectified)
    for index, (model, d, says) in enumerate(NO_LENSES):
        sensor = drawn_sensor(rng)
        name = f"no lens {index}: {model!r} {len(d)}"
        yield Case(name, sensor.truth(ZERO, False), sensor.fields(model, d), "homography", says)
    for binning in ((2, 2), (4, 4), (2, 1)):
        K = np.array([[450.0, 0, 243], [0, 452, 177], [0, 0, 1]])
        full = Sensor((480 * binning[0], 360 * binning[1]), np.diag([*binning, 1.0]) @ K, binning)
        truth = full.truth(ZERO, False)
        fields = full.fields("plumb_bob", ())
        # A driver that loads the calibration of binned images: avt_vimba_camera, pylon, spinnaker.
        yield Case(f"K of the binned image, {binning}", truth, fields | {"k": K.ravel()}, "homography", "binned image")
        yield Case(f"K and size of the binned image, {binning}", truth,
                   fields | {"k": K.ravel(), "width": 480, "height": 360}, "homography", "binned image's")  # fmt: skip
    for x, y in ((320, 240), (700, 500), (0, 300)):
        K = np.array([[450.0, 0, 243], [0, 452, 177], [0, 0, 1]])
        # camera1394, spinnaker: the window's size for the sensor's.
        sensor = Sensor((1280, 960), K + np.array([[0, 0, x], [0, 0, y], [0, 0, 0]]), window=(x, y, 480, 360))
        truth, fields = sensor.truth(ZERO, False), sensor.fields("plumb_bob", ())
        yield Case(f"size of the window, at {x}, {y}", truth, fields | {"width": 480, "height": 360}, "homography",
                   "or the window's")  # fmt: skip
        yield Case(f"size and K of the window, at {x}, {y}", truth,
                   fields | {"width": 480, "height": 360, "k": K.ravel()}, "homography", "or the window's")  # fmt: skip
        yield Case(f"K of the window, at {x}, {y}", truth, fields | {"k": K.ravel()}, "homography", "window")
    avt = Sensor((2064, 1544), np.array([[1198.2, 0, 1016.6], [0, 1200.6, 735.8], [0, 0, 1]]), (4, 4))
    yield Case(
        "avt_vimba_camera, binned by 4",
        avt.truth((-0.097715, 0.08086, -0.003701, 0.001999, 0.0), False),
        avt.fields("plumb_bob", (-0.097715, 0.08086, -0.003701, 0.001999, 0.0))
        | {"k": np.array([299.54396, 0.0, 254.14465, 0.0, 300.14093, 183.94307, 0.0, 0.0, 1.0])},
        "homography",
        "binned image",
    )


def _rejected(rng: np.random.Generator) -> Iterator[Case]:
    for name, image in (
        ("encoding", {"encoding": "no_such_encoding"}),
        ("cut", {"data": np.zeros(100, np.uint8)}),
        ("empty", {"width": 0, "height": 0}),
    ):
        for change in ({}, {"k": np.full(9, NAN)}):
            sensor = drawn_sensor(rng, plain=True)
            fields = sensor.fields("plumb_bob", ZERO) | change
            yield Case(f"image: {name}", sensor.truth(ZERO, False), fields, "rejected", image=image)


@cache
def cases(seed: int = 20) -> tuple[Case, ...]:
    """Return all cases, the same for the same seed."""
    rng = np.random.default_rng(seed)
    return tuple(case for source in (_good, _drawn, _unusual, _faulty, _rejected) for case in source(rng))
