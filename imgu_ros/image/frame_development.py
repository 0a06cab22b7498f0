# SPDX-License-Identifier: Apache-2.0
"""The development of a frame, which may run ahead of the rest of the chain, in another thread."""

from __future__ import annotations

import time
from dataclasses import dataclass

from imgu_ros.config.components import DevelopmentParameters
from imgu_ros.errors import ImguError
from imgu_ros.frame import Frame
from imgu_ros.image.development import Developed, develop


@dataclass(frozen=True, slots=True, eq=False)
class Development:
    """What became of a frame's pixels.

    Attributes
    ----------
    developed : the pictures; None when the frame cannot be developed
    reason : why it cannot; empty when it was
    took_ns : time that it took
    """

    developed: Developed | None
    reason: str
    took_ns: int


def develop_frame(frame: Frame, parameters: DevelopmentParameters) -> Development:
    """Develop a frame; what is wrong with it is said in the result. It depends on no other frame."""
    start = time.perf_counter_ns()
    try:
        developed = develop(frame.image, parameters.raw, parameters.demosaic)
    except ImguError as error:
        return Development(None, str(error), time.perf_counter_ns() - start)
    return Development(developed, "", time.perf_counter_ns() - start)
