# SPDX-License-Identifier: Apache-2.0
"""Write a software bill of materials of what is locked: python scripts/sbom.py LOCK EXTRAS.

CycloneDX 1.6, JSON. Versions and digests are those of the lock file; licences and dependencies are what the packages
declare that are installed in this environment. The same lock file and environment give the same bytes.
"""

from __future__ import annotations

import json
import sys
import uuid
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import installed
import lock

ROOT = Path(__file__).resolve().parent.parent
NAME = "imgu-ros"


def bill(file: Path, extras: list[str]) -> dict[str, Any]:
    """Return the bill of materials of this package with optional dependencies `extras`.

    Raises
    ------
    SystemExit
        If what is installed is not what is locked.
    """
    python = f"{sys.version_info[0]}.{sys.version_info[1]}"
    needs = installed.graph(NAME, extras)
    # Some are locked for another Python's sake.
    needed = {child for children in needs.values() for child in children}
    packages = [each for each in lock.select(lock.read(file), ["imgu_ros", *extras], python) if each.name in needed]
    known = {package.name for package in packages}
    for package in packages:
        found = installed.version(package.name)
        if found != package.version:
            raise SystemExit(f"{package.name}: {found or 'not'} installed; need {package.version} ({file.name})")
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    own = {
        "type": "application",
        "bom-ref": NAME,
        "name": manifest.findtext("name"),
        "version": manifest.findtext("version"),
        "description": manifest.findtext("description"),
        "licenses": [{"expression": manifest.findtext("license")}],
    }
    content = {
        "metadata": {"component": own},
        "components": [component(package) for package in packages],
        "dependencies": [
            {"ref": reference(name), "dependsOn": [reference(child) for child in children if child in known]}
            for name, children in needs.items()
            if name in known or name == NAME
        ],
    }
    # From the content, not by chance.
    number = uuid.uuid5(uuid.NAMESPACE_OID, json.dumps(content, sort_keys=True))
    head = {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
    }
    return {**head, "serialNumber": f"urn:uuid:{number}", "version": 1, **content}


def component(package: lock.Locked) -> dict[str, Any]:
    """Return the entry of one package."""
    licence, is_expression = installed.licence(package.name)
    named = {"expression": licence} if is_expression else {"license": {"name": licence}}
    return {
        "type": "library",
        "bom-ref": reference(package.name),
        "name": package.name,
        "version": package.version,
        "scope": "required" if "imgu_ros" in package.needed_by else "optional",
        **({"licenses": [named]} if licence else {}),
        "purl": f"pkg:pypi/{package.name}@{package.version}",
        "externalReferences": [
            {
                "type": "distribution",
                "url": f"pkg:pypi/{package.name}@{package.version}",
                "comment": "the files that may be installed",
                "hashes": [{"alg": "SHA-256", "content": digest} for digest in package.sha256],
            }
        ],
        "properties": [{"name": "imgu_ros:needed_by", "value": ", ".join(package.needed_by)}],
    }


def reference(name: str) -> str:
    """Return what the bill calls a package."""
    return name if name == NAME else f"pypi:{name}"


if __name__ == "__main__":
    _, chosen_file, chosen_extras = sys.argv
    made = bill(Path(chosen_file), [name for name in chosen_extras.split(",") if name])
    json.dump(made, sys.stdout, indent=2, ensure_ascii=False)
    print()
