"""Versions of the package and of what it stands on."""

from __future__ import annotations

import platform
from importlib import metadata

#: Name in the summary -> distributions that provide it, the first installed one counts.
_LIBRARIES = {
    "numpy": ("numpy",),
    "scipy": ("scipy",),
    "opencv": (
        "opencv-python-headless",
        "opencv-python",
        "opencv-contrib-python-headless",
        "opencv-contrib-python",
        "opencv",
    ),
    "rosbags": ("rosbags",),
}


def package_version() -> str:
    """Return the installed version of imgu_ros, or `not installed` when it runs from a source tree."""
    return _version(("imgu_ros", "imgu-ros")) or "not installed"


def versions() -> dict[str, str]:
    """Return the versions of imgu_ros, Python, and the libraries that its numbers depend on."""
    found = {"imgu_ros": package_version(), "python": platform.python_version()}
    for name, distributions in _LIBRARIES.items():
        found[name] = _version(distributions) or "unknown"
    return found


def _version(distributions: tuple[str, ...]) -> str | None:
    for distribution in distributions:
        try:
            return metadata.version(distribution)
        except metadata.PackageNotFoundError:
            continue
    return None
