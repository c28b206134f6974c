"""Checks that the links of the built pages have targets: files, and anchors within pages.  It does not need the network.

    python docs/check_links.py docs/_build/html

Links to other sites are not followed: `python -m sphinx -b linkcheck docs docs/_build/linkcheck` does that.
"""

import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class Page(HTMLParser):
    """The anchors and the references of one page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.references: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("id", "name") and value:
                self.anchors.add(value)
            elif name in ("href", "src") and value:
                self.references.append(value)


def broken(folder: Path) -> Iterator[str]:
    """A sentence for every reference without a target in the pages of a folder."""
    # HTML files of the theme in _static are not pages
    files = (path for path in sorted(folder.rglob("*.html")) if "_static" not in path.parts)
    pages = {path.resolve(): Page(path) for path in files}
    for path, page in pages.items():
        for reference in page.references:
            parts = urlsplit(reference)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.is_file():
                yield f"{path.relative_to(folder.resolve())}: {reference} does not exist"
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors:
                yield f"{path.relative_to(folder.resolve())}: {reference} has no such anchor"


if __name__ == "__main__":
    messages = list(broken(Path(sys.argv[1])))
    sys.exit("\n".join(messages) or None)
