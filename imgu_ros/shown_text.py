# SPDX-License-Identifier: Apache-2.0
"""Text from outside as it is shown to people: no character acts on a terminal, and no text is endless.

Names of files, topics and frames, encodings and formats come from other people's files and programs. Where a program
reads them they keep their exact value; messages, logs, diagnostics and reports show them through `shown`. `as_cell`
is for tables that a spreadsheet may open.
"""

from __future__ import annotations

import re

#: Length of a line that is shown, and of a name in it.
LINE_CHARACTERS, NAME_CHARACTERS = 2000, 200

#: Characters that act instead of being seen: C0 and C1 controls (ESC and CSI among them), line and paragraph
#: separators, marks and overrides of the direction of writing, zero-width characters, tags, and lone surrogates (of
#: names that are not UTF-8). Joiners stay: emoji and several scripts are written with them.
_ACTING = (
    r"\x00-\x1f\x7f-\x9f\u061c\u180e\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ud800-\udfff\ufeff\ufff9-\ufffb"
    r"\U000e0000-\U000e007f"
)
_ACTING_CHARACTER = re.compile(f"[{_ACTING}]")
_NAMED = {"\n": r"\n", "\r": r"\r", "\t": r"\t"}

#: A cell that begins so is a formula to a spreadsheet.
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "'")
_CELL_CHARACTER = re.compile(rf"[\\{_ACTING}]")
_CELL_ESCAPE = re.compile(r"\\(\\|x[0-9a-f]{2}|u[0-9a-f]{4}|U[0-9a-f]{8})")


def shown(text: str, limit: int = LINE_CHARACTERS) -> str:
    r"""Return a text on one line, its acting characters as visible escapes, at most `limit` characters long.

    What is longer loses its middle, and says its length there. A text that went through it stays as it is; so does
    what has nothing to escape, in any language.

    Parameters
    ----------
    text : from anywhere
    limit : most characters of the answer, at least 60

    Examples
    --------
    >>> print(shown("camera\x1b[2J"))
    camera\x1b[2J
    >>> shown("a" * 1000, 60)
    'aaaaaaaaaaaaaaaaaaaaaaaa...(1000 characters)...aaaaaaaaaaaaa'
    """
    if len(text) <= limit:
        if text.isprintable():
            return text
        escaped = _ACTING_CHARACTER.sub(_escape, text)
        if len(escaped) <= limit:
            return escaped
    mark = f"...({len(text)} characters)..."
    last = (limit - len(mark)) * 3 // 8
    first = limit - len(mark) - last
    start, end = (_ACTING_CHARACTER.sub(_escape, part) for part in (text[:first], text[-last:]))
    return f"{start[:first]}{mark}{end[-last:]}"


def quoted(name: str, limit: int = NAME_CHARACTERS) -> str:
    r"""Return a name as Python writes it, in quotes; of an endless one both ends and the length.

    Examples
    --------
    >>> print(quoted("camera\x1b"))
    'camera\x1b'
    """
    if len(name) <= limit:
        return repr(name)
    return f"{name[: limit * 2 // 3]!r}...({len(name)} characters)...{name[-(limit // 3) :]!r}"


def as_cell(text: str) -> str:
    r"""Return a text as a cell of a CSV file that no spreadsheet takes for a formula.

    Before a text that begins with ``= + - @``, tab, carriage return or ``'`` goes a ``'``; acting characters become
    escapes, and a backslash two. `cell_text` gives the text back.

    Examples
    --------
    >>> print(as_cell("=1+1"), as_cell("a\tb"))
    '=1+1 a\x09b
    """
    cell = text if text.isprintable() and "\\" not in text else _CELL_CHARACTER.sub(_cell_escape, text)
    return f"'{cell}" if text.startswith(_FORMULA) else cell


def cell_text(cell: str) -> str:
    r"""Return the text that `as_cell` made a cell of.

    Examples
    --------
    >>> cell_text(as_cell("=1+1")), cell_text(as_cell("a\\b\tc"))
    ('=1+1', 'a\\b\tc')
    """
    return _CELL_ESCAPE.sub(_unescaped, cell.removeprefix("'")) if "\\" in cell else cell.removeprefix("'")


def _escape(found: re.Match[str]) -> str:
    character = found[0]
    return _NAMED.get(character) or _code_escape(character)


def _cell_escape(found: re.Match[str]) -> str:
    return r"\\" if found[0] == "\\" else _code_escape(found[0])


def _code_escape(character: str) -> str:
    code = ord(character)
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def _unescaped(found: re.Match[str]) -> str:
    code = int(found[1][1:] or "5c", 16)
    return chr(code) if code < 0x110000 else found[0]
