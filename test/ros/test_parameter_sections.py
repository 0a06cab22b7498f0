from __future__ import annotations

import os

import pytest

from imgu_ros.ros.parameter_sections import unheeded_parameters


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
