"""The documentation against the code."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from imgu_ros.cli.main import main
from imgu_ros.codec.results import FRAME_OUTPUTS, TARGET_OUTPUTS


def test_parameter_reference_is_current(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["params", "--markdown"]) == 0
    assert (repository / "docs" / "parameters.md").read_text() == capsys.readouterr().out, (
        "run: imgu params --markdown > docs/parameters.md"
    )


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", "docs/interfaces.md", "docs/how-it-works.md"])
def test_links_lead_somewhere(repository: Path, page: str) -> None:
    text = (repository / page).read_text()
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        assert target.startswith("https://") or (repository / page).parent.joinpath(target).exists(), target


def test_every_output_topic_is_documented(repository: Path) -> None:
    text = (repository / "docs" / "interfaces.md").read_text()
    for topic in [*FRAME_OUTPUTS, *TARGET_OUTPUTS]:
        assert f"`{topic}`" in text, topic


@pytest.mark.parametrize("page", ["README.md", "docs/interfaces.md", "docs/how-it-works.md"])
def test_parameters_named_in_prose_exist(repository: Path, page: str) -> None:
    from imgu_ros.params import declarations

    known = {d.name for d in declarations()}
    groups = {name.split(".")[0] for name in known if "." in name}
    for name in re.findall(r"`([a-z_]+\.[a-z_]+)`", (repository / page).read_text()):
        if name.split(".")[0] in groups and not name.endswith(".csv"):
            assert name in known, name
