# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree

import pytest

from imgu_ros.report import versions
from imgu_ros.report.versions import package_version

MANIFEST = Path(__file__).resolve().parents[2] / "package.xml"


def test_in_a_source_tree_the_manifest_tells_the_version() -> None:
    assert package_version() == ElementTree.parse(MANIFEST).findtext("version")


@pytest.mark.parametrize("content", [None, "<package><name>other</name><version>9</version></package>", "no XML"])
def test_elsewhere_the_installation_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: str | None) -> None:
    if content is not None:
        (tmp_path / "package.xml").write_text(content)
    monkeypatch.setattr(versions, "_MANIFEST", tmp_path / "package.xml")
    monkeypatch.setattr(metadata, "version", lambda name: {"imgu_ros": "1.2.3"}[name])
    assert package_version() == "1.2.3"


def test_unknown_where_nothing_tells(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> str:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(versions, "_MANIFEST", tmp_path / "package.xml")
    monkeypatch.setattr(metadata, "version", missing)
    assert package_version() == "unknown"
