"""What a page holds: tables, ids and attributes; elements that do not nest are an error."""

import html.parser
import json
import re
import zlib
from base64 import b64decode
from collections import defaultdict

import numpy as np

VOID = {"meta", "img", "input", "br"}


class Outline(html.parser.HTMLParser):
    """Tables, ids, elements and text of a page; fails where elements do not nest."""

    def __init__(self, text):
        super().__init__()
        self.open, self.ids, self.tables, self.attributes = [], [], {}, defaultdict(list)
        self.elements, self.text = defaultdict(list), ""
        self.cells = self.caption = None
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.elements[tag].append(attrs)
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
        self.text += data
        if self.open and self.open[-1] == "caption":
            self.caption += data
        elif self.cells and self.cells[-1] and self.open[-1] in {"td", "th"}:
            self.cells[-1][-1] += data


class ReadPage:
    """What a page holds, read as a browser would."""

    def __init__(self, path):
        self.text = path.read_text(encoding="utf-8")
        self.data = json.loads(
            re.search(r'<script type="application/json" id="report-data">(.*?)</script>', self.text)[1]
        )

    def codes(self, name, at=0):
        about = self.data["maps"][at]
        return self.bytes_of(about[name], about)

    def objects(self):
        about = self.data["maps"][0]["objects"]
        return self.bytes_of(about["codes"], about)

    @staticmethod
    def bytes_of(text, about):
        return np.frombuffer(zlib.decompress(b64decode(text)), np.uint8).reshape(about["rows"], about["cols"])

    def values(self, key, at=0):
        about = self.data["maps"][at]
        (grid,) = [grid for grid in about["grids"] if grid["key"] == key]
        codes = self.bytes_of(grid["codes"], about).astype(float)
        plain = grid["low"] + grid["step"] * codes
        values = {"log": np.exp, "root": lambda root: root * np.abs(root)}.get(grid["scale"], np.array)(plain)
        return np.where(codes == 255, np.nan, values), grid


def require_no_requests(text):
    """A page that parses, has each id once, asks nobody for anything, and forbids a browser to."""
    outline = Outline(text)
    assert len(outline.ids) == len(set(outline.ids))
    outside = re.sub(r"<script type=\"application/json\".*?</script>", "", text, flags=re.DOTALL)
    outside = outside.replace('href="https://www.openstreetmap.org/', "")  # a link, which asks when it is followed
    assert not re.findall(r"(?i)https?:|//[a-z]+\.|@import|(?<!Data)url\((?!#)|xmlns", outside)
    assert all(link.startswith("https://www.openstreetmap.org/") for link in outline.attributes.pop("href", ()))
    assert set(outline.attributes) & {"action", "style", "onclick", "srcset"} == set()
    assert all(source.startswith("data:image/jpeg;base64,") for source in outline.attributes["src"])
    (policy,) = [text for text in outline.attributes["content"] if "default-src" in text]
    assert policy.startswith("default-src 'none'; img-src data:; style-src 'sha256-")
    assert "unsafe" not in policy
