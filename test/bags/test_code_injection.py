# SPDX-License-Identifier: Apache-2.0
"""rosbags makes Python code of a bag's message definitions: no text in them becomes code but names and numbers."""

from __future__ import annotations

import ast
import builtins
import re
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.bags.decoding import MessageDecoder
from imgu_ros.bags.storage import Channel

#: What rosbags' generators write.
IMPORTED = re.compile(r"__future__|dataclasses|typing|rosbags\.(interfaces|serde)(\.\w+)?")
CALLED = re.compile(
    r"cls|bytes|range|len|check_\w+|unpack_\w+|values?\.append|typestore\.get_msgdef|msgdef\.deserialize_\w+|numpy\.frombuffer"
    r"|bytes\(rawdata\[[a-z0-9 +:-]+\]\)\.decode"
)
CALL = "__import__('test_code_injection_was_run')"
SEPARATOR = "\n" + "=" * 80 + "\n"

#: What becomes code where a generator writes it down as it is: after a name, in quotes of each kind, on a new line.
ESCAPES = [
    f"a={CALL}",
    f"a: int = {CALL}",
    f"a\n{CALL}",
    f"a\r{CALL}",
    f"a\x0b{CALL}",
    f"a\x0c{CALL}",
    f"a\x85{CALL}",
    f"a\u2028{CALL}",
    f'a"+{CALL}+"',
    f"a'+{CALL}+'",
    f'a"""\n{CALL}\n"""',
    f"a\\\n{CALL}",
    f"a;{CALL}",
    f"a),{CALL},(",
    f"a]),{CALL}#",
    f"a\0{CALL}",
    f"{{{CALL}}}",
    f"%s{CALL}",
    "__class__",
    "__init__",
    "__post_init__",
    "__getattr__",
    "__debug__",
    "self",
    "val",
    "pos",
    "rawdata",
    "typestore",
    "print",
    "\u212a",  # becomes a K in Python's identifiers
]
FORMATS = ["ros1msg", "ros2msg", "ros2idl"]


def definitions(text: str) -> Iterator[tuple[str, str, str]]:
    """Yield (format, type name, definition) with the text wherever a definition or a type's name holds any."""
    for form in ("ros1msg", "ros2msg"):
        yield form, "demo/msg/Outer", f"int32 {text}\n"
        yield form, "demo/msg/Outer", f"{text} field\n"
        yield form, "demo/msg/Outer", f"{text}[3] field\n"
        yield form, "demo/msg/Outer", f"int32[{text}] field\n"
        yield form, "demo/msg/Outer", f"string<={text} field\n"
        yield form, "demo/msg/Outer", f"int32 field {text}\n"
        yield form, "demo/msg/Outer", f"string TEXT={text}\nint32 field\n"
        yield form, "demo/msg/Outer", f"string {text}=x\nint32 field\n"
        yield form, "demo/msg/Outer", f"demo/Inner field\n{SEPARATOR}MSG: demo/{text}\nint32 field\n"
        yield form, "demo/msg/Outer", f"demo/Inner field\n{SEPARATOR}MSG: demo/Inner\nint32 {text}\n"
        yield form, f"demo/msg/{text}", "int32 field\n"
        yield form, f"{text}/msg/Outer", "int32 field\n"
    for struct in (
        f"struct Outer {{ long {text}; }};",
        f"struct Outer {{ {text} field; }};",
        f"struct Outer {{ long field[{text}]; }};",
        f"struct Outer {{ sequence<long, {text}> field; }};",
        f"struct {text} {{ long field; }};",
        f"const long A = {text}; struct Outer {{ long field; }};",
        f'const string A = "{text}"; struct Outer {{ long field; }};',
        f"const string A = '{text}'; struct Outer {{ long field; }};",
        f"typedef {text} T; struct Outer {{ T field; }};",
        f"enum {text} {{ A }}; struct Outer {{ long field; }};",
        f"@default(value={text}) struct Outer {{ @verbatim(text={text}) long field; }};",
    ):
        yield "ros2idl", "demo/msg/Outer", f"module demo {{ module msg {{ {struct} }}; }};"
    yield "ros2idl", "demo/msg/Outer", f"module {text} {{ module msg {{ struct Outer {{ long field; }}; }}; }};"


@pytest.fixture
def executed(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Collect the source of all code that is run from text."""
    return watch(monkeypatch)


def watch(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    sources: list[Any] = []
    run = builtins.exec

    def watched(source: Any, *arguments: Any) -> None:
        # Not what Python's own dataclass decorator writes of the finished class.
        if isinstance(source, str) and not source.startswith("def __create_fn__"):
            sources.append(source)
        run(source, *arguments)

    monkeypatch.setattr(builtins, "exec", watched)
    return sources


def read(form: str, type_name: str, schema: str) -> str:
    serialization = "ros1" if form == "ros1msg" else "cdr"
    return MessageDecoder().type_error(Channel("/topic", type_name, serialization, form, schema))


@pytest.mark.parametrize("text", ESCAPES)
def test_definitions_run_no_code(text: str, executed: list[Any]) -> None:
    for form, type_name, schema in definitions(text):
        reason = read(form, type_name, schema)
        assert "No module named" not in reason, schema
    for source in executed:
        assert "test_code_injection_was_run" not in source
        check(source)


def check(source: str) -> None:
    """All that generated code imports and calls is what rosbags' own generators write."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            assert {item.name for item in node.names} <= {"numpy", "sys"}, ast.unparse(node)
        if isinstance(node, ast.ImportFrom):
            assert IMPORTED.fullmatch(node.module or ""), ast.unparse(node)
        if isinstance(node, ast.Call):
            assert CALLED.fullmatch(ast.unparse(node.func)), ast.unparse(node)


def test_a_plain_definition_is_read(executed: list[Any]) -> None:
    assert (
        read(
            "ros2msg",
            "demo/msg/Plain",
            "int32 number\nstring[] texts\ndemo/Inner[2] inner\n" + SEPARATOR + "MSG: demo/Inner\nfloat64[9] values\n",
        )
        == ""
    )
    assert len(executed) >= 2
    for source in executed:
        check(source)


@given(st.sampled_from(FORMATS), st.text(max_size=30), st.integers(0, 40))
def test_any_text_gives_checked_code_or_an_error(form: str, text: str, place: int) -> None:
    every = [item for item in definitions(text) if item[0] == form]
    form, type_name, schema = every[place % len(every)]
    with pytest.MonkeyPatch.context() as monkeypatch:
        executed = watch(monkeypatch)
        reason = read(form, type_name, schema)
    # Code is run only for a definition that serves, and it is what rosbags' generators write.
    assert executed or reason
    for source in executed:
        check(source)
