# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from imgu_ros.cli.options import add_parameter_options, parameters_of
from imgu_ros.config.parameters import Parameters
from imgu_ros.errors import ImguError


def parsed(*argv: str) -> Parameters:
    parser = argparse.ArgumentParser()
    add_parameter_options(parser)
    return parameters_of(parser.parse_args(argv), {"seed": 7})


@pytest.fixture
def file(tmp_path: Path) -> str:
    path = tmp_path / "p.yaml"
    path.write_text("/**:\n  ros__parameters:\n    seed: 3\n    matching: {ratio: 0.5}\n")
    return str(path)


def test_nothing_given() -> None:
    assert parsed().seed == 7
    assert parsed().matching.ratio == 0.85


def test_the_later_one_wins(file: str) -> None:
    assert parsed("-p", "seed:=5", "--params-file", file).seed == 3
    assert parsed("--params-file", file, "-p", "seed:=5", "-p", "seed:=6").seed == 6
    assert parsed("--params-file", file).matching.ratio == 0.5


def test_calls_do_not_share_state() -> None:
    assert parsed("-p", "seed:=5").seed == 5
    assert parsed().seed == 7


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["-p", "seeed:=1"], "nearest known: seed"),
        (["-p", "seed:=many"], "need an integer"),
        (["-p", "matching.ratio:=7"], "0.1 to 1"),
        (["-p", "seed"], "seed"),
        (["--params-file", "/no/such/file.yaml"], "/no/such/file.yaml"),
    ],
)
def test_bad_values(argv: list[str], said: str) -> None:
    with pytest.raises(ImguError, match=said):
        parsed(*argv)
