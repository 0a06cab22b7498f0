# SPDX-License-Identifier: Apache-2.0
"""Cameras, shapes, paths, sensor and exact projection of benchmarks/foreign_frames.py.

Everything is written out here and takes nothing from the package: what judges is not made of what is judged. The world
is the target's picture: x right, y down, z into the print, metres, origin at the middle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from imgu_ros.types import Floats, Image

RATE_HZ = 30.0
WIDTH, HEIGHT = 640, 480
TARGET_WIDTH_M = 0.3
#: camera_from_world, R (3, 3) and t (3,), at a time in seconds.
CameraPath = Callable[[float], tuple[Floats, Floats]]


@dataclass(frozen=True)
class RayOptics:
    """A camera.

    Attributes
    ----------
    distortion : plumb_bob: k1 k2 p1 p2 k3
    row_time_s : from one row's exposure to the next row's; 0: global shutter
    lens_radius_m, focus_m : of a thin lens; 0: a pinhole
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int = WIDTH
    height: int = HEIGHT
    distortion: tuple[float, ...] = (0.0,) * 5
    exposure_s: float = 0.0
    row_time_s: float = 0.0
    lens_radius_m: float = 0.0
    focus_m: float = 1.0

    @property
    def K(self) -> Floats:
        """Camera matrix."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])


@dataclass(frozen=True)
class RoomLamp:
    """A sphere that shines."""

    centre: tuple[float, ...]
    radius: float
    radiance: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class RoomShape:
    """A matt thing: of Mitsuba's kinds rectangle, cube, sphere, cylinder; `picture` is linear reflectance."""

    kind: str
    to_world: Floats
    colour: tuple[float, ...] = (0.5, 0.5, 0.5)
    picture: Floats | None = None


@dataclass(frozen=True, eq=False)
class RoomScene:
    """Shapes in the light of a lamp and of a sky, whose radiance is the same in all directions."""

    shapes: list[RoomShape]
    lamp: RoomLamp
    sky: tuple[float, ...]


@dataclass(frozen=True)
class BayerSensor:
    """Bayer sensor without white balance.

    Attributes
    ----------
    pattern : rggb, grbg, gbrg or bggr
    gains : of red, green and blue, on linear light
    """

    pattern: str = "rggb"
    bits: int = 10
    black: int = 64
    gains: tuple[float, float, float] = (0.5, 1.0, 0.65)
    full_well_e: float = 9000.0
    read_noise_e: float = 3.0

    @property
    def white(self) -> int:
        """Largest digital number."""
        return (1 << self.bits) - 1


def linear(picture: Image) -> Floats:
    """Return linear reflectance of sRGB."""
    v = picture.astype(np.float64) / 255
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def mosaic(light: Floats, sensor: BayerSensor) -> Floats:
    """Return the light of each pixel's own channel, after the channel's gain."""
    out = np.empty(light.shape[:2])
    for site, name in enumerate(sensor.pattern):
        channel = "rgb".index(name)
        out[site // 2 :: 2, site % 2 :: 2] = light[site // 2 :: 2, site % 2 :: 2, channel] * sensor.gains[channel]
    return out


def exposed(signal: Floats, sensor: BayerSensor, rng: np.random.Generator) -> Image:
    """Return digital numbers of a mosaic; 1 fills the well."""
    electrons = rng.poisson(np.maximum(signal, 0) * sensor.full_well_e)
    electrons = electrons + rng.normal(0, sensor.read_noise_e, signal.shape)
    dn = sensor.black + electrons * (sensor.white - sensor.black) / sensor.full_well_e
    return np.clip(np.rint(dn), 0, sensor.white).astype(np.uint16)


def film(raw: Image, sensor: BayerSensor) -> Image:
    """Return 8 bits through a film's curve: S-shaped over a gamma, monotone."""
    x = np.clip((raw.astype(np.float64) - sensor.black) / (sensor.white - sensor.black), 0, 1)
    g = x ** (1 / 2.2)
    y = 0.04 + 0.94 * (0.35 * g + 0.65 * g * g * (3 - 2 * g))
    return np.asarray(np.rint(255 * y), np.uint8)


def projected(optics: RayOptics, path: CameraPath, time_s: float, points: Floats) -> Floats:
    """Return the (N, 2) raw pixels at which the camera shows points of the world, (N, 3), while they are exposed.

    A rolling shutter shows a point where it is at the time of its own row; of a long exposure this is the mean place.
    """
    exposures = np.linspace(-0.5, 0.5, 17)[1::2] * optics.exposure_s if optics.exposure_s else np.zeros(1)
    return np.mean([_at_row_times(optics, path, time_s + dt, points) for dt in exposures], axis=0)


def _at_row_times(optics: RayOptics, path: CameraPath, time_s: float, points: Floats) -> Floats:
    middle = (optics.height - 1) / 2
    if not optics.row_time_s:
        return pinhole(optics, *path(time_s), points)
    times = time_s + np.linspace(-middle, middle, 129) * optics.row_time_s
    poses = [path(t) for t in times]
    paths = np.array([pinhole(optics, R, t, points) for R, t in poses])
    xy = paths[64]
    for _ in range(8):
        row = np.clip(xy[:, 1], 0, optics.height - 1)
        place = row / (2 * middle) * 128
        lower = np.minimum(place.astype(int), 127)
        share = (place - lower)[:, None]
        each = np.arange(len(points))
        xy = (1 - share) * paths[lower, each] + share * paths[lower + 1, each]
    return xy


def pinhole(optics: RayOptics, R: Floats, t: Floats, points: Floats) -> Floats:
    """Return the (N, 2) raw pixels of points of the world, with plumb_bob (Brown 1966)."""
    xyz = points @ R.T + t
    x, y = xyz[:, 0] / xyz[:, 2], xyz[:, 1] / xyz[:, 2]
    k1, k2, p1, p2, k3 = optics.distortion
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.column_stack((optics.fx * u + optics.cx, optics.fy * v + optics.cy))


def on_print(xy: Floats, size: tuple[int, int]) -> Floats:
    """Return (N, 3) points of the world of (N, 2) template px of a picture of that width and height."""
    metres = (xy - (np.array(size) - 1) / 2) * (TARGET_WIDTH_M / size[0])
    return np.column_stack((metres, np.zeros(len(xy))))


def homography(K: Floats, R: Floats, t: Floats, size: tuple[int, int]) -> Floats:
    """Return H_image_template of unit norm, in ideal pixels; `R`, `t` are camera_from_world."""
    s = TARGET_WIDTH_M / size[0]
    world = np.array([[s, 0, -s * (size[0] - 1) / 2], [0, s, -s * (size[1] - 1) / 2], [0, 0, 1]])
    H = K @ np.column_stack((R[:, 0], R[:, 1], t)) @ world
    return H / np.linalg.norm(H)


def placed(centre: Sequence[float], size: Sequence[float], R: Floats | None = None) -> Floats:
    """Return (4, 4): scaled by half of `size`, turned, moved."""
    M = np.eye(4)
    M[:3, :3] = (np.eye(3) if R is None else R) @ np.diag(np.asarray(size, float) / 2)
    M[:3, 3] = centre
    return M


def rotation(x: float, y: float, z: float) -> Floats:
    """Return Rz Ry Rx of angles in radians."""
    cx, sx, cy, sy, cz, sz = math.cos(x), math.sin(x), math.cos(y), math.sin(y), math.cos(z), math.sin(z)
    Rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    Ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    Rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(Rz @ Ry @ Rx)


def orbit(
    rng: np.random.Generator, optics: RayOptics, width_px: float, speed_px: float, axes: tuple[float, float]
) -> CameraPath:
    """Return a smooth path: the target's middle goes round an ellipse of semi-axes `axes` px, `speed_px` a frame."""
    a, b = axes
    # Arc length of the ellipse, so that the speed is even.
    phi = np.linspace(0, 2 * math.pi, 4097)
    steps = np.hypot(a * np.sin(phi), b * np.cos(phi))
    arc = np.concatenate(([0], np.cumsum((steps[1:] + steps[:-1]) / 2 * np.diff(phi))))
    start, way = rng.uniform(0, arc[-1]), rng.choice((-1, 1))
    tilt, phase = rng.uniform(math.radians(10), math.radians(25), 2), rng.uniform(0, 2 * math.pi, 4)
    frames_a_wave, roll = rng.uniform(50, 100, 4), rng.uniform(-0.5, 0.5)
    depth = optics.fx * TARGET_WIDTH_M / width_px
    middle = np.array([(optics.width - 1) / 2, (optics.height - 1) / 2])

    def at(time_s: float) -> tuple[Floats, Floats]:
        frame = time_s * RATE_HZ
        angle = np.interp((start + way * speed_px * frame) % arc[-1], arc, phi)
        waves = np.sin(phase + frame * 2 * math.pi / frames_a_wave)
        R = rotation(tilt[0] * waves[0], tilt[1] * waves[1], roll + 0.12 * waves[2])
        centre = middle + (a * math.cos(angle), b * math.sin(angle))
        ray = np.array([(centre[0] - optics.cx) / optics.fx, (centre[1] - optics.cy) / optics.fy, 1.0])
        return R, depth * (1 + 0.08 * waves[3]) * ray

    return at
