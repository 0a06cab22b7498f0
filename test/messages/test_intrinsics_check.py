# SPDX-License-Identifier: Apache-2.0
"""Both sides of every limit of what a K can be."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.messages.camera_reading import CameraDescription, read_camera

SIZE = (640, 480)


def described(
    f: tuple[float, float] = (500, 500), c: tuple[float, float] = (319.5, 239.5), size: tuple[int, int] = SIZE, **more
) -> CameraDescription:
    K = (f[0], more.pop("skew", 0.0), c[0], 0.0, f[1], c[1], 0.0, 0.0, 1.0)
    given = {"D": (), "model": "plumb_bob"} | more
    return CameraDescription("camera_info", K, width=size[0], height=size[1], **given)


def outcome(said: CameraDescription, image_size: tuple[int, int] | None = None) -> str:
    read = read_camera(said, rectified=False, image_size=image_size)
    assert (read.camera is None) == bool(read.reason)
    return "problem" if read.reason else "remark" if read.remarks else "fine"


def focal(degrees: float) -> tuple[float, float]:
    f = 320 / math.tan(math.radians(degrees) / 2)
    return f, f


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        (described(), "fine"),
        # Angle of view across the longer side.
        (described(f=focal(154.9)), "fine"),
        (described(f=focal(155.1)), "problem"),
        (described(f=focal(179)), "problem"),
        (described(f=focal(0.68)), "fine"),  # 0.51 degrees down
        (described(f=focal(0.49)), "problem"),
        (described(f=(500, 2)), "problem"),
        (described(f=(65, 65), model="fisheye"), "fine"),
        (described(f=(63, 63), model="fisheye"), "problem"),
        # Principal point, one direction.
        (described(c=(0.36 * 640, 239.5)), "fine"),
        (described(c=(0.34 * 640, 239.5)), "remark"),
        (described(c=(319.5, 0.64 * 480)), "fine"),
        (described(c=(319.5, 0.66 * 480)), "remark"),
        (described(c=(0.16 * 640, 239.5)), "remark"),
        (described(c=(0.14 * 640, 239.5)), "problem"),
        (described(c=(0.86 * 640, 239.5)), "problem"),
        (described(c=(319.5, -1)), "problem"),
        # To one corner, as of another resolution.
        (described(c=(0.42 * 640, 0.42 * 480)), "fine"),
        (described(c=(0.39 * 640, 0.39 * 480)), "problem"),
        (described(c=(0.61 * 640, 0.61 * 480)), "problem"),
        (described(c=(0.38 * 640, 0.62 * 480)), "fine"),
        (described(c=(0.38 * 640, 0.45 * 480)), "fine"),
        # Pixels.
        (described(f=(500, 251)), "fine"),
        (described(f=(500, 249)), "remark"),
        (described(f=(500, 1001)), "remark"),
        (described(skew=24.0), "fine"),
        (described(skew=-26.0), "remark"),
        # Of a part of the sensor: binned, or a window.
        (described(c=(639.5, 479.5), size=(1280, 960), binning=(2, 2)), "fine"),
        (described(c=(319.5, 239.5), size=(1280, 960), binning=(2, 2)), "problem"),
        (described(c=(319.5, 479.5), size=(1280, 960), binning=(2, 1)), "problem"),
        (described(c=(639.5, 479.5), size=(1280, 960), roi=(320, 240, 640, 480)), "fine"),
        (described(c=(319.5, 239.5), size=(1280, 960), roi=(320, 240, 640, 480)), "problem"),
        (described(c=(639.5, 479.5), size=(1280, 960), roi=(0, 0, 200, 200)), "fine"),
        (described(c=(319.5, 239.5), size=(1280, 960), roi=(0, 0, 640, 480)), "remark"),
        # Both readings in the middle: the standard's.
        (described(c=(619.5, 459.5), size=(1280, 960), roi=(20, 20, 1240, 920)), "fine"),
    ],
)
def test_limits(said: CameraDescription, expected: str) -> None:
    assert outcome(said) == expected, read_camera(said, rectified=False)


@pytest.mark.parametrize(
    ("ratio", "more", "expected"),
    [
        (1.2, {}, "fine"),
        (1.3, {}, "remark"),
        (0.75, {}, "remark"),
        (0.75, {"D": (-0.3, 0.1, 0, 0, 0)}, "fine"),
        (0.35, {"D": (-0.3, 0.1, 0, 0, 0)}, "remark"),
        (2.6, {"D": (-0.3, 0.1, 0, 0, 0)}, "remark"),
        (0.3, {"D": (0.01, 0, 0, 0), "model": "equidistant"}, "fine"),
        (0.1, {"D": (0.01, 0, 0, 0), "model": "equidistant"}, "remark"),
        (1000.0, {}, "remark"),
    ],
)
def test_focal_lengths_of_K_and_P(ratio: float, more: dict[str, object], expected: str) -> None:
    f = 500 * ratio
    P = (f, 0.0, 320.0, -10.0, 0.0, f, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    read = read_camera(described(P=P, **more), rectified=False, image_size=SIZE)
    assert read.camera is not None
    assert read.camera.K[0, 0] == 500
    assert [("K and P disagree: fx is 500 px" in line) for line in read.remarks] == [True] * (expected == "remark")


def test_which_matrix_would_do_is_said() -> None:
    good = (500.0, 0.0, 320.0, 0.0, 0.0, 500.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    identity = tuple(np.eye(3).ravel().tolist())
    said = CameraDescription("camera_info", identity, (), "plumb_bob", 640, 480, P=good)
    reason = read_camera(said, rectified=False).reason
    assert "P has fx 500 px: if the images are rectified, set camera.rectified to true" in reason
    # What depthai-ros sends for rectified images.
    said = CameraDescription("camera_info", (0.0,) * 9, (0.0,) * 8, "rational_polynomial", 640, 480, P=good)
    reason = read_camera(said, rectified=False).reason
    assert "K is all zero: the camera is not calibrated; P has fx 500 px" in reason
    assert read_camera(said, rectified=True).reason == ""
    said = described(P=tuple(np.eye(3, 4).ravel().tolist()))
    reason = read_camera(said, rectified=True).reason
    assert "K has fx 500 px: if the images are not rectified, set camera.rectified to false" in reason


def test_a_window_that_is_in_K_alone_is_told_how_it_is_said() -> None:
    def reason(**more) -> str:
        return read_camera(described(size=(700, 520), **more), rectified=False).reason

    assert reason(c=(435, 338)).endswith(
        "; if the image is a part of the sensor, need width, height and K of all of it, and roi"
    )
    assert "part of the sensor" in reason(c=(-65, 188))
    assert "part of the sensor" not in reason(c=(0, 0))
    assert "part of the sensor" not in reason(c=(435, 338), roi=(10, 10, 400, 300))


def test_the_order_of_D() -> None:
    for D, model, odd in (
        ((0.1, -0.1, 0.02, -0.02, 0.05), "plumb_bob", False),
        ((0.09, -0.12, 0.05, 0.0004, -0.0002), "plumb_bob", True),  # k1 k2 k3 p1 p2: Orbbec
        ((-0.0022, 0.0376, -0.0364, 0.0059, 0.0), "plumb_bob", True),  # a fisheye's: T265
        ((-0.0022, 0.0376, -0.0364, 0.0059), "equidistant", False),
    ):
        (*remarks,) = read_camera(described(D=D, model=model), rectified=False).remarks
        assert ["another order" in line for line in remarks] == [True] * odd


#: Fits that look odd and are cameras': strong rational ones cancel.
REAL = (
    ((1874.6, 1879.6), (647.5, 485.5), (1296, 972), "rational_polynomial",
     (-13.238113, -98.012135, 0.001444, 0.002849, 1357.782415, -13.050801, -102.363353, 1383.055291)),
    ((795, 795), (641, 362), (1280, 720), "rational_polynomial",
     (4.6552, 1.3477, -0.0003, 0.0002, 0.05, 4.9, 2.9, 0.3, 0.001, 0, -0.001, 0, 0.004, -0.012)),
    ((1451.8, 1451.8), (343, 237), (640, 480), "plumb_bob", (-0.160041, 1.349563, -0.001729, -0.000031, -9.472244)),
    ((545.2, 540.9), (339.5, 181.4), (640, 360), "plumb_bob", (-0.5351, 0.369, 0.0147, -0.00339, -0.128)),
    ((484.2, 484.2), (950.6, 587), (1920, 1200), "plumb_bob", (-0.008885, -0.00041, -0.00196, 0.001645, 0)),
    ((1138.8, 1138.4), (1635.7, 1208.6), (3280, 2464), "equidistant", (0.03678, 0.009125, -0.009733, -0.010051)),
    ((642.9, 642.9), (637.5, 350.7), (1280, 720), "plumb_bob", (0, 0, 0, 0, 0)),
    ((427.3, 427.3), (422.4, 43.8), (848, 100), "plumb_bob", (0, 0, 0, 0, 0)),
)  # fmt: skip


@pytest.mark.parametrize(("f", "c", "size", "model", "D"), REAL)
def test_calibrations_of_real_cameras_pass(f, c, size, model, D) -> None:
    assert outcome(described(f, c, size, model=model, D=D)) == "fine"


@pytest.mark.parametrize(
    ("D", "model", "fine"),
    [
        ((-0.36, 0.14, 0, 0, -0.025), "plumb_bob", True),
        ((-0.6, 0, 0, 0, 0), "plumb_bob", True),  # folds in the corners alone
        ((-5.0, 0, 0, 0, 0), "plumb_bob", False),
        ((0.2, 0.1, 0, 0), "equidistant", True),
        ((-9.0, 0, 0, 0), "equidistant", False),
        ((0.1,) * 5, "plumb_bob", True),
    ],
)
def test_a_lens_that_folds_the_image(D: tuple[float, ...], model: str, fine: bool) -> None:
    read = read_camera(described(D=D, model=model), rectified=False)
    assert (read.camera is not None) == fine
    assert fine or "folds the image over" in read.reason


_NUMBERS = st.one_of(
    st.floats(width=64),
    st.floats(-2000, 2000),
    st.sampled_from([0.0, 1.0, 320.0, 240.0, 500.0, -0.3, 1e-4, 5e-324, 1e308]),
)
_SIZES = st.one_of(st.integers(0, 2**32 - 1), st.sampled_from([0, 1, 2, 240, 320, 480, 640, 1280]))


@given(
    K=st.lists(_NUMBERS, min_size=9, max_size=9),
    P=st.lists(_NUMBERS, max_size=13),
    D=st.lists(_NUMBERS, max_size=15),
    model=st.one_of(
        st.text(max_size=60), st.sampled_from(["", "plumb_bob", "equidistant", "rational_polynomial", "tilted"])
    ),
    sizes=st.tuples(*[_SIZES] * 8),
    good=st.sampled_from(["K", "P", "size", "K and size", ""]),
    rectified=st.booleans(),
)
def test_whatever_is_said_nothing_is_raised(K, P, D, model, sizes, good, rectified) -> None:
    width, height, x, y, w, h, bx, by = sizes
    if "K" in good:
        K = [500.0, 0.0, 320.0, 0.0, 500.0, 240.0, 0.0, 0.0, 1.0]
    if good == "P":
        P = [500.0, 0.0, 320.0, 0.0, 0.0, 500.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    if "size" in good:
        width, height, x, y, w, h, bx, by = 640, 480, 0, 0, 0, 0, 1, 1
    said = CameraDescription(
        "camera_info",
        tuple(K),
        tuple(D),
        model,
        width,
        height,
        P=tuple(P),
        binning=(max(1, bx), max(1, by)),
        roi=(x, y, w, h),
    )
    for image_size in (None, (640, 480)):
        read = read_camera(said, rectified=rectified, image_size=image_size)
        assert (read.camera is None) == bool(read.reason)
        for line in (read.reason, *read.remarks):
            assert "\n" not in line
            assert len(line) < 800
        if read.camera is not None:
            assert np.isfinite(read.camera.K).all()
            centre = np.array([[read.camera.K[0, 2], read.camera.K[1, 2]]])
            assert np.isfinite(read.camera.undistort(centre)[0]).all()
