"""What holds for every HTML page that a stage writes."""

from __future__ import annotations

import re
from html.parser import HTMLParser

VOID = {"meta", "img", "br", "hr", "link", "input"}


class Checker(HTMLParser):
    """Every tag is closed in order, and nothing refers to another place than the page itself."""

    def __init__(self):
        super().__init__(convert_charrefs=True)
        self.open, self.text, self.tags = [], [], []

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        for name, value in attributes:
            if name in ("src", "href", "xlink:href", "action", "data", "srcset"):
                assert value.startswith(("#", "data:image/png;base64,")), (tag, name, value[:80])
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open and self.open.pop() == tag, tag

    def handle_data(self, data):
        self.text.append(data)


def checked(text):
    """The page as a Checker; raises AssertionError."""
    page = Checker()
    page.feed(text)
    page.close()
    assert page.open == []
    assert "@import" not in text and "url(http" not in text and "<script" not in text
    return page


def plain(text):
    """A page's source without the marks of explained words, which may stand in any sentence."""
    return re.sub(r"</?abbr[^>]*>", "", text)
