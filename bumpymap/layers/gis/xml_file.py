"""Write XML that QGIS reads, with the same bytes for the same content."""

import re
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree as ET

from bumpymap.core import atomic

__all__ = ["QGIS_VERSION", "add", "plain_text", "write_qgis"]

QGIS_VERSION = "3.22.0"
"""The version of QGIS whose form the files have; newer ones read it too."""
_DOCTYPE = b"<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def add(
    parent: ET.Element, tag: str, attributes: Mapping[str, str] | None = None, text: str | None = None
) -> ET.Element:
    """Append an element to another one and return it."""
    element = ET.SubElement(parent, tag, dict(attributes or {}))
    element.text = text
    return element


def plain_text(value: object) -> str:
    """Return a value as text; what XML cannot hold (control characters, bytes that are not UTF-8) becomes U+FFFD."""
    return _NOT_XML.sub("\ufffd", str(value))


def write_qgis(root: ET.Element, path: Path) -> None:
    """Write a style or a project, whole or not at all. Raises OutputError if it cannot be written."""
    ET.indent(root, " ")
    text = ET.tostring(root, encoding="utf-8")
    with atomic(path) as temporary:
        temporary.write_bytes(_DOCTYPE + text + b"\n")
