# SPDX-License-Identifier: Apache-2.0
"""Poses of fiducial markers beside the AprilTag library's and OpenCV's, of the same frames.

    pip install apriltag-python
    python benchmarks/markers.py --seed 61 --json benchmarks/figures/markers.json
    python benchmarks/markers.py --photographs ../shared/data/apriltag

Frames of 640x480 with a focal length of 680 px, of `marker_views.py`: markers of 50, 100 and 200 mm, 0.5 to 1.5 m away,
tilted by up to 60 degrees, raw and linear, or with white balance and the curve of sRGB. The other programs get the
demosaicked grey in 8 bits; their corners give a pose by `cv2.solvePnPGeneric` (IPPE_SQUARE), the better of the two. The
AprilTag library's pixel centres are at halves: they are shifted. Each view is one by itself: nothing is known of the
camera from earlier ones. A pose of ours that is reported as ambiguous counts as found, with its better solution.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from marker_views import CAMERA, K, MarkerView, grey_of, marker_views
from numpy.typing import NDArray
from print_views import RAW_PARAMETERS

from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.localizer import Localizer
from imgu_ros.reference.marker import marker_image
from imgu_ros.reference_kinds import make_references

Floats = NDArray[np.floating]

FAMILY = "tag36h11"
WIDTHS_M = (0.05, 0.1, 0.2)
#: A rotation that is off by more is the other solution of a plane, rad.
_FLIPPED = 0.3
#: Bound of the squared error in units of the covariance, 95 % of six degrees of freedom.
_INSIDE = 12.59


@dataclass
class Figures:
    """What one program made of the views of one row.

    Attributes
    ----------
    found, wrong : views with the right marker, and markers with another id
    errors_mm : of the positions
    flips : poses that are the other solution, and are not reported as ambiguous
    ambiguous : poses that are reported so
    nees : squared errors in units of the covariance
    """

    views: int = 0
    found: int = 0
    wrong: int = 0
    errors_mm: list[float] = field(default_factory=list)
    flips: int = 0
    ambiguous: int = 0
    nees: list[float] = field(default_factory=list)

    def row(self) -> dict[str, float | int | None]:
        """Return the figures by name."""
        median, p95 = np.percentile(self.errors_mm, (50, 95)) if self.errors_mm else (math.nan, math.nan)
        known = bool(self.nees)
        return {
            "found": self.found,
            "views": self.views,
            "wrong": self.wrong,
            "median_mm": round(float(median), 3),
            "p95_mm": round(float(p95), 3),
            "flips": self.flips,
            "ambiguous": self.ambiguous,
            "nees_p50": round(float(np.median(self.nees)), 2) if known else None,
            "inside": round(float(np.mean(np.array(self.nees) < _INSIDE)), 3) if known else None,
        }


Finder = Callable[[NDArray[np.uint8]], list[tuple[int, Floats]]]


def others() -> dict[str, Finder]:
    """Return what finds ids and corners, (4, 2) px from top left clockwise, by name."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    aruco = cv2.aruco.ArucoDetector(dictionary, parameters)

    def by_opencv(grey: NDArray[np.uint8]) -> list[tuple[int, Floats]]:
        corners, ids, _ = aruco.detectMarkers(grey)
        numbers = [] if ids is None else ids.ravel()
        return [
            (int(n), np.roll(c.reshape(4, 2).astype(float), 2, axis=0)) for n, c in zip(numbers, corners, strict=True)
        ]

    found: dict[str, Finder] = {"OpenCV ArUco": by_opencv}
    try:
        from apriltag import apriltag
    except ImportError:
        print("apriltag-python is not installed: no row of the AprilTag library")
        return found
    library = apriltag(FAMILY)

    def by_apriltag(grey: NDArray[np.uint8]) -> list[tuple[int, Floats]]:
        return [(d["id"], d["lb-rb-rt-lt"][[3, 2, 1, 0]] - 0.5) for d in library.detect(grey)]

    return {"AprilTag 3.4.5": by_apriltag, **found}


def judge_other(figures: Figures, find: Finder, view: MarkerView, grey: NDArray[np.uint8]) -> None:
    """Add what another program makes of a view."""
    figures.views += 1
    assert view.R is not None and view.t is not None
    for number, corners in find(grey):
        if number != view.number:
            figures.wrong += 1
            continue
        figures.found += 1
        half = view.width_m / 2
        square = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
        _, turns, shifts, _ = cv2.solvePnPGeneric(
            square, np.ascontiguousarray(corners).reshape(4, 1, 2), K, None, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
        figures.errors_mm.append(1e3 * float(np.linalg.norm(shifts[0].ravel() - view.t)))
        figures.flips += _angle(view.R @ cv2.Rodrigues(turns[0])[0].T) > _FLIPPED


def judge_own(figures: Figures, parameters: Parameters, view: MarkerView) -> None:
    """Add what this package makes of a view."""
    figures.views += 1
    assert view.R is not None and view.t is not None and view.number is not None
    # Two other ids are known as well: they are not in view.
    ids = (view.number, (view.number + 1) % 587, (view.number + 100) % 587)
    markers = [marker_image(f"m{number}", FAMILY, number, view.width_m) for number in ids]
    result = Localizer(parameters, make_references(markers, parameters)).process(view.frame)
    own, *rest = result
    figures.wrong += sum(other.status.found for other in rest)
    if not own.status.found:
        return
    figures.found += 1
    pose = own.solutions[0]
    turn = view.R @ pose.R.T
    error = np.concatenate((view.t - pose.t, cv2.Rodrigues(turn)[0].ravel()))
    figures.errors_mm.append(1e3 * float(np.linalg.norm(error[:3])))
    if own.pose is None:
        figures.ambiguous += 1
        return
    figures.flips += _angle(turn) > _FLIPPED
    figures.nees.append(float(error @ np.linalg.solve(pose.covariance, error)))


def _angle(R: Floats) -> float:
    return float(np.linalg.norm(cv2.Rodrigues(R)[0]))


def measured(seed: int, count: int) -> list[dict[str, object]]:
    """Return one row for each program, width and light."""
    rows: list[dict[str, object]] = []
    finders = others()
    for gamma in (False, True):
        parameters = parameters_from({} if gamma else RAW_PARAMETERS)
        for width_m in WIDTHS_M:
            figures = {name: Figures() for name in ("imgu_ros", *finders)}
            for view in marker_views(FAMILY, width_m, seed, count, gamma):
                judge_own(figures["imgu_ros"], parameters, view)
                grey = grey_of(view.frame)
                for name, find in finders.items():
                    judge_other(figures[name], find, view, grey)
            for name, each in figures.items():
                row = {
                    "light": "sRGB" if gamma else "linear",
                    "width_mm": round(1e3 * width_m),
                    "by": name,
                    **each.row(),
                }
                print("  ".join(f"{key} {value}" for key, value in row.items()), flush=True)
                rows.append(row)
    return rows


def photographs(folder: Path) -> None:
    """Print how positions of markers in photographs agree with the AprilTag library's."""
    from imgu_ros.frame import Frame
    from imgu_ros.vision.camera.intrinsics import make_camera
    from imgu_ros.vision.formation.layout import ColorModel, PixelLayout, RawImage

    find = others()["AprilTag 3.4.5"]
    # Intrinsics and width as the folder's test_info.yaml has them.
    known = {
        "multiple": np.array(
            [[338.563277422543, 0, 336.45495347495824], [0, 338.939280638548, 230.486982216255], [0, 0, 1]]
        ),
        "rotation": np.array([[329.8729619143081, 0, 528.0], [0, 332.94611303946357, 396.0], [0, 0, 1]]),
    }
    for name, intrinsics in known.items():
        total = both = own_only = other_only = 0
        apart = []
        for path in sorted((folder / name).glob("*.png")):
            grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            camera = make_camera(intrinsics, [], "plumb_bob", grey.shape[1], grey.shape[0])
            theirs = dict(find(grey))
            markers = [marker_image(f"m{n}", FAMILY, n, 0.065) for n in range(587)]
            parameters = Parameters()
            localizer = Localizer(parameters, make_references(markers, parameters))
            frame = Frame(RawImage(grey, PixelLayout(ColorModel.LUMA)), 1, "camera", camera)
            ours = {markers[r.number].number: r for r in localizer.process(frame) if r.status.found}
            total += len(theirs)
            both += len(ours.keys() & theirs.keys())
            own_only += len(ours.keys() - theirs.keys())
            other_only += len(theirs.keys() - ours.keys())
            apart += [float(np.abs(ours[n].outline - theirs[n]).max()) for n in ours.keys() & theirs.keys()]
        median, most = np.percentile(apart, (50, 100)) if apart else (math.nan, math.nan)
        print(
            f"{name}: AprilTag {total} markers, of which imgu_ros {both}, not {other_only}, others {own_only}; corners "
            f"apart by {median:.2f} px, at most {most:.2f} px"
        )


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=61)
    parser.add_argument("--views", type=int, default=40, help="of each width and light")
    parser.add_argument("--photographs", type=Path, help="folder of photographs with markers, instead")
    parser.add_argument("--json", type=Path, help="write the figures")
    arguments = parser.parse_args()
    if arguments.photographs:
        photographs(arguments.photographs)
        return
    rows = measured(arguments.seed, arguments.views)
    if arguments.json:
        document = {"seed": arguments.seed, "views": arguments.views, "K": CAMERA.K.tolist(), "rows": rows}
        arguments.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
