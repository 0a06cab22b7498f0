# SPDX-License-Identifier: Apache-2.0
"""What mkdocs.yml does not say: files of the repository outside docs/ that pages name are part of the site.

Each lies at `repository/<its path>`. In the repository links between pages of docs/ and other files are relative, so
that they work where the repository is looked at; here they are rewritten for the site.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parent.parent
FOLDER = "repository"
#: Pages outside docs/, by their name in the site; a changelog in reStructuredText is shown as it is.
PAGES = {
    f"{FOLDER}/{name}.md": name + suffix
    for name, suffix in {
        "CONTRIBUTING": ".md",
        "CHANGELOG": ".rst",
        "SECURITY": ".md",
        "QUALITY_DECLARATION": ".md",
    }.items()
}
_LINK = re.compile(r"(\]\()([^)\s#]+)((?:#[^)\s]*)?\))")


def on_files(files: Files, config: Any) -> Files:
    """Add the pages outside docs/, and the files outside it that pages link to."""
    for uri, name in PAGES.items():
        text = (ROOT / name).read_text(encoding="utf-8")
        files.append(File.generated(config, uri, content=_as_markdown(text) if name.endswith(".rst") else text))
    linked = {
        target
        for file in files.documentation_pages()
        for _, link, _ in _LINK.findall(file.content_string)
        for target in [_repository_path(file.src_uri, link)]
        if target is not None and not target.startswith("docs/") and target not in PAGES.values()
    }
    for target in sorted(linked):
        if (ROOT / target).is_file():
            files.append(File.generated(config, f"{FOLDER}/{target}", abs_src_path=str(ROOT / target)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Rewrite links that lead from docs/ to other files of the repository, or from these to docs/."""

    def rewritten(match: re.Match[str]) -> str:
        target = _repository_path(page.file.src_uri, match[2])
        if target is None:
            return match[0]
        return match[1] + posixpath.relpath(_site_path(target), posixpath.dirname(page.file.src_uri)) + match[3]

    return _LINK.sub(rewritten, markdown)


def _repository_path(page: str, link: str) -> str | None:
    """Return the path in the repository of what a page of the site links to; None of an address."""
    if ":" in link:
        return None
    source = PAGES.get(page) or posixpath.join("docs", page)
    return posixpath.normpath(posixpath.join(posixpath.dirname(source), link))


def _site_path(target: str) -> str:
    """Return where a file of the repository is in the site."""
    if target.startswith("docs/"):
        return target.removeprefix("docs/")
    return next((uri for uri, name in PAGES.items() if name == target), f"{FOLDER}/{target}")


def _as_markdown(text: str) -> str:
    """Return a text in reStructuredText as far as the changelog uses it: headings, lists, code."""
    text = re.sub(r"^\.\. .*\n", "", text)
    text = re.sub(r"^\^+\n(.+)\n\^+$", r"# \1", text, flags=re.MULTILINE)
    text = re.sub(r"^(.+)\n-{3,}$", r"## \1", text, flags=re.MULTILINE)
    return text.replace("``", "`")
