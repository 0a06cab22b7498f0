# SPDX-License-Identifier: Apache-2.0
"""The documentation against the code."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from imgu_ros.cli.main import main
from imgu_ros.messages.results import OUTPUTS

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted(str(path.relative_to(ROOT)) for path in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])


def test_parameter_reference_is_current(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["params", "--markdown"]) == 0
    assert (repository / "docs" / "parameters.md").read_text() == capsys.readouterr().out, (
        "run: imgu params --markdown > docs/parameters.md"
    )


def test_parameter_file_is_current(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["params", "--yaml"]) == 0
    assert (repository / "config" / "perception.yaml").read_text() == capsys.readouterr().out, (
        "run: imgu params --yaml > config/perception.yaml"
    )


def test_the_file_to_start_with_is_current_and_a_part_of_the_whole_one(
    repository: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (repository / "config" / "basic.yaml").read_text()
    assert main(["params", "--basic", "--yaml"]) == 0
    assert text == capsys.readouterr().out, "run: imgu params --basic --yaml > config/basic.yaml"
    everything = (repository / "config" / "perception.yaml").read_text()
    # Lists without values are comments in it.
    whole = {line.strip().removeprefix("# ") for line in everything.splitlines()}
    lines = [line.strip().removeprefix("# ") for line in text.partition("/**:")[2].splitlines()]
    assert len(lines) > 16
    assert set(lines) - {""} <= whole


@pytest.mark.parametrize("page", ["README.md", "docs/ros.md", "docs/parameters.md", "docs/interfaces.md"])
def test_the_file_to_start_with_is_found(repository: Path, page: str) -> None:
    assert "config/basic.yaml" in (repository / page).read_text()


def test_pages_are_found() -> None:
    assert {"README.md", "docs/interfaces.md", "docs/calibrate.md", "docs/reference/estimation.md"} <= set(PAGES)


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(repository: Path, page: str) -> None:
    text = (repository / page).read_text()
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        assert target.startswith("https://") or (repository / page).parent.joinpath(target).exists(), target


def test_every_output_topic_is_documented(repository: Path) -> None:
    text = (repository / "docs" / "interfaces.md").read_text()
    for name in (row.name for row in OUTPUTS):
        assert f"`{name}" in text or name.endswith("/compressed"), name


@pytest.mark.parametrize("page", PAGES)
def test_parameters_named_in_prose_exist(repository: Path, page: str) -> None:
    from imgu_ros.config.parameters import declarations

    known = {d.name for d in declarations()}
    groups = {name.split(".")[0] for name in known if "." in name}
    for name in re.findall(r"`([a-z_]+\.[a-z_]+)(?::=[^`]*)?`", (repository / page).read_text()):
        if name.split(".")[0] in groups and not name.endswith((".csv", ".yaml")) and not _is_code(repository, name):
            assert name in known, name


def _is_code(repository: Path, name: str) -> bool:
    """Whether `room.module` or `module.function` of the vision library has this name."""
    parent, child = name.split(".")
    vision = repository / "imgu_ros" / "vision"
    return (vision / parent / f"{child}.py").exists() or any(
        f"def {child}(" in module.read_text() for module in vision.glob(f"*/{parent}.py")
    )


def test_every_launch_file_and_layout_is_documented(repository: Path) -> None:
    text = (repository / "docs" / "ros.md").read_text()
    for path in [*(repository / "launch").glob("*.py"), *(repository / "config").glob("perception.*")]:
        assert f"`{path.relative_to(repository)}`" in text, path


def test_every_command_is_documented(repository: Path) -> None:
    from imgu_ros.cli.main import COMMANDS

    text = (repository / "docs" / "interfaces.md").read_text()
    for command in COMMANDS:
        assert f"`imgu {command} " in text or f"`imgu {command}`" in text, command


@pytest.mark.parametrize("page", PAGES)
def test_options_of_commands_exist(repository: Path, page: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Commands in code blocks: every long option is in the command's help."""
    text = (repository / page).read_text().replace("\\\n", " ")
    for command, rest in re.findall(r"^ *imgu ([a-z]+) (.*)$", text, re.MULTILINE):
        assert main([command, "--help"]) == 0
        known = capsys.readouterr().out
        for option in re.findall(r"(?<!\S)--[a-z-]+", rest.partition("#")[0]):
            assert option in known, f"imgu {command} {option}"


def test_every_cited_section_is_in_the_list_of_sources(repository: Path) -> None:
    """`IU 5.2.1` in a docstring leads to a row of docs/references.md."""
    listed = set(
        re.findall(r"^\| ([1-8](?:\.\d)+) \|", (repository / "docs/references.md").read_text("utf-8"), re.MULTILINE)
    )
    assert len(listed) > 100
    cited = {
        section
        for path in sorted((repository / "imgu_ros").rglob("*.py"))
        for group in re.findall(r"\bIU (\d[\d., andto-]*)", path.read_text("utf-8"))
        for section in re.findall(r"\d(?:\.\d)+", group)
    }
    assert cited and cited <= listed, sorted(cited - listed)


def test_paths_named_in_the_architecture_exist(repository: Path) -> None:
    """Files and folders of docs/architecture.md, below the package or the repository."""
    text = (repository / "docs/architecture.md").read_text("utf-8")
    prose = re.sub(r"<!-- before -->.*?<!-- end -->", "", text, flags=re.DOTALL)
    named = set(re.findall(r"[\w/]+/[\w/]*(?:\.py)?|\b\w+\.py", prose))
    paths = {name for name in named if name.endswith((".py", "/"))}
    assert len(paths) > 40
    modules = list((repository / "imgu_ros").rglob("*.py"))
    known = {path.name for path in modules}
    roots = (repository, repository / "imgu_ros")
    assert sorted(p for p in paths if p not in known and not any((root / p).exists() for root in roots)) == []
