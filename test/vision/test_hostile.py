# SPDX-License-Identifier: Apache-2.0
"""Hostile input to every public function of vision/: a typed error or the right answer, never NaN, never a crash.

`test/vision/<room>/calls.py` (or several files `calls_*.py`) gives a valid call of each public function of the room::

    CALLS: dict[Callable, Callable[[np.random.Generator], dict[str, object]]] = {
        transform: lambda rng: {"H": rng.normal(size=(3, 3)), "points": rng.uniform(0, 9, (5, 2))},
        Camera.project: lambda rng: {"self": camera(), "points": rng.uniform(1, 2, (5, 3))},  # a method
    }
    INFINITE = {depth_of_field}  # optional: functions whose documented results may be infinite

Every call is to be small (about a millisecond). Each array in it, alone or first in a list, and each float, is then
mutated. `pytest test/vision/test_hostile.py -k projective` runs one room, `-k projective.transform` one module.
"""

from __future__ import annotations

import dataclasses
import enum
import importlib
import importlib.util
import inspect
import itertools
import pkgutil
import re
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

import imgu_ros.vision
from imgu_ros.errors import ImguError

HERE = Path(__file__).parent
ARRAY_TYPES = ("ArrayLike", "NDArray", "Image", "Mask", "Points", "Floats", "Matrix3", "Indices")

type_of_calls = dict[Callable[..., Any], Callable[[np.random.Generator], dict[str, Any]]]


@dataclass(frozen=True)
class Room:
    calls: type_of_calls
    infinite: frozenset[Callable[..., Any]]
    missing: str


def _load(room: str) -> Room:
    calls: type_of_calls = {}
    infinite: set[Callable[..., Any]] = set()
    broken = ""
    paths = sorted((HERE / room).glob("calls*.py"))
    for path in paths:
        try:
            spec = importlib.util.spec_from_file_location(f"hostile_{room}_{path.stem}", path)
            assert spec is not None and spec.loader is not None
            module = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(module)
        except Exception:  # one broken file must not hide the others
            broken += f"test/vision/{room}/{path.name} cannot be loaded:\n{traceback.format_exc()}"
        else:
            calls |= module.CALLS
            infinite |= set(getattr(module, "INFINITE", ()))
    return Room(calls, frozenset(infinite), broken or ("" if paths else f"test/vision/{room}/calls.py is missing"))


BROKEN: list[str] = []
#: Without the aruco module every call of its room ends with one error, which `test/vision/markers` looks at.
UNUSABLE = set() if hasattr(cv2, "aruco") else {"markers"}


def _modules() -> Iterator[ModuleType]:
    for info in pkgutil.walk_packages(imgu_ros.vision.__path__, "imgu_ros.vision."):
        if not info.ispkg and info.name.count(".") == 2:
            continue  # a table of methods, in no room
        if info.name.split(".")[2] in UNUSABLE:
            continue
        try:
            yield importlib.import_module(info.name)
        except Exception as error:  # one broken module must not hide the others
            BROKEN.append(f"{info.name}: {error!r}")


def _takes_array(function: Callable[..., Any]) -> bool:
    parameters = inspect.signature(function).parameters.values()
    return any(name in str(parameter.annotation) for parameter in parameters for name in ARRAY_TYPES)


def _of_class(cls: type) -> Iterator[Callable[..., Any]]:
    """What of a class takes arrays: its constructor, unless it is a plain value type, and its public methods."""
    if issubclass(cls, enum.Enum | Exception) or getattr(cls, "_is_protocol", False):
        return
    value = dataclasses.is_dataclass(cls) and "__post_init__" not in vars(cls)
    if not value and "__init__" in vars(cls) and _takes_array(cls):
        yield cls
    # The methods of a problem or a model are called by `minimise` and `ransac` alone, with what they themselves made.
    if hasattr(cls, "linearise") or hasattr(cls, "squared_errors"):
        return
    for name, member in vars(cls).items():
        if _is_public(name) and inspect.isfunction(member) and _takes_array(member):
            yield member


def _is_public(name: str) -> bool:
    """Whether a function checks its arguments: those that say `unchecked` are called by the pipeline alone."""
    return not name.startswith("_") and not name.endswith("unchecked")


def _public() -> dict[str, Callable[..., Any]]:
    found: dict[str, Callable[..., Any]] = {}
    for module in _modules():
        place = module.__name__.removeprefix("imgu_ros.vision.")
        for name, member in vars(module).items():
            if not _is_public(name) or getattr(member, "__module__", "") != module.__name__:
                continue
            if inspect.isfunction(member):
                found[f"{place}.{name}"] = member
            elif inspect.isclass(member):
                for function in _of_class(member):
                    found[f"{place}.{function.__qualname__}"] = function
    return found


ROOMS = {
    info.name: _load(info.name)
    for info in pkgutil.iter_modules(imgu_ros.vision.__path__)
    if info.ispkg and info.name not in UNUSABLE
}
PUBLIC = _public()
#: Further entries of the rooms: wrappers, inherited methods.
EXTRA = {
    f"{name}.{call.__qualname__}": call
    for name, room in ROOMS.items()
    for call in room.calls
    if call not in PUBLIC.values()
}
EVERY = PUBLIC | EXTRA
#: What has no call yet fails in `test_valid_call` alone.
LISTED = [name for name, call in EVERY.items() if call in ROOMS[name.split(".", 1)[0]].calls]

# ---------------------------------------------------------------------------------------------------------------------
# Mutations


def _strided(a: NDArray[Any]) -> NDArray[Any]:
    wide = np.zeros((*a.shape[:-1], 2 * a.shape[-1]), a.dtype)
    wide[..., ::2] = a
    return wide[..., ::2]


def _read_only(a: NDArray[Any]) -> NDArray[Any]:
    a = a.copy()
    a.flags.writeable = False
    return a


def _with(a: NDArray[Any], value: float, place: float) -> NDArray[Any]:
    a = a.copy() if a.dtype.kind in "fc" else a.astype(np.float64)
    a.flat[min(int(place * a.size), a.size - 1)] = value
    return a


def _huge(a: NDArray[Any]) -> Any:
    return {"f": 1e300 if a.dtype.itemsize > 4 else 3e38, "b": True}.get(
        a.dtype.kind, np.iinfo(a.dtype).max if a.dtype.kind in "iu" else 1
    )


def _one_huge(a: NDArray[Any], place: float) -> NDArray[Any]:
    a = a.copy()
    a.flat[min(int(place * a.size), a.size - 1)] = _huge(a)
    return a


#: The same numbers in memory of another kind: the result must be the same.
SAME: dict[str, Callable[[NDArray[Any], float], Any]] = {
    "strided": lambda a, _: _strided(a),
    "reversed": lambda a, _: a[::-1].copy()[::-1],
    "fortran": lambda a, _: np.asfortranarray(a),
    "read-only": lambda a, _: _read_only(a),
    "byte-swapped": lambda a, _: a.astype(a.dtype.newbyteorder()),
}
#: Other numbers, shapes and types: a typed error, or a finite result.
OTHER: dict[str, Callable[[NDArray[Any], float], Any]] = {
    "empty": lambda a, _: a[:0],
    "no columns": lambda a, _: a[..., :0],
    "one": lambda a, _: a[:1],
    "one element": lambda a, _: a.reshape(-1)[:1],
    "0-d": lambda a, _: a.reshape(-1)[0],
    "nan": lambda a, place: _with(a, np.nan, place),
    "inf": lambda a, place: _with(a, np.inf, place),
    "-inf": lambda a, place: _with(a, -np.inf, place),
    "all nan": lambda a, _: np.full(a.shape, np.nan, a.dtype if a.dtype.kind == "f" else np.float64),
    "object": lambda a, _: a.astype(object),
    "objects": lambda a, _: np.full(a.shape, None),
    "complex": lambda a, _: a.astype(np.complex128),
    "str": lambda a, _: a.astype(str),
    "bool": lambda a, _: a.astype(bool),
    "int8": lambda a, _: np.clip(a.astype(np.float64), -128, 127).astype(np.int8),
    "int64": lambda a, _: np.clip(a.astype(np.float64), -1e9, 1e9).astype(np.int64),
    "float16": lambda a, _: np.clip(a.astype(np.float64), -6e4, 6e4).astype(np.float16),
    "ravelled": lambda a, _: a.reshape(-1),
    "stacked": lambda a, _: a[None],
    "deeper": lambda a, _: a[..., None],
    "transposed": lambda a, _: a.T,
    "shorter": lambda a, _: a[:-1],
    "narrower": lambda a, _: a[..., :-1],
    "longer": lambda a, _: np.concatenate((a, a[:1])),
    "ragged": lambda a, _: [[1.0, 2.0], [3.0]],
    "zeros": lambda a, _: np.zeros_like(a),
    "negative": lambda a, _: -a if a.dtype.kind == "f" else a,
    "all huge": lambda a, _: np.full_like(a, _huge(a)),
    "one huge": _one_huge,
    "tiny": lambda a, _: np.full_like(a, 1e-300 if a.dtype == np.float64 else 1e-38 if a.dtype.kind == "f" else 0),
}
#: Of functions that search or iterate, tens of milliseconds a call, these alone are swept through.
CORE = {
    "strided", "read-only", "byte-swapped", "empty", "one", "nan", "inf", "complex", "stacked", "shorter", "zeros",
    "one huge",
}  # fmt: skip
SLOW = {
    "best_of", "calibrate", "describe_brief_on_a_pyramid", "describe_orb_on_a_pyramid", "describe_patch_on_a_pyramid",
    "describe_rootsift_on_a_pyramid", "describe_sift_on_a_pyramid", "estimate_homography", "estimate_pose",
    "estimate_projection", "estimate_rotation", "fit_homography", "guided_homography", "planar_poses",
}  # fmt: skip
FLOATS = {"nan": np.nan, "inf": np.inf, "-inf": -np.inf}


@dataclass(frozen=True)
class Case:
    argument: str
    mutation: str
    #: Position in a list of arrays; None: the argument itself.
    index: int | None = None

    def applied(self, arguments: dict[str, Any], place: float = 0.5) -> dict[str, Any]:
        value = arguments[self.argument]
        if self.index is not None:
            changed = list(value)
            changed[self.index] = (SAME | OTHER)[self.mutation](value[self.index], place)
            return arguments | {self.argument: type(value)(changed)}
        if isinstance(value, float):
            return arguments | {self.argument: FLOATS[self.mutation]}
        return arguments | {self.argument: (SAME | OTHER)[self.mutation](value, place)}


def _cases(arguments: dict[str, Any]) -> Iterator[Case]:
    for name, value in arguments.items():
        if isinstance(value, np.ndarray) and value.ndim:
            yield from (Case(name, mutation) for mutation in SAME | OTHER)
        elif isinstance(value, list | tuple) and value and isinstance(value[0], np.ndarray) and value[0].ndim:
            yield from (Case(name, mutation, 0) for mutation in SAME | OTHER)
        elif type(value) is float:
            yield from (Case(name, mutation) for mutation in FLOATS)


# ---------------------------------------------------------------------------------------------------------------------
# Results


def _leaves(value: Any, path: str = "result") -> Iterator[tuple[str, Any]]:
    """Every number and array in a result, with where it is."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        for field in dataclasses.fields(value):
            yield from _leaves(getattr(value, field.name), f"{path}.{field.name}")
    elif isinstance(value, list | tuple):
        for i, item in enumerate(value):
            yield from _leaves(item, f"{path}[{i}]")
    elif isinstance(value, Iterator):
        yield from _leaves(list(itertools.islice(value, 3)), path)
    elif isinstance(value, np.ndarray | np.generic | float | int | str) or value is None:
        yield path, value


def _call(function: Callable[..., Any], arguments: dict[str, Any], infinite: bool) -> list[tuple[str, Any]]:
    """Call, and check that the inputs stay and that the result is finite; return the result's leaves."""
    before = {path: leaf.copy() for path, leaf in _arrays(arguments)}
    leaves = list(_leaves(function(**arguments)))
    for path, leaf in _arrays(arguments):
        assert_array_equal(leaf, before[path], f"{path} was modified in place")
    for path, leaf in leaves:
        kind = leaf.dtype.kind if isinstance(leaf, np.ndarray | np.generic) else "f" if isinstance(leaf, float) else ""
        if kind in ("f", "c"):
            wrong = np.isnan(leaf) if infinite else ~np.isfinite(leaf)
            assert not np.any(wrong), f"{path} holds {np.count_nonzero(wrong)} values that are not finite"
    return leaves


def _arrays(arguments: dict[str, Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    for name, value in arguments.items():
        for path, leaf in _leaves(value if not isinstance(value, Iterator) else None, name):
            if isinstance(leaf, np.ndarray):
                yield path, leaf


def _require_same(got: list[tuple[str, Any]], expected: list[tuple[str, Any]]) -> None:
    assert [path for path, _ in got] == [path for path, _ in expected]
    for (path, a), (_, b) in zip(got, expected, strict=True):
        if isinstance(b, str) or b is None:
            assert a == b, path
            continue
        a, b = np.asarray(a), np.asarray(b)
        assert a.shape == b.shape, path
        if b.dtype.kind != "f":
            assert_array_equal(a, b, path)
        else:
            relative = 1e-7 if b.dtype == np.float64 else 1e-4
            scale = float(np.abs(b[np.isfinite(b)]).max(initial=0))
            assert_allclose(a, b, relative, relative * scale, err_msg=path)


def _violation(function: Callable[..., Any], cases: list[Case], room: Room, seed: int, place: float) -> str | None:
    """Return what is wrong with the answer to one hostile call; None: nothing."""
    arguments = room.calls[function](np.random.default_rng(seed))
    for case in cases:
        arguments = case.applied(arguments, place)
    infinite = function in room.infinite
    same = all(case.mutation in SAME for case in cases)
    what = ", ".join(f"{c.argument}{'' if c.index is None else [c.index]} {c.mutation}" for c in cases)
    try:
        got = _call(function, arguments, infinite)
    except ImguError as error:
        if same and not any(case.mutation == "byte-swapped" for case in cases):
            return f"{what}: {error!r}"
        return None if str(error) and "\n" not in str(error) else f"{what}: {error!r} is not one line"
    except Exception as error:  # whatever escapes is the finding
        at = traceback.extract_tb(error.__traceback__)[-1]
        line = " ".join(str(error).split())[:150]
        return f"{what}: {type(error).__name__}: {line} ({Path(at.filename).name}:{at.lineno})"
    if same:
        try:
            _require_same(got, _call(function, room.calls[function](np.random.default_rng(seed)), infinite))
        except AssertionError as error:
            return f"{what}: another result: {' '.join(str(error).split())[:150]}"
    return None


# ---------------------------------------------------------------------------------------------------------------------
# Values that are no arrays

#: For every parameter: never what is meant, unless it is a flag, a name or None where that is allowed.
VALUES: dict[str, Callable[[], Any]] = {
    "None": lambda: None, "'text'": lambda: "text", "'3'": lambda: "3", "bytes": lambda: b"ab", "{}": dict,
    "{'a': 1}": lambda: {"a": 1}, "[]": list, "[None]": lambda: [None], "[['a', 'b']]": lambda: [["a", "b"]],
    "ragged": lambda: [[1.0, 2.0], [3.0]], "set": lambda: {1.5}, "object": object, "int": lambda: int,
    "lambda": lambda: lambda: 0, "generator": lambda: (i for i in range(3)), "1j": lambda: 1j,
    "date": lambda: np.datetime64("2020-01-01"), "0-d": lambda: np.array(0.5), "0-d None": lambda: np.array(None),
    "objects": lambda: np.array([None, "a"], object), "2-d": lambda: np.zeros((2, 3)),
    "masked": lambda: np.ma.masked_equal(np.eye(3), 0), "KeyPoints": lambda: [cv2.KeyPoint(1, 2, 3)] * 4,
}  # fmt: skip
#: For parameters that are no arrays: numbers out of range, and numbers of other types.
NUMBERS: dict[str, Any] = {
    "nan": np.nan, "inf": np.inf, "-inf": -np.inf, "-1": -1, "0": 0, "-1e9": -1e9, "10**30": 10**30,
    "-10**30": -(10**30), "1e300": 1e300, "1e-300": 1e-300, "2.5": 2.5, "3.0": 3.0, "True": True,
    "np.bool": np.bool_(False), "np.int64": np.int64(3), "np.uint8": np.uint8(3), "np.float32": np.float32(3),
    "0-d 3": np.array(3), "[3]": np.array([3]),
}  # fmt: skip


def _values(parameter: inspect.Parameter) -> dict[str, Callable[[], Any]]:
    kind = str(parameter.annotation)
    if any(name in kind for name in ARRAY_TYPES):
        return VALUES
    if "Callable" in kind or "Loss" in kind:  # what a function does when it is called is its own business
        return {name: value for name, value in VALUES.items() if name not in ("int", "lambda")}
    return VALUES | {name: lambda number=number: number for name, number in NUMBERS.items()}


def _escapes(
    function: Callable[..., Any], arguments: dict[str, Any], room: Room, what: str, same: bool = False
) -> str | None:
    """Return what is wrong with the answer to a call with values of other types; `same`: that of the valid call."""
    infinite = function in room.infinite
    try:
        got = _call(function, arguments, infinite)
        if same:
            _require_same(got, _call(function, room.calls[function](np.random.default_rng(0)), infinite))
    except ImguError as error:
        if same:
            return f"{what}: {error!r}"
        return None if str(error) and "\n" not in str(error) else f"{what}: {error!r} is not one line"
    except Exception as error:  # whatever escapes is the finding
        at = traceback.extract_tb(error.__traceback__)[-1]
        line = " ".join(str(error).split())[:150]
        return f"{what}: {type(error).__name__}: {line} ({Path(at.filename).name}:{at.lineno})"
    return None


def _parameters(function: Callable[..., Any]) -> list[inspect.Parameter]:
    variadic = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    parameters = inspect.signature(function).parameters.values()
    return [parameter for parameter in parameters if parameter.name != "self" and parameter.kind not in variadic]


# ---------------------------------------------------------------------------------------------------------------------


def _room_of(name: str) -> Room:
    room = ROOMS[name.split(".", 1)[0]]
    if EVERY[name] not in room.calls:
        short = name.split(".", 1)[0]
        pytest.fail(room.missing or f"test/vision/{short}/calls.py has no call of {name}", pytrace=False)
    return room


def test_every_module_imports() -> None:
    assert BROKEN == []


@pytest.mark.parametrize("name", EVERY)
def test_valid_call(name: str) -> None:
    room = _room_of(name)
    _call(EVERY[name], room.calls[EVERY[name]](np.random.default_rng(0)), EVERY[name] in room.infinite)


@pytest.mark.parametrize("name", LISTED)
def test_hostile_argument(name: str) -> None:
    room, function = _room_of(name), EVERY[name]
    cases = list(_cases(room.calls[function](np.random.default_rng(0))))
    if name.rpartition(".")[2] in SLOW:
        cases = [case for case in cases if case.mutation in CORE]
    found = [_violation(function, [case], room, 0, 0.5) for case in cases]
    wrong = [violation for violation in found if violation]
    if wrong:
        pytest.fail(f"{name}: {len(wrong)} of {len(cases)} hostile calls:\n  " + "\n  ".join(wrong), pytrace=False)


#: What takes no lists: internal arrays of the library itself, checked where they were made.
ARRAYS_ALONE = {
    "camera.resection.design_matrix", "matching.hamming.BinaryRows.distances", "matching.numbers.NumberRows.distances",
    "matching.metrics.require_index", "matching.patch_bank.PatchBank.select", "matching.gallery.Places.at",
    "projective.checks.finite", "projective.plane_motion.PlaneMotion.fit", "markers.dictionaries.nearest_marker",
}  # fmt: skip
#: Points as OpenCV returns them, (N, 1, 2): what is called so.
OF_POINTS = re.compile(r"^(points|others|xy|src|dst|pixels|corners|.*_xy|world|plane_xy|board_xy)$")
#: Not points of a picture or of space, or of any dimension.
NOT_OF_OPENCV = {
    "camera.resection.design_matrix", "estimation.chance.shares_of_places", "matching.gallery.Places.at",
}  # fmt: skip


#: What a test's own wrapper takes apart itself is no business of vision/.
OURS = [name for name in LISTED if name in PUBLIC]


@pytest.mark.parametrize("name", OURS)
def test_values_of_other_types(name: str) -> None:
    """None, words, dicts, objects, numbers out of range: for every parameter, those with defaults too."""
    room, function = _room_of(name), EVERY[name]
    wrong = []
    for parameter in _parameters(function):
        for what, value in _values(parameter).items():
            arguments = room.calls[function](np.random.default_rng(0)) | {parameter.name: value()}
            wrong.append(_escapes(function, arguments, room, f"{parameter.name}={what}"))
    found = [violation for violation in wrong if violation]
    if found:
        pytest.fail(f"{name}: {len(found)} of {len(wrong)} calls:\n  " + "\n  ".join(found), pytrace=False)


@pytest.mark.parametrize("name", [name for name in OURS if name not in ARRAYS_ALONE])
def test_lists_and_points_of_opencv_are_arrays_too(name: str) -> None:
    """Lists of lists, and (N, 1, 2) where points are taken: the same result."""
    room, function = _room_of(name), EVERY[name]
    called = room.calls[function](np.random.default_rng(0))
    wrong = []
    for parameter in _parameters(function):
        given, kind = called.get(parameter.name), str(parameter.annotation)
        if not isinstance(given, np.ndarray) or not given.ndim or "Image" in kind:
            continue
        forms: dict[str, Any] = {"list": given.tolist()}
        if given.ndim == 2:
            forms["tuples"] = tuple(map(tuple, given.tolist()))
        if OF_POINTS.match(parameter.name) and given.shape[1:] in ((2,), (3,)) and name not in NOT_OF_OPENCV:
            forms["(N, 1, C)"] = given[:, None]
        for form, value in forms.items():
            arguments = room.calls[function](np.random.default_rng(0)) | {parameter.name: value}
            violation = _escapes(function, arguments, room, f"{parameter.name} as {form}", same=True)
            wrong += [violation] if violation else []
    if wrong:
        pytest.fail(f"{name}:\n  " + "\n  ".join(wrong), pytrace=False)


@pytest.mark.parametrize("name", OURS)
def test_swapped_arguments(name: str) -> None:
    room, function = _room_of(name), EVERY[name]
    called = room.calls[function](np.random.default_rng(0))
    # Not what an error calls an argument, and not functions, which fail in their own ways.
    given = [p.name for p in _parameters(function) if p.name in called and p.name != "name"]
    given = [name for name in given if not inspect.isfunction(called[name])]
    wrong = []
    for a, b in itertools.combinations(given, 2):
        arguments = room.calls[function](np.random.default_rng(0))
        arguments[a], arguments[b] = arguments[b], arguments[a]
        wrong.append(_escapes(function, arguments, room, f"{a} and {b} swapped"))
    found = [violation for violation in wrong if violation]
    if found:
        pytest.fail(f"{name}: {len(found)} of {len(wrong)} calls:\n  " + "\n  ".join(found), pytrace=False)


@pytest.mark.parametrize("name", LISTED)
def test_hostile_arguments_together(name: str) -> None:
    room, function = _room_of(name), EVERY[name]
    cases = list(_cases(room.calls[function](np.random.default_rng(0))))
    if not cases:
        return

    # What is found is two mutations at most: nothing to shrink.
    @settings(
        max_examples=5, derandomize=True, database=None, deadline=None, phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(
        chosen=st.lists(st.sampled_from(cases), min_size=1, max_size=2, unique_by=lambda case: case.argument),
        seed=st.integers(1, 3),
        place=st.floats(0, 1),
    )
    def check(chosen: list[Case], seed: int, place: float) -> None:
        violation = _violation(function, chosen, room, seed, place)
        assert violation is None, violation

    check()
