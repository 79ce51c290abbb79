#!/usr/bin/env python3
"""Links of the book: a preprocessor of mdBook, and with --check DIR a check of the site that it made.

Pages link to one another and to sources as files of the checkout, so that they can be read there. A page that is one
line with a link to a document of the root becomes that document on the site; a link to the document leads to it, and
one to a source to the repository.
"""
import html.parser
import json
import pathlib
import posixpath
import re
import sys
import urllib.parse

ROOT = pathlib.Path(__file__).resolve().parent.parent
SOURCES = "https://github.com/stillroom/stillroom/blob/main/"
DOCUMENT = re.compile(r"\A[^\n]*\]\((\.\./[A-Z]+\.md)\)[^\n]*\n*\Z")
LINK = re.compile(r"(\]\()([^)\s]+)(\))")


def chapters(items):
    for item in items:
        chapter = item.get("Chapter") if isinstance(item, dict) else None
        if chapter:
            yield chapter
            yield from chapters(chapter["sub_items"])


def outside_code(text, change):
    """Changes a text, but for its blocks and spans of code."""
    parts = re.split(r"(^```.*?^```|^ +```.*?^ +```|`[^`\n]+`)", text, flags=re.MULTILINE | re.DOTALL)
    return "".join(part if index % 2 else change(part) for index, part in enumerate(parts))


def main():
    _, book = json.load(sys.stdin)
    found = list(chapters(book.get("items", book.get("sections", []))))
    included = {}
    for chapter in found:
        if document := DOCUMENT.match(chapter["content"]):
            included[posixpath.normpath(posixpath.join("docs", document[1]))] = chapter["path"]
    pages = {chapter["path"] for chapter in found}

    def site(folder):
        def link(match):
            before, target, after = match.groups()
            if "://" in target or target.startswith(("#", "mailto:")):
                return match.group()
            path, _, anchor = target.partition("#")
            path = posixpath.normpath(posixpath.join(folder, path))
            anchor = "#" + anchor if anchor else ""
            if path in included:
                return before + included[path] + anchor + after
            inner = path.removeprefix("docs/")
            if inner != path and (inner in pages or not inner.endswith(".md")):
                return before + inner + anchor + after
            return before + SOURCES + path + anchor + after

        return lambda text: LINK.sub(link, text)

    for chapter in found:
        if document := DOCUMENT.match(chapter["content"]):
            text = (ROOT / "docs" / document[1]).read_text(encoding="utf-8")
            chapter["content"] = outside_code(text, site(""))
        else:
            chapter["content"] = outside_code(chapter["content"], site("docs"))
    json.dump(book, sys.stdout)


class Page(html.parser.HTMLParser):
    """Where a page's links lead, and the places in it that can be led to."""

    def __init__(self, text):
        super().__init__()
        self.links = []
        self.ids = set()
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        for name, value in attributes:
            if name == "id":
                self.ids.add(value)
            elif value and (name == "src" or name == "href" and tag != "base"):
                self.links.append(value)


def check(site):
    """Prints links that lead nowhere, and returns how many there are."""
    pages = {path: Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    dead = set()
    count = 0
    for path, page in pages.items():
        # Addresses of the page for what is not found are those of a server's root.
        if path.name in ("404.html", "toc.html"):
            continue
        for link in page.links:
            parts = urllib.parse.urlsplit(link)
            if parts.scheme or parts.netloc:
                ours = link.startswith(SOURCES)
                if ours and not (ROOT / urllib.parse.unquote(link[len(SOURCES) :].partition("#")[0])).exists():
                    dead.add(f"{path.name}: {link}")
                continue
            count += 1
            target = (path.parent / urllib.parse.unquote(parts.path)).resolve() if parts.path else path
            anchor = urllib.parse.unquote(parts.fragment)
            if not target.exists() or anchor and target in pages and anchor not in pages[target].ids:
                dead.add(f"{path.name}: {link}")
    for link in sorted(dead):
        print(f"book: error: a link leads nowhere: {link}", file=sys.stderr)
    if not count:
        print("book: error: the site has no links at all", file=sys.stderr)
    return len(dead) or not count


if __name__ == "__main__":
    if sys.argv[1:2] == ["supports"]:
        sys.exit(0)
    if sys.argv[1:2] == ["--check"]:
        sys.exit(1 if check(pathlib.Path(sys.argv[2]).resolve()) else 0)
    main()
