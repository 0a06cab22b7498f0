# SPDX-License-Identifier: Apache-2.0
"""Whether the calibration that frames come with fits what they show, accumulated over frames."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from imgu_ros.errors import ImguError
from imgu_ros.result import CalibrationFinding, ReferenceResult
from imgu_ros.types import Floats, Points
from imgu_ros.vision.camera.calibration_evidence import CalibrationEvidence, weigh_calibration
from imgu_ros.vision.camera.calibration_test import CalibrationTest
from imgu_ros.vision.camera.camera_covariance import factor_of
from imgu_ros.vision.camera.intrinsics import Camera

#: Number of views that are weighed together, the newest. Measured: benchmarks/thresholds.py, study calibration.
_VIEWS = 48
#: A view is new when a corner has moved by this share of the target's size: a camera at rest repeats its errors.
#: Measured: benchmarks/thresholds.py, study calibration.
_MOVED = 0.03
#: Views are weighed again when this share of them is new. Measured: benchmarks/thresholds.py, study calibration.
_NEW_SHARE = 0.25
#: With so many views, only one in so many frames is examined: the estimate changes slowly by then.
_MANY, _PAUSE = 16, 5
#: A difference counts from this many standard deviations, times 1 + _FOR_FEW / views. `benchmarks/calibration_misfit.py
#: --part noise` gives the margin of correct calibrations. Measured: benchmarks/thresholds.py, study calibration.
_SIGMAS, _FOR_FEW = 5.0, 2.0
#: Smallest difference that counts, as a share of the focal length. Measured: benchmarks/thresholds.py, study
#: calibration.
_LEAST = 0.005
#: Accuracy of prints and lens models, as a share of the focal length. Measured: benchmarks/thresholds.py, study
#: calibration.
_FLOOR = 0.001
#: Share of the squared misfit that the focal length must explain to be named, and to stay named. Measured:
#: benchmarks/thresholds.py, study calibration.
_MOST, _MOST_HELD = 0.9, 0.75
#: Fewest views from which the cause is named; with fewer, standard deviations from which it is. Measured:
#: benchmarks/thresholds.py, study calibration.
_TELLING_VIEWS, _BEYOND_DOUBT = 4, 25.0
#: Squared residuals, in units of those expected, that no calibration explains, and fewest views for that. Measured:
#: benchmarks/thresholds.py, study calibration.
_SCATTERED, _SCATTERED_VIEWS = 8.0, 8
#: A warning is withdrawn below this share of the thresholds. Measured: benchmarks/thresholds.py, study calibration.
_HELD = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """A view of a target: its outline (4, 2), the target's size in it, px, and what it says of the calibration."""

    name: str
    outline: Points
    size_px: float
    test: CalibrationTest


class CalibrationCheck:
    """Accumulates what frames say about the calibration of the camera that took them.

    It forgets when the camera's numbers change.
    """

    def __init__(self) -> None:
        self._camera: Camera | None = None
        self._views: deque[_View] = deque(maxlen=_VIEWS)
        self._outlines: dict[str, tuple[Floats, Floats]] = {}
        self._new = self._since = 0
        self._evidence: CalibrationEvidence | None = None
        self._extra: Floats | None = None
        self._finding: CalibrationFinding | None = None

    @property
    def finding(self) -> CalibrationFinding | None:
        """What the frames so far say; None before the first pose."""
        return self._finding

    def reset(self) -> None:
        """Forget all views."""
        self._camera = None
        self._forget()

    def wants(self, camera: Camera, name: str, outline: Points) -> bool:
        """Return whether a target's place says something of the calibration, or the calibration of its pose.

        Parameters
        ----------
        camera : that took the frame
        name, outline : of the reference, and where its corners are seen, (4, 2) raw px
        """
        return self._extra is not None or not self._knows(camera) or (self._is_due() and self._is_new(name, outline))

    def examined(self, camera: Camera | None, found: Mapping[str, ReferenceResult]) -> dict[str, ReferenceResult]:
        """Take what one frame says, and return its results with what is known now in the covariances of their poses.

        Parameters
        ----------
        camera : that took the frame; None: not calibrated
        found : results of the frame, by name
        """
        if camera is None:
            return dict(found)
        if not self._knows(camera):
            self._forget()
        self._camera = camera
        if all(target.pose is None for target in found.values()):
            return dict(found)
        before, due = self._new, self._is_due()
        for target in found.values():
            if due and target.calibration is not None and target.outline is not None and target.is_sharp:
                self._add(target.name, target.outline, target.calibration)
        self._since = 0 if self._new > before else self._since + 1
        if self._new > before and self._new >= _NEW_SHARE * len(self._views):
            self._weigh(camera)
        return {name: self._with_misfit(result) for name, result in found.items()}

    def _knows(self, camera: Camera) -> bool:
        return self._camera is camera or (self._camera is not None and _same(self._camera, camera))

    def _forget(self) -> None:
        self._views.clear()
        self._outlines.clear()
        self._new = self._since = 0
        self._evidence = self._extra = self._finding = None

    def _is_due(self) -> bool:
        return len(self._views) < _MANY or self._since >= _PAUSE

    def _is_new(self, name: str, outline: Points) -> bool:
        """Whether a target is seen as in none of the views."""
        if name not in self._outlines:
            seen = [view for view in self._views if view.name == name]
            outlines = np.array([view.outline for view in seen]).reshape(-1, 4, 2)
            self._outlines[name] = outlines, np.array([_MOVED * view.size_px for view in seen])
        outlines, moved = self._outlines[name]
        return bool((np.abs(outlines - outline).reshape(-1, 8).max(axis=1, initial=0) > moved).all())

    def _add(self, name: str, outline: Points, test: CalibrationTest) -> None:
        if self._is_new(name, outline):
            x, y = outline.T
            area = abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2
            self._views.append(_View(name, outline, math.sqrt(area), test))
            # The oldest view, which has left, may be another target's.
            self._outlines.clear()
            self._new += 1

    def _weigh(self, camera: Camera) -> None:
        added, self._new = self._new, 0
        try:
            evidence = weigh_calibration([view.test for view in self._views], camera)
        except (ImguError, np.linalg.LinAlgError):
            # What cannot be weighed must cost neither the frame nor the views of before.
            for _ in range(min(added, len(self._views))):
                self._views.pop()
            self._outlines.clear()
            return
        self._extra = None if evidence.covariance is None else factor_of(evidence.covariance)
        self._finding = finding_of(evidence, self._finding)

    def _with_misfit(self, target: ReferenceResult) -> ReferenceResult:
        if self._extra is None or target.pose is None:
            return target
        # Poses of one frame are fused by the errors that they share: all have as many.
        factor = np.zeros((6, self._extra.shape[1]))
        if target.calibration is not None:
            factor = target.calibration.pose_by_camera @ self._extra
        pose = target.pose.with_shared_error(factor)
        return replace(target, pose=pose, solutions=(pose, *target.solutions[1:]))


def finding_of(evidence: CalibrationEvidence, before: CalibrationFinding | None = None) -> CalibrationFinding:
    """Return what evidence amounts to, after what was found before: what was said once is not said in other words."""
    e, held = evidence, 1.0 if before is None or not before.warning else _HELD
    needed = held * _SIGMAS * (1 + _FOR_FEW / e.views)
    least = held * _LEAST
    focal_sigma = math.hypot(e.focal_sigma, _FLOOR)
    too_long = 1 / (1 + max(e.focal, -0.9)) - 1
    # One view does not tell a focal length from a principal point: what explains it is said when several do.
    enough = e.views >= _TELLING_VIEWS or e.sigmas > _BEYOND_DOUBT
    most = _MOST if before is None or not before.is_focal else _MOST_HELD
    is_focal = enough and abs(e.focal) > max(needed * focal_sigma, least) and e.focal_share > most
    is_other = (enough and e.sigmas > needed and e.largest > max(least, needed * _FLOOR)) or (
        e.scatter > held * _SCATTERED and e.views >= _SCATTERED_VIEWS
    )
    warning = ""
    if is_focal:
        if before is not None and before.is_focal and before.warning:
            warning = before.warning
        else:
            warning = (
                f"camera_info does not fit what is seen (focal length about {100 * abs(too_long):.2g} % too "
                f"{'long' if too_long > 0 else 'short'}?): calibrate the camera as it is now, focus, zoom and "
                "resolution (imgu calibrate)"
            )
    elif is_other:
        warning = (
            "camera_info does not fit what is seen (and not by the focal length alone): calibrate the camera as it is "
            "now (imgu calibrate); a rolling shutter, motion blur or a target that is not flat looks like this too"
        )
    return CalibrationFinding(e.views, e.chi_squared, 100 * too_long, 100 * focal_sigma, is_focal, warning)


def _same(a: Camera, b: Camera) -> bool:
    return (
        a.model is b.model
        and (a.width, a.height) == (b.width, b.height)
        and np.array_equal(a.K, b.K)
        and np.array_equal(a.distortion, b.distortion)
        and (a.covariance is None) == (b.covariance is None)
        and (a.covariance is None or b.covariance is None or np.array_equal(a.covariance, b.covariance))
    )
