# SPDX-License-Identifier: Apache-2.0
"""A hand before a target of benchmarks/foreign_frames.py: capsules of textured skin, pushed in from one side."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from foreign_scenes import TARGET_WIDTH_M, RoomShape, placed

from imgu_ros.types import Floats

#: End, other end, radius.
Capsule = tuple[Floats, Floats, float]


def hand(rng: np.random.Generator, ratio: float, pose: tuple[Floats, Floats]) -> tuple[list[RoomShape], float]:
    """Return a hand that covers 20 to 50 % of a target as it is seen, and that share.

    Parameters
    ----------
    ratio : height of the target over its width
    pose : camera_from_world
    """
    goal = rng.uniform(0.22, 0.48)
    half = np.array([TARGET_WIDTH_M, TARGET_WIDTH_M * ratio]) / 2
    u, v = np.meshgrid(np.linspace(-1, 1, 19), np.linspace(-1, 1, 13))
    points = np.column_stack((u.ravel() * half[0], v.ravel() * half[1], np.zeros(u.size)))
    R, t = pose
    eye = -R.T @ t
    angle = rng.uniform(0, 2 * math.pi)
    inward = np.array([math.cos(angle), math.sin(angle), 0])
    best: tuple[float, list[Capsule], float] = (math.inf, [], 0.0)
    # Pushed in from the side until it covers as much as wanted.
    for reach in np.linspace(-0.1, 0.3, 21):
        capsules = _capsules(np.random.default_rng(int(angle * 1e6)), inward, half, reach)
        share = float(np.mean(_hidden(points, eye, capsules)))
        if abs(share - goal) < best[0]:
            best = (abs(share - goal), capsules, share)
    skin = _skin(rng)
    shapes = []
    for a, b, radius in best[1]:
        axis = b - a
        shapes += [RoomShape("sphere", placed(end, (2 * radius,) * 3), picture=skin) for end in (a, b)]
        side = np.cross(axis, (0, 0, 1.0))
        side = side / np.linalg.norm(side)
        M = np.eye(4)
        # Mitsuba's cylinder: radius 1 about z from 0 to 1.
        M[:3, :3] = np.column_stack((side * radius, np.cross(axis / np.linalg.norm(axis), side) * radius, axis))
        M[:3, 3] = a
        shapes.append(RoomShape("cylinder", M, picture=skin))
    return shapes, best[2]


def _capsules(rng: np.random.Generator, inward: Floats, half: Floats, reach: float) -> list[Capsule]:
    """Return palm, fingers and forearm: ends and radius of each; the fingers point against `inward`."""
    across = np.array([-inward[1], inward[0], 0])
    up = np.array([0, 0, -0.035])
    edge = np.abs(inward[:2]) @ half
    wrist = inward * (edge + 0.06 - reach) + across * rng.uniform(-0.03, 0.03) + up
    parts = [
        (wrist + across * s - inward * 0.01, wrist + across * s * 1.2 - inward * 0.08, 0.016)
        for s in (-0.03, -0.01, 0.01, 0.03)
    ]
    for s, length in ((-0.036, 0.06), (-0.012, 0.075), (0.012, 0.07), (0.036, 0.05)):
        knuckle = wrist - inward * 0.085 + across * s
        tip = knuckle - inward * length + across * (s * 0.5 + rng.normal(0, 0.006)) + np.array([0, 0, 0.02])
        parts.append((knuckle, tip, 0.0095))
    parts.append((wrist + across * 0.04, wrist - inward * 0.05 + across * 0.085 + np.array([0, 0, 0.01]), 0.011))
    parts.append((wrist, wrist + inward * 0.3 - np.array([0, 0, 0.05]), 0.03))
    return parts


def _hidden(points: Floats, eye: Floats, capsules: Sequence[Capsule]) -> Floats:
    """Return which points a capsule hides from the eye."""
    hidden = np.zeros(len(points), bool)
    ray = points - eye
    for a, b, radius in capsules:
        on_axis = a + np.linspace(0, 1, 9)[:, None] * (b - a)
        along = np.einsum("nk,mk->nm", ray, on_axis - eye) / np.sum(ray**2, axis=1)[:, None]
        nearest = eye + np.clip(along, 0, 1)[..., None] * ray[:, None]
        hidden |= (np.linalg.norm(nearest - on_axis, axis=2) < radius).any(axis=1)
    return hidden


def _skin(rng: np.random.Generator) -> Floats:
    tone = np.array([0.48, 0.28, 0.2]) * rng.uniform(0.5, 1.1)
    noise = sum(
        np.kron(rng.normal(0, 1, (128 // step, 128 // step)), np.ones((step, step))) * weight
        for step, weight in ((1, 0.06), (4, 0.08), (16, 0.08))
    )
    return np.clip(tone * (1 + np.asarray(noise))[..., None], 0.01, 0.9)
