# SPDX-License-Identifier: Apache-2.0
"""What is installed in this environment, as far as a lock file speaks of it: versions, licences, what needs what."""

from __future__ import annotations

import re
from collections.abc import Iterable
from importlib import metadata
from xml.etree import ElementTree

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

#: SPDX identifiers by what distributions write instead.
SPDX = {
    "Apache 2.0": "Apache-2.0",
    "Apache License 2.0": "Apache-2.0",
    "Apache License, Version 2.0": "Apache-2.0",
    "Apache Software License": "Apache-2.0",
    "Apache-2.0 License": "Apache-2.0",
    "BSD 3-Clause": "BSD-3-Clause",
    "BSD 3-Clause License": "BSD-3-Clause",
    "MIT License": "MIT",
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
    "Python Software Foundation License": "PSF-2.0",
}
_NAME = r"(?:[A-Za-z-]+-[A-Z0-9.][A-Za-z0-9.-]*|MIT|Zlib|ISC)"
_EXPRESSION = re.compile(rf"{_NAME}(?: (?:AND|OR) {_NAME})*")


def version(name: str) -> str | None:
    """Return the installed version of a package; None without it."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def licence(name: str) -> tuple[str, bool]:
    """Return the licence that an installed package declares (empty: none), and whether it is an SPDX expression."""
    distribution = metadata.distribution(name)
    info = distribution.metadata
    if expression := info.get("License-Expression"):
        return str(expression), True
    texts = [text for text in [info.get("License")] if text and "\n" not in text]
    texts += [line.rpartition(" :: ")[2] for line in info.get_all("Classifier", []) if line.startswith("License")]
    for file in distribution.files or []:
        # The wheels of ROS packages hold their manifest.
        if file.name == "package.xml":
            texts += [found.text or "" for found in ElementTree.parse(str(file.locate())).getroot().iter("license")]
        elif file.name == "LICENSE" and file.read_text().split()[:4] == ["Apache", "License", "Version", "2.0,"]:
            texts.append("Apache-2.0")
    texts = [SPDX.get(text.strip(), text.strip()) for text in texts if text]
    return next(((text, True) for text in texts if _EXPRESSION.fullmatch(text)), (texts[0] if texts else "", False))


def children(name: str, extras: Iterable[str]) -> list[tuple[str, frozenset[str]]]:
    """Return what an installed package with optional dependencies `extras` needs here, with the extras it asks for."""
    found = []
    for line in metadata.requires(name) or []:
        child = Requirement(line)
        if child.marker is None or any(child.marker.evaluate({"extra": extra}) for extra in ("", *extras)):
            found.append((canonicalize_name(child.name), frozenset(child.extras)))
    return found


def graph(name: str, extras: Iterable[str]) -> dict[str, list[str]]:
    """Return what each package needs that `name` with optional dependencies `extras` needs, itself included."""
    queue, seen = [(canonicalize_name(name), frozenset(extras))], set()
    needs: dict[str, set[str]] = {}
    while queue:
        entry = queue.pop()
        if entry in seen:
            continue
        seen.add(entry)
        if version(entry[0]) is not None:
            found = children(*entry)
            needs.setdefault(entry[0], set()).update(child for child, _ in found)
            queue += found
    return {each: sorted(found - {each}) for each, found in sorted(needs.items())}
