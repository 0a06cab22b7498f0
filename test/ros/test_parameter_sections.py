from __future__ import annotations

import pytest

from imgu_ros.ros.parameter_sections import files_without_section


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
    for arguments in (["--ros-args", "--params-file", str(file)], [f"--params-file={file}"]):
        lines = files_without_section(arguments, node)
        assert len(lines) == (0 if applies else 1)
        assert all(str(file) in line and node in line for line in lines)


def test_without_files_there_is_nothing_to_say():
    assert files_without_section([], "/perception") == []
    assert files_without_section(["--ros-args", "-p", "seed:=1"], "/perception") == []
