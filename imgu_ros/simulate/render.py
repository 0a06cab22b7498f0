# SPDX-License-Identifier: Apache-2.0
"""The light that reaches each pixel of a camera before a scene."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from imgu_ros.errors import ShapeError
from imgu_ros.reference.templates import TargetImage
from imgu_ros.simulate.boxes import boxes, strips
from imgu_ros.simulate.capture import View
from imgu_ros.simulate.geometry import image_from_template
from imgu_ros.simulate.levels import Levels
from imgu_ros.simulate.optics import PixelGrid, PlaneMap
from imgu_ros.simulate.scene import Scene, size_of, template_matrix
from imgu_ros.simulate.texture import wall_texture
from imgu_ros.types import Image, Matrix3
from imgu_ros.vision.camera.intrinsics import Camera
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.formation.layout import ColorModel, PixelLayout
from imgu_ros.vision.scale_space.pyramid import PixelScaling

#: Samples along each side of a pixel.
SAMPLES = 3


@dataclass(frozen=True, slots=True)
class _PixelSites:
    """Pixels of one colour phase: every `step`-th row and column, and (plane, channel of the output) measured there."""

    row: int
    column: int
    step: int
    planes: tuple[tuple[str, int], ...]


class Renderer:
    """Renders a scene as a noise-free sensor would see it."""

    def __init__(self, scene: Scene, camera: Camera, layout: PixelLayout, behind: Image | None = None) -> None:
        """Prepare textures and lens.

        Parameters
        ----------
        scene, camera : what is seen, and by what
        layout : Bayer, mono, RGB or BGR: only the colours that a pixel measures are computed
        behind : what is seen where no target is, as `radiance` returns it; None: the scene's wall

        Raises
        ------
        ShapeError
            If the layout is another, or the lens model has no inverse inside the image.
        """
        self.scene, self.camera = scene, camera
        self._sites = _sites(layout)
        self._channels = 1 + max(channel for sites in self._sites for _, channel in sites.planes)
        self._grid = PixelGrid(camera)
        self._levels = [Levels(target.pixels) for target in scene.targets]
        self._wall = Wall(scene.radius_m)
        self._behind = behind

    def radiance(self, view: RigidTransform | View) -> Image:
        """Render one view: of the camera at a pose, `camera_from_scene`, or as a `View` says.

        Each pixel is the mean over its area: SAMPLES x SAMPLES samples of a texture level whose pixels are about as
        large as the samples are apart; a target's edge covers it exactly.

        Returns
        -------
        (H, W) or (H, W, 3) float32, linear reflectance in [0, 1]

        Raises
        ------
        ShapeError
            If a target's centre is behind the camera.
        """
        if isinstance(view, RigidTransform):
            view = View(self.camera.K, view)
        shape = (self.camera.height, self.camera.width)
        out = np.empty(shape if self._channels == 1 else (*shape, self._channels), np.float32)
        if self._behind is None:
            self._draw_wall(out, view)
        else:
            out[:] = self._behind
        poses = [view.camera_from_scene.after(pose) for pose in self.scene.poses]
        # The far ones first: a nearer one hides them.
        for index in sorted(range(len(poses)), key=lambda i: -float(np.mean(poses[i].t[..., 2]))):
            self._draw_target(out, self.scene.targets[index], self._levels[index], view.K, poses[index])
        return out

    def mean_radiance(self, views: Sequence[View]) -> Image:
        """Render the mean of at least one view: what a pixel sees over time and aperture."""
        out = self.radiance(views[0])
        for view in views[1:]:
            out += self.radiance(view)
        out *= np.float32(1 / len(views))
        return out

    def _draw_wall(self, out: Image, view: View) -> None:
        """Fill the picture with the wall, whose texture is coarse: one sample for each 2x2 quad is enough."""
        height, width = out.shape[:2]
        H_image_wall = self._wall.image_from_wall(view.K, view.camera_from_scene, self.scene.wall_m)
        H_wall_image = np.asarray(np.linalg.inv(H_image_wall), np.float64)
        half = np.empty(((height + 1) // 2, (width + 1) // 2), np.float32)
        for rows in strips(0, height):
            level = self._wall.level_for(2 * self._largest_step(H_wall_image, rows, slice(0, width)))
            H = self._wall.level_from_wall(level) @ H_wall_image
            on_wall = self._grid.plane_map(H, slice(rows.start, rows.stop, 2), slice(0, width, 2))
            half[rows.start // 2 : (rows.stop + 1) // 2] = self._wall.roughness(level, on_wall)
        rough = cv2.resize(half, (2 * half.shape[1], 2 * half.shape[0]), interpolation=cv2.INTER_LINEAR)
        for sites in self._sites:
            where = _site_slices(sites, slice(0, height), slice(0, width))
            for name, channel in sites.planes:
                block = _channel(out, where, channel)
                np.multiply(rough[where], np.float32(WALL_REFLECTANCE[name]), out=block)

    def _draw_target(self, out: Image, target: TargetImage, levels: Levels, K: Matrix3, pose: RigidTransform) -> None:
        H_image_template = image_from_template(K, pose, template_matrix(target))
        H_template_image = np.asarray(np.linalg.inv(H_image_template), np.float64)
        for rows, columns in boxes(H_image_template, size_of(target), self.camera):
            level = levels.level_for(self._largest_step(H_template_image, rows, columns) / SAMPLES)
            A = levels.level_from_template(level)
            width, height = A[0, 0] * levels.size[0], A[1, 1] * levels.size[1]
            for sites in self._sites:
                where = _site_slices(sites, rows, columns)
                on_level = self._grid.plane_map(A @ H_template_image, *where)
                share = rectangle_coverage(on_level, width, height)
                colors = _area_means([levels.plane(level, name) for name, _ in sites.planes], on_level)
                for color, (_, channel) in zip(colors, sites.planes, strict=True):
                    block = _channel(out, where, channel)
                    color -= block
                    color *= share
                    block += color

    def _largest_step(self, H_plane_image: Matrix3, rows: slice, columns: slice) -> float:
        """Return how far apart on the plane neighbouring pixels look, at most, over a block's border."""
        row_step, column_step = max(1, (rows.stop - rows.start) // 4), max(1, (columns.stop - columns.start) // 8)
        m = self._grid.plane_map(
            H_plane_image, slice(rows.start, rows.stop, row_step), slice(columns.start, columns.stop, column_step)
        )
        if not m.front.any():
            return math.inf
        a, b, c, d = (part[m.front].astype(np.float64) for part in (m.ux, m.uy, m.vx, m.vy))
        # The larger singular value of [[a, b], [c, d]].
        half = (a * a + b * b + c * c + d * d) / 2
        root = np.sqrt(np.maximum(half * half - (a * d - b * c) ** 2, 0))
        return float(np.sqrt((half + root).max()))


def _area_means(planes: list[Image], m: PlaneMap) -> list[Image]:
    """Return the mean of each plane over each pixel's area, (rows, columns) float32."""
    n = SAMPLES
    rows, columns = m.u.shape
    offsets = ((np.arange(n, dtype=np.float32) - (n - 1) / 2) / n).astype(np.float32)
    along, down = offsets[None, :, None, None], offsets[:, None, None, None]
    # To first order in the offset: what is neglected is below 1e-3 of the samples' distance.
    u = (m.u + down * m.uy) + along * m.ux
    v = (m.v + down * m.vy) + along * m.vx
    u, v = u.reshape(n * n * rows, columns), v.reshape(n * n * rows, columns)
    # One call for all samples of a block, whose height OpenCV limits to 32767.
    samples = [cv2.remap(plane, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) for plane in planes]
    return [s.reshape(n * n, rows, columns).mean(axis=0) for s in samples]


def _sites(layout: PixelLayout) -> tuple[_PixelSites, ...]:
    if layout.color is ColorModel.BAYER and layout.pattern is not None:
        return tuple(_PixelSites(i // 2, i % 2, 2, ((color, 0),)) for i, color in enumerate(layout.pattern.value))
    if layout.color is ColorModel.MONO:
        return (_PixelSites(0, 0, 1, (("y", 0),)),)
    if layout.color in (ColorModel.RGB, ColorModel.BGR):
        return (_PixelSites(0, 0, 1, tuple((color, layout.color.value.index(color)) for color in "rgb")),)
    raise ShapeError(f"layout: {layout.color}; need bayer with a pattern, mono, rgb or bgr")


def _site_slices(sites: _PixelSites, rows: slice, columns: slice) -> tuple[slice, slice]:
    """Return the sites within a block that starts at even coordinates."""
    return (
        slice(rows.start + sites.row, rows.stop, sites.step),
        slice(columns.start + sites.column, columns.stop, sites.step),
    )


def _channel(out: Image, where: tuple[slice, slice], channel: int) -> Image:
    block: Image = out[where] if out.ndim == 2 else out[*where, channel]
    return block


_SIDE_PX = 1024
#: The texture repeats after this many scene radii.
_PERIOD_RADII = 4.0
#: Mean reflectance by plane.
WALL_REFLECTANCE = {"r": 0.24, "g": 0.23, "b": 0.21, "y": 0.23}


class Wall:
    """Texture levels of the wall, each half the size of the one before."""

    def __init__(self, scene_radius_m: float) -> None:
        """Scale the texture to a scene of this radius."""
        self._texel_m = _PERIOD_RADII * scene_radius_m / _SIDE_PX
        self._levels = _levels()

    def image_from_wall(self, K: Matrix3, camera_from_scene: RigidTransform, wall_m: float) -> Matrix3:
        """Return the (3, 3) map from texels to ideal pixels, w > 0 in front of the camera; of N poses (N, 3, 3)."""
        R, t = camera_from_scene.R, camera_from_scene.t
        plane = np.stack((R[..., 0] * self._texel_m, -R[..., 1] * self._texel_m, t - wall_m * R[..., 2]), axis=-1)
        H: Matrix3 = K @ plane
        return H

    def level_for(self, step_px: float) -> int:
        """Return the level for single samples `step_px` texels apart."""
        wanted = math.ceil(math.log2(step_px / 1.2)) if 0 < step_px < math.inf else len(self._levels)
        return min(max(wanted, 0), len(self._levels) - 1)

    def level_from_wall(self, level: int) -> Matrix3:
        """Return the (3, 3) map from texels to the level's pixels."""
        return PixelScaling(2.0**level).reduced_from_full

    def roughness(self, level: int, m: PlaneMap) -> Image:
        """Return the wall's relative reflectance, (rows, columns) float32 around 1; beyond its horizon 1."""
        rough = cv2.remap(self._levels[level], m.u, m.v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        rough[~m.front] = 1.0
        return rough


@cache
def _levels() -> tuple[Image, ...]:
    """Return the texture at full size, a half, a fourth, ...; every wall is the same."""
    levels = [wall_texture(_SIDE_PX)]
    while levels[-1].shape[0] > 4:
        levels.append(cv2.resize(levels[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
    return tuple(levels)


def rectangle_coverage(on_plane: PlaneMap, width: float, height: float) -> Image:
    """Return the share of each pixel, (rows, columns) float32 in [0, 1], that looks at the rectangle.

    The rectangle reaches from (-0.5, -0.5) to (width - 0.5, height - 0.5) in the plane's coordinates. Each edge cuts
    the unit pixel exactly, as a straight line; at a corner the product of two such shares is an approximation.
    """
    m = on_plane
    # No point of a pixel is further than this from its centre, in plane coordinates.
    reach_u = float(np.abs(m.ux).max() + np.abs(m.uy).max())
    reach_v = float(np.abs(m.vx).max() + np.abs(m.vy).max())
    du = np.float32(width / 2) - np.abs(m.u - np.float32((width - 1) / 2))
    dv = np.float32(height / 2) - np.abs(m.v - np.float32((height - 1) / 2))
    share = ((du > reach_u) & (dv > reach_v)).astype(np.float32)
    band = np.flatnonzero((du > -reach_u) & (dv > -reach_v) & (share == 0))
    if len(band):
        u, v, ux, uy, vx, vy = (a.ravel()[band] for a in (m.u, m.v, m.ux, m.uy, m.vx, m.vy))
        distances = np.stack((u + 0.5, width - 0.5 - u, v + 0.5, height - 0.5 - v)).astype(np.float32)
        shares = _half_plane_share(distances, np.stack((ux, ux, vx, vx)), np.stack((uy, uy, vy, vy)))
        share.ravel()[band] = shares.prod(axis=0)
    if not m.front.all():
        share[~m.front] = 0
    return share


def _half_plane_share(value: Image, gx: Image, gy: Image) -> Image:
    """Return the share of the unit pixel where the linear function with this central value and gradient is positive."""
    gx, gy = np.abs(gx), np.abs(gy)
    length = np.hypot(gx, gy)
    long, short = np.maximum(gx, gy) / length, np.minimum(gx, gy) / length
    d = value / length
    reach, away = (long + short) / 2, np.abs(d)
    # The distance over the pixel is the sum of two uniform variables: its distribution is a trapezoid.
    tail = np.maximum(reach - away, 0) ** 2 / (2 * long * np.maximum(short, np.float32(1e-6)))
    share = np.where(away <= (long - short) / 2, 0.5 + away / long, 1 - tail)
    share = np.where(away >= reach, np.float32(1), share)
    return np.where(d >= 0, share, 1 - share)
