# SPDX-License-Identifier: Apache-2.0
"""Calibration: how honest its uncertainty is, and its residual on real pictures beside OpenCV's calibrateCamera.

python benchmarks/calibration.py [--sets 50] [--data ../shared/data] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import cv2
import numpy as np

from imgu_ros.image_files.images import read_image
from imgu_ros.simulate.chessboard import random_chessboard_view
from imgu_ros.vision.camera.calibration import calibrate
from imgu_ros.vision.camera.chessboard import Chessboard, find_chessboard
from imgu_ros.vision.camera.intrinsics import Camera, make_camera

BOARD = Chessboard(9, 6, 0.025)
VIEWS, NOISE_PX = 15, 0.1
#: OpenCV counts the window from its middle: 2 x 5 + 1 = 11 px a side.
HALF_WINDOW = (5, 5)
LENSES: dict[str, tuple[int, tuple[float, ...]]] = {
    "plumb_bob": (900, (-0.26, 0.09, 0.0008, -0.0005, -0.01)),
    "rational_polynomial": (600, (0.35, 0.08, 0.0006, -0.0004, 0.01, 0.62, 0.16, 0.01)),
    "equidistant": (500, (-0.03, 0.008, -0.004, 0.001)),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", type=int, default=50)
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[2] / "shared" / "data")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    results = {"simulated": simulated(arguments.sets), "real": real(arguments.data / "chessboard")}
    if arguments.json:
        arguments.json.write_text(json.dumps(results, indent=2) + "\n")


def simulated(sets: int) -> dict[str, object]:
    """Sets of views with known noise: errors beside the predicted ones."""
    print(f"{sets} sets of {VIEWS} views, {NOISE_PX} px: mean normalised squared error of fx fy cx cy (4 is honest)")
    results: dict[str, object] = {}
    for model, (focal, k) in LENSES.items():
        K = np.array([[focal, 0, 655], [0, 0.98 * focal, 350], [0, 0, 1]])
        lens = make_camera(K, k, model, 1280, 720)
        squared, theirs, ours_ms, theirs_ms = [], [], [], []
        for seed in range(sets):
            rng = np.random.default_rng(seed)
            views = [random_chessboard_view(BOARD, lens, rng).corners for _ in range(VIEWS)]
            views = [view + rng.normal(0, NOISE_PX, view.shape) for view in views]
            start = time.perf_counter()
            found = calibrate(BOARD.corners(), views, 1280, 720, model)
            ours_ms.append(1e3 * (time.perf_counter() - start))
            error = _main(found.camera.K) - _main(lens.K)
            squared.append(float(error @ np.linalg.solve(found.covariance[:4, :4], error)))
            start = time.perf_counter()
            their_K = _opencv(views, lens)
            theirs_ms.append(1e3 * (time.perf_counter() - start))
            theirs.append([float(np.abs(error).max()), float(np.abs(_main(their_K) - _main(lens.K)).max())])
        worst = np.mean(theirs, axis=0)
        print(
            f"  {model:<20} {np.mean(squared):5.2f}   largest error px, ours {worst[0]:.2f}, OpenCV {worst[1]:.2f}"
            f"   ms {np.median(ours_ms):.0f}, OpenCV {np.median(theirs_ms):.0f}"
        )
        results[model] = {
            "normalised_squared_error": float(np.mean(squared)),
            "error_px": {"ours": float(worst[0]), "opencv": float(worst[1])},
            "ms": {"ours": float(np.median(ours_ms)), "opencv": float(np.median(theirs_ms))},
        }
    return results


def real(folder: Path) -> dict[str, float]:
    """Residuals on the pictures of a folder, px a corner."""
    files = sorted(folder.glob("left??.jpg"))
    if not files:
        print(f"{folder}: no pictures; skipped")
        return {}
    greys = [read_image(file) for file in files]
    greys = [grey if grey.ndim == 2 else cv2.cvtColor(grey, cv2.COLOR_RGB2GRAY) for grey in greys]
    height, width = greys[0].shape
    size = (BOARD.columns, BOARD.rows)
    ours = [corners for grey in greys if (corners := find_chessboard(grey, BOARD)) is not None]
    sector = [cv2.findChessboardCornersSB(grey, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE) for grey in greys]
    plain = [cv2.findChessboardCorners(grey, size) for grey in greys]
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-3)
    fixed = [
        cv2.cornerSubPix(grey, np.array(corners, np.float32), HALF_WINDOW, (-1, -1), criteria)
        for grey, (done, corners) in zip(greys, plain, strict=True)
        if done
    ]
    camera = make_camera([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1]], (), "plumb_bob", width, height)
    found = calibrate(BOARD.corners(), ours, width, height)
    results = {
        "ours": found.rms_corner_px,
        "calibrateCamera, our corners": _opencv_rms(ours, camera),
        "calibrateCamera, findChessboardCornersSB": _opencv_rms([c for done, c in sector if done], camera),
        "calibrateCamera, cornerSubPix 11 x 11 px": _opencv_rms(fixed, camera),
    }
    print(f"{len(files)} real pictures, residual px a corner")
    for name, value in results.items():
        print(f"  {name:<45} {value:.4f}")
    return results


def _main(K: np.ndarray) -> np.ndarray:
    return np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]])


def _points(count: int) -> list[np.ndarray]:
    xy = BOARD.corners()
    return [np.column_stack((xy, np.zeros(len(xy)))).astype(np.float32)[:, None]] * count


def _pixels(views: list[np.ndarray]) -> list[np.ndarray]:
    return [np.ascontiguousarray(np.reshape(view, (-1, 1, 2)), np.float32) for view in views]


def _opencv(views: list[np.ndarray], lens: Camera) -> np.ndarray:
    size, points, pixels = (lens.width, lens.height), _points(len(views)), _pixels(views)
    if str(lens.model) == "equidistant":
        # OpenCV 5 takes rows of points alone.
        points = [array.astype(np.float64).reshape(1, -1, 3) for array in points]
        pixels = [array.astype(np.float64).reshape(1, -1, 2) for array in pixels]
        names = cv2.fisheye if hasattr(cv2.fisheye, "CALIB_FIX_SKEW") else cv2  # OpenCV 4 and 5
        flags = names.CALIB_RECOMPUTE_EXTRINSIC | names.CALIB_FIX_SKEW
        return np.asarray(cv2.fisheye.calibrate(points, pixels, size, np.zeros((3, 3)), np.zeros(4), flags=flags)[1])
    flags = cv2.CALIB_RATIONAL_MODEL if str(lens.model) == "rational_polynomial" else 0
    return np.asarray(cv2.calibrateCamera(points, pixels, size, None, None, flags=flags)[1])


def _opencv_rms(views: list[np.ndarray], camera: Camera) -> float:
    return float(cv2.calibrateCamera(_points(len(views)), _pixels(views), (camera.width, camera.height), None, None)[0])


if __name__ == "__main__":
    main()
