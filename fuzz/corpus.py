# SPDX-License-Identifier: Apache-2.0
"""Named cases, each of which once broke a reader: built by code, run by test/fuzz and `python -m fuzz --corpus`."""

from __future__ import annotations

from fuzz import corpus_pictures, corpus_recordings, corpus_texts
from fuzz.corpus_entry import Entry
from fuzz.pool import Pool
from fuzz.worker import Answer, Request

CORPUS: dict[str, Entry] = {**corpus_recordings.ENTRIES, **corpus_pictures.ENTRIES, **corpus_texts.ENTRIES}


def run_entry(pool: Pool, name: str) -> tuple[list[str], Answer]:
    """Run a named case; return what is wrong with it, and what it cost."""
    entry = CORPUS[name]
    answer = pool.run(Request("", corpus=name))
    failures = list(answer.failures)
    if entry.is_read is not None and entry.is_read != answer.read:
        failures.append(f"need it to be {'read' if entry.is_read else 'refused'}; said: {answer.said}")
    if answer.messages < entry.messages:
        failures.append(f"{answer.messages} messages; need {entry.messages}; said: {answer.said}")
    if entry.says not in " ".join(answer.said):
        failures.append(f"need {entry.says!r} in what is said: {answer.said}")
    return failures, answer
