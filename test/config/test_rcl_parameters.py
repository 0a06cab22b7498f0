# SPDX-License-Identifier: Apache-2.0
"""Parameter files and overrides against rcl itself: the same ones are accepted, and with the same values."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from imgu_ros.config import yaml_values
from imgu_ros.config.parameters import basic_declarations, declarations
from imgu_ros.config.rcl_parameters import RclParameters, section_applies, with_slash
from imgu_ros.errors import ParameterError

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # rclpy's own, at import

Rcl = Callable[..., dict[str, object] | None]
HEAD = "/**:\n  ros__parameters:\n"


def ours(*arguments: str | bytes, name: str = "/perception") -> dict[str, object] | None:
    """Return the values of files and, where they begin with "-p ", overrides; None: refused."""
    parameters = RclParameters()
    try:
        for argument in arguments:
            if isinstance(argument, str) and argument.startswith("-p "):
                parameters.add_override(argument[3:])
            else:
                parameters.add_file(argument.encode() if isinstance(argument, str) else argument, "p.yaml")
    except ParameterError:
        return None
    entries = parameters.entries(lambda section: section_applies(with_slash(section), name))
    # rcl does not tell an empty list from a name without a value.
    return {name: None if entry.value == [] else entry.value for name, entry in entries.items()}


@pytest.fixture
def rcl(ros_domain: int, tmp_path: Path) -> Iterator[Rcl]:
    """Returns what a node of rclpy gets from rcl."""
    rclpy = pytest.importorskip("rclpy", reason="needs the ros extra")
    from rclpy.node import Node

    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    numbers = itertools.count()

    def read(*arguments: str | bytes, name: str = "/perception") -> dict[str, object] | None:
        command = ["--ros-args"]
        for argument in arguments:
            if isinstance(argument, str) and argument.startswith("-p "):
                command += ["-p", argument[3:]]
                continue
            path = tmp_path / f"{next(numbers)}.yaml"
            path.write_bytes(argument.encode() if isinstance(argument, str) else argument)
            command += ["--params-file", str(path)]
        namespace, _, node_name = name.rpartition("/")
        try:
            node = Node(
                node_name, namespace=namespace, context=context, cli_args=command, use_global_arguments=False,
                start_parameter_services=False, enable_rosout=False, enable_logger_service=False,
            )  # fmt: skip
        except Exception as error:
            if type(error).__name__ != "RCLInvalidROSArgsError":
                raise
            return None
        values = {name: _plain(parameter.value) for name, parameter in node._parameter_overrides.items()}
        node.destroy_node()
        return values

    yield read
    rclpy.shutdown(context=context)


def _plain(value: Any) -> object:
    return value.tolist() if hasattr(value, "tolist") else value


def lines(*values: str) -> str:
    return HEAD + "".join(f"    {line}\n" for line in values)


SCALARS = (
    "5 -5 +5 0x1F 010 08 0 -0 -0x10 0o17 0b11 1_000 1:30 1.5 1e3 1e-3 1E5 -.5 1. .5e1 5e 0x 0x1p3 0x.8 0x1p-1074 "
    "0x1.8p-1074 1e400 -1e400 1e-400 1e-310 0e-999999999 5e-324 2.2250738585072014e-308 99999999999999999999 "
    "9223372036854775807 9223372036854775808 -9223372036854775808 -9223372036854775809 .inf -.inf +.inf .nan +.nan "
    "-.nan .NaN .Nan inf -inf INF infinity nan NaN -nan nan(abc) nan( true True TRUE tRuE y Y yes Yes YES yEs on "
    "On ON n N no No NO off Off OFF false null ~ Null 2001-01-01 '5' 'true' \"on\" '' \"\" !!str\\ 5 rggb a:=b = "
    "<< ~/poster.png ./a C:\\x é €"
).split(" ")
FORMS = (
    "!!str 5", "!!str", "!!int '5'", "!!float 5", "!!bool 'yes'", "!!python/unicode '5'", "!!python/str 5", "!foo 5",
    "! 5", "!!null x", "!!python/tuple [a.png, b.png]", "!!python/tuple [0.5]", "!!python/tuple []",
    "!!python/tuple\n    - 1\n    - 2", "[]", "[ ]", "[1]", "[1, 2]", "[1.0, 2]", "[1, 2.0]", "[1, '2']",
    "[a, 'b c', '']", "[true, off]", "[[1, 2]]", "[[1], [2]]", "[[1], b]", "[[1], b: 2]", "[[]]", "[{a: 1}]",
    "[{a: 1}, {b: 2}]", "[a: b]", "{}", "{a: 1}", "{a: {b: 1}, c: 2}", "{a: {}}", "{a: [1], b: []}", "|\n      5\n",
    "|-\n      5\n", "|-\n        5\n", ">-\n      two\n      lines\n", "'a\n      b'", "\"\\x41\\n\"", "\"a\\0b\"",
    "# nothing", "", "5 # five", "a # b", "a#b", "&a 5", "&a [1]", "*a", "[*a]", "? 5", "- 5", "a: b: c", "'", "[1",
    "@x", "`x", "%x", "\t5", "5\t", "\"\\ud83d\\ude00\"", "\u00a05",
)  # fmt: skip
FILES = (
    b"", b"# nothing\n", b"5\n", b"[1]\n", b"perception:\n", b"perception: 5\n", b"perception: {}\n",
    b"ros__parameters: {a: 1}\n", b"/**:\n  ros__parameters:\n", b"/**:\n  ros__parameters: 5\n",
    b"/**:\n  ros__parameters: {}\n", b"/**: {ros__parameters_x: {a: 1}}", b"/**:\n  ros__parameters: []\n",
    b"/**:\n  ros__parameters: [a]\n", b"/**:\n  other: 5\n", b"\xef\xbb\xbf/**: {ros__parameters: {a: 1}}\n",
    b"/**:\r\n  ros__parameters:\r\n    a: 1\r\n    b: [x,\r\n y]\r\n",
    "/**: {ros__parameters: {a: é}}\n".encode("utf-16"), "/**: {ros__parameters: {a: é}}\n".encode("utf-16-be"),
    "# Größe\n/**: {ros__parameters: {a: 1}}\n".encode("latin-1"),
    "/**: {ros__parameters: {a: 1}}\n# Größe\n".encode("latin-1"),
    b"/**: {ros__parameters: {a: 1}}\n---\n/**: {ros__parameters: {b: 2}}\n",
    b"%YAML 1.1\n---\n/**: {ros__parameters: {a: 1}}\n...\n", b"%YAML 1.2\n---\n/**: {ros__parameters: {a: 1}}\n",
    b"%TAG ! tag:x,2000:\n---\n/**: {ros__parameters: {a: !y 1}}\n", b"/**:\n\tros__parameters: {a: 1}\n",
    b"/**:\n  ros__parameters:\n    a: 1\n   b: 2\n", b"/**: {ros__parameters: {'': 1}}",
    b"/**: {ros__parameters: {[1]: 1}}", b"/**: {ros__parameters: {? a : 1}}", b"/**: {ros__parameters: {a, b: 1}}",
    b"/**: {ros__parameters: {a: 1, a: 2}}", b"/**: {ros__parameters: {a: 1, a: x}}",
    b"/**: {ros__parameters: {a: [1], a: [0.5]}}", b"/**: {ros__parameters: {a: [1], a: []}}",
    b"/**: {ros__parameters: {a: 5, a: {b: 2}}}", b"/**: {ros__parameters: {a: x, a: {b: 2}}}",
    b"/**: {ros__parameters: {a.b: 3, a: {b: 2, c: 4}}}", b"/**: {ros__parameters: {a: {b: 2}, a.b: 3}}",
    b"/**: {ros__parameters: {a: {b.c: {d: 1}, e: 2}, f: 3}}",
    b"/**: {ros__parameters: {a: {b: {c: {d: 1}, e: 2}, f: 3}, g: 4}}", b"/**: {ros__parameters: {a: {}, b: 1}}",
    b"/**: {ros__parameters: {a: {b: {}}, c: 1}}", b"/**: {ros__parameters: {b: 1, a: {}}}",
    b"/**: {ros__parameters: {a: 1}, ros__parameters: {b: 2}}",
    b"/**: {ros__parameters: {a: 1}, perception: {ros__parameters: {b: 2}}}",
    b"/**: {ros__parameters: &x {a: 1}}\nperception: *x\n", b"/**: &x {ros__parameters: {a: 1}}\n",
    b"/**: {ros__parameters: {<<: {a: 1}}}",
)  # fmt: skip
#: Names of sections, and those of other nodes.
SECTIONS = (
    "/**", "/*", "*", "**", "perception", "/perception", "/perception/", "//perception", "left/perception",
    "/left/perception", "/**/perception", "/*/perception", "left/*", "/left/**", "/le*/perception",
    "left/**/perception", "per-ception", "1perception", "/", "/left/", "other", "/other", "a/b/perception", "/a/b/*",
    "***", "/left/perception/**",
)  # fmt: skip
SEVERAL: tuple[tuple[str, ...], ...] = (
    (lines("w: [1]"), "-p w:=[0.5]"), (lines("w: [0.5]"), "-p w:=[1]"), (lines("w: 1"), "-p w:=2"),
    (lines("n: [a]"), "-p n:=[]"), (lines("s: 1"), lines("s: 2", "t: 3")), (lines("a: x"), lines("a: {b: 2}")),
    ("-p s:=3", lines("s: 1")), ("perception: {ros__parameters: {s: 1}}\n", "-p s:=3"),
    ("/**: {ros__parameters: {s: 1}}\nperception: {ros__parameters: {s: 2}}\n", "-p s:=3"),
    ("perception: {ros__parameters: {s: 1}}\n/**: {ros__parameters: {s: 2}}\n",), ("-p perception:s:=4", "-p s:=5"),
    ("-p s:=5", "-p perception:s:=4"), ("-p other:s:=4",), ("-p s:=1", "-p s:=x"), (lines("g: {a: 1}"), "-p g.a:=2"),
    (lines("g.a: 1", "g.b: 2"), lines("g: {b: 3, a: 4}")),
)  # fmt: skip


#: What libyaml before 0.2 refuses, with which rcl's wheels are built, and that of Ubuntu 24.04 reads.
NEWER = [*(f"[{s}, {s}]" for s in SCALARS if ":" in s), b"%YAML 1.2\n---\n/**: {ros__parameters: {a: 1}}\n"]


def test_scalars_lists_and_forms(rcl: Rcl) -> None:
    for text in [*SCALARS, *(f"[{s}, {s}]" for s in SCALARS), *FORMS]:
        for file in (lines(f"x: {text}"), lines(f"x: {text}", "y: 1"), lines("g:", f"  x: {text}", "  y: 1", "z: 2")):
            expected = rcl(file)
            assert repr(ours(file)) == repr(expected) or (expected is None and text in NEWER), file


def test_overrides(rcl: Rcl) -> None:
    for text in [*SCALARS, *(f"[{s}, {s}]" for s in SCALARS), *FORMS]:
        override = f"-p x:={text}"
        expected = rcl(override)
        if not text.startswith("#"):  # rcl takes a comment for no value and says nothing; it is refused here
            assert repr(ours(override)) == repr(expected) or (expected is None and text in NEWER), override


def test_files(rcl: Rcl) -> None:
    for file in FILES:
        expected = rcl(file)
        assert repr(ours(file)) == repr(expected) or (expected is None and file in NEWER), file


@pytest.mark.parametrize("name", ["basic.yaml", "perception.yaml"])
def test_files_of_the_package(rcl: Rcl, repository: Path, name: str) -> None:
    file = (repository / "config" / name).read_bytes()
    expected = rcl(file)
    assert expected is not None
    assert ours(file) == expected
    assert len(basic_declarations()) <= 8
    held = basic_declarations() if name == "basic.yaml" else [known for known in declarations() if known.default != ()]
    assert set(expected) == {known.name for known in held}


@pytest.mark.parametrize("name", ["/perception", "/left/perception", "/a/b/perception"])
def test_sections(rcl: Rcl, name: str) -> None:
    for section in SECTIONS:
        file = f"{section}:\n  ros__parameters: {{s: 1}}\n"
        assert ours(file, name=name) == rcl(file, name=name), file
    file = (
        "left:\n  perception: {ros__parameters: {a: 1}}\n  other: {ros__parameters: {b: 1}}\n"
        "perception: {ros__parameters: {c: 1}}\n"
    )
    assert ours(file, name=name) == rcl(file, name=name)


def test_several_files_and_overrides(rcl: Rcl) -> None:
    for arguments in SEVERAL:
        assert ours(*arguments) == rcl(*arguments), arguments


def test_pure_python_yaml_reads_the_same(rcl: Rcl, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where PyYAML was built without libyaml."""
    import yaml

    monkeypatch.setattr(yaml_values, "_LOADER", yaml.SafeLoader)
    for text in SCALARS:
        file = lines(f"x: {text}")
        assert repr(ours(file)) == repr(rcl(file)), file
    for arguments in SEVERAL:
        assert ours(*arguments) == rcl(*arguments), arguments


_names = st.sampled_from(["a", "b", "a.b", "b.c", "a.b.c", "'c'", "d e", "1", "true"])
_scalars = st.sampled_from([*(s for s in SCALARS if ":" not in s), "!!str 5", "!foo a"]) | st.text(
    "0123456789eE+-.xXpP_ ", min_size=1, max_size=7
)
_lists = st.lists(_scalars, max_size=3).map(lambda items: f"[{', '.join(items)}]")
_values = _scalars | _lists | _lists.map(lambda text: f"!!python/tuple {text}")


def _map(children: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    pairs = st.tuples(_names, children).map(lambda pair: f"{pair[0]}: {pair[1]}")
    return st.lists(pairs, min_size=1, max_size=3).map(lambda items: f"{{{', '.join(items)}}}")


_groups = st.recursive(_values, _map, max_leaves=8)
_sections = st.tuples(
    st.sampled_from(["/**", "perception", "/perception", "/*", "other", "left/perception"]), _map(_groups)
)
_files = st.lists(_sections, min_size=1, max_size=3).map(
    lambda sections: "".join(f"{name}:\n  ros__parameters: {text}\n" for name, text in sections)
)
_overrides = st.tuples(_names.filter(lambda name: name.isalpha()), _values).map(lambda pair: f"-p {pair[0]}:={pair[1]}")


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.lists(_files, min_size=1, max_size=2), st.lists(_overrides, max_size=2))
def test_any_files_and_overrides(rcl: Rcl, files: list[str], overrides: list[str]) -> None:
    assert repr(ours(*files, *overrides)) == repr(rcl(*files, *overrides))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((lines("w: [1]"), "-p w:=[0.5]"), "w: [1] is in force, not the later [0.5]"),
        ((lines("n: [a]"), "-p n:=[]"), "n: ['a'] is in force, not the later []"),
        (
            ("/**: {ros__parameters: {s: 1}}\nperception: {ros__parameters: {s: 2}}\n", "-p s:=3"),
            "s: 2 is in force, not the later 3",
        ),
        ((lines("w: 1"), "-p w:=2"), ""),
        (("/**: {ros__parameters: {s: 1}}\nother: {ros__parameters: {s: 2}}\n",), ""),
    ],
)
def test_what_ros_leaves_out_of_force_is_told(arguments: tuple[str, ...], said: str) -> None:
    parameters = RclParameters()
    for argument in arguments:
        if argument.startswith("-p "):
            parameters.add_override(argument[3:])
        else:
            parameters.add_file(argument.encode(), "p.yaml")
    told = parameters.overruled(lambda section: section_applies(with_slash(section), "/perception"))
    assert len(told) == bool(said)
    assert all(line.startswith(said) and "\n" not in line for line in told)
