# SPDX-License-Identifier: Apache-2.0
"""Warnings of commands, on stderr."""

from __future__ import annotations

import sys


def warn(text: str) -> None:
    """Print a warning that does not end the command."""
    print(f"imgu: warning: {text}", file=sys.stderr, flush=True)
