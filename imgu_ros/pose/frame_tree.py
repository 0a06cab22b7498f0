# SPDX-License-Identifier: Apache-2.0
"""Coordinate frames: which hangs from which, and where it was when."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from imgu_ros.errors import FrameError
from imgu_ros.vision.camera.rigid import RigidTransform
from imgu_ros.vision.camera.rotation import exp_so3, log_so3

#: How far back moving frames are remembered, as tf2 does.
_MEMORY_NS = 10_000_000_000
#: Stamps that go back by more begin anew: a bag that starts over.
_JUMP_NS = 1_000_000_000
#: Most transforms kept of one frame: 10 s at 400 Hz.
_MOST_SAMPLES = 4096
#: Deeper trees than any robot's; a circle ends there.
_MOST_LEVELS = 256


@dataclass(frozen=True, slots=True, eq=False)
class StampedTransform:
    """`parent_from_child` at a time, and the names of the two frames: what /tf carries."""

    stamp_ns: int
    parent: str
    child: str
    parent_from_child: RigidTransform


class FrameTree:
    """The frames of a robot, as /tf and /tf_static tell of them; moving ones for the last ten seconds."""

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}

    def add(self, transform: StampedTransform, *, fixed: bool = False) -> None:
        """Take note of where a frame is.

        A frame has one parent: the last that was told. Of a moving frame whose stamps go back by more than a second
        nothing older is kept.

        Parameters
        ----------
        fixed : the frame never moves against its parent: the stamp does not matter
        """
        edge = self._edges.get(transform.child)
        if edge is None or edge.parent != transform.parent or edge.fixed or fixed:
            edge = self._edges[transform.child] = _Edge(transform.parent, fixed)
        edge.add(transform.stamp_ns, transform.parent_from_child)

    def parent(self, frame: str) -> str:
        """Return the frame's parent; empty when it has none."""
        edge = self._edges.get(frame)
        return "" if edge is None else edge.parent

    def root(self, frame: str) -> str:
        """Return the frame at the top of the tree in which `frame` is: itself when it has no parent."""
        *_, top = (frame, *(edge.parent for edge in self._upwards(frame)))
        return top

    def forget_moving(self) -> None:
        """Forget all but the fixed frames."""
        self._edges = {child: edge for child, edge in self._edges.items() if edge.fixed}

    def lookup(self, ancestor: str, frame: str, stamp_ns: int) -> RigidTransform:
        """Return `ancestor_from_frame` at a time, moving frames interpolated between the two nearest stamps.

        Raises
        ------
        FrameError
            If `frame` does not hang from `ancestor`, or a frame between them is not known at that time (yet).
        """
        found = RigidTransform(np.eye(3), np.zeros(3))
        at = frame
        for edge in self._upwards(frame):
            if at == ancestor:
                break
            found = edge.at(stamp_ns, at).after(found)
            at = edge.parent
        if at != ancestor:
            known = f"hangs from {at!r}" if at != frame else "has no parent"
            raise FrameError(f"{frame}: {known}; need it to hang from {ancestor!r}")
        return found

    def _upwards(self, frame: str) -> Iterator[_Edge]:
        for _ in range(_MOST_LEVELS):
            edge = self._edges.get(frame)
            if edge is None:
                return
            yield edge
            frame = edge.parent


class _Edge:
    """Where a frame was under its parent, by stamps in ascending order; a fixed one has one sample."""

    def __init__(self, parent: str, fixed: bool) -> None:
        self.parent = parent
        self.fixed = fixed
        self._stamps: list[int] = []
        self._samples: list[RigidTransform] = []

    def add(self, stamp_ns: int, sample: RigidTransform) -> None:
        stamps = self._stamps
        if self.fixed or (stamps and stamp_ns < stamps[-1] - _JUMP_NS):
            stamps.clear()
            self._samples.clear()
        place = bisect_left(stamps, stamp_ns)
        if place < len(stamps) and stamps[place] == stamp_ns:
            self._samples[place] = sample
            return
        stamps.insert(place, stamp_ns)
        self._samples.insert(place, sample)
        old = max(bisect_left(stamps, stamps[-1] - _MEMORY_NS), len(stamps) - _MOST_SAMPLES)
        if old > 0:
            del stamps[:old], self._samples[:old]

    def at(self, stamp_ns: int, frame: str) -> RigidTransform:
        if self.fixed:
            return self._samples[0]
        stamps = self._stamps
        place = bisect_left(stamps, stamp_ns)
        if place < len(stamps) and stamps[place] == stamp_ns:
            return self._samples[place]
        if not 0 < place < len(stamps):
            late, last = place > 0, stamps[-1 if place else 0]
            raise FrameError(
                f"{self.parent} -> {frame}: known {'until' if late else 'from'} {abs(stamp_ns - last) / 1e9:.3f} s "
                f"{'before the image' if late else 'after the image on'}; need it at the image's stamp"
            )
        return _between(self._samples[place - 1], self._samples[place], _share(stamps, place, stamp_ns))


def _share(stamps: list[int], place: int, stamp_ns: int) -> float:
    return (stamp_ns - stamps[place - 1]) / (stamps[place] - stamps[place - 1])


def _between(first: RigidTransform, second: RigidTransform, share: float) -> RigidTransform:
    """Return the transform a share of the way, turning at constant speed."""
    turn = log_so3(second.R @ first.R.T)
    return RigidTransform(exp_so3(share * turn) @ first.R, first.t + share * (second.t - first.t))
