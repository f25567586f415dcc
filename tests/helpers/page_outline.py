"""What a page holds: tables, ids and attributes; elements that do not nest are an error."""

import html.parser
from collections import defaultdict

VOID = {"meta", "img", "input", "br"}


class Outline(html.parser.HTMLParser):
    """Tables, ids and elements of a page; fails where elements do not nest."""

    def __init__(self, text):
        super().__init__()
        self.open, self.ids, self.tables, self.attributes = [], [], {}, defaultdict(list)
        self.cells = self.caption = None
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.ids += [attrs["id"]] if "id" in attrs else []
        for key, value in attrs.items():
            self.attributes[key].append(value)
        if tag in VOID:
            return
        self.open.append(tag)
        if tag == "table":
            self.cells = []
        elif tag == "tr":
            self.cells.append([])
        elif tag in {"td", "th"}:
            self.cells[-1].append("")
        elif tag == "caption":
            self.caption = ""

    def handle_startendtag(self, tag, attrs):
        self.attributes["self-closed"].append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        if tag == "table":
            self.tables[self.caption] = self.cells
            self.cells = None

    def handle_data(self, data):
        if self.open and self.open[-1] == "caption":
            self.caption += data
        elif self.cells and self.cells[-1] and self.open[-1] in {"td", "th"}:
            self.cells[-1][-1] += data
