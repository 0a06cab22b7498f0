# SPDX-License-Identifier: Apache-2.0
"""Who is compared with whom: the chain, tracking and detecting, and the recipes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from imgu_ros.bench.methods import ChainMethod, Method
from imgu_ros.bench.recipes import Features, Recipe
from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import ParameterError
from imgu_ros.reference.templates import TargetImage

TRACKING, DETECTION, ORB, SIFT = "tracking", "detection", "ORB", "SIFT"
#: What tables and plots call them.
TITLES = {TRACKING: "ours, tracking", DETECTION: "ours, detecting", ORB: "ORB recipe", SIFT: "SIFT recipe"}

#: Every method: its name, and how it is made of parameters (the chain's) and targets.
METHODS: dict[str, Callable[[Parameters, Sequence[TargetImage]], Method]] = {
    TRACKING: lambda p, t: ChainMethod(TRACKING, parameters_from({"tracking.enabled": True}, p), t),
    DETECTION: lambda p, t: ChainMethod(DETECTION, parameters_from({"tracking.enabled": False}, p), t),
    ORB: lambda p, t: Recipe(Features.ORB, t),
    SIFT: lambda p, t: Recipe(Features.SIFT, t),
}


def make_method(name: str, targets: Sequence[TargetImage], parameters: Parameters | None = None) -> Method:
    """Return a method, ready for frames.

    Parameters
    ----------
    name : tracking, detection, ORB or SIFT
    targets : the known ones
    parameters : the chain's; None: the defaults

    Raises
    ------
    ParameterError
        If there is no such method.
    """
    check_method(name)
    return METHODS[name](parameters or Parameters(), targets)


def check_method(name: str) -> None:
    """Raise ParameterError when there is no method of that name."""
    if name not in METHODS:
        raise ParameterError(f"method: {name!r}; need one of {', '.join(METHODS)}")
