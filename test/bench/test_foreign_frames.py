# SPDX-License-Identifier: Apache-2.0
"""The ruler of foreign frames: its truth, its sensor and its judge."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation


@pytest.fixture
def scenes(monkeypatch: pytest.MonkeyPatch, repository: Any) -> Any:
    """The module of cameras, paths and sensor."""
    monkeypatch.syspath_prepend(str(repository / "benchmarks"))
    import foreign_scenes  # type: ignore[import-not-found]

    return foreign_scenes


@pytest.fixture
def photographs(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Five small photographs in the place of the real ones."""
    import cv2

    (tmp_path / "kodak").mkdir()
    rng = np.random.default_rng(4)
    for index in range(5):
        noise = cv2.resize(rng.integers(0, 256, (12, 18, 3), np.uint8), (96, 64), interpolation=cv2.INTER_CUBIC)
        cv2.imwrite(str(tmp_path / "kodak" / f"{index}.png"), noise)
    monkeypatch.setenv("IMGU_DATA", str(tmp_path))


@pytest.fixture
def rows(scenes: Any, photographs: None) -> Any:
    """The module of rows."""
    import foreign_rows  # type: ignore[import-not-found]

    return foreign_rows


def test_mosaic_takes_the_channel_of_each_site(scenes: Any) -> None:
    light = np.broadcast_to(np.array([1.0, 2.0, 4.0]), (4, 6, 3))
    seen = scenes.mosaic(light, scenes.BayerSensor(pattern="gbrg", gains=(0.5, 1.0, 0.25)))
    assert np.array_equal(seen[:2, :2], [[2.0, 1.0], [0.5, 2.0]])
    assert np.array_equal(seen, np.tile(seen[:2, :2], (2, 3)))


def test_sensor_has_shot_and_read_noise(scenes: Any) -> None:
    sensor = scenes.BayerSensor()
    dn = scenes.exposed(np.full((200, 200), 0.4), sensor, np.random.default_rng(1)).astype(float)
    gain = (sensor.white - sensor.black) / sensor.full_well_e
    assert dn.mean() == pytest.approx(sensor.black + 0.4 * (sensor.white - sensor.black), abs=0.2)
    assert dn.var() == pytest.approx(gain**2 * (3600 + 9) + 1 / 12, rel=0.03)
    assert scenes.exposed(np.full((4, 4), 2.0), sensor, np.random.default_rng(1)).min() == sensor.white


def test_film_curve_is_monotone(scenes: Any) -> None:
    sensor = scenes.BayerSensor()
    values = scenes.film(np.arange(sensor.white + 1, dtype=np.uint16), sensor).astype(int)
    assert values[0] == values[sensor.black] > 0 and values[-1] < 255
    assert (np.diff(values) >= 0).all() and len(set(values)) > 200


def test_homography_agrees_with_the_projection(scenes: Any) -> None:
    optics = scenes.RayOptics(600.0, 602.0, 318.0, 243.0)
    path = scenes.orbit(np.random.default_rng(3), optics, 300.0, 20.0, (90.0, 60.0))
    size, xy = (640, 420), np.array([[-0.5, -0.5], [639.5, 0.0], [100.0, 419.5]])
    xyw = np.column_stack((xy, np.ones(3))) @ scenes.homography(optics.K, *path(0.1), size).T
    seen = scenes.projected(optics, path, 0.1, scenes.on_print(xy, size))
    assert np.allclose(seen, xyw[:, :2] / xyw[:, 2:], atol=1e-9)


def test_path_has_its_speed(scenes: Any) -> None:
    optics = scenes.RayOptics(600.0, 600.0, 319.5, 239.5)
    path = scenes.orbit(np.random.default_rng(3), optics, 300.0, 30.0, (100.0, 70.0))
    middle = np.array([scenes.pinhole(optics, *path(k / scenes.RATE_HZ / 8), np.zeros((1, 3)))[0] for k in range(200)])
    assert np.allclose(np.linalg.norm(np.diff(middle, axis=0), axis=1) * 8, 30.0, rtol=0.02)


def test_rolling_shutter_shows_each_point_at_its_own_row(scenes: Any) -> None:
    optics = scenes.RayOptics(600.0, 600.0, 319.5, 239.5, row_time_s=30e-6)
    path = scenes.orbit(np.random.default_rng(5), optics, 300.0, 25.0, (100.0, 60.0))
    points = np.array([[-0.1, -0.06, 0.0], [0.1, 0.06, 0.0]])
    for point, (x, y) in zip(points, scenes.projected(optics, path, 0.2, points), strict=True):
        at_row = path(0.2 + (y - 239.5) * 30e-6)
        assert np.allclose(scenes.pinhole(optics, *at_row, point[None])[0], (x, y), atol=1e-3)


def test_takes_follow_from_row_and_seed(rows: Any) -> None:
    for row in rows.ROWS:
        one, same, other = (rows.take(row, seed) for seed in (1, 1, 2))
        assert np.array_equal(one.target, same.target) and one.optics == same.optics
        assert np.array_equal(one.path(0.3)[0], same.path(0.3)[0])
        assert one.optics != other.optics and one.sensor.pattern != other.sensor.pattern
        if row.print != "photograph":
            assert not np.array_equal(one.target, other.target)
        if row.hand:
            assert len(one.covered) == rows.FRAMES and 0.15 < min(one.covered) < max(one.covered) < 0.55


def test_corner_error_and_nees(scenes: Any) -> None:
    import foreign_frames  # type: ignore[import-not-found]

    H = np.diag([2.0, 2.0, 1.0])
    moved = np.array([[1.0, 0, 3.0], [0, 1.0, 4.0], [0, 0, 1.0]]) @ H
    assert foreign_frames.corner_rms(-0.3 * moved, H, (40, 30)) == pytest.approx(5.0)
    behind = np.array([[1.0, 0, 0], [0, 1.0, 0], [-0.05, 0, 1.0]])
    assert foreign_frames.corner_rms(behind, np.eye(3), (40, 30)) == np.inf

    R, t, C = Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix(), np.array([0.1, 0.0, 0.7]), np.diag([1e-6] * 6)
    turned = Rotation.from_rotvec([0.002, 0, 0]).as_matrix() @ R
    assert foreign_frames.squared_error(R, t, C, turned, t + [0, 0.001, 0]) == pytest.approx(5.0)

    outcome = foreign_frames.ForeignOutcome("lens", 1, "imgu", 0, "tracked", 0.2, 3.0, 5.0, 4.0)
    outcomes = [outcome, replace(outcome, corner_px=30.0, nees=100.0), replace(outcome, corner_px=None, nees=None)]
    figures = foreign_frames.figures_of("lens", "lens", "imgu", outcomes)
    assert (figures.frames, figures.found, figures.wrong, figures.poses, figures.inside) == (3, 1, 1, 2, 0.5)
    assert "| 1/3 | 1 | 0.200 |" in foreign_frames.table([figures])


def test_centroid_of_a_polygon(scenes: Any) -> None:
    import foreign_truth  # type: ignore[import-not-found]

    triangle = np.array([[0.0, 0], [6, 0], [0, 3]])
    assert np.allclose(foreign_truth.polygon_centroid(triangle), (2, 1))


def test_path_tracer_shows_dots_where_the_truth_says(rows: Any) -> None:
    pytest.importorskip("mitsuba")
    try:
        from foreign_renderer import ForeignRenderer  # type: ignore[import-not-found]
    except ImportError as error:
        pytest.skip(str(error))
    import foreign_truth

    # Half the size, with everything that moves a point: lens, rolling shutter, motion.
    (row,) = (row for row in rows.ROWS if row.name == "rolling")
    shown = rows.take(row, 3).with_dots()
    optics = replace(
        shown.optics,
        fx=shown.optics.fx / 2,
        fy=shown.optics.fy / 2,
        cx=(shown.optics.cx - 0.5) / 2,
        cy=(shown.optics.cy - 0.5) / 2,
        width=320,
        height=240,
        distortion=(-0.28, 0.09, 0.0008, -0.0006, -0.01),
        row_time_s=60e-6,
    )
    shown = replace(shown, optics=optics)
    light = ForeignRenderer(shown.scene(0)).light(optics, shown.path, 0.1, 4, 1)
    errors = foreign_truth.dot_errors(shown, light, 0.1)
    assert np.sqrt((errors**2).sum(axis=1).mean()) < foreign_truth.MOST_PX
    assert np.abs(errors.mean(axis=0)).max() < 0.005


def test_frames_are_kept(rows: Any, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    import foreign_cache  # type: ignore[import-not-found]

    class Constant:
        """Renders nothing."""

        def light(self, *of: Any) -> Any:
            return np.full((480, 640, 3), 0.3)

    monkeypatch.setattr(foreign_cache, "_renderer", lambda take, index: Constant())
    (row,) = (row for row in rows.ROWS if row.film)
    frame = foreign_cache.FrameStore(rows.take(row, 1), tmp_path).frame(2)
    monkeypatch.setattr(foreign_cache, "_renderer", None)
    again = foreign_cache.FrameStore(rows.take(row, 1), tmp_path).frame(2)
    assert frame.pixels.dtype == np.uint8 and np.array_equal(frame.pixels, again.pixels)
    assert np.array_equal(frame.H, again.H) and frame.stamp_ns == again.stamp_ns == 10**9 + 66666667
    assert np.linalg.det(frame.R) == pytest.approx(1) and frame.t[2] > 0
