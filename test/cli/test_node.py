# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from imgu_ros.cli.main import main
from imgu_ros.cli.node import NODES, ros_arguments_of
from imgu_ros.errors import ParameterError


@pytest.mark.parametrize(
    ("rest", "expected"),
    [
        ([], []),
        (["-p", "seed:=1"], ["--ros-args", "-p", "seed:=1"]),
        (["--params-file", "a.yaml", "-r", "a:=b"], ["--ros-args", "--params-file", "a.yaml", "-r", "a:=b"]),
        (["--params-file=a.yaml"], ["--ros-args", "--params-file", "a.yaml"]),
        (["-p", "a:=1", "--ros-args", "-p", "b:=2"], ["--ros-args", "-p", "a:=1", "-p", "b:=2"]),
        (["--ros-args", "-p", "b:=2", "--", "x"], ["--ros-args", "-p", "b:=2", "--", "x"]),
    ],
)
def test_parameters_go_to_ros_with_or_without_ros_args(rest, expected):
    assert ros_arguments_of(rest) == expected


@pytest.mark.parametrize("rest", [["image.png"], ["-p"], ["--frobnicate", "1"]])
def test_other_arguments_are_refused(rest):
    with pytest.raises(ParameterError, match="need"):
        ros_arguments_of(rest)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "need one of perception"),
        (["percepton"], "did you mean perception"),
        (["homografy"], "did you mean homography"),
        (["perception", "image.png"], "image.png: unknown argument"),
    ],
)
def test_wrong_usage_is_one_line_and_2(capsys, arguments, said):
    assert main(["node", *arguments]) == 2
    captured = capsys.readouterr()
    assert said in captured.err
    assert captured.err.count("\n") == 1


def test_the_profile_is_printed(capsys):
    assert main(["node", "--print-dds-profile"]) == 0
    assert Path(capsys.readouterr().out.strip()).is_file()


def test_help_of_a_node(capsys):
    assert main(["node", "perception", "--help"]) == 0
    assert "--params-file" in capsys.readouterr().out


def test_every_node_has_a_module_of_its_name():
    for name, module in NODES.items():
        assert module.rpartition(".")[2] == name
        assert find_spec(module) is not None


@pytest.mark.parametrize("command", [["node", "perception"], ["play", "bag"]])
def test_without_the_ros_extra_one_line_says_how_to_get_it(capsys, monkeypatch, command):
    for name in [name for name in sys.modules if name.split(".")[0] == "rclpy" or name.startswith("imgu_ros.ros.")]:
        if name != "imgu_ros.ros.stopping":
            monkeypatch.delitem(sys.modules, name)
    for name in ("rclpy", "rosgraph_msgs", "rcl_interfaces", "std_srvs"):
        monkeypatch.setitem(sys.modules, name, None)
    assert main(command) == 1
    captured = capsys.readouterr()
    assert 'pip install ".[ros]"' in captured.err
    assert captured.err.count("\n") == 1
