# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import re
from pathlib import Path

import pytest

from imgu_ros.cli.main import main
from imgu_ros.config.files import read_parameter_file
from imgu_ros.config.parameters import Parameters, basic_declarations, declarations, group_headings
from imgu_ros.config.values import parameter_values, parameters_from


def listed(text: str) -> list[str]:
    """Return the names in a list of parameters, in its order."""
    return [line for line in text.splitlines() if line and not line.startswith((" ", "#", "`"))]


def test_those_to_start_with_are_listed_first_and_the_way_to_the_others(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["params"]) == 0
    out = capsys.readouterr().out
    assert listed(out) == [known.name for known in basic_declarations()]
    assert f"`imgu params --all` lists all {len(declarations())}" in out.splitlines()[-1]
    assert main(["params", "--basic"]) == 0
    assert capsys.readouterr().out == out


def test_every_parameter_is_listed_under_the_heading_of_its_group(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["params", "--all"]) == 0
    out = capsys.readouterr().out
    assert listed(out) == [known.name for known in declarations()]
    group = ""
    for line in out.splitlines()[1:]:
        if line.startswith("# "):
            group, _, heading = line[2:].partition(": ")
            assert heading == group_headings()[group]
        elif listed(line):
            assert line.rpartition(".")[0] == group


@pytest.mark.parametrize("which", [["--all", "--basic"], ["--all", "matching"], ["--basic", "matching"]])
def test_one_choice_of_parameters_at_a_time(which: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["params", *which]) == 2
    assert "not allowed with argument" in capsys.readouterr().err


def test_markdown_begins_with_those_to_start_with(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["params", "--markdown"]) == 0
    _, basic, *groups = capsys.readouterr().out.split("\n## ")
    row = re.compile(r"^\| `([a-z_.]+)` ", re.MULTILINE)
    assert row.findall(basic) == [known.name for known in basic_declarations()]
    assert row.findall("".join(groups)) == [known.name for known in declarations()]
    assert main(["params", "--markdown", "matching"]) == 0
    assert row.findall(capsys.readouterr().out) == [f.name for f in declarations() if f.group == "matching"]


def test_a_group(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["params", "matching", "seed"]) == 0
    out = capsys.readouterr().out
    assert "matching.ratio\n    double; default 0.85; 0.1 to 1\n" in out
    assert "seed\n    integer; default 0; 0 to 9007199254740992\n" in out
    assert "homography." not in out


def test_unknown_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["params", "matching.ration"]) == 1
    assert "nearest known: matching.ratio" in capsys.readouterr().err


def test_yaml_is_a_parameter_file_of_the_defaults(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["params", "--yaml"]) == 0
    path = tmp_path / "params.yaml"
    path.write_text(capsys.readouterr().out)
    assert parameter_values(parameters_from(read_parameter_file(path))) == parameter_values(Parameters())


def test_yaml_holds_what_is_set(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["params", "--yaml", "-p", "matching.ratio:=0.7", "-p", "targets.names:=[]"]) == 0
    path = tmp_path / "params.yaml"
    path.write_text(capsys.readouterr().out)
    assert parameters_from(read_parameter_file(path)).matching.ratio == 0.7


def test_yaml_of_a_group(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["params", "matching", "--yaml"]) == 0
    out = capsys.readouterr().out
    assert "    matching:\n" in out
    assert "    homography:\n" not in out
    assert main(["params", "--yaml", "--markdown"]) == 2
