# SPDX-License-Identifier: Apache-2.0
"""Text in recordings: UTF-8 by the rules of every format, and not always in practice (comments, names)."""

from __future__ import annotations

import codecs

_MARKS = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))


def text_of(data: bytes) -> str:
    """Return bytes as text, whatever they are: no text in a recording is worth the data beside it.

    They are read as a byte order mark says, else as UTF-8, else as Windows-1252, which Latin-1 is a part of; bytes that
    are not even that, as Latin-1. Different bytes give different text, so that names stay apart.
    """
    for mark, encoding in _MARKS:
        if data.startswith(mark):
            return data[len(mark) :].decode(encoding, "replace")
    for encoding in ("utf-8", "cp1252"):
        try:
            return data.decode(encoding)
        except UnicodeDecodeError:
            continue
    return data.decode("latin-1")


def ascii_patched(data: bytes | memoryview, text: bytes) -> bytes:
    """Return `data` with the bytes of the first string `text` in it that are not UTF-8 replaced by question marks.

    For deserialisers that take nothing but UTF-8: lengths and places in the data stay what they are. A string follows
    its length, which ROS 2 gives with a closing zero byte and ROS 1 without; the same bytes elsewhere are other data.

    Raises
    ------
    ValueError
        If there is no such string.
    """
    patched = bytearray(data)
    sizes = [(len(text) + zero).to_bytes(4, order) for zero in (1, 0) for order in ("little", "big")]
    found = [place + 4 for size in sizes if (place := patched.find(size + text)) >= 0]
    if not found:
        raise ValueError(f"no string of {len(text)} bytes that are not UTF-8 in the message")
    at = min(found)
    # Each byte that is none of UTF-8 becomes one surrogate, and each of those one question mark.
    patched[at : at + len(text)] = text.decode("utf-8", "surrogateescape").encode("utf-8", "replace")
    return bytes(patched)
