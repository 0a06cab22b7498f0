# SPDX-License-Identifier: Apache-2.0
"""Frames of a path tracer that is not this project's: Mitsuba 3, every ray made here (benchmarks/foreign_frames.py).

Every sample of a pixel has a place on the sensor, an instant and a point on the lens of its own; its ray follows from
the pose of that instant, the inverse of the distortion at that place and the plane in focus. So lens, rolling shutter,
motion blur and depth of field are exact, and a pixel is the mean of the light over its area.

Needs the optional dependency `foreign` and the shared library of LLVM, 19 or newer (`apt install libllvm19`);
`DRJIT_LIBLLVM_PATH` names it where it is not found, or where an older one is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from foreign_scenes import CameraPath, RayOptics, RoomScene, RoomShape

from imgu_ros.types import Floats

#: With older versions Dr.Jit compiles nothing, and ends the process.
_OLDEST_LLVM = 19

mi.set_variant("llvm_ad_rgb")
if dr.detail.llvm_version()[0] < _OLDEST_LLVM:
    raise ImportError(
        f"LLVM {dr.detail.llvm_version()[0]}: too old; let DRJIT_LIBLLVM_PATH name libLLVM {_OLDEST_LLVM} or newer"
    )

#: Poses between which those of a frame's samples are interpolated linearly.
_POSES = 257
_UNDISTORT_STEPS = 30
#: Samples of one wavefront: bounds the memory.
_WAVEFRONT = 5_000_000
#: Light from the lamp, and by way of one other surface.
_DEPTH = 3


class ForeignRenderer:
    """A scene that is loaded once and seen many times.

    Parameters
    ----------
    scene : what stands where
    """

    def __init__(self, scene: RoomScene) -> None:
        shapes = {f"shape{index}": _shape(shape) for index, shape in enumerate(scene.shapes)}
        lamp = {
            "type": "sphere",
            "center": list(scene.lamp.centre),
            "radius": scene.lamp.radius,
            "emitter": {"type": "area", "radiance": _rgb(scene.lamp.radiance)},
        }
        sky = {"type": "constant", "radiance": _rgb(scene.sky)}
        # Light adds up. Apart, each is sampled in the way that leaves it the less noise.
        by_lamp = {"type": "path", "max_depth": _DEPTH}
        by_sky = {"type": "direct", "bsdf_samples": 1, "emitter_samples": 0}
        self._scenes = [
            mi.load_dict({"type": "scene", "integrator": integrator, "light": light, **shapes})
            for integrator, light in ((by_lamp, lamp), (by_sky, sky))
        ]

    def light(self, optics: RayOptics, path: CameraPath, time_s: float, side: int, seed: int) -> Floats:
        """Return (height, width, 3) linear light of a frame whose middle row's exposure has its middle at `time_s`.

        Parameters
        ----------
        side : samples of a pixel are side x side
        """
        total = side * side
        count = min(total, max(1, _WAVEFRONT // (optics.width * optics.height)))
        while total % count:
            count -= 1
        light = np.zeros((optics.height * optics.width, 3))
        for first in range(0, total, count):
            light += self._part(optics, path, time_s, side, first, count, seed * 1009 + first)
        return (light / total).reshape(optics.height, optics.width, 3)

    def _part(
        self, optics: RayOptics, path: CameraPath, time_s: float, side: int, first: int, count: int, seed: int
    ) -> Floats:
        pixels = optics.width * optics.height
        index = dr.arange(mi.UInt32, pixels * count)
        pixel, stratum = index // count, index % count + dr.opaque(mi.UInt32, first)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, pixels * count)
        jitter = sampler.next_2d()
        column, row = pixel % optics.width, pixel // optics.width
        x = mi.Float64(column) - 0.5 + (mi.Float64(stratum % side) + mi.Float64(jitter.x)) / side
        y = mi.Float64(row) - 0.5 + (mi.Float64(stratum // side) + mi.Float64(jitter.y)) / side
        x, y = _undistorted((x - optics.cx) / optics.fx, (y - optics.cy) / optics.fy, optics.distortion)

        matrix = self._poses(optics, path, time_s, side, row, stratum, sampler)
        # The point in focus and the point of the lens it is seen through, in the camera's frame.
        far, ox, oy = optics.focus_m, mi.Float64(0), mi.Float64(0)
        if optics.lens_radius_m:
            disk = mi.warp.square_to_uniform_disk_concentric(sampler.next_2d())
            ox, oy = mi.Float64(disk.x) * optics.lens_radius_m, mi.Float64(disk.y) * optics.lens_radius_m
        ray = mi.RayDifferential3f(
            o=mi.Point3f(*[mi.Float(v) for v in _world(matrix, (ox, oy, mi.Float64(0)), True)]),
            d=dr.normalize(
                mi.Vector3f(*[mi.Float(v) for v in _world(matrix, (x * far - ox, y * far - oy, far), False)])
            ),
        )
        colour = mi.Color3f(0)
        for scene in self._scenes:
            colour += scene.integrator().sample(scene, sampler, ray, None, True)[0]
        # In one kernel: evaluated one by one, each channel would trace all rays again.
        dr.eval(colour)
        return np.stack([np.array(dr.block_sum(channel, count), np.float64) for channel in colour], axis=-1)

    @staticmethod
    def _poses(
        optics: RayOptics, path: CameraPath, time_s: float, side: int, row: Any, stratum: Any, sampler: Any
    ) -> list[Any]:
        """Return the 12 numbers of camera_from_world of every sample: R row by row, t."""
        skew = abs(optics.row_time_s) * (optics.height - 1)
        span = skew + optics.exposure_s
        if not span:
            R, t = path(time_s)
            # Opaque: as literals they would be compiled into a kernel of every pose's own.
            return [dr.opaque(mi.Float64, float(v)) for v in (*R.ravel(), *t)]
        times = np.linspace(-span / 2, span / 2, _POSES)
        table = np.array([np.concatenate((R.ravel(), t)) for R, t in (path(time_s + dt) for dt in times)])
        total = side * side
        # A shuffled stratum: an instant tells nothing of the place within the pixel.
        order = dr.gather(
            mi.UInt32, mi.UInt32(np.random.default_rng(total).permutation(total).astype(np.uint32)), stratum
        )
        instant = (mi.Float64(order) + mi.Float64(sampler.next_1d())) / total - 0.5
        at = (mi.Float64(row) - (optics.height - 1) / 2) * optics.row_time_s + instant * optics.exposure_s
        place = (at / span + 0.5) * (_POSES - 1)
        lower = dr.clip(mi.UInt32(place), 0, _POSES - 2)
        share = place - mi.Float64(lower)
        return [
            dr.lerp(dr.gather(mi.Float64, values, lower), dr.gather(mi.Float64, values, lower + 1), share)
            for values in (mi.Float64(np.ascontiguousarray(column)) for column in table.T)
        ]


def _world(m: Sequence[Any], v: tuple[Any, Any, Any], is_point: bool) -> list[Any]:
    """Return R^T v, or R^T (v - t) of a point."""
    if is_point:
        v = (v[0] - m[9], v[1] - m[10], v[2] - m[11])
    return [m[k] * v[0] + m[3 + k] * v[1] + m[6 + k] * v[2] for k in range(3)]


def _undistorted(x: Any, y: Any, d: Sequence[float]) -> tuple[Any, Any]:
    """Invert plumb_bob (k1 k2 p1 p2 k3) by fixed-point iteration."""
    if not any(d):
        return x, y
    k1, k2, p1, p2, k3 = d
    u, v = x, y
    for _ in range(_UNDISTORT_STEPS):
        r2 = u * u + v * v
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        dx, dy = 2 * p1 * u * v + p2 * (r2 + 2 * u * u), p1 * (r2 + 2 * v * v) + 2 * p2 * u * v
        u, v = (x - dx) / radial, (y - dy) / radial
    return u, v


def _rgb(value: Sequence[float]) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(v) for v in value]}


def _shape(shape: RoomShape) -> dict[str, Any]:
    T = mi.ScalarTransform4f
    described: dict[str, Any] = {"type": shape.kind, "to_world": T(mi.ScalarMatrix4f(shape.to_world))}
    reflectance: dict[str, Any] = _rgb(shape.colour)
    if shape.picture is not None:
        reflectance = {
            "type": "bitmap",
            "bitmap": mi.Bitmap(np.ascontiguousarray(shape.picture, np.float32)),
            "raw": True,
            "filter_type": "bilinear",
            "wrap_mode": "clamp",
        }
    diffuse = {"type": "diffuse", "reflectance": reflectance}
    described["bsdf"] = {"type": "twosided", "inner": diffuse}
    return described
