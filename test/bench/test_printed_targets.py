# SPDX-License-Identifier: Apache-2.0
"""The ruler of prints: its views show the print where their truth says."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imgu_ros.types import Floats


@pytest.fixture
def drawing(monkeypatch: pytest.MonkeyPatch, repository: Any) -> Any:
    """The module that draws prints."""
    monkeypatch.syspath_prepend(str(repository / "benchmarks"))
    import print_drawing  # type: ignore[import-not-found]

    return print_drawing


@pytest.fixture
def rendering(drawing: Any) -> Any:
    """The module that renders views."""
    import print_views  # type: ignore[import-not-found]

    return print_views


def test_same_seed_draws_same_prints(drawing: Any) -> None:
    kinds = ["logo", "number_label", "qr_code", "rotational_3"]
    one, same, other = (drawing.prints(seed, kinds) for seed in (3, 3, 4))
    assert len(drawing.KINDS) == len(set(drawing.KINDS)) >= 40
    for a, b, c in zip(one, same, other, strict=True):
        assert a.pixels.dtype == np.uint8
        assert np.array_equal(a.pixels, b.pixels)
        assert not np.array_equal(a.pixels, c.pixels)
    (sibling,) = one[-1].siblings
    differs = (sibling.pixels != one[-1].pixels).any(axis=2).mean()
    assert 0 < differs < 0.2


def test_an_unknown_kind_is_named(drawing: Any) -> None:
    with pytest.raises(ValueError, match="kinds: nothing; need"):
        drawing.prints(0, ["nothing"])


def test_symmetric_prints_are_symmetric(drawing: Any) -> None:
    for shown in drawing.prints(5, ["rotational_2", "rotational_4", "playing_card"]):
        turned = shown.pixels[::-1, ::-1].astype(int)
        assert np.abs(turned - shown.pixels).mean() < 1.0, shown.name


@pytest.mark.parametrize("mode", ["tracking", "detection"])
def test_dots_are_seen_where_the_truth_says(drawing: Any, rendering: Any, mode: str) -> None:
    size, radius = (760, 560), 22
    x, y = np.meshgrid(np.arange(60, size[0], 128), np.arange(60, size[1], 110))
    centres = np.column_stack((x.ravel(), y.ravel())).astype(float)
    shown = drawing.Print("dots", "dots", "ordinary", _dots(size, centres, radius), 0.2)
    light = rendering.Light(0.8, (0.0, 0.0), 0.0, (1.0, 1.0, 1.0), 0.5)
    rng = np.random.default_rng(1)
    errors = []
    for view in rendering.views(shown, 7, 4, mode):
        # The same place without a hand, shading or colour of the light, before black.
        place = rendering.Placement(view.R, view.t, view.tilt_deg)
        black = np.zeros((rendering.HEIGHT * 2, rendering.WIDTH * 2, 3), np.float32)
        frame = rendering.rendered(shown, place, black, light, rng, 0).frame
        grey = frame.image.pixels.astype(float) - rendering.BLACK_LEVEL
        for row, column, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
            grey[row::2, column::2] /= rendering.GAINS[channel]
        errors += [e for centre in centres if (e := _centroid_error(grey, view, shown, centre, radius)) is not None]
    assert len(errors) > 60
    assert np.sqrt(np.mean(np.square(errors))) < 0.02
    assert np.abs(np.mean(errors, axis=0)).max() < 0.01


def _dots(size: tuple[int, int], centres: Floats, radius: float) -> Floats:
    finer = 8
    image = np.zeros((size[1] * finer, size[0] * finer), np.uint8)
    for centre in (centres + 0.5) * finer - 0.5:
        cv2.circle(image, np.rint(centre * 16).astype(int).tolist(), radius * finer * 16, 255, -1, cv2.LINE_8, 4)
    reduced = cv2.resize(image, size, interpolation=cv2.INTER_AREA) / 255
    # Linear light is what is integrated: edges are as bright as they cover.
    display = np.where(reduced <= 0.0031308, 12.92 * reduced, 1.055 * reduced ** (1 / 2.4) - 0.055)
    return np.repeat(np.rint(255 * display).astype(np.uint8)[..., None], 3, axis=2)


def _centroid_error(grey: Floats, view: Any, shown: Any, centre: Floats, radius: float) -> Floats | None:
    """Return the centroid of a dot less that of its projection by R, t and K, px; None when it is not all in view."""
    steps = np.linspace(-radius, radius, 81)
    u, v = (axis.ravel() for axis in np.meshgrid(steps, steps))
    disc = np.column_stack((u, v))[np.hypot(u, v) <= radius] + centre

    def project(xy: Floats) -> tuple[Floats, Floats]:
        height, width = shown.pixels.shape[:2]
        metres = (xy - ((width - 1) / 2, (height - 1) / 2)) * (shown.width_m / width) * (1, -1)
        at = np.column_stack((metres, np.zeros(len(xy)))) @ view.R.T + view.t
        return at[:, :2] / at[:, 2:] * 600 + (319.5, 239.5), at[:, 2]

    seen, depth = project(disc)
    # A small area of the plane is seen under an angle that falls with the third power of its depth.
    expected = np.average(seen, axis=0, weights=depth**-3)
    low, high = np.floor(seen.min(axis=0) - 4).astype(int), np.ceil(seen.max(axis=0) + 5).astype(int)
    if (low < 0).any() or (high > (640, 480)).any():
        return None
    part = grey[low[1] : high[1], low[0] : high[0]]
    y, x = np.mgrid[low[1] : high[1], low[0] : high[0]]
    # Neighbours are further away than the window's margin.
    return np.array([(part * x).sum(), (part * y).sum()]) / part.sum() - expected


@pytest.fixture
def judging(drawing: Any) -> Any:
    """The module that compares answers with the truth."""
    import print_judging  # type: ignore[import-not-found]

    return print_judging


def test_squared_errors_of_a_right_covariance_are_chi_squared(judging: Any) -> None:
    rng = np.random.default_rng(2)
    A = rng.normal(size=(6, 6)) * 0.01
    C = A @ A.T + 1e-6 * np.eye(6)
    R, t = Rotation.random(rng=3).as_matrix(), np.array((0.1, -0.2, 1.5))
    errors = rng.multivariate_normal(np.zeros(6), C, 4000)
    nees = np.array(
        [judging.squared_error(R, t, C, Rotation.from_rotvec(e[3:]).as_matrix() @ R, t + e[:3]) for e in errors]
    )
    assert np.allclose(nees, np.einsum("ni,ij,nj->n", errors, np.linalg.inv(C), errors))
    assert nees.mean() == pytest.approx(6, abs=0.2)
    assert np.mean(nees < judging.NEES_95) == pytest.approx(0.95, abs=0.012)
    assert np.median(nees) == pytest.approx(judging.NEES_MEDIAN, abs=0.2)


def test_corner_error_is_the_rms_of_the_four_distances(drawing: Any, judging: Any) -> None:
    shown = drawing.Print("flat", "flat", "poor", np.zeros((40, 60, 3), np.uint8))
    shifted = np.array([[1, 0, 3], [0, 1, 4], [0, 0, 1.0]])
    assert judging.corner_rms(shifted, np.eye(3), shown) == pytest.approx(5)
    assert judging.corner_rms(-2 * shifted, np.eye(3), shown) == pytest.approx(5)
    through_the_horizon = np.array([[1, 0, 0], [0, 1, 0], [-1 / 30, 0, 1.0]])
    assert judging.corner_rms(through_the_horizon, np.eye(3), shown) == np.inf


@pytest.mark.parametrize(("kind", "same"), [("playing_card", True), ("rotational_2", True), ("poster", False)])
def test_half_a_turn_of_a_symmetric_print_is_a_copy(
    drawing: Any, rendering: Any, judging: Any, kind: str, same: bool
) -> None:
    (shown,) = drawing.prints(6, [kind])
    height, width = shown.pixels.shape[:2]
    half_turn = np.array([[-1, 0, width - 1], [0, -1, height - 1], [0, 0, 1.0]])
    nudged = np.array([[1, 0, 0.15], [0, 1, -0.15], [0, 0, 1.0]])
    for view in rendering.views(shown, 1, 3, "detection"):
        assert judging.is_copy(nudged @ view.H @ half_turn, view.H, shown) == same
        moved = np.array([[1, 0, 60], [0, 1, 45], [0, 0, 1.0]])
        assert not judging.is_copy(moved @ view.H, view.H, shown)


def test_a_print_that_fills_the_frame_is_compared(drawing: Any, rendering: Any, judging: Any) -> None:
    (shown,) = drawing.prints(6, ["playing_card"])
    height, width = shown.pixels.shape[:2]
    H = rendering.placed(shown, 1400.0, 0.2, 0.3, 0.1, np.array((320.0, 240.0))).homography(shown)
    half_turn = np.array([[-1, 0, width - 1], [0, -1, height - 1], [0, 0, 1.0]])
    assert judging.is_copy(H @ half_turn, H, shown)


def test_figures_count_right_wrong_and_withheld_poses(drawing: Any) -> None:
    import print_report  # type: ignore[import-not-found]
    import printed_targets  # type: ignore[import-not-found]

    def outcome(corner_px: float | None, nees: float | None, reason: str = "", **others: Any) -> Any:
        rotation = None if nees is None else others.pop("rotation_deg", 0.1)
        values = {"copy": False, "recipes_px": {"SIFT": 1.0, "ORB": None}} | others
        return printed_targets.Outcome(
            "ordinary", "poster", 1, "detection", 0, "", "", reason, corner_px, nees, rotation, values["copy"], 9, 0.1,
            0.5, "", 1.0, 0.0, values["recipes_px"],
        )  # fmt: skip

    figures = print_report.figures_of(
        [
            outcome(0.2, 4.0),
            outcome(0.4, 20.0, rotation_deg=35.0),
            outcome(70.0, 900.0, copy=True, recipes_px={"SIFT": 80.0, "ORB": 2.0}),
            outcome(0.3, None, "two poses fit alike, need a view from nearer (ratio 0.9)"),
            outcome(50.0, None, "two poses fit alike, need a view from nearer (ratio 0.8)"),
            outcome(None, None, "not in view, too small, blurred or covered (3 matches, 8 needed)"),
        ]
    )
    assert (figures["frames"], figures["published"], figures["right"], figures["wrong"]) == (6, 3, 2, 1)
    assert (figures["copies"], figures["flipped"]) == (1, 1)
    assert (figures["unpublished_right"], figures["unpublished_wrong"]) == (1, 1)
    assert figures["withheld"] == {"two poses fit alike": 2, "not in view, too small, blurred or covered": 1}
    assert figures["corner_p50_px"] == pytest.approx(0.3)
    assert figures["nees_p50"] == pytest.approx(12)
    assert figures["inside_95"] == pytest.approx(0.5)
    assert (figures["SIFT"], figures["ORB"]) == ({"right": 5, "wrong": 1}, {"right": 1, "wrong": 0})
