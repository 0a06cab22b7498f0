# SPDX-License-Identifier: Apache-2.0
"""The bill of materials and the audit of what is locked and installed."""

from __future__ import annotations

import base64
import hashlib
import importlib
import json
import re
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

REPOSITORY = Path(__file__).resolve().parent.parent
SCRIPTS = REPOSITORY / "scripts"


@pytest.fixture
def audit(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(str(SCRIPTS))
    yield importlib.import_module("audit")
    for name in ("audit", "installed", "lock"):
        sys.modules.pop(name, None)


@pytest.fixture(scope="module")
def lock_file() -> Path:
    """The lock file that this environment was made from."""
    for name in ("constraints.txt", "constraints-jazzy.txt"):
        text = (REPOSITORY / name).read_text()
        if all(f"{each}=={metadata.version(each)}" in text for each in ("numpy", "opencv-python-headless", "rosbags")):
            return REPOSITORY / name
    pytest.skip("this environment is not what a lock file has")


def bill(file: Path, extras: str) -> bytes:
    command = [sys.executable, str(SCRIPTS / "sbom.py"), str(file), extras]
    return subprocess.run(command, check=True, capture_output=True, timeout=60).stdout


def test_bill_of_materials(lock_file: Path) -> None:
    text = bill(lock_file, "")
    assert bill(lock_file, "") == text, "not reproducible"
    made: dict[str, Any] = json.loads(text)
    assert (made["bomFormat"], made["specVersion"]) == ("CycloneDX", "1.6")
    assert re.fullmatch("urn:uuid:[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}", made["serialNumber"])

    components = {item["bom-ref"]: item for item in made["components"]}
    assert len(components) == len(made["components"]) > 15
    locked = lock_file.read_text()
    for item in components.values():
        name, version = item["name"], item["version"]
        assert metadata.version(name) == version
        assert item["purl"] == f"pkg:pypi/{name}@{version}"
        assert item["licenses"]
        (block,) = re.findall(
            rf"^{re.escape(name)}=={re.escape(version)}(?: ;.*)? \\\n((?:    .*\n)+)", locked, re.MULTILINE
        )
        (source,) = item["externalReferences"]
        assert [each["content"] for each in source["hashes"]] == re.findall("sha256:([0-9a-f]{64})", block)

    # Whatever is in it is needed by something in it, from this package on.
    needs = {item["ref"]: item["dependsOn"] for item in made["dependencies"]}
    assert needs.keys() == components.keys() | {"imgu-ros"}
    reached, queue = set(), ["imgu-ros"]
    while queue:
        reference = queue.pop()
        if reference not in reached:
            reached.add(reference)
            queue += needs[reference]
    assert components.keys() <= reached
    direct = [Requirement(line) for line in metadata.requires("imgu-ros") or []]
    assert set(needs["imgu-ros"]) == {
        f"pypi:{canonicalize_name(each.name)}"
        for each in direct
        if each.marker is None or each.marker.evaluate({"extra": ""})
    }


def test_bill_of_materials_says_what_is_optional(lock_file: Path) -> None:
    made = json.loads(bill(lock_file, "test"))
    scopes = {item["name"]: item["scope"] for item in made["components"]}
    assert (scopes["numpy"], scopes["pytest"]) == ("required", "optional")


def install(folder: Path, licence: str = "MIT") -> Path:
    """Install a package of one module as pip does."""
    info = folder / "harmless-1.0.dist-info"
    info.mkdir(parents=True)
    files = {"harmless.py": "x = 1\n", f"{info.name}/METADATA": f"Name: harmless\nVersion: 1.0\nLicense: {licence}\n"}
    lines = []
    for name, text in files.items():
        (folder / name).write_text(text)
        digest = base64.urlsafe_b64encode(hashlib.sha256(text.encode()).digest()).decode().rstrip("=")
        lines.append(f"{name},sha256={digest},{len(text)}\n")
    (info / "RECORD").write_text("".join([*lines, f"{info.name}/RECORD,,\n"]))
    return info


def test_changed_file_of_a_package_is_found(audit: ModuleType, tmp_path: Path) -> None:
    distribution = metadata.Distribution.at(install(tmp_path))
    assert list(audit.changed_files(distribution)) == []
    (tmp_path / "harmless.py").write_text("x = 2\n")
    assert list(audit.changed_files(distribution)) == ["harmless: harmless.py: changed since it was installed"]
    (tmp_path / "harmless.py").unlink()
    assert list(audit.changed_files(distribution)) == ["harmless: harmless.py: missing"]


@pytest.mark.parametrize(
    ("licence", "allowed"),
    [
        ("MIT", True),
        ("Apache 2.0", True),
        ("BSD-3-Clause AND MIT", True),
        ("GPL-3.0-or-later", False),
        ("MIT AND GPL-3.0-only", False),
        ("Proprietary", False),
        ("", False),
    ],
)
def test_licences(
    audit: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, licence: str, allowed: bool
) -> None:
    install(tmp_path, licence)
    monkeypatch.syspath_prepend(str(tmp_path))
    package = audit.lock.Locked("harmless", "1.0", ("0" * 64,), ("imgu_ros",))
    assert (list(audit.licence_problems([package])) == []) is allowed


def test_other_version_is_found(audit: ModuleType, lock_file: Path) -> None:
    packages = [audit.lock.Locked("numpy", "0.1", ("0" * 64,), ("imgu_ros",))]
    packages += [audit.lock.Locked("absent", "1.0", ("0" * 64,), ("imgu_ros",))]
    problems = list(audit.environment_problems(packages))
    assert f"numpy {metadata.version('numpy')}: installed; need 0.1" in problems
    assert "absent 1.0: locked; not installed" in problems
    assert any(line.startswith("scipy ") and line.endswith("it is not locked") for line in problems)


def ranges(*events: dict[str, str]) -> dict[str, Any]:
    return {"ranges": [{"type": "ECOSYSTEM", "events": list(events)}]}


@pytest.mark.parametrize(
    ("version", "affected", "expected"),
    [
        ("1.0", ranges({"introduced": "0"}), True),
        ("1.0", ranges({"introduced": "0"}, {"fixed": "1.0"}), False),
        ("0.9", ranges({"introduced": "0"}, {"fixed": "1.0"}), True),
        ("1.0rc1", ranges({"introduced": "0"}, {"fixed": "1.0"}), True),
        ("1.10", ranges({"introduced": "0"}, {"fixed": "1.9"}), False),
        ("1.0", ranges({"introduced": "0"}, {"last_affected": "1.0"}), True),
        ("1.0.1", ranges({"introduced": "0"}, {"last_affected": "1.0"}), False),
        ("0.5", ranges({"introduced": "1.0"}), False),
        ("3.1", ranges({"fixed": "2.0"}, {"introduced": "3.0"}, {"introduced": "0"}, {"fixed": "3.2"}), True),
        ("2.5", ranges({"introduced": "0"}, {"fixed": "2.0"}, {"introduced": "3.0"}, {"fixed": "3.2"}), False),
        ("1.0", {"versions": ["1.0.0"]}, True),
        ("1.1", {"versions": ["1.0.0"]}, False),
        ("1.0", {"ranges": [{"type": "GIT", "events": [{"introduced": "0"}]}]}, False),
    ],
)
def test_which_versions_an_advisory_is_about(
    audit: ModuleType, version: str, affected: dict[str, Any], expected: bool
) -> None:
    assert audit.is_affected(version, affected) is expected


def test_locked_versions_are_looked_for_in_a_database(audit: ModuleType, tmp_path: Path) -> None:
    def entry(identifier: str, name: str, ecosystem: str = "PyPI", **more: Any) -> dict[str, Any]:
        package = {"ecosystem": ecosystem, "name": name}
        return {"id": identifier, "affected": [{"package": package, **ranges({"introduced": "0"})}], **more}

    with zipfile.ZipFile(tmp_path / "all.zip", "w") as archive:
        for number, item in enumerate(
            [
                entry("PYSEC-1", "Some.Package"),
                entry("PYSEC-2", "some_package", withdrawn="2026-01-01T00:00:00Z"),
                entry("GHSA-3", "some-package", ecosystem="npm"),
                entry("GHSA-4", "other"),
            ]
        ):
            archive.writestr(f"{number}.json", json.dumps(item))
    packages = [audit.lock.Locked("some-package", "2.0", ("0" * 64,), ("imgu_ros",))]
    found = list(audit.advisory_problems(packages, audit.advisories(tmp_path / "all.zip")))
    assert found == ["some-package 2.0: PYSEC-1"]


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04"])
def test_a_database_that_is_none_is_refused(audit: ModuleType, tmp_path: Path, content: bytes) -> None:
    (tmp_path / "all.zip").write_bytes(content)
    with pytest.raises(SystemExit, match="need an OSV database"):
        audit.advisories(tmp_path / "all.zip")
