"""Find dead links in a built site: python docs/check_links.py results/docs.

Every href and src that leads into the site must be a file there, and its #fragment an id (or name) of that page.
Links to other hosts are not followed. Prints one line a dead link; exit code 1 if there is any.
"""

import sys
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class Page(HTMLParser):
    """What a page has: `anchors`, the set of its ids and names; `links`, the list of its hrefs and srcs."""

    def __init__(self, text):
        super().__init__()
        self.anchors, self.links = {"", "top"}, []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        for name, value in attributes:
            if value and (name == "id" or (name == "name" and tag == "a")):
                self.anchors.add(value)
            elif value and name in ("href", "src"):
                self.links.append(value)


@cache
def _page(path):
    return Page(path.read_text())


def dead_links(site):
    """Return [(page, link)] of a folder of HTML files: links into it that lead nowhere, pages sorted by name."""
    site = Path(site).resolve()
    found = []
    for path in sorted(site.rglob("*.html")):
        for link in _page(path).links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = path if not parts.path else (path.parent / unquote(parts.path)).resolve()
            there = target.is_file() and target.is_relative_to(site)
            if not there or (target.suffix == ".html" and unquote(parts.fragment) not in _page(target).anchors):
                found.append((str(path.relative_to(site)), link))
    return found


def main(site):
    """Print the dead links of a site; return the exit code. A folder without a page is a fault, too."""
    if not any(Path(site).rglob("*.html")):
        print(f"{site}: no HTML files")
        return 1
    found = dead_links(site)
    for page, link in found:
        print(f"{page}: dead link {link}")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
