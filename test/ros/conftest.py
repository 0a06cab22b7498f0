"""Importing the ROS wheels warns of things that they do to themselves, once in a process."""

from __future__ import annotations

import contextlib
import warnings

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    with contextlib.suppress(ImportError):  # the tests say that they skip
        import rosidl_generator_py  # noqa: F401
