# SPDX-License-Identifier: Apache-2.0
"""Where markers are on a rigid thing, from poses of single markers in many frames.

The unknowns are the place of each marker on the thing, but for one that is its origin, and the thing's pose in each
frame. What is minimised is the sum of the squared residuals of all poses in units of their covariances (a pose graph of
two layers). Poses that contradict the others, as the other one of the two that a plane allows, are left out.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import lil_matrix
from scipy.spatial.transform import Rotation

from imgu_ros.errors import NotConverged, TooFewPoints
from imgu_ros.types import Floats, Indices
from imgu_ros.vision.camera.pose import Pose
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.rotation import log_so3

#: Fewest frames that show a marker together with others; fewer leave nothing to check by.
FEWEST_FRAMES = 3
#: Most frames; more change the result little, and cost memory by their square.
_MOST_FRAMES = 300
#: Relative poses among which the one nearest to the others is a start.
_COMPARED = 50
#: Residuals beyond so many standard deviations count less at first; poses whose squares are larger than the second are
#: left out: chi-squared of six degrees of freedom exceeds it once in a hundred thousand.
_SOFT, _OUTLIER = 3.0, 33.0
#: Median of chi-squared of six degrees of freedom.
_MEDIAN = 5.35
#: How often poses are left out and taken in again.
_ROUNDS = 3
#: How many metres a radian counts for where two poses are compared.
_RADIAN_M = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredMarker:
    """The place of a marker.

    Attributes
    ----------
    place : `thing_from_marker` with its covariance, (x y z rx ry rz) in the thing's axes; that of the origin is exact
    frames : in which it was seen together with others, and used
    left_out : poses that contradict the others
    together : number of frames in which it was seen with each other marker
    rms : of its residuals, in standard deviations: 1 where covariances are right
    """

    place: Pose
    frames: int
    left_out: int
    together: Mapping[str, int]
    rms: float


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredBundle:
    """Places of markers on a thing.

    Attributes
    ----------
    markers : by name; the origin is the first
    frames : that were used
    scale : by which the covariances were multiplied, since residuals are larger than these say; at least 1
    """

    markers: dict[str, MeasuredMarker]
    frames: int
    scale: float


def measure_bundle(frames: Sequence[Mapping[str, Pose]], names: Sequence[str]) -> MeasuredBundle:
    """Return the places of markers relative to the first.

    Parameters
    ----------
    frames : of each the poses `camera_from_marker`, by name
    names : of the markers, the origin first; at least two

    Raises
    ------
    TooFewPoints
        If a marker is not connected with the origin by frames that show two markers, or by too few.
    NotConverged
        If the adjustment does not settle.
    """
    used = [{name: each[name] for name in names if name in each} for each in frames]
    used = [each for each in used if len(each) > 1]
    together = Counter(pair for each in used for pair in combinations(each, 2))
    starts = _connected(used, names, together)
    if len(used) > _MOST_FRAMES:
        used = [used[i] for i in np.unique(np.linspace(0, len(used) - 1, _MOST_FRAMES).round().astype(int))]
    adjustment = _Adjustment(used, names, starts)
    adjustment.adjust()
    return adjustment.result(together)


def _connected(
    frames: Sequence[Mapping[str, Pose]], names: Sequence[str], together: Mapping[tuple[str, str], int]
) -> dict[str, RigidTransform]:
    """Return a place of each marker as a start, from marker to marker that are seen together."""
    origin, *_ = names
    places = {origin: RigidTransform(np.eye(3), np.zeros(3))}
    waiting = deque([origin])
    while waiting:
        known = waiting.popleft()
        for name in names:
            count = together.get((known, name), 0) + together.get((name, known), 0)
            if name not in places and count >= FEWEST_FRAMES:
                places[name] = places[known].after(_typical(known, name, frames))
                waiting.append(name)
    missing = [name for name in names if name not in places]
    if missing:
        seen = Counter(name for each in frames for name in each)
        raise TooFewPoints(
            f"{', '.join(missing)}: not connected with {origin}: "
            + "; ".join(f"{name} is in {seen[name]} of {len(frames)} frames that show two markers" for name in missing)
            + f"; need {FEWEST_FRAMES} frames that show it beside a marker that is connected"
        )
    return places


def _typical(known: str, name: str, frames: Sequence[Mapping[str, Pose]]) -> RigidTransform:
    """Return the relative pose that is nearest to the others: `known_from_name`."""
    relative = [
        each[known].transform.inverse().after(each[name].transform) for each in frames if known in each and name in each
    ]
    relative = relative[:: -(-len(relative) // _COMPARED)]
    away = np.array([[_apart(a, b) for b in relative] for a in relative])
    return relative[int(np.argmin(np.median(away, axis=1)))]


def _apart(a: RigidTransform, b: RigidTransform) -> float:
    return float(np.linalg.norm(a.t - b.t)) + _RADIAN_M * float(np.linalg.norm(log_so3(a.R @ b.R.T)))


class _Adjustment:
    """The places and the poses of the thing, as steps from a start: of each (x y z rx ry rz), R = Exp(r) R_start."""

    def __init__(
        self, frames: Sequence[Mapping[str, Pose]], names: Sequence[str], starts: Mapping[str, RigidTransform]
    ) -> None:
        self._names = list(names)
        seen = [(f, self._names.index(name), pose) for f, each in enumerate(frames) for name, pose in each.items()]
        self._frame: Indices = np.array([f for f, _, _ in seen])
        self._marker: Indices = np.array([m for _, m, _ in seen])
        self._R = np.stack([pose.R for _, _, pose in seen])
        self._t = np.stack([pose.t for _, _, pose in seen])
        # What all poses share does not become smaller by their number: it is put back at the end.
        shared = [np.zeros((6, 0)) if pose.shared is None else pose.shared for _, _, pose in seen]
        self._white = np.stack([
            np.linalg.inv(np.linalg.cholesky(pose.covariance - part @ part.T))
            for (_, _, pose), part in zip(seen, shared, strict=True)
        ])  # fmt: skip
        self._shared = np.stack(shared)
        self._places = [starts[name] for name in self._names]
        self._poses = [self._first_pose(f, seen) for f in range(len(frames))]
        self._kept = np.ones(len(seen), bool)

    def _first_pose(self, frame: int, seen: Sequence[tuple[int, int, Pose]]) -> RigidTransform:
        """Return the thing's pose by the marker whose pose agrees best with those of the others in a frame."""
        by_marker = [pose.transform.after(self._places[m].inverse()) for f, m, pose in seen if f == frame]
        away = [sum(_apart(a, b) for b in by_marker) for a in by_marker]
        sigma = [float(np.trace(pose.covariance[:3, :3])) for f, _, pose in seen if f == frame]
        return by_marker[min(range(len(by_marker)), key=lambda i: (round(away[i], 3), sigma[i]))]

    def _residuals(self, x: Floats) -> Floats:
        """Return the whitened residuals of all poses, (6 N,)."""
        steps = x.reshape(-1, 6)
        count = len(self._names) - 1
        place_R, place_t = self._moved(self._places, np.vstack((np.zeros((1, 6)), steps[:count])))
        pose_R, pose_t = self._moved(self._poses, steps[count:])
        R = pose_R[self._frame] @ place_R[self._marker]
        t = (pose_R[self._frame] @ place_t[self._marker][:, :, None])[:, :, 0] + pose_t[self._frame]
        turn = Rotation.from_matrix(self._R @ R.transpose(0, 2, 1)).as_rotvec()
        residuals = (self._white @ np.hstack((self._t - t, turn))[:, :, None])[:, :, 0]
        return np.asarray((residuals * self._kept[:, None]).ravel(), np.float64)

    @staticmethod
    def _moved(at: Sequence[RigidTransform], steps: Floats) -> tuple[Floats, Floats]:
        R = Rotation.from_rotvec(steps[:, 3:]).as_matrix() @ np.stack([each.R for each in at])
        return R, np.stack([each.t for each in at]) + steps[:, :3]

    def adjust(self) -> None:
        """Find the minimum; poses that contradict the others are left out."""
        for index in range(_ROUNDS):
            solution = least_squares(
                self._residuals,
                np.zeros(6 * (len(self._names) - 1 + len(self._poses))),
                jac_sparsity=self._pattern(),
                x_scale="jac",
                loss="soft_l1" if index == 0 else "linear",
                f_scale=_SOFT,
            )
            if not solution.success:
                raise NotConverged("measurement: the adjustment does not settle; need more frames, and sharp ones")
            steps = solution.x.reshape(-1, 6)
            count = len(self._names) - 1
            for many, own in (
                (self._places, np.vstack((np.zeros((1, 6)), steps[:count]))),
                (self._poses, steps[count:]),
            ):
                R, t = self._moved(many, own)
                many[:] = [RigidTransform(a, b) for a, b in zip(R, t, strict=True)]
            self._jacobian = solution.jac
            used, self._kept = self._kept, np.ones_like(self._kept)
            self._squared = (self._residuals(np.zeros_like(solution.x)).reshape(-1, 6) ** 2).sum(axis=1)
            expected = max(1.0, float(np.median(self._squared[used])) / _MEDIAN)
            self._kept = self._squared < _OUTLIER * expected if index < _ROUNDS - 1 else used

    def _pattern(self) -> lil_matrix:
        """Return which residuals depend on which steps."""
        count = len(self._names) - 1
        pattern = lil_matrix((6 * len(self._frame), 6 * (count + len(self._poses))), dtype=np.int8)
        for row, (frame, marker) in enumerate(zip(self._frame, self._marker, strict=True)):
            rows = slice(6 * row, 6 * row + 6)
            if marker > 0:
                pattern[rows, 6 * (marker - 1) : 6 * marker] = 1
            pattern[rows, 6 * (count + frame) : 6 * (count + frame) + 6] = 1
        return pattern

    def result(self, together: Mapping[tuple[str, str], int]) -> MeasuredBundle:
        """Return the places with their covariances."""
        J = self._jacobian.toarray() if hasattr(self._jacobian, "toarray") else np.asarray(self._jacobian)
        normal = J.T @ J
        # A frame all of whose poses were left out says nothing.
        idle = np.flatnonzero(normal.diagonal() <= 0)
        normal[idle, idle] = 1.0
        inverse = np.linalg.inv(normal)
        kept = self._kept
        freedom = max(6 * int(np.count_nonzero(kept)) - len(normal) + len(idle), 1)
        scale = max(1.0, float(self._squared[kept].sum()) / freedom)
        covariance = inverse * scale
        if self._shared.shape[2]:
            moved = (self._white @ self._shared * kept[:, None, None]).reshape(len(J), -1)
            passed = inverse @ (J.T @ moved)
            covariance = covariance + passed @ passed.T
        markers = {}
        for index, name in enumerate(self._names):
            own = slice(6 * (index - 1), 6 * index)
            of_place = covariance[own, own] if index else np.zeros((6, 6))
            mine = self._marker == index
            rms = float(np.sqrt(self._squared[mine & kept].mean() / 6)) if (mine & kept).any() else 0.0
            place = self._places[index]
            beside = {
                other: together.get((name, other), 0) + together.get((other, name), 0)
                for other in self._names
                if other != name
            }
            markers[name] = MeasuredMarker(
                Pose(place.R, place.t, (of_place + of_place.T) / 2, 0.0),
                int(np.count_nonzero(mine & kept)),
                int(np.count_nonzero(mine & ~kept)),
                {other: count for other, count in beside.items() if count},
                rms,
            )
        return MeasuredBundle(markers, len(self._poses), scale)
