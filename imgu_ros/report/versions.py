# SPDX-License-Identifier: Apache-2.0
"""Versions of the package and of what it stands on."""

from __future__ import annotations

import platform
from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree

#: Beside the package in a source tree; elsewhere the installation knows the version.
_MANIFEST = Path(__file__).resolve().parents[2] / "package.xml"
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
    """Return the version of imgu_ros: of the source tree that it runs from, or as installed."""
    return _manifest_version() or _version(("imgu_ros", "imgu-ros")) or "unknown"


def versions() -> dict[str, str]:
    """Return the versions of imgu_ros, Python, and the libraries that its numbers depend on."""
    found = {"imgu_ros": package_version(), "python": platform.python_version()}
    for name, distributions in _LIBRARIES.items():
        found[name] = _version(distributions) or "unknown"
    return found


def _manifest_version() -> str | None:
    try:
        manifest = ElementTree.parse(_MANIFEST).getroot()
    except (OSError, ElementTree.ParseError):
        return None
    return manifest.findtext("version") if manifest.findtext("name") == "imgu_ros" else None


def _version(distributions: tuple[str, ...]) -> str | None:
    for distribution in distributions:
        try:
            return metadata.version(distribution)
        except metadata.PackageNotFoundError:
            continue
    return None
