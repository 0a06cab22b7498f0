# SPDX-License-Identifier: Apache-2.0
"""What a check found, as lines for people and as what JSON can hold."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from imgu_ros.check.accuracy import TILT_DEG, ExpectedError
from imgu_ros.check.finding import DEPENDABLE_SHARE
from imgu_ros.check.verdict import DEPENDABLE, TargetCheck
from imgu_ros.vision.camera.intrinsics import Camera

#: Version of the document's fields: it rises when one is renamed or goes.
SCHEMA = 1


def camera_words(camera: Camera) -> str:
    """Return a camera in words."""
    fx = float(camera.K[0, 0])
    view = 2 * math.degrees(math.atan(camera.width / 2 / fx))
    return f"{camera.width} x {camera.height} px, focal length {fx:.0f} px ({view:.0f} degrees wide)"


def described(check: TargetCheck) -> Iterator[str]:
    """Yield lines about a target."""
    verdict = "dependable" if check.is_dependable else "not dependable"
    yield f"{check.name}: score {check.score} of 100, {verdict} (from {DEPENDABLE} on)"
    for reason in check.reasons:
        yield f"  - {reason.text}"
        yield f"    {reason.advice}"
    if check.curve is None:
        return
    smallest = check.smallest_width_px
    if smallest is None:
        yield f"  gives one pose dependably at no width: in {check.curve.large_share:.0%} of large views"
        return
    far = farthest(check)
    away = "" if far is None else f"; so it is {length(far, check)} away"
    yield f"  found from {smallest:.0f} px wide on, seen straight on{away}"
    yield f"  expected error of one frame, tilted by {TILT_DEG:.0f} degrees:"
    for error in check.errors:
        yield f"    {_error_line(error, check)}"


def length(metres: float, check: TargetCheck) -> str:
    """Return a length, in the target's widths where its printed width is unknown."""
    if not check.width_m:
        return f"{metres:.3g} widths"
    return f"{metres:.3g} m" if metres >= 1 else f"{100 * metres:.3g} cm"


def small_length(metres: float, distance_m: float, check: TargetCheck) -> str:
    """Return an error of the position, as a share of the distance where the printed width is unknown."""
    if not check.width_m:
        return f"{100 * metres / distance_m:.2g} % of the distance"
    return f"{1e3 * metres:.2g} mm"


def farthest(check: TargetCheck) -> float | None:
    """Return the distance at which a target is seen with its smallest width; None: it is found at none."""
    if check.curve is None or not check.errors:
        return None
    smallest, any_one = check.curve.smallest_px(), check.errors[0]
    return None if smallest is None else any_one.distance_m * any_one.seen_px / smallest


def document(checks: Sequence[TargetCheck], camera: Camera, version: str) -> dict[str, Any]:
    """Return what JSON can hold; null for what is unknown. Lengths are m, in widths where `width_m` is null."""
    return {
        "schema": SCHEMA,
        "imgu_ros": version,
        "dependable_from": DEPENDABLE,
        "found_share": DEPENDABLE_SHARE,
        "tilt_deg": TILT_DEG,
        "camera": {"width": camera.width, "height": camera.height, "K": camera.K.tolist()},
        "targets": [_target(check) for check in checks],
    }


def _target(check: TargetCheck) -> dict[str, Any]:
    traits, curve = check.traits, check.curve
    return {
        "name": check.name,
        "entry": check.entry,
        "score": check.score,
        "dependable": check.is_dependable,
        "width_m": check.width_m or None,
        "reasons": [{"kind": r.kind.value, "text": r.text, "advice": r.advice} for r in check.reasons],
        "looks_like": list(check.alike),
        "smallest_width_px": check.smallest_width_px,
        "farthest": farthest(check),
        "found": None
        if curve is None
        else {
            "large_views_share": curve.large_share,
            "views": [
                {"width_px": t.seen_px * check.width_of_longer, "tilt_deg": t.tilt_deg, "found": t.found}
                for t in curve.trials
            ],
        },
        "errors": [
            {
                "width_px": e.seen_px * check.width_of_longer,
                "distance": e.distance_m,
                "position": e.position_m,
                "rotation_deg": e.rotation_deg,
                "ambiguous_share": e.ambiguous_share,
            }
            for e in check.errors
        ],
        "picture": None
        if traits is None
        else {
            "width_px": traits.width_px,
            "height_px": traits.height_px,
            "corners": traits.corners,
            "contrast": traits.contrast,
            "flat_share": traits.flat_share,
            "lost_share": traits.lost_share,
            "turns_deg": list(traits.turns_deg),
            "repeats": traits.repeats,
        },
    }


def _error_line(error: ExpectedError, check: TargetCheck) -> str:
    where = f"{length(error.distance_m, check)} away ({error.seen_px * check.width_of_longer:.0f} px wide)"
    if error.position_m is None or error.rotation_deg is None:
        return f"{where}: no pose"
    position = small_length(error.position_m, error.distance_m, check)
    return f"{where}: {position}, {error.rotation_deg:.2g} degrees"
