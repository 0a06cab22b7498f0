# SPDX-License-Identifier: Apache-2.0
"""Names of rclpy and rosbags that are not public: all that the package uses, each with what it relies on."""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "imgu_ros"

#: Modules that their packages do not document: rosbags documents what `rosbags.<package>` exports.
PRIVATE_MODULES = re.compile(r"rclpy\.impl\b|rclpy\._|rosbags\.\w+\.\w+|_rclpy")
#: Names of variables that hold objects of rclpy: their attributes that begin with an underscore are not ours.
OF_RCLPY = {"node", "service", "subscription", "publisher", "executor", "timer", "client", "context", "rcutils_logger"}


def private_names(text: str) -> Iterator[str]:
    """Yield the private names that a module's code uses: imported ones, attributes, and those given to `getattr`."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and PRIVATE_MODULES.search(node.module or ""):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module in ("rclpy", "rosbags"):
            yield from (f"{node.module}.{alias.name}" for alias in node.names if alias.name in ("impl", "_rclpy"))
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if PRIVATE_MODULES.search(alias.name))
        elif isinstance(node, ast.Attribute) and re.match(r"_[a-z]", node.attr):
            owner = node.value.attr if isinstance(node.value, ast.Attribute) else getattr(node.value, "id", "")
            if owner.lstrip("_") in OF_RCLPY:
                yield f"{owner.lstrip('_')}.{node.attr}"
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("getattr", "setattr"):
            name = node.args[1]
            if isinstance(name, ast.Constant) and re.match(r"_[a-z]", str(name.value)):
                yield f"{ast.unparse(node.args[0])}.{name.value}"


def parameter_overrides() -> None:
    """A node keeps the overrides that nobody has declared as a mapping from name to Parameter."""
    pytest.importorskip("rclpy", reason="needs the ros extra")
    from rclpy.node import Node

    source = inspect.getsource(Node.__init__)
    assert "self._parameter_overrides" in source
    assert "_parameter_overrides" in inspect.getsource(Node.declare_parameters)


def internal_callers() -> None:
    """Files whose frames do not count as the caller of a logging call."""
    pytest.importorskip("rclpy", reason="needs the ros extra")
    from rclpy.impl import rcutils_logger

    assert isinstance(rcutils_logger._internal_callers, list)
    assert "_internal_callers" in inspect.getsource(rcutils_logger._find_caller)


def rcutils_logger() -> None:
    """The class of a node's logger, whose every message goes through `log`."""
    pytest.importorskip("rclpy", reason="needs the ros extra")
    from rclpy.impl.rcutils_logger import RcutilsLogger
    from rclpy.logging import get_logger

    assert type(get_logger("any")) is RcutilsLogger
    assert list(inspect.signature(RcutilsLogger.log).parameters)[:3] == ["self", "message", "severity"]
    for level in ("debug", "info", "warning", "error", "fatal"):
        assert "self.log(" in inspect.getsource(getattr(RcutilsLogger, level))


def parser_of_definitions() -> None:
    """A parser whose messages, as a table of types, equal what the public function makes of the same text."""
    from rosbags.typesys import get_types_from_idl
    from rosbags.typesys.base import make_typesdict
    from rosbags.typesys.idl import IDLParser

    text = "module a { module msg { struct B { long x; sequence<double> y; }; }; };"
    assert make_typesdict(IDLParser(text).specification()) == get_types_from_idl(text)


def typestore() -> None:
    """A typestore is made without types, takes those registered, and reads what they define in both serialisations."""
    from rosbags.serde.cdr import generate_deserialize_cdr
    from rosbags.serde.ros1 import generate_deserialize_ros1
    from rosbags.typesys import get_types_from_msg
    from rosbags.typesys.store import Typestore

    store = Typestore()
    assert not store.fielddefs
    store.register(get_types_from_msg("int32 x", "a/msg/B"))
    definition = store.get_msgdef("a/msg/B")
    fields = store.fielddefs["a/msg/B"][1]
    for order in ("le", "be"):
        data = (7).to_bytes(4, "little" if order == "le" else "big")
        message, size = generate_deserialize_cdr(fields, store, order)(data, 0, definition.cls, store)
        assert (message.x, size) == (7, 4)
    message, size = generate_deserialize_ros1(fields, store)((7).to_bytes(4, "little"), 0, definition.cls, store)
    assert (message.x, size) == (7, 4)
    for method in ("get_msgdef", "deserialize_cdr", "deserialize_ros1"):
        assert callable(getattr(Typestore, method))
    assert isinstance(store.cache, dict)


def names_of_fields_and_types() -> None:
    """Names that are Python's get an underscore; types of ROS 1 get the folder `msg`."""
    from rosbags.typesys.base import normalize_fieldname
    from rosbags.typesys.msg import normalize_msgtype

    assert [normalize_fieldname(name) for name in ("from", "x")] == ["from_", "x"]
    assert [normalize_msgtype(name) for name in ("a/B", "a/msg/B")] == ["a/msg/B", "a/msg/B"]


#: Every private name, and the check that fails when it changes.
CHECKS: dict[str, Callable[[], None]] = {
    "node._parameter_overrides": parameter_overrides,
    "rclpy.impl.rcutils_logger": rcutils_logger,
    "rclpy.impl.rcutils_logger.RcutilsLogger": rcutils_logger,
    "rcutils_logger._internal_callers": internal_callers,
    "rosbags.serde.cdr.generate_deserialize_cdr": typestore,
    "rosbags.serde.ros1.generate_deserialize_ros1": typestore,
    "rosbags.typesys.base.make_typesdict": parser_of_definitions,
    "rosbags.typesys.base.normalize_fieldname": names_of_fields_and_types,
    "rosbags.typesys.idl.IDLParser": parser_of_definitions,
    "rosbags.typesys.msg.normalize_msgtype": names_of_fields_and_types,
    "rosbags.typesys.store.Typestore": typestore,
}


def used() -> set[str]:
    return {name for path in PACKAGE.rglob("*.py") for name in private_names(path.read_text(encoding="utf-8"))}


def test_every_private_name_is_listed() -> None:
    assert used() == CHECKS.keys()


@pytest.mark.parametrize("name", CHECKS)
def test_private_name_is_as_expected(name: str) -> None:
    CHECKS[name]()


def test_a_service_gives_its_response_to_send_response() -> None:
    """`BackgroundServices` replaces this public method of one service; both executors look it up at each request.

    test_background_services.py shows that they do.
    """
    pytest.importorskip("rclpy", reason="needs the ros extra")
    from rclpy.service import Service

    assert list(inspect.signature(Service.send_response).parameters) == ["self", "response", "header"]


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("from rclpy.impl.implementation_singleton import rclpy_implementation",
         "rclpy.impl.implementation_singleton.rclpy_implementation"),
        ("import rclpy._rclpy_pybind11", "rclpy._rclpy_pybind11"),
        ("def f(node):\n    return node._parameters", "node._parameters"),
        ("class N:\n    def f(self):\n        return self._node._clock", "node._clock"),
        ("getattr(self, '_state_machine')", "self._state_machine"),
    ],
)  # fmt: skip
def test_private_names_are_seen(text: str, name: str) -> None:
    assert list(private_names(text)) == [name]
