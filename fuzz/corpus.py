# SPDX-License-Identifier: Apache-2.0
"""Named cases, each of which once broke a reader: built by code, run by test/fuzz and `python -m fuzz --corpus`."""

from __future__ import annotations

from fuzz import corpus_pictures, corpus_recordings, corpus_texts
from fuzz.corpus_entry import Entry

CORPUS: dict[str, Entry] = {**corpus_recordings.ENTRIES, **corpus_pictures.ENTRIES, **corpus_texts.ENTRIES}
