# SPDX-License-Identifier: Apache-2.0
"""YAML of others: aliases, nesting and long numbers decide neither time nor memory, and what tools write is read."""

from __future__ import annotations

import time

import pytest
import yaml

from imgu_ros.config.files import read_parameter_file
from imgu_ros.config.parameters import LimitsParameters
from imgu_ros.config.yaml_values import scalar_value
from imgu_ros.errors import FileError, ParameterError
from imgu_ros.files.camera_info_file import read_camera_info, read_description
from imgu_ros.files.yaml_tree import yaml_tree


def test_a_tree_of_texts():
    text = """%YAML 1.1
---
a: [1, 2.5, "3", ~, null, '', "null", true]
b: !!opencv-matrix {rows: 3, dt: d, data: [.nan, 0x10]}
? c
: &anchor {d: 010, d: 011}
e: [*anchor, *anchor]
<<: *anchor
f: !!python/object/apply:os.system ["false"]
1: !!int ""
--- another document
"""
    inner = {"d": "011"}
    assert yaml_tree(text) == {
        "a": ["1", "2.5", "3", None, None, "", "null", "true"],
        "b": {"rows": "3", "dt": "d", "data": [".nan", "0x10"]},
        "c": inner,
        "e": [inner, inner],
        "<<": inner,
        "f": ["false"],
        "1": "",
    }
    assert yaml_tree("") is None
    assert yaml_tree("# nothing\n") is None
    assert yaml_tree("plain") == "plain"


def bomb(levels: int) -> str:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, levels)]
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (bomb(12), "more than 4 MB of values, its aliases counted; need less (limits.text_mb)"),
        ("[" * 1_000_000, "nested more than 100 deep"),
        ("{a: " * 1_000_000, "nested more than 100 deep"),
        ("- " * 1_000_000, "nested more than 100 deep"),
        ("a: &a [*a]", "undefined alias a"),
        ("*" + "a" * 100_000, "undefined alias aaaa"),
        ("[1, 2]: 3", "a key that is no text"),
        ("[" + "a," * 300_000 + "]", "more than 1 MB of values"),
        ("a: \0", ""),
        ("a: [1", ""),
    ],
)
def test_yaml_that_is_refused(text, said):
    began = time.monotonic()
    limits = LimitsParameters(text_mb=1) if "1 MB" in said else LimitsParameters()
    with pytest.raises((ValueError, yaml.YAMLError)) as error:
        yaml_tree(text, limits)
    assert said in str(error.value)
    assert time.monotonic() - began < 8


def test_the_bound_counts_what_aliases_repeat():
    text = f"a: &a {'x' * 90_000}\nb: [{', '.join(['*a'] * 10)}]\n"
    assert len(yaml_tree(text, LimitsParameters(text_mb=1))["b"]) == 10
    with pytest.raises(ValueError, match="more than 1 MB of values"):
        yaml_tree(text.replace("]", ", *a]"), LimitsParameters(text_mb=1))


CALIBRATION = "image_width: 640\nimage_height: 480\ncamera_matrix: {data: [500, 0, 320, 0, 500, 240, 0, 0, 1]}\n"


@pytest.mark.parametrize(
    "text",
    [
        bomb(12),
        CALIBRATION.replace("640", "9" * 400),
        CALIBRATION.replace("640", "1e300"),
        CALIBRATION.replace("500", "9" * 100_000),
        CALIBRATION.replace("[500", f"[{'[' * 500}"),
        "\n" * 1_000_000,
        "[a\n" * 300_000,
        f"camera matrix\n[image]\n{'1 ' * 1_000_000}\n",
        "a: &a {k: 1}\nb: {<<: [" + "*a," * 100_000 + "*a]}\n",
    ],
)
def test_calibrations_that_are_none_are_refused_in_time(tmp_path, text):
    (tmp_path / "c.yaml").write_text(text)
    began = time.monotonic()
    with pytest.raises(FileError) as error:
        read_camera_info(tmp_path / "c.yaml")
    assert time.monotonic() - began < 8
    assert len(str(error.value)) < 600
    assert "\n" not in str(error.value)


def test_a_calibration_file_has_a_bound(tmp_path):
    (tmp_path / "c.yaml").write_text(CALIBRATION + "#" * 1_100_000)
    assert read_description(tmp_path / "c.yaml").width == 640
    with pytest.raises(FileError, match=r"need a calibration file of at most 1 MB \(limits.text_mb\)"):
        read_description(tmp_path / "c.yaml", LimitsParameters(text_mb=1))


def parameters(inner: str) -> str:
    return f"/**:\n  ros__parameters:\n{inner}"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (parameters("".join(f"    p{i}: 1\n" for i in range(100_000))), "more than 5000 parameters in '/**'"),
        (
            parameters(f"    {'g' * 400}:\n      {'a' * 700}: 1\n"),
            "a name of 1100 characters with its groups; need at most 1000",
        ),
        (parameters("".join(f"{' ' * (4 + i)}{'g' * 20}:\n" for i in range(300))), "characters with its groups"),
        ("".join(f"{' ' * i}ns{i}:\n" for i in range(900)), "characters with its groups"),
        (parameters(f"    seed: {'9' * 1_000_000}\n"), "seed"),
        (parameters(f"    seed: 0x{'f' * 1_000_000}p-3999990\n"), "seed"),
        (parameters(f"    seed: 0.{'0' * 320}{'1' * 1_000_000}\n"), "seed"),
        (parameters("    seed: [" * 900), ""),
        (bomb(12), ""),
    ],
)
def test_parameter_files_that_are_refused_in_time(tmp_path, text, said):
    (tmp_path / "p.yaml").write_text(text)
    began = time.monotonic()
    with pytest.raises(ParameterError) as error:
        read_parameter_file(tmp_path / "p.yaml")
    assert said in str(error.value)
    assert time.monotonic() - began < 8


def test_numbers_of_a_thousand_digits_are_numbers():
    def value(text):
        return scalar_value(next(event for event in yaml.parse(text) if isinstance(event, yaml.ScalarEvent)))

    assert value("0." + "1" * 998) == pytest.approx(1 / 9)
    assert isinstance(value("0." + "1" * 999), str)
