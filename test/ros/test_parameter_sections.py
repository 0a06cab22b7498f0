# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import os

import pytest

from imgu_ros.errors import ParameterError
from imgu_ros.ros.parameter_sections import parameter_fault, unheeded_parameters


@pytest.mark.parametrize(
    ("text", "node", "applies"),
    [
        ("/**: {ros__parameters: {seed: 1}}", "/perception", True),
        ("/**: {ros__parameters: {seed: 1}}", "/robot/left/perception", True),
        ("perception: {ros__parameters: {seed: 1}}", "/perception", True),
        ("/perception: {ros__parameters: {seed: 1}}", "/perception", True),
        ("perception: {ros__parameters: {seed: 1}}", "/robot/perception", False),
        ("/robot/perception: {ros__parameters: {seed: 1}}", "/robot/perception", True),
        ("robot: {perception: {ros__parameters: {seed: 1}}}", "/robot/perception", True),
        ("/**/perception: {ros__parameters: {seed: 1}}", "/a/b/perception", True),
        ("/*/perception: {ros__parameters: {seed: 1}}", "/a/perception", True),
        ("/*/perception: {ros__parameters: {seed: 1}}", "/a/b/perception", False),
        ("perceptoin: {ros__parameters: {seed: 1}}", "/perception", False),
        ("camera: {ros__parameters: {seed: 1}}\n/**: {ros__parameters: {seed: 1}}", "/perception", True),
    ],
)
def test_a_file_that_says_nothing_to_the_node_is_named(tmp_path, text, node, applies):
    file = tmp_path / "p.yaml"
    file.write_text(text)
    lines = unheeded_parameters(["--ros-args", "--params-file", str(file)], node)
    assert len(lines) == (0 if applies else 1)
    assert all(str(file) in line and node in line for line in lines)


def test_without_files_there_is_nothing_to_say():
    assert unheeded_parameters([], "/perception") == []
    assert unheeded_parameters(["--ros-args", "-p", "seed:=1"], "/perception") == []


def test_what_launch_ros_writes_is_read(tmp_path):
    file = tmp_path / "launch_params_x"
    file.write_text("/**:\n  ros__parameters:\n    targets.images: !!python/tuple\n    - poster.png\n")
    assert unheeded_parameters(["--ros-args", "--params-file", str(file)], "/left/perception") == []


def test_values_that_ros_leaves_out_of_force_are_named(tmp_path):
    file = tmp_path / "p.yaml"
    file.write_text("/**: {ros__parameters: {targets.widths_m: [1], seed: 1}}")
    arguments = ["--ros-args", "--params-file", str(file), "-p", "targets.widths_m:=[0.5]", "-p", "seed:=2"]
    (line,) = unheeded_parameters(arguments, "/perception")
    assert line.startswith("targets.widths_m: [1] is in force, not the later [0.5]")


def test_rcl_decides_what_a_file_means(tmp_path):
    """A file that it has read, or that is gone by now, is no reason to stop."""
    file = tmp_path / "p.yaml"
    file.write_bytes(b"\xff")
    assert unheeded_parameters(["--ros-args", "--params-file", str(file)], "/perception") == []
    assert unheeded_parameters(["--ros-args", "--params-file", str(tmp_path / "gone.yaml")], "/perception") == []


def test_a_pipe_is_not_read_again(tmp_path):
    """`--params-file <(...)`: a second reader would wait for a writer."""
    os.mkfifo(tmp_path / "pipe")
    assert unheeded_parameters(["--ros-args", "--params-file", str(tmp_path / "pipe")], "/perception") == []


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"# Gr\xf6\xdfe\n/**: {ros__parameters: {seed: 1}}\n", "p.yaml: line 1: byte 0xF6 is not UTF-8; "),
        (b"/**:\n  ros__parameters:\n    seed:\n", "p.yaml: line 3: seed: no value; need one"),
        (
            b"/**:\n  ros__parameters:\n    raw.gains: [1, 1.5, 1]\n",
            "p.yaml: line 3: raw.gains: a list of int and float; ",
        ),
        (b"seed: 3\n", "p.yaml: line 1: a value outside of 'ros__parameters:'"),
        (None, "p.yaml: No such file or directory; need a parameter file"),
        (b"/**: {ros__parameters: {seed: 1}}\n", ""),
    ],
)
def test_what_rcl_refuses_is_told_with_its_line(tmp_path, content, said):
    file = tmp_path / "p.yaml"
    if content is not None:
        file.write_bytes(content)
    told = parameter_fault(["--ros-args", "-r", "a:=b", "--params-file", str(file), "-p", "seed:=2"])
    assert told.startswith(f"{tmp_path}/{said}") if said else told == ""


def test_the_process_tells_it(ros_domain, tmp_path):
    pytest.importorskip("rclpy", reason="needs the ros extra")
    from imgu_ros.ros.process import init_ros

    (tmp_path / "p.yaml").write_text("/**:\n  ros__parameters:\n    seed:\n")
    with pytest.raises(ParameterError, match=r"p\.yaml: line 3: seed: no value"):
        init_ros(["--ros-args", "--params-file", str(tmp_path / "p.yaml")])
    with pytest.raises(ParameterError, match="^ROS arguments: .*bad::remap"):
        init_ros(["--ros-args", "-r", "bad::remap"])
