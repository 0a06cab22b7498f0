# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import pytest

from imgu_ros.cli.main import main
from imgu_ros.config.files import read_parameter_file
from imgu_ros.config.parameters import Parameters, declarations
from imgu_ros.config.values import parameter_values, parameters_from


def test_every_parameter_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["params"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if line and not line.startswith(" ")] == [known.name for known in declarations()]


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
