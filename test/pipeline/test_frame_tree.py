# SPDX-License-Identifier: Apache-2.0
"""The robot's frames: lookups against products of matrices, interpolation against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from imgu_ros.errors import FrameError
from imgu_ros.pose.frame_tree import FrameTree, StampedTransform
from imgu_ros.vision.camera.rigid import RigidTransform

SECOND = 1_000_000_000


def transform(seed: int) -> RigidTransform:
    return RigidTransform(Rotation.random(random_state=seed).as_matrix(), np.random.default_rng(seed).normal(size=3))


def tree_of(*edges: tuple[str, str, int]) -> FrameTree:
    tree = FrameTree()
    for parent, child, seed in edges:
        tree.add(StampedTransform(0, parent, child, transform(seed)), fixed=True)
    return tree


def test_a_chain_of_fixed_frames() -> None:
    tree = tree_of(("odom", "base", 1), ("base", "mast", 2), ("mast", "camera", 3), ("base", "wheel", 4))
    expected = transform(1).matrix @ transform(2).matrix @ transform(3).matrix
    np.testing.assert_allclose(tree.lookup("odom", "camera", 5).matrix, expected, atol=1e-12)
    np.testing.assert_allclose(tree.lookup("mast", "camera", 5).matrix, transform(3).matrix)
    np.testing.assert_array_equal(tree.lookup("camera", "camera", 5).matrix, np.eye(4))
    assert (tree.root("camera"), tree.root("odom"), tree.root("elsewhere")) == ("odom", "odom", "elsewhere")
    assert (tree.parent("camera"), tree.parent("odom")) == ("mast", "")


def test_what_does_not_hang_together_is_told() -> None:
    tree = tree_of(("base", "camera", 1))
    with pytest.raises(FrameError, match="camera: hangs from 'base'; need it to hang from 'odom'"):
        tree.lookup("odom", "camera", 0)
    with pytest.raises(FrameError, match="eye: has no parent; need it to hang from 'odom'"):
        tree.lookup("odom", "eye", 0)


def test_moving_frames_are_interpolated_and_never_guessed() -> None:
    tree = FrameTree()
    for n in (2, 0, 1):  # not in order
        tree.add(StampedTransform(n * SECOND // 10, "odom", "base", transform(n)))
    tree.add(StampedTransform(0, "base", "camera", transform(7)), fixed=True)
    for share in (0.0, 0.25, 0.9, 1.0):
        turn = Slerp([0, 1], Rotation.from_matrix([transform(1).R, transform(2).R]))(share).as_matrix()
        expected = np.eye(4)
        expected[:3, :3], expected[:3, 3] = turn, (1 - share) * transform(1).t + share * transform(2).t
        found = tree.lookup("odom", "camera", round((1 + share) * SECOND / 10))
        np.testing.assert_allclose(found.matrix, expected @ transform(7).matrix, atol=1e-7)
    with pytest.raises(FrameError, match=r"odom -> base: known until 0.050 s before the image"):
        tree.lookup("odom", "camera", SECOND // 4)
    with pytest.raises(FrameError, match=r"odom -> base: known from 0.100 s after the image"):
        tree.lookup("odom", "camera", -SECOND // 10)


def test_ten_seconds_are_remembered_and_a_jump_begins_anew() -> None:
    tree = FrameTree()
    for n in range(200):
        tree.add(StampedTransform(n * SECOND // 10, "odom", "base", transform(0)))
    tree.lookup("odom", "base", 10 * SECOND)
    with pytest.raises(FrameError):
        tree.lookup("odom", "base", 9 * SECOND)
    tree.add(StampedTransform(SECOND, "odom", "base", transform(5)))
    np.testing.assert_array_equal(tree.lookup("odom", "base", SECOND).R, transform(5).R)
    with pytest.raises(FrameError):
        tree.lookup("odom", "base", 15 * SECOND)


def test_a_new_parent_takes_the_place_of_the_old() -> None:
    tree = tree_of(("a", "x", 1))
    tree.add(StampedTransform(0, "b", "x", transform(2)))
    assert tree.parent("x") == "b"
    with pytest.raises(FrameError):
        tree.lookup("a", "x", 0)
    tree.add(StampedTransform(0, "x", "y", transform(2)), fixed=True)
    tree.forget_moving()
    assert (tree.parent("x"), tree.parent("y")) == ("", "x")


def test_a_circle_ends() -> None:
    tree = tree_of(("b", "a", 1), ("a", "b", 2))
    with pytest.raises(FrameError):
        tree.lookup("map", "a", 0)
    assert tree.root("a") in ("a", "b")
