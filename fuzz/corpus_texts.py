# SPDX-License-Identifier: Apache-2.0
"""Named calibrations and parameter files."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from fuzz.corpus_entry import Entry, file_of
from fuzz.kinds import CAMERA, PARAMETERS
from fuzz.texts import bomb, camera_seeds, parameter_seeds


def _loop(folder: Path) -> Path:
    path = folder / "file.yaml"
    path.symlink_to(path)
    return path


def _fifo(folder: Path) -> Path:
    path = folder / "file.yaml"
    os.mkfifo(path)
    return path


def _link(target: str) -> Callable[[Path], Path]:
    def build(folder: Path) -> Path:
        path = folder / "file.yaml"
        path.symlink_to(target)
        return path

    return build


def _folder(folder: Path) -> Path:
    return folder


def _odd_name(folder: Path) -> Path:
    path = Path(str(folder) + "/\udcff\x1b]0;x\x07.yaml")
    path.write_bytes(b"a: [")
    return path


def _merged_mappings() -> bytes:
    return b"k0: &k0 {a: 1}\n" + b"\n".join(
        b"k%d: &k%d {<<: [*k%d, *k%d], a%d: 1}" % (i, i, i - 1, i - 1, i) for i in range(1, 40)
    )


def _hostile() -> dict[str, Callable[[Path], Path]]:
    """Return what no YAML reader may stumble over, whatever it reads."""
    return {
        "alias_bomb": file_of("f.yaml", lambda: bomb(12, 10)),
        "alias_bomb_as_a_mapping": file_of("f.yaml", _merged_mappings),
        "endless_digits": file_of("f.yaml", lambda: b"image_width: " + b"9" * 5000 + b"\nk: [" + b"1" * 400 + b"]\n"),
        "deep_lists": file_of("f.yaml", lambda: b"a: " + b"[" * 200_000),
        "deep_mappings": file_of("f.yaml", lambda: b"".join(b" " * i + b"a:\n" for i in range(1500))),
        "large_file": file_of("f.yaml", lambda: b"a: 1\n" * 4_000_000),
        "one_long_line": file_of("f.yaml", lambda: b"a: " + b"x" * 30_000_000),
        "control_characters": file_of("f.yaml", lambda: b"\x1b[31m: \x07\n"),
        "escaped_control_characters": file_of("f.yaml", lambda: b'"\\x1b[31m\\a": {"\\x1b[2J": "\\x9b5n"}\n'),
        "loop": _loop,
        "fifo": _fifo,
        "zeros": _link("/dev/zero"),
        "random": _link("/dev/urandom"),
        "folder": _folder,
        "odd_name": _odd_name,
    }


def _camera(old: bytes, new: bytes, seed: int = 0) -> Callable[[Path], Path]:
    return file_of("camera.yaml", lambda: camera_seeds()[seed].replace(old, new))


def _parameters(old: bytes, new: bytes) -> Callable[[Path], Path]:
    return file_of("parameters.yaml", lambda: parameter_seeds()[0].replace(old, new))


_NUMBERS = {
    "400_digits": b"1" * 400,
    "infinite": b".inf",
    "overflowing": b"1e400",
    "not_a_number": b".nan",
    "minus_zero": b"-0",
    "hexadecimal": b"0x" + b"f" * 300,
    "control_characters": b'"\\x1b[2J"',
    "a_date": b"2001-99-99",
    "a_tag": b"!!float x",
}

ENTRIES: dict[str, Entry] = {
    **{f"camera_{name}": Entry(CAMERA, build, is_read=False) for name, build in _hostile().items()},
    **{f"parameters_{name}": Entry(PARAMETERS, build, is_read=False) for name, build in _hostile().items()},
    **{f"camera_width_{name}": Entry(CAMERA, _camera(b"640", value)) for name, value in _NUMBERS.items()},
    **{f"camera_matrix_{name}": Entry(CAMERA, _camera(b"500.0", value, 2)) for name, value in _NUMBERS.items()},
    **{
        f"parameters_seed_{name}": Entry(PARAMETERS, _parameters(b"seed: 7", b"seed: " + value))
        for name, value in _NUMBERS.items()
    },
    "camera_name_with_escapes": Entry(CAMERA, _camera(b": camera", b': "\\x1b[31m\\n=1+1"'), is_read=True),
    "camera_whole": Entry(CAMERA, _camera(b"500.0", b"501.0"), is_read=True),
}
