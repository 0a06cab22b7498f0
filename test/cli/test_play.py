# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest

from imgu_ros.cli.main import main


@pytest.mark.parametrize(
    "arguments",
    [
        ["bag", "--rate", "0"],
        ["bag", "--rate", "nan"],
        ["bag", "--rate", "fast"],
        ["bag", "--start", "-1"],
        ["bag", "--duration", "0"],
        ["bag", "--wait-for", "-1"],
        ["bag", "--wait-for", "1.5"],
        [],
    ],
)
def test_wrong_usage_is_2(capsys, arguments):
    assert main(["play", *arguments]) == 2
    assert "usage: imgu play" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "value"), [("--rate", "fast"), ("--rate", "1e12"), ("--start", "-1"), ("--wait-for", "1.5")]
)
def test_wrong_numbers_are_told_what_is_needed(capsys, option, value):
    assert main(["play", "bag", option, value]) == 2
    assert f"argument {option}: '{value}'; need a" in capsys.readouterr().err


@pytest.mark.parametrize("content", [None, b"", b"random bytes, no bag at all"])
def test_what_is_no_bag_is_one_line_and_1(capsys, tmp_path, content, ros_domain):
    pytest.importorskip("rclpy", reason="needs the ros extra")
    bag = tmp_path / "bag.mcap"
    if content is not None:
        bag.write_bytes(content)
    assert main(["play", str(bag)]) == 1
    captured = capsys.readouterr()
    assert str(bag) in captured.err
    assert captured.err.count("\n") == 1
